"""Runs of the reduced model with the derivatives of their outputs.

Forward sensitivities through the steps of the generalised-alpha scheme (`stepping.generalised_alpha`); compiled.

The scheme is differentiated as it stands. With S_q, S_v, S_a, S_A the derivatives of coordinates, velocities,
accelerations and auxiliary accelerations with a parameter, hats for their prediction with ``S_a_hat = S_a`` of the
step's beginning, and the step's own matrix,

    (by_q + gain_v by_v + gain_a by_a) x = - (by_p + by_q S_q_hat + by_v S_v_hat + by_a S_a_hat),
    S_q = S_q_hat + x,     S_v = S_v_hat + gain_v x,     S_a = S_a_hat + gain_a x.

One factorisation serves all parameters. Prescribed coordinates do not depend on any; those that say how far joints are
off are parameters themselves, ``S_q = 1`` from the start on.

Sensitivities at the start of a run.

An undeformed start depends on no parameter, velocities on those that are some of them; first accelerations follow from
the equations of motion, ``by_a S_a = - (by_p + by_q S_q + by_v S_v)``, and those that steps begin with from the steps
that they are taken of (`alpha_step.first_accelerations`). Where joints are off it is the static answer to that, ``by_q
S_q = - by_p`` of flexible coordinates without loads. In static equilibrium with free coordinates the residual at rest
vanishes, ``by_q S_q = - by_p``. With held ones the angles s of their joints are given and torques mu hold them,

    R(eta, p) + G^T mu = 0,     s(eta) = s_0,     G = ds/d eta,
    [by_q + sum_k mu_k d2 s_k/d eta2   G^T] [S_q ]     [by_p + (d G/dp)^T mu]
    [G                                 0  ] [S_mu] = - [d s/dp              ],

where s depends on parameters that are lengths alone.

Outputs of a run, and their derivatives along sensitivities of the reduced coordinates.

All outputs but stresses are smooth functions of poses and of displacements in body frames. Displacements
``u = Psi(theta) delta + 1/2 chi(theta) delta delta`` are interpolated, and their derivative is exact,

    du/dp = (Psi + chi delta) S_delta + sum_k (d_k Psi delta + 1/2 d_k chi delta delta) S_theta_k;

what outputs make of them and of the rigid kinematics is differentiated along the line (theta + h S_theta, u + h du/dp)
by central differences, which cross no cells of the tables and close no loops but those that the outputs themselves ask
for (`RigidKinematics.near`). Stresses have central differences along the whole line, and so has what reads rates,
accelerations or parameters, in the cells that the run is in; formulas of outputs have the chain rule. Where outputs are
polynomials of lengths through those of several models, ``y = sum_p L_p(l) y_p``, their derivative is ``sum_p L_p dy_p +
dL_p/dl y_p``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, RunError
from pgmp_petsc.gradients.contacts import Contact, Contacts
from pgmp_petsc.gradients.differences import FURTHER, NEAR, Differences, Off, why_differences
from pgmp_petsc.gradients.linearisation import Linearisation, Linearised
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import eliminate
from pgmp_petsc.models import Model, Observing, OutputRecord, ReducedModel
from pgmp_petsc.models.lengths import blended
from pgmp_petsc.models.reduced_statics import JointAngles
from pgmp_petsc.outputs.of_outputs import FormulaOfOutputs
from pgmp_petsc.outputs.outputs import in_order
from pgmp_petsc.outputs.rainflow import counted_changes
from pgmp_petsc.scene.uses import offset_directions, ordered_ends, velocity_names
from pgmp_petsc.stepping.alpha_step import LENGTHS, WEIGHTS, First, first_accelerations, goes_on_resolved
from pgmp_petsc.stepping.generalised_alpha import Attempt, Run, StateRecord, integrate, integrate_with_smaller_steps
from pgmp_petsc.stepping.second_order_system import Scheme, SecondOrderSystem, State
from pgmp_petsc.stepping.status import Status

Outputs = dict[str, np.ndarray]  # over a run or their derivatives, by their names, (n_t,) each
MOST_NUMBERS = 4_000_000  # of matrices along a run that are kept at once, 32 MB


@dataclass(frozen=True, eq=False)
class DifferentiatedRun:
    """A run and its derivatives."""

    time: np.ndarray  # shape (n_t,), s
    outputs: Outputs
    #: of every output with every parameter, by the names of both: ``derivatives[output][parameter]``, (n_t,)
    derivatives: dict[str, dict[str, np.ndarray]]
    steps_divided: int = 1  # by what the scene's step was divided
    off: Off = Off()  # how far derivatives that are differences may be off; see `differences`
    contacts: tuple[Contact, ...] = ()  # instants at which end stops are met and left, with their own derivatives

    def at_steps_of_scene(self) -> tuple[np.ndarray, Outputs]:
        """Return the instants after the scene's own steps and the outputs there, as many whatever the run's steps."""
        every = slice(None, None, self.steps_divided)
        return self.time[every], {name: values[every] for name, values in self.outputs.items()}


def differentiate(
    model: Model, values: Mapping[str, float], names: Sequence[str], pulse: Callable[[int], object] = lambda n: None
) -> DifferentiatedRun:
    """Run one sample, and differentiate its outputs with some parameters; with forces beside (`Scene.beside`), and of
    component models, by `differences`.

    The model is that of samples in which these parameters vary (`models.of_samples`), with the value of every parameter
    of the scene; `pulse` is called with the number of steps that have been taken since the last call. Raises
    `InputError` if the scene has no outputs, there is no static equilibrium to start from, or an end stop is grazed;
    `RunError` if the run stops before its end, with smaller steps too, or the lower end of a stop or limit is not below
    its upper one.
    """
    if not model.outputs.functions:
        raise InputError("outputs: none is given, so there is nothing to differentiate; add a table [outputs.NAME]")
    for ends in ordered_ends(model.scene):
        lower, upper = ends.at(model.scene, values)
        if not lower < upper:
            raise RunError(f"{ends.entry} is not below {ends.other} there")
    if why_differences(model):
        return _by_differences(model, values, names, pulse)

    def once(attempt: Attempt) -> tuple[Run, tuple[StateRecord, SecondOrderSystem]]:
        system = model.batch({name: np.array([value]) for name, value in values.items()}, 1)
        system.precise = True
        system.require_settled()
        trail = StateRecord(pulse)
        return integrate(system, attempt.simulation, observer=trail), (trail, system)

    attempt, (trail, system) = _fine(model, once)
    times, states = trail.states()
    linearisation = Linearisation(model, values, names)
    step, radius = times[-1] / (len(times) - 1), model.scene.simulation.spectral_radius
    first = first_accelerations(system, system.start(), step, np.ones(1, dtype=bool), radius)
    begun = replace(states, a=np.concatenate([first.a, states.a[1:]]))
    contacts = Contacts(model, system, linearisation, times, begun, first.auxiliary[0])
    changes = _propagated(model, first, linearisation, contacts, times, states)
    with np.errstate(all="ignore"):
        observed = ObservedChanges(model, values, times, states)
        by_name = {name: observed.of(name, changes[:, :, number]) for number, name in enumerate(names)}
    outputs, derivatives = _counted(model, values, times, observed.outputs, by_name)
    return DifferentiatedRun(times, outputs, derivatives, attempt.divisor, contacts=tuple(contacts.found))


def _fine(model: Model, once: Callable[[Attempt], tuple[Run, Any]]) -> tuple[Attempt, Any]:
    """Integrate `once`, or again with smaller steps; return the attempt that came to the end and what it kept. Raises
    `RunError` if none did."""
    kept: list[tuple[Attempt, Run, Any]] = []

    def run(attempt: Attempt) -> Run:
        done, own = once(attempt)
        kept[:] = [(attempt, done, own)]
        return done

    integrate_with_smaller_steps(run, model.scene.simulation, np.ones(1, dtype=bool))
    attempt, done, own = kept[0]
    status = Status(done.status[0])
    if status != Status.FINE:
        cure = status.cure(model.name, model.scene.beyond_steps)
        raise RunError(f"the run stopped at {done.failure_time[0]:.6g} s: {status.meaning}; {cure}")
    return attempt, own


def _by_differences(
    model: Model, values: Mapping[str, float], names: Sequence[str], pulse: Callable[[int], object]
) -> DifferentiatedRun:
    """Return a run with differences of the runs beside it as derivatives; see `differentiate`."""
    near = Differences.of(model, values, names, NEAR)
    attempt, times, each = _runs_beside(model, near, pulse)
    with np.errstate(all="ignore"):
        found = {output: near.slopes(each[output]) for output in each}
        for share, enough in FURTHER:
            offs = [off for output, slopes in found.items() for off in slopes.offs(output)]
            doubted = [name for name in names if any(off.share > enough and off.parameter == name for off in offs)]
            if not doubted:
                continue
            beside = Differences.of(model, values, doubted, share)
            try:
                other, _, runs = _runs_beside(model, beside)
            except PgmpError:
                continue  # what is further away may have no run
            for output in runs if other.divisor == attempt.divisor else ():
                found[output].take(beside.slopes(runs[output]))
    sizes = dict(zip(names, near.sizes))
    by_name = {name: {output: slopes.effects[name] / sizes[name] for output, slopes in found.items()} for name in names}
    off = max((off for output, slopes in found.items() for off in slopes.offs(output)), default=Off())
    outputs, derivatives = _counted(model, values, times, {name: runs[0] for name, runs in each.items()}, by_name)
    return DifferentiatedRun(times, outputs, derivatives, attempt.divisor, off)


def _runs_beside(
    model: Model, beside: Differences, pulse: Callable[[int], object] = lambda n_steps: None
) -> tuple[Attempt, np.ndarray, Outputs]:
    """Run a sample and those beside it; return the attempt, times (n_t,), and outputs, each (n_runs, n_t)."""

    def once(attempt: Attempt) -> tuple[Run, tuple[np.ndarray, list[Outputs]]]:
        times, runs = np.zeros(0), list[Outputs]()
        while len(runs) < beside.n_runs:
            n = min(model.largest_batch, beside.n_runs - len(runs))
            own = {name: column[len(runs) : len(runs) + n] for name, column in beside.values.items()}
            system = model.batch(own, n)
            system.precise = True
            system.require_settled()
            record = OutputRecord(model, system, *([] if runs else [pulse]))
            with np.errstate(all="ignore"):
                done = integrate(system, attempt.simulation, observer=record)
            worst = [int(np.argmax(done.status != Status.FINE))]  # the first that stopped, or the first of all
            done = replace(done, status=done.status[worst], failure_time=done.failure_time[worst])
            if done.status[0] != Status.FINE:
                break
            times, found = record.evaluated()
            runs += [{name: values[:, k] for name, values in found.items()} for k in range(n)]
        return done, (times, runs)

    attempt, (times, runs) = _fine(model, once)
    return attempt, times, {output: np.array([run[output] for run in runs]) for output in model.outputs.functions}


def _counted(
    model: Model, values: Mapping[str, float], times: np.ndarray, outputs: Outputs, by_name: Mapping[str, Outputs]
) -> tuple[Outputs, dict[str, dict[str, np.ndarray]]]:
    """Return outputs, with what is counted of them, and their derivatives by the names of outputs and parameters."""
    counts = model.outputs.counts
    by_name = {name: counted_changes(counts, times, outputs, found, values, name) for name, found in by_name.items()}
    outputs = model.outputs.counted_over(times, outputs, values)
    derivatives = {output: {name: found[output] for name, found in by_name.items()} for output in outputs}
    for output, whole in outputs.items():
        for name, found in {"": whole, **derivatives[output]}.items():
            if not np.isfinite(found).all():
                at = times[int(np.argmin(np.isfinite(found)))]
                what = f"its derivative with {name} " if name else ""
                raise RunError(f"outputs.{output}: {what}is no finite number from {at:.6g} s on")
    return outputs, derivatives


def _propagated(
    model: Observing, begun: First, linearisation: Linearisation, contacts: Contacts, times: np.ndarray, states: State
) -> np.ndarray:
    """Return the derivatives of the reduced coordinates, their rates and their accelerations over the run, shape (3,
    n_t, n_parameters, n_eta)."""
    n_t, n = states.q.shape
    step = times[-1] / (n_t - 1)
    radius = model.scene.simulation.spectral_radius
    scheme = Scheme.of(radius, step)
    prescribed = linearisation.prescribed
    moment = start_of_sensitivities(model, linearisation, states.at(slice(1)))
    result = np.empty((3, n_t, len(linearisation.names), n))
    result[:, 0] = moment[:3]
    if not begun.lost.any():
        moment[3] = _of_first(moment, linearisation, begun.ends, step, ~prescribed)
    if goes_on_resolved(radius):
        moment[2] = moment[3]
    at_once, first = max(16, MOST_NUMBERS // (3 * n * n)), 1
    while first < n_t:
        crossing = contacts.following(first)
        for begin in range(first, crossing, at_once):
            part = slice(begin, min(begin + at_once, crossing))
            here = linearisation.at(times[part], states.at(part))
            found = np.empty((3, *here.by_parameters.shape))
            propagate(
                here.by_q, here.by_v, here.by_a, here.by_parameters, astuple(scheme), step, prescribed, moment, found
            )  # fmt: skip
            result[:, part] = found
        if crossing < n_t:
            moment = contacts.through(crossing, moment)
            result[:, crossing] = moment[:3]
        first = crossing + 1
    return result


@njit(cache=True, entry=True, error_model="numpy", fastmath={"contract"})
def propagate(by_q, by_v, by_a, by_parameters, scheme, step, prescribed, moment, result):
    """Take the sensitivities through steps.

    Parameters
    ----------
    by_q, by_v, by_a, by_parameters
        At the ends of the steps, see `linearisation.Linearised`.
    scheme
        ``(alpha_m, alpha_f, beta, gamma, gain_v, gain_a)`` of the step.
    step
        s.
    prescribed
        Whether a coordinate is given, shape (n_eta,): it stays what it is in the beginning.
    moment
        S_q, S_v, S_a and S_A at the beginning, shape (4, n_parameters, n_eta); advanced in place.
    result
        S_q, S_v and S_a at the ends of the steps, shape (3, n_t, n_parameters, n_eta).
    """
    alpha_m, alpha_f, beta, gamma, gain_v, gain_a = scheme
    n_t, n_parameters, n = by_parameters.shape
    matrix, right, predicted = np.empty((n, n)), np.empty((n, n_parameters)), np.empty((3, n_parameters, n))
    weight = 1.0 / (1.0 - alpha_m)
    for t in range(n_t):
        for i in range(n):
            for j in range(n):
                matrix[i, j] = by_q[t, i, j] + gain_v * by_v[t, i, j] + gain_a * by_a[t, i, j]
        for p in range(n_parameters):
            q, v, a = predicted[0, p], predicted[1, p], predicted[2, p]
            for i in range(n):
                before, rate, now, auxiliary = moment[0, p, i], moment[1, p, i], moment[2, p, i], moment[3, p, i]
                ahead = (now - alpha_m * auxiliary) * weight
                q[i] = before + step * rate + step * step * ((0.5 - beta) * auxiliary + beta * ahead)
                v[i], a[i] = rate + step * ((1.0 - gamma) * auxiliary + gamma * ahead), now
                if prescribed[i]:
                    q[i], v[i], a[i] = before, 0.0, 0.0
            for i in range(n):
                right[i, p] = -by_parameters[t, p, i]
                for j in range(n):
                    right[i, p] -= by_q[t, i, j] * q[j] + by_v[t, i, j] * v[j] + by_a[t, i, j] * a[j]
        for k in range(n):
            if prescribed[k]:
                matrix[k, :], matrix[k, k], right[k, :] = 0.0, 1.0, 0.0
        eliminate(n, n_parameters, matrix, right)
        for p in range(n_parameters):
            q, v, a = predicted[0, p], predicted[1, p], predicted[2, p]
            for i in range(n):
                x, then = right[i, p], a[i] + gain_a * right[i, p]
                now, auxiliary = moment[2, p, i], moment[3, p, i]
                moment[0, p, i], moment[1, p, i], moment[2, p, i] = q[i] + x, v[i] + gain_v * x, then
                moment[3, p, i] = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * auxiliary) * weight
                for part in range(3):
                    result[part, t, p, i] = moment[part, p, i]


def _of_first(
    moment: np.ndarray, linearisation: Linearisation, ends: Sequence[State], step: float, free: np.ndarray
) -> np.ndarray:
    """Return S_A that steps begin with, of `first_accelerations`: at the end of a step of length l ``(by_a + l
    by_v + l^2 / 2 by_q) S_a = - (by_p + by_q (S_q + l S_v) + by_v S_v)``, of free coordinates."""
    found = np.zeros_like(moment[3])
    for length, weight, end in zip(np.multiply(LENGTHS, step), WEIGHTS, ends):
        here = linearisation.at(np.array([length]), end)
        by_q, by_v = here.by_q[0], here.by_v[0]
        pushed = here.by_parameters[0] + moment[0] @ by_q.T + moment[1] @ (by_v + length * by_q).T
        found[:, free] -= weight * _solved(here.by_a[0] + length * by_v + 0.5 * length**2 * by_q, pushed, free)
    return found


DIFFERENCE = 1e-3  # of second differences of fourth order: rounding and truncation leave 1e-9 of them


def start_of_sensitivities(model: Observing, linearisation: Linearisation, start: State) -> np.ndarray:
    """Return S_q, S_v, S_a and S_A of a sample at time zero, shape (4, n_parameters, n_eta), from its state there,
    arrays of shape (1, n_eta)."""
    n_parameters, n = len(linearisation.names), start.q.shape[1]
    moment = np.zeros((4, n_parameters, n))
    free, given = ~linearisation.prescribed, offset_directions(model.scene)
    for row, name in zip(moment[0], linearisation.names):
        row[n - len(given) :] = [own == name for own in given]
    time, initial, bent = np.zeros(1), model.scene.initial, free.copy()
    still = replace(start, v=np.zeros_like(start.v), a=np.zeros_like(start.a))
    if initial.equilibrium:
        at_rest, held = linearisation.at(time, still), initial.coordinates != "free"
    elif given:
        alone = copy(model)
        alone.actions = model.actions.of_joints(model.kinematics.mechanism)
        at_rest = Linearisation(alone, linearisation.values, linearisation.names).at(time, still, loaded=False)
        held, bent[: model.kinematics.n_coordinates] = bool(alone.actions.actions), False
        if held:
            _require_rest(model)
    if initial.equilibrium or given:
        if held:
            moment[0] = _held(model, start.q, at_rest, linearisation, moment[0])
        else:
            pushed = at_rest.by_parameters[0] + moment[0] @ at_rest.by_q[0].T
            moment[0][:, bent] = -_solved(at_rest.by_q[0], pushed, bent)
            if initial.equilibrium and not model.motions:
                return moment  # at rest it stays there: no accelerations, whatever the parameters
        moment[0][:, list(model.motions)] = 0.0
    named = velocity_names(model.scene)
    for k, coordinate in enumerate(model.kinematics.coordinates):
        for row, name in zip(moment[1], linearisation.names):
            row[k] = float(named.get(coordinate.name) == name)
    now = linearisation.at(time, start)
    pushed = now.by_parameters[0] + moment[0] @ now.by_q[0].T + moment[1] @ now.by_v[0].T
    moment[2][:, free] = -_solved(now.by_a[0], pushed, free)
    moment[3] = moment[2]
    return moment


def _require_rest(model: Observing) -> None:
    """Refuse a start that moves, where springs of elastic joints are in balance with joints that are off."""
    named = velocity_names(model.scene)
    for name, rate in zip(model.scene.coordinates, model.start[1]):
        if rate or name in named:
            raise InputError(
                f"simulation.initial.{name}.velocity = {named.get(name, f'{rate:.6g}')}: joints are off beside elastic "
                "ones, and derivatives of how their balance moves with the start are not known; let the run "
                "begin at rest, or compare runs (--set)"
            )


def _solved(matrix: np.ndarray, rows: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the solutions for the free coordinates of right-hand sides in rows."""
    return np.linalg.solve(matrix[np.ix_(free, free)], rows[:, free].T).T


