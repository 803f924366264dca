"""``pgmp animate``: a run, or a mode of vibration, as a film."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pgmp_petsc.cli.options import LARGEST_SCALE, Number, output_option
from pgmp_petsc.cli.report import say, stopped_runs
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import open_file

if TYPE_CHECKING:
    from pgmp_petsc.figures.motion import Motion
    from pgmp_petsc.results.mode_shape import ModeShape

FIELDS = ("mises", "deformation", "displacement", "none")
RATE = 20.0
LONGEST = 3600.0  # s
ENDINGS = (".mp4", ".gif")


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@output_option
@click.option(
    "--field",
    type=click.Choice(FIELDS),
    help="What the colours are: mises (von Mises stress; of beams in the outermost fibres), deformation, displacement "
    "from the first frame. By default mises, of modes displacement.",
)
@click.option(
    "--scale",
    metavar="N",
    type=Number(min=0.0, max=LARGEST_SCALE, min_open=True),
    help="Enlarge the deformation N times; where not given as much as shows it. It is said in the film.",
)
@click.option("--mode", metavar="K", type=int, help="Mode K of a reduced model, from 1.")
@click.option(
    "--at",
    "places",
    multiple=True,
    metavar="NAME=VALUE",
    help="Coordinate (rad) of the configuration of the mode; repeatable. Those at the start where not given.",
)
@click.option(
    "--seconds",
    metavar="T",
    type=Number(min=0.0, max=LONGEST, min_open=True),
    help="How long the film takes; as long as all frames do where not given.",
)
@click.option(
    "--fps",
    default=RATE,
    show_default=True,
    metavar="N",
    type=Number(min=0.5, max=120.0),
    help="Pictures a second.",
)
@click.pass_context
def animate(
    context: click.Context,
    file: Path,
    output: Path,
    field: str | None,
    scale: float | None,
    mode: int | None,
    places: tuple[str, ...],
    seconds: float | None,
    fps: float,
) -> None:
    """Make a film of FILE: of a trajectory's frames or, with --mode, of a mode of a reduced model.

    It is written as MP4 (-o film.mp4) or GIF (-o film.gif). One rank draws.
    """
    comm = context.obj.comm
    on_root(comm, _check, file, output, mode, places)
    shape = None
    if mode is not None:
        context.obj.start_petsc()
        shape = _shape(context, file, mode, places)
    lines = on_root(comm, _draw, file, output, shape, field, scale, seconds, fps)
    for line in lines:
        say(context, line)


def _check(file: Path, output: Path, mode: int | None, places: tuple[str, ...]) -> None:
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
    if places and mode is None:
        raise InputError("--at: for modes (--mode K); a film of a trajectory shows all of its frames")


def _shape(context: click.Context, file: Path, mode: int, places: tuple[str, ...]) -> ModeShape:
    """Return a mode of a reduced model. Collective on the command's ranks."""
    from pgmp_petsc.models import ReducedModel  # PETSc comes with it
    from pgmp_petsc.studies.inputs import read_rom
    from pgmp_petsc.studies.mode_shapes import mode_shape

    comm = context.obj.comm
    at = on_root(comm, _coordinates, places)
    scene, rom = read_rom(file, (), (), comm)
    return on_root(comm, lambda: mode_shape(ReducedModel(scene, rom), mode, at))


def _coordinates(places: tuple[str, ...]) -> dict[str, float]:
    """Return the coordinates that ``--at`` gives."""
    found: dict[str, float] = {}
    for place in places:
        name, _, value = (word.strip() for word in place.partition("="))
        try:
            angle = float(value)
        except ValueError:
            angle = math.nan
        if not math.isfinite(angle):
            raise InputError(f"--at {place}: needed is NAME=VALUE, a coordinate and its angle (rad)")
        if name in found:
            raise InputError(f"--at {place}: '{name}' is there twice; give it once")
        found[name] = angle
    return found


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
