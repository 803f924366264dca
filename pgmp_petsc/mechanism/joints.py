"""Joints between two frames ``(x, y, phi)``, fixed to a node of a body or to the ground.

Each joint gives constraints ``c(a, b) = 0`` of the two frames a and b it connects, with first and second derivatives in
the six frame unknowns. The full-order model applies them to nodes, the rigid kinematics to points of rigid bodies;
there is one formula for both. Trailing axes of the frames (samples, configurations) are kept.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

N_FRAME = 3
N_PAIR = 2 * N_FRAME


class Joint(Protocol):
    """Constraints of a pair of frames."""

    n_constraints: int
    linear: bool  # in the frame unknowns: constant Jacobian, no Hessian
    lengths: np.ndarray  # which constraints are measured by the mechanism's size, shape (n_constraints,)

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return c, shape (n_constraints, ...), for frames of shape (3, ...)."""

    def jacobian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return dc/d(a, b), shape (n_constraints, 6, ...)."""

    def hessian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the second derivatives of c, shape (n_constraints, 6, 6, ...)."""


class _SharedUnknowns:
    """Frames that have some of their unknowns in common: ``b_i - a_i`` for each of them, m or rad; linear."""

    linear = True
    unknowns: tuple[int, ...]

    @property
    def n_constraints(self) -> int:
        """Number of constraints."""
        return len(self.unknowns)

    @property
    def lengths(self) -> np.ndarray:
        """All constraints: rotations are held as strictly as lengths."""
        return np.ones(len(self.unknowns), dtype=bool)

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the differences, m and rad."""
        chosen = list(self.unknowns)
        return b[chosen] - a[chosen]

    def jacobian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the constant Jacobian."""
        jacobian = np.zeros((self.n_constraints, N_PAIR, *a.shape[1:]))
        for row, unknown in enumerate(self.unknowns):
            jacobian[row, unknown] = -1.0
            jacobian[row, N_FRAME + unknown] = 1.0
        return jacobian

    def hessian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return zeros."""
        return np.zeros((self.n_constraints, N_PAIR, N_PAIR, *a.shape[1:]))


class Revolute(_SharedUnknowns):
    """Equal positions: ``x_a = x_b``, ``y_a = y_b``."""

    unknowns = (0, 1)


class Fixed(_SharedUnknowns):
    """Equal positions and a fixed relative rotation: ``x_a = x_b``, ``y_a = y_b``, ``phi_b - phi_a = angle`` (rad)."""

    unknowns = (0, 1, 2)

    def __init__(self, angle: float) -> None:
        self._angle = angle

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return ``b - a``, the angle taken off, m and rad."""
        gap = super().residual(a, b)
        gap[2] -= self._angle
        return gap


class Driver(_SharedUnknowns):
    """The relative rotation ``phi_b - phi_a``, to be held at a given angle by whoever takes its residual."""

    unknowns = (2,)


class PointOnLine:
    """Point b stays on a line through a: ``n(phi_a) . (b - a) = 0``, n normal to the line.

    The line turns with frame a when a belongs to a body (``turning``); on the ground it is fixed and the constraint is
    linear.
    """

    n_constraints = 1
    lengths = np.array([True])

    def __init__(self, direction: tuple[float, float], turning: bool) -> None:
        self._direction = np.asarray(direction, dtype=float) / np.hypot(*direction)
        self.linear = not turning

    @property
    def direction(self) -> tuple[float, float]:
        """Unit direction of the line in the frame of a."""
        return float(self._direction[0]), float(self._direction[1])

    def line(self, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the line's unit direction and normal, each of shape (2, ...)."""
        angle = np.zeros_like(a[2]) if self.linear else a[2]
        cos, sin = np.cos(angle), np.sin(angle)
        dx, dy = self._direction
        direction = np.array([cos * dx - sin * dy, sin * dx + cos * dy])
        return direction, np.array([-direction[1], direction[0]])

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the distance of b from the line, m."""
        _, normal = self.line(a)
        return np.sum(normal * (b[:2] - a[:2]), axis=0)[None]

    def jacobian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return dc/d(a, b); ``dn/dphi = -direction``."""
        direction, normal = self.line(a)
        jacobian = np.zeros((1, N_PAIR, *a.shape[1:]))
        jacobian[0, 0:2] = -normal
        jacobian[0, 3:5] = normal
        if not self.linear:
            jacobian[0, 2] = -np.sum(direction * (b[:2] - a[:2]), axis=0)
        return jacobian

    def hessian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the second derivatives, zero where the line is fixed."""
        hessian = np.zeros((1, N_PAIR, N_PAIR, *a.shape[1:]))
        if not self.linear:
            direction, normal = self.line(a)
            hessian[0, 0:2, 2] = hessian[0, 2, 0:2] = direction
            hessian[0, 3:5, 2] = hessian[0, 2, 3:5] = -direction
            hessian[0, 2, 2] = -np.sum(normal * (b[:2] - a[:2]), axis=0)
        return hessian
