"""Ties between a body and the frames that hold it: to faces of its mesh, or to a floating frame and its deformation.

The frame of a group of faces has their mean position and mean rotation, see `bodies.solid`.

With a frame (p, d_1 .. d_d), the nodes' positions x_i, their weights w_i and arms a_i,

    p - sum_i w_i x_i = 0,    1/h sum_k (sum_i a_ik x_i) x d_k = 0,    h = int X'.X' dA / A,

the second of which is the frame's rotation less the faces' mean rotation to first order, and holds for any rotation.

With a floating frame (p, d_1 .. d_d) and the displacement A xi and the small rotation Theta xi of a frame (P, D_1 ..
D_d) at X in it (`bodies.floating`),

    P - p - sum_k d_k (X + A xi + 1/2 xi^T a xi)_k = 0,    1/2 (D_k.d_l - D_l.d_k) - (Theta xi)_m = 0,

with k, l, m in cyclic order, in the plane ``Phi - phi - Theta xi = 0``; a is zero but for bodies that follow their
foreshortening (`components.component_modes`).

Every row is a sum of terms ``f d x y``, of a component d of a director and two unknowns x and y, each of which may be
1; in the plane ``(x, y, phi)`` give the directors, with ``d d_k / d phi = J d_k``, J a right angle's rotation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.component import TURNS
from pgmp_petsc.bodies.solid import FaceFrame
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import select, sine_cosine
from pgmp_petsc.mechanism.mechanism import Unknowns

PHI = 2  # a frame's rotation in the plane
Derivative = tuple[np.ndarray, np.ndarray, np.ndarray]


class Terms(NamedTuple):
    """Terms ``f d x y`` of rows, each array of shape (n,)."""

    rows: np.ndarray
    turning: np.ndarray  # the unknown of its frame that d depends on, -1 where d is 1
    directors: np.ndarray  # number of d among the components of its frame's directors
    #: first, second: the unknowns x and y, the same or not, -1 where one is 1
    first: np.ndarray
    second: np.ndarray
    factors: np.ndarray  # f

    @classmethod
    def of(
        cls, d: int, rows: np.ndarray, factors: np.ndarray, first: np.ndarray | int = -1,
        second: np.ndarray | int = -1, frame: int = -1, directors: np.ndarray | int = 0,
    ) -> Terms:  # fmt: skip
        """Return terms in d dimensions; `frame` is the first unknown of that whose director they have."""
        turning = -1 if frame < 0 else frame + (PHI if d == 2 else d + directors)
        numbers = (np.broadcast_to(part, rows.shape) for part in (rows, turning, directors, first, second))
        return cls(*(part.astype(np.int64) for part in numbers), np.broadcast_to(factors, rows.shape).astype(float))

    @classmethod
    def joined(cls, parts: list[Terms]) -> Terms:
        """Return all terms of some parts."""
        empty = cls(*(np.zeros(0, dtype=np.int64),) * 5, np.zeros(0))
        return cls(*(np.concatenate(column) for column in zip(empty, *parts)))

    def derivatives(self, d: int) -> tuple[list[Derivative], list[Derivative]]:
        """Return which terms have first derivatives in x, y and the director's unknown, with rows and unknowns, and
        which have second ones in x and y, in that unknown and x or y, and in the plane in it twice, with both."""
        rows, turning, _, x, y, _ = self
        has_x, has_y, turns = (part >= 0 for part in (x, y, turning))
        twice = turns & (d == 2)
        first = [(has_x, rows, x), (has_y, rows, y), (turns, rows, turning)]
        second = [(has_x & has_y, x, y), (turns & has_x, turning, x), (turns & has_y, turning, y)]
        return first, [*second, (twice, turning, turning)]


class FrameTies:
    """Rows of terms in d dimensions, n rows of n_dofs unknowns; the interface is that of `StatementRows`."""

    def __init__(self, terms: Terms, d: int, n: int, n_dofs: int) -> None:
        self.terms, self.d, self.n = terms, d, n
        first, second = terms.derivatives(d)
        second = [(has, np.maximum(one, other), np.minimum(one, other)) for has, one, other in second]
        self.jacobian_pattern, self._of_first = _numbered(first, n_dofs)
        self.curvature_pattern = _numbered(second, n_dofs)[0]

    @classmethod
    def of(cls, unknowns: Unknowns) -> FrameTies:
        """Return the ties of all frames that hold bodies on meshes and in floating frames."""
        parts, n, d = [], 0, unknowns.dimension
        for body in unknowns.bodies:
            for number, faces in enumerate(body.face_frames.values()):
                frame = unknowns.frame(body.first_node + number)
                positions = body.first_internal + d * faces.nodes[:, None] + np.arange(d)  # of the faces' nodes
                parts += [_means(n, frame, positions, faces), *_rotations(n + d, int(frame[0]), positions, faces)]
                n += d + len(TURNS[d])
        for body, floating in ((body, one) for body in unknowns.bodies for one in body.blocks("floating")):
            last = unknowns.frame(body.first_node + body.n_nodes - 1)
            amplitudes = body.first_internal + np.arange(floating.n)
            for number, of_frame in enumerate(zip(floating.centres, floating.shapes, floating.bent)):
                parts += _holding(n, unknowns.frame(body.first_node + number), last, amplitudes, *of_frame)
                n += d + len(TURNS[d])
        return cls(Terms.joined(parts), d, n, unknowns.n_dofs)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return what is to be zero, shape (n, ...), m and rad, for unknowns (n_dofs, ...)."""
        return self._filled(_values, self.n, [], q)

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        return self._filled(_jacobian, self.jacobian_pattern[0].size, self._of_first, q)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return what the velocities do to the rates of the ties, shape (n, ...)."""
        return self._filled(_drift, self.n, [], q, v)

    def _filled(self, fill, size: int, places: list[np.ndarray], *arrays: np.ndarray) -> np.ndarray:
        trailing = arrays[0].shape[1:]
        n = math.prod(trailing)
        flat = [np.ascontiguousarray(array.reshape(len(array), n)) for array in arrays]
        result = np.zeros((size, n))
        fill(self.d, self.terms, *places, *flat, result)
        return result.reshape(size, *trailing)


def _numbered(entries: list[Derivative], n_dofs: int) -> tuple[tuple[np.ndarray, np.ndarray], list[np.ndarray]]:
    """Return the pairs of all derivatives, each once, and where each term has its own among them."""
    keys = [one[has] * n_dofs + other[has] for has, one, other in entries]
    unique, at = np.unique(np.concatenate(keys), return_inverse=True)
    places = [np.full(has.size, -1) for has, _, _ in entries]
    for place, (has, _, _), own in zip(places, entries, np.split(at, np.cumsum([key.size for key in keys])[:-1])):
        place[has] = own
    return np.divmod(unique, n_dofs), places


def _holding(
    first_row: int, frame: np.ndarray, floating: np.ndarray, amplitudes: np.ndarray, centre: np.ndarray,
    shape: np.ndarray, bent: np.ndarray,
) -> list[Terms]:  # fmt: skip
    """Return the terms of a frame that holds a body in a floating frame, rows from a first one on, of the unknowns of
    both, shape (m,), and xi, (n,); X, shape (d,), m; A and Theta, shape (3, n), in space (6, n); and a, (d, n, n)."""
    d, n, axes = centre.size, amplitudes.size, np.arange(centre.size)
    rotation, turned = shape[d:], first_row + d + np.arange(len(shape) - d)
    component, k = (part.ravel() for part in np.meshgrid(axes, axes, indexing="ij"))
    rows, directors = first_row + component, d * k + component  # sum_k d_k (...)_k
    of_floating = {"frame": int(floating[0])}
    found = [
        Terms.of(d, first_row + axes, 1.0, frame[:d]),
        Terms.of(d, first_row + axes, -1.0, floating[:d]),
        Terms.of(d, np.repeat(turned, n), -rotation.ravel(), np.tile(amplitudes, len(rotation))),
        Terms.of(
            d, np.repeat(rows, n), -shape[k].ravel(), np.tile(amplitudes, rows.size),
            directors=np.repeat(directors, n), **of_floating,
        ),
        Terms.of(d, rows, -centre[k], directors=directors, **of_floating),
        bent_terms(d, first_row, int(floating[0]), amplitudes, bent),
    ]  # fmt: skip
    if d == 2:
        return [*found, Terms.of(d, np.repeat(turned, 2), [1.0, -1.0], np.array([frame[2], floating[2]]))]
    for m, row in enumerate(turned):
        for factor, mine, its in ((0.5, m - 2, m - 1), (-0.5, m - 1, m - 2)):
            mine, its = d * (mine % d) + axes, floating[d + d * (its % d) + axes]
            found.append(Terms.of(d, np.full(d, row), factor, its, frame=int(frame[0]), directors=mine))
    return found


def bent_terms(d: int, first_row: int, frame: int, amplitudes: np.ndarray, bent: np.ndarray) -> Terms:
    """Return ``- 1/2 sum_k d_k xi^T a_k xi``, what ties have of second order in the deformation.

    Rows begin with that of the tie's first component; `frame` is the first unknown of the floating frame, the
    amplitudes are the unknowns xi, shape (n,), and `bent` is ``a``, shape (d, n, n), 1/m.
    """
    i, j = np.tril_indices(amplitudes.size)
    of_pairs = np.where(i == j, 0.5, 1.0) * bent[:, i, j]
    k, pair = np.nonzero(of_pairs)
    component = np.repeat(np.arange(d), k.size)
    k, pair = np.tile(k, d), np.tile(pair, d)
    first, second = amplitudes[i[pair]], amplitudes[j[pair]]
    return Terms.of(d, first_row + component, -of_pairs[k, pair], first, second, frame, d * k + component)


def _means(first_row: int, frame: np.ndarray, positions: np.ndarray, faces: FaceFrame) -> Terms:
    """Return ``p - sum w_i x_i``."""
    n, d = positions.shape
    axes = np.arange(d)
    rows = first_row + np.concatenate([axes, np.repeat(axes, n)])
    factors = np.concatenate([np.ones(d), -np.tile(faces.weights, d)])
    return Terms.of(d, rows, factors, np.concatenate([frame[:d], positions.T.ravel()]))


def _rotations(first_row: int, frame: int, positions: np.ndarray, faces: FaceFrame) -> Iterator[Terms]:
    """Yield ``1/h sum_k (sum_i a_ik x_i) x d_k``."""
    n, d = positions.shape
    second = faces.inertia[0, 0] if d == 2 else 0.5 * np.trace(faces.inertia)
    arms = faces.arms / second
    used = np.flatnonzero(np.abs(arms).max(axis=0) > 1e-12 * np.abs(arms).max())
    for row, plane in enumerate(TURNS[d], first_row):
        for sign, (one, other) in zip((-1.0, 1.0), permutations(plane)):
            for k in used:
                factors = sign * arms[:, k]
                yield Terms.of(d, np.full(n, row), factors, positions[:, other], frame=frame, directors=d * k + one)


@njit(error_model="numpy", forceinline=True)
def parts_of(d, terms, e, q):
    """Return of a term ``f d``, its first and second derivatives with what d turns with, x and y, for items q (n_dofs,)
    of `lane_items`."""
    turning, number, factor = terms.turning[e], terms.directors[e], terms.factors[e]
    first, second = terms.first[e], terms.second[e]
    zero, unit = select(0, q[0], 0.0), select(0, q[0], 1.0)
    x = q[first] if first >= 0 else unit
    y = q[second] if second >= 0 else unit
    if turning < 0:
        return zero + factor, zero, zero, x, y
    if d == 3:
        return factor * q[turning], zero + factor, zero, x, y
    sin, cos = sine_cosine(q[turning])
    sin, cos = factor * sin, factor * cos
    if number == 1:
        return sin, cos, -sin, x, y
    if number == 2:
        return -sin, -cos, sin, x, y
    return cos, -sin, -cos, x, y


@njit(cache=True, error_model="numpy")
def _values(d, terms, q, result):
    for sample in range(q.shape[1]):
        unknowns = q[:, sample]
        for e in range(terms.rows.size):
            along, _, _, x, y = parts_of(d, terms, e, unknowns)
            result[terms.rows[e], sample] += along * x * y


@njit(cache=True, error_model="numpy")
def _jacobian(d, terms, of_first, of_second, of_turning, q, result):
    for sample in range(q.shape[1]):
        unknowns = q[:, sample]
        for e in range(terms.rows.size):
            along, slope, _, x, y = parts_of(d, terms, e, unknowns)
            if of_first[e] >= 0:
                result[of_first[e], sample] += along * y
            if of_second[e] >= 0:
                result[of_second[e], sample] += along * x
            if of_turning[e] >= 0:
                result[of_turning[e], sample] += slope * x * y


@njit(cache=True, error_model="numpy")
def _drift(d, terms, q, v, result):
    for sample in range(q.shape[1]):
        unknowns = q[:, sample]
        for e in range(terms.rows.size):
            along, slope, bend, x, y = parts_of(d, terms, e, unknowns)
            of_x, of_y, spin = terms.first[e], terms.second[e], terms.turning[e]
            vx = v[of_x, sample] if of_x >= 0 else 0.0
            vy = v[of_y, sample] if of_y >= 0 else 0.0
            turned = v[spin, sample] if spin >= 0 else 0.0
            change = 2.0 * along * vx * vy + 2.0 * slope * turned * (vx * y + x * vy) + bend * turned**2 * x * y
            result[terms.rows[e], sample] += change
