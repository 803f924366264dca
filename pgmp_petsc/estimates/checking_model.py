"""The model in which reduced runs are checked: all unknowns that are left once continuum bodies are condensed.

Bodies of beams are on their meshes. Condensed bodies are in floating frames (`bodies.floating`): exact in the rotation
and in all that is quadratic in velocities, with every amplitude that they are condensed to. Equations, local effects
and drives are those of full-order and component runs, and so are the unknowns.

A reduced state gives these unknowns by (4) of Naets et al. 2015. Of a condensed body with unknowns y in the frame of
its rigid pose, the small motion that is a rigid one moves the floating frame, and the rest are its amplitudes,

    y = [rigid motions, modes] (s, xi).

Where these are not quite the place and the amplitudes that belong to the body's frames, by terms of second order in the
deformation, ties hold between both, and the error that is solved for has the difference.

**The error from the residual** (`ErrorSystem`).

With a motion ``q_r(t)`` of the unknowns, its velocities and its accelerations, ``q = q_r + e`` solves the full-order
equations (docs/method.md, error indicator). From static equilibrium, or with the stress that joints that are off build
in, each model starts in its own state, and e and e' are the differences; else they are 0. The residual at e = 0 varies
slowly, and what it sets off follows from a time integration with the run's own steps, or longer ones
(generalised-alpha, `reference_motion`), whose unknown is e.

**Loads as a run sees them**: at its time steps only. Between two steps a load may bend or jump. Whatever the integrator
makes of it, over a stretch of time the run feels another impulse than the load has: the difference between the exact
integral of the amplitude and the integral of what is known at the steps, by the trapezoidal rule, which is what the
scheme makes of it but for its first steps. Spread over the stretch, it is added to the amplitude at the instants at
which the error of the run is evaluated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.bodies.shape import in_floating_frame
from pgmp_petsc.controllers.running import Controls
from pgmp_petsc.effects import Action, Effect, Motion, effects_of, motions_of
from pgmp_petsc.effects.effect import Load
from pgmp_petsc.effects.time_function import Instant
from pgmp_petsc.estimates.reference_motion import ReferenceMotion, Schedule
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ComponentModel, ReducedModel
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.stepping.second_order_system import Scheme, SecondOrderSystem, State, StepsAsked, StepsTaken

N_PARTS = 16  # of a step, between which an amplitude is taken for linear
Amplitude = Callable[[float | np.ndarray], float | np.ndarray]


class SampledAmplitude:
    """An amplitude over time (s) at the instants of evaluation, with the impulse that the run missed.

    The error is evaluated at steps of increasing numbers, the first 0; evaluation number k has the time ``k interval``.
    """

    def __init__(self, amplitude: Amplitude, steps: np.ndarray, step: float, interval: float) -> None:
        self._interval = interval
        times = step * np.arange(steps[-1] + 1)
        amplitudes = amplitude(times)
        # the integral of the amplitude over every step
        impulses, lengths, parts = np.zeros_like(times), np.diff(times), np.arange(N_PARTS + 1) / N_PARTS
        fine = amplitude((times[:-1] + parts[:, None] * lengths).ravel()).reshape(parts.size, lengths.size)
        for part, of_part in zip(parts, fine):
            impulses[1:] += (1.0 / N_PARTS if 0.0 < part < 1.0 else 0.5 / N_PARTS) * lengths * of_part
        seen = np.concatenate([[0.0], 0.5 * step * np.cumsum(amplitudes[1:] + amplitudes[:-1])])
        missed = np.cumsum(impulses) - seen
        middles = (steps[1:-1] + steps[2:]) / 2.0
        # nothing is evaluated before the first interval ends: it represents the time from the start
        ends = np.interp(np.concatenate([[0.0], middles, [steps[-1]]]), np.arange(times.size), missed)
        self._amplitudes = amplitudes[steps]
        self._amplitudes[1:] += np.diff(ends) / interval

    def __call__(self, time: float | np.ndarray) -> float | np.ndarray:
        """Return the amplitude at the nearest evaluation."""
        return self._amplitudes[np.rint(np.divide(time, self._interval)).astype(int)]


class SampledLoad(Effect):
    """An effect whose strength changes with time, at the instants of evaluation; see `SampledAmplitude`."""

    def __init__(self, effect: Effect, steps: np.ndarray, step: float, interval: float) -> None:
        super().__init__(effect.name)
        self._effect, self._instants = effect, (steps, step, interval)

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        return self._effect.loads(matrices)

    def actions(self) -> list[Action]:
        """Return the actions of the effect with their strength at the instants of evaluation."""
        return self._sampled(self._effect.actions())

    def natural_actions(self) -> list[Action]:
        return self._sampled(self._effect.natural_actions())

    @cached_property
    def amplitude(self) -> SampledAmplitude:
        """The amplitude; effects that are actions alone are not asked for one."""
        return SampledAmplitude(self._effect.amplitude, *self._instants)

    def _sampled(self, actions: Sequence[Action]) -> list[Action]:
        sampled = (
            None if one.amplitude is None else SampledAmplitude(one.amplitude, *self._instants) for one in actions
        )
        return [replace(action, amplitude=amplitude) for action, amplitude in zip(actions, sampled)]


class SampledMotion:
    """A prescribed motion at the instants of evaluation, as `Motion`; parameters as of `SampledAmplitude`."""

    def __init__(self, motion: Motion, steps: np.ndarray, step: float, interval: float) -> None:
        self.name, self.coordinate = motion.name, motion.coordinate
        self._motion, self._times, self._interval = motion, step * steps, interval

    def at(self, time: float | np.ndarray) -> Instant:
        return self._motion.at(self._times[np.rint(np.divide(time, self._interval)).astype(int)])


def sampled_effects(effects: Sequence[Effect], steps: np.ndarray, step: float, interval: float) -> tuple[Effect, ...]:
    """Return effects at the instants of evaluation: those that do not change with time as they are."""
    return tuple(
        SampledLoad(effect, steps, step, interval) if _changes(effect, step * np.arange(steps[-1] + 1)) else effect
        for effect in effects
    )


def _changes(effect: Effect, times: np.ndarray) -> bool:
    sources = [action.amplitude for action in (*effect.actions(), *effect.natural_actions())]
    if any(source is not None for source in sources):
        return True
    # others have the constant one of all effects
    return effect.strength is not Effect.strength and bool(np.ptp(effect.amplitude(times)))


#: Unknowns and velocities that samples begin with, each (n_dofs, n_samples), NaN for those that are never advanced.
Begin = tuple[np.ndarray, np.ndarray]


class CheckingModel:
    """The model that a reduced model is checked against, with its full-order equations.

    `rotations` are the largest of a frame in its body per unit of each flexible coordinate, shape (n_delta,), rad.
    """

    def __init__(self, model: ReducedModel) -> None:
        scene, shapes = model.scene, {name: in_floating_frame(shape) for name, shape in model.meshes.items()}
        self.full = ComponentModel(scene, shapes, model.kinematics)
        mechanism = self.full.kinematics.mechanism
        self._effects, self._motions = effects_of(scene, mechanism), motions_of(scene, mechanism)
        rom = model.rom
        if any(body.n_amplitudes for body in mechanism.bodies):
            rom = _in_floating_frames(rom, model.kinematics.mechanism, mechanism)
        space, nodes = mechanism.space, range(mechanism.n_nodes)
        shape = len(rom.projection), len(nodes), space.n_dofs, -1
        nodal = rom.projection[:, : space.n_dofs * len(nodes)].reshape(shape)
        self.rotations = np.abs(nodal[:, :, space.dimension :]).max(axis=(0, 1, 2))
        #: gives the unknowns, (n_dofs, n_points, n), on paths of reduced states
        self.unknowns_of = Reconstruction(self.full.kinematics, rom, scene.interpolation, nodes, internal=True).unknowns

    def batch(self, values: Arrays, n: int) -> FullBatch:
        start = self.full.start_of_samples(values, n)
        return FullBatch(self.full.kinematics, self._effects, values, start, n, self._motions)

    def scheduled(self, batch: FullBatch, schedule: Schedule, step: float) -> FullBatch:
        """Return a batch under the loads at the instants of a schedule of a run with a step (s)."""
        instants = schedule.steps, step, schedule.interval
        effects = sampled_effects(self._effects, *instants)
        motions = {number: SampledMotion(motion, *instants) for number, motion in self._motions.items()}
        return batch.under(effects, motions)

    def control(self, system: ErrorSystem, schedule: Schedule, step: float) -> None:
        """Let controllers, and what joints carry, act on a system of one sample over a schedule, as of `scheduled`."""
        self.full.controlled(system.full, system.full.values, system.whole)
        if system.beside is not None:
            times = step * schedule.steps
            system.beside.clock = lambda time: float(times[round(time / schedule.interval)])

    def starts(self, values: Arrays, samples: np.ndarray) -> Begin | None:
        """Return what samples of a mask, shape (n,), start with: static equilibria, or what joints that are off build
        in.

        Parameter values have shape (n,) each. NaN where there is no such start; None where runs start undeformed.
        """
        from_rest, full = self.full.scene.initial.equilibrium, self.full
        if not from_rest and not full.is_off:
            return None
        chosen, n = {name: value[samples] for name, value in values.items()}, int(samples.sum())
        nowhere = np.full((1, samples.size), np.nan)
        if not n:
            return nowhere, nowhere
        if from_rest:
            settled = full.settled(chosen, n)
            q = np.where(settled.lost, np.nan, settled.unknowns)
            parts = q, np.zeros_like(q)
        else:
            try:
                parts = full.built_in(chosen, full.start_of_samples(chosen, n), n)
            except InputError:  # the bodies do not give way so far
                return nowhere, nowhere
        found = np.full((2, len(parts[0]), samples.size), np.nan)
        found[:, :, samples] = parts
        return found[0], found[1]


class ErrorSystem(SecondOrderSystem):
    """Full-order equations about a reference motion; see `SecondOrderSystem`.

    The full-order model is of the same samples, with its loads at the instants of the motion, of which number k is that
    of the time ``k interval``, s, the step of the integration. From the rigid coordinates at the start, shape (n_theta,
    n_samples), rad, turns are counted. `begin` is None where runs start undeformed.
    """

    about_motion = True

    def __init__(
        self, full: FullBatch, motion: ReferenceMotion, interval: float, theta: np.ndarray, begin: Begin | None
    ) -> None:
        self.comm, self.n_samples, self.steps_at_once = full.comm, full.n_samples, full.edgeless_at_once
        self.full, self._motion, self._interval, self._begin = full, motion, interval, begin
        self._turns, self._number = full.pack(full.turns(theta)), -1

    def start(self) -> State:
        """Return the error of the start, or none.

        The motion starts as the full-order model does, so there is no acceleration to speak of.
        """
        first = self._motion.over(0, 1)[:2, 0]
        rest = np.zeros_like(self.full.pack(first[0]))
        error = rest.copy(), rest.copy()
        if self._begin is not None:
            error = tuple(self.full.pack(np.nan_to_num(own - other)) for own, other in zip(self._begin, first))
        multipliers = self.full.pack(np.zeros((self.full.n_constraints, self.n_samples)))
        found = State(*error, rest, multipliers, self._turns.copy())
        if self.beside is not None:
            self.beside.start(found)
        return found

    @property
    def beside(self) -> Controls | None:
        return self.full.beside

    @property
    def held(self) -> bool:
        return self.full.held

    @property
    def carries(self) -> bool:
        return self.full.carries

    def whole(self, time: float, state: State) -> State:
        """Return the state of the full-order equations at a time, s, from that of the error."""
        number = round(time / self._interval)
        if number != self._number:
            self._number, self._parts = number, tuple(map(self.full.pack, self._motion.over(number, 1)[:, 0]))
        q, v, a = self._parts
        return replace(state, q=q + state.q, v=v + state.v, a=a + state.a)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction of the error; see `SecondOrderSystem.correct`."""
        moved = self.whole(time, state)
        before = moved.q.copy(), moved.v.copy(), moved.a.copy()
        size = self.full.correct(time, moved, scheme, active, fresh)
        # by its change, so that a sample which is not active stays what it is to the last digit
        state.q += moved.q - before[0]
        state.v += moved.v - before[1]
        state.a += moved.a - before[2]
        return size

    def begin_iteration(self) -> None:
        self.full.begin_iteration()

    def limited(self) -> np.ndarray:
        return self.full.limited()

    def steps_between_looks(self, every: int | None) -> int:
        return self.full.steps_between_looks(every)

    def take_steps(self, asked: StepsAsked) -> StepsTaken:
        return self.full.take_steps(asked, self._motion.over(round(asked.ends[0] / self._interval), asked.ends.size))

    def count_turns(self, state: State) -> None:
        """Take note of the angles at the instant that was corrected last; see `FullBatch.count_turns`."""
        self.full.count_turns(State(self._parts[0] + state.q, state.v, state.a, state.multipliers, state.turns))

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        self.full.restore(state, previous, samples)

    restore_all = restore

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        return self.full.reasons(time, state, samples)


def _in_floating_frames(rom: ReducedOrderModel, reduced: Mechanism, full: Mechanism) -> ReducedOrderModel:
    """Return a reduced model with its flexible vectors in the unknowns of a mechanism whose condensed bodies have
    floating frames."""

    def moved(vectors: np.ndarray) -> np.ndarray:
        found = np.zeros((len(vectors), full.n_dofs, vectors.shape[2]))
        for body, other in zip(reduced.bodies, full.bodies):
            found[:, other.dofs] = other.in_frame(vectors[:, body.dofs], body.node_dofs * body.n_nodes)
        return found

    curvature = None if rom.curvature is None else moved(rom.curvature)
    return replace(rom, projection=moved(rom.projection), curvature=curvature)
