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


def silent(rank: int = 0) -> bool:
    """Return whether a bar of this rank would show nothing."""
    return isinstance(progress(3, "samples", Rank(rank)), Silent)


def test_a_bar_is_shown_on_rank_0_where_a_person_is_watching(monkeypatch: pytest.MonkeyPatch) -> None:
    assert silent()
    # not in a fixture: pytest puts its own streams in place between set-up and test
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert not silent() and silent(rank=1)


def test_parts_of_what_a_bar_counts_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress(3, "settings", Rank(0)) as bar, without_progress():
        assert silent()
        bar.update()
    assert not silent(), "it ends with the block"
