"""Beginning and end of a benchmark that is run as a program."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from mpi4py import MPI

from pgmp_petsc.api.sources import Origin
from pgmp_petsc.base.errors import PgmpError
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.ranks.ending import release_petsc
from pgmp_petsc.ranks.petsc import start_mpi


def reduced_model(path: Path, overrides: Sequence[str] = ()) -> ReducedModel:
    """Return the model of a ROM, its scene changed where a change leaves the tables valid; each process reads it.

    Raises `InputError` as `Origin.prepared`.
    """
    return Origin.of(MPI.COMM_SELF, path, None, overrides, ()).prepared(MPI.COMM_SELF, told=False)


def guarded(work: Callable[[], None]) -> int:
    """Run a program's work and return its exit status; errors of the user's go to stderr."""
    try:
        work()
    except PgmpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    return 0


def end(status: int) -> NoReturn:
    """Exit; collective on COMM_WORLD."""
    release_petsc(start_mpi())
    sys.exit(status)
