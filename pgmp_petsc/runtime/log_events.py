"""Named events for PETSc's own log: ``pgmp ... -- -log_view`` shows what an effect takes of a run.

An event exists from its first use on: what a scene does not name never appears.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from functools import cache

from pgmp_petsc.runtime.installed import has_petsc


@cache
def log_event(name: str) -> AbstractContextManager:
    """Return the event ``pgmp_<name>``, to be entered with ``with``; without PETSc nobody takes note of it."""
    if not has_petsc():
        return nullcontext()
    from petsc4py import PETSc

    return PETSc.Log.Event(f"pgmp_{name}")
