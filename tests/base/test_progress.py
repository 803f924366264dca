"""How far work has come: a bar for a terminal, lines elsewhere, on rank 0 and one at a time."""

import io
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field

import numpy as np
import pytest
from conftest import TIMEOUT_SECONDS, run_mpi

from pgmp_petsc.base.progress import Beat, Lines, Progress, doing, progress, waits_for, without_progress
from pgmp_petsc.lanes import compiled

# counts to 7, with the first line at once
COUNTING = """
import sys
import time
from mpi4py import MPI
from pgmp_petsc.base import progress
progress.EVERY = 0.4
with progress.progress(7, "samples", MPI.COMM_WORLD) as bar:
    for _ in range(7):
        time.sleep(0.1)
        bar.update()
"""


@dataclass
class Rank:
    """What a bar asks of a communicator."""

    rank: int


@pytest.fixture(autouse=True)
def nothing_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin every test as a process begins."""
    for name, value in (("_waits_for", []), ("_waiting", [0.0, 0.0]), ("_counts", []), ("_phases", [])):
        monkeypatch.setattr(f"pgmp_petsc.base.progress.{name}", value)


@dataclass
class Clock:
    """Seconds that a test moves."""

    now: float = 100.0
    stream: io.StringIO = field(default_factory=io.StringIO)

    def lines(self) -> list[str]:
        return self.stream.getvalue().splitlines()

    def __call__(self) -> float:
        return self.now

    def after(self, seconds: float, act: Callable[..., None], *given: float) -> None:
        """Let so much time go by, and act then."""
        self.now += seconds
        act(*given)


class Terminal(io.StringIO):
    """A stream that a person watches."""

    def isatty(self) -> bool:
        return True


class Full(io.StringIO):
    """A stream that cannot be written to."""

    def write(self, text: str) -> int:
        raise OSError(28, "No space left on device")


def test_a_bar_is_shown_on_rank_0_where_a_person_is_watching(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(progress(3, "samples", Rank(0)), Lines)
    # not in a fixture: pytest puts its own streams in place between set-up and test
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress(3, "samples", Rank(0), initial=1) as bar:
        bar.update(2)
    assert type(bar) not in (Lines, Progress) and "samples" in sys.stderr.getvalue()
    with progress(2, "settings", Rank(0), work=10.0) as bar:
        bar.update(1, 1.0)
        shown = bar._bar.format_dict
        assert shown["rate"] * max(shown["elapsed"], 1e-3) == pytest.approx(1.0 / 9.0), "a tenth is done, not half"
    with progress(10, "samples", Rank(0)) as bar:  # samples under way count, and it never goes back
        for within, done, n in ((5.7, 0, 5), (0.0, 2, 5), (0.0, 8, 10)):
            bar.within(within)
            bar.update(done)
            assert bar._bar.n == n
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress(3, "samples", Rank(1)) as bar:
        bar.update(3)
    assert type(bar) is Progress and sys.stderr.getvalue() == "", "other ranks are silent"


def test_parts_of_what_is_counted_say_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress(3, "settings", Rank(0)) as bar, without_progress():
            assert type(progress(3, "samples", Rank(0))) is Progress
            bar.update()
        with progress(3, "samples", Rank(0)) as after:
            assert type(after) is not Progress, "it ends with the block"


def test_long_work_says_how_far_it_is() -> None:
    clock = Clock()
    with Lines(1000, "full samples", clock.stream, clock=clock) as bar:
        for _ in range(100):
            clock.after(1.0, bar.update, 10)
    assert clock.lines()[:3] == [
        "full samples: 50 of 1000, 5 s, about 95 s to go",
        "full samples: 100 of 1000, 10 s, about 90 s to go",
        "full samples: 150 of 1000, 15 s, about 85 s to go",
    ]
    assert clock.lines()[-1] == "full samples: 1000 of 1000, 100 s", "the log says that it came to its end"
    with Lines(3, "settings", (unlike := Clock()).stream, clock=unlike, work=100.0) as bar:
        for seconds in (60.0, 30.0, 10.0):
            unlike.now += seconds
            bar.update(1, seconds)
    assert unlike.lines()[:2] == [
        "settings: 1 of 3, 60 s, about 40 s to go",
        "settings: 2 of 3, 90 s, about 10 s to go",
    ]
    with Lines(10, "samples", (short := Clock()).stream, clock=short) as bar:
        for _ in range(10):
            short.after(0.49, bar.update)
    assert short.lines() == [], "short work says nothing"
    bar = Lines(1000, "samples", (resumed := Clock()).stream, initial=900, clock=resumed)
    resumed.after(10.0, bar.update, 10)
    assert resumed.lines() == ["samples: 910 of 1000, 10 s, about 90 s to go"], "what was done before is no speed"


def test_a_rate_of_less_than_a_moment_says_nothing_about_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pgmp_petsc.base.progress._beats", [Beat(io.StringIO(), clock := Clock(now=94.0))])
    clock.now = 100.0
    bar = Lines(64, "samples", clock.stream, clock=clock)  # unwatched, as whoever watches would look between both
    clock.after(0.3, bar.update)
    assert clock.lines() == ["samples: 1 of 64, 0 s"]


def test_a_search_says_what_is_done_and_not_how_much_is_left() -> None:
    clock = Clock()
    with Lines(None, "comparisons", clock.stream, clock=clock) as count:
        for _ in range(83):
            clock.after(0.2, count.update)
    assert clock.lines() == [f"comparisons: {n}, {s} s" for n, s in ((25, 5), (50, 10), (75, 15), (83, 17))]


def test_there_is_a_line_every_five_seconds_however_long_work_takes() -> None:
    clock = Clock()
    bar = Lines(100_000, "samples", clock.stream, clock=clock)
    for _ in range(10_000):
        clock.after(1.0, bar.update)
    said = clock.lines()
    assert len(said) == 10_000 / 5
    assert said[-1].endswith("h to go") or "about 25 h" in said[-1], said[-1]
    assert "min" in said[len(said) // 2]


def test_work_that_fails_does_not_say_that_it_is_done() -> None:
    clock = Clock()
    with pytest.raises(ZeroDivisionError), Lines(2, "samples", clock.stream, clock=clock) as bar:
        clock.after(6.0, bar.update)
        raise ZeroDivisionError
    assert clock.lines() == ["samples: 1 of 2, 6 s, about 6 s to go"]
    bar = Lines(2, "samples", Full(), clock=clock)  # and a stream that fails does not end the work
    clock.after(6.0, bar.update, 2)


def test_work_of_which_nothing_is_done_is_seen_to_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pgmp_petsc.base.progress.EVERY", 0.01)
    stream = io.StringIO()
    with Lines(3, "samples", stream):
        deadline = time.monotonic() + TIMEOUT_SECONDS
        while not stream.getvalue().endswith("\n") and time.monotonic() < deadline:
            time.sleep(0.01)
    assert set(stream.getvalue().splitlines()) == {"samples: 0 of 3, 0 s"}


def test_one_rank_says_it_under_mpirun() -> None:
    done = run_mpi(3, "-c", COUNTING)
    said = [line.split(",")[0] for line in done.stderr.splitlines()]
    assert all(line.startswith("samples: ") for line in said) and said.count("samples: 7 of 7") == 1


def test_what_work_waits_for_is_said_beside_the_count(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr("pgmp_petsc.base.progress._now", clock)
    count = Lines(7, "samples", clock.stream, clock=clock)
    waits_for("compiling")
    waits_for("compiling what that calls")
    waits_for(None)
    clock.after(6.0, count.look)
    waits_for(None)
    clock.after(20.0, count.look)
    assert clock.lines() == ["samples: 0 of 7, 6 s, compiling", "samples: 0 of 7, 26 s"]


def test_what_goes_on_within_a_count_is_said_beside_it() -> None:
    """Not what the count is part of, and of what is nested the outermost."""
    clock = Clock()
    with doing("times"):
        count = Lines(26, "settings", clock.stream, clock=clock)
        with doing("full order, 4000 steps"), doing("kinematics"):
            clock.after(6.0, count.look)
        clock.after(6.0, count.look)
    assert clock.lines() == ["settings: 0 of 26, 6 s, full order, 4000 steps", "settings: 0 of 26, 12 s"]


def test_what_a_search_has_found_is_said_where_nothing_goes_on_within_it() -> None:
    clock = Clock()
    count = Lines(None, "runs", clock.stream, clock=clock)
    count.found = "design 1"
    clock.after(6.0, count.look)
    with doing("errors"):
        clock.after(6.0, count.look)
    assert clock.lines() == ["runs: 0, 6 s, design 1", "runs: 0, 12 s, errors"]


def test_a_bar_says_what_work_waits_for(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress(7, "samples", Rank(0)) as count:
        waits_for("compiling")
        assert "compiling" in terminal.getvalue()
        waits_for(None)
        last = terminal.getvalue().rsplit("\r", 1)[-1]
        assert "samples" in last and "compiling" not in last
        with doing("errors"):
            assert "errors" in terminal.getvalue().rsplit("\r", 1)[-1]
        count.found = "design 1"
        count.update()
        assert "design 1" in terminal.getvalue().rsplit("\r", 1)[-1]
        assert "errors" not in terminal.getvalue().rsplit("\r", 1)[-1]


def test_compiling_is_what_work_waits_for(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str | None] = []
    monkeypatch.setattr(compiled, "waits_for", said.append)
    triple = compiled.njit()(lambda x: 3 * x)
    assert triple(2) == triple(3) - 3 == 6
    assert said == [compiled.COMPILING, None]


def test_minutes_of_compiling_do_not_make_hours_to_go(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three samples were done when it began; the other 509 take 20 s."""
    clock = Clock()
    monkeypatch.setattr("pgmp_petsc.base.progress._now", clock)
    count = Lines(512, "reduced samples", clock.stream, clock=clock)
    count.update(3)
    waits_for("compiling")
    clock.after(160.0, count.look)
    waits_for(None)
    for _ in range(20):
        clock.after(1.0, count.update, 25)
        count.look()
    told = [line for line in clock.lines() if "to go" in line]
    assert told and "h" not in told[0].split("to go")[0].split("about ")[1]
    seconds = [int(line.split("about ")[1].split(" s")[0]) for line in told]
    assert max(seconds) <= 25


