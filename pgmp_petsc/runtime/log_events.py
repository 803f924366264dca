"""Named events for PETSc's own log: ``pgmp ... -- -log_view`` shows what an effect takes of a run.

An event exists from its first use on: what a scene does not name never appears.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache


@cache
def log_event(name: str) -> AbstractContextManager:
    """Return the event ``pgmp_<name>``, to be entered with ``with``."""
    from petsc4py import PETSc

    return PETSc.Log.Event(f"pgmp_{name}")
