"""``pgmp merge``: shards of an ensemble, joined to what one run gives."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import click
import numpy as np

from pgmp_petsc.cli.ensemble_table import report
from pgmp_petsc.cli.options import files_argument, output_option
from pgmp_petsc.cli.output_form import output_form, say_figures
from pgmp_petsc.cli.report import save, say
from pgmp_petsc.ensemble.shards import Shards
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.shard import read_shard
from pgmp_petsc.results.summary import summary_of
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.claims import claimed, form_of


@click.command()
@files_argument
@output_option
@output_form
@click.pass_context
def merge(context: click.Context, files: tuple[Path, ...], output: Path) -> None:
    """Join all shards of an ensemble (pgmp montecarlo --shard) to the file that one run would have written.

    Exit status 1 if some samples failed.
    """
    comm = context.obj.comm
    context.with_resource(claimed(comm, output, form_of(output, "ensemble"), files))
    with ExitStack() as opened:
        with agreed(comm, "merging"):
            ensemble = _merged(files, output, opened) if comm.rank == 0 else None
        save(context, ensemble, output)
        failed = 0
        if ensemble is not None:
            failed = int(np.sum(ensemble.status != 0))
            say(context, report(ensemble, output))
            say_figures(context, {"file": output, **summary_of(ensemble)})
    if comm.bcast(failed):
        context.exit(1)


def _merged(files: tuple[Path, ...], output: Path, opened: ExitStack) -> Ensemble:
    shards = [opened.enter_context(read_shard(path)) for path in files]
    return Shards(files, shards, output.resolve().parent).described(output)
