"""Statements about the frames of nodes, compiled: frames from unknowns, and one chain rule back.

A point at the arm X of a node has the frame ``p = r + sum_k X_k d_k`` with the node's directors d_k. The unknowns of a
node are its frame in natural coordinates, or in the plane ``(x, y, phi)``, with ``d d_k / d phi = J d_k``, J a right
angle's rotation. The pose of a rigid body is such a node, with the arm from the body's origin.

What is evaluated is a function ``f(s)`` of the statement (`statements.Function`), with f' g and ``f' h + f'' g g^T``,
of one sample or of several side by side (`lane_items`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import types

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import empty_lanes, items, sine_cosine
from pgmp_petsc.lanes.vectors import vector
from pgmp_petsc.mechanism.joints import Attachment
from pgmp_petsc.mechanism.statements import ANGLE, IDENTITY, MEET, Function, Statement, U, V, W, evaluate, n_frame

PLANAR = 3  # unknowns of a node in the plane


class NodeStatements(NamedTuple):
    """Statements about pairs of nodes, as compiled functions take them."""

    kinds: np.ndarray  # of the statements, shape (n,)
    axes: np.ndarray  # their directions, shape (n, 3, d)
    arms: np.ndarray  # from the nodes of both sides to the points, in the frames of the nodes, shape (n, 2, d), m
    ground: np.ndarray  # frames of sides on the ground, zero for others, shape (n, 2 d (d + 1))
    on_ground: np.ndarray  # which sides are, shape (n, 2)
    factors: np.ndarray  # of the functions, shape (n,)
    #: first piece of the spline of each (n + 1,), where every piece begins and ends, shape (n_pieces, 2), and its
    #: coefficients, shape (n_pieces, 4)
    pieces: tuple[np.ndarray, np.ndarray, np.ndarray]

    @classmethod
    def of(
        cls,
        parts: Sequence[Statement],
        sides: Sequence[tuple[Attachment, Attachment]],
        dimension: int,
        functions: Sequence[Function] | None = None,
    ) -> NodeStatements:
        """Make them of statements in 2 or 3 dimensions, the attachments that they are about, and functions of them."""
        functions = [IDENTITY] * len(parts) if functions is None else functions
        lengths = [len(function.coefficients) for function in functions]
        spans = [np.stack([one.breaks[:-1], one.breaks[1:]], axis=1) for one in functions if one.breaks.size]
        every = [side for pair in sides for side in pair]
        on_ground = np.array([side.on_ground for side in every], dtype=bool)
        ground = np.zeros((len(every), n_frame(dimension)))
        ground[on_ground, dimension:] = np.eye(dimension).ravel()
        ground[on_ground, :dimension] = [side.point for side in every if side.on_ground] or 0.0
        return cls(
            np.array([part.kind for part in parts], dtype=np.int64),
            np.array([part.axes for part in parts]).reshape(-1, 3, dimension),
            np.array([side.arm for side in every]).reshape(-1, 2, dimension),
            ground.reshape(-1, 2 * n_frame(dimension)),
            on_ground.reshape(-1, 2),
            np.array([function.factor for function in functions], dtype=float),
            (
                np.cumsum([0, *lengths]),
                np.concatenate([*spans, np.zeros((0, 2))]),
                np.concatenate([np.zeros((0, 4)), *(function.coefficients for function in functions)]),
            ),
        )


class Scratch(NamedTuple):
    """Work arrays of one statement, (..., n_lanes): both frames, derivatives in them, half of the chain rule, and the
    function with its derivatives."""

    z: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    spare: np.ndarray
    half: np.ndarray
    function: np.ndarray


@njit(cache=True, error_model="numpy")
def scratch_of(statements, m, width):
    """Return work arrays for nodes with m unknowns, of as many samples as `width` is long."""
    n, n_lanes = statements.ground.shape[1], len(width)
    return Scratch(
        empty_lanes(n, n_lanes),
        empty_lanes(n, n_lanes),
        empty_lanes(n * n, n_lanes).reshape((n, n, n_lanes)),
        empty_lanes(n, n_lanes),
        empty_lanes(2 * m * n, n_lanes).reshape((n, 2 * m, n_lanes)),
        empty_lanes(3, n_lanes),
    )


def _item(statements, k, y, known, second, scratch, width, *_):
    return vector if len(width) > 1 else types.float64


@njit(cache=True, apart=_item, error_model="numpy")
def state(statements, k, y, known, second, scratch, width, g, h):
    """Evaluate the function f of a statement s, by its number k, in the unknowns y of its two nodes, numbers on the
    ground, shape (2 m, n_lanes), m = 3 in the plane or 12; return ``f(s)``, a number or a vector, of s itself m, 1 or
    rad.

    `known` is what an angle is nearest to, shape (n_lanes,), rad; in the plane angles count turns by themselves.
    Results are the first derivatives g, (2 m, n_lanes), and, where `second`, the second ones h, (2 m, 2 m, n_lanes).
    `width` has as many numbers as there are lanes; see `lane_items`.
    """
    y, g, h = items(y, width), items(g, width), items(h, width)
    if y.size == 2 * PLANAR and _is_linear(statements, k):
        s = _linear(statements, k, y, second, g, h)
    else:
        z = items(scratch.z, width)
        # in space the unknowns of nodes are their frames
        gradient = items(scratch.gradient, width) if y.size == 2 * PLANAR else g
        hessian = items(scratch.hessian, width) if y.size == 2 * PLANAR else h
        _place(statements, k, y, z)
        s = evaluate(
            statements.kinds[k], statements.axes[k], z, items(known, width)[()], second, gradient, hessian,
            items(scratch.spare, width),
        )  # fmt: skip
        _to_nodes(statements.arms[k], second, gradient, hessian)
        if y.size == 2 * PLANAR:
            _to_angles(z, second, gradient, hessian, items(scratch.half, width), g, h)
    return s if is_itself(statements, k) else through_function(statements, k, s, second, scratch.function, width, g, h)


@njit(error_model="numpy", forceinline=True)
def through_function(statements, k, s, second, function, width, g, h):
    """Return the function of a statement where that is s, and turn its derivatives g (n,) and h (n, n), items, into
    those of the function; `function` is a work array (3, n_lanes)."""
    of = items(function, width)
    of[0] = s
    for lane in range(function.shape[1]):
        function[0, lane], function[1, lane], function[2, lane] = function_at(statements, k, function[0, lane])
    slope, bend = of[1], of[2]
    if second:
        for i in range(g.size):
            bent = bend * g[i]
            for j in range(g.size):
                h[i, j] = slope * h[i, j] + bent * g[j]
    for i in range(g.size):
        g[i] = slope * g[i]
    return of[0]


@njit(inline="always")
def is_itself(statements, k):
    """Return whether the function of a statement is the statement."""
    return statements.factors[k] == 1.0 and statements.pieces[0][k] == statements.pieces[0][k + 1]


@njit(cache=True, error_model="numpy")
def function_at(statements, k, s):
    """Return the function of a statement where that is s, its slope and its second derivative."""
    factor, spans, coefficients = statements.factors[k], statements.pieces[1], statements.pieces[2]
    first, last = statements.pieces[0][k], statements.pieces[0][k + 1]
    value, slope, bend = factor * s, factor, 0.0
    if last > first:
        begin = spans[first, 0]
        period = spans[last - 1, 1] - begin
        within = s - period * np.floor((s - begin) / period) if period > 0.0 else s
        while last - first > 1:
            middle = (first + last) // 2
            if within >= spans[middle, 0]:
                first = middle
            else:
                last = middle
        x, c = within - spans[first, 0], coefficients[first]
        value = factor * (c[0] + x * (c[1] + x * (c[2] + x * c[3])))
        slope = factor * (c[1] + x * (2.0 * c[2] + x * 3.0 * c[3]))
        bend = factor * (2.0 * c[2] + x * 6.0 * c[3])
    return value, slope, bend


@njit(inline="always")
def _is_linear(statements, k):
    """Return whether a statement in the plane is linear in ``(x, y, phi)``: angles, and nodes that meet."""
    kind, arms = statements.kinds[k], statements.arms[k]
    if kind == MEET:
        return arms[0, 0] == 0.0 and arms[0, 1] == 0.0 and arms[1, 0] == 0.0 and arms[1, 1] == 0.0
    return kind == ANGLE


@njit(cache=True, error_model="numpy")
def _linear(statements, k, y, second, g, h):
    """Evaluate ``u . (r_b - r_a)``, or ``phi_b - phi_a`` and the angle from v_a to w_b before any turn."""
    axes, n = statements.axes[k], statements.ground.shape[1] // 2
    for i in range(2 * PLANAR):
        g[i] = 0.0
        for j in range(2 * PLANAR if second else 0):
            h[i, j] = 0.0
    angle = statements.kinds[k] == ANGLE
    s = 0.0 * y[0]
    if angle:
        cos, sin = axes[U, 0] * axes[W, 0] + axes[U, 1] * axes[W, 1], axes[V, 0] * axes[W, 0] + axes[V, 1] * axes[W, 1]
        s += np.arctan2(sin, cos)
    for side in range(2):
        sign, own = 2.0 * side - 1.0, PLANAR * side
        for c in range(2, 3) if angle else range(2):
            slope = sign if angle else sign * axes[U, c]
            if not statements.on_ground[k, side]:
                g[own + c] = slope
                s += slope * y[own + c]
            elif not angle:
                s += slope * statements.ground[k, n * side + c]
    return s


@njit(cache=True, error_model="numpy")
def _place(statements, k, y, z):
    """Fill both frames (2 d (d + 1),) of a statement from the unknowns (2 m,) of its nodes."""
    d, m = statements.axes.shape[2], y.size // 2
    n = d * (d + 1)
    for side in range(2):
        first, own = n * side, m * side
        if statements.on_ground[k, side]:
            for c in range(n):
                z[first + c] = statements.ground[k, first + c]
            continue
        if m == PLANAR:
            sin, cos = sine_cosine(y[own + 2])
            z[first], z[first + 1] = y[own], y[own + 1]
            z[first + 2], z[first + 3], z[first + 4], z[first + 5] = cos, sin, -sin, cos
        else:
            for c in range(n):
                z[first + c] = y[own + c]
        for j in range(d):
            for c in range(d):
                z[first + c] += statements.arms[k, side, j] * z[first + d + d * j + c]


@njit(cache=True, error_model="numpy")
def _to_nodes(arms, second, gradient, hessian):
    """Turn derivatives in two frames, second ones where they are wanted too, into those in the frames of their nodes;
    `arms` are those of both sides, shape (2, d), m."""
    d, n_pair = arms.shape[1], gradient.size
    for side in range(2):
        for j in range(d):
            arm = arms[side, j]
            if arm != 0.0:
                for c in range(d):
                    at, point = n_pair // 2 * side + d + d * j + c, n_pair // 2 * side + c
                    gradient[at] += arm * gradient[point]
                    if second:
                        for i in range(n_pair):
                            hessian[at, i] += arm * hessian[point, i]
                        for i in range(n_pair):
                            hessian[i, at] += arm * hessian[i, point]


@njit(cache=True, error_model="numpy")
def _to_angles(z, second, gradient, hessian, half, g, h):
    """Turn derivatives in the frames of two nodes in the plane into g (6,) and h (6, 6), those in ``(x, y, phi)``.

    `z` are the frames, shape (12,), and `half` is a work array (12, 6).
    """
    n_pair = z.size
    n = n_pair // 2
    # columns, then rows; J d_1 = d_2, J d_2 = -d_1
    for side in range(2):
        first, own = n * side, PLANAR * side
        x, y, at = z[first + 2], z[first + 3], first + 2  # the directors are (x, y) and (-y, x)
        g[own], g[own + 1] = gradient[first], gradient[first + 1]
        g[own + 2] = x * (gradient[at + 1] - gradient[at + 2]) - y * (gradient[at] + gradient[at + 3])
        for i in range(n_pair if second else 0):
            bent = hessian[i]
            half[i, own], half[i, own + 1] = bent[first], bent[first + 1]
            half[i, own + 2] = x * (bent[at + 1] - bent[at + 2]) - y * (bent[at] + bent[at + 3])
    for side in range(2 if second else 0):
        first, own = n * side, PLANAR * side
        x, y, at = z[first + 2], z[first + 3], first + 2
        for j in range(2 * PLANAR):
            h[own, j], h[own + 1, j] = half[first, j], half[first + 1, j]
            h[own + 2, j] = x * (half[at + 1, j] - half[at + 2, j]) - y * (half[at, j] + half[at + 3, j])
        for c in range(2, 6):
            h[own + 2, own + 2] -= z[first + c] * gradient[first + c]  # d2 d_k / d phi2 = -d_k
