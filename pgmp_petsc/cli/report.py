"""What a command tells the user."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click

from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import is_table
from pgmp_petsc.runtime.remarks import Remark

if TYPE_CHECKING:
    import h5py

    from pgmp_petsc.runtime.files import RunRecord
    from pgmp_petsc.scene import Scene

#: Adds what it holds to an open file.
Part = Callable[["h5py.File"], None]


class Writable(Protocol):
    """A result with a file format."""

    def write(self, path: Path, *parts: Part) -> None:
        """Write the file, and what the parts add to it."""


def say(context: click.Context, text: str) -> None:
    """Print ``text`` on rank 0, at once, unless the session is quiet; not collective."""
    if context.obj.comm.rank == 0 and not context.obj.quiet:
        click.echo(text)


def say_remarks(context: click.Context, scene: Scene) -> None:
    """Print what is doubtful about a scene on rank 0; not collective."""
    for remark in scene.remarks:
        say(context, f"  {remark}")
        say_warning(context, remark)


def say_warning(context: click.Context, remark: Remark) -> None:
    """Print a warning on standard error on rank 0 where the session is quiet and has no report; not collective."""
    if context.obj.quiet and not context.obj.has_report and context.obj.comm.rank == 0 and remark.kind == "warning":
        click.echo(f"pgmp: {remark}", err=True)


def remark_lines(record: RunRecord, said: Sequence[Remark] = ()) -> list[str]:
    """Return a line for every remark on a result, but for those that were said before it was made."""
    return [f"  {remark}" for remark in record.remarks if remark not in said]


def stopped_runs(*paths: Path) -> list[str]:
    """Return a line for every file that holds only a part of a run, saying why; by one process."""
    from pgmp_petsc.runtime.files import KINDS, RunRecord, open_file

    lines = []
    for path in paths:
        with open_file(path, KINDS) as file:
            if file.attrs.get("status", 0):
                lines += [f"{path}: {remark}" for remark in RunRecord.read(file).remarks[:1]]
    return lines


def say_of_files(
    context: click.Context, files: Sequence[Path], write: Callable[..., Sequence[str]], *args: Any
) -> None:
    """Call ``write(files, *args)`` on one rank; print what it says, and of which files only a part could be shown.

    Collective on all ranks.
    """
    for line in (*on_root(context.obj.comm, write, files, *args), *on_root(context.obj.comm, stopped_runs, *files)):
        say(context, line)


def save(context: click.Context, result: Writable | None, path: Path, *parts: Part) -> None:
    """Write a result that rank 0 holds, with further parts where its file takes them. Collective on all ranks."""

    def writing_the_result() -> None:
        from pgmp_petsc.results.tables import write_result  # loads h5py, which not every command needs

        write_result(result, path, *parts)

    on_root(context.obj.comm, writing_the_result)
    if is_table(path):
        say(
            context, f"{path}: rows and columns alone; a file *.h5 has the scene, remarks, estimates and statistics too"
        )
