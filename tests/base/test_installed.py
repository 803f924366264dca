"""What this Python has of MPI and PETSc, and one rank in place of a communicator."""

from collections.abc import Callable

import numpy as np
import pytest
from mpi4py import MPI
from refusals import assert_refused

from pgmp_petsc.base import surroundings
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.resources import free_share
from pgmp_petsc.base.surroundings import (
    OneRank,
    alone,
    has_mpi,
    has_petsc,
    is_communicator,
    missing,
    needs_petsc,
    refuse_ranks,
)
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import RankGroup, deal, first_ranks


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nothing be found."""
    monkeypatch.setattr(surroundings, "_is_there", lambda name: False)


def test_here_everything_is_there() -> None:
    assert missing() == () and has_petsc() and has_mpi() and alone() == MPI.COMM_SELF
    needs_petsc("tests")
    assert not surroundings._is_there("no_such_package") and surroundings._is_there("petsc4py")
    assert is_communicator(MPI.COMM_SELF) and not is_communicator(MPI.COMM_NULL) and not is_communicator(OneRank())


def test_without_them_one_rank_takes_their_place(bare: None) -> None:
    assert missing() == ("petsc4py", "slepc4py", "mpi4py") and not has_petsc() and not has_mpi()
    assert isinstance(alone(), OneRank) and is_communicator(alone()) and not is_communicator(3)
    with pytest.raises(SystemExit, match="3"):
        OneRank().Abort(3)


@pytest.mark.parametrize("absent", ["petsc4py", "slepc4py", "mpi4py"])
def test_one_that_is_missing_is_named(absent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """PETSc takes communicators of mpi4py: without it there is no use for the others."""
    monkeypatch.setattr(surroundings, "_is_there", lambda name: name != absent)
    assert not has_petsc() and has_mpi() is (absent != "mpi4py")
    assert_refused(f"^models need PETSc and SLEPc, and .* has no {absent}; .*docs/without_petsc", needs_petsc, "models")


def test_processes_that_were_started_together_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them; the first one alone says why."""
    for name in (*surroundings.SIZES, *surroundings.NUMBERS):
        monkeypatch.delenv(name, raising=False)
    refuse_ranks()
    monkeypatch.setenv("PMI_SIZE", "1")
    refuse_ranks()
    monkeypatch.setenv("PMI_SIZE", "2")
    monkeypatch.setenv("PMI_RANK", "1")
    assert_refused("^$", refuse_ranks)
    monkeypatch.setenv("PMI_RANK", "0")
    assert_refused("^2 processes were started together, .* start one, or install mpi4py$", refuse_ranks)


ASKED: dict[str, Callable] = {
    "rank": lambda comm: (comm.rank, comm.size), "bcast": lambda comm: comm.bcast({"a": 1}, root=0),
    "gather": lambda comm: comm.gather((1, 2)), "allgather": lambda comm: comm.allgather("x"),
    "allreduce": lambda comm: comm.allreduce(2.5),
    "sum of arrays": lambda comm: comm.allreduce(np.arange(3.0)).tolist(),
    "Split": lambda comm: comm.Split(color=3, key=comm.rank).size, "Dup": lambda comm: comm.Dup().rank,
    "on_root": lambda comm: on_root(comm, max, 3, 4), "agreed": lambda comm: _message(comm),
    "deal": lambda comm: _dealt(comm), "groups": lambda comm: _groups(comm),
    "memory": lambda comm: free_share(comm) is None,
}  # fmt: skip


@pytest.mark.parametrize("what", ASKED)
def test_one_rank_answers_as_mpi_does(what: str) -> None:
    assert ASKED[what](OneRank()) == ASKED[what](MPI.COMM_SELF)


def _message(comm: OneRank) -> str:
    with pytest.raises(InputError) as raised, agreed(comm, "a test"):
        raise InputError("no")
    return str(raised.value)


def _dealt(comm: OneRank) -> list:
    taken: list = []

    def work(number: int, pulse: Callable) -> int:
        pulse()
        return number**2

    deal(comm, 4, work, lambda number, result: taken.append((number, result)))
    return taken


def _groups(comm: OneRank) -> tuple:
    with RankGroup.split(comm, 1) as group, first_ranks(comm, 1) as first:
        return group.index, group.count, group.comm.size, group.roots.size, first.size, list(group.arc(5))
