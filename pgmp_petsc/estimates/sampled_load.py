"""Loads as a run sees them: at its time steps only.

Between two steps a load may bend or jump. Whatever the integrator makes of it, over a stretch of time the run feels
another impulse than the load has: the difference between the exact integral of the amplitude and the integral of what
is known at the steps, by the trapezoidal rule, which is what the scheme makes of it but for its first steps. Spread
over the stretch, it is added to the amplitude at the instants at which the error of the run is evaluated.

Vibrations that the start of a reduced run sets off, where loads at time zero meet undeformed bodies.

The equations of motion at the start, ``M a = F`` with ``delta = 0``, give accelerations of the flexible coordinates.
Had the bodies been given time, they would have the quasi-static deformation delta_0 under the same loads and the
inertia forces of the rigid motion that these make. With the rigid accelerations eliminated,

    K delta_0 = (M_dd - M_dr M_rr^-1 M_rd) a_d,

d the flexible and r the rigid coordinates that are not prescribed. Without damping the bodies swing about delta_0 from
nothing to twice of it: a mass on a spring to which a weight is added. By strain energy the swing is the share

    2 sqrt(U(delta_0) / largest U of the run)

of the largest deformation; above 1 where modes do not reach their crests together. A start from static deformation
with coordinates held, delta_h, leaves a swing by ``delta_0 - delta_h``: none where motions are prescribed, more than
before where the mechanism is let go and what held it was a large torque.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, note, warning
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects import AT_REST, Action, Effect, Motion
from pgmp_petsc.effects.effect import Load
from pgmp_petsc.effects.motion import Instant
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.models.model import search_of
from pgmp_petsc.models.reduced_statics import ReducedStatics
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.scene.references import parts_of
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.static_equilibrium import settle

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
        missed = np.cumsum(_impulses(amplitude, times)) - np.concatenate(
            [[0.0], 0.5 * step * np.cumsum(amplitudes[1:] + amplitudes[:-1])]
        )
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

    def amplitude(self, time: float | np.ndarray) -> float | np.ndarray:
        return self._of_loads(time)

    @cached_property
    def _of_loads(self) -> SampledAmplitude:
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
        """Return the motion at the nearest evaluation."""
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


def _impulses(amplitude: Amplitude, times: np.ndarray) -> np.ndarray:
    """Return the integral of the amplitude over every step, 0 first, shape (n_t,)."""
    result = np.zeros_like(times)
    steps = np.diff(times)
    parts = np.arange(N_PARTS + 1) / N_PARTS
    amplitudes = amplitude((times[:-1] + parts[:, None] * steps).ravel()).reshape(parts.size, steps.size)
    for part, of_part in zip(parts, amplitudes):
        result[1:] += (1.0 / N_PARTS if 0.0 < part < 1.0 else 0.5 / N_PARTS) * steps * of_part
    return result


LARGE = 0.5  # share of the largest deformation from which on a run is about its start
CURED = 0.25  # share of the swing that a start from static deformation may leave


def jump_remarks(model: ReducedModel, system: ReducedSystem, start: State, strain: np.ndarray) -> tuple[Remark, ...]:
    """Return that most of the deformation of a run is the swing that its start sets off, and the cure.

    A warning where a start from static deformation cures it: then the mechanism is held or driven from the start, and
    would not have been undeformed. Otherwise a note: it may be let go, or loads may set in, as the scene says. The
    strain energy is that over the run, shape (n_t,), J.
    """
    largest = float(np.max(strain, initial=0.0))
    if model.scene.initial.equilibrium or not largest > 0.0:
        return ()
    swing = _quasi_static(model, system, start)
    energy = _strain_energy(system, start, swing)
    share = 2.0 * np.sqrt(max(energy, 0.0) / largest)
    if not share >= LARGE:
        return ()
    at_once = ", ".join(_acting(model, system, start)) or "inertia forces of its speed"
    what = (
        f"the run starts undeformed, with {at_once} at once: the vibration that this sets off makes "
        f"{min(100.0 * share, 100.0):.0f} % of its largest deformation"
    )
    damped = any(effect.on_vibrations for effect in model.scene.effects.values())
    lasts = "" if damped else "; nothing in the bodies damps it: it falls out of step with that of a better model"
    if _is_cured(model, system, start, swing, energy):
        return (warning(f"{what}; initial.equilibrium = true starts with the static one{lasts}"),)
    cure = "let loads grow from zero, or add structural_damping"
    return (note(f"{what}; where that is not meant, {cure} (initial.equilibrium = true does not help here){lasts}"),)


def _quasi_static(model: ReducedModel, system: ReducedSystem, state: State) -> np.ndarray:
    """Return the quasi-static deformation at the start of one sample, without given coordinates, shape (n,)."""
    r, n = system.tables.n_coordinates, system.n_moving
    stiffness, inertia = (matrix[0, :n, :n] for matrix in system.stiffness_and_inertia(0.0, state))
    free = [k for k in range(r) if k not in model.motions]
    moved = np.linalg.solve(inertia[np.ix_(free, free)], inertia[free, r:])
    # springs may be zero, of what elastic joints release
    return np.linalg.lstsq(
        stiffness[r:, r:], (inertia[r:, r:] - inertia[r:, free] @ moved) @ state.a[0, r:n], rcond=None
    )[0]


def _strain_energy(system: ReducedSystem, state: State, deformation: np.ndarray) -> float:
    """Return the strain energy of one sample at the start with another deformation, J."""
    bent = np.zeros_like(state.q)
    bent[0, : system.tables.n_coordinates] = state.q[0, : system.tables.n_coordinates]
    bent[0, system.tables.n_coordinates : system.n_moving] = deformation
    return float(system.strain_energy(bent)[0])


def _acting(model: ReducedModel, system: ReducedSystem, state: State) -> list[str]:
    """Return the effects whose forces are not zero at the start of one sample, by their entries."""
    at = np.zeros(1)
    names = set(model.terms.tables.load_effects)
    found = {effect.name for effect in model.effects if effect.name in names and np.any(effect.amplitude(at))}
    if actions := model.actions.actions:
        forces = system.action_forces(at, np.array([[state.q, state.v, state.a]])).reshape(len(actions), -1)
        found |= {action.effect for action, own in zip(actions, forces) if np.any(own)}
    named = model.scene.effects.items()
    return [f"effects.{name}" for name, effect in named if not found.isdisjoint(parts_of(name, effect))]


def _is_cured(model: ReducedModel, system: ReducedSystem, state: State, swing: np.ndarray, energy: float) -> bool:
    """Return whether a start from static deformation, with coordinates held, leaves little of the swing."""
    if np.max(np.abs(model.start[1])) * model.scene.simulation.duration > AT_REST:
        return False  # it starts at rest alone
    statics, search = ReducedStatics(system, model.joint_angles), search_of(model.scene, model.kinematics.mechanism)
    try:
        held = settle(statics, model.start[0][None], search)
    except InputError:  # under large loads the search may end where the mechanism cannot close
        return False
    if held.reasons:
        return False
    left = swing - held.unknowns[system.tables.n_coordinates : system.n_moving, 0]
    return _strain_energy(system, state, left) <= CURED**2 * energy
