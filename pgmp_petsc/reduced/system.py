"""The reduced model as a second-order system for the integrator; a batch of samples with their own parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from pgmp_petsc.base.surroundings import alone
from pgmp_petsc.controllers.acting import NOTED, given_to
from pgmp_petsc.controllers.running import MOST_STARTS, Controls
from pgmp_petsc.effects import Effect, Motion
from pgmp_petsc.effects.action import amplitudes_over
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.lanes.lane_items import aligned
from pgmp_petsc.lanes.vectors import LANES
from pgmp_petsc.reduced.action_kernel import ABOUT, FORCE, POWER, STORED, Acting
from pgmp_petsc.reduced.actions import ReducedActions, ReducedStrengths
from pgmp_petsc.reduced.arrays import Room, Strengths
from pgmp_petsc.reduced.control import Control
from pgmp_petsc.reduced.kernel import act_on, correct, evaluate_residuals, fill_matrices, find_all_carried, load_on
from pgmp_petsc.reduced.lagrangian import damping_power, load_powers, reduced_energy
from pgmp_petsc.reduced.sample_lanes import ReducedLanes
from pgmp_petsc.reduced.steps import Clocks, Progress, advance
from pgmp_petsc.reduced.terms import ReducedTerms
from pgmp_petsc.stepping.second_order_system import Energies, Scheme, SecondOrderSystem, State, Stretch
from pgmp_petsc.stepping.status import Status

LARGE = 1e30  # gain that makes stiffness negligible beside mass in the iteration matrix
LARGEST = 2**20  # numbers that are written down, of all samples and steps
STATES_AT_ONCE = 2**16  # states whose outputs are evaluated together
FURTHEST = 2**21  # numbers of all samples and steps: in more of them samples that began side by side drift apart
STARTING_CORRECTIONS = 4  # one where stiffness does not change with the deformation


class ReducedTrail(State):
    """Room for states as they lie side by side, shape (n_t, 3, n_samples, n_eta)."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.whole = aligned((shape[0], 3, *shape[1:]))
        super().__init__(*np.moveaxis(self.whole, 1, 0), np.zeros((shape[0], 0)), np.zeros((shape[0], 0)))

    @property
    def motion(self) -> np.ndarray:
        return self.whole


