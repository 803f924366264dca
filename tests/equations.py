"""The full-order equations of one rank as dense matrices."""

import numpy as np

from pgmp_petsc.full.kernel import evaluate
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.full.problem import FullEquations


def evaluated(
    equations: FullEquations, q: np.ndarray, v: np.ndarray, gains: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a rank's rows of the forces on one sample and of the iteration matrix, (n_rows,) and (n_rows, n_dofs), at
    unknowns and velocities (n_dofs,), without loads, actions and joints."""
    layout, n = equations.layout, equations.layout.n_unknowns
    here = layout.needed[:n]
    n_bound = layout.needed.size - n
    rest, multipliers = np.zeros((n, 1)), np.zeros((n_bound, 1))
    x, diagonal, lower = np.zeros((n + n_bound, 1)), np.zeros((n + n_bound, 1)), np.zeros((layout.n_lower, 1))
    amplitudes, angles = tuple(np.zeros(len(part)) for part in (equations.loads, equations.actions)), np.zeros(9)
    state = q[here, None], v[here, None], rest, multipliers, np.zeros((equations.n_turns, 1))
    evaluate(
        Reference(equations.problem), 0, amplitudes, angles, 0.0, np.empty((0, 1)), state, gains, np.zeros(1), True, x,
        diagonal, lower,
    )  # fmt: skip
    matrix = np.zeros((n + n_bound, q.size))
    below, across = layout.lower
    kept = below < n
    matrix[below[kept], here[across[kept]]] = matrix[across[kept], here[below[kept]]] = lower[kept, 0]
    matrix[np.arange(n), here] = diagonal[:n, 0]
    own = np.searchsorted(layout.needed, np.arange(equations.rows.start, equations.rows.stop))
    return x[own, 0], matrix[own]


def load_vectors(equations: FullEquations) -> dict[str, np.ndarray]:
    """Return the load of every effect on all unknowns of one sample, of one rank, shape (n_dofs,)."""
    found, loads = {}, equations.problem.loads
    for number, dof, value in zip(loads.numbers, loads.dofs, loads.values):
        vector = found.setdefault(equations.loads[number].name, np.zeros(equations.n_dofs))
        vector[dof] += value * loads.weights[0, number, 0]
    return found
