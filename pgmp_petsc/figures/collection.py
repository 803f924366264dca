"""From result files to pictures: which files belong into which picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from pgmp_petsc.figures.densities import densities
from pgmp_petsc.figures.frequencies import frequencies
from pgmp_petsc.figures.mechanism import mechanism
from pgmp_petsc.figures.style import save
from pgmp_petsc.figures.tradeoff import mesh_costs, online_costs, total_costs
from pgmp_petsc.figures.trajectories import paired, trajectories
from pgmp_petsc.results import Ensemble, ModesTable, Tradeoff, Trajectory
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import open_file

READERS = {"modes": ModesTable, "trajectory": Trajectory, "ensemble": Ensemble, "tradeoff": Tradeoff}


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

    written = []
    if results["modes"]:
        written.append(save(frequencies(results["modes"]), directory / "frequencies.png"))
    runs = results["trajectory"]
    if runs:
        written.append(save(trajectories(paired(runs)), directory / "trajectories.png"))
        with_frames = [run for run in runs if run.frames is not None]
        if with_frames:
            figure = mechanism(with_frames[0], exaggeration=exaggeration)
            written.append(save(figure, directory / "mechanism.png"))
    if results["ensemble"]:
        in_order = sorted(results["ensemble"], key=lambda ensemble: ensemble.model != "full")
        written.append(save(densities(in_order), directory / "densities.png"))
    for number, study in enumerate(results["tradeoff"], start=1):
        # unlike the others, studies are not comparable: each has its own machine and load
        name = "tradeoff" if len(results["tradeoff"]) == 1 else f"tradeoff_{number}"
        for suffix, picture in (("", online_costs), ("_total", total_costs), ("_mesh", mesh_costs)):
            written.append(save(picture(study), directory / f"{name}{suffix}.png"))
    lines = [str(path) for path in written]
    if runs and not with_frames:
        lines.append("no mechanism.png: no trajectory has frames; use --override simulation.frames=100")
    return lines


def _make(directory: Path) -> None:
    """Make the directory, and check that it can be written to."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output directory '{directory}' cannot be made: {error.strerror}") from error
    if not os.access(directory, os.W_OK | os.X_OK):
        raise InputError(f"output directory '{directory}': no permission to write in it")
