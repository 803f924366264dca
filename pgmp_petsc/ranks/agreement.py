"""Agreement between ranks: a failure on one rank becomes the same failure on all of them.

A rank that leaves a collective operation alone makes the others wait for ever. Work that one rank can fail at
by itself (reading a file, one eigenproblem, one sample) is therefore wrapped in :func:`agreed`, which ends
with one reduction and lets all ranks raise together.

Ranks without work wait there for those that have some, and leave the processor to them: MPI's own waiting keeps it
busy.
"""

from __future__ import annotations

import pickle
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, RunError, missing_extra, plain_reason
from pgmp_petsc.base.plugins import IN_USE, to_blame
from pgmp_petsc.base.surroundings import Comm

Result = TypeVar("Result")
# s: what is ready soon is waited for in MPI's way, whose answer comes at once; then it is looked for now and then
SOON, NOW_AND_THEN = 5e-3, 1e-3


@contextmanager
def agreed(comm: Comm, activity: str) -> Iterator[None]:
    """Raise on every rank what any rank raised within the block. Collective on ``comm``.

    The block itself must contain no collective operation on ``comm``: a rank that fails skips the rest of it. Raised is
    the `PgmpError` of the lowest failing rank, with its type and message; that rank keeps its own traceback. Any other
    exception there is an `InputError` below a line of a plugin, else a `RunError` that names the activity, a noun
    phrase ("reading the mesh"), with the traceback on stderr.
    """
    failure: PgmpError | None = None
    try:
        yield
    except PgmpError as error:
        failure = error
    except (Exception, SystemExit) as error:  # a plugin's exit too: other ranks would wait for this one
        failure = missing_extra(error) if isinstance(error, ModuleNotFoundError) else None
        failure = failure or to_blame(error, {plugin.path for plugin in IN_USE.values()})
        failure = failure or _unexpected(error, activity, comm.rank)
    lowest = _lowest_failing_rank(comm, failure is not None)
    if lowest is None:
        return
    if comm.size > 1:
        packed = comm.bcast(_pack(failure) if comm.rank == lowest else None, root=lowest)
        if comm.rank != lowest:
            failure = pickle.loads(packed)
    raise failure


def on_root(comm: Comm, function: Callable[..., Result], *args: Any, doing: str = "") -> Result:
    """Call ``function(*args)`` on rank 0 and return its result on every rank. Collective on ``comm``. Raises
    `PgmpError`, as :func:`agreed`, of what is being done, by default the function's name in words; a result that cannot
    be pickled counts as a failure of rank 0."""
    result, packed = None, None
    with agreed(comm, doing or getattr(function, "__name__", "work on rank 0").replace("_", " ").strip()):
        if comm.rank == 0:
            result = function(*args)
            if comm.size > 1:
                # Pickled here and not by bcast: an error there would be known to rank 0 only.
                packed = pickle.dumps(result)
    if comm.size > 1:
        packed = comm.bcast(packed, root=0)
        if comm.rank > 0:
            result = pickle.loads(packed)
    return result


def _unexpected(error: BaseException, activity: str, rank: int) -> RunError:
    """Return the user's message of an error; the traceback of one that may be a mistake of ours is printed."""
    plain = plain_reason(error)
    if plain is not None:
        return RunError(f"{activity} failed on rank {rank}: {plain}")
    text = "".join(traceback.format_exception(error))
    print(f"pgmp: rank {rank}, {activity}:\n{text}", file=sys.stderr, end="", flush=True)
    failure = RunError(f"{activity} failed on rank {rank}: {type(error).__name__}: {error}")
    failure.__cause__ = error
    return failure


def _lowest_failing_rank(comm: Comm, failed: bool) -> int | None:
    """Return the lowest rank that failed, or None if none did. Collective on ``comm``."""
    if comm.size == 1:
        return 0 if failed else None
    from mpi4py import MPI

    own, lowest = np.array([comm.rank if failed else comm.size]), np.empty(1, dtype=int)
    request, start = comm.Iallreduce(own, lowest, op=MPI.MIN), time.perf_counter()
    while not request.Test():
        if time.perf_counter() - start > SOON:
            time.sleep(NOW_AND_THEN)
    return int(lowest[0]) if lowest[0] < comm.size else None


def _pack(failure: PgmpError) -> bytes:
    """Pickle a failure for the other ranks, as its nearest base class if it does not survive pickling."""
    try:
        packed = pickle.dumps(failure)
        pickle.loads(packed)
        return packed
    except Exception:
        base = InputError if isinstance(failure, InputError) else RunError
        return pickle.dumps(base(str(failure)))
