"""Ranks: groups of them and their communicators, and processes that they start."""

import ast
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from conftest import ROOT, SCRIPTS, TIMEOUT_SECONDS, run_mpi
from refusals import refusal

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ranks.ending import TIME_IS_OVER, child, run_child
from pgmp_petsc.ranks.groups import RankGroup, first_ranks


@dataclass
class World:
    """As much of a communicator as a split needs; a split part knows its colour and the key it was given."""

    rank: int
    size: int
    color: int = -1
    key: int = -1
    freed: bool = False

    def Split(self, color: int, key: int) -> "World":  # noqa: N802, mpi4py's name
        """Return this rank's part; groups are contiguous, so the rank within follows from the color."""
        return World(0 if color == 0 and key == 0 else self.rank, self.size, color, key)

    def Free(self) -> None:  # noqa: N802, mpi4py's name
        """Note that it is free; once is enough."""
        assert not self.freed
        self.freed = True


@pytest.mark.parametrize(
    ("size", "ranks_per_group", "expected"),
    [
        (1, 1, [0]), (4, 1, [0, 1, 2, 3]), (4, 2, [0, 0, 1, 1]), (5, 2, [0, 0, 1, 1, 1]), (3, 2, [0, 0, 0]),
        (5, 5, [0] * 5),
    ],
)  # fmt: skip
def test_ranks_left_over_join_the_last_group(size: int, ranks_per_group: int, expected: list[int]) -> None:
    split = [RankGroup.split(World(rank, size), ranks_per_group) for rank in range(size)]
    assert [group.index for group in split] == expected
    assert {group.count for group in split} == {expected[-1] + 1}
    assert [group.comm.color for group in split] == expected
    assert [group.comm.key for group in split] == list(range(size))


@pytest.mark.parametrize("ranks_per_group", [0, -1, 4])
def test_a_group_larger_than_the_run_is_refused(ranks_per_group: int) -> None:
    assert refusal(RankGroup.split, World(0, 3), ranks_per_group) == (
        f"--ranks-per-angle = {ranks_per_group}: allowed are 1 to 3, the number of ranks of this run"
    )


@pytest.mark.parametrize("count", [1, 2, 3, 5, 7, 64])
@pytest.mark.parametrize("n", [1, 4, 5, 24, 63, 629])
def test_arcs_are_contiguous_even_and_complete(count: int, n: int) -> None:
    arcs = [RankGroup(World(0, count), World(0, 1), None, index, count).arc(n) for index in range(count)]
    assert [row for arc in arcs for row in arc] == list(range(n))
    # every group knows the shares of all
    shares = RankGroup(World(0, count), World(0, 1), None, 0, count).arcs(n)
    assert shares == arcs[: min(count, n)] and all(shares)
    lengths = [len(arc) for arc in arcs]
    # the arcs that are empty come last, so that the others are neighbours in the order of the groups
    assert lengths[min(count, n) :] == [0] * (count - min(count, n))
    assert max(lengths[: min(count, n)]) - min(lengths[: min(count, n)]) <= 1


def test_a_group_of_one_process() -> None:
    from mpi4py import MPI

    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        assert (group.index, group.count, group.comm.size, group.roots.size) == (0, 1, 1, 1)
        assert group.arc(7) == range(7)
    assert group.comm == group.roots == MPI.COMM_NULL


def test_who_splits_frees_also_when_an_error_ends_the_work() -> None:
    with pytest.raises(InputError), RankGroup.split(World(0, 3), 2) as group:
        raise InputError("bad")
    assert group.comm.freed and group.roots.freed


def test_the_first_ranks_and_the_others() -> None:
    parts = []
    for rank in range(3):
        with pytest.raises(InputError), first_ranks(World(rank, 3), 2) as part:
            parts.append(part)
            raise InputError("bad")
    assert [part.color for part in parts] == [0, 0, 1]
    assert all(part.freed for part in parts)


def test_communicators_are_freed() -> None:
    """MPI has a limited number of them, and a study makes some for every model."""
    handles = ast.literal_eval(run_mpi(3, SCRIPTS / "communicators.py").stdout)
    assert len(handles) == 3 and all(before == after for before, after in handles)


RANKS = (1, 3)
# what every rank says of a case, by the number of ranks
AGREED: dict[str, Callable[[int], str]] = {
    "fine": lambda n: "returned fine",
    "one": lambda n: "raised InputError 2: bodies.rod.mesh: no such file",
    "several": lambda n: f"raised RunError 1: failed on {min(1, n - 1)}",
    "unexpected": lambda n: f"raised RunError 1: eigenproblem 7 failed on rank {n - 1}: ZeroDivisionError: oops",
    "unpicklable": lambda n: "1: diverged at 0.5",  # the rank itself knows its kind
    "root": lambda n: "returned [1, 2, 3]",
    "root_fails": lambda n: "raised InputError 2: missing",
    "root_unpicklable": lambda n: "failed on rank 0" if n > 1 else "returned function",
    "timings": lambda n: f"returned {[('all', float(n)), *((f'only {rank}', 0.5) for rank in range(n))]}",
}


