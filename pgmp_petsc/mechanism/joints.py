"""Constraints of joints: statements about two frames that are to be zero, and the connections that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.statements import (
    MEET,
    Combination,
    Statement,
    along,
    angle,
    meet,
    perpendicular,
    within,
)


def meeting(dimension: int) -> list[Statement]:
    """Return that two points share their position."""
    return [meet(axis) for axis in np.eye(dimension)]


def guided(in_a: np.ndarray) -> list[Statement]:
    """Return that a point is on the line along the first axis of a triad (d, d) in a, one axis a column."""
    return [along(axis) for axis in in_a.T[1:]]


def aligned(in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
    """Return that the first axes of triads (3, 3) in a and in b have one direction."""
    return [perpendicular(in_a[:, k], in_b[:, 0]) for k in (1, 2)]


def parallel(in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
    """Return that triads (d, d) in a and in b have the same directions."""
    if len(in_a) == 2:
        return [perpendicular(in_a[:, 0], in_b[:, 1])]
    return [*aligned(in_a, in_b), perpendicular(in_a[:, 1], in_b[:, 2])]


def weld(in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
    """Return that two points share their position, and triads (d, d) in a and in b their directions."""
    return [*meeting(len(in_a)), *parallel(in_a, in_b)]


def share_position(statements: Sequence[Statement]) -> bool:
    """Return whether the points of two frames meet where such statements are zero."""
    return sum(part.kind == MEET for part in statements) == statements[0].axes.shape[1]


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
class Release:
    """A direction that a joint holds in the configuration, and releases in the motion."""

    statement: Statement  # what is measured along or about it
    key: str  # the entry of its stiffness, ``stiffness`` or ``turning_stiffness``
    axis: int  # the number of its axis
    rest: float = 0.0  # the statement in the configuration, rad; along axes and of cosines it is zero


@dataclass(frozen=True, eq=False)
class Connection:
    """A named joint between two attachments, and the rows of its constraints."""

    name: str
    #: what is zero in the configuration; joints whose points share their position begin with that
    statements: tuple[Statement, ...]
    a: Attachment
    b: Attachment
    rows: slice  # of these, among those of all joints
    #: the axes that it turns about and slides along, the first of triads in the frames of a and of b, shape (d, d)
    #: each, one axis a column
    axes: tuple[np.ndarray, np.ndarray]
    held: tuple[Statement, ...]  # what is zero in the motion
    released: tuple[Release, ...]  # directions that are held in the configuration alone
    moved: Attachment  # a in the motion: where the joint is, if it is off

    @property
    def sides(self) -> tuple[Attachment, Attachment]:
        """Both attachments."""
        return self.a, self.b

    @property
    def sides_held(self) -> tuple[Attachment, Attachment]:
        """Both attachments in the motion, which `held` is about."""
        return self.moved, self.b

    @property
    def holds_position(self) -> bool:
        """Whether the two points share their position."""
        return share_position(self.statements)

    def holding(self, moving: bool = False) -> list[tuple[Statement, tuple[Attachment, Attachment]]]:
        """Return what is zero in the configuration, or in the motion too, with its sides."""
        if moving:
            return [(part, self.sides_held) for part in self.held]
        return [(part, self.sides) for part in self.statements]

    @property
    def straight(self) -> Connection:
        """The joint where it should be, if it is off."""
        return self if self.moved is self.a else replace(self, held=self.statements, moved=self.a)

    def measure(self, motion: str) -> Statement:
        """Return what measures ``turning`` or ``sliding``."""
        return {"turning": self.angle, "sliding": along(self.axes[0][:, 0])}[motion]

    @cached_property
    def angle(self) -> Statement:
        """How far b is turned against a about the joint's axis; in the plane from where both bodies are parallel, in
        space from where they are assembled."""
        return angle(*self.axes)


@dataclass(frozen=True, eq=False)
class Coupling:
    """A named joint that couples the motions of others: a combination of what measures these, which is to be zero."""

    name: str
    combination: Combination
    sides: tuple[Attachment, ...]  # of the statements, a pair for each
    value: float  # that the combination keeps
    rows: slice

    def holding(self, moving: bool = False) -> list[tuple[Combination, tuple[Attachment, ...]]]:
        """Return what has its value, in the motion too, with its sides."""
        return [(self.combination, self.sides)]
