"""The choice of what a scene leaves open, one part of the error after the other.

1. The step, from the full-order model itself (`step_choice`), before anything is reduced. If the tolerance needs a very
   small one, the reduction is chosen with a larger one first, and the search goes on when that was worth while.
2. The reduction, full-order and reduced model run with the same step (`reduction_choice`): the cheapest basis, at more
   angles where few do not suffice, and the fewest angles for it.
3. Where the step became finer than in 2, the reduction is looked at again with it.

Errors are the largest of any output, sample and load of the training (`cases.Training`). Each part may take its share
of the tolerance (`errors.Ledger`).

Of scenes whose lengths, places or ratios are parameters a tolerance is met by runs of one mechanism. What it leaves
open is chosen with the nominal lengths; then the same is asked with nothing left open at both ends of every length, the
others nominal, and together. That all models between them are as good follows from how smooth they are in a length,
which every build measures (`reduction.length_family`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path

import h5py
import numpy as np

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.bench.bench import Bench
from pgmp_petsc.bench.candidates import MOST_CONDENSED, Limits
from pgmp_petsc.bench.cases import Training
from pgmp_petsc.bench.finished import Finished
from pgmp_petsc.bench.history import REDUCTION, Ledger, Trial
from pgmp_petsc.bench.reduction_choice import KNOBS, ReductionChoice
from pgmp_petsc.bench.reference import Demand, Subject, choose_reference, distance_from_mesh
from pgmp_petsc.bench.refusal import refuse
from pgmp_petsc.bench.step_choice import (
    AHEAD,
    EARLY_PER_PERIOD,
    FIRST_PER_PERIOD,
    MOST_ANYWAY,
    SEEN,
    StepChoice,
    first_steps,
)
from pgmp_petsc.bodies.shape import BodyShape, at_lengths
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results.selection import Selection
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.border import own_values, values_text
from pgmp_petsc.scene.numerics import Reduction, Simulation, count_steps
from pgmp_petsc.scene.uses import extremes, length_names, with_numbers

MORE_MODES = 1.5  # of the component model as a reference, for each that bodies of a basis are condensed for
PAYS = 0.8  # of the processor time of a reference sample, from which on a reduced one is no cheaper to speak of
SPARE = 1.0 - REDUCTION  # of the tolerance, for what took no part in the training, and for what the reference is off
FINER = 4  # by how much the step is refined where the reduction has to be looked at again


@dataclass(frozen=True)
class Choice:
    """The settings that were chosen."""

    scene: Scene  # the scene with everything given and without tolerances
    rom: ReducedOrderModel | None  # the reduced model, on the first rank; None elsewhere
    selection: Selection  # for the file

    def write(self, path: Path, *parts: Callable[[h5py.File], None]) -> None:
        """Write the reduced model with what was chosen, and what the parts add; by one process."""
        self.rom.write(path, self.selection.put, *parts)


def leaves_open(scene: Scene) -> bool:
    """Return whether a scene has a tolerance to choose for."""
    return scene.reduction.tolerance is not None or scene.simulation.tolerance is not None


def choose(
    scene: Scene,
    meshes: Mapping[str, BodyShape],
    group: RankGroup,
    say: Callable[[str], None] = lambda text: None,
    finished: Finished | None = None,
) -> Choice:
    """Choose what the tolerances of a scene leave open. Collective on ``group.world``; its groups share an
    eigenproblem.

    What errors are measured against, and what that is predicted to take, goes to `say` before it is run; runs of the
    reference that an earlier run of the program left are in `finished`, where others are kept. Raises `InputError` if a
    tolerance cannot be met, or there is no reference within the budget.
    """
    timings, ledger, training = Timings(), Ledger(), Training.of(scene)
    entry = "reduction.tolerance" if scene.reduction.tolerance is not None else "simulation.tolerance"
    if not scene.outputs:
        raise InputError(f"{entry}: errors are those of outputs, and the scene has none; name some in [outputs]")
    with timings.phase("components"):
        n_modes = modes_to_condense(scene)
        subject = Subject.of(scene, meshes, group, n_modes)
    with timings.phase("selection"), progress(None, "choosing, tried so far", group.world) as bar:
        period = subject.first_period(group)
        reference = choose_reference(
            scene, meshes, subject.kinematics, _demand(scene, training, period, n_modes, entry), group.world
        )
        say(reference.why)
        coarse = min(first_steps(scene.simulation.duration, period)[1], _given_steps(scene) or MOST_ANYWAY)
        reference = distance_from_mesh(reference, meshes, training.values, training.n_samples, coarse, group.world)
        bench = Bench(reference, training, group.world, subject, group, bar, finished)
        step = StepChoice(bench, ledger, period, reference.model.name)
        step.begin()
        if scene.reduction.tolerance is None:
            bench.check_references(step.n_basis, step.loads)
            step.finish({})
            allowed, trial = step.allowed, bench.try_out(scene.reduction, step.n_basis, step.loads)
        else:
            bench.check_references(step.n_basis)
            limits = Limits.of(scene, subject.kinematics, n_modes)
            reduction = ReductionChoice(bench, ledger, limits, step.n_basis, step.allowed)
            say(reduction.price)
            allowed, trial = reduction.allowed, reduction.run()
            step.finish(allowed)
            trial = _at_the_chosen_step(bench, ledger, limits, step, trial)
        if not trial.built:
            raise RunError(trial.reason)
        step.fit_reduced(trial)
        rom = bench.rom_of(trial)
        chosen = _chosen_scene(scene, step, trial, rom)
        found = [*mesh_remark(bench, trial.n_steps), _cost_remark(bench, step, trial)]
        if not step.kept:
            loads = " and ".join(f"'{name}'" for name in step.loads)
            sharper = "for loads with sharper corners, give simulation.tolerance with the run"
            found.insert(0, f"the step was found with {loads}: {sharper}")
    asked = {name: getattr(scene, name).tolerance for name in ("reduction", "simulation")}
    used = step.loads if scene.reduction.tolerance is None else [load.name for load in bench.training.loads]
    selection = Selection(
        tolerances={name: value for name, value in asked.items() if value is not None},
        allowed=allowed,
        chosen=_entries(scene, chosen, kept=False),
        reasons=ledger.reasons,
        kept=_entries(scene, chosen, kept=True),
        attempts=tuple(ledger.attempts),
        outputs=bench.outputs,
        values=own_values(scene, bench.training.values),
        loads={load.name: load.description for load in bench.training.loads if load.name in used},
        remarks=(reference.why, *bench.remarks, *found, *(() if finished is None else map(str, finished.remarks))),
        reference=reference.about,
    )
    if group.world.rank > 0:
        return Choice(chosen, None, selection)
    record = rom.record
    record = replace(record, scene_toml=scene_to_toml(chosen), timings=timings.as_dict() | record.timings)
    return Choice(chosen, replace(rom, record=record), selection)


def modes_to_condense(scene: Scene) -> int:
    """Return for how many modes bodies of cells are condensed: what the scene gives, or as many as are tried."""
    given = scene.reduction.tolerance is None or "modes" in scene.reduction.model_fields_set
    return scene.reduction.modes if given else MOST_CONDENSED


def _given_steps(scene: Scene) -> int:
    """Return the number of steps of a scene that gives its step; 0 where it is to be chosen."""
    simulation = scene.simulation
    given = simulation.tolerance is None or "step" in simulation.model_fields_set
    return count_steps(simulation.duration, simulation.step) if given else 0


def _demand(scene: Scene, training: Training, period: float, n_modes: int, entry: str) -> Demand:
    """Return what the reference has to run, at least: for the step, and under all loads for the reduction."""
    of_step = sum(load.for_step for load in training.loads)
    n_loads, given = (len(training.loads) if scene.reduction.tolerance is not None else of_step), _given_steps(scene)
    if given:
        steps = n_loads * given + (AHEAD * of_step * given if scene.simulation.tolerance is not None else 0)
    else:
        # runs with halved steps, up to the smallest that are tried before the reduction, are together two of these
        early = EARLY_PER_PERIOD // FIRST_PER_PERIOD
        steps = (n_loads * SEEN + 2 * of_step * early) * first_steps(scene.simulation.duration, period)[1]
    cases = f"{training.n_samples} samples under {n_loads} loads"
    cure = "shorten simulation.duration, or let fewer parameters vary"
    tolerance = scene.reduction.tolerance or scene.simulation.tolerance
    n_modes = ceil(MORE_MODES * n_modes)
    return Demand(f"{entry} = {tolerance:g}", float(steps * training.n_samples), cases, cure, n_modes)


def _at_the_chosen_step(bench: Bench, ledger: Ledger, limits: Limits, step: StepChoice, trial: Trial) -> Trial:
    """Return a trial that is also good enough with a step that was found later and is finer than the trial's."""
    tolerance = bench.scene.reduction.tolerance
    allowed = REDUCTION * tolerance
    while trial.n_steps < step.n_steps:
        finest = step.n_finest
        errors = bench.run_again(trial, finest, step.loads)
        ledger.add_trial("basis", KNOBS, replace(trial, n_steps=finest), errors)
        if errors.largest <= allowed:
            break
        n_steps = min(FINER * trial.n_steps, finest)
        if n_steps == trial.n_steps:
            refuse("reduction.tolerance", tolerance, "basis", {"basis": allowed} | step.allowed, ledger, [])
        trial = ReductionChoice(bench, ledger, limits, n_steps, step.allowed).run()
    return trial


