"""The full-order model of a batch of samples as one second-order system for the integrator, on one rank."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from types import MappingProxyType
from typing import Self

import numpy as np

from pgmp_petsc.dynamics.alpha_step import FIRST_CONTRACTION, StepsAsked, StepsTaken, StepTaken
from pgmp_petsc.dynamics.energies import Energies
from pgmp_petsc.dynamics.full_energy import EnergyNames, energies_of
from pgmp_petsc.dynamics.full_forces import act
from pgmp_petsc.dynamics.full_kernel import Factors, correct, count_turns
from pgmp_petsc.dynamics.full_parts import mass_on_diagonal
from pgmp_petsc.dynamics.full_problem import FullEquations
from pgmp_petsc.dynamics.full_steps import take_steps
from pgmp_petsc.dynamics.part_reference import Reference
from pgmp_petsc.dynamics.sample_blocks import SampleBlocks
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.dynamics.static_equilibrium import Settled
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.effects import Effect, Motion, driven
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.runtime.lane_items import aligned
from pgmp_petsc.runtime.surroundings import alone
from pgmp_petsc.runtime.vectors import aligned_zeros

# A call from Python costs what some tens of steps of a small mechanism do. What lies behind an edge that is crossed is
# taken again
STEPS_AT_ONCE, BEFORE_EDGES = 50, 32
LARGEST = 2**18  # unknowns of all samples and steps that are kept from a call


class FullBatch:
    """A batch of full-order samples, or a single one.

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
    settled
        Static equilibrium of every sample to start from; the undeformed mechanism if there is none.

    Attributes
    ----------
    steps_at_once
        Equal steps that one call is to take; see `AlphaStep`.
    instants_at_once
        States of a run whose frames and energies are best evaluated together.
    has_light_nodes
        See `first_accelerations`.
    """

    instants_at_once = 256
    has_light_nodes = True

    def __init__(
        self,
        kinematics: RigidKinematics,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[np.ndarray, np.ndarray],
        n_samples: int,
        motions: Mapping[int, Motion] = MappingProxyType({}),
        settled: Settled | None = None,
    ) -> None:
        self.comm, self.settled = alone(), settled
        blocks = self._blocks = SampleBlocks.of(n_samples)
        equations = self._equations = FullEquations(kinematics, effects, values, blocks, initial)
        self.n_samples, self.n_dofs = n_samples, equations.n_dofs
        self.n_constraints = equations.constraints.n_constraints
        most = BEFORE_EDGES if equations.edges else STEPS_AT_ONCE
        self.steps_at_once = max(1, min(most, LARGEST // (self.n_dofs * n_samples)))
        self._reference = Reference(equations.problem)
        self._sources = equations.sources(effects, tuple(motions.values()))
        self._conservative = np.array([effect.conservative for effect in equations.loads], dtype=bool)
        self._names = EnergyNames.of(equations, self._sources.motions)
        self._nobody = np.zeros(n_samples, dtype=bool)
        n = self.n_dofs + self.n_constraints
        self._factors = Factors(
            aligned_zeros((blocks.n_blocks, n + equations.layout.n_lower, blocks.n_lanes)),
            aligned_zeros((n, blocks.n_lanes)),
        )
        self._size = np.empty((blocks.n_blocks, blocks.n_lanes))
        self._typical_mass = mass_on_diagonal(equations.problem) / self.n_dofs

    def under(self, effects: Sequence[Effect], motions: Mapping[int, Motion]) -> Self:
        """Return the batch under effects and motions that differ from its own over time alone; both share memory."""
        other = copy(self)
        other._sources = self._equations.sources(effects, tuple(motions.values()))
        return other

    def __enter__(self) -> FullBatch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Nothing is to be given back."""

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Parameter values of the samples, each of shape (n_samples,)."""
        return self._equations.values

    def start(self) -> State:
        """Return the start, undeformed or settled, with consistent accelerations and multipliers."""
        theta, rates = self._equations.initial
        if self.settled is not None:
            q = self.settled.unknowns
            state = self.consistent(q, np.zeros_like(q), self.settled.theta.T)
            return self.settled.at_rest(state, len(self._sources.motions))
        return self.consistent(*self._equations.place(theta, rates), theta)

    def consistent(self, q: np.ndarray, v: np.ndarray, theta: np.ndarray) -> State:
        """Return the state at time 0 with given unknowns and velocities that obey the constraints, and the coordinates.

        They have the shape (n,) where they are the same of all samples, or else (n, n_samples).
        """
        turns = self._equations.turns(theta.reshape(theta.shape[0], -1))
        accelerations = driven(self._sources.motions, 0.0).acceleration
        q, v = q.reshape(self.n_dofs, -1), v.reshape(self.n_dofs, -1)
        n = max(q.shape[1], v.shape[1])
        q, v = (np.repeat(part, n // part.shape[1], axis=1) for part in (q, v))
        drift = self._equations.constraints.drift(q, v, accelerations)
        nothing = np.zeros((self.n_dofs, 1))
        parts = q, v, nothing, np.zeros((self.n_constraints, 1)), turns, drift
        *parts, drift = (self.pack(np.broadcast_to(part, (len(part), self.n_samples))) for part in parts)
        return self._accelerated(0.0, State(*parts), drift, np.ones(self.n_samples, dtype=bool), True)

    def _accelerated(self, time: float, state: State, drift: np.ndarray, samples: np.ndarray, fresh: bool) -> State:
        """Return a state with the accelerations and multipliers of ``M a + C^T lambda = g_ext - g_int, C a = -drift``.

        Both enter linearly: one correction with the mass alone solves it.
        """
        trial = state.copy()
        trial.a[:] = 0.0
        self._correct(time, trial, (0.0, 1.0, 0.0), drift, samples, fresh)
        return State(state.q, state.v, trial.a, trial.multipliers, state.turns)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        itself = np.empty((self._blocks.n_blocks, 0, self._blocks.n_lanes))
        return self._correct(time, state, (scheme.gain_v, scheme.gain_a, 1.0), itself, active, fresh)

    def begin_iteration(self) -> None:
        """Forget at which rates laws were evaluated; see `AlphaStep`."""
        self._equations.problem.actions.about[:] = np.nan

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
        """Take equal steps, up to one in which an iteration fails; see `AlphaStep`.

        States may be those about a motion: `reference` has its positions, velocities and accelerations at the ends of
        the steps, shape (3, n_steps, n_dofs, n_samples).
        """
        previous, scheme, n = asked.previous, asked.scheme, asked.ends.size
        expected = np.full(self._size.shape, FIRST_CONTRACTION) if asked.expected is None else asked.expected
        if reference is None:
            reference = np.empty((3, 0, self.n_dofs, self.n_samples))
        about = self._blocks.pack(reference, 2)
        before = (previous.q, previous.v, previous.a, previous.multipliers, previous.turns, asked.auxiliary, expected)
        after = tuple(aligned((n, *part.shape)) for part in before)
        lost, n_corrections = np.empty(self._size.shape, dtype=bool), np.empty(n, dtype=np.int64)
        coefficients = (scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma, scheme.gain_v, scheme.gain_a)
        n_taken = take_steps(
            self._reference, self._factors, self._sources.at(asked.ends), asked.probed, coefficients,
            self._typical_mass, asked.step, tuple(about), asked.behind,
            before, self._blocks.mask(asked.samples), after, lost, n_corrections,
        )  # fmt: skip
        taken = [part[:n_taken] for part in (*after, n_corrections)]
        return StepsTaken(State(*taken[:5]), *taken[5:], lost.ravel()[: self.n_samples])

    def with_samples(self, taken: StepTaken, other: StepTaken, samples: np.ndarray) -> StepTaken:
        """Return a step with some samples, a mask, as in another one of the same length; its arrays are used again."""
        self.restore(taken.state, other.state, samples)
        chosen = self._blocks.mask(samples)
        np.copyto(taken.auxiliary, other.auxiliary, where=chosen[:, None, :])
        np.copyto(taken.expected, other.expected, where=chosen)
        lost, n_iterations = np.where(samples, other.lost, taken.lost), taken.n_iterations + other.n_iterations
        return replace(taken, lost=lost, n_iterations=n_iterations)

    def project(self, time: float, state: State, step: float, samples: np.ndarray) -> None:
        """Make velocities and accelerations of some samples consistent with the constraints at the end of a step.

        With the rates ``C v - c_t`` of the constraints, c_t those of the motions, the least change dv in the norm of
        the mass and then the accelerations follow from

            M dv + C^T mu = 0,  C dv = -(C v - c_t);    M a + C^T lambda = g_ext - g_int,  C a = -(dC/dt) v + c_tt.
        """
        constraints, now = self._equations.constraints, driven(self._sources.motions, time)
        q, v = self.unpack(state.q), self.unpack(state.v)
        # accelerations are linear in what stands for c: a step's worth of dv is the difference of two
        rates = self.pack(constraints.rates(q, v, now.speed) / step)
        before = self._accelerated(time, state, np.zeros_like(rates), samples, True).a
        dv = step * (self._accelerated(time, state, rates, samples, False).a - before)
        chosen = self._blocks.mask(samples)[:, None, :]
        np.add(state.v, dv, out=state.v, where=chosen)
        drift = self.pack(constraints.drift(q, self.unpack(state.v), now.acceleration))
        found = self._accelerated(time, state, drift, samples, False)
        np.copyto(state.a, found.a, where=chosen)
        np.copyto(state.multipliers, found.multipliers, where=chosen)

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        chosen = self._blocks.mask(samples)
        for now, before in (
            (state.q, previous.q),
            (state.v, previous.v),
            (state.a, previous.a),
            (state.multipliers, previous.multipliers),
            (state.turns, previous.turns),
        ):
            np.copyto(now, before, where=chosen[:, None, :])

    @property
    def moving_constraints(self) -> bool:
        """Whether constraints turn or follow motions; see `AlphaStep`."""
        return self._equations.moving_constraints

    @property
    def n_events(self) -> int:
        """Number of edges of laws."""
        return len(self._equations.edges)

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed, shape (n_events, n_samples)."""
        amplitudes, found = self._sources.at(np.array([time])).actions[0], []
        actions = Reference(self._equations.problem.actions)
        for block in range(self._blocks.n_blocks):
            turns = state.turns[block, len(state.turns[block]) - len(amplitudes) :]
            now = act(actions, block, amplitudes, state.q[block], state.v[block], turns, 0.0, False)
            found.append(now.depths.T)
        return self._blocks.unpack(np.array(found))

    def outside(self, state: State) -> np.ndarray:
        """Return no sample: the full-order model is valid everywhere."""
        return self._nobody

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why samples fail; see `SecondOrderSystem.reasons`."""
        finite = np.isfinite(self.unpack(state.v)[:, samples]).all(axis=0)
        return np.where(finite, Status.NOT_CONVERGED, Status.NOT_FINITE)

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Return a state's array as (n, n_samples)."""
        return self._blocks.unpack(array)

    def pack(self, rows: np.ndarray) -> np.ndarray:
        """Return rows of shape (n, n_samples) as a state's array."""
        return self._blocks.pack(rows)

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
        strengths = self._sources.at(np.full(n, time))
        table = energies_of(
            self._reference,
            self._conservative,
            strengths,
            np.arange(n),
            state.q,
            state.v,
            state.multipliers,
            state.turns,
        )
        return self._names.energies(self.unpack(table))

    def energies_over(self, times: Sequence[float], states: Sequence[State]) -> Energies:
        """Return energies and powers of the only sample at several instants, each of shape (n,)."""
        parts = zip(*((state.q[0], state.v[0], state.multipliers[0], state.turns[0]) for state in states))
        strengths = self._sources.at(np.array(times))
        first = np.zeros(len(states), dtype=np.int64)
        table = energies_of(self._reference, self._conservative, strengths, first, *(np.array(part) for part in parts))
        return self._names.energies(table[..., 0].T)

    def _correct(
        self,
        time: float,
        state: State,
        gains: tuple[float, float, float],
        residual: np.ndarray,
        active: np.ndarray,
        fresh: bool,
    ) -> np.ndarray:
        parts = (state.q, state.v, state.a, state.multipliers, state.turns)
        now = self._sources.at(np.array([time]))
        chosen = self._blocks.mask(active)
        correct(
            self._reference, self._factors, (0, self._blocks.n_blocks), (now.loads[0], now.actions[0]), now.angles[0],
            residual, parts, gains, self._typical_mass, chosen, fresh, self._size,
        )  # fmt: skip
        return self._size.ravel()[: self.n_samples].copy()
