"""Statements about the frames of nodes, compiled: frames from unknowns, and one chain rule back; and as rows of a
system of equations, with values, derivatives on fixed patterns, and drift.

A point at the arm X of a node has the frame ``p = r + sum_k X_k d_k`` with the node's directors d_k. The unknowns of a
node are its frame in natural coordinates, or in the plane ``(x, y, phi)``, with ``d d_k / d phi = J d_k``, J a right
angle's rotation. The pose of a rigid body is such a node, with the arm from the body's origin.

What is evaluated is a function ``f(s)`` of the statement (`statements.Function`), with f' g and ``f' h + f'' g g^T``,
of one sample or of several side by side (`lane_items`).

A row is a statement, or a combination of functions of several (`statements.Combination`). Its terms add up, and have
their derivatives each in the unknowns of two nodes: patterns list them term by term. In space the turn of an angle
among them is that of the angle's own row, where there is one, or else the one with which the sum is nearest to its
value. Trailing axes of the unknowns (samples, configurations) are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
from numba import types

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import WIDE, empty_lanes, items, keep, sine_cosine
from pgmp_petsc.lanes.vectors import LANES, vector
from pgmp_petsc.mechanism.joints import Attached, Attachment
from pgmp_petsc.mechanism.space import Space
from pgmp_petsc.mechanism.statements import ANGLE, IDENTITY, MEET, Function, Line, Statement, U, V, W, evaluate, n_frame

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


VALUES, SLOPES, CURVATURES, DRIFT = range(4)
ROUND_OFF = 1e-14  # of derivatives of order 1 at a generic place, below which they are zero everywhere


class StatementRows:
    """Statements about pairs of nodes, one a row, or combinations of them.

    There are n `parts`; `node_dofs` leads from a node to the unknowns that its frame depends on, shape (m,): ``(x, y,
    phi)`` or natural coordinates.

    Terms have the rows `row_of`, increasing, (n_terms,), and in `dofs` the unknowns of both nodes, -1 on the ground,
    (n_terms, 2 m). `jacobian_pattern` has rows and unknowns of their first derivatives that are not zero everywhere,
    each (n_entries,); what repeats a pair is added. `curvature_pattern` has rows and columns among all unknowns of the
    second derivatives of all rows that are not, one of each symmetric pair, each (n_curved,); rows repeat a pair.
    `compiled` are the rows as compiled functions take them.
    """

    def __init__(self, parts: Sequence[Attached], node_dofs: Callable[[int], np.ndarray], dimension: int) -> None:
        self.parts, self.n = parts, len(parts)
        terms = [term for part, _ in parts for term in part.terms]
        self.row_of = np.repeat(np.arange(self.n), [len(part.terms) for part, _ in parts])
        every = [side for _, sides in parts for side in sides]
        own = [part for part, _ in terms], list(zip(every[::2], every[1::2])), dimension
        self.statements = NodeStatements.of(*own, [function for _, function in terms])
        # derivatives may be zero at some place, as those of a cam that dwells, or of what is local along a line
        generic = [part.generic for part, _ in terms], *own[1:], [function.generic for _, function in terms]
        # with factors of their own, by which terms of a row do not cancel
        factors = np.random.default_rng(0).uniform(1.0, 2.0, len(terms))
        self._generic = NodeStatements.of(*generic)._replace(factors=factors)
        grounded = np.full(node_dofs(0).size, -1)
        dofs = [grounded if side.on_ground else node_dofs(side.node) for side in every]
        alone = {part.terms[0][0]: row for row, (part, _) in enumerate(parts) if len(part.terms) == 1}
        self.near = near_to(parts, alone)
        self.dofs = np.array(dofs, dtype=np.int64).reshape(len(terms), 2 * grounded.size)
        self._compile()

    @classmethod
    def on_poses(cls, parts: Sequence[Attached], space: Space) -> StatementRows:
        """Return the rows of parts on rigid bodies, whose unknowns are the poses of all bodies."""
        placed = [(part, tuple(side.on_pose() for side in sides)) for part, sides in parts]
        return cls(placed, lambda body: space.n_pose * body + np.arange(space.n_pose), space.dimension)

    def values(self, q: np.ndarray, known: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the statements, shape (n, ...), for unknowns (n_dofs, ...).

        In space angles are nearest to `known`, which broadcasts against the result, rad.
        """
        known = np.array(np.broadcast_to(known, (self.n, *q.shape[1:])))
        return self._evaluated(VALUES, self.n, q, known)

    def gradients(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives of terms in the unknowns of `dofs`, shape (n_terms, 2 m, ...)."""
        return self._everything(SLOPES, q, self.statements)

    def hessians(self, q: np.ndarray) -> np.ndarray:
        """Return the second derivatives of terms in the unknowns of `dofs`, shape (n_terms, 2 m, 2 m, ...)."""
        return self._everything(CURVATURES, q, self.statements)

    def dense(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return all first and second derivatives of the rows, shapes (n, n_dofs) and (n, n_dofs, n_dofs), at unknowns
        (n_dofs,)."""
        felt = self.dofs >= 0
        both = felt[:, :, None] & felt[:, None, :]
        places = self.row_of[:, None] * q.size + self.dofs
        pairs = places[:, :, None] * q.size + self.dofs[:, None, :]
        slopes = np.bincount(places[felt], self.gradients(q)[felt], self.n * q.size)
        bends = np.bincount(pairs[both], self.hessians(q)[both], self.n * q.size**2)
        return slopes.reshape(self.n, q.size), bends.reshape(self.n, q.size, q.size)

    def second_along(self, q: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """Return the second derivatives along pairs of directions (n_dofs, k, n), shape (n, n_rows, k, k), at unknowns
        (n_dofs, n)."""
        k, n = ways.shape[1:]
        found = np.empty((n, self.n, k, k))
        for i, j in combinations_with_replacement(range(k), 2):
            found[:, :, i, j] = found[:, :, j, i] = self.drift(q, ways[:, i], ways[:, j]).T
        return found

    def jacobian_values(self, q: np.ndarray, generic: bool = False) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...); `generic` are those of statements
        and functions whose derivatives are zero nowhere, in the places of all."""
        rows = self.compiled._replace(statements=self._generic) if generic else self.compiled
        return self._evaluated(SLOPES, self.jacobian_pattern[0].size, q, rows=rows)

    def drift(self, q: np.ndarray, v: np.ndarray, w: np.ndarray | None = None) -> np.ndarray:
        """Return ``v^T h w``, shape (n, ...), w = v if not given: what the velocities do to the rates of the
        statements."""
        return self._evaluated(DRIFT, self.n, q, v if w is None else w, rates=v)

    def _evaluated(
        self,
        what: int,
        size: int,
        q: np.ndarray,
        known: np.ndarray | None = None,
        rates: np.ndarray | None = None,
        rows: Rows | None = None,
    ) -> np.ndarray:
        """Return what is wanted, shape (size, ...); `known` are the angles or the multipliers of the rows, or the rates
        on the other side of a drift."""
        trailing = q.shape[1:]
        n = math.prod(trailing)
        if not size * n:
            return np.zeros((size, *trailing))
        known = np.zeros((0, n)) if known is None else known
        arrays = (q, q if rates is None else rates, known)
        q, rates, known = (np.ascontiguousarray(part.reshape(len(part), n), dtype=float) for part in arrays)
        result = np.zeros((size, n))
        _evaluate(what, self.compiled if rows is None else rows, q, rates, known, result)
        return result.reshape(size, *trailing)

    def _everything(self, what: int, q: np.ndarray, statements: NodeStatements) -> np.ndarray:
        """Return all first or second derivatives of statements in the places of all terms, zeros included."""
        ones, shape = np.ones((self.n, *q.shape[1:])), self.dofs.shape
        shape += shape[1:] if what == CURVATURES else ()
        found = self._evaluated(what, math.prod(shape), q, ones, rows=self._all._replace(statements=statements))
        return found.reshape(*shape, *q.shape[1:])

    @cached_property
    def _all(self) -> Rows:
        """Return the rows with every derivative on their patterns, none of them known beforehand."""
        n, width = self.dofs.shape
        everyone, columns = np.arange(n), np.tile(np.arange(width), n)
        pairs = np.tile(np.indices((width, width)).reshape(2, -1), n)
        return Rows(
            self.statements, self.dofs, self.row_of, self.near, everyone[:0], everyone, np.zeros(n),
            (width * np.arange(n + 1), columns, self.dofs.ravel()), np.zeros(columns.size),
            (width**2 * np.arange(n + 1), *np.ascontiguousarray(pairs)),
        )  # fmt: skip

    def _compile(self) -> None:
        """Find what is not zero at a place that no mechanism comes to, and what is the same everywhere."""
        n_dofs, n = self.dofs.max(initial=0) + 1, len(self.dofs)
        generic, at_zero = np.random.default_rng(0).normal(size=(n_dofs, 2)), np.zeros((n_dofs, 1))
        gradients, hessians = (self._everything(what, generic, self._generic) for what in (SLOPES, CURVATURES))
        moving = self.dofs >= 0
        curved = _not_zero(hessians) & moving[:, :, None] & moving[:, None, :]
        bent = curved.any(axis=(1, 2))
        first = _not_zero(gradients) & moving
        terms, columns = np.array(np.nonzero(first))  # contiguous, as everywhere: one compiled function for all
        entries = _starts(terms, n), columns, self.dofs[terms, columns]
        self.jacobian_pattern = self.row_of[terms], entries[2]
        both = np.array(np.nonzero(curved))
        lower = self.dofs[both[0], both[1]] >= self.dofs[both[0], both[2]]
        terms, i, j = np.ascontiguousarray(both[:, lower])
        self.curvature_pattern = self.dofs[terms, i], self.dofs[terms, j]
        # linear terms are their value at zero and their slopes there
        alone = self._all._replace(row_of=np.arange(n))
        constants = self._evaluated(VALUES, n, at_zero, np.zeros((n, 1)), rows=alone).ravel()
        self.compiled = Rows(
            self.statements, self.dofs, self.row_of, self.near, np.flatnonzero(~bent), np.flatnonzero(bent),
            constants, entries, self.gradients(at_zero)[..., 0][first], (_starts(terms, n), i, j),
        )  # fmt: skip


class Rows(NamedTuple):
    """Rows as compiled functions take them."""

    #: statements, dofs: as in `StatementRows`
    statements: NodeStatements
    dofs: np.ndarray
    row_of: np.ndarray  # the row that each term adds to, shape (n_terms,)
    near: Near  # of the rows' values
    #: linear, bent: numbers of the terms that are linear in the unknowns, and of the others
    linear: np.ndarray
    bent: np.ndarray
    constants: np.ndarray  # values where all unknowns are zero, shape (n_terms,)
    #: first entry of each term (n_terms + 1,) on the pattern of first derivatives, column in `dofs` and unknown of each
    entries: tuple[np.ndarray, np.ndarray, np.ndarray]
    slopes: np.ndarray  # first derivatives there where all unknowns are zero, shape (n_entries,)
    #: first entry of each term (n_terms + 1,) on the pattern of second derivatives, and its two columns in `dofs`
    curved: tuple[np.ndarray, np.ndarray, np.ndarray]


class Near(NamedTuple):
    """What the angles of n terms are near to: lines over known numbers, or what others leave of their row's value."""

    left: np.ndarray  # which are near to that, bool, shape (n,)
    offsets: np.ndarray  # of the lines, rad, shape (n,)
    starts: np.ndarray  # first entry of each line, (n + 1,); numbers and slopes of all entries
    numbers: np.ndarray
    slopes: np.ndarray


def near_to(parts: Sequence[Attached], numbers: Mapping[Statement, int]) -> Near:
    """Return it for the terms of parts; of known motions `numbers` are given."""
    left, offsets, entries = [], [], []
    for part, _ in parts:
        for statement, function in part.terms:
            line = Line(0.0, {statement: 1.0}) if statement in numbers else part.lines.get(statement)
            # a spline repeats itself with every turn
            is_loose = line is None and statement.kind == ANGLE and not function.breaks.size
            left.append(is_loose and len(part.terms) > 1)
            offsets.append(0.0 if line is None else line.offset)
            slopes = {} if line is None else line.slopes
            entries.append([(numbers[one], slope) for one, slope in slopes.items() if one in numbers])
    every = np.array([entry for own in entries for entry in own]).reshape(-1, 2)
    return Near(
        np.array(left, dtype=bool), np.array(offsets), np.cumsum([0, *map(len, entries)]),
        every[:, 0].astype(np.int64), np.ascontiguousarray(every[:, 1]),
    )  # fmt: skip


def _not_zero(found: np.ndarray) -> np.ndarray:
    """Return what is not zero at either of two places, the last axis."""
    return (np.abs(found[..., 0]) > ROUND_OFF) | (np.abs(found[..., 1]) > ROUND_OFF)


def _starts(rows: np.ndarray, n: int) -> np.ndarray:
    """Return the first of the entries of each of n rows, and their number, shape (n + 1,)."""
    return np.searchsorted(rows, np.arange(n + 1))


@njit(cache=True, entry=True, error_model="numpy")
def _evaluate(what, rows, q, rates, known, result):
    """Fill what is wanted of all rows, for all samples, into zeros (n or n_entries or n_curved, n_samples): ``VALUES``,
    ``SLOPES`` or ``CURVATURES`` on the patterns of `rows`, or ``DRIFT``; one function, as each compiles the statements
    anew.

    Of shape (n_dofs, n_samples) are q and the rates of the drift; `known` is what angles are nearest to, or the
    multipliers of the curvatures, (n, n_samples), or the rates on the other side of the drift.
    """
    starts, columns, unknowns = rows.entries
    curved_starts, one, other = rows.curved
    n_samples, width = q.shape[1], rows.dofs.shape[1]
    for k in rows.linear:
        if what == VALUES:
            for sample in range(n_samples):
                result[rows.row_of[k], sample] += rows.constants[k]
        for entry in range(starts[k], starts[k + 1]):
            slope = rows.slopes[entry]
            for sample in range(n_samples):
                if what == VALUES:
                    result[rows.row_of[k], sample] += slope * q[unknowns[entry], sample]
                elif what == SLOPES:
                    result[entry, sample] = slope
    scratch, y, g = scratch_of(rows.statements, width // 2, WIDE), empty_lanes(width, LANES), empty_lanes(width, LANES)
    second = what == CURVATURES or what == DRIFT
    h, own = empty_lanes(width * width, LANES).reshape((width, width, LANES)), empty_lanes(2, LANES)
    value, near = own
    for first in range(0, n_samples, LANES):
        n_here = min(LANES, n_samples - first)
        for k in rows.bent:
            row, of = rows.row_of[k], rows.near
            for lane in range(LANES):
                sample = first + min(lane, n_here - 1)  # lanes behind the last sample have it again
                for i in range(width):
                    y[i, lane] = q[rows.dofs[k, i], sample] if rows.dofs[k, i] >= 0 else 0.0
                near[lane] = 0.0
                if what == VALUES:
                    left = (known[row, sample] - result[row, sample]) / rows.statements.factors[k]
                    near[lane] = left if of.left[k] else of.offsets[k]
                    for entry in range(of.starts[k], of.starts[k + 1]):
                        near[lane] += of.slopes[entry] * known[of.numbers[entry], sample]
            items(value, WIDE)[()] = state(rows.statements, k, y, near, second, scratch, WIDE, g, h)
            for lane in range(n_here):
                sample = first + lane
                if what == VALUES:
                    result[row, sample] += value[lane]
                elif what == SLOPES:
                    for entry in range(starts[k], starts[k + 1]):
                        result[entry, sample] = g[columns[entry], lane]
                elif what == CURVATURES:
                    for entry in range(curved_starts[k], curved_starts[k + 1]):
                        result[entry, sample] = known[row, sample] * h[one[entry], other[entry], lane]
                else:
                    for i in range(width):
                        for j in range(width):
                            if h[i, j, lane] != 0.0:
                                turning = _rate(rows, k, i, rates, sample) * _rate(rows, k, j, known, sample)
                                result[row, sample] += h[i, j, lane] * turning
    keep(own)


@njit(inline="always")
def _rate(rows, k, i, rates, sample):
    """Return the rate of the unknown i of a term, zero on the ground."""
    dof = rows.dofs[k, i]
    return rates[dof, sample] if dof >= 0 else 0.0
