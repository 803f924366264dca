"""``pgmp export``: a trajectory for ParaView, a result as a table, or a reduced model for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.api.exports import export_result
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.options import PathName, Whole, output_option, scene_options
from pgmp_petsc.cli.report import quiet
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import is_table
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.seal import BrokenSeal, seal_of

FMU = ".fmu"
XDMF = (".xdmf", ".xmf")


@click.command()
@click.argument("file", type=PathName())
@output_option
@click.option("--fmi", type=Whole(2, 3), help="Version of FMI of an FMU, 2 (default) or 3.")
@scene_options
@quiet
@click.pass_context
def export(
    context: click.Context,
    file: Path,
    output: Path,
    fmi: int | None,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Write the frames of trajectory FILE as XDMF, which ParaView opens; a result's columns as CSV (-o FILE.csv); or a
    reduced model FILE for other programs.

    The XDMF file refers to FILE and copies nothing: keep the two together. CSV has units in its first line.

    A reduced model becomes a folder of C99 (-o model/), or an FMU for co-simulation and model exchange (-o model.fmu).
    """
    suffix = output.suffix.lower()
    if suffix == FMU or (suffix not in XDMF and not is_table(output) and on_root(context.obj.comm, _is_rom, file)):
        # what models need takes a noticeable time, and tables need none of it
        from pgmp_petsc.api.exports import export_model

        Call(context, output)  # what is said of the model is printed
        export_model(file, output, fmi=fmi, parameters=settings, overrides=overrides, comm=context.obj.comm)
        return
    if fmi is not None:
        raise InputError(f"--fmi {fmi} is for FMUs of reduced models, and '{output}' is none; leave it out")
    if settings or overrides:
        raise InputError("--set and --override are for the export of a reduced model; a result is what it is")
    Call(context, output)
    export_result(file, output, comm=context.obj.comm)


def _is_rom(file: Path) -> bool:
    try:
        return seal_of(file).kind == "rom"
    except (OSError, BrokenSeal):
        return False  # the reader of trajectories says what is wrong with it
