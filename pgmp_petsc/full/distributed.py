"""One full-order sample on many ranks, and its statics.

Unknowns are dealt to ranks in contiguous shares, and a constraint's multiplier goes with the first of its unknowns.
Each rank evaluates the elements and joints that touch its unknowns, as a batch does (`full.systems`), and has its rows
of

    [ gain_a M + K(q, lambda)   s C^T ]
    [ s C                        0    ]

with constraints scaled by s to the size of the inertia terms (Bottasso, Bauchau and Cardona 2007); a direct solver
factorises it in parallel. The same equations at rest, for the mechanism whose coordinates are all held,

    g_int(q) + C(q)^T lambda = g_ext(0),     c(q) = 0,

are its statics: minus the multiplier of a held coordinate is the torque that holds it.

Options prefix: ``pgmp_full_`` (e.g. ``-pgmp_full_mat_mumps_icntl_4 2``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cached_property

import numpy as np

from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.effects.time_function import Motion, TimeFunction
from pgmp_petsc.full.energy import energies_of
from pgmp_petsc.full.forces import act_over
from pgmp_petsc.full.kernel import count_turns, evaluate
from pgmp_petsc.full.parts import mass_on_diagonal
from pgmp_petsc.full.problem import FullEquations, Sources
from pgmp_petsc.full.rank_solver import RankSolver
from pgmp_petsc.full.systems import FullSystem, Gains
from pgmp_petsc.stepping.second_order_system import Energies, State, joined
from pgmp_petsc.stepping.static_equilibrium import LONGEST, cause_of, iterate_at_rest, put_on
from pgmp_petsc.stepping.status import Status


class FullDistributed(FullSystem):
    """One full-order sample on all ranks of a communicator, each with the equations for its share of the unknowns.

    Local state arrays hold this rank's unknowns and multipliers. `motions` are prescribed ones by the number of their
    coordinate. Collective on `comm`.
    """

    def __init__(self, equations: FullEquations, comm: Comm, motions: Mapping[int, Motion]) -> None:
        super().__init__(equations, comm, 1, Sources(equations.loads, equations.actions, tuple(motions.values())))
        self.rows, layout, self._problem = equations.rows, equations.layout, equations.problem
        n, n_all = layout.n_unknowns, layout.needed.size
        self._n, self._own = n, np.searchsorted(layout.needed, np.arange(self.rows.start, self.rows.stop))
        self._multipliers = n + np.flatnonzero(equations.owned_constraints)
        self._x, self._diagonal = np.empty((n_all, 1)), np.zeros((n_all, 1))
        self._lower = np.zeros((layout.n_lower, 1))
        # the row of every unknown and multiplier in PETSc's order: rank by rank
        starts = [equations.unknowns.share(rank, comm.size).start for rank in range(comm.size)]
        firsts = np.concatenate([np.arange(self.n_dofs), equations.owners])
        ranks = np.searchsorted(starts, firsts, side="right") - 1
        rows = np.empty(ranks.size, dtype=np.intp)
        rows[np.argsort(ranks, kind="stable")] = np.arange(ranks.size)
        self._solver = RankSolver(layout, np.concatenate([self._own, self._multipliers]), rows, comm)
        self._typical_mass = comm.allreduce(float(mass_on_diagonal(self._problem, equations.size)[0, 0])) / self.n_dofs
        self._itself = np.empty((0, 1))  # no residual but c
        self._solver_failed = False
        self.bends = any(comm.allgather(bool(self._problem.actions.laws.bend.any())))
        self._counted_edges = np.flatnonzero(self._problem.actions.counted[equations.edges])
        self.n_events = comm.allreduce(len(self._counted_edges))

    def close(self) -> None:
        """Destroy the PETSc objects."""
        self._solver.close()

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Gather a state's array of unknowns from all ranks as (n, 1), on every rank."""
        return np.concatenate(self.comm.allgather(array))[:, None]

    def undeformed(self, theta: np.ndarray, rates: np.ndarray) -> State:
        """Return the undeformed mechanism at coordinates and rates (n_theta,), without multipliers."""
        q, v = self._equations.place(theta, rates)
        return self._state(q[:, None], v[:, None], self._equations.turns(theta[:, None]))

    def _state(self, q: np.ndarray, v: np.ndarray, turns: np.ndarray) -> State:
        own, speeds = (part[self.rows.start : self.rows.stop, 0].copy() for part in (q, v))
        return State(own, speeds, np.zeros_like(own), np.zeros(self._multipliers.size), turns[:, 0])

    def _against(self, rows: np.ndarray) -> np.ndarray:
        return rows[self._equations.chosen]

    def correct_at_rest(self, state: State, share: float) -> np.ndarray:
        """Do one Newton correction of a state at rest under a share of the loads at time zero, in place.

        A correction longer than `LONGEST`, in units of the mechanism's size or of 1 rad, is shortened to it. Returned
        is the size before, (1,), the same on all ranks. Collective on `comm`.
        """
        step, multipliers = self._solve(0.0, state, (0.0, 0.0, 1.0), self._typical_stiffness, self._itself, True, share)
        size = self._size_of(step)
        if np.isfinite(size):
            shortened = min(1.0, LONGEST / size) if size > 0.0 else 1.0
            state.q -= shortened * step
            state.multipliers -= shortened * multipliers
        return np.array([size])

    def _correct(
        self, time: float, state: State, gains: Gains, residual: np.ndarray, active: np.ndarray, fresh: bool
    ) -> np.ndarray:
        gain_v, gain_a, _ = gains
        with np.errstate(all="ignore"):  # a sample that fails may overflow before it is given up
            step, multipliers = self._solve(time, state, gains, gain_a * self._typical_mass, residual, fresh)
        state.q -= step
        state.v -= gain_v * step
        state.a -= gain_a * step
        state.multipliers -= multipliers
        return np.array([self._size_of(step)])

    def limited(self) -> np.ndarray:
        """Return the same on all ranks. Collective on `comm`."""
        return np.array([any(self.comm.allgather(bool(np.isinf(self._problem.actions.about).any())))])

    def count_turns(self, state: State) -> None:
        if state.turns.size:
            count_turns(self._reference, self._gathered(state.q)[: self._n], state.turns[:, None])

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        if samples[0]:
            for now, before in zip(state.parts(), previous.parts()):
                now[:] = before

    restore_all = restore

    def depths(self, times: np.ndarray, states: State, samples: np.ndarray) -> np.ndarray:
        """Return the same on all ranks. Collective on `comm`."""
        q, v = (np.stack([self._gathered(one)[: self._n] for one in part])[:, None] for part in (states.q, states.v))
        own = np.zeros((times.size, 1, len(self._equations.edges), 1))
        if self._equations.actions:
            act_over(
                self._actions, self._problem.width, self._sources.amplitudes(times), q, v,
                np.ascontiguousarray(states.turns)[:, None, :, None], samples[None], own,
            )  # fmt: skip
        return np.concatenate(self.comm.allgather(own[:, 0, self._counted_edges]), axis=1)

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Collective on `comm`."""
        finite = all(self.comm.allgather(bool(np.isfinite(state.v).all())))
        if self._solver_failed:
            return np.array([Status.SOLVER_FAILED])
        return np.array([Status.NOT_CONVERGED if finite else Status.NOT_FINITE])

    def multipliers(self, state: State) -> np.ndarray:
        equations = self._equations
        every = np.zeros((equations.constraints.n_constraints, 1))
        every[equations.chosen[equations.owned_constraints], 0] = state.multipliers
        return self.comm.allreduce(every)

    def frames_over(self, states: State) -> np.ndarray:
        return self._equations.frames(self._columns(states.q), states.turns.T)

    def energies_over(self, times: Sequence[float], states: State) -> Energies:
        """Return the same on all ranks. Collective on `comm`."""
        found = []
        for time, *parts in zip(times, states.q, states.v, states.multipliers, states.turns):
            (q, speeds, multipliers, turns), now = parts, self._sources.at(np.array([time]))
            here, v = self._gathered(q, multipliers), self._gathered(speeds)[: self._n]
            table = energies_of(
                self._reference, self._conservative, now, np.zeros(1, dtype=np.int64), here[None, : self._n], v[None],
                here[None, self._n :], turns[None, :, None],
            )  # fmt: skip
            found.append(self._names.summed(table[0], self.comm))
        return joined(found)

    def _solve(
        self,
        time: float,
        state: State,
        gains: Gains,
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

    @cached_property
    def _typical_stiffness(self) -> float:
        """The mean size on the diagonal of the stiffness at rest. Collective on `comm`."""
        q = self._equations.start[0][self._equations.layout.needed[: self._n], None]
        rest, bound = np.zeros_like(q), np.zeros((self._x.size - self._n, 1))
        state = (q, rest, rest, bound, np.zeros((self._equations.n_turns, 1)))
        amplitudes = tuple(np.zeros(len(sources)) for sources in (self._sources.loads, self._sources.actions))
        evaluate(
            self._reference, 0, amplitudes, np.zeros(len(self._sources.motions)), 0.0, bound, state, (0.0, 0.0, 1.0),
            np.zeros(1), True, self._x, self._diagonal, self._lower,
        )  # fmt: skip
        own = np.abs(self._diagonal[self._own, 0])
        return self.comm.allreduce(float(own.sum())) / self.n_dofs or 1.0


class FullStatics(AbstractContextManager):
    """One sample whose coordinates are held, all prescribed; see `Statics`. Collective on `comm`."""

    n_samples = 1

    def __init__(self, equations: FullEquations, comm: Comm) -> None:
        self._start = equations.initial[0]
        self._held = [Motion("held", "", TimeFunction.constant(0.0)) for _ in self._start]
        self._system = FullDistributed(equations, comm, dict(enumerate(self._held)))
        self._q, self._share = np.zeros((equations.n_dofs, 1)), 0.0

    def __exit__(self, *_: object) -> None:
        self._system.close()

    def hold(self, theta: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the deformation, from the undeformed mechanism; see `Statics.hold`."""
        torques = np.full(theta.shape, np.nan)
        if not samples[0]:
            return torques, np.zeros(1, dtype=bool)
        for held, angle in zip(self._held, theta[0]):
            held.angle = TimeFunction.constant(float(angle))
        begun = self._system.undeformed(theta[0], np.zeros_like(theta[0]))
        state = begun.copy()

        def begin(going: np.ndarray) -> None:
            self._system.restore(state, begun, going)

        def converge(going: np.ndarray, share: float) -> np.ndarray:
            return iterate_at_rest(lambda _: self._system.correct_at_rest(state, share), going)

        lost, (self._share,) = put_on(begin, converge, samples)
        if not lost[0]:
            self._q = self._system.unpack(state.q)
            torques[0] = self._system.multipliers(state)[-theta.shape[1] :, 0]  # those of driven angles come last
        return torques, lost

    def cause(self, sample: int) -> str:
        return cause_of(self._share)

    def unknowns(self) -> np.ndarray:
        return self._q

    def inertia(self) -> np.ndarray:
        turning = (self._system.undeformed(self._start, rates) for rates in np.eye(self._start.size))
        return np.array([[2.0 * self._system.energies(0.0, state).kinetic[0] for state in turning]])
