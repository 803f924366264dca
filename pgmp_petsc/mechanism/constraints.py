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

from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism
from pgmp_petsc.mechanism.space import PLANE


def constraint_jacobian(mechanism: Mechanism, poses: np.ndarray, clamped: Sequence[Coordinate] = ()) -> sp.csr_matrix:
    """Return C in body frames at one configuration of the rigid mechanism.

    Parameters
    ----------
    poses
        Shape (n_bodies, 3).
    clamped
        Coordinates that are held: the relative rotation of each is one more constraint, in rows after all others.

    Returns
    -------
    csr_matrix, shape (n_constraints + n_clamped + n_ties, n_dofs)
        The ties of frames to the meshes of continuum bodies come last.
    """
    rows, columns, values = [], [], []
    # joints in the plane hold at nodes, those in space at points of the rigid bodies
    held = mechanism.place(poses) if mechanism.space is PLANE else poses
    for connection in mechanism.connections:
        for dofs, block in connection.body_jacobian(poses, held):
            row, column = np.meshgrid(np.arange(connection.rows.start, connection.rows.stop), dofs, indexing="ij")
            # explicit zeros are dropped: an unknown that no constraint feels must not become a dependent one
            chosen = np.abs(block) > 1e-14
            rows.append(row[chosen])
            columns.append(column[chosen])
            values.append(block[chosen])
    for row, coordinate in enumerate(clamped, mechanism.n_constraints):
        for dofs, gradient in coordinate.body_gradient(poses):
            rows.append(np.full(dofs.size, row))
            columns.append(dofs)
            values.append(gradient)
    shape = (mechanism.n_constraints + len(clamped), mechanism.n_dofs)
    joints = sp.coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    return sp.vstack([joints, *_ties(mechanism)]).tocsr()


def _ties(mechanism: Mechanism) -> Iterator[sp.spmatrix]:
    """Yield the constraints between the frames of each meshed body and its mesh: the same at every configuration."""
    for body in mechanism.bodies:
        if body.meshed is not None:
            solid = body.meshed.solid
            means = sp.vstack([frame.functionals(solid.mesh.n_nodes) for frame in body.meshed.frames.values()]).tocoo()
            n = means.shape[0]
            nodal = body.dofs[:n]
            rows = np.concatenate([np.arange(n), means.row])
            columns = np.concatenate([nodal, body.first_internal + means.col])
            data = np.concatenate([np.ones(n), -means.data])
            yield sp.coo_matrix((data, (rows, columns)), shape=(n, mechanism.n_dofs))


@dataclass(frozen=True, eq=False)
class ConstraintHessian:
    """Second derivatives of one joint's constraints in body frames.

    Attributes
    ----------
    rows
        Numbers of the constraints, n_c of them.
    dofs
        The nodal unknowns that they depend on, shape (k,).
    values
        Shape (n_c, k, k).
    """

    rows: slice
    dofs: np.ndarray
    values: np.ndarray


def constraint_hessians(mechanism: Mechanism, poses: np.ndarray) -> list[ConstraintHessian]:
    """Return the second derivatives of the joints that are not linear, for poses (n_bodies, 3) of rigid bodies."""
    hessians, q = [], mechanism.place(poses)
    for connection in mechanism.connections:
        if not connection.linear:
            columns = connection.moving_columns
            turn = block_diag(
                *(mechanism.space.rotation(poses[side.body]) for side in connection.sides if not side.on_ground)
            )
            values = connection.hessian(q)[:, columns][:, :, columns]
            hessians.append(ConstraintHessian(connection.rows, connection.dofs, turn.T @ values @ turn))
    return hessians
