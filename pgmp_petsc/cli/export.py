"""``pgmp export``: a trajectory for ParaView, a result as a table, or a reduced model for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.cli.options import Whole, output_option, scene_options
from pgmp_petsc.cli.report import say, stopped_runs
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import KINDS, TABLE, TABULAR, check_output, is_table, named
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.seal import BrokenSeal, seal_of

FMU = ".fmu"
XDMF = (".xdmf", ".xmf")


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@output_option
@click.option("--fmi", type=Whole(2, 3), help="Version of FMI of an FMU, 2 (default) or 3.")
@scene_options
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
        from pgmp_petsc.cli.calls import Call

        Call(context, output)  # what is said of the model is printed
        export_model(file, output, fmi=fmi, parameters=settings, overrides=overrides, comm=context.obj.comm)
        return
    if fmi is not None:
        raise InputError(f"--fmi {fmi} is for FMUs of reduced models, and '{output}' is none; leave it out")
    if settings or overrides:
        raise InputError("--set and --override are for the export of a reduced model; a result is what it is")
    if is_table(output):
        rows, columns = on_root(context.obj.comm, _write_table, file, output)
        say(context, f"{output}: {rows} rows, {columns} columns, with their units in the first line")
        return
    from pgmp_petsc.export.xdmf import write_xdmf

    n_frames = on_root(context.obj.comm, write_xdmf, file, output)
    say(context, f"{output}: {n_frames} frames, stored in {file}")
    for line in (*on_root(context.obj.comm, _truncated, file), *on_root(context.obj.comm, stopped_runs, file)):
        say(context, line)


def _write_table(file: Path, output: Path) -> tuple[int, int]:
    """Write the columns of a result; return the numbers of rows and columns. By one process."""
    from pgmp_petsc.results.readers import READERS
    from pgmp_petsc.results.tables import columns_of, write_result
    from pgmp_petsc.runtime.files import open_file

    with open_file(file, KINDS) as opened:
        kind = str(opened.attrs["kind"])
    if kind not in TABULAR:
        known = ", ".join(named(one) for one in TABULAR)
        raise InputError(
            f"output '{output}': {named(kind)} ('{file}') has no rows and columns; a table can be made of {known}; "
            f"'pgmp info {file} --json' has its figures"
        )
    result = READERS[kind].read(file)
    check_output(output, TABLE, (file,))
    write_result(result, output)
    columns = columns_of(result)
    return len(next(iter(columns.values()))[1]), len(columns)


def _truncated(file: Path) -> list[str]:
    """Return what the stresses of a reduced run lack; by one process."""
    from pgmp_petsc.results.body_fields import GROUP, truncated
    from pgmp_petsc.runtime.files import open_file

    with open_file(file, "trajectory") as opened:
        reduced, scene = str(opened.attrs["model"]) == "reduced", str(opened.attrs["scene"])
        lacking = truncated(scene) if reduced and GROUP in opened else ""
    return [f"  note: {lacking}"] if lacking else []


def _is_rom(file: Path) -> bool:
    try:
        return seal_of(file).kind == "rom"
    except (OSError, BrokenSeal):
        return False  # the reader of trajectories says what is wrong with it
