"""Coordinates of a condensed body with a scaled cross-section: those in which what a scale does to a motion is least.

With the scale s (`bodies.section_scale`) mass and stiffness of the displacements on the mesh are affine in its powers.
But a motion of the body is another one on the mesh for every s: the mean rotation of a section is 1/s of that on the
mesh, linear fields with a coordinate across the axis are s of those on the mesh, and so are the axial displacements of
bending, the turning ones of torsion, the lateral ones of stretching. What the axis does, the mean of a section, is the
same. So

    u = V T(s) y,    T(s) = T_0 + s T_1,

with V the body's frames and internal coordinates at s = 1, T_0 the part of a motion that is a function of the place
along the axis alone, T_1 the rest: a mode shape y of one section then is nearly one of the others. Exactly constant are
the frames and the linear displacement fields C, those across the axis being s C_1 on the mesh: ``T(s) C = C - C_1 + s
C_1``. ``T^T M T`` and ``T^T K T`` are affine again, with two powers more, and everything else is as without a scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import eigh

from pgmp_petsc.bodies.affine import Monomial, Quantity

DEGREE = 24  # of polynomials along the axis, for modes with up to half as many waves
DEPENDENT = 1e-10  # of the largest square: a coarse mesh does not tell all of them apart


def axial_fields(places: np.ndarray, lowest: float, highest: float) -> np.ndarray:
    """Return displacement fields that are polynomials of x alone, shape (n d, d (DEGREE + 1)), at places (n, d) with x
    between."""
    n, d = places.shape
    along = legvander((2.0 * places[:, 0] - lowest - highest) / (highest - lowest), DEGREE)
    return np.einsum("nk,ij->nikj", along, np.eye(d)).reshape(n * d, -1)


def axial_part(momenta: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Return what takes vectors of an orthonormal basis V to their part along the axis, shape (n, n).

    Parameters
    ----------
    momenta
        ``V^T M F`` of the fields F, shape (n, n_fields).
    squares
        ``F^T M F``.
    """
    values, directions = eigh(squares)
    chosen = values > DEPENDENT * values[-1]
    unit = momenta @ (directions[:, chosen] / np.sqrt(values[chosen]))
    return unit @ unit.T


@dataclass(frozen=True, eq=False)
class SectionCoordinates:
    """The change of coordinates.

    Attributes
    ----------
    factor
        s.
    constant, linear
        T_0 and T_1, shape (n, n).
    """

    factor: Quantity
    constant: np.ndarray
    linear: np.ndarray

    @classmethod
    def of(
        cls, factor: Quantity, n_frames: int, across: np.ndarray, mass: np.ndarray, fields: np.ndarray
    ) -> SectionCoordinates:
        """Find T.

        Parameters
        ----------
        factor
            s.
        n_frames
            Number of frames, whose unknowns come first.
        across
            The rest of a motion beside its part along the axis, shape (n, n); need not be exact.
        mass
            In the coordinates at s = 1 for any parameter values, shape (n, n).
        fields
            C, shape (n, d (d + 1)), as `Component.fields`.
        """
        d = {6: 2, 12: 3}[fields.shape[1]]
        turning = np.tile(np.arange(3 * (d - 1)) >= d, n_frames)
        scaling = np.concatenate([np.zeros(d, dtype=bool), np.tile(np.arange(d) > 0, d)])
        linear = across.copy()
        linear[: turning.size] = 0.0
        linear[np.flatnonzero(turning), np.flatnonzero(turning)] = 1.0
        # the least correction, in the mass, that makes the fields exact
        unit = fields / np.sqrt(np.einsum("if,ij,jf->f", fields, mass, fields))
        weighted = unit.T @ mass
        missing = np.where(scaling, unit, 0.0) - linear @ unit
        missing[: turning.size] = 0.0  # frames are
        linear += missing @ np.linalg.solve(weighted @ unit, weighted)
        return cls(factor, np.eye(len(mass)) - linear, linear)

    def apply(self, terms: Mapping[Monomial, np.ndarray]) -> dict[Monomial, np.ndarray]:
        """Return ``T^T A T`` by weight, for terms A by weight: symmetric, or (d, d, n, n) that are as a whole."""
        found: dict[Monomial, np.ndarray] = {}
        for weight, matrix in terms.items():
            mixed = self.constant.T @ matrix @ self.linear
            parts = (
                self.constant.T @ matrix @ self.constant,
                mixed + (mixed.T if mixed.ndim == 2 else mixed.transpose(1, 0, 3, 2)),
                self.linear.T @ matrix @ self.linear,
            )
            for power, part in enumerate(parts):
                scale = self.factor**power
                place = weight * scale.monomial
                found[place] = found.get(place, 0.0) + scale.coefficient * part
        return found

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray]:
        """T_0 and T_1, of the powers 0 and 1 of s."""
        return self.constant, self.linear

    def at(self, values: Mapping[str, float]) -> np.ndarray:
        """Return T."""
        return self.constant + self.factor.at(values) * self.linear
