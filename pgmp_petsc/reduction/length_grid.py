"""Chebyshev points of lengths, and polynomials through what is known there.

A quantity f of lengths l_1, l_2, ... is known at the points of a tensor grid, n along each, and is

    f(l) = sum_p L_p(l) f_p = sum_k c_k prod_i x_i^k_i,    x_i = (l_i - middle_i) / half_i,

between them: a polynomial of degree n - 1 in each. With the first form one value is contracted; the second is affine in
monomials of places (`bodies.affine.Place`), so that tables of many samples are too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from pgmp_petsc.bodies.affine import Monomial, Place
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.lengths import length_names, length_range


@dataclass(frozen=True)
class LengthGrid:
    """A tensor grid of Chebyshev points (of the first kind)."""

    names: tuple[str, ...]  # parameters that are lengths or places, sorted
    ranges: tuple[tuple[float, float], ...]  # smallest and largest value of each, m
    n_points: int  # along each

    @classmethod
    def of(cls, scene: Scene) -> LengthGrid:
        """Return the grid of a scene's lengths."""
        names = length_names(scene)
        return cls(names, tuple(length_range(scene, name) for name in names), scene.reduction.length_points)

    @property
    def nodes(self) -> np.ndarray:
        """Places of the points, -1 to 1, shape (n_points,), increasing."""
        return -np.cos(np.pi * (np.arange(self.n_points) + 0.5) / self.n_points)

    @property
    def places(self) -> tuple[Place, ...]:
        """Where each length is in its range."""
        ends = zip(self.names, self.ranges)
        return tuple(Place(name, 0.5 * (low + high), 0.5 * (high - low)) for name, (low, high) in ends)

    @property
    def points(self) -> list[dict[str, float]]:
        """Values of the lengths at every point, the last one fastest."""
        return [self.values_at(nodes) for nodes in product(self.nodes, repeat=len(self.names))]

    def values_at(self, places: Sequence[float]) -> dict[str, float]:
        """Return the lengths (m) at places from -1 to 1."""
        return {own.name: float(own.middle + own.half * x) for own, x in zip(self.places, places)}

    def shares(self, values: Mapping[str, np.ndarray | float], by: str = "") -> np.ndarray:
        """Return L_p at values (numbers, or of shape (n,)), shape (n_p,) or (n_p, n); their sum is 1.

        With the name of a parameter their derivatives by it, whose sum is 0.
        """
        shape = np.shape(values[self.names[0]])
        found = np.ones((1, *shape)) if not by or by in self.names else np.zeros((1, *shape))
        for place in self.places:
            at, exponents = place.at(values), range(self.n_points)
            powers = np.array([at**k for k in exponents])
            if place.name == by:
                powers = np.array([k * at ** max(k - 1, 0) for k in exponents]) / place.half
            own = np.tensordot(self._inverse.T, powers, 1)
            found = (found[:, None] * own).reshape(-1, *found.shape[1:])
        return found

    def height(self, values: Mapping[str, float]) -> float:
        """Return the least |T_n| of the places of values: 0 at points of the grid, 1 farthest from these."""
        angles = [np.arccos(np.clip(place.at(values), -1.0, 1.0)) for place in self.places]
        return float(min(abs(np.cos(self.n_points * angle)) for angle in angles))

    def weights(self, own: Sequence[Monomial]) -> tuple[Monomial, ...]:
        """Return the weights of `coefficients` of terms with weights of their own, (term, monomial) in this order."""
        powers = product(range(self.n_points), repeat=len(self.names))
        monomials = [
            Monomial((), tuple(sorted((place, k) for place, k in zip(self.places, exponents) if k)))
            for exponents in powers
        ]
        return tuple(weight * monomial for weight in own for monomial in monomials)

    def coefficients(self, tables: Sequence[np.ndarray]) -> np.ndarray:
        """Return c_k of tables (n, n_terms, ...) at every point, shape (n, n_terms * n_p, ...); see `weights`."""
        inverse = np.ones((1, 1))
        for _ in self.names:
            inverse = np.kron(inverse, self._inverse)
        found = np.moveaxis(np.tensordot(inverse, np.stack(tables), 1), 0, 2)
        return np.ascontiguousarray(found).reshape(found.shape[0], -1, *found.shape[3:])

    @property
    def _inverse(self) -> np.ndarray:
        """From values at the points to coefficients of powers, shape (n_points, n_points)."""
        return np.linalg.inv(np.vander(self.nodes, increasing=True))
