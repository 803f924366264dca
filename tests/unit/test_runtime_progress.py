"""The progress bar: on rank 0 with a terminal, and one at a time."""

from __future__ import annotations

import io
import sys
from dataclasses import dataclass

import pytest

from pgmp_petsc.runtime.progress import Silent, progress, without_progress


@dataclass
class Rank:
    """What a bar asks of a communicator."""

    rank: int


class Terminal(io.StringIO):
    """A stream that a person watches."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


def test_a_bar_counts_on_rank_0_where_a_person_is_watching(terminal: Terminal) -> None:
    with progress(3, "samples", Rank(0)) as bar:
        assert not isinstance(bar, Silent)
        bar.update()
    assert isinstance(progress(3, "samples", Rank(1)), Silent)


def test_without_a_terminal_there_is_none() -> None:
    assert isinstance(progress(3, "samples", Rank(0)), Silent)


def test_parts_of_what_a_bar_counts_have_none(terminal: Terminal) -> None:
    with progress(3, "settings", Rank(0)) as bar, without_progress():
        assert isinstance(progress(48, "eigenproblems", Rank(0)), Silent)
        bar.update()
    assert not isinstance(progress(3, "samples", Rank(0)), Silent), "it ends with the block"
