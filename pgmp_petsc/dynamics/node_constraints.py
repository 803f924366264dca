"""Constraints between nodes of bodies in the plane, compiled: what joints demand and what drives prescribe.

    c = s(y_a, y_b) - target - driven(t) = 0

with a statement s (`mechanism.node_statements`) in the unknowns y of two nodes. Statements that are linear in them, all
at nodes but the lines that turn, are a row of numbers; the others are evaluated for every sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.batched_ldl import Symbolic
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.connection import Connection
from pgmp_petsc.mechanism.constraints import constraint_jacobian
from pgmp_petsc.mechanism.joints import N_FRAME, N_PAIR, PointOnLine
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.node_statements import NodeStatements, scratch_of, state
from pgmp_petsc.mechanism.null_space import null_space
from pgmp_petsc.mechanism.statements import ALONG, ANGLE, MEET, Statement
from pgmp_petsc.runtime.compiled import njit


class NodeConstraints(NamedTuple):
    """Constraints on pairs of nodes, as compiled functions take them.

    Attributes
    ----------
    statements
        What has to be zero, n of them.
    dofs
        Unknowns of both nodes, -1 on the ground, shape (n, 6).
    targets
        What is taken off, shape (n,), m or rad.
    motions
        Number of the prescribed motion that is taken off too, -1 where there is none, shape (n,).
    linear
        Whether a statement is linear in the unknowns, shape (n,).
    gradients, offsets
        Derivatives of those that are, shape (n, 6), and their values where all unknowns are zero, shape (n,).
    """

    statements: NodeStatements
    dofs: np.ndarray
    targets: np.ndarray
    motions: np.ndarray
    linear: np.ndarray
    gradients: np.ndarray
    offsets: np.ndarray


class ConstraintEntries(NamedTuple):
    """Where the entries of constraint k go: those from ``starts[k]`` to ``starts[k + 1]``, and likewise of its
    curvature.

    Attributes
    ----------
    starts, columns, positions
        Entries of C: number among the six unknowns, and where the matrix stores them.
    curved_starts, curved_rows, curved_columns, curved_positions
        Entries of ``lambda d2c/dy2``, one of each symmetric pair.
    """

    starts: np.ndarray
    columns: np.ndarray
    positions: np.ndarray
    curved_starts: np.ndarray
    curved_rows: np.ndarray
    curved_columns: np.ndarray
    curved_positions: np.ndarray


def node_constraints(kinematics: RigidKinematics, theta: np.ndarray) -> NodeConstraints:
    """Return the constraints of a mechanism in the plane without those that follow from the others at theta (n_theta,).

    Those of prescribed motions are the last.
    """
    mechanism = kinematics.mechanism
    jacobian = constraint_jacobian(mechanism, kinematics.poses(theta)[..., 0])
    kept = null_space(jacobian).rows
    driven = mechanism.driven_connections(jacobian.shape[0])
    every = [item for connection in (*mechanism.connections, *driven) for item in _statements_of(connection)]
    chosen = [every[k] for k in (*kept, *range(jacobian.shape[0], len(every)))]
    parts, targets, sides = zip(*chosen)
    statements = NodeStatements.of(parts, sides, dimension=2)
    dofs = np.array([np.concatenate([_dofs(a), _dofs(b)]) for a, b in sides])
    motions = np.maximum(np.arange(len(chosen)) - len(kept), -1)
    linear = np.array([_is_linear(part, *pair) for part, pair in zip(parts, sides)])
    offsets, gradients, _ = _evaluated(statements, np.zeros((len(chosen), N_PAIR)))
    return NodeConstraints(statements, dofs, np.array(targets), motions, linear, gradients, offsets)


def entry_pattern(constraints: NodeConstraints) -> tuple[np.ndarray, ...]:
    """Return constraint and unknown of the entries of C, and constraint, row and column of those of the curvature.

    Unknowns are numbered 0 to 5 in the two nodes of a constraint. An entry is one that is not zero in two states of no
    symmetry.
    """
    moving = constraints.dofs >= 0
    first, second = (np.outer(np.ones(len(moving)), np.linspace(*ends, N_PAIR)) for ends in ((0.1, 0.7), (1.3, 0.2)))
    (_, g_one, h_one), (_, g_two, h_two) = (_evaluated(constraints.statements, y) for y in (first, second))
    rows, columns = np.nonzero(((g_one != 0.0) | (g_two != 0.0)) & moving)
    curved = ((h_one != 0.0) | (h_two != 0.0)) & moving[:, :, None] & moving[:, None, :]
    curved &= ~constraints.linear[:, None, None]
    return rows, columns, *(np.ascontiguousarray(part) for part in np.nonzero(np.tril(curved)))


def place_entries(constraints: NodeConstraints, n_dofs: int, symbolic: Symbolic) -> ConstraintEntries:
    """Return where the matrix stores all entries; multiplier k is the unknown ``n_dofs + k``."""
    rows, columns, owner, i, j = entry_pattern(constraints)
    starts, curved_starts = (np.searchsorted(part, np.arange(len(constraints.dofs) + 1)) for part in (rows, owner))
    positions = symbolic.position(n_dofs + rows, constraints.dofs[rows, columns])
    curved = symbolic.position(constraints.dofs[owner, i], constraints.dofs[owner, j])
    return ConstraintEntries(starts, columns, positions, curved_starts, i, j, curved)


def _statements_of(connection: Connection) -> list[tuple[Statement, float, tuple[Attachment, Attachment]]]:
    """Return the statements of a joint, what is taken off each, and its sides."""
    joint, still = connection.joint, np.zeros(N_FRAME)
    targets = -joint.residual(still, still)
    axes = np.zeros((joint.n_constraints, 3, 2))
    if isinstance(joint, PointOnLine):
        along = joint.direction
        axes[0, 0] = -along[1], along[0]
        kinds = [ALONG]
    else:
        kinds = [ANGLE if unknown == 2 else MEET for unknown in joint.unknowns]
        for row, unknown in zip(axes, joint.unknowns):
            if unknown == 2:
                row[:] = [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]
            else:
                row[0, unknown] = 1.0
    return [
        (Statement(kind, row), float(target), connection.sides) for kind, row, target in zip(kinds, axes, targets)
    ]


def _is_linear(part: Statement, a: Attachment, b: Attachment) -> bool:
    if part.kind == ANGLE:
        return True
    at_nodes = all(side.on_ground or side.at_node for side in (a, b))
    return at_nodes and (part.kind == MEET or a.on_ground)


def _dofs(side: Attachment) -> np.ndarray:
    return np.full(N_FRAME, -1) if side.on_ground else side.dofs


@njit(cache=True, error_model="numpy")
def _evaluated(statements, y):
    """Return all statements (n,), their gradients (n, 6) and second derivatives (n, 6, 6) at y, shape (n, 6)."""
    n, m = y.shape
    values, gradients, hessians = np.empty(n), np.zeros((n, m)), np.zeros((n, m, m))
    scratch = scratch_of(statements, m // 2)
    for k in range(n):
        values[k] = state(statements, k, y[k], 0.0, True, scratch, gradients[k], hessians[k])
    return values, gradients, hessians


@njit(cache=True, error_model="numpy")
def drift_of(constraints, q, v, accelerations):
    """Return ``(dC/dt) v``, what is left of c'' at zero acceleration, shape (n_blocks, n, n_lanes).

    q and v have the shape (n_blocks, n_dofs, n_lanes), and `accelerations` are those of the motions, (n_motions,).
    """
    n, m = constraints.dofs.shape
    drift = np.zeros((q.shape[0], n, q.shape[2]))
    scratch = scratch_of(constraints.statements, m // 2)
    y, rate, g, h = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros((m, m))
    for block in range(q.shape[0]):
        for k in range(n):
            for lane in range(q.shape[2]):
                if constraints.motions[k] >= 0:
                    drift[block, k, lane] -= accelerations[constraints.motions[k]]
                if constraints.linear[k]:
                    continue
                for i in range(m):
                    dof = constraints.dofs[k, i]
                    y[i], rate[i] = (q[block, dof, lane], v[block, dof, lane]) if dof >= 0 else (0.0, 0.0)
                state(constraints.statements, k, y, 0.0, True, scratch, g, h)
                for i in range(m):
                    for j in range(m):
                        drift[block, k, lane] += h[i, j] * rate[i] * rate[j]
    return drift


@njit(cache=True, error_model="numpy")
def add_constraints(
    constraints, entries, driven, residual, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower
):  # fmt: skip
    """Add ``C^T lambda`` and ``s c`` to x, and ``s C`` and ``gain_k lambda d2c/dq2`` to the matrix.

    Parameters
    ----------
    driven
        Angles of the motions now, shape (n_motions,), rad.
    residual
        What stands for c, shape (n, n_lanes), or (0, n_lanes) for c itself.
    q, multipliers
        Shapes (n_dofs, n_lanes) and (n, n_lanes).
    scale
        Of the constraints, shape (n_lanes,).
    gain_k, fresh
        Factor of the curvature, and whether the matrix is wanted.
    x, place, diagonal, lower
        Right-hand side in elimination order, the turn of each unknown, and the matrix.
    """
    n, m = constraints.dofs.shape
    n_dofs, n_lanes = q.shape
    scratch = scratch_of(constraints.statements, m // 2)
    y, g, h, missed = np.zeros(m), np.zeros(m), np.zeros((m, m)), np.zeros(n_lanes)
    for k in range(n):
        goal = constraints.targets[k]
        if constraints.motions[k] >= 0:
            goal += driven[constraints.motions[k]]
        entry_range = range(entries.starts[k], entries.starts[k + 1])
        if constraints.linear[k]:
            for lane in range(n_lanes):
                missed[lane] = constraints.offsets[k] - goal
            for entry in entry_range:
                i = entries.columns[entry]
                slope, dof = constraints.gradients[k, i], constraints.dofs[k, i]
                at, position = place[dof], entries.positions[entry]
                for lane in range(n_lanes):
                    missed[lane] += slope * q[dof, lane]
                    x[at, lane] += slope * multipliers[k, lane]
                if fresh:
                    for lane in range(n_lanes):
                        lower[position, lane] += slope * scale[lane]
        else:
            for lane in range(n_lanes):
                for i in range(m):
                    dof = constraints.dofs[k, i]
                    y[i] = q[dof, lane] if dof >= 0 else 0.0
                missed[lane] = state(constraints.statements, k, y, 0.0, fresh, scratch, g, h) - goal
                for entry in entry_range:
                    i = entries.columns[entry]
                    x[place[constraints.dofs[k, i]], lane] += g[i] * multipliers[k, lane]
                    if fresh:
                        lower[entries.positions[entry], lane] += g[i] * scale[lane]
                for entry in range(entries.curved_starts[k], entries.curved_starts[k + 1] if fresh else 0):
                    bent = gain_k * multipliers[k, lane] * h[entries.curved_rows[entry], entries.curved_columns[entry]]
                    position = entries.curved_positions[entry]
                    if position < 0:
                        diagonal[-1 - position, lane] += bent
                    else:
                        lower[position, lane] += bent
        row = place[n_dofs + k]
        for lane in range(n_lanes):
            x[row, lane] += scale[lane] * (missed[lane] if residual.shape[0] == 0 else residual[k, lane])
