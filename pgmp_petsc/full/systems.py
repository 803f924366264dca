"""The full-order model as a second-order system for the integrator: batches of samples, and one sample on many ranks.

    M q'' + g_int(q) + C(q)^T lambda = g_ext(t),     c(q) = 0

(Naets et al. 2015, eq. (3)). A batch is on one rank, LANES samples side by side (`full_kernel`).

Of a sample that is distributed, the reference, unknowns are dealt to ranks in contiguous shares, and a constraint's
multiplier goes with the first of its unknowns. Each rank evaluates the elements and joints that touch its unknowns, as
a batch does, and has its rows of

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
from copy import copy
from functools import cached_property
from types import MappingProxyType
from typing import Self

import numpy as np

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.base.surroundings import Comm, alone
from pgmp_petsc.controllers.running import MOST_STARTS, Controls
from pgmp_petsc.effects import Effect, Held, Motion, driven
from pgmp_petsc.effects.law import rubs
from pgmp_petsc.full.energy import EnergyNames, energies_of
from pgmp_petsc.full.forces import act
from pgmp_petsc.full.kernel import Factors, correct, count_turns, evaluate
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.full.parts import mass_on_diagonal
from pgmp_petsc.full.problem import FullEquations, Sources
from pgmp_petsc.full.rank_solver import RankSolver
from pgmp_petsc.full.steps import take_steps
from pgmp_petsc.lanes.lane_items import aligned
from pgmp_petsc.lanes.vectors import aligned_zeros
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.stepping.energies import Energies, joined
from pgmp_petsc.stepping.sample_blocks import SampleBlocks
from pgmp_petsc.stepping.second_order_system import Scheme, SecondOrderSystem, Settled, State, StepsAsked, StepsTaken
from pgmp_petsc.stepping.static_equilibrium import LONGEST, cause_of, iterate_at_rest, put_on
from pgmp_petsc.stepping.status import Status

# A call from Python costs what some tens of steps of a small mechanism do. What lies behind an edge that is crossed is
# taken again
STEPS_AT_ONCE, BEFORE_EDGES = 200, 32
LARGEST = 2**18  # unknowns of all samples and steps that are kept from a call
ITSELF = np.empty((0, 1))  # no residual but c
Gains = tuple[float, float, float]  # of velocities, accelerations and stiffness


class FullSystem(SecondOrderSystem):
    """Full-order samples, whose states a subclass lays out in arrays.

    Parameters
    ----------
    equations
        Of the samples on this rank.
    comm
        Ranks that share the model.
    sources
        What changes with time.
    settled
        Static equilibrium of every sample to start from; the undeformed mechanism if there is none.
    built_in
        Unknowns and velocities to start from in its place, each (n_dofs, 1 or n_samples), where joints that are off
        deform the mechanism.

    Attributes
    ----------
    instants_at_once
        States of a run whose frames and energies are best evaluated together.
    """

    has_light_nodes = True
    instants_at_once = 1

    def __init__(
        self,
        equations: FullEquations,
        comm: Comm,
        n_samples: int,
        sources: Sources,
        settled: Settled | None,
        built_in: tuple[np.ndarray, np.ndarray] | None,
    ) -> None:
        self.comm, self.n_samples, self.settled, self.built_in = comm, n_samples, settled, built_in
        self._equations, self._sources, self._reference = equations, sources, Reference(equations.problem)
        self.n_dofs, self.n_constraints = equations.n_dofs, equations.constraints.n_constraints
        self.moving_constraints = equations.moving_constraints
        self._conservative = np.array([effect.conservative for effect in equations.loads], dtype=bool)
        self._names = EnergyNames.of(equations, sources.motions)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Parameter values of the samples, each of shape (n_samples,)."""
        return self._equations.values

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Return a state's array of unknowns as (n, n_samples), on every rank."""
        raise NotImplementedError

    def multipliers(self, state: State) -> np.ndarray:
        """Return the multipliers of the constraints, shape (n_constraints, n_samples), on every rank. Collective on
        `comm`."""
        raise NotImplementedError

    def multipliers_of_joints(self, state: State) -> np.ndarray:
        """Return the scheme's own multipliers of joints and driven angles (`ConstraintSet.of_joints`), shape (n,
        n_samples). Collective on `comm`."""
        return self._equations.constraints.of_joints(self.multipliers(state))

    def joint_multipliers(self, time: float, state: State) -> np.ndarray:
        """Return the multipliers of joints and driven angles (`ConstraintSet.of_joints`), shape (n, n_samples).
        Collective on `comm`.

        They are those with which accelerations obey the constraints, ``C q'' = -(dC/dt) q' + c_tt``, in the state's
        positions and velocities. Those of the scheme itself are of first order in the step until what its start has
        against the constraints is damped (Arnold, Bruls and Cardona 2015); these are of second order, as the motion is.
        """
        accelerations = driven(self._sources.motions, time).acceleration
        drift = self._equations.constraints.drift(self.unpack(state.q), self.unpack(state.v), accelerations)
        everyone = np.ones(self.n_samples, dtype=bool)
        found = self._accelerated(time, state, self._against(drift), everyone, True)
        return self.multipliers_of_joints(found)

    def start(self) -> State:
        """Return the start, undeformed or settled, with consistent accelerations and multipliers."""
        found = self._begun.copy()
        if self.beside is not None:
            self.beside.start(found)
            self.beside.settle(found)
        return found

    @cached_property
    def _begun(self) -> State:
        """The start: two runs of a system begin with it, the second for the error of the first one's step."""
        theta, rates = self._equations.initial
        if self.settled is None:
            return self.consistent(*(self.built_in or self._equations.place(theta, rates)), theta)
        q = self.settled.unknowns
        state = self.consistent(q, np.zeros_like(q), self.settled.theta.T)
        return self.settled.at_rest(state, len(self._sources.motions))

    def consistent(self, q: np.ndarray, v: np.ndarray, theta: np.ndarray) -> State:
        """Return the state at time 0 with given unknowns and velocities that obey the constraints, and the coordinates.

        They have the shape (n,) where they are the same of all samples, or else (n, n_samples).
        """
        turns = self._equations.turns(theta.reshape(theta.shape[0], -1))
        accelerations = driven(self._sources.motions, 0.0).acceleration
        q, v = q.reshape(self.n_dofs, -1), v.reshape(self.n_dofs, -1)
        n = max(q.shape[1], v.shape[1])
        q, v = (np.repeat(part, n // part.shape[1], axis=1) for part in (q, v))
        drift, state = self._against(self._equations.constraints.drift(q, v, accelerations)), self._state(q, v, turns)
        if self.beside is not None:
            self.beside.start(state)
        everyone = np.ones(self.n_samples, dtype=bool)
        found = self._accelerated(0.0, state, drift, everyone, True)
        for _ in range(MOST_STARTS if self.beside is not None else 0):
            if not self.beside.settle(found):
                break
            found = self._accelerated(0.0, found, drift, everyone, False)
        return found

    def project(self, time: float, state: State, step: float, samples: np.ndarray) -> None:
        """Make velocities and accelerations of some samples consistent with the constraints at the end of a step.

        With the rates ``C v - c_t`` of the constraints, c_t those of the motions, the least change dv in the norm of
        the mass and then the accelerations follow from

            M dv + C^T mu = 0,  C dv = -(C v - c_t);    M a + C^T lambda = g_ext - g_int,  C a = -(dC/dt) v + c_tt.

        Collective on `comm`.
        """
        if not samples.any():
            return
        constraints, now = self._equations.constraints, driven(self._sources.motions, time)
        q, v = self.unpack(state.q), self.unpack(state.v)
        # accelerations are linear in the residual in place of c: a step's worth of dv is the difference of two
        rates = self._against(constraints.rates(q, v, now.speed) / step)
        before = self._accelerated(time, state, np.zeros_like(rates), samples, True).a
        moved = state.copy()
        moved.v += step * (self._accelerated(time, state, rates, samples, False).a - before)
        self.restore(state, moved, samples)
        drift = self._against(constraints.drift(q, self.unpack(state.v), now.acceleration))
        self.restore(state, self._accelerated(time, state, drift, samples, False), samples)

    def _state(self, q: np.ndarray, v: np.ndarray, turns: np.ndarray) -> State:
        """Lay out unknowns, velocities and turns (n, 1 or n_samples), without accelerations and multipliers."""
        raise NotImplementedError

    def _against(self, rows: np.ndarray) -> np.ndarray:
        """Lay out the residual in place of c, of all constraints, (n_constraints, 1 or n_samples)."""
        raise NotImplementedError

    def _correct(
        self, time: float, state: State, gains: Gains, residual: np.ndarray, active: np.ndarray, fresh: bool
    ) -> np.ndarray:
        """Correct a state in place; `residual` replaces c where given. Return the sizes."""
        raise NotImplementedError

    def _accelerated(self, time: float, state: State, drift: np.ndarray, samples: np.ndarray, fresh: bool) -> State:
        """Return a state with the accelerations and multipliers of ``M a + C^T lambda = g_ext - g_int, C a = -drift``.

        Both enter linearly: one correction with the mass alone solves it.
        """
        trial = state.copy()
        trial.a[:] = 0.0
        self._correct(time, trial, (0.0, 1.0, 0.0), drift, samples, fresh)
        return State(state.q, state.v, trial.a, trial.multipliers, state.turns, state.beside)

    def accelerate(self, time: float, state: State, samples: np.ndarray) -> None:
        """Give samples their accelerations; see `SecondOrderSystem`. Collective on `comm`."""
        accelerations = driven(self._sources.motions, time).acceleration
        drift = self._equations.constraints.drift(self.unpack(state.q), self.unpack(state.v), accelerations)
        self.restore(state, self._accelerated(time, state, self._against(drift), samples, True), samples)

    def control(self, controls: Controls) -> None:
        """Let controllers act on the only sample."""
        self.beside = self._sources.controls = controls

    def put_forces(self, forces: Sequence[np.ndarray]) -> None:
        """Take what is given to each action; see `Controls`."""
        parameters = self._equations.problem.actions.parameters
        for column, number in zip(*self._sources.controlled):
            parameters[:, column, :, : forces[number].shape[1]] = forces[number]

    def begin_iteration(self) -> None:
        """Forget at which rates laws were evaluated; see `SecondOrderSystem`."""
        self._equations.problem.actions.about[:] = np.nan

    def frames_over(self, states: Sequence[State]) -> np.ndarray:
        """Return the frames of all nodes of the only sample in several states, shape (n_nodes, n_frame, n)."""
        return np.concatenate([self.frames(state) for state in states], axis=-1)

    def energies_over(self, times: Sequence[float], states: Sequence[State]) -> Energies:
        """Return energies and powers of the only sample at several instants, each of shape (n,)."""
        return joined([self.energies(time, state) for time, state in zip(times, states)])


class FullBatch(FullSystem):
    """A batch of full-order samples, or a single one, on this rank.

    Arrays have shape (n_blocks, n, n_lanes); see `SampleBlocks`.

    Parameters
    ----------
    kinematics
        Rigid kinematics; the start is an undeformed configuration.
    effects
        Effects of the scene.
    values
        Parameter values of the samples, each of shape (n_samples,).
    initial
        Positions (rad) and velocities (rad/s) of the rigid coordinates at the start, each of shape (n_theta,).
    n_samples
        Number of samples.
    motions
        Prescribed motions by the number of their coordinate.
    settled, built_in
        See `FullSystem`.
    """

    instants_at_once = 256

    def __init__(
        self,
        kinematics: RigidKinematics,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[np.ndarray, np.ndarray],
        n_samples: int,
        motions: Mapping[int, Motion] = MappingProxyType({}),
        settled: Settled | None = None,
        built_in: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        blocks = self._blocks = SampleBlocks.of(n_samples)
        equations = FullEquations(kinematics, effects, values, blocks, initial)
        sources = equations.sources(effects, tuple(motions.values()))
        super().__init__(equations, alone(), n_samples, sources, settled, built_in)
        self.n_events = len(equations.edges)
        #: see `SecondOrderSystem`, for steps that no edge ends
        self.edgeless_at_once = max(1, min(STEPS_AT_ONCE, LARGEST // (self.n_dofs * n_samples)))
        self.steps_at_once = min(BEFORE_EDGES, self.edgeless_at_once) if equations.edges else self.edgeless_at_once
        n = self.n_dofs + self.n_constraints
        self._factors = Factors(
            aligned_zeros((blocks.n_blocks, n + equations.layout.n_lower, blocks.n_lanes)),
            aligned_zeros((n, blocks.n_lanes)),
        )
        self._size = np.empty((blocks.n_blocks, blocks.n_lanes))
        self._typical_mass = mass_on_diagonal(equations.problem, equations.size) / self.n_dofs

    def steps_between_looks(self, every: int | None) -> int:
        """Return how many steps make one of PETSc's TS where it does not look; see `SecondOrderSystem`."""
        return STEPS_AT_ONCE

    def under(self, effects: Sequence[Effect], motions: Mapping[int, Motion]) -> Self:
        """Return the batch under effects and motions that differ from its own over time alone; both share memory."""
        other = copy(self)
        other._sources = self._equations.sources(effects, tuple(motions.values()))
        vars(other).pop("_begun", None)  # under other loads it begins with other accelerations
        return other

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Return a state's array as (n, n_samples)."""
        return self._blocks.unpack(array)

    def pack(self, rows: np.ndarray) -> np.ndarray:
        """Return rows of shape (n, n_samples), or the same ones for all samples, as a state's array."""
        return self._blocks.pack(np.broadcast_to(rows, (len(rows), self.n_samples)))

    _against = pack

    def _state(self, q: np.ndarray, v: np.ndarray, turns: np.ndarray) -> State:
        nothing, unbound = np.zeros((self.n_dofs, 1)), np.zeros((self.n_constraints, 1))
        return State(*(self.pack(part) for part in (q, v, nothing, unbound, turns)))

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        itself = np.empty((self._blocks.n_blocks, 0, self._blocks.n_lanes))
        return self._correct(time, state, (scheme.gain_v, scheme.gain_a, 1.0), itself, active, fresh)

    def _correct(
        self, time: float, state: State, gains: Gains, residual: np.ndarray, active: np.ndarray, fresh: bool
    ) -> np.ndarray:
        now = self._sources.at(np.array([time]))
        correct(
            self._reference, self._factors, (0, self._blocks.n_blocks), (now.loads[0], now.actions[0]), now.angles[0],
            residual, state.parts(), gains, self._typical_mass, self._blocks.mask(active), fresh, self._size,
        )  # fmt: skip
        return self._size.ravel()[: self.n_samples].copy()

    def limited(self) -> np.ndarray:
        """Return the samples of which a law was limited in the last correction."""
        return self._blocks.unpack(np.isnan(self._equations.problem.actions.about).any(axis=1))

    def turns(self, theta: np.ndarray) -> np.ndarray:
        """Return the angles that turns are counted from at coordinates (n_theta, n), rad, shape (n_turns, n)."""
        return self._equations.turns(theta)

    def frames_of(self, q: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, n_frame, n), for unknowns (n_dofs, n) and turns (n_turns,
        n)."""
        return self._equations.frames(q, turns)

    def count_turns(self, state: State) -> None:
        """Take note of the angles at an instant that is kept."""
        for q, turns in zip(state.q, state.turns):
            count_turns(self._reference, q, turns)

    def take_steps(self, asked: StepsAsked, reference: np.ndarray | None = None) -> StepsTaken:
        """Take equal steps, up to one in which an iteration fails.

        States may be those about a motion: `reference` has its positions, velocities and accelerations at the ends of
        the steps, shape (3, n_steps, n_dofs, n_samples).
        """
        scheme, n, (state, auxiliary, behind, contraction) = asked.scheme, asked.ends.size, asked.moment
        if reference is None:
            reference = np.empty((3, 0, self.n_dofs, self.n_samples))
        about = self._blocks.pack(reference, 2)
        before = (*state.parts(), auxiliary, self._blocks.pack(contraction))
        after = tuple(aligned((n, *part.shape)) for part in before)
        lost, n_corrections = np.empty(self._size.shape, dtype=bool), np.empty(n, dtype=np.int64)
        coefficients = (scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma, scheme.gain_v, scheme.gain_a)
        n_taken = take_steps(
            self._reference, self._factors, self._sources.at(asked.ends), asked.probed, coefficients,
            self._typical_mass, asked.step, tuple(about), behind, before, self._blocks.mask(asked.samples), after,
            lost, n_corrections,
        )  # fmt: skip
        *states, auxiliary, contraction, n_corrections = (part[:n_taken] for part in (*after, n_corrections))
        contraction = contraction.reshape(n_taken, self._size.size)[:, : self.n_samples]
        return StepsTaken(State(*states), auxiliary, contraction, lost.ravel()[: self.n_samples], n_corrections)

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        chosen = self._blocks.mask(samples)[:, None, :]
        for now, before in zip(state.parts(), previous.parts()):
            np.copyto(now, before, where=chosen)

    restore_all = restore

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed, shape (n_events, n_samples)."""
        amplitudes, found = self._sources.at(np.array([time])).actions[0], []
        actions = Reference(self._equations.problem.actions)
        for block in range(self._blocks.n_blocks):
            turns = state.turns[block, len(state.turns[block]) - len(self._equations.problem.actions.dofs) :]
            now = act(actions, block, amplitudes, state.q[block], state.v[block], turns, 0.0, False)
            found.append(now.depths.T)
        return self._blocks.unpack(np.array(found))

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why samples fail; see `SecondOrderSystem.reasons`."""
        finite = np.isfinite(self.unpack(state.v)[:, samples]).all(axis=0)
        return np.where(finite, Status.NOT_CONVERGED, Status.NOT_FINITE)

    def multipliers(self, state: State) -> np.ndarray:
        """Return the multipliers of the constraints, shape (n_constraints, n_samples)."""
        return self._blocks.unpack(state.multipliers)

    def frames(self, state: State) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, n_frame, n_samples)."""
        return self._equations.frames(self.unpack(state.q), self.unpack(state.turns))

    def frames_over(self, states: Sequence[State]) -> np.ndarray:
        """Return the frames of all nodes of the only sample in several states, shape (n_nodes, n_frame, n)."""
        return self._equations.frames(
            np.array([state.q[0, :, 0] for state in states]).T, np.array([state.turns[0, :, 0] for state in states]).T
        )

    def energies(self, time: float, state: State) -> Energies:
        """Return energies and powers at an instant, each of shape (n_samples,)."""
        n = self._blocks.n_blocks
        table = energies_of(
            self._reference, self._conservative, self._sources.at(np.full(n, time)), np.arange(n), state.q, state.v,
            state.multipliers, state.turns,
        )  # fmt: skip
        return self._names.energies(self.unpack(table))

    def energies_over(self, times: Sequence[float], states: Sequence[State]) -> Energies:
        """Return energies and powers of the only sample at several instants, each of shape (n,)."""
        parts = zip(*((state.q[0], state.v[0], state.multipliers[0], state.turns[0]) for state in states))
        strengths = self._sources.at(np.array(times))
        first = np.zeros(len(states), dtype=np.int64)
        table = energies_of(self._reference, self._conservative, strengths, first, *(np.array(part) for part in parts))
        return self._names.energies(table[..., 0].T)


class FullDistributed(FullSystem):
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
    settled, built_in
        See `FullSystem`.
    """

    def __init__(
        self,
        equations: FullEquations,
        comm: Comm,
        motions: Mapping[int, Motion | Held] = MappingProxyType({}),
        settled: Settled | None = None,
        built_in: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        sources = Sources(equations.loads, equations.actions, tuple(motions.values()))
        super().__init__(equations, comm, 1, sources, settled, built_in)
        self.rows, layout, self._problem = equations.rows, equations.layout, equations.problem
        n, n_all = layout.n_unknowns, layout.needed.size
        self._n, self._own = n, np.searchsorted(layout.needed, np.arange(self.rows.start, self.rows.stop))
        self._multipliers = n + np.flatnonzero(equations.owned_constraints)
        self._x, self._diagonal = np.empty((n_all, 1)), np.zeros((n_all, 1))
        self._lower = np.zeros((layout.n_lower, 1))
        self._solver = RankSolver(layout, np.concatenate([self._own, self._multipliers]), self._rows_of_all(), comm)
        self._typical_mass = comm.allreduce(float(mass_on_diagonal(self._problem, equations.size)[0, 0])) / self.n_dofs
        self._typical_stiffness = 0.0
        self._solver_failed = False
        self.rubs = any(comm.allgather(rubs(self._problem.actions.laws)))
        self._counted_edges = np.flatnonzero(self._problem.actions.counted[equations.edges])
        self.n_events = comm.allreduce(len(self._counted_edges))

    def close(self) -> None:
        """Destroy the PETSc objects."""
        self._solver.close()

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Gather a state's array of unknowns from all ranks as (n, 1), on every rank."""
        return np.concatenate(self.comm.allgather(array))[:, None]

    def at_rest(self, q: np.ndarray, theta: np.ndarray) -> State:
        """Return a state at rest without multipliers, for unknowns of shape (n_dofs,) and coordinates (n_theta,)."""
        return self._state(q[:, None], np.zeros((self.n_dofs, 1)), self._equations.turns(theta[:, None]))

    def _state(self, q: np.ndarray, v: np.ndarray, turns: np.ndarray) -> State:
        own, speeds = (part[self.rows.start : self.rows.stop, 0].copy() for part in (q, v))
        return State(own, speeds, np.zeros_like(own), np.zeros(self._multipliers.size), turns[:, 0])

    def _against(self, rows: np.ndarray) -> np.ndarray:
        return rows[self._equations.chosen]

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
        state = self._state(q[:, None], v[:, None], self._equations.turns(theta[:, None]))
        return float(self.energies(0.0, state).kinetic[0])

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        return self._correct(time, state, (scheme.gain_v, scheme.gain_a, 1.0), ITSELF, active, fresh)

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
        """Return whether a law was limited in the last correction, the same on all ranks. Collective on `comm`."""
        return np.array([any(self.comm.allgather(bool(np.isnan(self._problem.actions.about).any())))])

    def count_turns(self, state: State) -> None:
        """Take note of the angles at an instant that is kept."""
        if state.turns.size:
            count_turns(self._reference, self._gathered(state.q)[: self._n], state.turns[:, None])

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put the sample back."""
        if samples[0]:
            for now, before in zip(state.parts(), previous.parts()):
                now[:] = before

    restore_all = restore

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed, shape (n_events, 1), the same on all ranks. Collective on `comm`."""
        q, v = (self._gathered(part)[: self._n] for part in (state.q, state.v))
        own = np.zeros(0)
        if self._equations.actions:
            amplitudes = self._sources.at(np.array([time])).actions[0]
            turns = state.turns[state.turns.size - len(self._problem.actions.dofs) :, None]
            own = act(Reference(self._problem.actions), 0, amplitudes, q, v, turns, 0.0, False).depths[0]
        return np.concatenate(self.comm.allgather(own[self._counted_edges]))[:, None]

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why the sample fails; see `SecondOrderSystem.reasons`. Collective on `comm`."""
        finite = all(self.comm.allgather(bool(np.isfinite(state.v).all())))
        if self._solver_failed:
            return np.array([Status.SOLVER_FAILED])
        return np.array([Status.NOT_CONVERGED if finite else Status.NOT_FINITE])

    def multipliers(self, state: State) -> np.ndarray:
        """Return the multipliers of the constraints, shape (n_constraints, 1), on every rank. Collective on `comm`."""
        equations = self._equations
        every = np.zeros((equations.constraints.n_constraints, 1))
        every[equations.chosen[equations.owned_constraints], 0] = state.multipliers
        return self.comm.allreduce(every)

    def frames(self, state: State) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, n_frame, 1), the same on all ranks. Collective on `comm`."""
        return self._equations.frames(self.unpack(state.q), state.turns[:, None])

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


class FullStatics:
    """One sample whose coordinates are held; see `Statics`. Collective on `comm`.

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

    def __init__(self, equations: FullEquations, n_theta: int, comm: Comm) -> None:
        self._equations = equations
        self._held = {k: Held(0.0) for k in range(n_theta)}
        self._system = FullDistributed(equations, comm, self._held)
        self._q, self._share = np.zeros((equations.n_dofs, 1)), 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._system.close()

    def hold(self, theta: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the deformation, from the undeformed mechanism; see `Statics.hold`."""
        torques = np.full(theta.shape, np.nan)
        if not samples[0]:
            return torques, np.zeros(1, dtype=bool)
        for held, angle in zip(self._held.values(), theta[0]):
            held.angle = float(angle)
        place = self._equations.place(theta[0], np.zeros_like(theta[0]))[0]
        state = self._system.at_rest(place, theta[0])

        def begin(going: np.ndarray) -> None:
            self._system.restore(state, self._system.at_rest(place, theta[0]), going)

        def converge(going: np.ndarray, share: float) -> np.ndarray:
            return iterate_at_rest(lambda _: self._corrected(state, share), going)

        lost, (self._share,) = put_on(begin, converge, samples)
        if not lost[0]:
            self._q = self._system.unpack(state.q)
            torques[0] = self._system.multipliers(state)[-theta.shape[1] :, 0]  # those of driven angles come last
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
            moments.append(2.0 * self._system.kinetic_energy(self._equations.place(theta, rates)[1]))
        return np.array([moments])

    def _corrected(self, state: State, share: float) -> np.ndarray:
        """Correct a state under a share of the loads, in place; return the size, no number where that fails."""
        try:
            return np.array([self._system.correct_at_rest(state, share, LONGEST)])
        except RunError:
            return np.full(1, np.nan)
