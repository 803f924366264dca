"""Scalar statements about two frames, in the plane and in space: what joints, coordinates and effects are made of.

A frame is ``zeta = (p, d_1 .. d_d)``, a position and the directors of a body: 6 numbers in the plane, 12 in space. With
directions ``u_a = sum_k u_k d_k`` that are fixed in a frame, a statement s of two frames a and b is one of `KINDS`. Its
gradient and second derivatives in the 2 d (d + 1) numbers of both frames are printed from the expression
(`statement_kinds`), in compiled code and in C. Zero is what a joint demands; a law of s and s' (`effects.law`) is a
force on it. What couples several is a `Combination` of functions of them, each about two frames of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy

from pgmp_petsc.declare.expressions import kept
from pgmp_petsc.lanes.compiled import njit, text_mark
from pgmp_petsc.mechanism.statement_kinds import Kind, print_kinds

KINDS = (
    Kind("MEET", "dot(u, p_b - p_a)"),
    Kind("PERPENDICULAR", "dot(u_a, w_b)", unit="1"),
    Kind("WITHIN", "dot(v_b, w_b)", unit="1"),
    Kind("ALONG", "dot(u_a, p_b - p_a)"),
    Kind("ANGLE", "atan2(dot(v_a, w_b), dot(u_a, w_b))", unit="rad", periodic=True, fixed=True),
    Kind("DISTANCE", "sqrt(dot(p_b - p_a, p_b - p_a))", singular=True),
    Kind("FOLLOWING", pull="w_b", fixed=True),
    Kind("FADING", "fade(dot(u_a, p_b - p_a)) * dot(v_a, p_b - p_a)", limited=True, generic="FADING_EVERYWHERE"),
    Kind("BULGING", "bulge(dot(u_a, p_b - p_a)) * dot(v_a, w_b)", limited=True, generic="BULGING_EVERYWHERE"),
    Kind("FADING_EVERYWHERE", "dot(u_a, p_b - p_a) * dot(v_a, p_b - p_a)"),
    Kind("BULGING_EVERYWHERE", "dot(u_a, p_b - p_a) * dot(v_a, w_b)"),
    Kind("SWEEPING", "dot(u_a, p_b - p_a) * dot(v_a, p_b - p_a)", sweep=True),
)
NAMES = [kind.name for kind in KINDS]
MEET, PERPENDICULAR, WITHIN, ALONG, ANGLE, DISTANCE, FOLLOWING, FADING, BULGING, _, _, SWEEPING = range(len(KINDS))
U, V, W = range(3)  # rows of a statement's directions
_MARK = text_mark(
    *(f"pgmp_petsc.{name}" for name in ("mechanism.statement_kinds", "declare.forms", "declare.expressions"))
)
CODE = kept("statements", repr((_MARK, KINDS)), Path(__file__), lambda: print_kinds(KINDS))
evaluate = CODE.evaluate


@dataclass(frozen=True, eq=False)
class Function:
    """A function f of a statement s: a factor times s, or times a cubic spline of s that closes on itself.

    On piece k, from ``x = breaks[k]`` on, the spline is ``sum_j coefficients[k, j] (s - x)^j``, of s within the period
    that the breaks span; with a period of 0 it is one polynomial, of any s.
    """

    factor: float = 1.0
    breaks: np.ndarray = field(default_factory=lambda: np.zeros(0))  # shape (n + 1,), rad; none where it is linear
    coefficients: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))  # shape (n, 4)

    @classmethod
    def square(cls) -> Function:
        """Return the square of s."""
        return cls(1.0, np.zeros(2), np.array([[0.0, 0.0, 1.0, 0.0]]))

    @classmethod
    def through(cls, factor: float, table: Sequence[tuple[float, float]]) -> Function:
        """Return a factor times the spline through points, the last of which is the first one after a period."""
        x, y = np.array(table, dtype=float).T
        found = scipy.interpolate.CubicSpline(x, np.append(y[:-1], y[0]), bc_type="periodic")
        return cls(factor, x, np.ascontiguousarray(found.c[::-1].T))

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray | float]:
        """Return f and df/ds at values of s (n,)."""
        if not self.breaks.size:
            return self.factor * s, self.factor
        first, period = self.breaks[0], self.breaks[-1] - self.breaks[0]
        within = first + (s - first) % period if period else s
        piece = np.searchsorted(self.breaks[1:-1], within, side="right")
        c, x = self.factor * self.coefficients[piece].T, within - self.breaks[piece]
        return c[0] + x * (c[1] + x * (c[2] + x * c[3])), c[1] + x * (2.0 * c[2] + x * 3.0 * c[3])

    @property
    def generic(self) -> Function:
        """A function none of whose derivatives is zero where this one's may be other than zero."""
        bent = np.zeros_like(self.coefficients)
        bent[:, 1:3] = 1.0
        return Function(1.0, self.breaks, bent)