@pytest.fixture(scope="module", params=RANKS)
def agreed(request) -> tuple[int, list[str], str]:
    """Return the number of ranks, the lines of all, case by case in one start, and stderr."""
    done = run_mpi(request.param, SCRIPTS / "agreement.py", *AGREED)
    return request.param, done.stdout.splitlines(), done.stderr


@pytest.mark.parametrize("case", AGREED)
def test_all_ranks_return_or_raise_the_same(agreed, case):
    n, said, _ = agreed
    lines = [line.removeprefix(f"{case} ") for line in said if line.startswith(f"{case} ")]
    if case == "unpicklable":
        lines = [line.split(maxsplit=2)[2] for line in lines]
    assert len(lines) == n and len(set(lines)) == 1 and AGREED[case](n) in lines[0]


def test_an_unexpected_exception_shows_its_traceback_once(agreed):
    n, _, stderr = agreed
    assert stderr.count(f"rank {n - 1}, eigenproblem 7") == stderr.count("in fail_with") == 1


# what a mesh reader of meshio does with a file cut short, and a compiler with children of its own
SPINS = "while True: pass"
SPINS_BELOW = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {SPINS!r}, sys.argv[1]])"


def living(mark: str) -> list[int]:
    """Return the processes whose command line holds a mark."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            words, state = (place / "cmdline").read_bytes(), (place / "stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            continue
        if mark.encode() in words and state != "Z":
            found.append(int(place.name))
    return found


def waited(condition: Callable[[], bool]) -> bool:
    """Wait until a condition holds; return whether it did."""
    until = time.monotonic() + TIMEOUT_SECONDS
    while not condition() and time.monotonic() < until:
        time.sleep(0.05)
    return condition()


def test_what_a_child_returns(tmp_path: Path) -> None:
    done = run_child(["sh", "-c", "pwd; echo wrong >&2; exit 3"], 60.0, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (3, f"{tmp_path}\n".encode(), b"wrong\n")
    assert run_child(["sh", "-c", "kill -SEGV $$"], 60.0).returncode == 128 + signal.SIGSEGV
    lacking = run_child(["/nowhere/cc"], 60.0)
    assert (lacking.returncode, lacking.stderr) == (127, b"/nowhere/cc: No such file or directory")


@pytest.mark.parametrize("program", [SPINS, SPINS_BELOW, "import time; time.sleep(1e4)"])
def test_a_child_ends_at_its_time(program: str, tmp_path: Path) -> None:
    """One that works, one whose own child does, and one that waits."""
    assert run_child([sys.executable, "-c", program, str(tmp_path)], 1.0).returncode == TIME_IS_OVER
    assert waited(lambda: not living(str(tmp_path)))


def test_a_child_has_its_limits_itself() -> None:
    done = run_child([sys.executable, "-c", "import resource as r; print(r.getrlimit(r.RLIMIT_CPU))"], 7.0)
    assert done.stdout == b"(7, 8)\n"


def test_what_is_left_at_the_end_of_the_block_is_ended(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), child([sys.executable, "-c", SPINS_BELOW, str(tmp_path)]):
        assert waited(lambda: len(living(str(tmp_path))) == 3)
        raise KeyboardInterrupt
    assert waited(lambda: not living(str(tmp_path)))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("program", [SPINS, SPINS_BELOW])
def test_no_child_outlives_its_parent(program: str, number: int, tmp_path: Path) -> None:
    own = f"import sys; from pgmp_petsc.ranks.ending import run_child; run_child({[program]} and sys.argv[1:], 600)"
    command = [sys.executable, "-c", own, sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT) as parent:
        many = 3 if program == SPINS else 4  # itself, the guard, and the program with its children
        assert waited(lambda: len(living(str(tmp_path))) == many)
        parent.send_signal(number)
        parent.wait(TIMEOUT_SECONDS)
    assert waited(lambda: not living(str(tmp_path)))


def test_no_mesh_reader_outlives_a_command(tmp_path: Path) -> None:
    """Its reader looks for the next line of a file that has no more."""
    mesh = tmp_path / "endless.off"
    mesh.write_text("OFF\n")
    scene = (ROOT / "scenes" / "slider_crank.toml").read_text().replace("../meshes/crank_5.msh", str(mesh))
    (tmp_path / "scene.toml").write_text(scene)
    assert str(mesh) in scene
    command = [sys.executable, "-m", "pgmp_petsc.cli.main", "check", str(tmp_path / "scene.toml")]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as parent:
        assert waited(lambda: len(living(str(mesh))) == 2)
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait(TIMEOUT_SECONDS)
    assert waited(lambda: not living(str(mesh)))


def test_every_child_is_started_in_one_place() -> None:
    """Whoever starts one elsewhere has to see to its end."""
    starts = ("import subprocess", "from subprocess", "multiprocessing", "os.fork", "os.spawn", "os.system", "popen(")
    texts = {path: path.read_text(encoding="utf-8") for path in (ROOT / "pgmp_petsc").rglob("*.py")}
    found = {path.name for path, text in texts.items() if any(start in text for start in starts)}
    assert found == {"ending.py", "solids.py"}, found  # the latter has the name of a pipe