def _chosen_scene(scene: Scene, step: StepChoice, trial: Trial, rom: ReducedOrderModel) -> Scene:
    """Return the scene with the chosen entries; its tables are validated anew.

    Where a build took more angles than a candidate had, these are what was chosen: the model was judged with them.
    """
    time = {"tolerance": None} | ({} if step.kept else {"step": step.step})
    kept = {"tolerance": None}
    if scene.reduction.sampling_tolerance is None and rom.tables.n_coordinates == 1:
        kept["angles"] = len(rom.frequencies_hz)
    return scene.model_copy(
        update={
            "reduction": Reduction(**trial.reduction.model_dump() | kept),
            "simulation": Simulation(**scene.simulation.model_dump() | time),
        }
    )


def _entries(scene: Scene, chosen: Scene, kept: bool) -> dict[str, object]:
    """Return the entries that the scene gave (`kept`), or that were chosen, by dotted name."""
    entries = {}
    for table, knobs in (("reduction", KNOBS), ("simulation", ("step",))):
        before = getattr(scene, table)
        if before.tolerance is not None:
            for knob in knobs:
                if (knob in before.model_fields_set) == kept:
                    entries[f"{table}.{knob}"] = getattr(getattr(chosen, table), knob)
    return entries


def mesh_remark(bench: Bench, n_steps: int) -> list[str]:
    """Say what the meshes themselves leave, no part of the tolerance, or how far the reference is from them."""
    errors, apart = bench.finer_meshes(n_steps), bench.reference.from_mesh
    given = (bench.scene.reduction.tolerance, bench.scene.simulation.tolerance)
    tolerance = min(value for value in given if value is not None)
    worst = max(apart, key=apart.__getitem__, default="")
    if apart and apart[worst] > SPARE * tolerance:
        return [
            f"the tolerance holds against the reference, which is itself {apart[worst]:.2g} away from the mesh in "
            f"{worst}, more than {SPARE:g} of the tolerance: against the mesh it may not hold "
            '(reference.model = "mesh")'
        ]
    if errors is None:
        return ["what finer meshes would change is no part of the tolerance, and was not measured"]
    if not np.isfinite(errors.values).any():
        return []
    moved = ", ".join(f"{name} by {error:.2g}" for name, error in zip(bench.outputs, errors.by_output))
    more = "; the meshes leave more than the tolerance" if errors.largest > tolerance else ""
    return [f"no part of the tolerance: cells cut in two would move {moved}{more}"]


