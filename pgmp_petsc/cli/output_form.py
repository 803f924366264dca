"""What a command writes on standard output: words, nothing, or its figures as JSON and nothing else."""

from __future__ import annotations

from collections.abc import Mapping

import click

from pgmp_petsc.cli.options import Command
from pgmp_petsc.results.summary import json_text
from pgmp_petsc.runtime.progress import without_progress


def output_form(command: Command) -> Command:
    """Add ``--json`` and ``--quiet``; the function receives neither: `say` and `say_figures` know."""
    json = "Write the figures as JSON on standard output, and nothing else there."
    return click.option("--json", is_flag=True, expose_value=False, callback=_take_json, help=json)(quiet(command))


def quiet(command: Command) -> Command:
    """Add ``--quiet`` to a command that has no figures; the function does not receive it: `say` knows."""
    words = "Write nothing but errors and warnings on standard error."
    return click.option("--quiet", is_flag=True, expose_value=False, callback=_take_quiet, help=words)(command)


def say_figures(context: click.Context, figures: Mapping[str, object]) -> None:
    """Write figures as JSON on rank 0, where they are asked for; not collective."""
    if context.obj.json and context.obj.comm.rank == 0:
        click.echo(json_text(figures))


def _take_json(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    if wanted:
        context.obj.json = context.obj.quiet = True


def _take_quiet(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    if wanted:
        context.obj.quiet = True
        context.with_resource(without_progress())
