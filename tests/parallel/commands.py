"""``pgmp`` with commands that end in every possible way. Used by test_cli_frame.py."""

from __future__ import annotations  # the declaration of commands reads annotations as text

import io
import json
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from os import PathLike
from pathlib import Path

import click
import numpy as np

from pgmp_petsc.api import Found
from pgmp_petsc.api.declared import command
from pgmp_petsc.api.ranks import tell
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.cli import main as frame
from pgmp_petsc.cli.declared import say
from pgmp_petsc.files.checkpoint_folder import CheckpointFolder
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.petsc import petsc_solver

frame.GRACE_SECONDS = 1.0


def own(function: Callable) -> click.Command:
    """Make a command of a function of click's context."""
    return click.command()(click.pass_context(function))


def on_last_rank(context: click.Context) -> bool:
    return context.obj.comm.rank == context.obj.comm.size - 1


@own
def fine(context: click.Context) -> None:
    """Print on every rank, once through say."""
    say(context, "said")
    print("printed")


@own
def agreeing(context: click.Context) -> None:
    """Fail on the last rank, agreed on by all."""
    with agreed(context.obj.comm, "reading"):
        if on_last_rank(context):
            raise InputError("bodies.rod.mesh: not found")


@own
def failing(context: click.Context) -> None:
    """Fail on every rank with exit status 1."""
    raise RunError("no convergence")


@own
def alone(context: click.Context) -> None:
    """Fail on the last rank while the others wait in a collective operation."""
    if on_last_rank(context):
        raise InputError("known to one rank")
    context.obj.comm.barrier()


@own
def crashing(context: click.Context) -> None:
    """Crash on the last rank while the others wait in a collective operation."""
    if on_last_rank(context):
        raise ZeroDivisionError("a mistake")
    context.obj.comm.barrier()


@own
def interrupted(context: click.Context) -> None:
    """Be interrupted on the last rank."""
    if on_last_rank(context):
        raise KeyboardInterrupt
    time.sleep(1e4)  # until mpirun ends it


@click.command()
@click.argument("output", required=False, type=click.Path(path_type=Path))
@click.pass_context
def waiting(context: click.Context, output: Path | None) -> None:
    """Wait to be ended, rank 0 within MPI; with OUTPUT a piece of it is finished."""
    comm = context.obj.comm
    if output is not None and comm.rank == 0:
        folder = CheckpointFolder(output, {"format": 1})
        folder.open(resume=False)
        folder.put("piece", {"a": np.zeros(3)})
    comm.barrier()
    print("waiting", flush=True)
    if comm.rank == 0 and comm.size > 1:
        comm.barrier()
    time.sleep(600.0)


@own
def some_failed(context: click.Context) -> None:
    """End with status 1 without a message, as where some samples failed."""
    context.exit(1)


@own
def petsc(context: click.Context) -> None:
    """Print the options that PETSc was started with."""
    from petsc4py import PETSc

    say(context, str(sorted(PETSc.Options().getAll().items())))


@own
def using(context: click.Context) -> None:
    """Use an option on the last rank."""
    from petsc4py import PETSc

    if on_last_rank(context):
        PETSc.Options("pgmp_ts_").getInt("used")


@own
def solving(context: click.Context) -> None:
    """Make a solver."""
    from petsc4py import PETSc

    with agreed(context.obj.comm, "solving"), petsc_solver("pgmp_ts_", "solver"):
        solver = PETSc.KSP().create(PETSc.COMM_SELF)
        solver.setOptionsPrefix("pgmp_ts_")
        try:
            solver.setFromOptions()
        finally:
            solver.destroy()


@click.command()
@click.argument("kind")
def refused(kind: str) -> None:
    """Meet what the system refuses."""
    errors = {
        "memory": MemoryError("16 GiB"),
        "permission": PermissionError(13, "Permission denied", "/data/x"),
        "nesting": RecursionError("maximum recursion depth exceeded"),
        "text": UnicodeEncodeError("utf-8", "\udcff", 0, 1, "surrogates not allowed"),
    }
    raise errors[kind]


@command("options", "For a test.", 0, petsc=False)
def options(
    parameters: Parameters | None = None, overrides: Overrides = (), output: str | PathLike[str] | None = None,
    comm: object = None,
) -> None:  # fmt: skip
    """Print the shared options."""
    tell(comm, f"{parameters} {overrides} {output}")


@own
def modules(context: click.Context) -> None:
    """Print whether PETSc was imported."""
    say(context, f"petsc4py imported: {'petsc4py' in sys.modules}")


STARTED = (petsc, using, solving)
OTHERS = (fine, agreeing, failing, alone, crashing, interrupted, waiting, some_failed, options, modules, refused)


def load_own(head: Found, load: Callable[[Found], click.Command] = frame.load) -> click.Command:
    """Return a command of this module, which click made or a declaration, or one of the package."""
    found = globals()[head.function] if head.module == __name__ else None
    return found if isinstance(found, click.Command) else load(head)


for _command in (*STARTED, *OTHERS):
    _name = _command.__name__ if _command is options else _command.callback.__name__
    frame.COMMANDS[_name] = Found(__name__, _name, _name, "For a test.", 0, _command in STARTED)
frame.load = load_own


def each(commands: list[list[str]]) -> None:
    """Run commands one after the other; print a line each, of every rank's status, output and errors, as JSON."""
    from mpi4py import MPI

    for words in commands:
        out, err, status = io.StringIO(), io.StringIO(), 0
        with redirect_stdout(out), redirect_stderr(err):
            try:
                frame.main(words)
            except SystemExit as end:
                status = end.code or 0
        if ranks := MPI.COMM_WORLD.gather((status, out.getvalue(), err.getvalue())):
            print(json.dumps(ranks), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["each"]:
        each(json.loads(sys.argv[2]))
    else:
        frame.main()
