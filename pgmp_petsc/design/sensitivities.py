"""Sensitivities of a run: derivatives of its outputs with parameters of the scene."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, gathered, nearest_name, note, warning
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.estimates.error_indicator import errors_of_runs, not_known
from pgmp_petsc.estimates.own_error import largest_at_start, of_figures, polynomials_of_lengths
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.gradients.contacts import Contact
from pgmp_petsc.gradients.differences import NEAR, Off, announce_runs, why_differences
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, differentiate
from pgmp_petsc.models import LengthLanes, Model, Observing, ReducedModel, of_samples
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.results.gradients import DEVIATION, PERCENT, Derivatives, Instants, is_sharp, vertex
from pgmp_petsc.results.numbers import nothing, share_text
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.parameters import correlation_matrix
from pgmp_petsc.scene.units import own_values, result_units

SHARE = 0.01  # of the value of a parameter without a distribution
LEAST = 0.05  # of an output's largest effect: smaller ones are nothing beside it
DOUBTFUL = 0.01  # of the largest derivative: what differences may be off by from there on is warned of


def chosen_parameters(scene: Scene, asked: Sequence[str], known: Iterable[str], without: str) -> tuple[str, ...]:
    """Return the parameters that are asked for, each once, all that are known where none is; raises `InputError` if
    there is no parameter, with what is to be done `without`, or none of a name."""
    for name in asked:
        if name not in scene.parameters:
            raise InputError(f"--parameter {name}: there is no such parameter{nearest_name(name, scene.parameters)}")
    names = tuple(dict.fromkeys(asked)) or tuple(known)
    if not names:
        raise InputError(f"parameters: {without}")
    return names


def sensitivities(model: ReducedModel, asked: Sequence[str], comm: Comm) -> Derivatives | None:
    """Run a sample, and differentiate it with the parameters of these names, all where there are none; one rank does,
    the others wait, and have None. Collective on `comm`. Raises `InputError` and `RunError` as `differentiate` and
    `chosen_parameters`."""
    with agreed(comm, "sensitivities"):
        names = chosen_parameters(
            model.scene, asked, model.scene.parameters, "the scene has none; give a number a name, such as "
            "[parameters.r1] nominal = 5.6e-3, and the name in its place",
        )  # fmt: skip
        return _on_one_rank(model, names, comm) if comm.rank == 0 else None


def _on_one_rank(model: ReducedModel, names: Sequence[str], comm: Comm) -> Derivatives:
    scene, timings, model = model.scene, Timings(), of_samples(model, names)
    n_steps = scene.simulation.n_steps
    announce_runs(model, names, "this run with its derivatives", comm)
    with timings.phase("run and derivatives"), progress(n_steps, model.title, comm) as bar:
        run = differentiate(model, scene.values, names, bar.update)
    with timings.phase("errors"):
        own = _of_own_error(model, run, names)
    units = {name: result_units(scene)[name] for name in names} | dict(model.outputs.units)
    changes = {name: _change(scene, name) for name in names}
    idle = [name for name in names if not any(found[name].any() for found in run.derivatives.values())]
    without = [note(f"no output depends on {', '.join(idle)} in this run")] if idle else []
    corners = corner_remarks(run, np.array([[change] for change, _ in changes.values()]))
    # zero where one has no distribution
    matrix = correlation_matrix(scene, names)
    uncertain = np.array([scene.parameters[name].distribution is not None for name in names], dtype=float)
    return Derivatives(
        RunRecord(
            scene_to_toml(scene), own_values(scene), None, comm.size, timings.as_dict(),
            (*run_remarks(model, run), *corners, *own, *without, *scene.remarks),
        ),
        run.time,
        run.outputs,
        run.derivatives,
        units,
        changes,
        (np.eye(len(names)) if matrix is None else matrix) * np.outer(uncertain, uncertain),
        run.steps_divided,
        _instants(run.contacts),
    )  # fmt: skip


def _instants(contacts: Sequence[Contact]) -> Instants | None:
    if not contacts:
        return None
    met, time, turning = (np.array([getattr(c, name) for c in contacts]) for name in ("met", "time", "turning"))
    return Instants(tuple(c.effect for c in contacts), met, time, turning, np.array([c.derivatives for c in contacts]))


def _change(scene: Scene, name: str) -> tuple[float, str]:
    """Return the change of a parameter to which effects refer, and what it is."""
    parameter = scene.parameters[name]
    if parameter.distribution is not None:
        return parameter.deviation, DEVIATION
    return SHARE * abs(scene.values[name]), PERCENT


def _of_own_error(model: Observing, run: DifferentiatedRun, names: Sequence[str]) -> tuple[Remark, ...]:
    """Return what errors of the model do to the effects at the end: they change from here to the next value of each
    parameter."""
    scene, what, units = model.scene, "derivatives", model.outputs.units
    moved = [_moved(scene, name) for name in names]
    points = [scene.values, *(scene.values | {name: value} for name, value in zip(names, moved))]
    errors = errors_of_runs(model, points)
    if errors is None:
        return (not_known(model, what),)
    effects, lost = [], [output for output, at_end in errors.at_end.items() if not np.isfinite(at_end).all()]
    none = nothing(run.outputs, units, model.kinematics.size)
    for output, at_end in errors.at_end.items():
        if output in lost:
            continue
        slopes = run.derivatives[output]
        size = max(abs(slopes[name][-1] * (new - scene.values[name])) for name, new in zip(names, moved))
        for name, new, error in zip(names, moved, at_end[1:]):
            change = new - scene.values[name]
            slope = float(slopes[name][-1])
            # an effect that is nothing beside the largest one, or beside outputs, is not worth a word
            if abs(slope * change) > max(LEAST * size, none[output]):
                without = slope - (error - at_end[0]) / change
                text = f"d {output} / d {name} at the end"
                unit = scene.system.size_of(scene.parameters[name].unit or "1") / scene.system.size_of(units[output])
                effects.append((text, unit * slope, unit * float(without), abs(unit * slope)))
    unknown = (not_known(model, f"{what} of {', '.join(lost)}", errors, lost),) if lost else ()
    return (*(of_figures(effects) if effects else ()), *unknown)


def _moved(scene: Scene, name: str) -> float:
    """Return the changed value of a parameter for its effects, within its bounds, on where that is far enough."""
    value, change = scene.values[name], _change(scene, name)[0] or SHARE
    low, high = scene.parameters[name].bounds or (-np.inf, np.inf)
    back, on = max(value - change, low), min(value + change, high)
    return on if on == value + change or on - value > value - back else back


def step_remarks(model: Observing, run: DifferentiatedRun) -> list[Remark]:
    """Return that a run took smaller steps than the scene's, where it did, and what is largest at its start."""
    told = list(largest_at_start(model.scene, run.outputs, model.outputs.units))
    if run.steps_divided > 1:
        step = f"simulation.step = {model.scene.simulation.step:g} s"
        told.append(note(f"{step} is large for this run: it was integrated with 1/{run.steps_divided} of it"))
    return told


