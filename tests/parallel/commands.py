"""``pgmp`` with commands that end in every possible way. Used by test_cli_frame.py."""

from __future__ import annotations

import sys
import time

import click

from pgmp_petsc.cli import main as frame
from pgmp_petsc.cli.lazy import LazyCommand
from pgmp_petsc.cli.options import output_option, scene_options
from pgmp_petsc.cli.report import say
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError, RunError

frame.GRACE_SECONDS = 1.0


@click.command()
@click.pass_context
def fine(context: click.Context) -> None:
    """Print on every rank, once through say."""
    say(context, "said")
    print("printed")


@click.command()
@click.pass_context
def agreeing(context: click.Context) -> None:
    """Fail on the last rank, agreed on by all."""
    comm = context.obj.comm
    with agreed(comm, "reading"):
        if comm.rank == comm.size - 1:
            raise InputError("bodies.rod.mesh: not found")


@click.command()
@click.pass_context
def failing(context: click.Context) -> None:
    """Fail on every rank with exit status 1."""
    raise RunError("no convergence")


@click.command()
@click.pass_context
def alone(context: click.Context) -> None:
    """Fail on the last rank while the others wait in a collective operation."""
    comm = context.obj.comm
    if comm.rank == comm.size - 1:
        raise InputError("known to one rank")
    comm.barrier()


@click.command()
@click.pass_context
def crashing(context: click.Context) -> None:
    """Crash on the last rank while the others wait in a collective operation."""
    comm = context.obj.comm
    if comm.rank == comm.size - 1:
        raise ZeroDivisionError("a mistake")
    comm.barrier()


@click.command()
@click.pass_context
def interrupted(context: click.Context) -> None:
    """Be interrupted on the last rank."""
    comm = context.obj.comm
    if comm.rank == comm.size - 1:
        raise KeyboardInterrupt
    time.sleep(1e4)  # until mpirun ends it


@click.command()
@click.pass_context
def some_failed(context: click.Context) -> None:
    """End with status 1 without a message, as where some samples failed."""
    context.exit(1)


@click.command()
@click.pass_context
def petsc(context: click.Context) -> None:
    """Print the options that PETSc was started with."""
    from petsc4py import PETSc

    say(context, str(sorted(PETSc.Options().getAll().items())))


@click.command()
@scene_options
@output_option
@click.pass_context
def options(context: click.Context, settings: tuple, overrides: tuple, output: object) -> None:
    """Print the shared options."""
    say(context, f"{settings} {overrides} {output}")


@click.command()
@click.pass_context
def modules(context: click.Context) -> None:
    """Print whether PETSc was imported."""
    say(context, f"petsc4py imported: {'petsc4py' in sys.modules}")


for _command in (fine, agreeing, failing, alone, crashing, interrupted, some_failed, petsc, options, modules):
    _name = _command.callback.__name__
    frame.COMMANDS[_name] = LazyCommand(f"{__name__}:{_name}", "For a test.", uses_petsc=_name == "petsc")

if __name__ == "__main__":
    frame.main()
