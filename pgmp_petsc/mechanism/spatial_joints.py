"""Joints in space as quadratic constraints of two frames.

Every joint is a list of statements (`statements`) that are zero: points that meet, directions at right angles, a place
along a direction. All of them are polynomials of second degree in the frames' twelve numbers, ``c = g + G z + 1/2 z^T Q
z`` with ``z = (a, b)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.statements import MEET, Statement, along, meet, perpendicular

N_FRAME = SPATIAL.n_pose
N_PAIR = 2 * N_FRAME


@dataclass(frozen=True, eq=False)
class SpatialJoint:
    """Constraints of a pair of frames.

    Attributes
    ----------
    kind
        Type in the scene.
    constant, slope, curvature
        g, G and Q, shapes (n_constraints,), (n_constraints, 24) and (n_constraints, 24, 24).
    lengths
        Which constraints are lengths (m); the others are cosines, shape (n_constraints,).
    holds_position
        Whether the two points share their position.
    """

    kind: str
    constant: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray
    lengths: np.ndarray
    holds_position: bool

    linear = False

    @property
    def n_constraints(self) -> int:
        """Number of constraints."""
        return self.constant.size

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return c, shape (n_constraints, ...), for frames of shape (12, ...)."""
        z = np.concatenate([a, b])
        half = 0.5 * np.einsum("ci...,i...->c...", np.tensordot(self.curvature, z, axes=1), z)
        return self.constant.reshape(-1, *(1,) * (z.ndim - 1)) + np.tensordot(self.slope, z, axes=1) + half

    def jacobian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return dc/d(a, b), shape (n_constraints, 24, ...)."""
        z = np.concatenate([a, b])
        return self.slope.reshape(*self.slope.shape, *(1,) * (z.ndim - 1)) + np.tensordot(self.curvature, z, axes=1)

    def hessian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the second derivatives, shape (n_constraints, 24, 24, ...)."""
        trailing = a.shape[1:]
        return np.broadcast_to(self.curvature.reshape(*self.curvature.shape, *(1,) * len(trailing)), (
            *self.curvature.shape, *trailing,
        ))  # fmt: skip


def spatial_joint(kind: str, axes: tuple[np.ndarray, ...]) -> SpatialJoint:
    """Make a joint.

    Parameters
    ----------
    kind
        ``spherical``, ``revolute``, ``universal``, ``cylindrical``, ``prismatic``, ``fixed``, ``point_on_line`` or
        ``point_on_plane``.
    axes
        The joint's axes u, v, w, an orthonormal triad, in the frame of a and the same directions, as assembled, in the
        frame of b: two matrices (3, 3), one axis a column. The first one is that of the rotation, of the line, or the
        plane's normal; a universal joint has its first axis u in a and its second axis v in b.
    """
    in_a, in_b = (matrix.T for matrix in axes)
    normals, meeting = (1, 2), [meet(axis) for axis in np.eye(3)]
    aligned = [perpendicular(in_a[k], in_b[0]) for k in normals]
    guided = [along(in_a[k]) for k in normals]
    parts = {
        "spherical": meeting,
        "revolute": [*meeting, *aligned],
        "universal": [*meeting, perpendicular(in_a[0], in_b[1])],
        "cylindrical": [*guided, *aligned],
        "prismatic": [*guided, *aligned, perpendicular(in_a[1], in_b[2])],
        "fixed": [*meeting, *aligned, perpendicular(in_a[1], in_b[2])],
        "point_on_line": guided,
        "point_on_plane": [along(in_a[0])],
    }[kind]
    return _joint(kind, parts)


def orthonormality() -> SpatialJoint:
    """Return what makes three directors a rotation: their lengths and angles, of frame b; frame a has no part in it."""
    pairs = [(i, j) for i in range(3) for j in range(i + 1)]
    curvature = np.zeros((len(pairs), N_PAIR, N_PAIR))
    for row, (i, j) in enumerate(pairs):
        for c in range(3):
            _add(curvature[row], N_FRAME + 3 + 3 * i + c, N_FRAME + 3 + 3 * j + c, 1.0)
    constant = np.array([-1.0 if i == j else 0.0 for i, j in pairs])
    return SpatialJoint(
        "rigid", constant, np.zeros((6, N_PAIR)), curvature, np.zeros(6, dtype=bool), holds_position=False
    )


def _add(curvature: np.ndarray, i: int, j: int, factor: float) -> None:
    """Add ``factor z_i z_j`` to a quadratic form (24, 24)."""
    curvature[i, j] += factor
    curvature[j, i] += factor


def _joint(kind: str, parts: Sequence[Statement]) -> SpatialJoint:
    nowhere = np.zeros(N_FRAME)
    slope, curvature = (
        np.array([derivative(part, nowhere, nowhere) for part in parts])
        for derivative in (Statement.gradient, Statement.hessian)
    )
    lengths = np.array([part.is_length for part in parts])
    return SpatialJoint(kind, np.zeros(len(parts)), slope, curvature, lengths, parts[0].kind == MEET)


def triad(axis: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
    """Return an orthonormal triad whose first column is along an axis and whose second is nearest to another
    direction."""
    first = axis / np.linalg.norm(axis)
    if second is None:
        second = np.eye(3)[np.argmin(np.abs(first))]
    second = second - first * (first @ second)
    second = second / np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)])
