"""Quantities that vary over a body: factors of its cells' matrices, affine in parameters.

A constant of a uniform body, such as E A, has in cell e the factor

    1 + sum_k w_k(p) f_k(e)

with weights w_k of the parameters and numbers f_k(e). Matrices are linear in the constants, so every further weight is
one more affine term (Naets et al. 2015, eq. (2)): that of the uniform body with cell e times f_k(e).

A `SectionScale` scales the cross-section of a slender body about the x axis of its mesh: s takes the place X of the
mesh to ``D X``, ``D = diag(1, s, s)`` (in the plane ``diag(1, s)`` with s times the thickness). Derivatives across the
axis are then 1/s of those on the mesh and volumes s^2, so that

    M = s^2 M_2,    K = s^2 K_2 + s K_1 + K_0,

where K_2, K_1 and K_0 hold the products of strains with none, one and two derivatives across the axis: exact terms of
the mapped energy, not a Taylor series.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pgmp_petsc.bodies.affine import Monomial, Quantity, Values


@dataclass(frozen=True, eq=False)
class Profile:
    """A factor over the cells of a body."""

    #: f_k by weight, each of shape (n_cells,), beside the 1; none of a uniform body
    terms: Mapping[Monomial, np.ndarray] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.terms)

    def __mul__(self, other: Profile) -> Profile:
        product = dict(self.terms)
        for weight, values in other.terms.items():
            product[weight] = product.get(weight, 0.0) + values
            for own, factors in self.terms.items():
                product[own * weight] = product.get(own * weight, 0.0) + factors * values
        return Profile(product)

    def over(self, terms: Mapping[Monomial, np.ndarray], cells: np.ndarray | slice) -> dict[Monomial, np.ndarray]:
        """Return affine terms of a uniform body, by weight, each with one row a cell of these numbers, shape (n, ...),
        with the factor."""
        found = dict(terms)
        for factor, along in self.terms.items():
            chosen = along[cells]
            for weight, values in terms.items():
                part = chosen.reshape(-1, *[1] * (values.ndim - 1)) * values
                found[weight * factor] = found.get(weight * factor, 0.0) + part
        return found

    def weights(self, own: set[Monomial]) -> set[Monomial]:
        """Return the weights that `over` makes of some."""
        return own | {weight * factor for weight in own for factor in self.terms}

    def at(self, values: Values, of_cells: Callable[[np.ndarray], np.ndarray]) -> np.ndarray | float:
        """Return the factor at points, shape (n_points, 1 or n), for parameter values, numbers or of shape (n,); of a
        uniform body 1.0.

        `of_cells` makes values at the points (n_points,) of those in all cells (n_cells,), and keeps ones.
        """
        total: np.ndarray | float = 1.0
        for weight, along in self.terms.items():
            total = total + np.multiply.outer(of_cells(along), np.atleast_1d(weight.evaluate(values)))
        return total


@dataclass(frozen=True, eq=False)
class Profiles:
    """The factors of a body."""

    #: modulus, density: of Young's modulus and of the density
    modulus: Profile = Profile()
    density: Profile = Profile()
    size: Profile = Profile()  # of a size of its cross-section that stiffness and mass are proportional to

    def __bool__(self) -> bool:
        return bool(self.modulus or self.density or self.size)

    @property
    def stiffness(self) -> Profile:
        """Factor of the stiffness."""
        return self.modulus * self.size

    @property
    def mass(self) -> Profile:
        """Factor of the mass."""
        return self.density * self.size

    def of(self, kind: str) -> Profile:
        """Return the factor of ``"mass"`` or ``"stiffness"``."""
        return self.mass if kind == "mass" else self.stiffness


UNIFORM = Profiles()


@dataclass(frozen=True)
class SectionScale:
    """A scale s of cross-sections."""

    factor: Quantity  # s, of which the mesh has 1
    #: of the condensed body's terms, whose coordinates scale too (`components.component_modes`)
    powers: ClassVar[Mapping[str, range]] = {"mass": range(2, 5), "stiffness": range(5)}

    def pairs(self, dimension: int) -> Iterator[tuple[Quantity, np.ndarray]]:
        """Yield each power of s in the stiffness, and which pairs of derivatives it belongs to, shape (d, d)."""
        across = np.arange(dimension) > 0
        count = across[:, None].astype(int) + across
        for n_across in range(3):
            yield self.factor ** (2 - n_across), count == n_across

    @property
    def area(self) -> Quantity:
        """Area over that of the mesh: the factor of the mass."""
        return self.factor**2

    def stretch(self, dimension: int, values: Mapping[str, float]) -> np.ndarray:
        """Return the diagonal of D, shape (d,)."""
        stretch = np.ones(dimension)
        stretch[1:] = self.factor.at(values)
        return stretch
