"""What a command tells the user.

What a command writes on standard output: words, nothing, or its figures as JSON and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pgmp_petsc.cli.options import Command
from pgmp_petsc.results.summary import json_text
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.errors import Remark, visible
from pgmp_petsc.runtime.progress import without_progress

if TYPE_CHECKING:
    from pgmp_petsc.runtime.files import RunRecord


def say(context: click.Context, text: str) -> None:
    """Print ``text`` on rank 0, at once, unless the session is quiet; not collective."""
    if context.obj.comm.rank == 0 and not context.obj.quiet:
        click.echo(text)


def say_warning(context: click.Context, remark: Remark) -> None:
    """Print a warning on standard error on rank 0 where the session is quiet; not collective."""
    if context.obj.quiet and context.obj.comm.rank == 0 and remark.kind == "warning":
        click.echo(visible(f"pgmp: {remark}"), err=True)


def remark_lines(record: RunRecord, said: Sequence[Remark] = ()) -> list[str]:
    """Return a line for every remark on a result, but for those that were said before it was made."""
    return [f"  {remark}" for remark in record.remarks if remark not in said]


def say_of_files(
    context: click.Context, files: Sequence[Path], write: Callable[..., Sequence[str]], *args: Any
) -> None:
    """Call ``write(files, *args)`` on one rank; print what it says, and of which files only a part could be shown.

    Collective on all ranks.
    """
    from pgmp_petsc.api.files import stopped_runs

    for line in (*on_root(context.obj.comm, write, files, *args), *on_root(context.obj.comm, stopped_runs, *files)):
        say(context, line)


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
