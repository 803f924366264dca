"""What is made of stresses, or of the forces and moments in a beam's section: one number at every point.

Stresses are those of Hooke's law for the strains (St. Venant and Kirchhoff's with Green and Lagrange's), of the
material's elasticity alone: what damps is no part of them. In plane stress the principal stresses are the two in the
plane; von Mises' stress is that of the whole tensor, whose components across the plane vanish.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.elasticity import Lame

Points = np.ndarray  # what is known at points, shape (n_points, n_components, n)


def hooke(strains: Points, lame: Lame) -> Points:
    """Return stresses over Young's modulus, components as those of the strains (`solid_strains`)."""
    d = 2 if strains.shape[1] == 3 else 3
    found = 2.0 * lame.shear * strains
    found[:, :d] += lame.first * strains[:, :d].sum(axis=1, keepdims=True)
    return found


def von_mises(stresses: Points) -> np.ndarray:
    """Return von Mises' stress, shape (n_points, n)."""
    if stresses.shape[1] == 3:
        xx, yy, xy = np.moveaxis(stresses, 1, 0)
        return np.sqrt(np.maximum(xx**2 + yy**2 - xx * yy + 3.0 * xy**2, 0.0))
    xx, yy, zz, *shear = np.moveaxis(stresses, 1, 0)
    across = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.sqrt(0.5 * across + 3.0 * sum(part**2 for part in shear))


def principal(stresses: Points, largest: bool) -> np.ndarray:
    """Return the largest or the smallest principal stress, tension positive, shape (n_points, n).

    In space the three are ``p + 2 q cos(phi + 2 pi k / 3)`` with the mean p, ``6 q^2 = |S|^2`` of the deviator S and
    ``cos(3 phi) = det(S) / (2 q^3)`` (Smith 1961): of all points at once, to round-off of the largest stress but where
    two are equal to its root.
    """
    if stresses.shape[1] == 3:
        xx, yy, xy = np.moveaxis(stresses, 1, 0)
        reach = np.hypot(0.5 * (xx - yy), xy)
        return 0.5 * (xx + yy) + (reach if largest else -reach)
    xx, yy, zz, xy, xz, yz = np.moveaxis(stresses, 1, 0)
    mean = (xx + yy + zz) / 3.0
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    q = np.sqrt((xx**2 + yy**2 + zz**2 + 2.0 * (xy**2 + xz**2 + yz**2)) / 6.0)
    unit = np.where(q > 0.0, q, 1.0)  # of a pressure alone any direction is principal
    xx, yy, zz, xy, xz, yz = (part / unit for part in (xx, yy, zz, xy, xz, yz))
    det = xx * (yy * zz - yz**2) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    phi = np.arccos(np.clip(0.5 * det, -1.0, 1.0)) / 3.0
    return mean + 2.0 * q * np.cos(phi + (0.0 if largest else 2.0 * np.pi / 3.0))


def outermost(axial: np.ndarray, bending: np.ndarray, largest: bool) -> np.ndarray:
    """Return the normal stress in the fibre that is stretched most or least, for that of the axial force and the
    largest one of bending, of one shape."""
    return axial + bending if largest else axial - bending


@dataclass(frozen=True)
class Extreme:
    """Which of several values an output reports.

    Attributes
    ----------
    of
        From values (n_points, n) to the place of the one that is reported, shape (n,).
    """

    of: Callable[[np.ndarray], np.ndarray]

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return the value reported, shape (n,); no number where one of them is none."""
        known = np.isfinite(values)
        place = self.of(np.where(known, values, 0.0))
        found = np.take_along_axis(values, place[None], axis=0)[0]
        return np.where(known.all(axis=0), found, np.nan)


LARGEST = Extreme(lambda values: np.argmax(values, axis=0))
SMALLEST = Extreme(lambda values: np.argmin(values, axis=0))
#: Of forces and moments: the one of largest magnitude, with its sign.
FURTHEST = Extreme(lambda values: np.argmax(np.abs(values), axis=0))
EXTREMES = {"von_mises": LARGEST, "principal_max": LARGEST, "stress_max": LARGEST} | dict.fromkeys(
    ("principal_min", "stress_min"), SMALLEST
)
