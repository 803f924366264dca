"""The ranks that a call runs on, and the start of MPI, PETSc and SLEPc where a program has not started them.

PETSc starts together on the ranks of a call, and waits for no others: ranks of a program may go ways of their own, and
some compute nothing. Where some of a call's ranks have it running and others have not, these start it by themselves;
every object of PETSc here is on a communicator that is named.
"""

from __future__ import annotations

import atexit
import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from pgmp_petsc.base.errors import InputError, Remark, visible
from pgmp_petsc.base.surroundings import Comm, alone, has_petsc, is_communicator
from pgmp_petsc.ranks.ending import release_petsc
from pgmp_petsc.ranks.petsc import petsc_runs, start_mpi, start_petsc

#: Gets what commands print on the way: what was chosen, and why (level INFO); remarks on results (level WARNING).
#: The attribute `ABOUT` of its records says what they are about, `REMARK` is the remark where there is one.
LOGGER = logging.getLogger("pgmp_petsc")
ABOUT, WAY, SCENE, RESULT, REMARK = "pgmp_about", "way", "scene", "result", "pgmp_remark"
# of this process: whether a call, or who called, has seen to the start and to what is held at the end
_seen_to: list[str] = []


def ranks_of(comm: Comm | None) -> Comm:
    """Return the ranks of a call: those that are given, else COMM_WORLD where it has several, else COMM_SELF; raises
    `InputError` if it is no communicator of mpi4py."""
    world = start_mpi()
    if comm is None:
        return world if world.size > 1 else alone()
    if not is_communicator(comm):
        raise InputError(f"comm = {comm!r}: allowed is a communicator of mpi4py, such as MPI.COMM_WORLD")
    return comm


def solving_ranks_of(comm: Comm | None) -> Comm:
    """Return the same, with PETSc and SLEPc started on them where they are installed. Collective on these ranks."""
    own = ranks_of(comm)
    if has_petsc():
        _start(own)
    return own


def petsc_is_seen_to() -> None:
    """Leave the start of PETSc, and what it holds at the end, to who calls, such as the command line."""
    _seen_to.append("by the caller")


def _start(comm: Comm) -> None:
    """Start PETSc where it does not run; a program that started it has given its own options. Collective on `comm`."""
    own = petsc_runs(), bool(_seen_to)
    states = {own} if comm.size == 1 else set(comm.allgather(own))
    if _seen_to:
        return
    # at the end all ranks that began together let go together, and no other rank is waited for
    where = alone()
    if len(states) == 1 and comm.size > 1:
        world = start_mpi()
        # PETSc keeps it to the end of the program, and the caller's may be freed
        where = world if comm.size == world.size else comm.Dup()
    start_petsc((), where)
    atexit.register(release_petsc, where)
    _seen_to.append("by a call")


@contextmanager
def untold() -> Iterator[None]:
    """Log nothing of calls within the block, of which who calls them tells in a line."""
    before, LOGGER.disabled = LOGGER.disabled, True
    try:
        yield
    finally:
        LOGGER.disabled = before


def tell(comm: Comm, text: str) -> None:
    """Log what a command would print, on the first rank; not collective."""
    if comm.rank == 0 and text:
        LOGGER.info("%s", visible(text), extra={ABOUT: WAY})


def tell_remarks(comm: Comm, remarks: Iterable[Remark], about: str = SCENE) -> None:
    """Log remarks on a scene or a result on the first rank: warnings are seen unless a program says otherwise."""
    if comm.rank == 0:
        for remark in remarks:
            level = logging.WARNING if remark.kind == "warning" else logging.INFO
            LOGGER.log(level, "%s", visible(str(remark)), extra={ABOUT: about, REMARK: remark})
