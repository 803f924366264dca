"""What ties the frames of groups of faces to the mesh: mean position and mean rotation, see `bodies.face_frame`.

With a frame (p, d_1 .. d_d), the nodes' positions x_i, their weights w_i and arms a_i,

    p - sum_i w_i x_i = 0,    1/h sum_k (sum_i a_ik x_i) x d_k = 0,    h = int X'.X' dA / A,

the second of which is the frame's rotation less the faces' mean rotation to first order, and holds for any rotation.
Every row is a sum of products f d_kc x_ie; in the plane ``(x, y, phi)`` give the directors, with ``d d_k / d phi = J
d_k``, J a right angle's rotation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.face_frame import FaceFrame
from pgmp_petsc.mechanism.unknowns import Unknowns
from pgmp_petsc.runtime.compiled import njit

PLANES = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}  # of rotations, in their order
PHI = 2  # a frame's rotation in the plane


class Products(NamedTuple):
    """Products ``f d x``.

    Attributes
    ----------
    rows
        Of each product, shape (n,).
    frames
        First unknown of its frame.
    directors
        Number of its component of a director among the frame's d d.
    positions
        The unknown x.
    factors
        f.
    """

    rows: np.ndarray
    frames: np.ndarray
    directors: np.ndarray
    positions: np.ndarray
    factors: np.ndarray


class FrameTies:
    """The ties of all frames of bodies on meshes; the interface is that of `StatementRows`."""

    def __init__(self, unknowns: Unknowns) -> None:
        self._d = unknowns.dimension
        found = list(_ties_of(unknowns))
        n_each = self._d + len(PLANES[self._d])
        self.n = n_each * len(found)
        linear, products = [], []
        for number, (frame, positions, faces) in enumerate(found):
            linear.append(_means(n_each * number, frame, positions, faces))
            products.append(_rotations(n_each * number + self._d, frame[0], positions, faces))
        empty = np.zeros(0, dtype=np.int64)
        self._linear = _joined([(empty, empty, np.zeros(0)), *linear])
        self._products = Products(*_joined([(empty,) * 4 + (np.zeros(0),), *products]))
        self._find_patterns(unknowns.n_dofs)

    @property
    def linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows, unknowns and factors of the entries that are linear, each (n_linear,)."""
        return self._linear

    @property
    def turning(self) -> np.ndarray:
        """The unknown of its frame that every product depends on, shape (n_products,)."""
        return self._products.frames + (PHI if self._d == 2 else self._d + self._products.directors)

    @property
    def products(self) -> Products:
        """The products."""
        return self._products

    def values(self, q: np.ndarray) -> np.ndarray:
        """Return what is to be zero, shape (n, ...), m and rad, for unknowns (n_dofs, ...)."""
        return self._filled(_values, self.n, q)

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        return self._filled(_jacobian, self.jacobian_pattern[0].size, q)

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the sum of multipliers (n, ...) times second derivatives on `curvature_pattern`."""
        return self._filled(_curvature, self.curvature_pattern[0].size, q, multipliers)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return what the velocities do to the rates of the ties, shape (n, ...)."""
        return self._filled(_drift, self.n, q, v)

    def _filled(self, fill, size: int, *arrays: np.ndarray) -> np.ndarray:
        trailing = arrays[0].shape[1:]
        n = math.prod(trailing)
        flat = [np.ascontiguousarray(array.reshape(len(array), n)) for array in arrays]
        result = np.zeros((size, n))
        fill(self._d, self._linear, self._products, self._places, *flat, result)
        return result.reshape(size, *trailing)

    def _find_patterns(self, n_dofs: int) -> None:
        (row, column, _), p = self._linear, self._products
        turning = self.turning
        keys = np.concatenate([row * n_dofs + column, p.rows * n_dofs + p.positions, p.rows * n_dofs + turning])
        unique, at = np.unique(keys, return_inverse=True)
        self.jacobian_pattern = unique // n_dofs, unique % n_dofs
        of_linear, of_position, of_director = np.split(at, [row.size, row.size + p.rows.size])
        keys = [np.maximum(turning, p.positions) * n_dofs + np.minimum(turning, p.positions)]
        if self._d == 2:
            keys.append(turning * n_dofs + turning)
        unique, at = np.unique(np.concatenate(keys), return_inverse=True)
        self.curvature_pattern = unique // n_dofs, unique % n_dofs
        mixed, twice = at[: p.rows.size], at[p.rows.size :] if self._d == 2 else at[:0]
        self._places = of_linear, of_position, of_director, mixed, twice


def _ties_of(unknowns: Unknowns) -> Iterator[tuple[np.ndarray, np.ndarray, FaceFrame]]:
    """Yield, frame by frame, its unknowns (m,), those of the positions of its faces' nodes (n, d), and the faces."""
    d = unknowns.dimension
    for body in unknowns.bodies:
        if body.meshed is not None:
            for number, faces in enumerate(body.meshed.frames.values()):
                positions = body.first_internal + d * faces.nodes[:, None] + np.arange(d)
                yield unknowns.frame(body.first_node + number), positions, faces


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
    for row, plane in enumerate(PLANES[d], first_row):
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
def _values(d, linear, products, places, q, result):
    rows, columns, factors = linear
    for sample in range(q.shape[1]):
        for e in range(rows.size):
            result[rows[e], sample] += factors[e] * q[columns[e], sample]
        for e in range(products.rows.size):
            component, _ = director(d, products, e, q, sample)
            result[products.rows[e], sample] += products.factors[e] * component * q[products.positions[e], sample]


@njit(cache=True, error_model="numpy")
def _jacobian(d, linear, products, places, q, result):
    of_linear, of_position, of_director, _, _ = places
    for sample in range(q.shape[1]):
        for e in range(of_linear.size):
            result[of_linear[e], sample] += linear[2][e]
        for e in range(products.rows.size):
            component, slope = director(d, products, e, q, sample)
            along = products.factors[e] * q[products.positions[e], sample]
            result[of_position[e], sample] += products.factors[e] * component
            result[of_director[e], sample] += along * (slope if d == 2 else 1.0)


@njit(cache=True, error_model="numpy")
def _curvature(d, linear, products, places, q, multipliers, result):
    _, _, _, mixed, twice = places
    for sample in range(q.shape[1]):
        for e in range(products.rows.size):
            component, slope = director(d, products, e, q, sample)
            factor = products.factors[e] * multipliers[products.rows[e], sample]
            result[mixed[e], sample] += factor * (slope if d == 2 else 1.0)
            if d == 2:  # d2 d_k / d phi2 = -d_k
                result[twice[e], sample] -= factor * component * q[products.positions[e], sample]


@njit(cache=True, error_model="numpy")
def _drift(d, linear, products, places, q, v, result):
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
