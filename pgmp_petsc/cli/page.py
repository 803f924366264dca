"""``pgmp report``: results as one page."""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.cli.options import PathName, files_argument
from pgmp_petsc.cli.report import quiet, say_of_files


@click.command()
@files_argument
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FILE.html",
    type=PathName(),
    help="Page to write; it replaces an older one when it is complete.",
)
@quiet
@click.pass_context
def report(context: click.Context, files: tuple[Path, ...], output: Path) -> None:
    """Write result FILEs as one page that needs no network: for the screen, the phone and the printer.

    FILEs are trajectories, ensembles, trade-off studies, and reduced models, whose choices are a part of the error
    budget. It begins with a verdict in words and has the mechanism as a film, outputs with bands, distributions with
    intervals, which parameters matter, the error budget, the balance of energy, samples that failed, warnings, costs,
    the commands that repeat it, and the data as CSV. What is not known is said.

    Results of different scenes get sections of their own, with the scenes' names.
    """
    from pgmp_petsc.report.page import write_report

    say_of_files(context, files, write_report, output)
