"""``pgmp animate``: a run, or a mode of vibration, as a film."""

from __future__ import annotations

import math
from pathlib import Path

import click

from pgmp_petsc.api.films import FIELDS, LARGEST_SCALE, LONGEST, MOST_PICTURES, RATE, animate as animated
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.options import Number, PathName, output_option
from pgmp_petsc.cli.report import quiet
from pgmp_petsc.runtime.errors import InputError


@click.command()
@click.argument("file", type=PathName())
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
    type=Number(*MOST_PICTURES),
    help="Pictures a second.",
)
@quiet
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
    if mode is not None:
        context.obj.start_petsc()
    call = Call(context, output)
    animated(
        file, output, mode=mode, at=_coordinates(places), field=field, scale=scale, seconds=seconds, fps=fps,
        comm=call.arguments["comm"],
    )  # fmt: skip


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