def _held(
    model: Observing, eta: np.ndarray, at_rest: Linearised, linearisation: Linearisation, given: np.ndarray
) -> np.ndarray:
    """Return S_q of coordinates (n_parameters, n_eta) whose joints' angles are held, at eta (1, n_eta); `given` has
    that of coordinates that say how far joints are off."""
    angles = [member.joint_angles for member in model.members]
    slopes, curvatures = _angle_derivatives(model, angles, model.shares(linearisation.values), eta)
    r, n = slopes.shape
    moving = ~model.terms.tables.prescribed(())
    torques = np.linalg.lstsq(slopes[:, moving].T, -at_rest.residual[0, moving], rcond=None)[0]
    matrix = np.zeros((n + r, n + r))
    matrix[:n, :n] = at_rest.by_q[0] + np.einsum("k,kij->ij", torques, curvatures)
    matrix[:n, n:], matrix[n:, :n] = slopes.T, slopes
    right = np.concatenate([at_rest.by_parameters[0], np.zeros((len(at_rest.by_parameters[0]), r))], axis=1)
    for row, name in zip(right, linearisation.names):
        shares = model.shares(linearisation.values, name)
        if shares.any():
            row[:n] += torques @ _angle_derivatives(model, angles, shares, eta)[0]
            row[n:] += _angles(angles, shares, eta)[0]
    right[:, : given.shape[1]] += given @ matrix[:n, :n].T
    right[:, n:] += given @ slopes.T
    found = given.copy()
    found[:, moving] -= _solved(matrix, right, np.append(moving, np.ones(r, dtype=bool)))[:, :-r]
    return found


