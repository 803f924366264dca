"""Runs of the reduced model with the derivatives of their outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import Run, integrate
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.dynamics.smaller_steps import Attempt, integrate_with_smaller_steps
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.gradients.contacts import Contact, Contacts
from pgmp_petsc.gradients.linearisation import Linearisation
from pgmp_petsc.gradients.observed import ObservedChanges
from pgmp_petsc.gradients.propagation import propagate
from pgmp_petsc.gradients.start import start_of_sensitivities
from pgmp_petsc.models import LengthLanes, ReducedModel
from pgmp_petsc.runtime.errors import InputError, RunError

MOST_NUMBERS = 4_000_000  # of matrices along a run that are kept at once, 32 MB


@dataclass(frozen=True, eq=False)
class DifferentiatedRun:
    """A run and its derivatives.

    Attributes
    ----------
    time
        Shape (n_t,), s.
    outputs
        Each of shape (n_t,).
    derivatives
        Of every output with every parameter, by the names of both: ``derivatives[output][parameter]``, (n_t,).
    eta, changes
        Reduced coordinates (n_t, n_eta), and their derivatives (n_t, n_parameters, n_eta).
    steps_divided
        By what the scene's step was divided.
    contacts
        Instants at which end stops are met and left, with their own derivatives.
    """

    time: np.ndarray
    outputs: dict[str, np.ndarray]
    derivatives: dict[str, dict[str, np.ndarray]]
    eta: np.ndarray
    changes: np.ndarray
    steps_divided: int = 1
    contacts: tuple[Contact, ...] = ()

    def at_steps_of_scene(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the instants after the scene's own steps and the outputs there, as many whatever the run's steps."""
        every = slice(None, None, self.steps_divided)
        return self.time[every], {name: values[every] for name, values in self.outputs.items()}


class _Trail:
    """Keeps all states of a run; see `TrailObserver`."""

    every = 1

    def __init__(self, pulse: Callable[[int], object]) -> None:
        self._times: list[np.ndarray] = []
        self._states: list[np.ndarray] = []
        self._pulse = pulse

    def __call__(self, number: int, time: float, state: State) -> None:
        """Keep the state after a step."""
        self._keep(np.array([time]), np.array([[state.q, state.v, state.a]]), int(number > 0))

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Keep the states after many steps."""
        self._keep(times, trail, times.size)

    def _keep(self, times: np.ndarray, trail: np.ndarray, n_steps: int) -> None:
        self._times.append(times.copy())
        self._states.append(trail.copy())
        self._pulse(n_steps)

    def of_sample(self, sample: int) -> tuple[np.ndarray, State]:
        """Return the instants (n_t,) and the states of one sample, arrays of shape (n_t, n_eta)."""
        states = np.concatenate([trail[:, :, sample] for trail in self._states])
        return np.concatenate(self._times), State(*(states[:, part].copy() for part in range(3)), np.zeros(0))


def differentiate(
    model: ReducedModel | LengthLanes,
    values: Mapping[str, float],
    names: Sequence[str],
    pulse: Callable[[int], object] = lambda n_steps: None,
) -> DifferentiatedRun:
    """Run one sample, and differentiate its outputs with some parameters.

    Parameters
    ----------
    model
        The model of samples in which these parameters vary (`models.of_samples`).
    values
        Value of every parameter of the scene.
    names
        Parameters to differentiate with.
    pulse
        Called with the number of steps that have been taken since the last call.

    Raises
    ------
    InputError
        If the scene has no outputs, there is no static equilibrium to start from, or an end stop is grazed.
    RunError
        If the run stops before its end, with smaller steps too.
    """
    if not model.outputs.functions:
        raise InputError("outputs: none is given, so there is nothing to differentiate; add a table [outputs.NAME]")
    of_sample = {name: np.array([value]) for name, value in values.items()}
    kept: list[tuple[Attempt, Run, _Trail]] = []

    def once(attempt: Attempt) -> Run:
        system = model.batch(of_sample, 1)
        if system.settled is not None:
            system.settled.require()
        trail = _Trail(pulse)
        done = integrate(system, attempt.simulation, observer=trail)
        kept[:] = [(attempt, done, trail)]
        return done

    integrate_with_smaller_steps(once, model.scene.simulation, np.ones(1, dtype=bool))
    attempt, done, trail = kept[0]
    status = Status(done.status[0])
    if status != Status.FINE:
        raise RunError(f"the run stopped at {done.failure_time[0]:.6g} s: {status.meaning}; {status.cure}")
    times, states = trail.of_sample(0)
    linearisation = Linearisation(model, values, names)
    contacts = Contacts(model, values, linearisation, times, states)
    changes = _propagated(model, linearisation, contacts, times, states)
    with np.errstate(all="ignore"):
        observed = ObservedChanges(model, values, states.q)
        outputs = observed.outputs
        by_name = {name: observed.of(name, changes[:, number]) for number, name in enumerate(names)}
    derivatives = {output: {name: by_name[name][output] for name in names} for output in outputs}
    _require_finite(outputs, derivatives, times)
    return DifferentiatedRun(times, outputs, derivatives, states.q, changes, attempt.divisor, tuple(contacts.found))


def _propagated(
    model: ReducedModel | LengthLanes,
    linearisation: Linearisation,
    contacts: Contacts,
    times: np.ndarray,
    states: State,
) -> np.ndarray:
    """Return the derivatives of the reduced coordinates over the run, shape (n_t, n_parameters, n_eta)."""
    n_t, n = states.q.shape
    step = times[-1] / (n_t - 1)
    scheme = Scheme.of(model.scene.simulation.spectral_radius, step)
    prescribed = np.array([k in model.motions for k in range(model.kinematics.n_coordinates)])
    moment = start_of_sensitivities(model, linearisation, _part(states, slice(0, 1)))
    result = np.empty((n_t, len(linearisation.names), n))
    result[0] = moment[0]
    at_once, first = max(16, MOST_NUMBERS // (3 * n * n)), 1
    while first < n_t:
        crossing = contacts.following(first)
        for begin in range(first, crossing, at_once):
            part = slice(begin, min(begin + at_once, crossing))
            here = linearisation.at(times[part], _part(states, part), scheme)
            propagate(
                here.by_q, here.by_v, here.by_a, here.by_parameters, astuple(scheme), step, prescribed, moment,
                result[part],
            )  # fmt: skip
        if crossing < n_t:
            moment = contacts.through(crossing, moment)
            result[crossing] = moment[0]
        first = crossing + 1
    return result


def _part(states: State, part: slice) -> State:
    return State(states.q[part], states.v[part], states.a[part], states.multipliers)


def _require_finite(
    outputs: Mapping[str, np.ndarray], derivatives: Mapping[str, Mapping[str, np.ndarray]], times: np.ndarray
) -> None:
    """Refuse outputs that are no finite numbers, or have no derivatives.

    Raises
    ------
    RunError
        Naming the output, the parameter and the instant.
    """
    for output, values in outputs.items():
        for name, found in {"": values, **derivatives[output]}.items():
            if not np.isfinite(found).all():
                at = times[int(np.argmin(np.isfinite(found)))]
                what = f"its derivative with {name} " if name else ""
                raise RunError(f"outputs.{output}: {what}is no finite number from {at:.6g} s on")