def test_slow_first_samples_do_not_tell_how_long_the_others_take() -> None:
    """The first samples, whose errors are estimated, take ten times as long."""
    clock = Clock()
    count = Lines(1000, "samples", clock.stream, clock=clock)
    for k in range(160):
        clock.after(1.0, count.update, 1 if k < 60 else 9)
    line = next(line for line in clock.lines() if int(line.split(", ")[1].split(" ")[0]) >= 120)
    done = int(line.split(": ")[1].split(" of")[0])
    said = int(line.split("about ")[1].split(" s")[0])
    assert abs(said - (1000 - done) / 9) < 10


def test_samples_under_way_count_by_their_steps() -> None:
    clock = Clock()
    with Lines(512, "samples", clock.stream, clock=clock) as bar:
        for k in range(1, 101):
            clock.after(0.4, bar.within, 512 * k / 100)
        bar.within(0.0)
        bar.update(512)
    lines = clock.lines()
    assert lines[0] == "samples: 66 of 512, 5 s, about 35 s to go" and lines[-1] == "samples: 512 of 512, 40 s"


def test_a_command_shows_what_it_does_where_nothing_is_counted() -> None:
    clock, terminal = Clock(), Terminal()
    beat = Beat(terminal, clock)
    with doing("reading meshes"):
        beat.look()
        clock.after(3.0, beat.look)
        assert terminal.getvalue() == "", "short work says nothing"
        for _ in range(4):
            clock.after(1.0, beat.look)
        assert terminal.getvalue().endswith("\r\x1b[Kpgmp: reading meshes, 7 s\r")
        with Lines(3, "samples", clock.stream, clock=clock):
            beat.look()
            assert terminal.getvalue().endswith("\r\x1b[K"), "a count says it itself"
    log = io.StringIO()
    quiet = Beat(log, clock)
    with doing("reading meshes"):
        for _ in range(12):
            clock.after(1.0, quiet.look)
    assert log.getvalue().splitlines() == [f"pgmp: reading meshes, {s} s" for s in (3, 8)]
    waits_for("compiling")
    for _ in range(10):
        clock.after(1.0, quiet.look)
    waits_for(None)
    assert log.getvalue().splitlines()[2:] == [f"pgmp: compiling, {s} s" for s in (1, 6)]


def test_short_phases_in_turn_are_not_silent_for_longer_than_a_long_one(monkeypatch) -> None:
    """A log of phases and counts of four seconds each, one behind the other: a line every five seconds at least."""
    clock, said = Clock(), []
    beat = Beat(clock.stream, clock)
    monkeypatch.setattr("pgmp_petsc.base.progress._beats", [beat])
    for number in range(6):
        counted = Lines(4, "samples", clock.stream, clock=clock) if number % 2 else nullcontext()
        with doing(f"phase {number}"), counted as count:
            for _ in range(4):
                clock.after(1.0, beat.look)
                if count is not None:
                    count.update()
                if len(clock.stream.getvalue().splitlines()) > len(said):
                    said.append(clock.now)
    assert np.diff([clock.now - 24.0, *said]).max() <= 5.0
