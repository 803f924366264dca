"""Constraints between nodes in a batch of samples, compiled: what joints demand and what drives prescribe.

    c = s(y_a, y_b) - wanted - driven(t) = 0

with a statement s in the unknowns y of two nodes (`mechanism.statement_rows`). Statements that are linear in them, all
at nodes but the lines that turn, are a row of numbers; the others are evaluated for every sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.batched_ldl import Symbolic
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.node_statements import scratch_of, state
from pgmp_petsc.mechanism.statement_rows import Rows
from pgmp_petsc.runtime.compiled import njit


class NodeConstraints(NamedTuple):
    """Constraints on pairs of nodes, as compiled functions take them.

    Attributes
    ----------
    rows
        The statements, n of them.
    wanted
        What is taken off, shape (n,), m, 1 or rad.
    motions
        Number of the prescribed motion that is taken off too, -1 where there is none, shape (n,).
    linear
        Whether a statement is linear in the unknowns, shape (n,).
    positions, curved_positions
        Where the matrix stores the first derivatives, and the second ones of those that are not.
    """

    rows: Rows
    wanted: np.ndarray
    motions: np.ndarray
    linear: np.ndarray
    positions: np.ndarray
    curved_positions: np.ndarray

    @classmethod
    def of(cls, constraints: ConstraintSet, n_dofs: int, symbolic: Symbolic) -> NodeConstraints:
        """Make them of the constraints of beams; multiplier k is the unknown ``n_dofs + k`` of the matrix."""
        system, wanted = constraints.as_rows()
        n_driven = constraints.n_driven
        linear = np.zeros(system.n, dtype=bool)
        linear[system.compiled.linear] = True
        rows, columns = constraints.jacobian_pattern
        return cls(
            system.compiled,
            np.concatenate([wanted, np.zeros(n_driven)]),
            np.maximum(np.arange(system.n) - wanted.size, -1),
            linear,
            symbolic.position(n_dofs + rows, columns),
            symbolic.position(*system.curvature_pattern),
        )


@njit(cache=True, error_model="numpy")
def add_constraints(
    constraints, driven, residual, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower
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
    rows = constraints.rows
    n, m = rows.dofs.shape
    n_dofs, n_lanes = q.shape
    starts, columns, unknowns = rows.entries
    curved_starts, one, other = rows.curved
    scratch = scratch_of(rows.statements, m // 2)
    y, g, h, missed = np.zeros(m), np.zeros(m), np.zeros((m, m)), np.zeros(n_lanes)
    for k in range(n):
        goal = constraints.wanted[k]
        if constraints.motions[k] >= 0:
            goal += driven[constraints.motions[k]]
        entry_range = range(starts[k], starts[k + 1])
        if constraints.linear[k]:
            for lane in range(n_lanes):
                missed[lane] = rows.constants[k] - goal
            for entry in entry_range:
                slope, dof = rows.slopes[entry], unknowns[entry]
                at, position = place[dof], constraints.positions[entry]
                for lane in range(n_lanes):
                    missed[lane] += slope * q[dof, lane]
                    x[at, lane] += slope * multipliers[k, lane]
                if fresh:
                    for lane in range(n_lanes):
                        lower[position, lane] += slope * scale[lane]
        else:
            for lane in range(n_lanes):
                for i in range(m):
                    dof = rows.dofs[k, i]
                    y[i] = q[dof, lane] if dof >= 0 else 0.0
                missed[lane] = state(rows.statements, k, y, 0.0, fresh, scratch, g, h) - goal
                for entry in entry_range:
                    i = columns[entry]
                    x[place[unknowns[entry]], lane] += g[i] * multipliers[k, lane]
                    if fresh:
                        lower[constraints.positions[entry], lane] += g[i] * scale[lane]
                for entry in range(curved_starts[k], curved_starts[k + 1] if fresh else 0):
                    bent = gain_k * multipliers[k, lane] * h[one[entry], other[entry]]
                    position = constraints.curved_positions[entry]
                    if position < 0:
                        diagonal[-1 - position, lane] += bent
                    else:
                        lower[position, lane] += bent
        row = place[n_dofs + k]
        for lane in range(n_lanes):
            x[row, lane] += scale[lane] * (missed[lane] if residual.shape[0] == 0 else residual[k, lane])
