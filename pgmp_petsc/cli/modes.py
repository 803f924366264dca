"""``pgmp modes``: eigenfrequencies over the configurations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

from pgmp_petsc.api.modes import frequencies
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.options import PathName, Whole, output_option, ranks_per_angle_option, scene_options
from pgmp_petsc.cli.report import output_form, remark_lines
from pgmp_petsc.results.modes import ModesTable
from pgmp_petsc.runtime.errors import Remark

SHOWN = 6
NOTHING = 1e-6  # of a mode's highest frequency


@click.command()
@click.argument("scene", metavar="SCENE", type=PathName())
@output_option
@click.option("--rom", metavar="ROM.h5", type=PathName(), help="Add this model's frequencies.")
@click.option(
    "--angles",
    metavar="N",
    type=Whole(min=2),
    help="Angles of each coordinate; reduction.angles if not given.",
)
@ranks_per_angle_option
@output_form
@scene_options
@click.pass_context
def modes(
    context: click.Context,
    scene: Path,
    output: Path,
    rom: Path | None,
    angles: int | None,
    ranks_per_angle: int,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Compute eigenfrequencies of SCENE over its configurations, full-order and (with --rom) reduced."""
    call = Call(context, output, settings, overrides)
    call.say(frequencies(scene, rom=rom, angles=angles, ranks_per_angle=ranks_per_angle, **call.arguments), report)


def report(table: ModesTable, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the range of every frequency, how far the reduced ones are from it, and all remarks but those said."""
    lines = [
        f"{path}: {len(table.full_hz)} {'angles' if table.theta.ndim == 1 else 'configurations'}",
        "  mode     lowest Hz    highest Hz   reduced, largest difference",
    ]
    for mode in range(min(SHOWN, table.full_hz.shape[1])):
        full = table.full_hz[:, mode]
        line = f"  {mode + 1:4d} {full.min():13.6g} {full.max():13.6g}"
        if table.reduced_hz is not None and mode < table.reduced_hz.shape[1]:
            # a mechanism on a spring has no stiffness at a dead centre: there is nothing to compare with
            some = np.abs(full) > NOTHING * np.max(np.abs(full))
            line += f" {np.max(np.abs(table.reduced_hz[some, mode] / full[some] - 1), initial=0.0):14.2e}"
        lines.append(line)
    return "\n".join([*lines, *remark_lines(table.record, said)])
