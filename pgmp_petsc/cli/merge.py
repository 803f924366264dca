"""``pgmp merge``: shards of an ensemble, joined to what one run gives."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.api.ensembles import merge as merged
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.ensemble_table import report
from pgmp_petsc.cli.options import files_argument, output_option
from pgmp_petsc.cli.report import output_form


@click.command()
@files_argument
@output_option
@output_form
@click.pass_context
def merge(context: click.Context, files: tuple[Path, ...], output: Path) -> None:
    """Join all shards of an ensemble (pgmp montecarlo --shard) to the file that one run would have written.

    Exit status 1 if some samples failed.
    """
    call = Call(context, output)
    found = merged(files, **call.arguments)
    call.say(found, report)
    if context.obj.comm.bcast(found.data is not None and bool(found.status.any())):
        context.exit(1)
