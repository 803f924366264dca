"""Results as films, as pictures and as one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command, numbers_by_name
from pgmp_petsc.api.files import kind_in, stopped_runs
from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of, tell
from pgmp_petsc.api.result import Result, file_of
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.files.claims import check_output
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.results import Trajectory

if TYPE_CHECKING:
    from pgmp_petsc.figures.motion import Motion
    from pgmp_petsc.results.trajectory import ModeShape


FIELDS = ("mises", "deformation", "displacement", "none")
RATE = 20.0
LARGEST_SCALE = 1e9  # that deformations are drawn enlarged by
ENDINGS = (".mp4", ".gif")


@command(
    "animate", "A run or a mode as a film, MP4 or GIF.", 140, petsc="mode",
    result=Argument("A trajectory, or with `mode` a reduced model; or its file.", word="FILE"),
    output=Argument(
        "File to write, NAME.mp4 or NAME.gif; it replaces an older one when it is complete.", "-o --output", "FILE",
        required=True,
    ),
    mode=Argument("Mode K of a reduced model.", word="K", allowed=Range(1)),
    at=Argument(
        "Coordinate (rad, or a length) where the mode is seen. Those at the start where not given.", word="NAME=VALUE",
        allowed="angles (rad), lengths of what slides, by the names of coordinates, such as {'theta': 0.5}",
        read=numbers_by_name("--at", "needed is NAME=VALUE, a coordinate and its value (rad, or a length)"),
    ),
    field=Argument(
        "What the colours are: mises (von Mises stress; of beams in the outermost fibres), deformation, displacement "
        "from the first frame. By default mises, of modes displacement; none where no body deforms.", allowed=FIELDS,
    ),
    scale=Argument(
        "Enlarge the deformation N times; where not given as much as shows it. It is said in the film.", word="N",
        allowed=Range(0.0, LARGEST_SCALE, above=True),
    ),
    seconds=Argument(
        "How long the film takes, s; as long as all frames do where not given.", word="T",
        allowed=Range(0.0, 3600.0, above=True, unit="s"),
    ),
    fps=Argument("Pictures a second.", word="N", allowed=Range(0.5, 120.0)),
    gives="The film.",
)  # fmt: skip
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
    comm: Comm | None = None,
) -> Path:
    """Make a film of `result`: of a trajectory's frames or, with `mode`, of a mode of a reduced model.

    Forces in joints are arrows, where their components along all axes of the ground are outputs.

    It is written as MP4 (-o film.mp4) or GIF (-o film.gif). One rank draws.
    """
    comm = ranks_of(comm) if mode is None else solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        file = file_of(result)
        places = dict(at or {})
    target = Path(output)
    on_root(comm, _check, file, target, mode, places)
    shape = None if mode is None else _shape(file, mode, places, comm)
    for line in on_root(comm, _draw, file, target, shape, field, scale, seconds, fps):
        tell(comm, line)
    return target


def _check(file: Path, output: Path, mode: int | None, at: Mapping[str, float]) -> None:
    """Refuse what cannot become a film, before anything is computed; by one process."""
    if output.suffix.lower() not in ENDINGS:
        raise InputError(f"output file '{output}': a film is named .mp4 or .gif")
    check_output(output, "film", (file,))
    kind = kind_in(file, ("trajectory", "rom", "components", "modes"))
    if kind == "components":
        cure = "simulate it first, and animate the run"
        raise InputError(f"file '{file}' is a component model, which has no modes of the mechanism; {cure}")
    if kind == "modes":
        cure = "the shapes are in a reduced model: pgmp build SCENE -o rom.h5, then pgmp animate rom.h5 --mode K"
        raise InputError(f"file '{file}': a table of modes holds frequencies alone; {cure}")
    if kind == "rom" and mode is None:
        raise InputError(f"file '{file}' is a reduced model; give --mode K for one of its modes, or simulate it first")
    if kind == "trajectory" and mode is not None:
        raise InputError(f"--mode {mode}: for reduced models; '{file}' is a trajectory")
    if at and mode is None:
        raise InputError("--at: for modes (--mode K); a film of a trajectory shows all of its frames")


def _shape(file: Path, mode: int, at: Mapping[str, float], comm: Comm) -> ModeShape:
    """Return a mode of a reduced model. Collective on `comm`."""
    from pgmp_petsc.api.sources import Origin  # takes a noticeable time
    from pgmp_petsc.studies.field_frames import mode_shape

    model = Origin.of(comm, file, None, (), ()).prepared(comm, told=False)
    return on_root(comm, mode_shape, model, mode, at)


def _deforms(run: Trajectory) -> bool:
    """Return whether a body of a run deforms; frames that are not there are refused where they are drawn."""
    return run.frames is None or not set(run.frames.positions) <= set(run.frames.rigid)


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
    from pgmp_petsc.figures.motion import motion_of, vibration_of
    from pgmp_petsc.figures.solids import Pace, write_film  # matplotlib takes a noticeable time

    if shape is None:
        run = Trajectory.read(file)
        motion: Motion = motion_of(run, field or ("mises" if _deforms(run) else "none"), scale)
    else:
        motion = vibration_of(shape, field or "displacement", scale)
    pace = Pace.of(len(motion.captions), fps, seconds)
    n = write_film(motion, output, pace)
    of = f"{n} of {len(motion.captions)} instants" if n < len(motion.captions) else f"{n} pictures"
    enlarged = f", deformation enlarged {motion.scale:g} times" if motion.scale != 1.0 else ""
    notes = (text if text.startswith("warning: ") else f"note: {text}" for text in motion.notes)
    said = [f"{output}: {of}, {pace.seconds:.3g} s{enlarged}", *(f"  {text}" for text in notes)]
    return said if shape is not None else [*said, *stopped_runs(file)]


@command(
    "plot", "Draw result files as pictures.", 130, petsc=False,
    files=Argument("Result files.", word="FILE", allowed="a list of names of files"),
    output=Argument("Directory for the pictures; made if it does not exist.", "-o --output", "DIR", required=True),
    exaggerate=Argument(
        "Enlarge the deformation in the pictures of the mechanism.", word="FACTOR", allowed=Range(1.0, LARGEST_SCALE)
    ),
    at=Argument(
        "Instant of the picture of solids; that of the largest stress if not given.", word="SECONDS",
        allowed=Range(0.0),
    ),
    gives="The folder.",
)  # fmt: skip
def plot(
    files: Sequence[str | PathLike[str]],
    output: str | PathLike[str],
    *,
    exaggerate: float = 1.0,
    at: float | None = None,
    comm: Comm | None = None,
) -> Path:
    """Draw result FILEs: what belongs together goes into one picture.

    Results of different scenes never share a picture: with several, the names of pictures end with those of the
    scenes. Within one, keys tell results apart by what differs: parameters, other entries of the scene, the model,
    the seed, or else the file. Brackets hold confidence intervals.

    Tables of modes become frequencies.png or, with two coordinates, frequency_maps.png. Trajectories become
    trajectories.png (full-order and reduced ones are compared where they are of one case); the first that has
    them gives mechanism.png, energies.png, of solids solids.png (surfaces with von Mises' stress in colour), forces.png
    (of joints, polar), torques.png (of drives over their speed), rainflow.png and, with two coordinates,
    coordinate_path.png. Ensembles become densities.png and, each ensemble by itself, bands.png (outputs over time) and
    sobol.png (which parameters matter), rare events rare_event.png, trade-off studies tradeoff.png,
    tradeoff_total.png and tradeoff_mesh.png.
    """
    comm = ranks_of(comm)
    paths, folder = [Path(file) for file in files], Path(output)

    def drawing_the_pictures() -> list[str]:
        from pgmp_petsc.figures.collection import draw  # matplotlib takes a noticeable time

        return draw(paths, folder, exaggerate, at)

    _tell_of_files(comm, on_root(comm, drawing_the_pictures), paths)
    return folder


@command(
    "report", "Write results as one page that needs no network.", 150, petsc=False,
    results=Argument(
        "Results, or names of their files: trajectories, ensembles, trade-offs, fits and reduced models.", word="FILE",
        allowed="a list of results, or of names of files",
    ),
    path=Argument(
        "Page to write; it replaces an older one when it is complete.", "-o --output", "FILE.html", required=True
    ),
    gives="The page.",
)  # fmt: skip
def write_report(
    results: Sequence[Result | str | PathLike[str]], path: str | PathLike[str], *, comm: Comm | None = None
) -> Path:
    """Write result FILEs as one page that needs no network: for the screen, the phone and the printer.

    FILEs are trajectories, ensembles, trade-off studies, fits, and reduced models, whose choices are a part of the
    error budget. Figures of several ensembles, or of several runs of one model, stand beside each other. It begins
    with a verdict and has the mechanism as a film, outputs with bands, distributions with intervals, which parameters
    matter, the error budget, the balance of energy, samples that failed, warnings, costs, the commands that repeat it,
    and the data as CSV. What is not known is said.

    Results of different scenes get sections of their own, with the scenes' names.

    A page names the files that it is of: what a program holds and was not written yet is written beside it, as
    PAGE_KIND_NUMBER.h5.
    """
    comm = ranks_of(comm)
    path, files = Path(path), []
    for number, result in enumerate(results, 1):
        if not isinstance(result, Result):
            files.append(Path(result))
        else:
            files.append(result.path or result.write(path.with_name(f"{path.stem}_{result.kind}_{number}.h5")))

    def writing_the_page() -> list[str]:
        from pgmp_petsc.report.page import write_report as write

        return write(files, path)

    _tell_of_files(comm, on_root(comm, writing_the_page), files)
    return path


def _tell_of_files(comm: Comm, lines: Sequence[str], files: Sequence[Path]) -> None:
    """Tell what was made, and of which files only a part could be shown. Collective on `comm`."""
    for line in (*lines, *on_root(comm, stopped_runs, *files)):
        tell(comm, line)