def _angle_derivatives(
    model: Observing, angles: Sequence[JointAngles], shares: np.ndarray, eta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return first and second derivatives of the coordinates' angles, (n_theta, n_eta) and (n_theta, n_eta, n_eta)."""
    offsets, factors = np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
    steps = np.diag(DIFFERENCE / model.terms.scale)
    lines = offsets[:, None, None] * steps
    slopes = np.einsum("o,oik->ki", factors, _angles(angles, shares, eta + lines))
    planes = lines[:, :, None, None] + lines
    curvatures = np.einsum("o,p,oipjk->kij", factors, factors, _angles(angles, shares, eta + planes))
    inverse = 1.0 / np.diag(steps)
    return slopes * inverse, curvatures * np.outer(inverse, inverse)


def _angles(angles: Sequence[JointAngles], shares: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Return the angles at eta of shape (..., n_eta), sums over members with shares, shape (..., n_theta)."""
    rows = eta.reshape(-1, eta.shape[-1])
    found = sum(share * own.of(rows) for share, own in zip(shares, angles))
    return found.reshape(*eta.shape[:-1], found.shape[1])


# in rad or of the mechanism's size: truncation leaves 2e-9, and rounding 1e-12 of the mechanism's size
OBSERVED_DIFFERENCE = 1e-4
OF_STRESSES = 1e-5  # of stresses, and of the parameter: their lines leave cells, where slopes of tables have corners


class ObservedChanges:
    """The outputs of one run and their derivatives.

    Instants of the run have shape (n_t,), s, and reduced coordinates, rates and accelerations there shapes (n_t,
    n_eta).
    """

    def __init__(self, model: Observing, values: Mapping[str, float], times: np.ndarray, states: State) -> None:
        self._model, self._values, self._times, self._states = model, dict(values), times, states
        self._members = [_Member(member, self._values, times, states) for member in model.members]
        shares = model.shares(self._values)
        self._made_of = blended(shares, [member.outputs for member in self._members])
        self._made_of |= model.stressed(states, self._values)
        self.outputs = model.composed(self._made_of, times, self._values, times.size)  # each of shape (n_t,)
        entries = {one: model.scene.outputs[one] for one in in_order(model.scene)}
        self._combined = {
            one: entry.combined(one, dict.fromkeys(entry.made_in(model.scene)), model.scene)
            for one, entry in entries.items() if isinstance(entry, FormulaOfOutputs)
        }  # fmt: skip

    def of(self, name: str, changes: np.ndarray) -> Outputs:
        """Return the derivatives of all outputs with a parameter, each (n_t,), for those of eta, its rates and
        accelerations, shape (3, n_t, n_eta)."""
        shares, slopes = self._model.shares(self._values), self._model.shares(self._values, name)
        parts = [member.changes(name, changes) for member in self._members]
        parts += [member.outputs for member in self._members]
        found = blended([*shares, *slopes], parts)
        value = self._values[name]
        found |= _central(
            lambda far: self._model.stressed(_moved(self._states, far, changes), self._values | {name: value + far}),
            OF_STRESSES / _largest(self._model, changes, value),
        )
        found = self._through_formulas(name, found)
        for output, formula in self._combined.items():
            exact = formula.change(name, self.outputs, found, self._times, self._values)
            # the slope of a root at zero is infinite
            found[output] = np.where(np.isfinite(exact), exact, found[output])
        return found

    def _through_formulas(self, name: str, found: Outputs) -> Outputs:
        """Return derivatives with those of formulas by differences along what they are made of."""
        model, value = self._model, self._values[name]
        if not model.formulas:
            return found
        sizes = {one: np.abs(values).max() for one, values in self._made_of.items()}
        shares = [np.full((1, self._times.size), 1.0 / abs(value) if value else 0.0)]
        shares += [np.abs(np.atleast_2d(found[one])) / size for one, size in sizes.items() if size]
        largest = np.max(np.concatenate(shares), axis=0)

        def composed(far: np.ndarray) -> Outputs:
            made_of = {one: values + far * found[one] for one, values in self._made_of.items()}
            return model.composed(made_of, self._times, self._values | {name: value + far}, far.size)

        changes = _central(composed, OBSERVED_DIFFERENCE / np.where(largest > 0.0, largest, 1.0))
        return found | {formula: changes[formula] for formula in model.formulas}


class _Member:
    """The same of one of the models whose outputs, each with its share, make those of the whole."""

    def __init__(self, model: ReducedModel, values: Mapping[str, float], times: np.ndarray, states: State) -> None:
        self._model, self._values, self._times, self._states = model, values, times, states
        frames, self._along = model.reconstruction.along(states.q)
        order = model.outputs.order
        jets = model.reconstruction.jets((states.q, states.v, states.a), order) if order else []
        observed = model.observed_at([frames, *jets[1:]], times, states, values)
        self._behind = observed[frames.shape[0] * frames.shape[1] :]
        # the loops that this closes serve all evaluations next to it
        self._evaluate = model.outputs.near(observed)
        self.outputs = self._evaluate(observed)
        #: outputs by what is differenced: frames alone, or the whole line, stresses with smaller steps
        self._kinds: dict[str, str] = {}
        for name, reading in model.outputs.functions.items():
            on_line = reading.depth(0) or reading.needs.parameters or reading.needs.base
            of_model = reading.needs.stresses or reading.needs.multipliers
            self._kinds[name] = "stresses" if of_model else "line" if on_line else "frames"

    def changes(self, name: str, changes: np.ndarray) -> Outputs:
        """Return the derivatives of the outputs with a parameter."""
        model, value, frames_at = self._model, self._values[name], self._along(changes[0])

        def observed(far: np.ndarray, cells: np.ndarray | None = None) -> np.ndarray:
            values = self._values | {name: value + far}
            return model.observed_of(self._times, _moved(self._states, far, changes), values, cells)

        of_line = _largest(model, changes, value)
        ways = {
            "frames": (
                lambda far: self._evaluate(np.concatenate([frames_at(far).reshape(-1, far.size), self._behind])),
                OBSERVED_DIFFERENCE / _largest(model, changes, 0.0),
            ),
            "line": (lambda far: model.outputs.evaluate(observed(far, self._states.q)), OBSERVED_DIFFERENCE / of_line),
            "stresses": (lambda far: self._evaluate(observed(far)), OF_STRESSES / of_line),
        }
        each = {kind: _central(*ways[kind]) for kind in {*self._kinds.values()}}
        return {output: each[self._kinds[output]][output] for output in self.outputs}


def _central(outputs: Callable[[np.ndarray], Outputs], far: np.ndarray) -> Outputs:
    """Return central differences of outputs along a line, over steps (n_t,)."""
    ahead, behind = outputs(far), outputs(-far)
    return {name: (ahead[name] - behind[name]) / (2.0 * far) for name in ahead}


def _moved(states: State, far: np.ndarray, changes: np.ndarray) -> State:
    """Return states that follow a parameter so far (n_t,) from its value."""
    moved = (part + far[:, None] * change for part, change in zip(states.parts(), changes))
    return State(*moved, states.multipliers)


def _largest(model: Observing, changes: np.ndarray, value: float) -> np.ndarray:
    """Return by how many of what is large reduced coordinates change with a parameter, or the parameter with itself,
    where it is not zero, shape (n_t,): what it is a factor of must not be taken far from its value."""
    size = np.max(np.abs(changes[0]) * model.terms.scale, axis=1)
    largest = np.maximum(size, 1.0 / abs(value) if value else 0.0)
    return np.where(largest > 0.0, largest, 1.0)
