"""Constraints of second degree in natural coordinates: joints, rigid directors, and frames tied to their faces.

    c_r = g_r + sum G_ri q_i + sum B_rk q_i(k) q_j(k)

A frame (p, d_1, d_2, d_3) is tied to the nodes x_i of its faces, with their weights w_i and arms a_i
(`bodies.face_frame`), by

    p - sum_i w_i x_i = 0,    1/h sum_k d_k x (sum_i a_ik x_i) = 0,    h = int X'.X' dA / A,

the second of which is the frame's rotation less the faces' mean rotation to first order, and holds for any rotation.
Prescribed coordinates are angles, the only constraints of another kind.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.face_frame import FaceFrame
from pgmp_petsc.mechanism.natural_coordinates import JointAngle, NaturalSides, NaturalUnknowns
from pgmp_petsc.mechanism.null_space import null_space
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.spatial_attachment import SpatialAttachment
from pgmp_petsc.mechanism.spatial_joints import SpatialJoint, orthonormality

N_TIES = 6
EVEN = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]


@dataclass(frozen=True, eq=False)
class Polynomials:
    """Some polynomials of second degree.

    Attributes
    ----------
    constant
        g, shape (n,).
    linear
        Rows, unknowns and factors of G's entries.
    bilinear
        Rows, both unknowns and factors of B's entries.
    """

    constant: np.ndarray
    linear: tuple[np.ndarray, np.ndarray, np.ndarray]
    bilinear: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class QuadraticConstraints:
    """All constraints of a mechanism in space; the interface is that of `ConstraintSet`, for one sample.

    Parameters
    ----------
    unknowns
        The numbering.
    parts
        The polynomials.
    angles
        What prescribed coordinates hold, rows after all others.
    kept
        Numbers of the polynomials to take, increasing; all by default.
    """

    linear = False

    def __init__(
        self,
        unknowns: NaturalUnknowns,
        parts: Sequence[Polynomials],
        angles: Sequence[JointAngle] = (),
        kept: np.ndarray | None = None,
    ) -> None:
        self._unknowns, self._parts, self._angles = unknowns, parts, tuple(angles)
        first = np.cumsum([0, *(part.constant.size for part in parts)])
        place = np.arange(first[-1])
        if kept is not None:
            place = np.full(first[-1], -1)
            place[kept] = np.arange(kept.size)
        self._n = int(np.sum(place >= 0))
        self.n_driven = len(self._angles)
        self.n_constraints = self._n + self.n_driven
        self._constant = np.concatenate([part.constant for part in parts])[place >= 0]
        self._linear = _joined([(place[f + p.linear[0]], *p.linear[1:]) for f, p in zip(first, parts)])
        self._bilinear = _joined([(place[f + p.bilinear[0]], *p.bilinear[1:]) for f, p in zip(first, parts)])
        self._find_patterns()

    def residual(self, q: np.ndarray, driven: np.ndarray | None = None) -> np.ndarray:
        """Return c, shape (n_constraints, 1), for unknowns (n_dofs, 1); m, 1 or rad."""
        q = q[:, 0]
        (row, i, factor), (rows, j, k, factors) = self._linear, self._bilinear
        found = self._constant + np.bincount(row, factor * q[i], self._n)
        found += np.bincount(rows, factors * q[j] * q[k], self._n)
        away = np.array([angle.value(q) for angle in self._angles])
        if self.n_driven:
            away = SPATIAL.principal(away - np.ravel(driven))
        return np.concatenate([found, away])[:, None]

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the entries of C on `jacobian_pattern`, shape (n_entries, 1)."""
        q = q[:, 0]
        (_, _, factor), (_, j, k, factors) = self._linear, self._bilinear
        entries = np.concatenate([factor, factors * q[k], factors * q[j]])
        found = np.bincount(self._jacobian_places, entries, self._n_jacobian)
        return np.concatenate([found, *(angle.derivatives(q)[0] for angle in self._angles)])[:, None]

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the entries of ``sum lambda d2c/dq2`` on `curvature_pattern`, shape (n_curved, 1)."""
        rows, _, _, factors = self._bilinear
        entries = factors * multipliers[rows, 0] * self._doubled
        found = [np.bincount(self._curvature_places, entries, self._n_curved)]
        for angle, multiplier in zip(self._angles, multipliers[self._n :, 0]):
            hessian = multiplier * angle.derivatives(q[:, 0])[1]
            found.append(hessian[np.tril_indices(len(hessian))])
        return np.concatenate(found)[:, None]

    def drift(self, q: np.ndarray, v: np.ndarray, driven: np.ndarray | None = None) -> np.ndarray:
        """Return ``(dC/dt) v``, shape (n_constraints, 1); `driven` are the accelerations of prescribed coordinates."""
        rows, j, k, factors = self._bilinear
        q, v = q[:, 0], v[:, 0]
        found = np.bincount(rows, 2.0 * factors * v[j] * v[k], self._n)
        turning = [v[angle.dofs] @ angle.derivatives(q)[1] @ v[angle.dofs] for angle in self._angles]
        if self.n_driven:
            turning = np.array(turning) - np.ravel(driven)
        return np.concatenate([found, turning])[:, None]

    def independent(self, q: np.ndarray) -> QuadraticConstraints:
        """Return the constraints without those that follow from the others, as found at unknowns (n_dofs,)."""
        rows, columns = self.jacobian_pattern
        values = self.jacobian_values(q[:, None])[:, 0]
        own = (rows < self._n) & (np.abs(values) > 1e-14)  # what no constraint feels must not become dependent
        jacobian = sp.csr_matrix((values[own], (rows[own], columns[own])), shape=(self._n, self._unknowns.n_dofs))
        return QuadraticConstraints(self._unknowns, self._parts, self._angles, null_space(jacobian).rows)

    def _find_patterns(self) -> None:
        n_dofs = self._unknowns.n_dofs
        (row, i, _), (rows, j, k, _) = self._linear, self._bilinear
        keys = np.concatenate([row * n_dofs + i, rows * n_dofs + j, rows * n_dofs + k])
        unique, self._jacobian_places = np.unique(keys, return_inverse=True)
        self._n_jacobian = unique.size
        driven = [np.full(angle.dofs.size, self._n + number) for number, angle in enumerate(self._angles)]
        self.jacobian_pattern = (
            np.concatenate([unique // n_dofs, *driven]),
            np.concatenate([unique % n_dofs, *(angle.dofs for angle in self._angles)]),
        )
        unique, self._curvature_places = np.unique(np.maximum(j, k) * n_dofs + np.minimum(j, k), return_inverse=True)
        self._n_curved, self._doubled = unique.size, np.where(j == k, 2.0, 1.0)
        lower = [np.tril_indices(angle.dofs.size) for angle in self._angles]
        self.curvature_pattern = (
            np.concatenate([unique // n_dofs, *(a.dofs[i] for a, (i, _) in zip(self._angles, lower))]),
            np.concatenate([unique % n_dofs, *(a.dofs[j] for a, (_, j) in zip(self._angles, lower))]),
        )


def natural_constraints(unknowns: NaturalUnknowns) -> QuadraticConstraints:
    """Return all constraints of a mechanism, redundant ones included."""
    mechanism = unknowns.mechanism
    parts = [of_joint(unknowns, connection.joint, connection.sides) for connection in mechanism.connections]
    ground = SpatialAttachment(-1, -1, np.zeros(3))
    for node in range(mechanism.n_nodes):
        parts.append(of_joint(unknowns, orthonormality(), (ground, SpatialAttachment(0, node, np.zeros(3)))))
    parts += _ties(unknowns)
    angles = [JointAngle(unknowns, c.connection) for c in mechanism.coordinates if c.prescribed]
    return QuadraticConstraints(unknowns, parts, angles)


def of_joint(
    unknowns: NaturalUnknowns, joint: SpatialJoint, sides: tuple[SpatialAttachment, SpatialAttachment]
) -> Polynomials:
    """Return a joint's constraints between two attachments."""
    frames = NaturalSides(unknowns, sides)
    t, fixed = frames.map, frames.constant
    pulled = joint.curvature @ fixed  # (n, 24)
    constant = joint.constant + joint.slope @ fixed + 0.5 * pulled @ fixed
    slope = (joint.slope + pulled) @ t
    curvature = t.T @ joint.curvature @ t
    row, i = np.nonzero(slope)
    rows, j, k = np.nonzero(np.tril(curvature))
    factors = np.where(j == k, 0.5, 1.0) * curvature[rows, j, k]
    return Polynomials(constant, (row, frames.dofs[i], slope[row, i]), (rows, frames.dofs[j], frames.dofs[k], factors))


