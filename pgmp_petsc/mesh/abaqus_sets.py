"""Sets of Abaqus files that meshio 5 would read wrongly without a word.

Its reader keeps the last of several cards for one set; it deals out the sets that ELEMENT cards name to the blocks of
cells by counting them, which is wrong once a card before has named none; and it does not tell which cells a set has
that is made from other sets.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pgmp_petsc.runtime.errors import InputError

SUFFIX = ".inp"


def check_sets(path: Path, received: str) -> None:
    """Refuse the sets of an Abaqus file that meshio would read wrongly; do nothing for other files.

    Parameters
    ----------
    path : Path
        A file that meshio has read.
    received : str
        The scene's entry and its value, with which messages begin.
    """
    if path.suffix.lower() != SUFFIX:
        return
    known, bare_element_card = set(), False
    for keyword, options, data in _cards(path):
        card = f'{received}: the set "{options.get("ELSET", options.get("NSET"))}"'
        if keyword == "ELEMENT" and "ELSET" not in options:
            bare_element_card = True
            continue
        sort = {"ELEMENT": "ELSET"}.get(keyword, keyword)
        name = (sort, options.get(sort, "").upper())
        if name in known:
            raise InputError(f"{card} is on several cards, of which meshio reads one; one {sort} card must list it")
        known.add(name)
        if keyword == "ELEMENT" and bare_element_card:
            raise InputError(
                f"{card} is on an ELEMENT card after one without ELSET, and meshio would read other cells for it; an "
                "ELSET card must list it, or each ELEMENT card name its own set"
            )
        if keyword != "ELEMENT" and not data.split(",")[0].strip().isdecimal() and data.strip():
            raise InputError(f"{card} is made from other sets, which meshio does not tell; its card must list numbers")


def _cards(path: Path) -> Iterator[tuple[str, dict[str, str], str]]:
    """Yield keyword, options and first line of data of the cards that hold elements or sets, names in capitals."""
    with path.open(encoding="utf-8", errors="replace") as file:
        card = None
        for line in file:
            if line.startswith("**") or not line.strip():
                continue
            if card is not None and not line.startswith("*"):
                yield (*card, line)
                card = None
            elif line.startswith("*"):
                if card is not None:
                    yield (*card, "")
                keyword, *words = (word.strip() for word in line[1:].split(","))
                options = {key.strip().upper(): value.strip() for key, _, value in (w.partition("=") for w in words)}
                card = (keyword.upper(), options) if keyword.upper() in ("ELEMENT", "ELSET", "NSET") else None
        if card is not None:
            yield (*card, "")
