"""Nodes, sets of nodes and elements of an Abaqus input file, with the numbers that its matrices are written in.

meshio's reader forgets these numbers and stops at elements that it does not know, whose matrices are of no less use.

Files with sets that it would read wrongly without a word are refused: it keeps the last of several cards for one set;
it deals out the sets that ELEMENT cards name to the blocks of cells by counting them, which is wrong once a card
before has named none; and it does not tell which cells a set has that is made from other sets.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import meshio
import numpy as np

from pgmp_petsc.runtime.errors import InputError

#: Types of cells by their family and their number of nodes; the order of nodes is meshio's.
FAMILIES = {
    "plane": {3: "triangle", 6: "triangle6", 4: "quad", 8: "quad8"},
    "solid": {4: "tetra", 10: "tetra10", 8: "hexahedron", 20: "hexahedron20"},
}
OF_TYPE = re.compile(r"(?:(CPS|CPE)|C3D)(\d+)")
OTHER = "vertex"  # of elements of other types, whose cells no one asks for


def read_abaqus_nodes(path: Path, received: str) -> tuple[meshio.Mesh, np.ndarray]:
    """Return what a file holds, and the numbers of its nodes, shape (n_nodes,).

    Raises `InputError` if it has no nodes, nodes of one number, or others in files that it includes; or if an element
    or a set names a node that is not there. `received` begins messages.
    """
    places: dict[int, list[float]] = {}
    sets: dict[str, list[int]] = {}
    cells: dict[str, list[list[int]]] = {}
    for keyword, options, lines in _cards(path):
        if keyword == "INCLUDE":
            raise InputError(f"{received}: it includes other files; one file with all nodes of the body is needed")
        if keyword == "NODE":
            own = [line.split(",") for line in lines]
            for label, *place in own:
                if int(label) in places:
                    raise InputError(f"{received}: node {int(label)} is there twice; the nodes of one body are needed")
                places[int(label)] = [float(x) if x.strip() else 0.0 for x in (*place, "", "", "")[:3]]
            if "NSET" in options:
                sets.setdefault(options["NSET"], []).extend(int(label) for label, *_ in own)
        elif keyword == "NSET":
            sets.setdefault(options.get("NSET", ""), []).extend(_members(lines, options, sets))
        elif keyword == "ELEMENT":
            kind = kind_of(options.get("TYPE", ""))
            numbers = [int(word) for line in lines for word in line.split(",") if word.strip()]
            n = n_nodes_of(kind)
            if kind != OTHER and n:
                if len(numbers) % (n + 1):
                    raise InputError(
                        f"{received}: elements of type {options['TYPE']} have {n} nodes each, not all here do"
                    )
                cells.setdefault(kind, []).extend(np.array(numbers).reshape(-1, n + 1)[:, 1:].tolist())
            else:
                cells.setdefault(OTHER, [])
    if not places:
        raise InputError(f"{received}: it has no nodes; a NODE card with all nodes of the body is needed")
    labels = np.array(list(places))
    at = {label: number for number, label in enumerate(places)}
    try:
        blocks = [(kind, np.array([[at[n] for n in cell] for cell in found])) for kind, found in cells.items() if found]
        point_sets = {name: np.array([at[n] for n in members], dtype=int) for name, members in sets.items()}
    except KeyError as error:
        raise InputError(f"{received}: an element or a set names node {error.args[0]}, which is not there") from error
    # cells beside ones of no known type would not be all of the body
    known = [] if OTHER in cells else blocks
    return meshio.Mesh(np.array(list(places.values())), known, point_sets=point_sets), labels


def kind_of(name: str) -> str:
    """Return meshio's type of the cells that an Abaqus element such as ``C3D20R`` has; `OTHER` if none is known."""
    found = OF_TYPE.match(name.upper())
    if found is None:
        return OTHER
    return FAMILIES["plane" if found[1] else "solid"].get(int(found[2]), OTHER)


def n_nodes_of(kind: str) -> int:
    """Return how many nodes a type of cells has; 0 of others."""
    return next((n for family in FAMILIES.values() for n, name in family.items() if name == kind), 0)


def _members(lines: list[str], options: dict[str, str], sets: dict[str, list[int]]) -> Iterator[int]:
    """Yield the nodes of a set: numbers, ranges, and other sets."""
    for line in lines:
        words = [word.strip() for word in line.split(",") if word.strip()]
        if "GENERATE" in options:
            first, last, *step = map(int, words)
            yield from range(first, last + 1, *step)
        else:
            for word in words:
                yield from sets[word] if word in sets else (int(word),)


def _cards(path: Path) -> Iterator[tuple[str, dict[str, str], list[str]]]:
    """Yield keyword, options and lines of data of every card."""
    card = None
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in map(str.strip, file):
            if not line or line.startswith("**"):
                continue
            if not line.startswith("*"):
                if card is not None:
                    card[2].append(line)
                continue
            if card is not None:
                yield card
            keyword, *words = (word.strip() for word in line[1:].split(","))
            options = {
                key.strip().upper(): value.strip().strip('"') for key, _, value in (w.partition("=") for w in words)
            }
            card = keyword.upper(), options, []
    if card is not None:
        yield card


SUFFIX = ".inp"
OF_SETS = ("ELEMENT", "ELSET", "NSET")  # cards that hold sets, or name one


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
    for keyword, options, lines in _cards(path):
        if keyword not in OF_SETS:
            continue
        data = lines[0] if lines else ""
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
