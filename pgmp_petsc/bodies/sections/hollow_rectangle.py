"""A rectangular tube with walls of one thickness t: a rectangle b x h with the hole b_i x h_i in its middle.

Area and second moments are those of the rectangle less those of the hole.

Torsion is Bredt's, with what the walls resist by themselves and with sharp corners. A corner, t by t, has the
resistance of 0.559 squares of wall, encloses 0.145 t^2 and resists with 0.4058 t^4 by itself (finite differences):

    J = 4 (b_i h_i + t (b_i + h_i) + 0.58 t^2)^2 / (2 (b_i + h_i) / t + 2.236) + 2/3 t^3 (b_i + h_i) + 1.623 t^4,

0.1 % off for walls up to a quarter of the shorter side, and 1.1 % for a square without a hole.

Shear along the height has the factor of a thin-walled box (Cowper 1966) with middle lines of the ratio m, width to
height,

    10 (1 + nu) (1 + 3 m)^2
      / (12 + 72 m + 150 m^2 + 90 m^3 + nu (11 + 66 m + 135 m^2 + 90 m^3) + 10 m^3 (3 + nu + 3 m)).

Neither is affine in parameters: polynomials of these are fitted over the values that they have, as few terms as are
`NEAR` it, exact at the nominal values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations_with_replacement, product
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.bodies.affine import AffineSum, Quantity
from pgmp_petsc.bodies.sections.solid_shapes import Rectangle
from pgmp_petsc.scene.bodies import Spans
from pgmp_petsc.scene.fields import PositiveOrParameter, Unit

NEAR = 3e-3  # how far a fit may be off
HIGHEST = 5  # degree of a fit
BESIDE = 1.25  # over and under the nominal value, of parameters that do not vary
LEVELS = 7  # values of each parameter that a fit is made of

Sizes = tuple[np.ndarray, np.ndarray, np.ndarray]  # b, h, t


class HollowRectangle(Rectangle):
    """A rectangular tube with walls of one thickness."""

    proportional = ()
    ordered = (("wall", "height", 0.5), ("wall", "width", 0.5))
    shape: Literal["hollow_rectangle"]
    wall: Annotated[PositiveOrParameter, Unit("m")] = Field(
        description="thickness of the walls (m), or a parameter's name"
    )

    def area(self) -> AffineSum:
        (b, h), (b_i, h_i) = self._rectangles()
        return b * h - b_i * h_i

    def inertia(self) -> tuple[AffineSum, AffineSum]:
        (b, h), (b_i, h_i) = self._rectangles()
        return (h * b**3 - h_i * b_i**3) * (1 / 12), (b * h**3 - b_i * h_i**3) * (1 / 12)

    def sheared(self, nu: float, nominal: Mapping[str, float], spans: Spans) -> tuple[AffineSum, AffineSum]:
        def factor(sizes: Sizes) -> np.ndarray:
            b, h, t = sizes
            m = (b - t) / (h - t)
            below = 12 + 72 * m + 150 * m**2 + 90 * m**3 + nu * (11 + 66 * m + 135 * m**2 + 90 * m**3)
            shares = 10 * (1 + nu) * (1 + 3 * m) ** 2 / (below + 10 * m**3 * (3 + nu + 3 * m))
            return shares * 2 * t * (b + h - 2 * t)

        def across(sizes: Sizes) -> np.ndarray:
            return factor((sizes[1], sizes[0], sizes[2]))

        return self._fitted(factor, nominal, spans), self._fitted(across, nominal, spans)

    def torsion(self, nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        def constant(sizes: Sizes) -> np.ndarray:
            b, h, t = sizes
            b, h = b - 2 * t, h - 2 * t
            enclosed = b * h + t * (b + h) + 0.58 * t**2
            return 4 * enclosed**2 / (2 * (b + h) / t + 2.236) + 2 / 3 * t**3 * (b + h) + 1.623 * t**4

        return self._fitted(constant, nominal, spans)

    def _rectangles(self) -> Iterator[tuple[AffineSum, AffineSum]]:
        """Yield the width and the height of the tube and of its hole."""
        width, height, wall = map(AffineSum.of, (self.width, self.height, self.wall))
        yield width, height
        yield width - 2.0 * wall, height - 2.0 * wall

    def _fitted(self, function: Callable[[Sizes], np.ndarray], nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        """Return a function of the sizes as a polynomial of the parameters."""
        entries = (self.width, self.height, self.wall)
        names = list(dict.fromkeys(entry for entry in entries if isinstance(entry, str)))
        ranges = spans() if names else {}

        def exact(values: np.ndarray) -> np.ndarray:
            """Return the function at values over the nominal ones, shape (n, n_names)."""
            scaled = {name: nominal[name] * column for name, column in zip(names, values.T)}
            b, h, t = (scaled[entry] if isinstance(entry, str) else np.array([entry]) for entry in entries)
            return np.where(2.0 * t < np.minimum(b, h), function((b, h, t)), np.nan)

        at_nominal = exact(np.ones((1, len(names))))[0]
        found = np.array([float(at_nominal)])
        powers: list[tuple[int, ...]] = [()]
        if names:
            levels = [_levels(*ranges.get(name, (nominal[name],) * 2), nominal[name]) for name in names]
            grid = np.array(list(product(*levels)))
            wanted = exact(grid) / at_nominal
            grid, wanted = grid[np.isfinite(wanted)], wanted[np.isfinite(wanted)]
            for degree in range(1, HIGHEST + 1):
                powers = [one for n in range(degree + 1) for one in combinations_with_replacement(range(len(names)), n)]
                rows = np.column_stack([np.prod(grid[:, one], axis=1) for one in map(list, powers)])
                found = np.linalg.lstsq(rows / wanted[:, None], np.ones(len(rows)), rcond=None)[0]
                found /= found.sum()
                if np.max(np.abs(rows @ found / wanted - 1.0)) < NEAR:
                    break
            found *= at_nominal
        terms = []
        for coefficient, one in zip(found, powers):
            term = Quantity(float(coefficient))
            for number in one:
                term = term * Quantity.of(names[number]) * (1.0 / nominal[names[number]])
            terms.append(term)
        return AffineSum.total(*terms)


def _levels(low: float, high: float, nominal: float) -> np.ndarray:
    """Return values over the nominal one that a fit is made of."""
    low, high = (low, high) if low < high else (nominal / BESIDE, nominal * BESIDE)
    return np.linspace(low, high, LEVELS) / nominal
