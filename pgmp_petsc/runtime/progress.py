"""How far long work has come, said by rank 0 on stderr.

A person at a terminal sees a bar. Where stderr is no terminal (under mpirun, in the log of a batch job) there is a line
after `FIRST` seconds and then every `EVERY` seconds, less often the longer the work takes; short work says nothing.
A thread writes them, so that work of which no unit is done yet is seen to go on.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, TextIO

from pgmp_petsc.runtime.errors import visible

if TYPE_CHECKING:
    from mpi4py import MPI
    from tqdm import tqdm

FIRST = 5.0  # s, before the first line
EVERY = 10.0  # s, between lines of work that began less than 100 s ago
SHARE = 0.1  # of the time since the beginning, between later lines
SELDOM = 60.0  # s, the longest time between lines

_quiet: ContextVar[bool] = ContextVar("quiet", default=False)
_waits_for: list[str] = []  # what stands beside the count
_bars: list[tqdm] = []  # those at a terminal


class Progress(Protocol):
    """What :func:`progress` returns: a context manager that counts."""

    def update(self, n: int = 1) -> object:
        """Count ``n`` further units of work as done."""

    def __enter__(self) -> Progress: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None: ...


class Silent:
    """A count that shows nothing."""

    def update(self, n: int = 1) -> None:
        """Do nothing."""

    def __enter__(self) -> Silent:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None


class Lines:
    """A count that writes a line now and then.

    Parameters
    ----------
    total
        Units of work; None where it is not known before: a search ends when it ends.
    description
        What is counted.
    stream
        Where the lines go.
    initial
        Units that were done before; they do not tell how fast the others go.
    clock
        Seconds since any instant.
    """

    def __init__(
        self,
        total: int | None,
        description: str,
        stream: TextIO,
        initial: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._total, self._description, self._stream, self._clock = total, description, stream, clock
        self._initial = self._done = initial
        self._start = clock()
        self._next = self._start + FIRST
        self._said = -1  # the count of the last line
        self._turn = threading.Lock()
        self._ended = threading.Event()

    def update(self, n: int = 1) -> None:
        """Count ``n`` further units of work as done."""
        self._done += n
        self.look()

    def look(self) -> None:
        """Write a line if it is time."""
        with self._turn:
            now = self._clock()
            if now < self._next:
                return
            elapsed = now - self._start
            self._next = now + min(max(EVERY, SHARE * elapsed), SELDOM)
            done = self._done - self._initial
            left = 0 if self._total is None else self._total - self._done
            # what work waits for, such as the compiler, comes once: it does not tell how fast the rest goes
            known = done > 0 and left > 0 and not _waits_for
            rest = f", about {_words(elapsed * left / done)} to go" if known else ""
            self._say(", ".join([f"{_words(elapsed)}{rest}", *_waits_for[-1:]]))

    def __enter__(self) -> Lines:
        threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        # the last line of a log says that the work came to its end
        if 0 <= self._said < self._done >= (self._total or 0) and kind is None:
            self._say(_words(self._clock() - self._start))

    def _watch(self) -> None:
        while not self._ended.wait(FIRST):
            self.look()

    def _say(self, times: str) -> None:
        self._said = self._done
        of = "" if self._total is None else f" of {self._total}"
        try:
            print(f"{self._description}: {self._done}{of}, {times}", file=self._stream, flush=True)
        except OSError:
            # whoever read stderr has gone, or its disk is full: no reason to end the work
            self._next = float("inf")


def progress(total: int | None, description: str, comm: MPI.Comm, initial: int = 0) -> Progress:
    """Return a count over ``total`` units of work, of which ``initial`` are done already; not collective.

    Where the total is not known before (None), it says what is done, and not how much is left.

    Rank 0 shows a bar if stderr is a terminal, else a line now and then; the other ranks show nothing.
    """
    if comm.rank > 0 or _quiet.get():
        return Silent()
    if not sys.stderr.isatty():
        return Lines(total, description, sys.stderr, initial)
    from tqdm import tqdm

    bar = tqdm(total=total, desc=description, initial=initial, leave=False, dynamic_ncols=True, file=sys.stderr)
    _bars[:] = [one for one in _bars if not one.disable] + [bar]  # a bar that is closed is disabled
    return bar


def waits_for(what: str | None) -> None:
    """Say beside the counts what work waits for, None at the end of that; it may wait for one within another."""
    if what is None:
        _waits_for.pop()
    else:
        _waits_for.append(what)
    for bar in _bars:
        if not bar.disable:
            bar.set_postfix_str((_waits_for or [""])[-1])


def announce(text: str, comm: MPI.Comm) -> None:
    """Say on stderr what a computation has decided; by the first rank of `comm`, not collective."""
    if comm.rank > 0 or _quiet.get():
        return
    # not over the bar of a terminal
    start = "\r\x1b[K" if sys.stderr.isatty() else ""
    with suppress(OSError):
        print(f"{start}pgmp: {visible(text)}", file=sys.stderr, flush=True)


@contextmanager
def without_progress() -> Iterator[None]:
    """Show nothing within the block: its work is a small part of what a count outside shows."""
    before = _quiet.set(True)
    try:
        yield
    finally:
        _quiet.reset(before)


def _words(seconds: float) -> str:
    """Return a time as a person reads it: 14 s, 3 min 20 s, 5 h 12 min."""
    whole = round(seconds)
    if whole < 180:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 180:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
