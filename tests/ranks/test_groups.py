"""Groups of ranks, and failures that all of them agree on."""

import ast
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from refusals import refusal

from pgmp_petsc.base.errors import InputError
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


def groups(size: int, ranks_per_group: int) -> list[RankGroup]:
    """Return the group of every rank."""
    return [RankGroup.split(World(rank, size), ranks_per_group) for rank in range(size)]


@pytest.mark.parametrize(
    ("size", "ranks_per_group", "expected"),
    [
        (1, 1, [0]),
        (4, 1, [0, 1, 2, 3]),
        (4, 2, [0, 0, 1, 1]),
        (5, 2, [0, 0, 1, 1, 1]),
        (3, 2, [0, 0, 0]),
        (5, 5, [0] * 5),
    ],
)
def test_ranks_left_over_join_the_last_group(size: int, ranks_per_group: int, expected: list[int]) -> None:
    split = groups(size, ranks_per_group)
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


def test_communicators_are_freed(mpirun: Callable, parallel_scripts: Path) -> None:
    """MPI has a limited number of them, and a study makes some for every model."""
    handles = ast.literal_eval(mpirun(3, parallel_scripts / "communicators.py").stdout)
    assert len(handles) == 3 and all(before == after for before, after in handles)


RANKS = (1, 3)


def outcomes(mpirun, parallel_scripts, n: int, case: str) -> tuple[list[str], str]:
    """Return the line of every rank, and stderr."""
    done = mpirun(n, parallel_scripts / "agreement.py", case)
    lines = done.stdout.splitlines()
    assert len(lines) == n
    return lines, done.stderr


@pytest.mark.parametrize("n", RANKS)
def test_nothing_is_raised_where_no_rank_fails(mpirun, parallel_scripts, n):
    assert outcomes(mpirun, parallel_scripts, n, "fine")[0] == ["returned fine"] * n


@pytest.mark.parametrize("n", RANKS)
def test_an_error_of_one_rank_is_raised_on_all(mpirun, parallel_scripts, n):
    lines, _ = outcomes(mpirun, parallel_scripts, n, "one")
    assert lines == ["raised InputError 2: bodies.rod.mesh: no such file"] * n


@pytest.mark.parametrize("n", RANKS)
def test_the_lowest_failing_rank_decides(mpirun, parallel_scripts, n):
    lines, _ = outcomes(mpirun, parallel_scripts, n, "several")
    assert lines == [f"raised RunError 1: failed on {min(1, n - 1)}"] * n


@pytest.mark.parametrize("n", RANKS)
def test_an_unexpected_exception_names_activity_type_and_rank(mpirun, parallel_scripts, n):
    lines, stderr = outcomes(mpirun, parallel_scripts, n, "unexpected")
    message = f"raised RunError 1: eigenproblem 7 failed on rank {n - 1}: ZeroDivisionError: oops"
    assert lines == [message] * n
    assert stderr.count("Traceback") == 1
    assert "fail_with" in stderr and f"rank {n - 1}, eigenproblem 7" in stderr


@pytest.mark.parametrize("n", RANKS)
def test_an_error_that_cannot_be_pickled_keeps_its_message(mpirun, parallel_scripts, n):
    lines, _ = outcomes(mpirun, parallel_scripts, n, "unpicklable")
    assert {line.split(": ")[1] for line in lines} == {"diverged at 0.5"}
    assert all(line.split()[2] == "1:" for line in lines)


@pytest.mark.parametrize("n", RANKS)
def test_a_result_of_the_root_reaches_all(mpirun, parallel_scripts, n):
    assert outcomes(mpirun, parallel_scripts, n, "root")[0] == ["returned [1, 2, 3]"] * n


@pytest.mark.parametrize("n", RANKS)
def test_a_failure_of_the_root_reaches_all(mpirun, parallel_scripts, n):
    assert outcomes(mpirun, parallel_scripts, n, "root_fails")[0] == ["raised InputError 2: missing"] * n


def test_a_result_of_the_root_that_cannot_be_pickled_is_a_failure_of_all(mpirun, parallel_scripts):
    lines, _ = outcomes(mpirun, parallel_scripts, 3, "root_unpicklable")
    assert len(set(lines)) == 1 and "failed on rank 0" in lines[0]


def test_timings_are_the_maximum_over_ranks_of_every_phase(mpirun, parallel_scripts):
    lines, _ = outcomes(mpirun, parallel_scripts, 3, "timings")
    expected = [("all", 3.0), ("only 0", 0.5), ("only 1", 0.5), ("only 2", 0.5)]
    assert lines == [f"returned {expected}"] * 3
