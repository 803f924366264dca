"""The Python interface, whose names `pgmp_petsc` hands on: scenes, reduced models, runs, results.

Every function is collective on its ``comm`` and raises the package's own errors (`InputError`, `RunError`) on all ranks
alike. Results are the same on all ranks.

Its functions and the commands are found by the heads of the modules in this room, which are read: modules are not
imported, so that neither `pgmp --help` nor ``import pgmp_petsc`` waits for what commands need.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOM = Path(__file__).parent
# the decorator at a function's head, whose first words are a command's name, its line of help and its place in lists
_HEAD = re.compile(
    r'^@(?:command\(\s*"(?P<name>\w+)",\s*"(?P<help>[^"]*)",\s*(?P<place>\d+)(?P<rest>.*?)|interface\(.*?)'
    r"^def (?P<function>\w+)",
    re.MULTILINE | re.DOTALL,
)
_PETSC = re.compile(r'\bpetsc=(?:(False)|"(\w+)")')


@dataclass(frozen=True)
class Found:
    """A function of the interface, as the head of its module has it."""

    #: module, function: where it is
    module: str
    function: str
    #: name, help, place, petsc: of its command; an empty name where it has none
    name: str
    help: str
    place: int
    petsc: bool | str


@cache
def found(room: Path = ROOM) -> tuple[Found, ...]:
    """Return all functions of the interface in a room, commands in the order of lists; no module is imported."""
    functions = []
    for path in sorted(room.glob("*.py")):
        for head in _HEAD.finditer(path.read_text(encoding="utf-8")):
            starts = _PETSC.search(head["rest"] or "")
            petsc = True if starts is None else starts[2] or False
            functions.append(
                Found(f"{__name__}.{path.stem}", head["function"], head["name"] or "", head["help"] or "",
                      int(head["place"] or 0), petsc)
            )  # fmt: skip
    return tuple(sorted(functions, key=lambda one: one.place))
