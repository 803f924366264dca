"""Joints: lists of statements about two frames that are to be zero.

A joint between two attachments.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.statements import MEET, Statement, along, angle, meet, perpendicular, within

#: Joints whose two points share their position.
MEETING = ("revolute", "fixed", "spherical", "universal")


@dataclass(frozen=True, eq=False)
class Joint:
    """Constraints of a pair of frames.

    Attributes
    ----------
    kind
        Type in the scene.
    statements
        What is to be zero, points that meet first.
    """

    kind: str
    statements: tuple[Statement, ...]

    @property
    def n_constraints(self) -> int:
        """Number of constraints."""
        return len(self.statements)

    @property
    def holds_position(self) -> bool:
        """Whether the two points share their position."""
        return self.statements[0].kind == MEET


def joint(kind: str, in_a: np.ndarray, in_b: np.ndarray) -> Joint:
    """Make a joint.

    Parameters
    ----------
    kind
        ``revolute``, ``fixed``, ``point_on_line``, and in space ``spherical``, ``universal``, ``cylindrical``,
        ``prismatic`` or ``point_on_plane``.
    in_a, in_b
        The joint's axes u, v, w, an orthonormal triad, in the frame of a, and the same directions, as assembled, in
        the frame of b, shape (3, 3) each, one axis a column; u, v and (2, 2) in the plane. The first one is that of
        the rotation in space, of the line, or the plane's normal; a universal joint has its first axis u in a and its
        second axis v in b.
    """
    d = len(in_a)
    a, b = in_a.T, in_b.T
    meeting, guided = [meet(axis) for axis in np.eye(d)], [along(axis) for axis in a[1:]]
    if d == 2:
        parts = {"revolute": meeting, "fixed": [*meeting, perpendicular(a[0], b[1])], "point_on_line": guided}
    else:
        aligned = [perpendicular(a[k], b[0]) for k in (1, 2)]
        parts = {
            "spherical": meeting,
            "revolute": [*meeting, *aligned],
            "universal": [*meeting, perpendicular(a[0], b[1])],
            "cylindrical": [*guided, *aligned],
            "prismatic": [*guided, *aligned, perpendicular(a[1], b[2])],
            "fixed": [*meeting, *aligned, perpendicular(a[1], b[2])],
            "point_on_line": guided,
            "point_on_plane": [along(a[0])],
        }
    return Joint(kind, tuple(parts[kind]))


def orthonormality() -> tuple[list[Statement], np.ndarray]:
    """Return the statements about frame b that make three directors a rotation, and their values, shape (6,)."""
    pairs = [(i, j) for i in range(3) for j in range(i + 1)]
    axes = np.eye(3)
    return [within(axes[i], axes[j]) for i, j in pairs], np.array([float(i == j) for i, j in pairs])


def triad(axis: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
    """Return orthonormal axes (d, d), one a column: the first along an axis, in space the second nearest to another
    direction."""
    first = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    if first.size == 2:
        return np.array([[first[0], -first[1]], [first[1], first[0]]])
    if second is None:
        second = np.eye(3)[np.argmin(np.abs(first))]
    second = second - first * (first @ second)
    second = second / np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)])


@dataclass(frozen=True, eq=False)
class Connection:
    """A named joint between two attachments, and the rows of its constraints.

    Attributes
    ----------
    axes
        The joint's axes in the frames of a and of b, shape (d, d) each, one axis a column; see `joints.joint`.
    """

    name: str
    joint: Joint
    a: Attachment
    b: Attachment
    rows: slice
    axes: tuple[np.ndarray, np.ndarray]

    @property
    def sides(self) -> tuple[Attachment, Attachment]:
        """Both attachments."""
        return self.a, self.b

    @cached_property
    def angle(self) -> Statement:
        """How far b is turned against a about the joint's axis; in the plane from where both bodies are parallel, in
        space from where they are assembled."""
        return angle(*self.axes)
