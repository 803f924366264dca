"""What a command tells the user."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import click

from pgmp_petsc.runtime.agreement import on_root

if TYPE_CHECKING:
    import h5py

    from pgmp_petsc.scene import Scene

#: Adds what it holds to an open file.
Part = Callable[["h5py.File"], None]


class Writable(Protocol):
    """A result with a file format."""

    def write(self, path: Path, *parts: Part) -> None:
        """Write the file, and what the parts add to it."""


def say(context: click.Context, text: str) -> None:
    """Print ``text`` on rank 0, at once; not collective."""
    if context.obj.comm.rank == 0:
        click.echo(text)


def say_remarks(context: click.Context, scene: Scene) -> None:
    """Print what is doubtful about a scene on rank 0; not collective."""
    for remark in scene.remarks:
        say(context, f"  {remark}")


def save(context: click.Context, result: Writable | None, path: Path, *parts: Part) -> None:
    """Write a result that rank 0 holds, with further parts where its file takes them. Collective on all ranks."""

    def writing_the_result() -> None:
        result.write(path, *parts)

    on_root(context.obj.comm, writing_the_result)
