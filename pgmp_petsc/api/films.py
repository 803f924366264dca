"""Runs, and modes of vibration, of a program as films.

Results of a program as one page.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import checked, wrong
from pgmp_petsc.api.files import stopped_runs
from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of, tell
from pgmp_petsc.api.result import Result, file_of
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import open_file

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.figures.motion import Motion
    from pgmp_petsc.results.modes import ModeShape


FIELDS = ("mises", "deformation", "displacement", "none")
RATE = 20.0
MOST_PICTURES = (0.5, 120.0)  # a second
LONGEST = 3600.0  # s
LARGEST_SCALE = 1e9  # that deformations are drawn enlarged by
ENDINGS = (".mp4", ".gif")


@checked
def animate(
    result: Result | str | PathLike[str],
    output: str | PathLike[str],
    *,
    mode: int | None = None,
    at: Mapping[str, float] | None = None,
    field: str | None = None,
    scale: float | None = None,
    seconds: float | None = None,
    fps: float = RATE,
    comm: MPI.Comm | None = None,
) -> Path:
    """Make a film of a trajectory's frames, or of a mode of a reduced model, and return where; as ``pgmp animate``.

    One rank draws. Collective on `comm`.

    Parameters
    ----------
    result
        A trajectory, or with `mode` a reduced model; or its file.
    output
        ``NAME.mp4`` or ``NAME.gif``.
    mode, at
        Number of the mode, from 1, and coordinates (rad) of its configuration, those at the start where not given.
    field
        What the colours are: ``mises``, ``deformation``, ``displacement`` or ``none``; by default ``mises``, of modes
        ``displacement``.
    scale
        Enlarges the deformation; where not given as much as shows it.
    seconds, fps
        How long the film takes, s, as long as all frames do where not given; pictures a second.

    Raises
    ------
    InputError
        If the result cannot become a film, or that cannot be made there.
    RunError
        If the system fails to write.
    """
    comm = ranks_of(comm) if mode is None else solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        file = file_of(result)
        if field is not None and field not in FIELDS:
            raise InputError(f"field = {field!r}: allowed are {', '.join(FIELDS)}")
        _check_numbers(scale, seconds, fps)
        places = _angles(at or {})
    target = Path(output)
    on_root(comm, _check, file, target, mode, places)
    shape = None if mode is None else _shape(file, mode, places, comm)
    for line in on_root(comm, _draw, file, target, shape, field, scale, seconds, fps):
        tell(comm, line)
    return target


def _check_numbers(scale: float | None, seconds: float | None, fps: float) -> None:
    least, most = MOST_PICTURES
    for name, value, fine, allowed in (
        ("scale", scale, lambda x: 0.0 < x <= LARGEST_SCALE, f"above 0 and at most {LARGEST_SCALE:g}"),
        ("seconds", seconds, lambda x: 0.0 < x <= LONGEST, f"above 0 and at most {LONGEST:g} s"),
        ("fps", fps, lambda x: least <= x <= most, f"from {least:g} to {most:g}"),
    ):
        if value is not None and not fine(value):
            raise InputError(f"{name} = {value!r}: allowed are numbers {allowed}")


def _angles(at: Mapping[str, float]) -> dict[str, float]:
    """Return the coordinates of a configuration."""
    for name, angle in at.items():
        if isinstance(angle, bool) or not isinstance(angle, (int, float)) or not math.isfinite(angle):
            raise InputError(f"at[{name!r}] = {angle!r}: allowed is an angle (rad), a finite number")
    return {str(name): float(angle) for name, angle in at.items()}


def _check(file: Path, output: Path, mode: int | None, at: Mapping[str, float]) -> None:
    """Refuse what cannot become a film, before anything is computed; by one process."""
    if output.suffix.lower() not in ENDINGS:
        raise InputError(f"output file '{output}': a film is named .mp4 or .gif")
    check_output(output, "film", (file,))
    with open_file(file, ("trajectory", "rom", "modes")) as opened:
        kind = str(opened.attrs["kind"])
    if kind == "modes":
        raise InputError(
            f"file '{file}': a table of modes holds frequencies alone; the shapes are in a reduced model: pgmp build "
            "SCENE -o rom.h5, then pgmp animate rom.h5 --mode K"
        )
    if kind == "rom" and mode is None:
        raise InputError(f"file '{file}' is a reduced model; give --mode K for one of its modes, or simulate it first")
    if kind == "trajectory" and mode is not None:
        raise InputError(f"--mode {mode}: for reduced models; '{file}' is a trajectory")
    if at and mode is None:
        raise InputError("--at: for modes (--mode K); a film of a trajectory shows all of its frames")


def _shape(file: Path, mode: int, at: Mapping[str, float], comm: MPI.Comm) -> ModeShape:
    """Return a mode of a reduced model. Collective on `comm`."""
    from pgmp_petsc.models import ReducedModel  # takes a noticeable time
    from pgmp_petsc.studies.inputs import read_rom
    from pgmp_petsc.studies.mode_shapes import mode_shape

    scene, rom = read_rom(file, (), (), comm)
    return on_root(comm, lambda: mode_shape(ReducedModel(scene, rom), mode, at))


def _draw(
    file: Path,
    output: Path,
    shape: ModeShape | None,
    field: str | None,
    scale: float | None,
    seconds: float | None,
    fps: float,
) -> list[str]:
    """Write the film and return what is to be said of it; by one process."""
    from pgmp_petsc.figures.films import Pace, write_film  # matplotlib takes a noticeable time
    from pgmp_petsc.figures.motion import motion_of, vibration_of
    from pgmp_petsc.results import Trajectory

    if shape is None:
        motion: Motion = motion_of(Trajectory.read(file), field or "mises", scale)
    else:
        motion = vibration_of(shape, field or "displacement", scale)
    pace = Pace.of(len(motion.captions), fps, seconds)
    n = write_film(motion, output, pace)
    of = f"{n} of {len(motion.captions)} instants" if n < len(motion.captions) else f"{n} pictures"
    enlarged = f", deformation enlarged {motion.scale:g} times" if motion.scale != 1.0 else ""
    said = [f"{output}: {of}, {pace.seconds:.3g} s{enlarged}", *map(_indented, motion.notes)]
    return said if shape is not None else [*said, *stopped_runs(file)]


def _indented(text: str) -> str:
    """Return what the film has under its title as a line; warnings of its run say that they are."""
    return f"  {text}" if text.startswith("warning: ") else f"  note: {text}"


@checked
def write_report(
    results: Sequence[Result | str | PathLike[str]], path: str | PathLike[str], *, comm: MPI.Comm | None = None
) -> Path:
    """Write results as one page that needs no network, as ``pgmp report``, and return its path. Collective on `comm`.

    Parameters
    ----------
    results
        Results, or names of their files: trajectories, ensembles, trade-off studies and reduced models. A page names
        the files that it is of: results that were not written are written beside it, as
        ``<page>_<kind>_<number>.h5``.
    path
        The page.

    Raises
    ------
    InputError
        If one of them is none that a page shows, or the page cannot be made there.
    RunError
        If the system fails to write.
    """
    comm = ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        if not results:
            raise wrong("results", results, "a list of results or of names of files, and not an empty one")
    path, files = Path(path), []
    for number, result in enumerate(results, 1):
        if not isinstance(result, Result):
            files.append(Path(result))
        else:
            files.append(result.path or result.write(path.with_name(f"{path.stem}_{result.kind}_{number}.h5")))

    def writing_the_page() -> list[str]:
        from pgmp_petsc.report.page import write_report as write

        return write(files, path)

    for line in on_root(comm, writing_the_page):
        tell(comm, line)
    return path
