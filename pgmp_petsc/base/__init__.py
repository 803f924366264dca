"""What every room may use: errors, the surroundings of a process, progress, times and memory, ideas from outside.

Errors carry the exit status that a command ends with, and what a user is to read. Nothing here knows of mechanics, of
MPI or of files of results. Begin with `errors`, then `progress`.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

__version__ = "0.1.0"
#: Where colorama is installed numba colours its messages by it, and standard output ends with escape codes, JSON too.
PLAIN_NUMBA = "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING"

os.environ.setdefault(PLAIN_NUMBA, "1")


def given_by(room: str, names: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a room that gives `names` of its modules, which are imported when a name is asked
    for."""
    modules = {name: module for module, each in names.items() for name in each}

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module '{room}' has no attribute '{name}'")
        return getattr(import_module(f"{room}.{modules[name]}"), name)

    return get
