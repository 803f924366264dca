"""What a command tells the user."""

from __future__ import annotations

import click


def say(context: click.Context, text: str) -> None:
    """Print ``text`` on rank 0, at once; not collective."""
    if context.obj.comm.rank == 0:
        click.echo(text)
