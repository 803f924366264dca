"""Scalar statements about two frames, in the plane and in space: what joints, coordinates and effects are made of.

A frame is ``zeta = (p, d_1 .. d_d)``, a position and the directors of a body: 6 numbers in the plane, 12 in space. With
directions ``u_a = sum_k u_k d_k`` that are fixed in a frame, a statement s of two frames a and b is one of

=================== ================================================================================================
``MEET``            ``u . (p_b - p_a)`` with u fixed in the ground
``PERPENDICULAR``   ``u_a . w_b``
``WITHIN``          ``v_b . w_b``, constant while b stays rigid
``ALONG``           ``u_a . (p_b - p_a)``
``ANGLE``           ``atan2(v_a . w_b, u_a . w_b)``, the turn that is nearest to one that is known
``DISTANCE``        ``|p_b - p_a|``; where the points meet it has no direction, and its gradient is taken as zero
``FOLLOWING``       no measure but a direction: the gradient is ``w_b`` on p_b, for a force that turns with its body
=================== ================================================================================================

with the gradient and the second derivatives in the 2 d (d + 1) numbers of both frames. Zero is what a joint demands; a
law of s and s' (`effects.laws`) is a force on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.runtime.compiled import njit
from pgmp_petsc.runtime.lane_items import angle_of, beyond, nearest_whole, select, square_root

MEET, PERPENDICULAR, WITHIN, ALONG, ANGLE, DISTANCE, FOLLOWING = range(7)
U, V, W = range(3)  # rows of a statement's directions


@dataclass(frozen=True, eq=False)
class Statement:
    """A statement about two frames.

    Attributes
    ----------
    kind
        One of the module's table.
    axes
        The directions u, v and w, shape (3, d), in the frames that the kind says; zero where it has none.
    """

    kind: int
    axes: np.ndarray

    @property
    def is_length(self) -> bool:
        """Whether it is measured in m; others are cosines or rad."""
        return self.kind not in (PERPENDICULAR, WITHIN, ANGLE)

    @property
    def fixed_in_bodies(self) -> bool:
        """Whether its gradient keeps its direction in the frames, however they stand."""
        return self.kind in (ANGLE, FOLLOWING)

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


def _statement(kind: int, **directions: np.ndarray) -> Statement:
    axes = np.zeros((3, len(next(iter(directions.values())))))
    for name, direction in directions.items():
        axes["uvw".index(name)] = direction
    return Statement(kind, axes)


@njit(cache=True, error_model="numpy")
def _evaluate_all(kind, axes, z, turned, values, gradients, hessians):
    """Evaluate a statement at pairs of frames, the columns of z; derivatives without columns are not wanted."""
    gradient, hessian, spare = np.empty(z.shape[0]), np.empty((z.shape[0], z.shape[0])), np.empty(z.shape[0])
    first, second = gradients.shape[1] > 0, hessians.shape[2] > 0
    for k in range(z.shape[1]):
        values[k] = evaluate(kind, axes, z[:, k].copy(), turned[k], second, gradient, hessian, spare)
        if first:
            gradients[:, k] = gradient
        if second:
            hessians[:, :, k] = hessian


@njit(cache=True, apart=lambda kind, axes, z, *_: z.dtype, error_model="numpy")
def evaluate(kind, axes, z, turned, second, gradient, hessian, spare):
    """Evaluate a statement, of numbers or of vectors (`lane_items`).

    Parameters
    ----------
    kind, axes
        As in `Statement`.
    z
        Both frames, shape (2 d (d + 1),): m and 1.
    turned
        What an ``ANGLE`` is nearest to, rad.
    second
        Whether second derivatives are wanted.
    gradient, hessian
        Results: g, shape (2 d (d + 1),), and ``dg_i/dz_j``; symmetric but for ``FOLLOWING``.
    spare
        Work array, shape (2 d (d + 1),).

    Returns
    -------
    float
        s, m, 1 or rad.
    """
    d = axes.shape[1]
    n = d * (d + 1)
    for i in range(2 * n):
        gradient[i] = 0.0
        for j in range(2 * n if second else 0):
            hessian[i, j] = 0.0
    if kind == DISTANCE:
        return _distance(z, d, n, second, gradient, hessian)
    if kind == ANGLE:
        return _angle(axes, z, d, n, turned, second, gradient, hessian, spare)
    s = 0.0 * z[0]
    if kind == MEET:
        for c in range(d):
            gradient[c], gradient[n + c] = -axes[U, c], axes[U, c]
            s += axes[U, c] * (z[n + c] - z[c])
        return s
    if kind == WITHIN:
        return _within(axes, z, d, n, second, gradient, hessian)
    for k in range(d):
        u, w = axes[U, k], axes[W, k]
        for c in range(d):
            in_a, in_b = d + d * k + c, n + d + d * k + c  # component c of director k
            if kind == FOLLOWING:
                gradient[n + c] += w * z[in_b]
                if second:
                    hessian[n + c, in_b] = w
            elif kind == ALONG:
                s += u * z[in_a] * (z[n + c] - z[c])
                gradient[in_a] = u * (z[n + c] - z[c])
                gradient[c] -= u * z[in_a]
                gradient[n + c] += u * z[in_a]
                if second:
                    hessian[c, in_a] = hessian[in_a, c] = -u
                    hessian[n + c, in_a] = hessian[in_a, n + c] = u
            else:  # PERPENDICULAR
                for j in range(d):
                    other = n + d + d * j + c
                    s += u * axes[W, j] * z[in_a] * z[other]
                    gradient[in_a] += u * axes[W, j] * z[other]
                    gradient[other] += u * axes[W, j] * z[in_a]
                    if second:
                        hessian[in_a, other] = hessian[other, in_a] = u * axes[W, j]
    return s


@njit(cache=True, error_model="numpy")
def _within(axes, z, d, n, second, gradient, hessian):
    """Evaluate ``v_b . w_b = sum v_k w_j d_k . d_j``."""
    s = 0.0 * z[0]
    for k in range(d):
        for j in range(d):
            factor = axes[V, k] * axes[W, j]
            if factor != 0.0:
                for c in range(d):
                    one, other = n + d + d * k + c, n + d + d * j + c
                    s += factor * z[one] * z[other]
                    gradient[one] += factor * z[other]
                    gradient[other] += factor * z[one]
                    if second:
                        hessian[one, other] += factor
                        hessian[other, one] += factor
    return s


@njit(cache=True, error_model="numpy")
def _distance(z, d, n, second, gradient, hessian):
    """Evaluate ``|r|``, r = p_b - p_a: the gradient e = r / |r|, and ``(1 - e e^T) / |r|``."""
    square = 0.0 * z[0]
    for c in range(d):
        square += (z[n + c] - z[c]) * (z[n + c] - z[c])
    length = square_root(square)
    apart = beyond(length, 0.0)
    for i in range(d):
        e = select(apart, (z[n + i] - z[i]) / length, 0.0)
        gradient[i], gradient[n + i] = -e, e
        for j in range(d if second else 0):
            across = ((1.0 if i == j else 0.0) - e * (z[n + j] - z[j]) / length) / length
            across = select(apart, across, 0.0)
            hessian[i, j] = hessian[n + i, n + j] = across
            hessian[i, n + j] = hessian[n + i, j] = -across
    return length


@njit(cache=True, error_model="numpy")
def _angle(axes, z, d, n, turned, second, gradient, hessian, stretch):
    """Evaluate the angle: with ``(cos, sin) = r (u_a . w_b, v_a . w_b)`` and its gradient g, and m that of ``log r``,
    its second derivatives are ``(cos d2 sin - sin d2 cos) / r - g m^T - m g^T``."""
    cos, sin = 0.0 * z[0], 0.0 * z[0]
    for c in range(d):
        w = _component(axes, W, z, n, d, c)
        cos += _component(axes, U, z, 0, d, c) * w
        sin += _component(axes, V, z, 0, d, c) * w
    found, r = angle_of(sin, cos), square_root(cos * cos + sin * sin)
    cos, sin = cos / r, sin / r
    for c in range(d):
        u, v = _component(axes, U, z, 0, d, c), _component(axes, V, z, 0, d, c)
        w = _component(axes, W, z, n, d, c)
        for k in range(d):
            in_a, in_b = d + d * k + c, n + d + d * k + c
            across, level = cos * axes[V, k] - sin * axes[U, k], cos * axes[U, k] + sin * axes[V, k]
            gradient[in_a], stretch[in_a] = across * w / r, level * w / r
            gradient[in_b] = axes[W, k] * (cos * v - sin * u) / r
            stretch[in_b] = axes[W, k] * (cos * u + sin * v) / r
            for j in range(d if second else 0):
                other = n + d + d * j + c
                hessian[in_a, other] = hessian[other, in_a] = across * axes[W, j] / r
    for i in range(2 * d * d if second else 0):
        one = d + i if i < d * d else n + d + i - d * d
        for j in range(2 * d * d):
            other = d + j if j < d * d else n + d + j - d * d
            hessian[one, other] -= gradient[one] * stretch[other] + stretch[one] * gradient[other]
    whole = 2.0 * np.pi
    return found + whole * nearest_whole((turned - found) / whole)


@njit(inline="always")
def _component(axes, direction, z, first, d, c):
    """Return component c of a direction that is fixed in the frame that begins at `first`."""
    total = 0.0 * z[0]
    for k in range(d):
        total += axes[direction, k] * z[first + d + d * k + c]
    return total
