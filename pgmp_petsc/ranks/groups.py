"""Ranks that work apart: groups of ranks, and work that is dealt out to ranks as they get through it.

Nobody waits in a round. Rank 0 works too. It deals between two pieces of its own, and in the midst of one wherever its
work calls `pulse`; what others have computed comes in the same way. Where there are many pieces a rank has one more in
hand than it works on, so that it never waits for an answer; where there are few it has not, or the last ones would wait
behind others.

A rank that fails says so, and all stop after the piece that they are at: no rank waits for one that has left.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.ranks.agreement import NOW_AND_THEN

if TYPE_CHECKING:
    from mpi4py import MPI

UNKNOWNS_PER_RANK = 3000  # of a run that is shared by ranks


@dataclass(frozen=True)
class RankGroup(AbstractContextManager):
    """This rank's place among groups of ranks; in a ``with`` block, which frees the groups' communicators."""

    world: Comm  # all ranks
    comm: Comm  # the ranks of this group
    roots: Comm | None  # the first ranks of all groups (on those ranks), else None
    #: index, count: number of this group, and of groups
    index: int
    count: int

    @classmethod
    def split(cls, world: Comm, ranks_per_group: int, option: str = "--ranks-per-angle") -> RankGroup:
        """Split all ranks into groups; ranks left over join the last group. Collective on `world`.

        `option` is what asks for it, in messages. Raises `InputError` if a group needs more ranks than there are.
        """
        if not 1 <= ranks_per_group <= world.size:
            raise InputError(
                f"{option} = {ranks_per_group}: allowed are 1 to {world.size}, the number of ranks of this run"
            )
        count = world.size // ranks_per_group
        index = min(world.rank // ranks_per_group, count - 1)
        comm = world.Split(color=index, key=world.rank)
        roots = world.Split(color=int(comm.rank > 0), key=index)
        if comm.rank > 0:
            roots.Free()
        return cls(world, comm, roots if comm.rank == 0 else None, index, count)

    def __exit__(self, *_: object) -> None:
        """Free the communicators of this rank. Collective on each of them."""
        for comm in (self.roots, self.comm):
            if comm is not None:
                comm.Free()

    def arcs(self, n: int) -> list[range]:
        """Return the groups' contiguous shares of n configurations; groups beyond the n-th have none."""
        bounds = np.linspace(0, n, min(self.count, n) + 1).round().astype(int)
        return [range(first, last) for first, last in zip(bounds, bounds[1:])]

    def arc(self, n: int) -> range:
        """Return this group's share; empty where it has none."""
        arcs = self.arcs(n)
        return arcs[self.index] if self.index < len(arcs) else range(0)


@contextmanager
def first_ranks(comm: Comm, n: int) -> Iterator[Comm]:
    """Yield a communicator of the first n ranks, and one of the others on those. Collective on `comm`.

    It is freed at the end of the block, whatever happens there: freeing waits for nobody in MPI's usual
    implementations.
    """
    part = comm.Split(color=int(comm.rank >= n), key=comm.rank)
    try:
        yield part
    finally:
        part.Free()


Pulse = Callable[[], None]
Work = Callable[[int, Pulse], Any]
Take = Callable[[int, Any], None]

MANY = 4  # pieces a rank from which on it has one in hand
RESULT, ANSWER = 1, 2  # tags
NO_MORE, STOP = -1, -2  # answers
FAILED, LEAVES = -1, -2  # in place of the number of a piece


def deal(comm: Comm, n_pieces: int, work: Work, take: Take) -> None:
    """Work off pieces 0 to n_pieces - 1, in about this order. Collective on `comm`.

    A piece, given by its number, is computed on any rank by `work`, which calls what it is given besides now and then;
    `take` takes in its number and its result, which is pickled, on rank 0. What these raise is raised on the rank where
    it was; the others return early. To be called where ranks agree on failures (`ranks.agreement.agreed`).
    """
    in_hand = 2 if n_pieces >= MANY * comm.size else 1
    if comm.rank == 0:
        _First(comm, range(1 + (comm.size - 1) * in_hand, n_pieces), work, take).run(n_pieces)
    else:
        _Other(comm, range(comm.rank, n_pieces, comm.size - (in_hand > 1))[:in_hand], work).run()


