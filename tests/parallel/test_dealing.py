"""Pieces are worked off once each, whoever does it, and a failure is one of all ranks."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

FINE = {"none": 0, "few": 2, "many": 25, "unequal": 41, "large": 12, "groups": 25}
FAILING = dict.fromkeys(("one fails", "a group fails"), "RunError: piece 7 failed")
FAILING["the writing fails"] = "RunError: the disk is full"


@pytest.fixture(scope="module")
def said(mpirun: Callable, parallel_scripts: Path) -> Callable[[int, str], list[str]]:
    """Return a function that gives what the ranks said of a case; all cases of one number of ranks are one run."""

    def lines(n: int, case: str) -> list[str]:
        if n not in done:
            printed = mpirun(n, parallel_scripts / "dealing.py", *FINE, *FAILING).stdout
            done[n] = [line.split("|") for line in printed.splitlines()]
        return [text for name, _, text in done[n] if name == case]

    done: dict[int, list[list[str]]] = {}
    return lines


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("case", FINE)
def test_every_piece_is_computed_once_and_taken_in_by_the_first_rank(said: Callable, n: int, case: str) -> None:
    texts = said(n, case)
    assert len(texts) == n
    computed, taken = zip(*(re.fullmatch(r"computed \[(.*)\] took \[(.*)\]", text).groups() for text in texts))
    everything, groups = list(range(FINE[case])), 2 if case == "groups" and n > 1 else 1
    assert [int(k) for k in taken[0].split(",") if k] == everything and not any(taken[1:])
    by_groups = sorted(int(k) for part in computed for k in part.split(",") if k)
    if groups == 1:
        assert by_groups == everything
    else:  # both ranks of a group compute a piece, three where one is left over
        assert sorted(set(by_groups)) == everything and len(by_groups) >= 2 * len(everything)


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("case", FAILING)
def test_a_failure_is_that_of_all_ranks(said: Callable, n: int, case: str) -> None:
    assert said(n, case) == [FAILING[case]] * n


def test_pieces_go_to_whoever_is_ready(said: Callable) -> None:
    """Every tenth one takes twenty times as long: who has one of these gets fewer of the others."""
    counts = [len(re.search(r"computed \[(.*?)\]", text)[1].split(",")) for text in said(2, "unequal")]
    assert sum(counts) == FINE["unequal"] and min(counts) >= 2
