"""From result files to pictures: which files belong into which picture."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from matplotlib.figure import Figure

from pgmp_petsc.figures.coordinate_plane import coordinate_path, frequency_maps
from pgmp_petsc.figures.densities import densities
from pgmp_petsc.figures.energies import energies
from pgmp_petsc.figures.frequencies import frequencies
from pgmp_petsc.figures.mechanism import mechanism
from pgmp_petsc.figures.style import save
from pgmp_petsc.figures.tradeoff import mesh_costs, online_costs, total_costs
from pgmp_petsc.figures.trajectories import paired, trajectories
from pgmp_petsc.results import Ensemble, ModesTable, Tradeoff, Trajectory
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import open_file

READERS = {"modes": ModesTable, "trajectory": Trajectory, "ensemble": Ensemble, "tradeoff": Tradeoff}
Pictures = dict[str, Callable[[], Figure]]  # what draws each, by the name of its file without suffix
Result = TypeVar("Result")


def draw(files: Sequence[Path], directory: Path, exaggeration: float = 1.0) -> list[str]:
    """Draw result files into ``directory`` and return the paths written, one line each; by one process only.

    Raises
    ------
    InputError
        If a file is not a result with a picture, or the directory cannot be made or written to.
    """
    # All files are read before any picture is drawn: a bad one is reported at once.
    results: dict[str, list] = {kind: [] for kind in READERS}
    for path in files:
        with open_file(path, READERS) as file:
            kind = str(file.attrs["kind"])
        results[kind].append(READERS[kind].read(path))
    _make(directory)

    runs, ensembles = results["trajectory"], results["ensemble"]
    pictures = {**_of_modes(results["modes"]), **_of_runs(runs, exaggeration)}
    if ensembles:
        in_order = sorted(ensembles, key=lambda ensemble: ensemble.model != "full")
        pictures["densities"] = partial(densities, in_order)
    for study, name in _numbered(results["tradeoff"], "tradeoff"):
        # unlike the others, studies are not comparable: each has its own machine and load
        for suffix, picture in (("", online_costs), ("_total", total_costs), ("_mesh", mesh_costs)):
            pictures[f"{name}{suffix}"] = partial(picture, study)
    for name in pictures:
        check_output(directory / f"{name}.png", "picture", files)
    lines = [str(save(picture(), directory / f"{name}.png")) for name, picture in pictures.items()]
    if runs and "mechanism" not in pictures:
        lines.append("no mechanism.png: no trajectory has frames; use --override simulation.frames=100")
    return lines


def _of_modes(tables: Sequence[ModesTable]) -> Pictures:
    """Return the pictures of tables of modes: maps of those with two coordinates, the others over each other."""
    mapped = [table for table in tables if len(table.coordinate_units) == 2]
    others = [table for table in tables if len(table.coordinate_units) != 2]
    pictures = {name: partial(frequency_maps, table) for table, name in _numbered(mapped, "frequency_maps")}
    return {"frequencies": partial(frequencies, others), **pictures} if others else pictures


def _of_runs(runs: Sequence[Trajectory], exaggeration: float) -> Pictures:
    """Return the pictures of runs: all outputs together; shapes, energies and path of the first run that has them."""
    pictures: Pictures = {"trajectories": partial(trajectories, paired(runs))} if runs else {}
    of_one = {
        "mechanism": (partial(mechanism, exaggeration=exaggeration), lambda run: run.frames is not None),
        "energies": (energies, lambda run: run.balance is not None),
        "coordinate_path": (coordinate_path, lambda run: len(run.coordinate_units) == 2),
    }
    for name, (picture, has) in of_one.items():
        first = next(filter(has, runs), None)
        if first is not None:
            pictures[name] = partial(picture, first)
    return pictures


def _numbered(results: Sequence[Result], name: str) -> list[tuple[Result, str]]:
    """Return results with the names of their pictures, numbered from 1 where there are several."""
    if len(results) == 1:
        return [(results[0], name)]
    return [(result, f"{name}_{number}") for number, result in enumerate(results, start=1)]


def _make(directory: Path) -> None:
    """Make the directory, and check that it can be written to."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output directory '{directory}' cannot be made: {error.strerror}") from error
    if not os.access(directory, os.W_OK | os.X_OK):
        raise InputError(f"output directory '{directory}': no permission to write in it")
