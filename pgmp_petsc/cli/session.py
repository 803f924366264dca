"""One call of ``pgmp``: its ranks, the options for PETSc, and whether it prints words, nothing, or JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import click

from pgmp_petsc.base.progress import without_progress
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.ranks.petsc import start_petsc


@dataclass
class Session:
    """One call of ``pgmp``; click's context object (``context.obj``)."""

    comm: Comm  # all ranks of the run
    petsc_options: Sequence[str] = ()  # what stood after ``--`` on the command line
    quiet: bool = False  # whether `say` prints nothing
    json: bool = False  # whether the command prints its figures as JSON, and nothing else
    petsc_started: bool = field(default=False, init=False)  # whether PETSc was started for the command

    def start_petsc(self) -> None:
        """Start PETSc with the user's options; anything that imports PETSc is imported after this."""
        start_petsc(self.petsc_options)
        self.petsc_started = True


def say(context: click.Context, text: str) -> None:
    """Print ``text`` on rank 0, at once, unless the session is quiet; not collective."""
    if context.obj.comm.rank == 0 and not context.obj.quiet:
        click.echo(text)


def take_json(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    """Take ``--json``."""
    if wanted:
        context.obj.json = context.obj.quiet = True


def take_quiet(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    """Take ``--quiet``."""
    if wanted:
        context.obj.quiet = True
        context.with_resource(without_progress())
