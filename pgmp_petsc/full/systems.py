"""The full-order model as a second-order system for the integrator: batches of samples.

    M q'' + g_int(q) + C(q)^T lambda = g_ext(t),     c(q) = 0

(Naets et al. 2015, eq. (3)). A batch is on one rank, LANES samples side by side (`full.kernel`). One sample on many
ranks, and statics, are in `full.distributed`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np

from pgmp_petsc.base.surroundings import Comm, alone
from pgmp_petsc.controllers.acting import NOTED
from pgmp_petsc.controllers.running import BEFORE, MOST_STARTS, Controls, States
from pgmp_petsc.effects import Effect, Motion
from pgmp_petsc.effects.time_function import driven
from pgmp_petsc.full.carried import Carried, find_all_carried
from pgmp_petsc.full.energy import EnergyNames, energies_of
from pgmp_petsc.full.forces import act_over
from pgmp_petsc.full.kernel import Factors, count_turns
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.full.parts import mass_on_diagonal
from pgmp_petsc.full.problem import FullEquations, Sources
from pgmp_petsc.full.steps import Beside, correct, take_steps
from pgmp_petsc.lanes.lane_items import SampleBlocks, aligned
from pgmp_petsc.lanes.vectors import aligned_zeros
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.multipliers import OfConnection
from pgmp_petsc.stepping.second_order_system import Energies, Scheme, SecondOrderSystem, State, StepsAsked, StepsTaken
from pgmp_petsc.stepping.status import Status

# A call from Python costs what some tens of steps of a small mechanism do. What lies behind an edge that is crossed is
# taken again
STEPS_AT_ONCE, BEFORE_EDGES = 200, 32
STATES_AT_ONCE = 256  # of all samples, whose frames and energies are evaluated together
LARGEST = 2**18  # unknowns of all samples and steps that are kept from a call
ACROSS = 0.1  # of the largest velocity: no run that is stable has as much across what joints hold
ACROSS_IN_STEP = 1e-3  # of the mechanism's size, or rad, in a step: what trembles about rest is below it
Gains = tuple[float, float, float]  # of velocities, accelerations and stiffness


class FullSystem(SecondOrderSystem, AbstractContextManager):
    """Full-order samples, whose states a subclass lays out in arrays.

    Whoever makes them may let them start from `settled`, the static equilibrium of every sample, or, where joints that
    are off deform the mechanism, from `built_in`, unknowns and velocities, each (n_dofs, 1 or n_samples); without these
    the mechanism is undeformed. `sources` change with time, and `comm` shares the model.
    """

    def __init__(self, equations: FullEquations, comm: Comm, n_samples: int, sources: Sources) -> None:
        self.comm, self.n_samples = comm, n_samples
        self.values = equations.values  # of the parameters, each of shape (n_samples,)
        self._equations, self._sources = equations, sources
        self._reference = self._of_unknowns = Reference(equations.problem)
        self._actions = Reference(equations.problem.actions)
        constraints = equations.constraints
        self.n_dofs, self.n_constraints = equations.n_dofs, constraints.n_constraints
        self.moving_constraints = not constraints.linear or constraints.n_driven > 0
        self._conservative = np.array([effect.conservative for effect in equations.loads], dtype=bool)
        self._names = EnergyNames.of(equations, sources.motions)

    def __exit__(self, *_: object) -> None:
        self.close()

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Return a state's array of unknowns as (n, n_samples), on every rank."""
        raise NotImplementedError

    def multipliers(self, state: State) -> np.ndarray:
        """Return the multipliers of the constraints, shape (n_constraints, n_samples), on every rank. Collective on
        `comm`."""
        raise NotImplementedError

    def multipliers_of_joints(self, times: Sequence[float], states: State) -> np.ndarray:
        """Return the scheme's own multipliers of joints and driven angles (`ConstraintSet.of_joints`) at times (n_t,),
        in states with a leading axis of instants, shape (n, n_t n_samples). Collective on `comm`."""
        each = [self.multipliers(states.at(k)) for k in range(len(times))]
        return self._equations.constraints.of_joints(np.concatenate(each, axis=1))

    def joint_multipliers(self, times: Sequence[float], states: State) -> np.ndarray:
        """Return the multipliers of joints and driven angles (`ConstraintSet.of_joints`) at times (n_t,), s, in states
        with a leading axis of instants, shape (n, n_t n_samples), instant after instant. Collective on `comm`.

        They are those with which accelerations obey the constraints, ``C q'' = -(dC/dt) q' + c_tt``, in the state's
        positions and velocities, and not those of the scheme (docs/method.md, forces in joints). Accelerations are
        those before forces of controllers jump, and so are these.
        """
        with nullcontext() if self.beside is None else self.beside.on_side(BEFORE):
            drift = self._drift(times, self._columns(states.q), self._columns(states.v))
            drift = np.moveaxis(drift.reshape(len(drift), len(times), self.n_samples), 1, 0)
            return self.multipliers_of_joints(times, self._accelerated_over(times, states, drift))

    def frames(self, state: State) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, n_frame, n_samples), the same on all ranks. Collective on
        `comm`."""
        return self.frames_over(state.alone)

    def _drift(self, times: Sequence[float], q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return what is left of the accelerations of the constraints where states (n_dofs, n) have none, (n_rows, n);
        each of the times (n_t,) is that of ``n / n_t`` of them."""
        return self._equations.constraints.drift(q, v, self._accelerations(times, q.shape[1]))

    def _accelerations(self, times: Sequence[float], n: int) -> np.ndarray:
        """Return the accelerations of the prescribed motions, (n_motions, n), at times as of `_drift`."""
        each = [driven(self._sources.motions, time).acceleration for time in times]
        return np.repeat(np.array(each).T, n // len(times), axis=1)

    def _rates(self, time: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the rates of the constraints, (n_rows, n)."""
        return self._equations.constraints.rates(q, v, driven(self._sources.motions, time).speed)

    def start(self) -> State:
        found = self._begun.copy()
        if self.beside is not None:
            self.beside.start(found)
            self.beside.settle(found)
        return found

    @cached_property
    def _begun(self) -> State:
        """The start: two runs of a system begin with it, the second for the error of the first one's step."""
        if self.settled is None:
            return self.consistent(*(self.built_in or self._equations.start), self._equations.initial[0])
        q = self.settled.unknowns
        state = self.consistent(q, np.zeros_like(q), self.settled.theta.T)
        return self.settled.at_rest(state, len(self._sources.motions))

    def consistent(self, q: np.ndarray, v: np.ndarray, theta: np.ndarray) -> State:
        """Return the state at time 0 with given unknowns and velocities that obey the constraints, and the coordinates.

        They have the shape (n,) where they are the same of all samples, or else (n, n_samples).
        """
        turns = self._equations.turns(theta.reshape(theta.shape[0], -1))
        q, v = q.reshape(self.n_dofs, -1), v.reshape(self.n_dofs, -1)
        n = max(q.shape[1], v.shape[1])
        q, v = (np.repeat(part, n // part.shape[1], axis=1) for part in (q, v))
        drift, state = self._against(self._drift([0.0], q, v)), self._state(q, v, turns)
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
        q, v = self.unpack(state.q), self.unpack(state.v)
        # accelerations are linear in the residual in place of c: a step's worth of dv is the difference of two
        rates = self._against(self._rates(time, q, v) / step)
        before = self._accelerated(time, state, np.zeros_like(rates), samples, True).a
        moved = state.copy()
        moved.v += step * (self._accelerated(time, state, rates, samples, False).a - before)
        self.restore(state, moved, samples)
        drift = self._against(self._drift([time], q, self.unpack(state.v)))
        self.restore(state, self._accelerated(time, state, drift, samples, False), samples)

    def strayed(self, state: State, step: float) -> np.ndarray:
        constraints = self._equations.constraints
        if not self.moving_constraints:
            return super().strayed(state, step)
        q, v = self.unpack(state.q), self.unpack(state.v)
        across, fastest = constraints.strayed(q, v, self._equations.units)
        return (across > ACROSS * fastest) & (across * step > ACROSS_IN_STEP)

    def _state(self, q: np.ndarray, v: np.ndarray, turns: np.ndarray) -> State:
        """Lay out unknowns, velocities and turns (n, 1 or n_samples), without accelerations and multipliers."""
        raise NotImplementedError

    def _against(self, rows: np.ndarray) -> np.ndarray:
        """Lay out the residual in place of c, of all constraints, (n_constraints, 1 or n_samples)."""
        raise NotImplementedError

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        return self._correct(time, state, (scheme.gain_v, scheme.gain_a, 1.0), self._itself, active, fresh)

    def _correct(
        self, time: float, state: State, gains: Gains, residual: np.ndarray, active: np.ndarray, fresh: bool
    ) -> np.ndarray:
        """Correct a state in place; `residual` replaces c where it is not `_itself`. Return the sizes."""
        raise NotImplementedError

    def _accelerated(self, time: float, state: State, drift: np.ndarray, samples: np.ndarray, fresh: bool) -> State:
        """Return a state with the accelerations and multipliers of ``M a + C^T lambda = g_ext - g_int, C a = -drift``.

        Both enter linearly: one correction with the mass alone solves it.
        """
        trial = state.copy()
        trial.a[:] = 0.0
        self._correct(time, trial, (0.0, 1.0, 0.0), drift, samples, fresh)
        return State(state.q, state.v, trial.a, trial.multipliers, state.turns, state.beside)

    def _accelerated_over(self, times: Sequence[float], states: State, drift: np.ndarray) -> State:
        """Return states with a leading axis of instants with such accelerations and multipliers, of all samples; see
        `_accelerated`. The drift has the shape (n_t, n_rows, n_samples)."""
        everyone = np.ones(self.n_samples, dtype=bool)
        return State.along(
            [
                self._accelerated(time, states.at(k), self._against(drift[k]), everyone, True)
                for k, time in enumerate(times)
            ]
        )

    def control(self, controls: Controls) -> None:
        """Let controllers act on the only sample."""
        self.beside = self._sources.controls = controls
        self.held = controls.holds

    def put_forces(self, forces: Sequence[np.ndarray]) -> None:
        """Take what is given to each action; see `Controls`."""
        parameters = self._equations.problem.actions.parameters
        for column, number in zip(*self._sources.controlled):
            parameters[:, column, :, : forces[number].shape[1]] = forces[number]

    def begin_iteration(self) -> None:
        """Forget at which rates laws were evaluated; see `SecondOrderSystem`."""
        self._equations.problem.actions.about[:] = np.nan

    def unknowns_over(self, states: State) -> list[np.ndarray]:
        """Return unknowns, velocities and accelerations of states with a leading axis of n_t instants, (n_dofs, n_t
        n_samples) each, instant after instant, on every rank."""
        every = self._in_unknowns(states)
        return [self._columns(part) for part in (every.q, every.v, every.a)]

    def _in_unknowns(self, states: State) -> State:
        """Return states with a leading axis in the unknowns of all frames."""
        return states

    def _columns(self, parts: np.ndarray) -> np.ndarray:
        """Return unknowns of states with a leading axis of n_t instants as (n, n_t n_samples)."""
        return np.concatenate([self.unpack(part) for part in parts], axis=1)

    def frames_over(self, states: State) -> np.ndarray:
        """Return the frames of all nodes in these states, shape (n_nodes, n_frame, n_t n_samples)."""
        raise NotImplementedError


class FullBatch(FullSystem):
    """A batch of full-order samples, or a single one, on this rank, from an undeformed configuration.

    Arrays have shape (n_blocks, n, n_lanes); see `SampleBlocks`. Parameter values of the samples have shape
    (n_samples,), `initial` positions (rad) and velocities (rad/s) of the rigid coordinates shape (n_theta,) each, and
    `motions` are prescribed ones by the number of their coordinate. What is to be stepped `in_joints`, by a
    `JointBatch`, has no matrix of its own.
    """

    _joints: Reference | None = None  # in joint coordinates what these are
    _carried: Reference  # joints whose forces friction hangs on
    _states: States  # controllers that compiled steps take along

    def __init__(
        self,
        kinematics: RigidKinematics,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[np.ndarray, np.ndarray],
        n_samples: int,
        motions: Mapping[int, Motion],
        in_joints: bool = False,
    ) -> None:
        blocks = self._blocks = SampleBlocks.of(n_samples)
        equations = FullEquations(kinematics, effects, values, blocks, initial, in_joints=in_joints)
        super().__init__(equations, alone(), n_samples, equations.sources(effects, tuple(motions.values())))
        self.n_events = len(equations.edges)
        self._bound_calls()
        n = self.n_dofs + self.n_constraints
        self._factors = Factors(
            aligned_zeros((blocks.n_blocks, n + equations.layout.n_lower, blocks.n_lanes)),
            aligned_zeros((n, blocks.n_lanes)),
        )
        self._itself = np.empty((blocks.n_blocks, 0, blocks.n_lanes))  # no residual but c, and nothing beside
        self._typical_mass = mass_on_diagonal(equations.problem, equations.size) / self.n_dofs

    def _bound_calls(self) -> None:
        """Find how many steps are taken in a call, with and without edges that may end them."""
        #: see `SecondOrderSystem`, for steps that no edge ends
        self.edgeless_at_once = max(1, min(STEPS_AT_ONCE, LARGEST // (self.n_dofs * self.n_samples)))
        self.steps_at_once = min(BEFORE_EDGES, self.edgeless_at_once) if self.n_events else self.edgeless_at_once

    @property
    def typical_mass(self) -> np.ndarray:
        """Whose inertia the constraints are scaled to, of every sample, kg, shape (n_samples,)."""
        return self._typical_mass.ravel()[: self.n_samples]

    @property
    def instants_at_once(self) -> int:
        return max(1, STATES_AT_ONCE // self.n_samples)

    def steps_between_looks(self, every: int | None) -> int:
        return STEPS_AT_ONCE

    def under(self, effects: Sequence[Effect], motions: Mapping[int, Motion]) -> Self:
        """Return the batch under effects and motions that differ from its own over time alone; both share memory."""
        other = copy(self)
        other._sources = self._equations.sources(effects, tuple(motions.values()))
        vars(other).pop("_begun", None)  # under other loads it begins with other accelerations
        return other

    def control(
        self, controls: Controls, forces: Sequence[OfConnection] = (), origins: np.ndarray | None = None
    ) -> None:
        """Let controllers act on the only sample, and friction by `forces` that joints carry; `origins` are what counts
        as zero of each motion that is measured, (n_rows,), where actions measure all of them, and None elsewhere."""
        super().control(controls)
        self.carries = origins is not None and controls.is_continuous
        self._carried = Reference(self._carried_of(forces))
        if self.carries:
            columns, numbers = self._sources.controlled
            actions = np.array(columns)[np.argsort(numbers)]
            self._states = States.of(controls, actions, origins[:, None], 1, self._blocks.n_lanes)

    def _carried_of(self, forces: Sequence[OfConnection]) -> Carried:
        constraints = self._equations.constraints
        numbers = constraints.of_joints(1 + np.arange(constraints.n_constraints)) - 1
        return Carried.of(forces, self._equations, numbers.astype(int))

    def carried(self, time: float, state: State) -> np.ndarray:
        """Return the forces that joints carry, (n, n_samples)."""
        now, blocks = self._sources.at(np.array([time])), self._blocks
        found = np.empty((blocks.n_blocks, self._carried.parts.actions.size, blocks.n_lanes))
        find_all_carried(
            self._reference, self._joints, self._factors, self._carried, (now.loads[0], now.actions[0]), now.angles[0],
            state.parts(), self._typical_mass, found,
        )  # fmt: skip
        return blocks.unpack(found)

    def unpack(self, array: np.ndarray) -> np.ndarray:
        return self._blocks.unpack(array)

    def turns(self, theta: np.ndarray) -> np.ndarray:
        """Return the angles that turns are counted from at coordinates (n_theta, n), rad, shape (n_turns, n)."""
        return self._equations.turns(theta)

    def pack(self, rows: np.ndarray, place: int = 0) -> np.ndarray:
        """Return rows of shape (..., n_samples), or the same ones for all samples, as a state's array; behind a leading
        axis of instants the place of the blocks is 1."""
        return self._blocks.pack(np.broadcast_to(rows, (*rows.shape[:-1], self.n_samples)), place)

    _against = pack

    def _state(self, q: np.ndarray, v: np.ndarray, turns: np.ndarray) -> State:
        nothing, unbound = np.zeros((self.n_dofs, 1)), np.zeros((self.n_constraints, 1))
        return State(*(self.pack(part) for part in (q, v, nothing, unbound, turns)))

    def _correct(
        self, time: float, state: State, gains: Gains, residual: np.ndarray, active: np.ndarray, fresh: bool
    ) -> np.ndarray:
        parts, size = tuple(part[None] for part in state.parts()), np.empty((1, *self._typical_mass.shape))
        self._correct_over(np.array([time]), parts, gains, residual[None], active, fresh, size)
        return size.ravel()[: self.n_samples]

    def _correct_over(
        self, times: np.ndarray, parts: tuple[np.ndarray, ...], gains: Gains, residual: np.ndarray, active: np.ndarray,
        fresh: bool, size: np.ndarray,
    ) -> None:  # fmt: skip
        correct(
            self._reference, self._joints, self._factors, self._sources.at(times), residual, parts, gains,
            self._typical_mass, self._blocks.mask(active), fresh, size,
        )  # fmt: skip

    def _accelerated_over(self, times: Sequence[float], states: State, drift: np.ndarray) -> State:
        q, v, a, multipliers, turns = states.parts()
        trial = q.copy(), v.copy(), np.zeros_like(a), multipliers.copy(), np.ascontiguousarray(turns)
        everyone, size = np.ones(self.n_samples, dtype=bool), np.empty((len(times), *self._typical_mass.shape))
        self._correct_over(np.array(times), trial, (0.0, 1.0, 0.0), self.pack(drift, 1), everyone, True, size)
        return replace(states, a=trial[2], multipliers=trial[3])

    def limited(self) -> np.ndarray:
        return self._blocks.unpack(np.isinf(self._equations.problem.actions.about).any(axis=1))

    def count_turns(self, state: State) -> None:
        for q, turns in zip(state.q, state.turns):
            count_turns(self._reference, q, turns)

    def take_steps(self, asked: StepsAsked, reference: np.ndarray | None = None) -> StepsTaken:
        """Take equal steps, up to one in which an iteration fails.

        States may be those about a motion: `reference` has its positions, velocities and accelerations at the ends of
        the steps, shape (3, n_steps, n_dofs, n_samples).
        """
        scheme, n, (state, auxiliary, behind, contraction) = asked.scheme, asked.ends.size, asked.moment
        about = np.empty((3, 0, *state.q.shape)) if reference is None else self._blocks.pack(reference, 2)
        numbers, beside = self._itself, None
        if self.carries:
            numbers = self._blocks.pack(state.beside.T)
            self.beside.iterates = True
            beside = Reference(Beside(self._carried.parts, self._states, self.beside.over(asked.ends)))
        before = (*state.parts(), auxiliary, self._blocks.pack(contraction), numbers)
        after = tuple(aligned((n, *part.shape)) for part in before)
        lost, n_corrections = np.empty(self._typical_mass.shape, dtype=bool), np.empty(n, dtype=np.int64)
        coefficients = (scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma, scheme.gain_v, scheme.gain_a)
        n_taken = take_steps(
            self._reference, self._joints, beside, self._factors, self._sources.at(asked.ends), asked.probed,
            coefficients, self._typical_mass, asked.step, tuple(about), behind, before,
            self._blocks.mask(asked.samples), after, lost, n_corrections,
        )  # fmt: skip
        *states, auxiliary, contraction, numbers, n_corrections = (part[:n_taken] for part in (*after, n_corrections))
        contraction, states = contraction.reshape(n_taken, self._typical_mass.size)[:, : self.n_samples], State(*states)
        if self.carries:
            states.beside = np.moveaxis(self._blocks.unpack(np.moveaxis(numbers, 1, 0)), 1, 2)
            self.beside.take_steps(asked.ends[:n_taken], states.beside)
        return StepsTaken(states, auxiliary, contraction, lost.ravel()[: self.n_samples], n_corrections)

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        chosen = self._blocks.mask(samples)[:, None, :]
        for now, before in zip(state.parts(), previous.parts()):
            np.copyto(now, before, where=chosen)

    restore_all = restore

    def depths(self, times: np.ndarray, states: State, samples: np.ndarray) -> np.ndarray:
        found, blocks = self._acted(self._sources.amplitudes(times), states, samples), self._blocks
        return blocks.unpack(np.moveaxis(found, 1, 0))

    def measured(self, state: State) -> np.ndarray:
        """Return the motions that forces of controllers are of, or are led by, and their rates, a row for each part of
        what is given, (n_rows, n_samples, 2)."""
        columns, numbers = self._sources.controlled
        everyone = np.ones(self.n_samples, dtype=bool)
        self._acted(np.zeros((1, len(self._sources.actions))), state.alone, everyone)
        noted = self._equations.problem.actions.parameters[0, columns]
        return noted[np.argsort(numbers), : self.n_samples, NOTED]

    def _acted(self, amplitudes: np.ndarray, states: State, samples: np.ndarray) -> np.ndarray:
        """Evaluate the actions of some samples in states with a leading axis of instants, with amplitudes (n_t,
        n_actions); return how far edges are crossed, (n_t, n_blocks, n_events, n_lanes)."""
        every, blocks = self._in_unknowns(states), self._blocks
        found = np.empty((len(amplitudes), blocks.n_blocks, self.n_events, blocks.n_lanes))
        act_over(
            self._actions, self._equations.problem.width, amplitudes, every.q, every.v, every.turns,
            blocks.mask(samples), found,
        )  # fmt: skip
        return found

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        finite = np.isfinite(self.unpack(state.v)[:, samples]).all(axis=0)
        return np.where(finite, Status.NOT_CONVERGED, Status.NOT_FINITE)

    def multipliers(self, state: State) -> np.ndarray:
        return self._blocks.unpack(state.multipliers)

    def frames_over(self, states: State) -> np.ndarray:
        every = self._in_unknowns(states)
        return self._equations.frames(self._columns(every.q), self._columns(every.turns))

    def energies_over(self, times: Sequence[float], states: State) -> Energies:
        n, shape, flat = self._blocks.n_blocks, states.q.shape[:2], self._in_unknowns(states).merged()
        strengths, blocks = self._sources.at(np.repeat(times, n)), np.tile(np.arange(n), len(times))
        table = energies_of(
            self._of_unknowns, self._conservative, strengths, blocks, flat.q, flat.v, flat.multipliers, flat.turns
        )  # fmt: skip
        return self._names.energies(self._columns(table.reshape(*shape, *table.shape[1:])))

    def _columns(self, parts: np.ndarray) -> np.ndarray:
        if len(parts) == 1:
            return self._blocks.unpack(parts[0])  # in less time
        rows = self._blocks.unpack(np.moveaxis(parts, 1, 0))
        return np.moveaxis(rows, 0, 1).reshape(rows.shape[1], len(rows) * self.n_samples)
