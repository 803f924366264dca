"""What a result's reader has to know besides its figures: warnings, and notes on what was left out and why.

A remark is printed where the result is made, kept in its file (root attribute ``remarks``) and printed again by ``pgmp
info``: what was not computed, not estimated, not converged or left out is said in all three places in the same words.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal


@dataclass(frozen=True)
class Remark:
    """One sentence about a result, with its reason and, where there is one, the cure.

    Parameters
    ----------
    kind
        ``warning`` where figures may be wrong or are worth less than they look, ``note`` where something is absent.
    text
        The sentence, without a full stop at its end.
    """

    kind: Literal["warning", "note"]
    text: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}"


def warning(text: str) -> Remark:
    """Return a remark that figures may be wrong or are worth less than they look."""
    return Remark("warning", text)


def note(text: str) -> Remark:
    """Return a remark that something is absent."""
    return Remark("note", text)


def to_json(remarks: Iterable[Remark]) -> str:
    """Return remarks as a JSON array of objects with ``kind`` and ``text``."""
    return json.dumps([asdict(remark) for remark in remarks])


def from_json(text: str) -> tuple[Remark, ...]:
    """Return what `to_json` wrote; raises `ValueError` where it is something else."""
    try:
        return tuple(Remark(str(entry["kind"]), str(entry["text"])) for entry in json.loads(text))
    except (KeyError, TypeError) as error:
        raise ValueError(f"remarks are no list of objects with kind and text: {error}") from error
