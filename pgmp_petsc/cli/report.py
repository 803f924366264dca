"""What a command tells the user."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.errors import visible
from pgmp_petsc.runtime.remarks import Remark

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
