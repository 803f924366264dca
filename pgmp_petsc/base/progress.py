"""The progress of long work, printed by rank 0 on stderr.

A person at a terminal sees a bar. Where stderr is no terminal (under mpirun, in the log of a batch job) there is a line
every `EVERY` seconds; short work says nothing. A thread writes them, so that work of which no unit is done yet is seen
to go on.

The time left follows from the rate of the last part of the work, without the time that it waited for the compiler:
the first part is slower as a rule. Where units are not alike, it follows from what they are predicted to take, and from
all of the work so far. Units that are under way count by the share of their steps that is done.

Between counts a person at a terminal sees which phase goes on, and a log has a line of it (`Beat`): neither is without
a word for longer than `EVERY`.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, TextIO

from pgmp_petsc.base.errors import visible
from pgmp_petsc.base.surroundings import Comm

if TYPE_CHECKING:
    from tqdm import tqdm


EVERY = 5.0  # s, between lines
FIRST = 4.0  # s, before a command's first line, so that with its start it is not silent for longer than `EVERY`
RECENT = 0.5  # of the time, the last part, whose rate tells what is left; EVERY at least
TOLD = 0.01  # of what there was to do, from which on the time left is shown
NOTED = 0.5  # s, between two counts that are kept of the last part
BEAT = 1.0  # s, between looks of what shows that a command goes on

_quiet: ContextVar[bool] = ContextVar("quiet", default=False)
_waits_for: list[str] = []  # the text beside the count
_waiting = [0.0, 0.0]  # s that work waited for such things so far, and since when it does now
_bars: list[tqdm] = []  # those at a terminal
_counts: list[object] = []  # counts that are open
_beats: list[Beat] = []  # those that look
_phases: list[str] = []  # what goes on, the innermost last; beside a count what was begun within it is shown


class Progress(AbstractContextManager):
    """A count of work that shows nothing, a context manager; :func:`progress` returns one, or one that shows it.

    The total is None where it is not known before: a search ends when it ends. `initial` units were done before.
    Of units that are not alike, `work` is what all of them are predicted to take; the time left follows from that.
    What a search has `found` so far, in words, is shown with the next count.
    """

    def __init__(self, total: float | None = None, initial: int = 0, work: float | None = None) -> None:
        self._total, self._done, self._part = total, initial, 0.0
        self._work, self._worked = work, 0.0
        self._outer = len(_phases)
        self.found = ""

    def update(self, n: int = 1, work: float = 0.0) -> None:
        """Count ``n`` further units of work as done, which were predicted to take so much of all."""
        self._done += n
        self._worked += work
        self.look()

    def within(self, units: float) -> None:
        """Say how many units are done within those under way, 0 when they are counted."""
        self._part = max(self._part, units) if units > 0.0 else 0.0
        self.look()

    def look(self) -> None:
        """Show how far the work is."""

    @property
    def beside(self) -> list[str]:
        """What is to be said beside the count, one or none: what work waits for, or else what goes on within it, or
        what it has found."""
        return _waits_for[-1:] or _phases[self._outer : self._outer + 1] or ([self.found] if self.found else [])

    @property
    def _of_all(self) -> tuple[float, float]:
        """What is done, and of how much: units where these are alike, what they are predicted to take where not."""
        return (self._so_far, self._total or 0.0) if self._work is None else (self._worked, self._work)

    @property
    def _so_far(self) -> float:
        done = self._done + self._part
        return done if self._total is None else min(done, float(max(self._total, self._done)))

    def __exit__(self, *error: object) -> None:
        return None


class _Watched:
    """State that a separate thread looks at now and then, within a block."""

    def __init__(self) -> None:
        self._ended = threading.Event()

    def _watch(self, kept: list[Any], pause: Callable[[], float]) -> None:
        """Begin, as one of those that are kept; `pause` returns the seconds to the next look."""

        def looking() -> None:
            while not self._ended.wait(pause()):
                self.look()

        kept.append(self)
        threading.Thread(target=looking, daemon=True).start()


class Lines(Progress, _Watched):
    """A count that writes a line now and then; see `Progress`.

    What was done before does not tell how fast the others go. The clock tells seconds since any instant.
    """

    def __init__(
        self,
        total: int | None,
        description: str,
        stream: TextIO,
        initial: int = 0,
        clock: Callable[[], float] = time.monotonic,
        work: float | None = None,
    ) -> None:
        Progress.__init__(self, total, initial, work)
        _Watched.__init__(self)
        self._description, self._stream, self._clock = description, stream, clock
        self._start, self._initial = clock(), self._of_all[0]
        self._seen = deque([(0.0, self._initial)])  # s without waiting, units or what they are predicted to take
        self._waited = waited(self._start)
        self._next = min([self._start + EVERY, *(max(one.due, self._start) for one in _beats)])
        self._said = -1  # the count of the last line
        self._turn = threading.Lock()

    def look(self) -> None:
        """Write a line if it is time."""
        with self._turn:
            now, (done, of) = self._clock(), self._of_all
            elapsed = now - self._start
            # what work waits for, such as the compiler, comes once: it does not tell how fast the rest goes
            worked = elapsed - (waited(now) - self._waited)
            if worked - self._seen[-1][0] >= NOTED:
                self._seen.append((worked, done))
            # of units that are not alike, the last ones tell how far off predictions of their own kind are
            recent = max(RECENT * worked, EVERY) if self._work is None else worked
            while len(self._seen) > 2 and self._seen[1][0] <= worked - recent:
                self._seen.popleft()
            if now < self._next:
                return
            self._next = now + EVERY
            left = of - done
            since, before = self._seen[0]
            known = left > 0.0 and done - before > 0.0 and worked - since >= NOTED and not _waits_for
            known = known and done - self._initial >= TOLD * (of - self._initial)
            rest = f", about {_words((worked - since) * left / (done - before))} to go" if known else ""
            self._say(", ".join([f"{_words(elapsed)}{rest}", *self.beside]))

    def __enter__(self) -> Lines:
        self._watch(_counts, lambda: min(max(self._next - self._clock(), 0.01), EVERY))
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        _counts.remove(self)
        # the last line of a log says that the work came to its end
        if 0 <= self._said < self._done >= (self._total or 0) and error[0] is None:
            self._say(_words(self._clock() - self._start))

    def _say(self, times: str) -> None:
        self._said = self._done
        for one in _beats:
            one.due = self._clock() + EVERY
        of = "" if self._total is None else f" of {self._total}"
        try:
            print(f"{self._description}: {int(self._so_far)}{of}, {times}", file=self._stream, flush=True)
        except OSError:
            # whoever read stderr has gone, or its disk is full: no reason to end the work
            self._next = float("inf")


def progress(total: int | None, description: str, comm: Comm, initial: int = 0, work: float | None = None) -> Progress:
    """Return a count over ``total`` units of work, of which ``initial`` are done already; not collective.

    Where the total is not known before (None), it says what is done, and not how much is left. Units that are not alike
    are counted with the work that they are predicted to take, of all `work`.

    Rank 0 shows a bar if stderr is a terminal, else a line now and then; the other ranks show nothing.
    """
    if comm.rank > 0 or _quiet.get():
        return Progress()
    if not sys.stderr.isatty():
        return Lines(total, description, sys.stderr, initial, work=work)
    from tqdm import tqdm

    class Bar(tqdm):
        """A bar whose time left follows from what units are predicted to take, where they are not alike."""

        count: _Bar

        @property
        def format_dict(self) -> dict[str, Any]:
            shown = super().format_dict
            done, of = self.count._of_all if work is not None and self.n else (0.0, 0.0)
            if 0.0 < done < of:
                shown["rate"] = done / (of - done) * (self.total - self.n) / max(shown["elapsed"], 1e-3)
            return shown

    count = Bar.count = _Bar(total, initial, work)
    options = {"initial": initial, "leave": False, "dynamic_ncols": True, "file": sys.stderr}
    count._bar = Bar(total=total, desc=description, **options)
    _bars[:] = [one for one in _bars if not one.disable] + [count._bar]  # a bar that is closed is disabled
    return count


class _Bar(Progress):
    """A bar at a terminal; units within those under way move it too."""

    _bar: tqdm

    def look(self) -> None:
        """Move the bar, which never goes back: others may be less far with theirs."""
        done = int(self._so_far)
        if done > self._bar.n:
            self.tell()
            self._bar.update(done - self._bar.n)

    def tell(self) -> None:
        """Say beside the bar what goes on, if that has changed."""
        text = "".join(self.beside)
        if not self._bar.disable and text != (self._bar.postfix or ""):
            self._bar.set_postfix_str(text)

    def __enter__(self) -> _Bar:
        _counts.append(self)
        self._bar.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        _counts.remove(self)
        self._bar.__exit__(*error)


class Beat(_Watched):
    """Shows that a command goes on while nothing is counted: what it does, or waits for, and for how long.

    A person sees a line that the next one takes the place of; a log has lines as seldom as those of counts. Something
    is to be said when it is `due` by the clock, s.
    """

    def __init__(self, stream: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._stream, self._clock, self._person = stream, clock, stream.isatty()
        self._since, self._what, self.due = clock(), "", clock() + FIRST
        self._shown = False

    def __enter__(self) -> Beat:
        self._watch(_beats, lambda: min(BEAT, max(self.due - self._clock(), 0.05)))
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        _beats.remove(self)
        self.clear()

    def look(self) -> None:
        """Show what goes on, if nothing was said for `EVERY` seconds and no count shows it."""
        now = self._clock()
        for bar in _bars:  # its time goes on where no unit comes to its end
            if self._person and not bar.disable:
                bar.refresh()
        what = "" if _counts else (_waits_for or _phases or ["working"])[-1]
        if what != self._what:
            self.clear()
            self._what, self._since = what, now
        if not what:
            self.due = now + EVERY if self._person else self.due  # a bar shows that, and lines of a log say so
        elif now >= self.due:
            self.due = now + (BEAT if self._person else EVERY)
            start, end = ("\r\x1b[K", "\r") if self._person else ("", "\n")
            self._shown = True
            self._write(f"{start}pgmp: {what}, {_words(now - self._since)}{end}")

    def clear(self) -> None:
        """Take away the line that a person sees."""
        if self._person and self._shown:
            self._shown = False
            self._write("\r\x1b[K")

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):  # nobody reads it any more
            self._stream.write(text)
            self._stream.flush()


def beating(comm: Comm, quiet: bool) -> AbstractContextManager[object]:
    """Return what shows that a command goes on, on rank 0; not collective."""
    if comm.rank > 0 or quiet or sys.stderr is None:
        return nullcontext()
    return Beat(sys.stderr)


def clear_beat() -> None:
    """Take away what a `Beat` shows, before something else is written there."""
    for one in _beats:
        one.clear()


@contextmanager
def doing(what: str) -> Iterator[None]:
    """Name what goes on within the block, for whoever waits."""
    _phases.append(what)
    _tell_bars()
    try:
        yield
    finally:
        _phases.pop()
        _tell_bars()


def _tell_bars() -> None:
    for count in _counts:
        if isinstance(count, _Bar):
            count.tell()


def waited(now: float) -> float:
    """Return how long this process has waited for what `waits_for` said, s."""
    return _waiting[0] + (now - _waiting[1] if _waits_for else 0.0)


def waits_for(what: str | None) -> None:
    """Say beside the counts what work waits for, None at the end of that; it may wait for one within another."""
    if what is None:
        _waits_for.pop()
        if not _waits_for:
            _waiting[0] += _now() - _waiting[1]
    else:
        if not _waits_for:
            _waiting[1] = _now()
        _waits_for.append(what)
    _tell_bars()


def _now() -> float:
    return time.monotonic()


def announce(text: str, comm: Comm) -> None:
    """Say on stderr what a computation has decided; by the first rank of `comm`, not collective."""
    if comm.rank > 0 or _quiet.get():
        return
    # not over the bar of a terminal
    start = "\r\x1b[K" if sys.stderr.isatty() else ""
    for one in _beats:
        one.due = _now() + EVERY
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
