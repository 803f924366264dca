"""``pgmp build``: the offline build of a reduced model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pgmp_petsc.api.modes import build as built
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.options import PathName, output_option, ranks_per_angle_option, scene_options
from pgmp_petsc.cli.report import output_form, remark_lines
from pgmp_petsc.runtime.errors import Remark

if TYPE_CHECKING:
    from pgmp_petsc.reduction.rom import ReducedOrderModel
    from pgmp_petsc.studies.building import Built


@click.command()
@click.argument("scene", metavar="SCENE", type=PathName())
@output_option
@ranks_per_angle_option
@click.option("--resume", is_flag=True, help="Take up a build of the same file that was stopped.")
@output_form
@scene_options
@click.pass_context
def build(
    context: click.Context,
    scene: Path,
    output: Path,
    ranks_per_angle: int,
    resume: bool,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Compute modes at the sampled configurations of SCENE and write the reduced model (ROM.h5).

    With reduction.tolerance, or simulation.tolerance, what SCENE does not give is chosen so that no output has a larger
    error; all that was tried is kept in the file. With reduction.effects = "auto" effects too small to matter are left
    out, and terms of the reduced model that do are added; the estimate is printed and kept too. Otherwise what SCENE
    leaves out although it matters is said, as in pgmp check --effects.

    Finished bodies and configurations are kept in ROM.h5.partial until the file is written; --resume takes them up,
    with any number of ranks. With a tolerance it is the runs that errors are measured against.
    """
    call = Call(context, output, settings, overrides)
    made = built(scene, ranks_per_angle=ranks_per_angle, resume=resume, **call.arguments)
    call.say(made, all_of)


def all_of(made: Built, path: Path, said: Sequence[Remark] = ()) -> str:
    """Say what was built, what is doubtful about it, and what was chosen for tolerances."""
    chosen = [] if made.selection is None else made.selection.lines(attempts=False)
    return "\n".join([report(made.rom, path, said), *chosen])


def report(rom: ReducedOrderModel, path: Path, said: Sequence[Remark] = ()) -> str:
    """Say what was built, and what is doubtful about it."""
    tables = rom.tables
    lines = [
        f"{path}: {len(rom.frequencies_hz)} {'angles' if tables.n_coordinates == 1 else 'configurations'}, "
        f"{rom.frequencies_hz.shape[1]} modes from {rom.frequencies_hz[:, 0].min():.4g} to "
        f"{rom.frequencies_hz[:, -1].max():.4g} Hz{beside_modes(rom)}",
        *points_report(rom),
        f"  tables: {tables.mass.shape[1]} mass, {tables.stiffness.shape[1]} stiffness and "
        f"{tables.load.shape[1]} load terms",
        f"  neighbouring spaces of modes agree to a cosine of {rom.cosines.min():.6f}",
    ]
    if tables.samples.n > len(rom.frequencies_hz):
        lines.append("  one mode changes its sign after a turn: the tables cover two turns")
    lines += remark_lines(rom.record, said)
    lines += [f"  {phase:14s}{seconds:8.2f} s" for phase, seconds in rom.record.timings.items()]
    return "\n".join(lines)


def beside_modes(rom: ReducedOrderModel) -> str:
    """Name what a basis has besides modes."""
    n_parameter = rom.n_parameter
    n_static = rom.tables.n_modes - rom.frequencies_hz.shape[1] - n_parameter
    return (f", {n_static} static" if n_static else "") + (
        f", {n_parameter} of other parameters" if n_parameter else ""
    )


def points_report(rom: ReducedOrderModel) -> list[str]:
    """Say where in the parameter space the basis has further modes."""
    if not rom.n_parameter:
        return []
    places = "; ".join(
        ", ".join(f"{name} = {value:.4g}" for name, value in point.items()) for point in rom.points.points
    )
    first, last = rom.points.missed[[0, -1]]
    return [
        f"  modes at other parameters: {places}",
        f"  at the worst parameters tried, the basis misses {last:.2g} of the modes' energy norm instead of "
        f"{first:.2g}",
    ]
