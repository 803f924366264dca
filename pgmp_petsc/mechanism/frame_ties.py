"""Ties between a body and the frames that hold it: to faces of its mesh, or to a floating frame and its deformation.

The frame of a group of faces has their mean position and mean rotation, see `bodies.face_frame`.

With a frame (p, d_1 .. d_d), the nodes' positions x_i, their weights w_i and arms a_i,

    p - sum_i w_i x_i = 0,    1/h sum_k (sum_i a_ik x_i) x d_k = 0,    h = int X'.X' dA / A,

the second of which is the frame's rotation less the faces' mean rotation to first order, and holds for any rotation.
Every row is a sum of products f d_kc x_ie; in the plane ``(x, y, phi)`` give the directors, with ``d d_k / d phi = J
d_k``, J a right angle's rotation.

With a floating frame (p, d_1 .. d_d) and the displacement A xi and the small rotation Theta xi of a frame (P, D_1 ..
D_d) at X in it (`bodies.floating`),

    P - p - sum_k d_k (X + A xi)_k = 0,    1/2 (D_k.d_l - D_l.d_k) - (Theta xi)_m = 0,

with k, l, m in cyclic order, in the plane ``Phi - phi - Theta xi = 0``: products of directors with amplitudes and with
each other, and in the plane arms, ``f d_k``. What bodies that follow their foreshortening add is in `curved_ties`.

What ties of frames to floating bodies have of second order in the deformation: ``-1/2 sum_k d_k xi^T a_k xi``.

A frame of a body that follows its foreshortening (`components.component_modes`) is displaced in the floating frame by
``A xi + 1/2 xi^T a xi``. These are products ``f d x y`` of a component of a director and two amplitudes, in rows that
`FrameTies` has; in the plane ``d d_k / d phi = J d_k``, with J a right angle's rotation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.face_frame import FaceFrame
from pgmp_petsc.bodies.linear_fields import TURNS
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.unknowns import Unknowns


class Products(NamedTuple):
    """Products ``f d x``."""

    rows: np.ndarray  # of each product, shape (n,)
    frames: np.ndarray  # first unknown of its frame
    directors: np.ndarray  # number of its component of a director among the frame's d d
    positions: np.ndarray  # the unknown x
    factors: np.ndarray  # f


class Arms(NamedTuple):
    """Terms ``f d``, a constant times a component of a director in the plane; fields as those of `Products`."""

    rows: np.ndarray
    frames: np.ndarray
    directors: np.ndarray
    factors: np.ndarray


class FrameTies:
    """The ties of all frames that hold bodies on meshes and in floating frames; the interface is that of
    `StatementRows`.

    Attributes
    ----------
    linear
        Rows, unknowns and factors of the entries that are linear, each (n_linear,).
    products, arms
        The products, and the arms, of which there are some in the plane alone.
    curved
        What is of second order in the deformation of bodies in floating frames.
    """

    def __init__(self, unknowns: Unknowns) -> None:
        self._d, self.n = unknowns.dimension, 0
        empty = np.zeros(0, dtype=np.int64)
        linear, products = [(empty, empty, np.zeros(0))], [(empty,) * 4 + (np.zeros(0),)]
        arms, curved = [(empty,) * 3 + (np.zeros(0),)], []
        for frame, positions, faces in _faces_of(unknowns):
            linear.append(_means(self.n, frame, positions, faces))
            products.append(_rotations(self.n + self._d, frame[0], positions, faces))
            self.n += self._d + len(TURNS[self._d])
        for held in _held_by_floating(unknowns):
            for parts, found in zip((linear, products, arms), held.ties(self.n)):
                parts.append(found)
            curved.append(Quadratics.of(self.n, held.floating[0], held.amplitudes, held.bent))
            self.n += held.shape.shape[0]
        self.curved = CurvedTies(curved, self._d, self.n)
        self.linear, self.products, self.arms = _joined(linear), Products(*_joined(products)), Arms(*_joined(arms))
        self._find_patterns(unknowns.n_dofs)

    @property
    def turning(self) -> np.ndarray:
        """The unknown of its frame that every product depends on, shape (n_products,)."""
        return self.products.frames + (PHI if self._d == 2 else self._d + self.products.directors)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return what is to be zero, shape (n, ...), m and rad, for unknowns (n_dofs, ...)."""
        return self._filled(_values, self.n, q) + self.curved.values(q)

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        return np.concatenate([self._filled(_jacobian, self._sizes[0], q), self.curved.jacobian_values(q)])

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the sum of multipliers (n, ...) times second derivatives on `curvature_pattern`."""
        own = self._filled(_curvature, self._sizes[1], q, multipliers)
        return np.concatenate([own, self.curved.curvature_values(q, multipliers)])

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return what the velocities do to the rates of the ties, shape (n, ...)."""
        return self._filled(_drift, self.n, q, v) + self.curved.drift(q, v)

    def _filled(self, fill, size: int, *arrays: np.ndarray) -> np.ndarray:
        trailing = arrays[0].shape[1:]
        n = math.prod(trailing)
        flat = [np.ascontiguousarray(array.reshape(len(array), n)) for array in arrays]
        result = np.zeros((size, n))
        fill(self._d, self.linear, self.products, self.arms, self._places, *flat, result)
        return result.reshape(size, *trailing)

    def _find_patterns(self, n_dofs: int) -> None:
        (row, column, _), p, arms = self.linear, self.products, self.arms
        turning, of_arms = self.turning, arms.frames + PHI
        entries = (row, column), (p.rows, p.positions), (p.rows, turning), (arms.rows, of_arms)
        unique, at = np.unique(np.concatenate([i * n_dofs + j for i, j in entries]), return_inverse=True)
        self.jacobian_pattern = _joined([(unique // n_dofs, unique % n_dofs), self.curved.jacobian_pattern])
        n_entries = unique.size
        of_linear, of_position, of_director, of_arm = np.split(at, np.cumsum([i.size for i, _ in entries])[:-1])
        pairs = [(np.maximum(turning, p.positions), np.minimum(turning, p.positions))]
        pairs += [(turning, turning), (of_arms, of_arms)] if self._d == 2 else []
        unique, at = np.unique(np.concatenate([i * n_dofs + j for i, j in pairs]), return_inverse=True)
        self.curvature_pattern = _joined([(unique // n_dofs, unique % n_dofs), self.curved.curvature_pattern])
        self._sizes = n_entries, unique.size
        mixed, twice, bent = at[: p.rows.size], at[p.rows.size : 2 * p.rows.size], at[2 * p.rows.size :]
        self._places = of_linear, of_position, of_director, of_arm, mixed, twice, bent


def _faces_of(unknowns: Unknowns) -> Iterator[tuple[np.ndarray, np.ndarray, FaceFrame]]:
    """Yield, frame by frame, its unknowns (m,), those of the positions of its faces' nodes (n, d), and the faces."""
    d = unknowns.dimension
    for body in unknowns.bodies:
        for number, faces in enumerate(body.face_frames.values()):
            positions = body.first_internal + d * faces.nodes[:, None] + np.arange(d)
            yield unknowns.frame(body.first_node + number), positions, faces


class _Held(NamedTuple):
    """A frame that holds a body in a floating frame."""

    #: frame, floating: unknowns of both, shape (m,)
    frame: np.ndarray
    floating: np.ndarray
    amplitudes: np.ndarray  # unknowns xi, shape (n,)
    centre: np.ndarray  # x, shape (d,), m
    shape: np.ndarray  # a and Theta, shape (3, n), in space (6, n)
    bent: np.ndarray  # what is of second order in the displacement, shape (d, n, n)

    def ties(self, first_row: int) -> tuple[tuple[np.ndarray, ...], ...]:
        """Return what is linear, the products and the arms, rows from a first one on."""
        d, n = self.centre.size, self.amplitudes.size
        rotation, axes = self.shape[d:], np.arange(d)
        component, k = (part.ravel() for part in np.meshgrid(axes, axes, indexing="ij"))
        rows, directors = first_row + component, d * k + component  # sum_k d_k (...)_k
        same = np.full(rows.size, self.floating[0])
        moved = [
            np.repeat(rows, n), np.repeat(same, n), np.repeat(directors, n), np.tile(self.amplitudes, rows.size),
            -self.shape[k].ravel(),
        ]  # fmt: skip
        turned = first_row + d + np.arange(len(rotation))
        linear = [
            np.concatenate([first_row + np.tile(axes, 2), np.repeat(turned, n)]),
            np.concatenate([self.frame[:d], self.floating[:d], np.tile(self.amplitudes, len(rotation))]),
            np.concatenate([np.repeat([1.0, -1.0], d), -rotation.ravel()]),
        ]
        arms = rows, same, directors, -self.centre[k]
        if d == 2:
            angles = np.repeat(turned, 2), np.array([self.frame[2], self.floating[2]]), np.array([1.0, -1.0])
            return _joined([tuple(linear), angles]), tuple(moved), arms
        linear = _joined([tuple(linear), (rows, self.floating[d + directors], arms[-1])])
        products = [tuple(moved)]
        for m, row in enumerate(turned):
            for factor, one, other in ((0.5, m - 2, m - 1), (-0.5, m - 1, m - 2)):
                one, other = one % d, other % d
                mine, its = d * one + axes, self.floating[d + d * other + axes]
                products.append((np.full(d, row), np.full(d, self.frame[0]), mine, its, np.full(d, factor)))
        none = np.zeros(0, dtype=np.int64)
        return linear, _joined(products), (none, none, none, np.zeros(0))


def _held_by_floating(unknowns: Unknowns) -> Iterator[_Held]:
    for body in unknowns.bodies:
        for floating in body.blocks("floating"):
            last = body.first_node + body.n_nodes - 1
            amplitudes = body.first_internal + np.arange(floating.n)
            for number, parts in enumerate(zip(floating.centres, floating.shapes, floating.bent)):
                yield _Held(unknowns.frame(body.first_node + number), unknowns.frame(last), amplitudes, *parts)


def _means(first_row: int, frame: np.ndarray, positions: np.ndarray, faces: FaceFrame) -> tuple[np.ndarray, ...]:
    """Return rows, unknowns and factors of ``p - sum w_i x_i``."""
    n, d = positions.shape
    axes = np.arange(d)
    rows = first_row + np.concatenate([axes, np.repeat(axes, n)])
    columns = np.concatenate([frame[:d], positions.T.ravel()])
    return rows, columns, np.concatenate([np.ones(d), -np.tile(faces.weights, d)])


def _rotations(first_row: int, frame: int, positions: np.ndarray, faces: FaceFrame) -> tuple[np.ndarray, ...]:
    """Return the products of ``1/h sum_k (sum_i a_ik x_i) x d_k``, as in `Products`."""
    n, d = positions.shape
    second = faces.inertia[0, 0] if d == 2 else 0.5 * np.trace(faces.inertia)
    arms = faces.arms / second
    used = np.flatnonzero(np.abs(arms).max(axis=0) > 1e-12 * np.abs(arms).max())
    parts = []
    for row, plane in enumerate(TURNS[d], first_row):
        for sign, (one, other) in zip((-1.0, 1.0), permutations(plane)):
            for k in used:
                same = (np.full(n, value, dtype=np.int64) for value in (row, frame, d * k + one))
                parts.append((*same, positions[:, other], sign * arms[:, k]))
    return _joined(parts)


def _joined(parts: list[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    return tuple(np.concatenate(column) for column in zip(*parts))


@njit(inline="always")
def director(d, products, e, q, sample):
    """Return the component of the director in a product, and its derivative with phi in the plane."""
    frame, number = products.frames[e], products.directors[e]
    if d == 3:
        return q[frame + 3 + number, sample], 0.0
    phi = q[frame + PHI, sample]
    cos, sin = np.cos(phi), np.sin(phi)
    if number == 0:
        return cos, -sin
    if number == 1:
        return sin, cos
    if number == 2:
        return -sin, -cos
    return cos, -sin


@njit(cache=True, error_model="numpy")
def _values(d, linear, products, arms, places, q, result):
    rows, columns, factors = linear
    for sample in range(q.shape[1]):
        for e in range(rows.size):
            result[rows[e], sample] += factors[e] * q[columns[e], sample]
        for e in range(products.rows.size):
            component, _ = director(d, products, e, q, sample)
            result[products.rows[e], sample] += products.factors[e] * component * q[products.positions[e], sample]
        for e in range(arms.rows.size):
            result[arms.rows[e], sample] += arms.factors[e] * director(d, arms, e, q, sample)[0]


@njit(cache=True, error_model="numpy")
def _jacobian(d, linear, products, arms, places, q, result):
    of_linear, of_position, of_director, of_arm, _, _, _ = places
    for sample in range(q.shape[1]):
        for e in range(of_linear.size):
            result[of_linear[e], sample] += linear[2][e]
        for e in range(products.rows.size):
            component, slope = director(d, products, e, q, sample)
            along = products.factors[e] * q[products.positions[e], sample]
            result[of_position[e], sample] += products.factors[e] * component
            result[of_director[e], sample] += along * (slope if d == 2 else 1.0)
        for e in range(arms.rows.size):
            result[of_arm[e], sample] += arms.factors[e] * director(d, arms, e, q, sample)[1]


@njit(cache=True, error_model="numpy")
def _curvature(d, linear, products, arms, places, q, multipliers, result):
    _, _, _, _, mixed, twice, bent = places
    for sample in range(q.shape[1]):
        for e in range(products.rows.size):
            component, slope = director(d, products, e, q, sample)
            factor = products.factors[e] * multipliers[products.rows[e], sample]
            result[mixed[e], sample] += factor * (slope if d == 2 else 1.0)
            if d == 2:  # d2 d_k / d phi2 = -d_k
                result[twice[e], sample] -= factor * component * q[products.positions[e], sample]
        for e in range(arms.rows.size):
            component, _ = director(d, arms, e, q, sample)
            result[bent[e], sample] -= arms.factors[e] * multipliers[arms.rows[e], sample] * component


@njit(cache=True, error_model="numpy")
def _drift(d, linear, products, arms, places, q, v, result):
    for sample in range(q.shape[1]):
        for e in range(products.rows.size):
            component, slope = director(d, products, e, q, sample)
            frame, position = products.frames[e], products.positions[e]
            if d == 2:
                spin = v[frame + PHI, sample]
                change = 2.0 * slope * spin * v[position, sample] - component * spin * spin * q[position, sample]
            else:
                change = 2.0 * v[frame + 3 + products.directors[e], sample] * v[position, sample]
            result[products.rows[e], sample] += products.factors[e] * change
        for e in range(arms.rows.size):
            component, _ = director(d, arms, e, q, sample)
            spin = v[arms.frames[e] + PHI, sample]
            result[arms.rows[e], sample] -= arms.factors[e] * component * spin * spin


PHI = 2  # a frame's rotation in the plane


class Quadratics(NamedTuple):
    """Products ``f d x y``."""

    rows: np.ndarray  # of each product, shape (n,)
    frames: np.ndarray  # first unknown of its frame
    directors: np.ndarray  # number of its component of a director among the frame's d d
    #: first, second: the unknowns x and y, the same or not
    first: np.ndarray
    second: np.ndarray
    factors: np.ndarray  # f

    @classmethod
    def of(
        cls, first_row: int, frame: int, amplitudes: np.ndarray, bent: np.ndarray, least: float = 1e-8
    ) -> Quadratics:
        """Return those of one frame.

        Parameters
        ----------
        first_row
            The row of the tie's first component.
        frame, amplitudes
            The first unknown of the floating frame, and the unknowns xi, shape (n,).
        bent
            ``a``, shape (d, n, n), 1/m.
        least
            Of the largest entry, below which there is none: symmetric meshes leave round-off there.
        """
        d, n = len(bent), amplitudes.size
        i, j = np.tril_indices(n)
        of_pairs = np.where(i == j, 0.5, 1.0) * bent[:, i, j]
        k, pair = np.nonzero(np.abs(of_pairs) > least * np.max(np.abs(of_pairs), initial=0.0))
        component = np.repeat(np.arange(d), k.size)
        k, pair = np.tile(k, d), np.tile(pair, d)
        return cls(
            first_row + component, np.full(k.size, frame), d * k + component, amplitudes[i[pair]],
            amplitudes[j[pair]], -of_pairs[k, pair],
        )  # fmt: skip


class CurvedTies:
    """The products of all frames, to be added to `FrameTies`.

    Parameters
    ----------
    parts
        Of each frame.
    dimension
        2 or 3.
    n_rows
        Number of rows of all ties.

    Attributes
    ----------
    products
        All of them.
    turning
        The unknown of its frame that every product depends on, shape (n_products,).
    jacobian_pattern, curvature_pattern
        Rows and unknowns of the first derivatives, pairs of unknowns of the second ones; entries may repeat.
    """

    def __init__(self, parts: list[Quadratics], dimension: int, n_rows: int) -> None:
        none = np.zeros(0, dtype=np.int64)
        parts = [Quadratics(*(none,) * 5, np.zeros(0)), *parts]
        p = self.products = Quadratics(*(np.concatenate(column) for column in zip(*parts)))
        self._d, self._n_rows = dimension, n_rows
        turning = self.turning = p.frames + (PHI if dimension == 2 else dimension + p.directors)
        self.jacobian_pattern = np.tile(p.rows, 3), np.concatenate([p.first, p.second, turning])
        pairs = [(p.first, p.second), (turning, p.first), (turning, p.second)]
        pairs += [(turning, turning)] if dimension == 2 else []
        one, other = (np.concatenate(column) for column in zip(*pairs))
        self.curvature_pattern = np.maximum(one, other), np.minimum(one, other)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return what they add to the ties, shape (n_rows, ...), for unknowns (n_dofs, ...)."""
        if not self.products.rows.size:
            return np.zeros((self._n_rows, *q.shape[1:]))
        along, _, x, y = self._at(q)
        return self._summed(along * x * y, q)

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        along, slope, x, y = self._at(q)
        return np.concatenate([along * y, along * x, slope * x * y])

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return multipliers (n_rows, ...) times second derivatives on `curvature_pattern`."""
        p, (along, slope, x, y) = self.products, self._at(q)
        force = multipliers[p.rows]
        twice = np.where(p.first == p.second, 2.0, 1.0).reshape(-1, *(1,) * (q.ndim - 1))
        parts = [force * along * twice, force * slope * y, force * slope * x]
        parts += [-force * along * x * y] if self._d == 2 else []  # d2 d_k / d phi2 = -d_k
        return np.concatenate(parts)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return what the velocities do to the rates of the ties, shape (n_rows, ...)."""
        if not self.products.rows.size:
            return np.zeros((self._n_rows, *q.shape[1:]))
        p, (along, slope, x, y) = self.products, self._at(q)
        vx, vy, spin = v[p.first], v[p.second], v[self.turning]
        change = 2.0 * along * vx * vy + 2.0 * slope * spin * (vx * y + x * vy)
        if self._d == 2:
            change -= along * spin**2 * x * y
        return self._summed(change, q)

    def _summed(self, values: np.ndarray, q: np.ndarray) -> np.ndarray:
        found = np.zeros((self._n_rows, *q.shape[1:]))
        np.add.at(found, self.products.rows, values)
        return found

    def _at(self, q: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return ``f d``, its derivative with what it turns with, and both amplitudes, each (n_products, ...)."""
        p = self.products
        factors = p.factors.reshape(-1, *(1,) * (q.ndim - 1))
        turned = q[self.turning]
        if self._d == 3:
            along, slope = turned, np.ones_like(turned)
        else:
            parts = np.array([np.cos(turned), np.sin(turned), -np.sin(turned), np.cos(turned)])
            slopes = np.array([-np.sin(turned), np.cos(turned), -np.cos(turned), -np.sin(turned)])
            number = np.arange(p.directors.size)
            along, slope = parts[p.directors, number], slopes[p.directors, number]
        return factors * along, factors * slope, q[p.first], q[p.second]
