"""From result files to pictures: which files belong into which picture."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from matplotlib.figure import Figure

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures.ensembles import bands, densities, joined, rare_event, sobol, stopping
from pgmp_petsc.figures.ensembles import labels_of as densities_labels
from pgmp_petsc.figures.mechanism import mechanism
from pgmp_petsc.figures.solids import frame_at, has_solids, solids
from pgmp_petsc.figures.studies import (
    coordinate_path,
    frequencies,
    frequency_maps,
    mesh_costs,
    online_costs,
    total_costs,
)
from pgmp_petsc.figures.studies import labels_of as tables_labels
from pgmp_petsc.figures.style import MODELS, letters_lacking, read_scenes, save, scene_name, tell_apart
from pgmp_petsc.figures.trajectories import (
    DIAGRAMS,
    design,
    energies,
    fit,
    labels_of,
    loads,
    paired,
    sensitivities,
    trajectories,
)
from pgmp_petsc.files.claims import check_folder, check_output
from pgmp_petsc.results import READERS, Derivatives, Design, Ensemble, Fit, ModesTable, Tradeoff, Trajectory
from pgmp_petsc.results.ensemble import RareEvent

# kinds whose results have a picture each
ALONE: dict[type, tuple[str, Callable[..., Figure]]] = {
    Derivatives: ("sensitivities", sensitivities),
    Fit: ("fit", fit),
    Design: ("design", design),
    RareEvent: ("rare_event", rare_event),
}
Pictures = dict[str, Callable[[], Figure]]  # what draws each, by the name of its file without suffix
Result = TypeVar("Result", ModesTable, Trajectory, Ensemble, Tradeoff, Derivatives, Fit, Design, RareEvent)
Sourced = list[tuple[Path, Result]]  # results and the files that they come from


def draw(files: Sequence[Path], directory: Path, exaggeration: float = 1.0, at: float | None = None) -> list[str]:
    """Draw result files into ``directory`` and return the paths written, one line each; by one process only.

    Results of different mechanisms are never in one picture: the pictures' names then end with those of the scenes.
    What tells results in one picture apart is in its keys. What is left out is said in a line. Raises `InputError` if a
    file is not a result with a picture, the directory cannot be made or written to, or nothing can be drawn; `RunError`
    if the system fails to write.
    """
    # All files are read before any picture is drawn: a bad one is reported at once.
    scenes, lines = read_scenes(files, READERS, "drawn")
    _make(directory)
    pictures: dict[Path, Callable[[], Figure]] = {}
    for results, ending in zip(scenes, _endings([found[0][1] for found in scenes])):
        of_scene, notes = _of_scene([(path, result) for path, result, _ in results], exaggeration, at)
        pictures |= {directory / f"{name}{ending}.png": picture for name, picture in of_scene.items()}
        lines += [note.replace(".png", f"{ending}.png") for note in notes]
    for target in pictures:
        check_output(target, "picture", files)
    drawn, failures = [], []
    with letters_lacking() as lacking:
        for target, picture in pictures.items():
            try:
                drawn.append(str(save(picture(), target)))
            except InputError as error:
                failures.append(f"no {target.name}: {error}")
    if not drawn:
        raise InputError("; ".join(failures))
    return [*drawn, *failures, *lines, *lacking]


def pictures_of(result: Result, path: Path, exaggeration: float, at: float | None) -> Pictures:
    """Return what draws each picture of one result, by its name; empty of what has none. `path` names it in keys."""
    return _of_scene([(path, result)], exaggeration, at)[0]


def draw_result(result: Result, directory: Path) -> str:
    """Draw a result that has one picture into ``directory``; by one process only. Return its path, and a line on what
    it lacks. Raises `InputError` if the directory cannot be made or written to; `RunError` if the system fails to
    write."""
    _make(directory)
    name, picture = ALONE[type(result)]
    with letters_lacking() as lacking:
        path = save(picture(result), check_output(directory / f"{name}.png", "picture"))
    return "\n".join([str(path), *lacking])


def _of_scene(results: Sourced, exaggeration: float, at: float | None) -> tuple[Pictures, list[str]]:
    tables, runs, ensembles, studies = (
        [(path, result) for path, result in results if isinstance(result, kind)]
        for kind in (ModesTable, Trajectory, Ensemble, Tradeoff)
    )
    of_runs, notes = _of_runs(runs, exaggeration, at)
    of_ensembles, left_out = _of_ensembles(ensembles)
    pictures, notes = {**_of_modes(tables), **of_runs, **of_ensembles}, notes + left_out
    for study, name in _numbered([study for _, study in studies], "tradeoff"):
        # unlike the others, studies are not comparable: each has its own machine and load
        for suffix, picture in (("", online_costs), ("_total", total_costs), ("_mesh", mesh_costs)):
            pictures[f"{name}{suffix}"] = partial(picture, study)
    for kind, (title, picture) in ALONE.items():
        of_kind = [(path, result) for path, result in results if isinstance(result, kind)]
        labels = tell_apart([result.record for _, result in of_kind], files=[path for path, _ in of_kind])
        for label, (result, name) in zip(labels, _numbered([result for _, result in of_kind], title)):
            pictures[name] = partial(picture, result, label=label)
    return pictures, notes


def _of_ensembles(ensembles: Sourced) -> tuple[Pictures, list[str]]:
    """Return the pictures of ensembles: densities of all together, what else is known of each by itself."""
    if not ensembles:
        return {}, []
    in_order = sorted(ensembles, key=lambda found: tuple(MODELS).index(found[1].model))
    found = [ensemble for _, ensemble in in_order]
    labels = densities_labels(found, [path for path, _ in in_order])
    pictures: Pictures = {"densities": partial(densities, found, labels)}
    of_each = {
        "bands": (bands, lambda ensemble: any(band.count for band in ensemble.bands.values())),
        "sobol": (sobol, lambda ensemble: bool(ensemble.sobol)),
        "joined": (
            joined,
            lambda one: one.joined and any("mean" in of.figures for of in one.joined.corrected.values()),
        ),
        "stopping": (stopping, lambda ensemble: ensemble.stopping is not None and bool(ensemble.stopping.rules)),
    }
    for title, (picture, has) in of_each.items():
        having = [(ensemble, label) for ensemble, label in zip(found, labels) if has(ensemble)]
        for (ensemble, label), name in _numbered(having, title):
            pictures[name] = partial(picture, ensemble, label=label)
    shown = [{*ensemble.parameters, *ensemble.outputs} & set(ensemble.statistics) for ensemble in found]
    return pictures, _left_out("densities", shown)


def _of_modes(tables: Sourced) -> Pictures:
    """Return the pictures of tables of modes: maps of those with two coordinates, the others over each other."""
    if not tables:
        return {}
    files, found = [path for path, _ in tables], [table for _, table in tables]
    labels = tables_labels(found, files)
    # all have the coordinates of their scene
    if len(found[0].coordinate_units) != 2:
        return {"frequencies": partial(frequencies, found, labels=labels)}
    numbered = zip(_numbered(found, "frequency_maps"), labels)
    return {name: partial(frequency_maps, table, label=label) for (table, name), label in numbered}


def _of_runs(runs: Sourced, exaggeration: float, at: float | None) -> tuple[Pictures, list[str]]:
    """Return the pictures of runs: all outputs together; shapes, energies and path of the first run that has them.

    Lines say which run that is where there are several, and what is left out.
    """
    if not runs:
        asked = {"--at": at is not None, "--exaggerate": exaggeration != 1.0}
        return {}, [f"{option}: without effect, as there is no trajectory" for option, given in asked.items() if given]
    files, found = {id(run): path for path, run in runs}, [run for _, run in runs]
    comparisons = paired(found)
    pictures: Pictures = {"trajectories": partial(trajectories, comparisons, labels=labels_of(comparisons, files))}
    label_of: dict[int, str] = {}  # what tells runs of one model from each other
    for model in MODELS:
        chosen = [run for run in found if run.model == model]
        told = tell_apart([run.record for run in chosen], files=[files[id(run)] for run in chosen])
        label_of |= dict(zip(map(id, chosen), told))
    of_one = {
        "mechanism": (partial(mechanism, exaggeration=exaggeration), lambda run: run.frames is not None),
        "solids": (partial(solids, at=at, exaggeration=exaggeration), has_solids),
        "energies": (energies, lambda run: run.balance is not None and not run.rests),
        **{kind: (partial(loads, kind=kind), diagram.of) for kind, diagram in DIAGRAMS.items()},
        "coordinate_path": (coordinate_path, lambda run: len(run.coordinate_units) == 2),
    }
    notes = _left_out("trajectories", [set(run.outputs) for run in found])
    first_of: dict[int, list[str]] = {}
    for name, (picture, has) in of_one.items():
        having = list(filter(has, found))
        if name == "solids" and having and at is not None:
            frame_at(having[0], at)  # outside the run no picture is drawn at all
        if having:
            pictures[name] = partial(picture, having[0], label=label_of[id(having[0])])
        if len(having) > 1:
            first_of.setdefault(id(having[0]), []).append(f"{name}.png")
    for run, names in first_of.items():
        notes.append(f"{', '.join(names)}: of {files[run]} alone, the first run that has what they show")
    if at is not None and "solids" not in pictures:
        notes.append(f"--at {at:g}: without effect, as no trajectory has bodies of solids in its frames")
    if "energies" not in pictures and any(run.rests for run in found):
        notes.append("no energies.png: the mechanism rests, and energies are of round-off alone")
    if "mechanism" not in pictures:
        notes.append("no mechanism.png: no trajectory has frames; use --override simulation.frames=100")
    return pictures, notes


def _left_out(name: str, quantities: Sequence[set[str]]) -> list[str]:
    """Return a line on the quantities that some results lack and that are therefore not drawn."""
    lacking = sorted(set.union(*quantities) - set.intersection(*quantities))
    return [f"{name}.png is without {', '.join(lacking)}: not every file has it"] if lacking else []


def _endings(results: Sequence[Result]) -> list[str]:
    """Return what the pictures' names end with: nothing for one scene, else its name, numbered where it comes again."""
    if len(results) == 1:
        return [""]
    names = [re.sub(r"[^\w-]+", "_", scene_name(result.record)).strip("_") or "unnamed" for result in results]
    several = {name for name, count in Counter(names).items() if count > 1}
    return [f"_{name}_{1 + names[:k].count(name)}" if name in several else f"_{name}" for k, name in enumerate(names)]


def _numbered(results: Sequence[Result], name: str) -> list[tuple[Result, str]]:
    """Return results with the names of their pictures, numbered from 1 where there are several."""
    if len(results) == 1:
        return [(results[0], name)]
    return [(result, f"{name}_{number}") for number, result in enumerate(results, start=1)]


def _make(directory: Path) -> None:
    """Make the directory, after checking that it can be made and written to."""
    try:
        check_folder(directory)
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output directory '{directory}' cannot be made: {error.strerror}") from error