IDENTITY = Function()


@dataclass(frozen=True)
class Line:
    """A motion (rad or m) as a line over others: ``offset + sum_k slope_k s_k``."""

    offset: float
    slopes: Mapping[Statement, float]


@dataclass(frozen=True, eq=False)
class Combination:
    """``sum_i f_i(s_i)`` of statements, each about a pair of frames of its own, one pair after the other."""

    terms: tuple[tuple[Statement, Function], ...]
    #: what motions that follow from the coordinates are near to, as those behind a row of gears
    lines: Mapping[Statement, Line] = field(default_factory=dict)

    @property
    def is_length(self) -> bool:
        """Whether it is measured in m, as its first term is."""
        return self.terms[0][0].is_length

    @property
    def fixed_in_bodies(self) -> bool:
        """Whether its gradient keeps its direction in the frames of all its terms, however they stand."""
        return all(part.fixed_in_bodies and not function.breaks.size for part, function in self.terms)


@dataclass(frozen=True, eq=False)
class Statement:
    """A statement about two frames."""

    kind: int  # its number among `KINDS`
    #: the directions u, v and w, shape (3, d), in the frames that the kind says; zero where it has none
    axes: np.ndarray
    lines: ClassVar[Mapping[Statement, Line]] = {}  # as of a `Combination`

    @property
    def terms(self) -> tuple[tuple[Statement, Function], ...]:
        """Itself, as the only term of a `Combination`."""
        return ((self, IDENTITY),)

    @property
    def generic(self) -> Statement:
        """A statement none of whose derivatives is zero where this one's may be other than zero."""
        generic = KINDS[self.kind].generic
        return Statement(NAMES.index(generic), self.axes) if generic else self

    @property
    def is_length(self) -> bool:
        """Whether it is measured in m; others are cosines or rad."""
        return KINDS[self.kind].unit == "m"

    @property
    def fixed_in_bodies(self) -> bool:
        """Whether its gradient keeps its direction in the frames, however they stand."""
        return KINDS[self.kind].fixed

    def value(self, a: np.ndarray, b: np.ndarray, turned: np.ndarray | float = 0.0) -> np.ndarray:
        """Return s, shape (...), m, 1 or rad, for frames of shape (d (d + 1) or more, ...).

        An angle is nearest to `turned`, which broadcasts against s, rad.
        """
        return self._evaluated(a, b, 0, turned)[0]

    def gradient(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return ds/d(a, b), shape (2 d (d + 1), ...)."""
        return self._evaluated(a, b, 1)[1]

    def hessian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the derivative of the gradient, shape (2 d (d + 1), 2 d (d + 1), ...)."""
        return self._evaluated(a, b, 2)[2]

    def _evaluated(
        self, a: np.ndarray, b: np.ndarray, order: int, turned: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, ...]:
        """Return s and its derivatives up to `order`."""
        n, trailing = n_frame(self.axes.shape[1]), a.shape[1:]
        z = np.concatenate([a[:n].reshape(n, -1), b[:n].reshape(n, -1)]).astype(float, order="C")
        turned, m = np.full(trailing, turned, dtype=float).reshape(-1), z.shape[1]
        parts = np.empty(m), np.empty((2 * n, m * (order > 0))), np.empty((2 * n, 2 * n, m * (order > 1)))
        _evaluate_all(self.kind, self.axes, z, turned, *parts)
        return tuple(part.reshape((*part.shape[:-1], *trailing)) for part in parts[: order + 1])


def n_frame(dimension: int) -> int:
    """Return how many numbers a frame has in 2 or 3 dimensions."""
    return dimension * (dimension + 1)


def meet(axis: np.ndarray) -> Statement:
    """Return how far b is from a along an axis (d,) of the ground."""
    return _statement(MEET, u=axis)


def perpendicular(u: np.ndarray, w: np.ndarray) -> Statement:
    """Return the cosine between unit directions (d,) in a and in b."""
    return _statement(PERPENDICULAR, u=u, w=w)


def within(v: np.ndarray, w: np.ndarray) -> Statement:
    """Return the product of two directions (d,) in b."""
    return _statement(WITHIN, v=v, w=w)


def along(axis: np.ndarray) -> Statement:
    """Return how far b is from a along an axis (d,) that is fixed in a; its length does not matter."""
    return _statement(ALONG, u=np.asarray(axis, dtype=float) / np.linalg.norm(axis))


def fading(reach: np.ndarray, v: np.ndarray) -> Statement:
    """Return how far b is from a along a direction v (d,) in a, times a weight that falls from 1 to 0 as b moves from a
    to the end of a vector (d,) in a: Hermite's, ``1 - 3 x^2 + 2 x^3``."""
    return _statement(FADING, u=reach / (reach @ reach), v=v)


def bulging(reach: np.ndarray, v: np.ndarray, w: np.ndarray) -> Statement:
    """Return the cosine between unit directions (d,) in a and in b, times ``2 x^2 (1 - x)^2``, x as in `fading`."""
    return _statement(BULGING, u=reach / (reach @ reach), v=v, w=w)


def angle(in_a: np.ndarray, in_b: np.ndarray) -> Statement:
    """Return how far b is turned against a about the first axis of triads (3, 3), one axis a column.

    In the plane the triads are the axes x and y, (2, 2).
    """
    second, third = in_a[:, -2], in_a[:, -1]
    return _statement(ANGLE, u=second, v=third, w=in_b[:, -2])


def distance(dimension: int) -> Statement:
    """Return the distance of two points."""
    return _statement(DISTANCE, u=np.zeros(dimension))


def following(axis: np.ndarray) -> Statement:
    """Return a direction (d,) that turns with b; its length does not matter."""
    return _statement(FOLLOWING, w=np.asarray(axis, dtype=float) / np.linalg.norm(axis))


def sweeping(u: np.ndarray, v: np.ndarray) -> Statement:
    """Return a pull across the way from a to b in the plane of directions u and v (d,) in a, times that way: its rate
    is twice the area that b sweeps in a second."""
    return _statement(SWEEPING, u=u, v=v)


def _statement(kind: int, **directions: np.ndarray) -> Statement:
    axes = np.zeros((3, len(next(iter(directions.values())))))
    for name, direction in directions.items():
        axes["uvw".index(name)] = direction
    return Statement(kind, axes)


@njit(cache=True, entry=True, error_model="numpy")
def _evaluate_all(kind, axes, z, turned, values, gradients, hessians):
    """Evaluate a statement at pairs of frames, the columns of z; derivatives without columns are not wanted."""
    gradient, hessian, spare = np.empty(z.shape[0]), np.empty((z.shape[0], z.shape[0])), np.empty(z.shape[0])
    first, second = gradients.shape[1] > 0, hessians.shape[2] > 0
    n = gradient.size
    for k in range(z.shape[1]):
        values[k] = evaluate(kind, axes, z[:, k].copy(), turned[k], second, gradient, hessian, spare)
        # number by number: what an array put into another would say of their shapes takes seconds to compile
        for i in range(n if first else 0):
            gradients[i, k] = gradient[i]
            for j in range(n if second else 0):
                hessians[i, j, k] = hessian[i, j]