@gathered
def difference_remarks(model: Model, off: Off) -> Iterator[Remark]:
    """Return that derivatives are differences of runs, where they are, and how far these may be off."""
    why = why_differences(model)
    if why:
        apart = f"derivatives are differences of runs, {NEAR:g} of a parameter's size apart, because of {why}"
        if not off.share:
            yield note(apart)
            return
        where = f"d {off.output} / d {off.parameter}"
        said = f"{apart}; they are estimated to be off by up to {share_text(off.share)} of the largest ({where})"
        yield note(said) if off.share < DOUBTFUL else warning(f"{said}: compare runs (--set)")
        return
    if model.scene.jumping:
        yield warning(
            f"{', '.join(model.scene.jumping)}: derivatives leave out what a force jumps by where a comparison or a "
            "sign changes; where such a place moves with a parameter they are wrong: write it without a jump (max, "
            "min, tanh), or compare runs (--set)"
        )


@gathered
def run_remarks(model: Model, run: DifferentiatedRun) -> Iterator[Remark]:
    """Return what is to be said of the derivatives of a run."""
    yield note(
        f"derivatives are those of the {model.title} model with its time step; errors of the run are estimated by pgmp "
        "simulate"
    )
    yield from difference_remarks(model, run.off)
    yield from step_remarks(model, run)
    if isinstance(model, LengthLanes):
        yield polynomials_of_lengths(model, False)
    if not why_differences(model) and model.stresses is not None:
        names = ", ".join(stress.name for stress in model.stresses.stresses)
        yield note(
            f"derivatives of stresses ({names}) follow from central differences along the exact derivatives of the "
            "motion; where a largest value changes its place they have a corner"
        )
    yield from contact_remarks(run)


@gathered
def corner_remarks(run: DifferentiatedRun, changes: np.ndarray) -> Iterator[Remark]:
    """Return which largest and smallest values the step does not resolve, where changes of the parameters (n, 1) do
    something else an instant before than an instant after."""
    told = []
    for output, values in run.outputs.items():
        rows = np.array(list(run.derivatives[output].values())) * changes
        for what, sign in (("largest", 1.0), ("smallest", -1.0)):
            at = vertex(values, sign).at
            near = rows[:, max(at - 1, 0) : at + 2]
            if is_sharp(values, at) and np.ptp(near, axis=1).max() > LEAST * np.abs(rows[:, at]).max():
                told.append(f"the {what} {output} at {run.time[at]:.4g} s")
    if told:
        yield warning(
            f"derivatives of {', '.join(told)} are unsure: there is a corner, or a vibration of fewer than 8 steps; "
            "take a smaller simulation.step, or compare runs (--set)"
        )


@gathered
def contact_remarks(run: DifferentiatedRun) -> Iterator[Remark]:
    """Return what is to be said of the end stops that a run meets and leaves."""
    for entry in dict.fromkeys(contact.entry for contact in run.contacts):
        own = [contact for contact in run.contacts if contact.entry == entry]
        nearest = min(own, key=lambda contact: contact.turning)
        times = "once" if len(own) == 1 else f"{len(own)} times"
        yield note(
            f"{entry} is met or left {times}, first at {own[0].time:.5g} s: these instants move with the "
            "parameters, and derivatives hold for changes that leave their number and order as they are; nearest "
            f"to grazing is that at {nearest.time:.5g} s, where the path would turn back within "
            f"{nearest.turning:.2g} s"
        )
