"""Full-order statics of one sample with held coordinates, on all ranks of a communicator.

    g_int(q) + C(q)^T lambda = g_ext(0),     c(q) = 0,

where the constraints hold every coordinate: the equations of `FullDistributed` at rest, for the mechanism whose
coordinates are all prescribed. Minus the multiplier of a held coordinate is the torque that holds it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.dynamics.full_distributed import FullDistributed
from pgmp_petsc.dynamics.full_problem import FullEquations
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.static_equilibrium import LONGEST, MAX_CORRECTIONS, ROUND_OFF, SHARES, TOLERANCE, cause_of
from pgmp_petsc.effects import Held
from pgmp_petsc.runtime.errors import RunError

if TYPE_CHECKING:
    from mpi4py import MPI


class FullStatics:
    """One sample; see `Statics`. Collective on `comm`.

    Parameters
    ----------
    equations
        Of the mechanism whose coordinates are all prescribed, on this rank.
    n_theta
        Number of its coordinates.
    comm
        Ranks that share the model.
    """

    n_samples = 1

    def __init__(self, equations: FullEquations, n_theta: int, comm: MPI.Comm) -> None:
        self._equations = equations
        self._held = {k: Held(0.0) for k in range(n_theta)}
        self._system = FullDistributed(equations, comm, self._held)
        self._q, self._share = np.zeros((equations.n_dofs, 1)), 0.0

    def close(self) -> None:
        """Destroy the PETSc objects."""
        self._system.close()

    def __enter__(self) -> FullStatics:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def hold(self, theta: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the deformation, from the undeformed mechanism; see `Statics.hold`."""
        torques, lost = np.full(theta.shape, np.nan), np.zeros(1, dtype=bool)
        if not samples[0]:
            return torques, lost
        for held, angle in zip(self._held.values(), theta[0]):
            held.angle = float(angle)
        self._share = 0.0
        for n_parts in SHARES:
            state = self._system.at_rest(self._equations.place(theta[0], np.zeros_like(theta[0]))[0], theta[0])
            if all(self._reach(state, part / n_parts) for part in range(1, n_parts + 1)):
                break
        else:
            return torques, np.ones(1, dtype=bool)
        self._q = self._system.unpack(state.q)
        torques[0] = self._system.multipliers(state)[-theta.shape[1] :]  # those of driven angles come last
        return torques, lost

    def cause(self, sample: int) -> str:
        """Return why there is no deformation; see `Statics.cause`."""
        return cause_of(self._share)

    def unknowns(self) -> np.ndarray:
        """Return the unknowns, shape (n_dofs, 1)."""
        return self._q

    def inertia(self) -> np.ndarray:
        """Return the inertia of the rigid mechanism at the start, shape (1, n_theta)."""
        theta, moments = np.array([held.angle for held in self._held.values()]), []
        for rates in np.eye(theta.size):
            q, v = self._equations.place(theta, rates)
            moments.append(2.0 * self._system.kinetic_energy(v))
        return np.array([moments])

    def _reach(self, state: State, share: float) -> bool:
        """Correct a state under a share of the loads, and note the largest one; return whether that converged."""
        found = self._converge(state, share)
        self._share = max(self._share, share if found else 0.0)
        return found

    def _converge(self, state: State, share: float) -> bool:
        """Correct a state, in place, under a share of the loads; return whether that converged."""
        last = np.inf
        for _ in range(MAX_CORRECTIONS):
            try:
                size = self._system.correct_at_rest(state, share, LONGEST)
            except RunError:
                return False
            if not np.isfinite(size):
                return False
            if size <= TOLERANCE or (size < ROUND_OFF and size >= 0.5 * last):
                return True
            last = size
        return False
