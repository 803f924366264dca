"""Joints in space as quadratic constraints of two frames.

With a frame's position p and a direction ``w = sum_k w_k d_k`` that is fixed in it, every joint is made of three
statements

    p_b - p_a = 0,        u_a . w_b = 0,        u_a . (p_b - p_a) = 0,

all of them polynomials of second degree in the frames' twelve numbers, ``c = g + G z + 1/2 z^T Q z`` with ``z = (a,
b)``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.mechanism.space import SPATIAL

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
    normals, meeting = (1, 2), [_Meet(k) for k in range(3)]
    aligned = [_Perpendicular(in_a[k], in_b[0]) for k in normals]
    guided = [_Along(in_a[k]) for k in normals]
    parts = {
        "spherical": meeting,
        "revolute": [*meeting, *aligned],
        "universal": [*meeting, _Perpendicular(in_a[0], in_b[1])],
        "cylindrical": [*guided, *aligned],
        "prismatic": [*guided, *aligned, _Perpendicular(in_a[1], in_b[2])],
        "fixed": [*meeting, *aligned, _Perpendicular(in_a[1], in_b[2])],
        "point_on_line": guided,
        "point_on_plane": [_Along(in_a[0])],
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


@dataclass(frozen=True)
class _Meet:
    """``(p_b - p_a)_k = 0``."""

    component: int
    length = True

    def fill(self, slope: np.ndarray, curvature: np.ndarray) -> None:
        slope[self.component], slope[N_FRAME + self.component] = -1.0, 1.0


@dataclass(frozen=True, eq=False)
class _Perpendicular:
    """``u_a . w_b = 0`` for directions u in a and w in b."""

    u: np.ndarray
    w: np.ndarray
    length = False

    def fill(self, slope: np.ndarray, curvature: np.ndarray) -> None:
        for i, j, c in np.ndindex(3, 3, 3):
            _add(curvature, 3 + 3 * i + c, N_FRAME + 3 + 3 * j + c, self.u[i] * self.w[j])


@dataclass(frozen=True, eq=False)
class _Along:
    """``u_a . (p_b - p_a) = 0`` for a direction u in a."""

    u: np.ndarray
    length = True

    def fill(self, slope: np.ndarray, curvature: np.ndarray) -> None:
        for i, c in np.ndindex(3, 3):
            _add(curvature, 3 + 3 * i + c, N_FRAME + c, self.u[i])
            _add(curvature, 3 + 3 * i + c, c, -self.u[i])


def _add(curvature: np.ndarray, i: int, j: int, factor: float) -> None:
    """Add ``factor z_i z_j`` to a quadratic form (24, 24)."""
    curvature[i, j] += factor
    curvature[j, i] += factor


def _joint(kind: str, parts: Iterable[_Meet | _Perpendicular | _Along]) -> SpatialJoint:
    parts = list(parts)
    slope, curvature = np.zeros((len(parts), N_PAIR)), np.zeros((len(parts), N_PAIR, N_PAIR))
    for row, part in enumerate(parts):
        part.fill(slope[row], curvature[row])
    lengths = np.array([part.length for part in parts])
    return SpatialJoint(kind, np.zeros(len(parts)), slope, curvature, lengths, isinstance(parts[0], _Meet))


def triad(axis: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
    """Return an orthonormal triad whose first column is along an axis and whose second is nearest to another
    direction."""
    first = axis / np.linalg.norm(axis)
    if second is None:
        second = np.eye(3)[np.argmin(np.abs(first))]
    second = second - first * (first @ second)
    second = second / np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)])