def _ties(unknowns: NaturalUnknowns) -> Iterator[Polynomials]:
    for body in unknowns.bodies:
        if body.meshed is not None:
            for number, frame in enumerate(body.meshed.frames.values()):
                positions = body.first_internal + 3 * frame.nodes[:, None] + np.arange(3)
                yield _tie(unknowns.frame(body.first_node + number), positions, frame)


def _tie(frame: np.ndarray, positions: np.ndarray, faces: FaceFrame) -> Polynomials:
    """Return the ties of a frame's unknowns (12,) to the positions (n, 3) of the nodes of its faces."""
    n = len(positions)
    meeting = np.repeat(np.arange(3), n)
    linear = (
        np.concatenate([np.arange(3), meeting]),
        np.concatenate([frame[:3], positions.T.ravel()]),
        np.concatenate([np.ones(3), -np.tile(faces.weights, 3)]),
    )
    arms = faces.arms / (0.5 * np.trace(faces.inertia))
    parts = []
    for c, a, b in permutations(range(3)):
        sign = 1.0 if (c, a, b) in EVEN else -1.0
        for k in np.flatnonzero(np.abs(arms).max(axis=0) > 1e-12 * np.abs(arms).max()):
            row, director = np.full(n, 3 + c), np.full(n, frame[3 + 3 * k + a])
            parts.append((row, director, positions[:, b], sign * arms[:, k]))
    return Polynomials(np.zeros(N_TIES), linear, _joined(parts))


def _joined(parts: Sequence[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    """Return columns of parts one after the other, without the rows below 0."""
    columns = tuple(np.concatenate(column) for column in zip(*parts))
    return tuple(column[columns[0] >= 0] for column in columns)
