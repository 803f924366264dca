"""What a command tells the user."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import click

from pgmp_petsc.runtime.agreement import on_root


class Writable(Protocol):
    """A result with a file format."""

    def write(self, path: Path) -> None:
        """Write the file."""


def say(context: click.Context, text: str) -> None:
    """Print ``text`` on rank 0, at once; not collective."""
    if context.obj.comm.rank == 0:
        click.echo(text)


def save(context: click.Context, result: Writable | None, path: Path) -> None:
    """Write a result that rank 0 holds. Collective on all ranks."""

    def writing_the_result() -> None:
        result.write(path)

    on_root(context.obj.comm, writing_the_result)
