"""Constraint Jacobians of the full-order model in body frames, at configurations of the rigid mechanism.

In body frames (`u_b = R_b^T (q_b - rho_b)` node by node) mass and stiffness do not depend on the configuration; the
constraint Jacobian alone does, through the directions in which the bodies meet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import block_diag

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.body_frames import BodyGradients
from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism
from pgmp_petsc.mechanism.statement_rows import StatementRows


class ConstraintJacobian:
    """C in body frames at configurations of the rigid mechanism, on one nonzero pattern.

    Rows are those that the joints hold in the motion, of the clamped coordinates, and of the ties of frames to the
    meshes of continuum bodies.

    Parameters
    ----------
    mechanism
        The mechanism.
    clamped
        Coordinates that are held: the statement of each is one more constraint.

    Attributes
    ----------
    pattern
        A matrix with the nonzero pattern, shape (n_held + n_clamped + n_ties, n_dofs). What no constraint feels
        at any configuration is not in it: such an unknown must not become a dependent one.
    """

    def __init__(self, mechanism: Mechanism, clamped: Sequence[Coordinate] = ()) -> None:
        held = [part for one in mechanism.holders for part in one.holding(moving=True)]
        self._gradients = BodyGradients(mechanism, held + [(c.statement, c.sides) for c in clamped])
        rows, columns = self._gradients.rows, self._gradients.dofs
        self._order = np.lexsort((columns, rows))
        ones, shape = np.ones(rows.size), (self._gradients.n, mechanism.n_dofs)
        joints = sp.csr_matrix((ones, (rows, columns)), shape=shape)
        self.pattern = sp.vstack([joints, *_ties(mechanism)]).tocsr()

    def values(self, poses: np.ndarray) -> np.ndarray:
        """Return the entries on the pattern at poses (n_bodies, n_pose), shape (n_entries,)."""
        values = self.pattern.data.copy()
        values[: self._order.size] = self._gradients.values(poses)[self._order]
        return values

    def at(self, poses: np.ndarray) -> sp.csr_matrix:
        """Return C at poses (n_bodies, n_pose)."""
        pattern = self.pattern
        return sp.csr_matrix((self.values(poses), pattern.indices, pattern.indptr), shape=pattern.shape)


def constraint_jacobian(mechanism: Mechanism, poses: np.ndarray, clamped: Sequence[Coordinate] = ()) -> sp.csr_matrix:
    """Return C at one configuration, poses (n_bodies, n_pose)."""
    return ConstraintJacobian(mechanism, clamped).at(poses)


def _ties(mechanism: Mechanism) -> Iterator[sp.spmatrix]:
    """Yield the constraints between the frames of each meshed body and its mesh: the same at every configuration."""
    for body in mechanism.bodies:
        if body.face_frames:
            n_points = len(body.points)
            means = sp.vstack([frame.functionals(n_points) for frame in body.face_frames.values()]).tocoo()
            n = means.shape[0]
            nodal = body.dofs[:n]
            rows = np.concatenate([np.arange(n), means.row])
            columns = np.concatenate([nodal, body.first_internal + means.col])
            data = np.concatenate([np.ones(n), -means.data])
            yield sp.coo_matrix((data, (rows, columns)), shape=(n, mechanism.n_dofs))


@dataclass(frozen=True, eq=False)
class ConstraintHessian:
    """Second derivatives of the constraints of one joint or coupling, or of a clamped coordinate, in body frames."""

    rows: slice  # numbers of the constraints, n_c of them
    dofs: np.ndarray  # the nodal unknowns that they depend on, shape (k,)
    values: np.ndarray  # shape (n_c, k, k)


class ConstraintHessians:
    """Second derivatives of joints and clamped coordinates that are not linear, in body frames, at configurations of
    the rigid mechanism.

    With the frames ``z(u)`` of the nodes in their displacements u these are ``F^T h F + g.z''``, F the frames'
    gradient, and g and h the derivatives of a statement in the frames; z'' is zero in the plane.
    """

    def __init__(self, mechanism: Mechanism, clamped: Sequence[Coordinate] = ()) -> None:
        self._mechanism = mechanism
        n_pose = mechanism.space.n_pose
        self._joints: list[tuple[slice, list[Attachment], StatementRows]] = []
        first = 0
        held = [one.holding(moving=True) for one in mechanism.holders]
        for parts in [*held, *([(c.statement, c.sides)] for c in clamped)]:
            numbered = slice(first, first := first + len(parts))
            moving = list({side.node: side for _, own in parts for side in own if not side.on_ground}.values())
            numbers = {side.node: n_pose * k for k, side in enumerate(moving)}
            rows = StatementRows(
                [part for part, _ in parts],
                [sides for _, sides in parts],
                lambda node, numbers=numbers: numbers.get(node, 0) + np.arange(n_pose),
                mechanism.space.dimension,
            )
            if parts and (rows.curvature_pattern[0].size or mechanism.space.n_tied):
                self._joints.append((numbered, moving, rows))

    def at(self, poses: np.ndarray) -> list[ConstraintHessian]:
        """Return them at poses (n_bodies, n_pose)."""
        return [self._of_joint(*joint, poses) for joint in self._joints]

    def _of_joint(
        self, numbered: slice, moving: list[Attachment], rows: StatementRows, poses: np.ndarray
    ) -> ConstraintHessian:
        space = self._mechanism.space
        at = [poses[side.body] for side in moving]
        places = [space.place(pose, (side.point - side.arm)[None])[0] for pose, side in zip(at, moving)]
        slopes, values = rows.dense(np.concatenate(places))
        turn = block_diag(*(space.frame_gradient(pose) for pose in at))
        curved = turn.T @ values @ turn
        for k, pose in enumerate(at):
            own = slice(space.n_dofs * k, space.n_dofs * (k + 1))
            curved[:, own, own] += space.frame_curvature(pose, slopes[:, space.n_pose * k : space.n_pose * (k + 1)])
        dofs = np.concatenate([self._mechanism.node_dofs(side.node) for side in moving])
        return ConstraintHessian(numbered, dofs, curved)
