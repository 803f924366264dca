"""``pgmp export``: a trajectory for ParaView."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.cli.options import output_option
from pgmp_petsc.cli.report import say, stopped_runs
from pgmp_petsc.runtime.agreement import on_root


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@output_option
@click.pass_context
def export(context: click.Context, file: Path, output: Path) -> None:
    """Write the frames of trajectory FILE as XDMF, which ParaView opens.

    The XDMF file refers to FILE and copies nothing: keep the two together.
    """
    from pgmp_petsc.export.xdmf import write_xdmf

    n_frames = on_root(context.obj.comm, write_xdmf, file, output)
    say(context, f"{output}: {n_frames} frames, stored in {file}")
    for line in on_root(context.obj.comm, stopped_runs, file):
        say(context, line)