def _cost_remark(bench: Bench, step: StepChoice, trial: Trial) -> str:
    """Say what a sample costs with what was chosen, and what the full-order model costs for the same tolerance."""
    reduced, full = bench.processor_times(trial, step.n_steps, step.n_full)
    return cost_text(reduced, step.n_steps, full, step.n_full, bench.full_model.title)


def cost_text(reduced: float, n_reduced: int, full: float, n_full: int, title: str) -> str:
    """Say what a sample of both models costs (s) with so many steps, and where reducing does not pay."""
    said = (
        f"processor time of a sample: {1e3 * reduced:.2g} ms with {n_reduced} steps; of the {title} model "
        f"{1e3 * full:.2g} ms with {n_full} steps"
    )
    if reduced < PAYS * full:
        return said
    return (
        f"{said}: the reduction does not pay here, for that model is small; run samples with it (--full), or take a "
        "larger reduction.tolerance or fewer outputs"
    )


def choose_over_lengths(
    scene: Scene,
    meshes: Mapping[str, BodyShape],
    group: RankGroup,
    say: Callable[[str], None] = lambda text: None,
    finished: Finished | None = None,
) -> Choice:
    """Choose what the tolerances of a scene leave open, with any lengths; see `choose`. Collective on ``group.world``.

    Raises `InputError` or `RunError`, as `choose`; with the lengths at which what was chosen does not keep the
    tolerance.
    """
    names = length_names(scene)
    if not names:
        return choose(scene, meshes, group, say, finished)
    nominal = {name: scene.nominal[name] for name in names}
    at = values_text(scene, nominal)
    say(f"tolerances: what they leave open is chosen at {at}, and checked at the ends of the range")
    found = _chosen_at(scene, nominal, meshes, group, say, finished)
    chosen = scene.model_copy(update={"reduction": found.scene.reduction, "simulation": found.scene.simulation})
    asked, remarks = _asked_again(scene, chosen), []
    for lengths in extremes(scene):
        check = _chosen_at(asked, lengths, meshes, group, lambda text: None, None)
        parts = {attempt.part: attempt.largest for attempt in check.selection.attempts}
        left = ", ".join(f"{part} leaves {size:.2g}" for part, size in parts.items()) or "nothing was left to look at"
        remarks.append(f"at {values_text(scene, lengths)}: {left}")
    selection = replace(found.selection, remarks=(*found.selection.remarks, *remarks))
    return Choice(chosen, build_rom(chosen, meshes, group), selection)


def _chosen_at(
    scene: Scene,
    lengths: Mapping[str, float],
    meshes: Mapping[str, BodyShape],
    group: RankGroup,
    say: Callable[[str], None],
    finished: Finished | None,
) -> Choice:
    """Choose with some lengths, m."""
    shapes = at_lengths(scene.with_values(lengths), meshes)
    try:
        return choose(with_numbers(scene, lengths), shapes, group, say, finished)
    except (InputError, RunError) as error:
        raise type(error)(f"at {values_text(scene, lengths)}: {error}") from error


def _asked_again(scene: Scene, chosen: Scene) -> Scene:
    """Return a scene with its tolerances in which everything is given that was chosen."""
    update: dict[str, Reduction | Simulation] = {"simulation": chosen.simulation}
    of_reduction, of_step = ({"tolerance": table.tolerance} for table in (scene.reduction, scene.simulation))
    if scene.reduction.tolerance is not None:
        update["reduction"] = Reduction(**chosen.reduction.model_dump(exclude_none=True) | of_reduction)
    if scene.simulation.tolerance is not None:
        update["simulation"] = Simulation(**chosen.simulation.model_dump() | of_step)
    return scene.model_copy(update=update)
