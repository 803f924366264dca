"""Shapes of sections: circle and rectangle, solid, and as tubes with walls of one thickness t.

Circle of radius r: ``A = pi r^2``, ``I = pi r^4 / 4``, shear factor ``6 (1 + nu) / (7 + 6 nu)``; rectangle of
width b and height h (h in the plane of motion): ``A = b h``, ``I = b h^3 / 12``, shear factor
``10 (1 + nu) / (12 + 11 nu)`` (Cowper 1966).

The torsion constant is ``pi r^4 / 2`` of a circle. That of a rectangle with the longer side a and the shorter side b is
(Timoshenko and Goodier 1951, art. 94)

    J = k a b^3,    k(x) = 1/3 (1 - 192 / pi^5 x sum_odd tanh(n pi / (2 x)) / n^5),    x = b / a,

which is one term where the ratio of the sides is fixed. Where it changes with parameters,

    J = a^2 b^2 g(x),    g(x) = g(1/x) = sum_k c_k x^k,

which is smooth also where the sides exchange their order, with c fitted over all ratios that the parameters have, exact
at the nominal values: three terms or more, as few as are `NEAR` it: 0.1 % off at most where sides that exchange their
order are up to four times as long as each other, 0.6 % up to `WIDEST`.

What is in the hole of a tube is taken from the circle or rectangle: area and second moments are those of the shape less
those of the hole, and so is the torsion constant of a circle, whose shear has the factor (Cowper 1966), with the ratio
m of the inner to the outer radius,

    6 (1 + nu) (1 + m^2)^2 / ((7 + 6 nu) (1 + m^2)^2 + (20 + 12 nu) m^2).

Torsion of a rectangle, with a hole b_i x h_i, is Bredt's, with what the walls resist by themselves and with sharp
corners. A corner, t by t, has the resistance of 0.559 squares of wall, encloses 0.145 t^2 and resists with 0.4058 t^4
by itself (finite differences):

    J = 4 (b_i h_i + t (b_i + h_i) + 0.58 t^2)^2 / (2 (b_i + h_i) / t + 2.236) + 2/3 t^3 (b_i + h_i) + 1.623 t^4,

0.1 % off for walls up to a quarter of the shorter side, and 1.1 % for a square without a hole. Its shear along the
height has the factor of a thin-walled box (Cowper 1966) with middle lines of the ratio m, width to height,

    10 (1 + nu) (1 + 3 m)^2
      / (12 + 72 m + 150 m^2 + 90 m^3 + nu (11 + 66 m + 135 m^2 + 90 m^3) + 10 m^3 (3 + nu + 3 m)).

These factors and this torsion are not affine in parameters: polynomials of them are fitted over the values that they
have, as few terms as are `CLOSE` to it, exact at the nominal values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import reduce
from itertools import combinations_with_replacement, product
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.bodies.affine import AffineSum, Quantity
from pgmp_petsc.bodies.sections.section import ShapedSection
from pgmp_petsc.scene.bodies import Spans
from pgmp_petsc.scene.fields import PositiveOrParameter, Unit

NEAR = 5e-4  # of a torsion constant: how far a fit may be off it
MOST_TERMS = 11
WIDEST = 8.0  # ratio of sides up to which one fit is made on both sides of the square


class Circle(ShapedSection):
    """A solid circular cross-section."""

    round = True
    sizes = ("radius", "radius")
    shape: Literal["circle"]
    radius: Annotated[PositiveOrParameter, Unit("m")] = Field(description="radius (m)")

    @property
    def reach(self) -> tuple[Quantity, Quantity]:
        return (Quantity.of(self.radius),) * 2

    def area(self) -> AffineSum:
        return math.pi * AffineSum.of(self.radius) ** 2

    def inertia(self) -> tuple[AffineSum, AffineSum]:
        return (math.pi / 4 * AffineSum.of(self.radius) ** 4,) * 2

    def sheared(self, nu: float, nominal: Mapping[str, float], spans: Spans) -> tuple[AffineSum, AffineSum]:
        return (6 * (1 + nu) / (7 + 6 * nu) * self.area(),) * 2

    def torsion(self, nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        return 2.0 * self.inertia()[0]


class Rectangle(ShapedSection):
    """A solid rectangular cross-section."""

    sizes = ("height", "width")
    proportional = ("width",)
    shape: Literal["rectangle"]
    width: Annotated[PositiveOrParameter, Unit("m")] = Field(
        description="size across the plane of motion (m), in space along the third axis"
    )
    height: Annotated[PositiveOrParameter, Unit("m")] = Field(
        description="size in the plane of motion (m), in space along `orientation`"
    )

    @property
    def reach(self) -> tuple[Quantity, Quantity]:
        return 0.5 * Quantity.of(self.height), 0.5 * Quantity.of(self.width)

    def area(self) -> AffineSum:
        return AffineSum.of(self.width) * AffineSum.of(self.height)

    def inertia(self) -> tuple[AffineSum, AffineSum]:
        width, height = AffineSum.of(self.width), AffineSum.of(self.height)
        return height * width**3 * (1 / 12), width * height**3 * (1 / 12)

    def sheared(self, nu: float, nominal: Mapping[str, float], spans: Spans) -> tuple[AffineSum, AffineSum]:
        return (10 * (1 + nu) / (12 + 11 * nu) * self.area(),) * 2

    def torsion(self, nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        sides = Quantity.of(self.width), Quantity.of(self.height)
        short, long = sorted(sides, key=lambda side: float(side.at(nominal)))
        ratio = float(short.at(nominal) / long.at(nominal))
        exact = float(_square_share(ratio))
        if short.monomial == long.monomial:
            return AffineSum.total(exact / ratio * long * short**3)
        # of values at which each side is as short, or as long, as it gets
        found = spans()
        ends = [{name: found.get(name, (value, value))[end] for name, value in nominal.items()} for end in (0, 1)]
        least, most = ([float(side.at(values)) for side in (short, long)] for values in ends)
        largest = max(ratio, most[0] / max(least[1], most[0] / WIDEST))
        smallest = least[0] / most[1]
        if largest > 1.0:
            smallest = max(smallest, 1.0 / WIDEST)
        # fitted over ratios of the sides, and exact at the nominal one
        ratios = np.geomspace(min(smallest, ratio), largest, 200)
        wanted = _square_share(ratios)
        for n in range(3, MOST_TERMS + 1):
            fits = []
            for powers in np.arange(2 - n, n)[:, None] + np.arange(n) - n // 2:  # around the square, or to one side
                rows = ratios[:, None] ** powers.astype(float)
                factors = np.linalg.lstsq(rows / wanted[:, None], np.ones(ratios.size), rcond=None)[0]
                factors *= exact / (factors @ ratio ** powers.astype(float))
                fits.append((float(np.max(np.abs(rows @ factors / wanted - 1.0))), factors, powers))
            error, factors, powers = min(fits, key=lambda fit: fit[0])
            if error < NEAR:
                break
        return AffineSum.total(*(float(c) * short ** int(2 + k) * long ** int(2 - k) for c, k in zip(factors, powers)))


def _square_share(ratio: np.ndarray | float) -> np.ndarray:
    """Return ``J / (a b)^2`` of rectangles with ratios of their sides, one of which is as good as its inverse."""
    ratio = np.asarray(ratio, dtype=float)
    x, n = np.minimum(ratio, 1.0 / ratio), np.arange(1, 200, 2)
    series = np.sum(np.tanh(n * math.pi / (2.0 * x[..., None])) / n**5, axis=-1)
    return x / 3.0 * (1.0 - 192.0 / math.pi**5 * x * series)


CLOSE = 3e-3  # how far a fit of a tube may be off
HIGHEST = 5  # degree of a fit
BESIDE = 1.25  # over and under the nominal value, of parameters that do not vary
LEVELS = 7  # values of each parameter that a fit is made of


class Hollow(ShapedSection):
    """A tube with walls of one thickness, which are thinner than its sizes as they are `ordered`."""

    proportional = ()
    wall: Annotated[PositiveOrParameter, Unit("m")] = Field(description="thickness of the walls (m)")

    def fitted(self, function: Callable[..., np.ndarray], nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        """Return a function of the sizes, the wall last, as a polynomial of the parameters."""
        entries = [getattr(self, name) for _, name, _ in self.ordered] + [self.wall]
        names = list(dict.fromkeys(entry for entry in entries if isinstance(entry, str)))
        ranges = spans() if names else {}

        def exact(values: np.ndarray) -> np.ndarray:
            """Return the function at values over the nominal ones, shape (n, n_names)."""
            scaled = {name: nominal[name] * column for name, column in zip(names, values.T)}
            *sizes, wall = (scaled[entry] if isinstance(entry, str) else np.array([entry]) for entry in entries)
            hollow = [wall < share * size for (*_, share), size in zip(self.ordered, sizes)]
            return np.where(reduce(np.logical_and, hollow), function(*sizes, wall), np.nan)

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
                if np.max(np.abs(rows @ found / wanted - 1.0)) < CLOSE:
                    break
            found *= at_nominal
        terms = []
        for coefficient, one in zip(found, powers):
            term = Quantity(float(coefficient))
            for number in one:
                term = term * Quantity.of(names[number]) * (1.0 / nominal[names[number]])
            terms.append(term)
        return AffineSum.total(*terms)


class HollowCircle(Hollow, Circle):
    """A circular tube."""

    ordered = (("wall", "radius", 1.0),)
    shape: Literal["hollow_circle"]

    def area(self) -> AffineSum:
        outer, inner = self._radii()
        return math.pi * (outer**2 - inner**2)

    def inertia(self) -> tuple[AffineSum, AffineSum]:
        outer, inner = self._radii()
        return (math.pi / 4 * (outer**4 - inner**4),) * 2

    def sheared(self, nu: float, nominal: Mapping[str, float], spans: Spans) -> tuple[AffineSum, AffineSum]:
        def sheared(r: np.ndarray, t: np.ndarray) -> np.ndarray:
            m = (r - t) / r
            share = 6 * (1 + nu) * (1 + m**2) ** 2 / ((7 + 6 * nu) * (1 + m**2) ** 2 + (20 + 12 * nu) * m**2)
            return share * math.pi * r**2 * (1 - m**2)

        return (self.fitted(sheared, nominal, spans),) * 2

    def _radii(self) -> tuple[AffineSum, AffineSum]:
        """Return the radius of the tube and of its hole."""
        return AffineSum.of(self.radius), AffineSum.of(self.radius) - AffineSum.of(self.wall)


class HollowRectangle(Hollow, Rectangle):
    """A rectangular tube with walls of one thickness."""

    ordered = (("wall", "height", 0.5), ("wall", "width", 0.5))
    shape: Literal["hollow_rectangle"]

    def area(self) -> AffineSum:
        (b, h), (b_i, h_i) = self._rectangles()
        return b * h - b_i * h_i

    def inertia(self) -> tuple[AffineSum, AffineSum]:
        (b, h), (b_i, h_i) = self._rectangles()
        return (h * b**3 - h_i * b_i**3) * (1 / 12), (b * h**3 - b_i * h_i**3) * (1 / 12)

    def sheared(self, nu: float, nominal: Mapping[str, float], spans: Spans) -> tuple[AffineSum, AffineSum]:
        def sheared(h: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
            m = (b - t) / (h - t)
            below = 12 + 72 * m + 150 * m**2 + 90 * m**3 + nu * (11 + 66 * m + 135 * m**2 + 90 * m**3)
            shares = 10 * (1 + nu) * (1 + 3 * m) ** 2 / (below + 10 * m**3 * (3 + nu + 3 * m))
            return shares * 2 * t * (b + h - 2 * t)

        def across(h: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
            return sheared(b, h, t)

        return self.fitted(sheared, nominal, spans), self.fitted(across, nominal, spans)

    def torsion(self, nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        def constant(h: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
            b, h = b - 2 * t, h - 2 * t
            enclosed = b * h + t * (b + h) + 0.58 * t**2
            return 4 * enclosed**2 / (2 * (b + h) / t + 2.236) + 2 / 3 * t**3 * (b + h) + 1.623 * t**4

        return self.fitted(constant, nominal, spans)

    def _rectangles(self) -> Iterator[tuple[AffineSum, AffineSum]]:
        """Yield the width and the height of the tube and of its hole."""
        width, height, wall = map(AffineSum.of, (self.width, self.height, self.wall))
        yield width, height
        yield width - 2.0 * wall, height - 2.0 * wall


def _levels(low: float, high: float, nominal: float) -> np.ndarray:
    """Return values over the nominal one that a fit is made of."""
    low, high = (low, high) if low < high else (nominal / BESIDE, nominal * BESIDE)
    return np.linspace(low, high, LEVELS) / nominal
