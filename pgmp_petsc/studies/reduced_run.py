"""A single run of a reduced model: its errors, where it is valid, what its tables cannot tell, and what its start does
to all of it: vibrations that it sets off, and small differences that grow.

**Vibrations**, where loads at time zero meet undeformed bodies.

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

**Differences**, from a second run of the model.

Where joints have room, each impact makes differences larger. A run from coordinates that are off by `OFF` of the range
in which each of them moves says by how much: with G(t) the largest difference of an output up to t, as a share of its
range, over `OFF`, a start that is known to the share p is lost where ``p G`` is one. Speeds, accelerations and forces
do not count, as they jump with an impact.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, gathered, note, warning
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects import AT_REST, loads_of
from pgmp_petsc.estimates import coarser_run, own_error
from pgmp_petsc.estimates.error_indicator import ErrorIndicator
from pgmp_petsc.estimates.validity import Validity, remarks_of
from pgmp_petsc.mechanism.mechanism import rigid_positions, to_body, words_of
from pgmp_petsc.models import OutputRecord, ReducedModel
from pgmp_petsc.models.model import search_of
from pgmp_petsc.models.reduced_statics import ReducedStatics
from pgmp_petsc.reduced.lagrangian import least_stiffness, load_powers
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduction.tables import smoother
from pgmp_petsc.results.estimates import Balance, EstimatedErrors
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.outputs import models_alone
from pgmp_petsc.scene.references import parts_of
from pgmp_petsc.stepping.generalised_alpha import Attempt, StateRecord, Together, integrate
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.static_equilibrium import settle, start_remarks
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
    errors = EstimatedErrors(*estimate.histories[0], coarser_run.largest_felt(model, known.outputs), absent=absent)
    large = own_error.large_errors(
        *errors.of_one_run(), model.outputs.units, model.name, scene, coarser_run.vanishing_length(model)
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


LARGE = 0.5  # share of the largest deformation from which on a run is about its start
CURED = 0.25  # share of the swing that a start from static deformation may leave
STILL = 1e-6  # of the mechanism's size, or of 1 rad: what moves by less has no range
OFF = 1e-9  # of the range of each coordinate
TAIL = 1e-9  # of the forces that accelerate the start, below which that of a smooth law is its tail
KNOWN = 1e-3  # to which a start is known, as a rule


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
    if model.scene.carried:
        lasts += (
            "; friction hangs on the forces that it makes in joints: where the step does not follow it, estimated "
            "errors may be several times too small"
        )
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
    """Return the effects and controllers whose forces count at the start of one sample, by their entries."""
    at = np.zeros(1)
    names = set(model.terms.tables.load_effects)
    found = {effect.name for effect in model.effects if effect.name in names and np.any(effect.amplitude(at))}
    if actions := model.actions.actions:
        forces = system.action_forces(at, np.array([[state.q, state.v, state.a]])).reshape(len(actions), -1)
        n = system.n_moving
        moved = np.abs(system.stiffness_and_inertia(0.0, state)[1][0, :n, :n] @ state.a[0, :n]).max()
        found |= {action.effect for action, own in zip(actions, forces) if np.abs(own).max() > TAIL * moved}
    named = {f"effects.{name}": parts_of(name, effect) for name, effect in model.scene.effects.items()}
    named |= {f"controllers.{name}": (name,) for name in model.scene.controllers}
    return [entry for entry, parts in named.items() if not found.isdisjoint(parts)]


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


def growth_of(model: ReducedModel, simulation: Simulation, eta: np.ndarray, outputs: Arrays) -> np.ndarray | None:
    """Return G (n_t,) of a run with coordinates (n_t, n_eta) and outputs; None where a run from beside its start does
    not end, or nothing moves."""
    scene = model.scene
    smooth = [k for k, one in scene.outputs.items() if not (models_alone(scene, k) or one.derivatives_in(scene))]
    size = model.kinematics.size
    system = model.batch({name: np.array([value]) for name, value in model.scene.values.items()}, 1)
    start = system.start()
    q = start.q.copy()
    q[:, : system.n_moving] += OFF * np.ptp(eta, axis=0)[: system.n_moving]
    system.begun = q, start.v
    record = OutputRecord(model, system)
    if integrate(system, simulation, observer=record).status[0] != Status.FINE:
        return None
    beside = record.evaluated()[1]
    shares = [
        np.maximum.accumulate(np.abs(beside[name][:, 0] - own)) / np.ptp(own)
        for name, own in outputs.items()
        if name in smooth and np.ptp(own) > STILL * (1.0 if model.outputs.units[name] == "rad" else size)
    ]
    return np.max(shares, axis=0) / OFF if shares else None


@gathered
def spread_remarks(times: np.ndarray, growth: np.ndarray | None) -> Iterator[Remark]:
    """Return by how much differences of the start grow over a run, and that it is chaotic where they take all."""
    if growth is None:
        return
    grown = f"a small difference of the start becomes {growth[-1]:.2g} times as large over the run, by its impacts"
    lost = growth * KNOWN >= 1.0
    if not lost.any():
        yield note(grown)
        return
    yield warning(
        f"chaotic: {grown}. Of a start that is known to {KNOWN:g} nothing is left from {times[np.argmax(lost)]:.3g} s "
        "on: a single history is one of many there, and statistics of samples (pgmp montecarlo) are what is known"
    )
