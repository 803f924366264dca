"""A single run of a reduced model: its errors, where it is valid, and what its tables cannot tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pgmp_petsc.base.errors import Remark, note
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects import loads_of
from pgmp_petsc.estimates import own_error
from pgmp_petsc.estimates.error_indicator import ErrorIndicator
from pgmp_petsc.estimates.starts import growth_of, jump_remarks, spread_remarks
from pgmp_petsc.estimates.validity import Validity, remarks_of
from pgmp_petsc.mechanism.mechanism import rigid_positions, to_body, words_of
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.lagrangian import least_stiffness, load_powers
from pgmp_petsc.reduction.tables import smoother
from pgmp_petsc.results.estimates import Balance, EstimatedErrors
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.stepping.generalised_alpha import Attempt, StateRecord, Together, integrate
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.static_equilibrium import start_remarks
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies import single_run
from pgmp_petsc.studies.field_frames import field_frames, fields_over, left_out_of_fields
from pgmp_petsc.studies.single_run import RunPart


def run_reduced(model: ReducedModel, comm: Comm, n_ranks: int) -> Trajectory:
    """Run a reduced model on this process, of a command on so many ranks; see `studies.simulate`."""
    timings, indicator = Timings(), ErrorIndicator(model) if own_error.is_estimated(model.scene) else None
    part, steps = single_run.furthest(
        lambda attempt: _reduced_part(model, attempt, indicator, timings, comm), model.scene.simulation
    )
    eta, n_theta = part.recorded["eta"], model.kinematics.n_coordinates
    validity, status = part.recorded["validity"], part.run.status
    with timings.phase("projection"):
        frames = np.moveaxis(model.frames_of(eta[part.shown]), 2, 0) if part.shown else np.empty(0)
        fields = model.fields()
        seen = fields_over(fields, eta[part.shown], model.scene.values)
    known, reason = part, ""
    if status[0] != Status.FINE:
        reason = lost_definiteness(model, _of_sample(model), part.time, eta) if np.isfinite(eta).all() else ""
        known = part.relied_on
        if indicator is not None and known.run.n_steps:
            known = _reduced_part(model, known.attempt, indicator, timings, comm)
    errors, estimated = _errors(model, part, known, timings)
    remarks = [*single_run.why_stopped(model, part.run, reason, eta), *steps, *estimated]
    if status[0] == Status.FINE and model.scene.loose:
        with timings.phase("a run from beside its start"):
            grown = growth_of(model, part.attempt.simulation, eta, part.outputs)
        remarks += spread_remarks(part.time, grown)
    found = {name: float(value[0]) for name, value in validity.extremes.items()}
    balance = single_run.balance_of(part.time, part.recorded["energies"])
    rests = single_run.rest_remarks(model, part, eta[:, :n_theta], frames)
    common = single_run.described(
        model, part, frames, n_ranks, timings,
        (*remarks, *(rests or single_run.balance_remarks(balance, part.attempt.simulation.step, model.scene.system)),
         *own_error.truncated_stresses(model.scene), *left_out_of_fields(fields.seen), *part.recorded["started"],
         *jump_remarks(model, part.recorded["system"], part.recorded["start"], balance.strain),
         *remarks_of(model.scene, found)),
    )  # fmt: skip
    return Trajectory(
        coordinates=eta[:, :n_theta],
        modal=eta[:, n_theta:],
        fields=field_frames(fields.seen, model.kinematics, frames, seen),
        balance=with_weights(balance, model, eta[0]),
        errors=errors,
        validity=found,
        **common,
    )


def _errors(
    model: ReducedModel, part: RunPart, known: RunPart, timings: Timings
) -> tuple[EstimatedErrors | None, list[Remark]]:
    """Return the estimated errors of a reduced run, and what is to be said of them; `known` is all of it, or of one
    that stopped a run of `RunPart.relied_on`."""
    watched, scene = known.recorded["watched"], model.scene
    if watched is None or known.run.status[0] != Status.FINE:
        return None, [*own_error.absence_of_estimates(scene)] or [
            note(f"errors were not estimated: {single_run.STOPPED}")
        ]
    with timings.phase("errors"):
        estimate = watched.estimate(known.run.status)
    absent = {name: why for name, (why,) in estimate.absent.items() if why}
    errors = EstimatedErrors(*estimate.histories[0], single_run.largest_felt(model, known.outputs), absent=absent)
    large = own_error.large_errors(
        *errors.of_one_run(), model.outputs.units, model.name, scene, single_run.vanishing_length(model)
    )
    until = single_run.up_to(part, "errors") if len(absent) < len(errors.outputs) else ()
    said = [*large, *until, *own_error.not_estimated(errors, scene), *own_error.few_steps(known.time.size - 1)]
    return errors, [*said, *own_error.left_out_of_estimates(model)]


def _reduced_part(
    model: ReducedModel, attempt: Attempt, indicator: ErrorIndicator | None, timings: Timings, comm: Comm
) -> RunPart:
    """Run a reduced model with the steps of an attempt; an indicator watches for errors."""
    simulation, values = attempt.simulation, _of_sample(model)
    system = model.batch(values, 1)
    system.require_settled()
    watched = None if indicator is None else indicator.stepped(simulation).watch(system, np.array([0]))
    validity = Validity(model, system, values, simulation)
    with timings.phase("integration"), single_run.progress_of("reduced", attempt, comm) as bar:
        record = StateRecord(bar.update)
        watches = [validity] if watched is None else [validity, watched]
        done = integrate(system, simulation, observer=Together([*watches, record]))
    times, history = record.states()
    with timings.phase("projection"), np.errstate(all="ignore"):
        outputs = model.observed_of(times, history, model.scene.values)
        energies = system.energies_over(*record.of_batch(), model.scene.values)
    part = RunPart.of(model, done, attempt, times, outputs, eta=history.q, energies=energies)
    start = State(history.q[:1], history.v[:1], history.a[:1], history.multipliers)
    looked = {"watched": watched, "validity": validity, "system": system, "started": start_remarks(model.scene, system)}
    return replace(part, recorded={**part.recorded, **looked, "start": start})


def _of_sample(model: ReducedModel) -> dict[str, np.ndarray]:
    return {name: np.array([value]) for name, value in model.scene.values.items()}


LOOK_BACK = 400  # steps before a failure in which its cause is looked for


def lost_definiteness(model: ReducedModel, values: Mapping[str, np.ndarray], time: np.ndarray, eta: np.ndarray) -> str:
    """Return since when the stiffness was indefinite before the end, and why; empty where it was not."""
    looked_at = slice(-LOOK_BACK, None)
    share = least_stiffness(model.terms, values, eta[looked_at])
    unsound = np.isnan(share)
    if unsound.any():
        where = words_of(model.kinematics.coordinates, eta[looked_at][np.argmax(unsound)], 4)
        what = f"the stiffness at rest, interpolated between sampled angles, is not positive definite at {where}"
        return f"{what}; build with {smoother(model.scene.interpolation)}"
    lost = share <= 0.0
    if not lost[-1]:
        return ""
    since = time[looked_at][lost.size - int(np.argmin(lost[::-1])) if not lost.all() else 0]
    return (
        f"the stiffness of the deformed mechanism is indefinite from {since:.6g} s on (at the end its least "
        f"eigenvalue is {share[-1]:.2g} times that at rest): the cubic strain energy of geometric_stiffening has no "
        "lower bound and runs away at deformations beyond what second order describes; "
        f"{Status.BROKE_DOWN.cure(model.name)}"
    )


def with_weights(balance: Balance, model: ReducedModel, start: np.ndarray) -> Balance:
    """Add the potential energy of weights to the balance of a reduced run, which knows their work alone.

    It is that at the start, reduced coordinates of shape (n_eta,), less the work done since: the same integral as in
    the residual, which does not change.
    """
    effects = [effect for effect in model.effects if effect.conservative]
    if not effects:
        return balance
    mechanism = model.kinematics.mechanism
    r, values = model.kinematics.n_coordinates, _of_sample(model)
    poses = model.kinematics.poses(start[:r])[..., 0]
    # from the undeformed bodies to the start, halfway: the work is of second degree in the deformation
    deformed = np.where(np.arange(start.size) < r, 0.0, start)
    bent = load_powers(model.terms, values, (start - 0.5 * deformed)[None], deformed[None])
    places = rigid_positions(mechanism, poses)
    matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
    potential = balance.potential
    for effect in effects:
        lifted = 0.0
        for load in loads_of([effect], matrices):
            weight, field = load.body_force
            force = matrices.mass[weight] @ to_body(mechanism, poses, field)
            lifted += float(load.weight.evaluate(model.scene.values)) * float(force @ places)
        lifted += float(bent[effect.name][0])
        potential = potential - float(effect.amplitude(0.0)) * lifted - balance.work[effect.name]
    return replace(balance, potential=potential)
