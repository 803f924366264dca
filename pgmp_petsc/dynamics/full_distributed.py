"""The full-order model of one sample, distributed over ranks: the reference.

    M q'' + g_int(q) + C(q)^T lambda = g_ext(t),     c(q) = 0

(Naets et al. 2015, eq. (3)). Unknowns are dealt to ranks in contiguous shares, and a constraint's multiplier goes with
the first of its unknowns. Each rank evaluates the elements and joints that touch its unknowns, as a batch of samples
does (`full_kernel`), and has its rows of

    [ gain_a M + K(q, lambda)   s C^T ]
    [ s C                        0    ]

with constraints scaled by s to the size of the inertia terms (Bottasso, Bauchau and Cardona 2007); a direct solver
factorises it in parallel.

Options prefix: ``pgmp_full_`` (e.g. ``-pgmp_full_mat_mumps_icntl_4 2``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.dynamics.energies import Energies, joined
from pgmp_petsc.dynamics.full_energy import EnergyNames, energies_of
from pgmp_petsc.dynamics.full_forces import act
from pgmp_petsc.dynamics.full_kernel import count_turns, evaluate
from pgmp_petsc.dynamics.full_parts import mass_on_diagonal
from pgmp_petsc.dynamics.full_problem import FullEquations, Sources
from pgmp_petsc.dynamics.part_reference import Reference
from pgmp_petsc.dynamics.rank_solver import RankSolver
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.dynamics.static_equilibrium import Settled
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.effects import Held, Motion, driven
from pgmp_petsc.effects.law import rubs

if TYPE_CHECKING:
    from mpi4py import MPI

ITSELF = np.empty((0, 1))  # no residual but c


class FullDistributed:
    """One full-order sample on all ranks of a communicator. Collective on `comm`.

    Local state arrays hold this rank's unknowns and multipliers.

    Parameters
    ----------
    equations
        Of the sample on this rank, made for its share of the unknowns.
    comm
        Ranks that share the model.
    motions
        Prescribed motions by the number of their coordinate.
    settled
        Static equilibrium to start from; the undeformed mechanism if there is none.
    """

    n_samples = 1
    instants_at_once = 1
    has_light_nodes = True

    def __init__(
        self,
        equations: FullEquations,
        comm: MPI.Comm,
        motions: Mapping[int, Motion | Held] = MappingProxyType({}),
        settled: Settled | None = None,
    ) -> None:
        self.comm, self._equations, self.settled = comm, equations, settled
        self.n_dofs, self.rows = equations.n_dofs, equations.rows
        self._sources = Sources(equations.loads, equations.actions, tuple(motions.values()))
        layout, self._problem, self._reference = equations.layout, equations.problem, Reference(equations.problem)
        n, n_all = layout.n_unknowns, layout.needed.size
        self._n, self._own = n, np.searchsorted(layout.needed, np.arange(self.rows.start, self.rows.stop))
        self._multipliers = n + np.flatnonzero(equations.owned_constraints)
        self._x, self._diagonal = np.empty((n_all, 1)), np.zeros((n_all, 1))
        self._lower = np.zeros((layout.n_lower, 1))
        self._solver = RankSolver(layout, np.concatenate([self._own, self._multipliers]), self._rows_of_all(), comm)
        self._conservative = np.array([effect.conservative for effect in equations.loads], dtype=bool)
        self._names = EnergyNames.of(equations, self._sources.motions)
        self._typical_mass = comm.allreduce(float(mass_on_diagonal(self._problem)[0, 0])) / self.n_dofs
        self._typical_stiffness = 0.0
        self._solver_failed = False
        self.rubs = any(comm.allgather(rubs(self._problem.actions.laws)))

    def close(self) -> None:
        """Destroy the PETSc objects."""
        self._solver.close()

    def __enter__(self) -> FullDistributed:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Parameter values of the samples, each of shape (n_samples,)."""
        return self._equations.values

    def start(self) -> State:
        """Return the start, undeformed or settled, with consistent accelerations and multipliers."""
        q, v = self._equations.start()
        if self.settled is None:
            return self.consistent(q, v, self._equations.initial[0])
        state = self.consistent(self.settled.unknowns[:, 0], np.zeros_like(v), self.settled.theta[0])
        return self.settled.at_rest(state, len(self._sources.motions))

    def at_rest(self, q: np.ndarray, theta: np.ndarray) -> State:
        """Return a state at rest without multipliers, for unknowns of shape (n_dofs,) and coordinates (n_theta,)."""
        own, nothing = q[self.rows.start : self.rows.stop].copy(), np.zeros(len(self.rows))
        turns = self._equations.turns(theta[:, None])[:, 0]
        return State(own, nothing, nothing.copy(), np.zeros(self._multipliers.size), turns)

    def correct_at_rest(self, state: State, share: float, longest: float) -> float:
        """Do one Newton correction of a state at rest under a share of the loads at time zero, in place.

        A correction longer than `longest`, in units of the mechanism's size or of 1 rad, is shortened to it. Returned
        is the size before, the same on all ranks. Collective on `comm`.
        """
        if not self._typical_stiffness:
            self._typical_stiffness = self._find_typical_stiffness()
        static = (0.0, 0.0, 1.0)
        step, multipliers = self._solve(0.0, state, static, self._typical_stiffness, ITSELF, True, share)
        size = self._size_of(step)
        if np.isfinite(size):
            shortened = min(1.0, longest / size) if size > 0.0 else 1.0
            state.q -= shortened * step
            state.multipliers -= shortened * multipliers
        return size

    def kinetic_energy(self, v: np.ndarray) -> float:
        """Return the kinetic energy for velocities of shape (n_dofs,), the same on all ranks. Collective on `comm`."""
        q, theta = self._equations.start()[0], self._equations.initial[0]
        state = self.at_rest(q, theta)
        state.v = v[self.rows.start : self.rows.stop].copy()
        return float(self.energies(0.0, state).kinetic[0])

    def consistent(self, q: np.ndarray, v: np.ndarray, theta: np.ndarray) -> State:
        """Return the state at time 0 with given unknowns and velocities (n_dofs,) that obey the constraints, and the
        coordinates (n_theta,)."""
        state = self.at_rest(q, theta)
        state.v = v[self.rows.start : self.rows.stop].copy()
        acceleration = driven(self._sources.motions, 0.0).acceleration
        drift = self._equations.constraints.drift(q[:, None], v[:, None], acceleration)
        return self._accelerated(0.0, state, drift, True)

    def project(self, time: float, state: State, step: float, samples: np.ndarray) -> None:
        """Make velocities and accelerations consistent with the constraints; see `FullBatch.project`. Collective on
        `comm`."""
        if not samples[0]:
            return
        constraints, now = self._equations.constraints, driven(self._sources.motions, time)
        q, v = self.unpack(state.q), self.unpack(state.v)
        rates = constraints.rates(q, v, now.speed) / step
        before = self._accelerated(time, state, np.zeros_like(rates), True).a
        state.v += step * (self._accelerated(time, state, rates, False).a - before)
        drift = constraints.drift(q, self.unpack(state.v), now.acceleration)
        found = self._accelerated(time, state, drift, False)
        state.a[:], state.multipliers[:] = found.a, found.multipliers

    @property
    def moving_constraints(self) -> bool:
        """Whether constraints turn or follow motions; see `AlphaStep`."""
        return self._equations.moving_constraints

    def _accelerated(self, time: float, state: State, drift: np.ndarray, fresh: bool) -> State:
        """Return a state with the accelerations and multipliers of ``M a + C^T lambda = g_ext - g_int, C a = -drift``,
        given the drift of all constraints."""
        still = State(state.q, state.v, np.zeros_like(state.a), state.multipliers, state.turns)
        chosen = drift[self._equations.chosen]
        change, multipliers = self._solve(time, still, (0.0, 1.0, 0.0), self._typical_mass, chosen, fresh)
        return State(state.q, state.v, -change, state.multipliers - multipliers, state.turns)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        gains, scale = (scheme.gain_v, scheme.gain_a, 1.0), scheme.gain_a * self._typical_mass
        with np.errstate(all="ignore"):  # a sample that fails may overflow before it is given up
            step, multipliers = self._solve(time, state, gains, scale, ITSELF, fresh)
        state.q -= step
        state.v -= scheme.gain_v * step
        state.a -= scheme.gain_a * step
        state.multipliers -= multipliers
        return np.array([self._size_of(step)])

    def begin_iteration(self) -> None:
        """Forget at which rates laws were evaluated; see `AlphaStep`."""
        self._problem.actions.about[:] = np.nan

    def limited(self) -> np.ndarray:
        """Return whether a law was limited in the last correction, the same on all ranks. Collective on `comm`."""
        return np.array([any(self.comm.allgather(bool(np.isnan(self._problem.actions.about).any())))])

    def count_turns(self, state: State) -> None:
        """Take note of the angles at an instant that is kept."""
        if state.turns.size:
            count_turns(self._reference, self._gathered(state.q)[: self._n], state.turns[:, None])

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put the sample back."""
        if samples[0]:
            for now, before in (
                (state.q, previous.q),
                (state.v, previous.v),
                (state.a, previous.a),
                (state.multipliers, previous.multipliers),
                (state.turns, previous.turns),
            ):
                now[:] = before

    @property
    def n_events(self) -> int:
        """Number of edges of laws."""
        return self.comm.allreduce(len(self._counted_edges()))

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed, shape (n_events, 1), the same on all ranks. Collective on `comm`."""
        q, v = (self._gathered(part)[: self._n] for part in (state.q, state.v))
        own = np.zeros(0)
        if self._equations.actions:
            amplitudes = self._sources.at(np.array([time])).actions[0]
            turns = state.turns[state.turns.size - amplitudes.size :, None]
            own = act(Reference(self._problem.actions), 0, amplitudes, q, v, turns, 0.0, False).depths[0]
        return np.concatenate(self.comm.allgather(own[self._counted_edges()]))[:, None]

    def outside(self, state: State) -> np.ndarray:
        """Return False: the full-order model is valid everywhere."""
        return np.zeros(1, dtype=bool)

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why the sample fails; see `SecondOrderSystem.reasons`. Collective on `comm`."""
        finite = all(self.comm.allgather(bool(np.isfinite(state.v).all())))
        if self._solver_failed:
            return np.array([Status.SOLVER_FAILED])
        return np.array([Status.NOT_CONVERGED if finite else Status.NOT_FINITE])

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Gather a state's array of unknowns from all ranks as (n, 1), on every rank."""
        return np.concatenate(self.comm.allgather(array))[:, None]

    def multipliers(self, state: State) -> np.ndarray:
        """Return the multipliers of all constraints, shape (n_constraints,), on every rank. Collective on `comm`."""
        equations = self._equations
        every = np.zeros(equations.constraints.n_constraints)
        every[equations.chosen[equations.owned_constraints]] = state.multipliers
        return self.comm.allreduce(every)

    def frames(self, state: State) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, n_frame, 1), the same on all ranks. Collective on `comm`."""
        return self._equations.frames(self.unpack(state.q), state.turns[:, None])

    def frames_over(self, states: Sequence[State]) -> np.ndarray:
        """Return the frames of all nodes in several states, shape (n_nodes, n_frame, n). Collective on `comm`."""
        return np.concatenate([self.frames(state) for state in states], axis=-1)

    def energies_over(self, times: Sequence[float], states: Sequence[State]) -> Energies:
        """Return energies and powers at several instants, each of shape (n,). Collective on `comm`."""
        return joined([self.energies(time, state) for time, state in zip(times, states)])

    def energies(self, time: float, state: State) -> Energies:
        """Return energies and powers at an instant, the same on all ranks. Collective on `comm`."""
        here, v = self._gathered(state.q, state.multipliers), self._gathered(state.v)[: self._n]
        table = energies_of(
            self._reference, self._conservative, self._sources.at(np.array([time])), np.zeros(1, dtype=np.int64),
            here[None, : self._n], v[None], here[None, self._n :], state.turns[None, :, None],
        )  # fmt: skip
        return self._names.summed(table[0], self.comm)

    def _solve(
        self,
        time: float,
        state: State,
        gains: tuple[float, float, float],
        scale: float,
        residual: np.ndarray,
        fresh: bool,
        share: float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the residual and solve for the correction; `residual` replaces c(q) where given.

        Where the linear solver fails, the correction is no number: the sample is lost, and the others go on. `share` is
        what part of the loads and local effects acts.
        """
        here = self._gathered(state.q, state.multipliers)
        v, a = (self._gathered(part)[: self._n] for part in (state.v, state.a))
        now = self._sources.at(np.array([time]))
        turns, scales = state.turns[:, None], np.array([scale])
        evaluate(
            self._reference, 0, (now.loads[0], now.actions[0]), now.angles[0], share, residual,
            (here[: self._n], v, a, here[self._n :], turns), gains, scales, fresh, self._x, self._diagonal, self._lower,
        )  # fmt: skip
        if fresh:
            self._solver.assemble(self._diagonal[:, 0], self._lower[:, 0])
        n_own = self._own.size
        solution = self._solver.solve(np.concatenate([self._x[self._own, 0], self._x[self._multipliers, 0]]))
        self._solver_failed = solution is None
        if solution is None:
            return np.full(n_own, np.nan), np.full(self._multipliers.size, np.nan)
        return solution[:n_own], scale * solution[n_own:]

    def _gathered(self, unknowns: np.ndarray, multipliers: np.ndarray | None = None) -> np.ndarray:
        """Return what is needed here of unknowns and multipliers, shape (n, 1), from the rows of all ranks."""
        if multipliers is None:
            multipliers = np.zeros(self._multipliers.size)
        return self._solver.gather(np.concatenate([unknowns, multipliers]))[:, None]

    def _size_of(self, step: np.ndarray) -> float:
        """Return the size of a correction, the same on all ranks."""
        units = self._problem.units[self._own]
        moved = float(np.max(np.abs(step) * units, initial=0.0)) if np.all(np.isfinite(step)) else np.inf
        return max(self.comm.allgather(moved))

    def _counted_edges(self) -> np.ndarray:
        """Return the numbers of the edges of the actions that are counted here."""
        return np.flatnonzero(self._problem.actions.counted[self._equations.edges])

    def _find_typical_stiffness(self) -> float:
        """Return the mean size on the diagonal of the stiffness at rest. Collective on `comm`."""
        q = self._equations.start()[0][self._equations.layout.needed[: self._n], None]
        rest, bound = np.zeros_like(q), np.zeros((self._x.size - self._n, 1))
        state = (q, rest, rest, bound, np.zeros((self._equations.n_turns, 1)))
        amplitudes = tuple(np.zeros(len(sources)) for sources in (self._sources.loads, self._sources.actions))
        evaluate(
            self._reference, 0, amplitudes, np.zeros(len(self._sources.motions)), 0.0, bound, state, (0.0, 0.0, 1.0),
            np.zeros(1), True, self._x, self._diagonal, self._lower,
        )  # fmt: skip
        own = np.abs(self._diagonal[self._own, 0])
        return self.comm.allreduce(float(own.sum())) / self.n_dofs or 1.0

    def _rows_of_all(self) -> np.ndarray:
        """Return the row of every unknown and multiplier in PETSc's order: rank by rank, shape (n_all,)."""
        equations, size = self._equations, self.comm.size
        starts = [equations.unknowns.share(rank, size).start for rank in range(size)]
        firsts = np.concatenate([np.arange(self.n_dofs), equations.owners])
        ranks = np.searchsorted(starts, firsts, side="right") - 1
        rows = np.empty(ranks.size, dtype=np.intp)
        rows[np.argsort(ranks, kind="stable")] = np.arange(ranks.size)
        return rows