class ReducedSystem(SecondOrderSystem):
    """A batch of samples of the reduced model, on one rank.

    They have parameter values (n_samples,) each, and start at positions (rad) with velocities (rad/s) of the rigid
    coordinates, each a number or of shape (n_theta,). Effects give the loads' amplitudes over time; motions are by the
    numbers of the prescribed coordinates. The last coordinates are given where joints are off and do not move, shape
    (n_given, n_samples).
    """

    steps_at_once, has_range = 2**31, True  # steps each by itself

    def __init__(
        self,
        terms: ReducedTerms,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[np.ndarray | float, np.ndarray | float],
        n_samples: int,
        motions: Mapping[int, Motion] = MappingProxyType({}),
        actions: ReducedActions | None = None,
        given: np.ndarray | None = None,
    ) -> None:
        tables, layout = terms.tables, terms.layout
        self.tables = tables
        self.comm, self.n_samples = alone(), n_samples
        self._initial = initial
        self._terms, self._effects, self._motions = terms, effects, motions
        self.values = values
        by_name = {effect.name: effect for effect in effects}
        self._load_effects = [by_name[name] for name in dict.fromkeys(tables.load_effects)]
        names = [effect.name for effect in self._load_effects]
        self._actions = actions or ReducedActions.none(len(layout.rigid))
        self.built_in = given if tables.n_given else None
        #: coordinates and velocities (n_samples, n_eta) that samples start from where they are known
        self.begun: tuple[np.ndarray, np.ndarray] | None = None
        self._prescribed = tables.prescribed(motions)
        self._is_rigid = np.arange(self.n_eta) < tables.n_coordinates
        self._lanes = ReducedLanes(terms, self._actions, names, values, self._prescribed, n_samples)
        self._equations, self._memory = self._lanes.equations, self._lanes.memory
        self._passed = Reference(self._equations), Reference(self._memory), Reference(Room.of(self._equations))
        self._clocks: dict[int, Reference] = {}  # by how many numbers are beside
        bounds = [(-np.inf, np.inf) if axis.periodic else (axis.lower, axis.upper) for axis in tables.samples]
        self._bounds = np.array(bounds, dtype=float)
        self._strengths = ReducedStrengths(self._load_effects, self._actions.actions, motions, tables.n_coordinates)
        self.controlled = given_to(self._actions.actions)
        self._led = []  # of these, the first of each force
        self._control = Control.of(None, [], np.zeros((0, n_samples)), self._actions, n_samples)
        self._found: tuple[np.ndarray, np.ndarray] | None = None
        self.n_events = self._memory.depths.shape[1]
        nothing = ReducedStrengths((), (), {}, tables.n_coordinates)
        self._functions = (self._strengths if self.n_events else nothing).functions

    def control(self, controls: Controls, origins: np.ndarray | None) -> None:
        """Let controllers act; `origins` are what counts as zero of each motion that they measure, a row for each part
        of their forces, where actions measure all of them, and None elsewhere."""
        self.beside, self.carries = controls, origins is not None
        self._led = [self.controlled[first] for first in controls.firsts]
        if self.carries:
            self._control = Control.of(controls, self.controlled, origins, self._actions, self.n_samples)
        self._no_amplitudes = self._lanes.packed_over(np.zeros((1, 1, len(self._actions.actions))))

    def put_forces(self, forces: Sequence[np.ndarray]) -> None:
        """Take what is given to each action; see `Controls`."""
        for column, given in zip(self.controlled, forces):
            self._equations.local.actions.parameters[column, :, : given.shape[1]] = given

    def measured(self, state: State) -> np.ndarray:
        """Return the motions that forces of controllers are of, or are led by, and their rates, a row for each part of
        what is given, (n_rows, n_samples, 2)."""
        kept, n_actions = self._memory.known.copy(), len(self._actions.actions)
        everyone, found = np.ones(self.n_samples, dtype=bool), np.empty((1, self.n_samples, 3, n_actions))
        trail = np.array([[state.q, state.v]])
        act_on(*self._passed, self._no_amplitudes, trail, self._lanes.sets(everyone), 0.0, np.bool_(False), found)
        self._memory.known[:] = kept  # with what laws that are limited keep for the next iterate
        return self._equations.local.actions.parameters[self.controlled, :, NOTED]

    def carried(self, time: float, state: State, given: np.ndarray) -> np.ndarray:
        """Return the forces that joints carry, (n, n_samples), where friction acts by those that are given."""
        moved, found = np.ones(self.n_samples, dtype=bool), given.copy()
        if self._found is not None:  # a sample that does not move keeps what it had
            moved = (self._found[0] != state.a).any(axis=1)
            found[:, ~moved] = self._found[1][:, ~moved]
        parameters = self._equations.local.actions.parameters
        before = parameters.copy()
        self.put_forces(list(given[..., None]))
        strengths = Reference(self._strengths.at(time))
        find_all_carried(*self._passed, strengths, _parts(state), self._lanes.sets(moved), found)
        parameters[:] = before
        self._found = state.a.copy(), found
        return found

    @property
    def n_eta(self) -> int:
        """Number of reduced coordinates."""
        return self.tables.n_coordinates + self.tables.n_modes

    @property
    def n_moving(self) -> int:
        """Number of these but for the given ones."""
        return self.n_eta - self.tables.n_given

    def undeformed(self, theta: np.ndarray) -> np.ndarray:
        """Return coordinates (n_samples, n_eta) without deformation but what is given, at theta, (n_samples, n_theta)
        or the same for all."""
        q = np.zeros((self.n_samples, self.n_eta))
        q[:, : self.tables.n_coordinates] = theta
        if self.built_in is not None:
            q[:, self.n_moving :] = self.built_in.T
        return q

    def start(self) -> State:
        """Return the start, undeformed or settled, with the accelerations that the equations of motion give."""
        r = self.tables.n_coordinates
        q = self.undeformed(self._initial[0])
        v = np.zeros_like(q)
        if self.begun is not None:
            q, v = (part.copy() for part in self.begun)
        elif self.settled is None:
            if self.built_in is not None:
                # what they add to the static answer to offsets: nothing at the nominal parameters in first order
                unloaded = State(q, *np.zeros((2, *q.shape)), np.zeros(0))
                for _ in range(STARTING_CORRECTIONS):
                    everyone = np.ones(self.n_samples, dtype=bool)
                    self.correct_at_rest(unloaded, np.zeros_like(q), everyone, 0.0, LARGE)
            v[:, :r] = self._initial[1]
        else:
            q[:] = self.settled.unknowns.T
        state = State(q, v, np.zeros_like(q), np.zeros(0))
        if self.beside is not None:
            self.beside.start(state)
        self._accelerate(state)
        for _ in range(MOST_STARTS if self.beside is not None else 0):
            if not self.beside.settle(state):
                break
            self._accelerate(state)
        return state if self.settled is None else self.settled.at_rest(state, len(self._motions))

    def _accelerate(self, state: State) -> None:
        """Give all samples the accelerations that the equations have at time 0, in place."""
        # they enter linearly: with stiffness negligible in the matrix, a correction solves M a = -r
        trial, everyone = replace(state.copy(), a=np.zeros_like(state.a)), np.ones(self.n_samples, dtype=bool)
        self.correct(0.0, trial, Scheme(0.0, 0.0, 0.0, 0.0, gain_v=0.0, gain_a=LARGE), everyone, fresh=True)
        state.a[:] = trial.a
        self._strengths.prescribe(0.0, state, everyone)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        self._strengths.prescribe(time, state, active)
        self._act(time, state, scheme.gain_v, active, fresh)
        return self._correct(*self._passed, self._strengths.at(time), state, scheme, active, fresh)

    def begin_iteration(self) -> None:
        """Forget at which rates laws were evaluated; see `AlphaStep`."""
        self._memory.known[:, ABOUT] = np.nan

    def limited(self) -> np.ndarray:
        """Return the samples of which a law was limited in the last correction."""
        return np.isinf(self._memory.known[:, ABOUT]).any(axis=1)

    def _correct(
        self, equations: Reference, memory: Reference, room: Reference, strengths: Strengths, state: State,
        scheme: Scheme, active: np.ndarray, fresh: bool,
    ) -> np.ndarray:  # fmt: skip
        """Do one Newton correction of some samples in place; return its size."""
        size, gains = self._lanes.zeros(), (scheme.gain_v, scheme.gain_a)
        lanes = self._lanes.sets(active)
        correct(equations, memory, room, strengths, _parts(state), gains, lanes, np.bool_(fresh), size)
        return self._lanes.unpacked(size).copy()

    @cached_property
    def _at_rest(self) -> tuple[Reference, Reference, Acting]:
        """The equations with all rigid coordinates prescribed, what they keep, and what acts in them."""
        equations = self._equations._replace(prescribed=self._prescribed | self._is_rigid)
        acting = Acting.empty(len(self._memory.samples), self.n_eta)
        return Reference(equations), Reference(self._memory._replace(acting=acting)), acting

    def correct_at_rest(
        self, state: State, force: np.ndarray, active: np.ndarray, share: float, longest: float
    ) -> np.ndarray:
        """Do one Newton correction of the flexible coordinates at rest, under a share of the loads and local effects at
        time zero, in place; return its size (n_samples,) before it was shortened to the `longest`, in units of the
        mechanism's size or of 1 rad. The force (n_samples, n_eta) is what else is in balance with the residual: ``r +
        force = 0``."""
        before, at_start = state.q.copy(), self._strengths.at(0.0)
        at_start.loads[:] *= share
        equations, memory, acting = self._at_rest
        acting.balance[:] = self._lanes.packed(force.T)
        if self._actions.actions:
            self._act(0.0, state, 0.0, active, True)
            acting.balance[:] += share * self._memory.acting.balance
            acting.tangent[:] = share * self._memory.acting.tangent
        scheme = Scheme(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        size = self._correct(equations, memory, self._passed[2], at_start, state, scheme, active, True)
        shortened = np.where(size > longest, longest / np.maximum(size, longest), 1.0)
        state.q[:] = np.where(shortened[:, None] < 1.0, before + shortened[:, None] * (state.q - before), state.q)
        return size

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the kinetic energy of the samples in a state, shape (n_samples,), J."""
        return reduced_energy(self._terms, self.values, q, v)[0]

    def strain_energy(self, q: np.ndarray) -> np.ndarray:
        """Return the strain energy of the samples at positions (n_samples, n_eta), shape (n_samples,), J."""
        return reduced_energy(self._terms, self.values, q, np.zeros_like(q))[1]

    def residual(self, time: float, state: State) -> np.ndarray:
        """Return the residual of the equations of motion, shape (n_samples, n_eta).

        In the rows of prescribed coordinates it is the force (N m) that drives them.
        """
        return self.residuals_over(np.array([time]), np.array([[state.q, state.v, state.a]]))[0]

    def residuals_over(self, times: np.ndarray, trail: np.ndarray) -> np.ndarray:
        """Return the residuals at times (n_t,) in states (n_t, 3, n_samples, n_eta), shape (n_t, n_samples, n_eta); see
        `residual`. Where samples are each at a time of its own, (n_t, n_samples), no controller acts."""
        given, n_own = self._strengths.over(times.ravel()), times.size // len(times)
        loads, amplitudes = (of.reshape(len(times), n_own, of.shape[1]) for of in (given.loads, given.actions))
        if times.ndim == 1:
            amplitudes = self._amplitudes(times)
        strengths, everyone = tuple(map(self._lanes.packed_over, (loads, amplitudes))), np.ones(self.n_samples, bool)
        found = np.empty((len(times), *trail.shape[2:]))
        evaluate_residuals(*self._passed, strengths, np.ascontiguousarray(trail), self._lanes.sets(everyone), found)
        return found

    def node_loads(self, times: np.ndarray, trail: np.ndarray) -> np.ndarray:
        """Return what local effects do to displacements and rotations of their nodes in body frames, in states (n_t, 2,
        n_samples, n_eta) at times of their own, (n_t, n_samples): shape (n_t, n_samples, n_nodes * n_dofs)."""
        d, n_blocks = self._actions.dimension, len(self._memory.samples)
        loads = aligned((len(times), n_blocks, self._actions.places.n_nodes, d * (d + 1) // 2, LANES))
        amplitudes = amplitudes_over(self._actions.actions, times.ravel()).reshape(*times.shape, -1)
        load_on(*self._passed, self._lanes.packed_over(amplitudes), trail, loads)
        by_samples = self._lanes.unpacked(np.swapaxes(loads, 0, 1))
        return np.moveaxis(by_samples.reshape(len(times), -1, self.n_samples), 1, 2)

    def depths(self, times: np.ndarray, states: State, samples: np.ndarray) -> np.ndarray:
        """Return how far each edge is crossed; see `SecondOrderSystem.depths`."""
        found = np.empty((times.size, self.n_events, self.n_samples))
        for k, time in enumerate(times):
            self._act(time, states.at(k), 0.0, samples, False)
            found[k] = self._memory.depths.T
        return found

    @property
    def instants_at_once(self) -> int:
        """See `SecondOrderSystem`: what is observed of reduced samples is cheap for many at once."""
        return max(1, STATES_AT_ONCE // self.n_samples)

    def energies_over(self, times: np.ndarray, states: State, values: Mapping[str, Any] | None = None) -> Energies:
        """Return energies and powers, from the same tables as the equations of motion; parameter values may be
        numbers."""
        trail = states.motion
        n = times.size * self.n_samples
        residual = self.residuals_over(times, trail) if self._motions else np.zeros_like(trail[:, 0])
        known = self._known(times, trail).reshape(n, 3, len(self._actions.actions))
        values = values or {name: np.tile(value, times.size) for name, value in self.values.items()}
        instants = np.repeat(times, self.n_samples)
        q, v, residual = (part.reshape(n, -1) for part in (trail[:, 0], trail[:, 1], residual))
        energies = Energies(*reduced_energy(self._terms, values, q, v))
        for action, power, stored in zip(self._actions.actions, known[:, POWER].T, known[:, STORED].T):
            energies.add_power(action.effect, power)
            energies.add_potential(action.effect, stored)
        loads = load_powers(self._terms, values, q, v) if self._load_effects else {}
        for effect in self._load_effects:
            energies.add_power(effect.name, effect.amplitude(instants) * loads[effect.name])
        if self._terms.damping is not None:
            power = damping_power(self._terms, values, q, v)
            energies.add_power(self._terms.damping.effect, power - 2.0 * self._terms.damping.mass * energies.kinetic)
        for k, motion in self._motions.items():
            energies.add_power(motion.name, residual[:, k] * v[:, k])
        return energies

    @property
    def load_weights(self) -> np.ndarray:
        """Weight of every load term, shape (n_samples, n_load_terms)."""
        return self._lanes.load_weights.T

    def load_amplitudes(self, times: np.ndarray) -> np.ndarray:
        """Return the amplitude of every load term at times (n_t,), without its weight, shape (n_t, n_load_terms)."""
        return self._strengths.over(times).loads[:, self._equations.weights.effects]

    def action_forces(self, times: np.ndarray, trail: np.ndarray) -> np.ndarray:
        """Return the force (N or N m) of every action at times (n_t,), in states of shape (n_t, 3, n_samples, n_eta).

        With the weight of every term of the actions' places, shape (n_t, n_samples, n_actions * n_terms).
        """
        if not self._actions.actions:
            return np.empty((times.size, self.n_samples, 0))
        forces = self._known(times, trail)[:, :, FORCE]
        weighted = forces[..., None] * self._lanes.place_weights.T[:, None]
        return weighted.reshape(*forces.shape[:2], forces.shape[2] * weighted.shape[3])

    def advance(self, stretch: Stretch) -> tuple[np.ndarray, np.ndarray]:
        """Take some samples through equal steps, each by itself, over edges of laws too; see `SecondOrderSystem`."""
        moment, scheme = stretch.moment, stretch.scheme
        self._lanes.regroup(moment.state.q, stretch.samples)
        progress = Progress(
            self._lanes.zeros(np.int64),
            self._lanes.zeros(np.int64),
            np.zeros(1, dtype=np.int64),
            np.ascontiguousarray(stretch.beyond.T),
            stretch.shown,
            stretch.trail.whole,
            self.precise,
        )
        beside = moment.state.beside if self.carries else np.empty((self.n_samples, 0))
        state = (*_parts(moment.state), moment.auxiliary, moment.before, moment.contraction[:, None], beside)
        control, strengths = self._control, self._strengths.over(stretch.ends)
        if beside.shape[1] not in self._clocks:
            self._clocks[beside.shape[1]] = Reference(Clocks.of(self.n_eta, beside.shape[1], strengths, self.n_events))
        if self.carries:
            control = control.over_steps(self.beside, stretch.ends, stretch.trail.forces)
        advance(
            *self._passed, self._clocks[beside.shape[1]], strengths, self._functions,
            (scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma), (stretch.first, stretch.ends, stretch.step),
            state, self._bounds, self._lanes.sets(stretch.samples), progress, Reference(control),
        )  # fmt: skip
        if self.carries:
            self.beside.take(moment.state)
            self.beside.put_nothing()
        stretch.beyond[:] = progress.beyond.T
        stretch.counted[0] += progress.n_corrections.sum()
        return self._lanes.unpacked(progress.outcome), self._lanes.unpacked(progress.n_steps)

    def trail(self, state: State, n: int) -> ReducedTrail:
        return ReducedTrail((n, *state.q.shape))

    def steps_between_looks(self, every: int | None) -> int:
        """Return how many steps make one of PETSc's TS where it does not look; see `SecondOrderSystem`.

        Few samples go further at once; of many, what is written down is to stay in the cache.
        """
        largest = FURTHEST if every is None else min(LARGEST * every, FURTHEST)
        return max(1, largest // (3 * self.n_samples * self.n_eta))

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        for now, before in zip(_parts(state), _parts(previous)):
            now[samples] = before[samples]

    def restore_all(self, trail: State, states: State, samples: np.ndarray) -> None:
        """Put samples in all instants of a trail to what they are in other states."""
        for now, before in zip(_parts(trail), _parts(states)):
            now[:, samples] = before[:, samples]

    def outside(self, state: State) -> np.ndarray:
        """Return the samples whose rigid coordinates left the sampled range."""
        return ~self.tables.samples.contains(state.q[:, : self.tables.n_coordinates])

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why samples fail; see `SecondOrderSystem.reasons`.

        The model itself has broken down where the energy of its terms of first and second order in the deformation is
        no longer positive: where the inertia about the rigid motion, or with terms of second order the stiffness, is
        not positive definite.
        """
        finite = np.isfinite(state.q).all(axis=1) & np.isfinite(state.v).all(axis=1) & np.isfinite(state.a).all(axis=1)
        reasons = np.where(finite, Status.NOT_CONVERGED, Status.NOT_FINITE)
        stiffness, inertia = self.stiffness_and_inertia(time, state)
        r, n = self.tables.n_coordinates, self.n_moving
        for sample in np.flatnonzero(finite & samples):
            blocks = inertia[sample, :n, :n], stiffness[sample, r:n, r:n]
            lowest = [np.linalg.eigvalsh(matrix)[0] for matrix in blocks]
            if not min(lowest) > 0.0:
                reasons[sample] = Status.BROKE_DOWN
        return reasons[samples]

    def stiffness_and_inertia(self, time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return the residual's derivatives with positions and with accelerations, each (n_samples, n_eta, n_eta)."""
        self._act(time, state, 0.0, np.ones(self.n_samples, dtype=bool), True)
        found = []
        for gain_a in (0.0, 1.0):
            fill_matrices(*self._passed, self._strengths.at(time), _parts(state), gain_a)
            found.append(self._lanes.matrices())
        return found[0], found[1] - found[0]

    def _act(self, time: float, state: State, gain_v: float, active: np.ndarray, with_tangent: bool) -> None:
        """Evaluate the actions on the active samples, and what is known of them beside their forces."""
        if self._actions.actions:
            self._known(np.array([time]), np.array([[state.q, state.v]]), active, gain_v, with_tangent)

    def _known(
        self, times: np.ndarray, trail: np.ndarray, active: np.ndarray | None = None, gain_v: float = 0.0,
        with_tangent: bool = False,
    ) -> np.ndarray:  # fmt: skip
        """Evaluate the actions on active samples, or on all, at times (n_t,); return what is known of them, (n_t,
        n_samples, 3, n_actions), as of `act`."""
        lanes = self._lanes.sets(np.ones(self.n_samples, dtype=bool) if active is None else active)
        found = np.zeros((times.size, self.n_samples, 3, len(self._actions.actions)))
        if found.size:
            amplitudes = self._lanes.packed_over(self._amplitudes(times))
            act_on(*self._passed, amplitudes, np.ascontiguousarray(trail), lanes, gain_v, np.bool_(with_tangent), found)
        return found

    def _amplitudes(self, times: np.ndarray) -> np.ndarray:
        """Return the amplitudes of the actions at times (n_t,), forces of controllers with them, (n_t, 1 or n_samples,
        n_actions)."""
        found = amplitudes_over(self._actions.actions, times)[:, None]
        if self.beside is not None and not self.beside.iterates:
            found = np.repeat(found, self.n_samples, axis=1)
            found[:, :, self._led] += self.beside.forces(times)
        return found


def _parts(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, velocities and accelerations."""
    return state.q, state.v, state.a