def deal_to_groups(group: RankGroup, n_pieces: int, work: Work, take: Take) -> None:
    """As `deal`, with groups of ranks that compute a piece together. Collective on ``group.world``.

    What `work` raises it has to raise on all ranks of a group.
    """
    if group.comm.size == 1:
        deal(group.roots, n_pieces, work, take)
        return
    if group.comm.rank > 0:
        while (number := group.comm.bcast(None)) != NO_MORE:
            work(number, lambda: None)
        return
    failed = False

    def lead(number: int, pulse: Pulse) -> Any:
        nonlocal failed
        group.comm.bcast(number)
        failed = True  # unless it comes back
        result = work(number, pulse)
        failed = False
        return result

    try:
        deal(group.roots, n_pieces, lead, take)
    finally:
        if not failed:
            group.comm.bcast(NO_MORE)


class _First:
    """Rank 0, which deals, and the numbers of the pieces that nobody has at the start."""

    def __init__(self, comm: Comm, pool: range, work: Work, take: Take) -> None:
        self._comm, self._pool, self._work, self._take = comm, deque(pool), work, take
        self._incoming: list[tuple[int, MPI.Request]] = []
        self._n_left, self._stopped, self._failure = 0, False, None

    def run(self, n_pieces: int) -> None:
        """Work and deal until all others have left."""
        own = 0 if n_pieces else None
        while own is not None and not self._stopped:
            try:
                self._keep(own, self._work(own, self.pulse))
            except Exception as error:
                self._fail(error)
            self.pulse()
            own = self._pool.popleft() if self._pool else None
        while self._n_left < self._comm.size - 1:
            if not self.pulse():
                time.sleep(NOW_AND_THEN)
        if self._failure is not None:
            raise self._failure

    def pulse(self) -> bool:
        """Take in what has come and deal; return whether something had."""
        if self._comm.size == 1:
            return False
        from mpi4py import MPI

        status = MPI.Status()
        while (message := self._comm.improbe(MPI.ANY_SOURCE, RESULT, status)) is not None:
            self._incoming.append((status.source, message.irecv()))
        waiting, came = [], False
        for source, request in self._incoming:
            done, content = request.test()
            if done:
                came = True
                self._hear(source, *content)
            else:
                waiting.append((source, request))
        self._incoming = waiting
        return came

    def _hear(self, source: int, number: int, result: Any) -> None:
        """Take in one message and answer it."""
        if number == LEAVES:
            self._n_left += 1
        elif number == FAILED:
            self._stopped = True
        else:
            self._keep(number, result)
            following = self._pool.popleft() if self._pool else NO_MORE
            self._comm.send(STOP if self._stopped else following, source, ANSWER)

    def _keep(self, number: int, result: Any) -> None:
        try:
            if not self._stopped:
                self._take(number, result)
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._stopped, self._failure = True, self._failure or error


class _Other:
    """Any other rank, and the numbers of the pieces that it has at the start."""

    def __init__(self, comm: Comm, in_hand: range, work: Work) -> None:
        self._comm, self._work, self._in_hand = comm, work, deque(in_hand)
        self._n_owed = 0  # answers
        self._sent: list[MPI.Request] = []

    def run(self) -> None:
        """Work until there is no more."""
        try:
            while self._in_hand:
                number = self._in_hand.popleft()
                self._send(number, self._work(number, self._pulse))
                self._n_owed += 1
                self._listen()
        except Exception:
            self._send(FAILED)
            raise
        finally:
            self._in_hand.clear()
            while self._n_owed:
                self._answer()
            self._send(LEAVES)
            while self._sent:
                self._pulse()
                time.sleep(NOW_AND_THEN if self._sent else 0.0)

    def _send(self, number: int, result: Any = None) -> None:
        self._sent.append(self._comm.isend((number, result), 0, RESULT))

    def _pulse(self) -> None:
        """Let MPI go on with what was sent."""
        self._sent = [request for request in self._sent if not request.test()[0]]

    def _listen(self) -> None:
        """Take in the answers that are there; wait for one where there is nothing in hand."""
        while self._n_owed and (not self._in_hand or self._comm.iprobe(0, ANSWER)):
            answer = self._answer()
            if answer >= 0:
                self._in_hand.append(answer)
            elif answer == STOP:
                self._in_hand.clear()

    def _answer(self) -> int:
        while not self._comm.iprobe(0, ANSWER):
            self._pulse()
            time.sleep(NOW_AND_THEN)
        self._n_owed -= 1
        return self._comm.recv(source=0, tag=ANSWER)
