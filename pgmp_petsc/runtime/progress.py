"""A progress bar on rank 0 when a person is watching, silence otherwise."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from mpi4py import MPI

_quiet: ContextVar[bool] = ContextVar("quiet", default=False)


class Progress(Protocol):
    """What :func:`progress` returns: a context manager that counts."""

    def update(self, n: int = 1) -> object:
        """Count ``n`` further units of work as done."""

    def __enter__(self) -> Progress: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None: ...


class Silent:
    """A progress bar that shows nothing."""

    def update(self, n: int = 1) -> None:
        """Do nothing."""

    def __enter__(self) -> Silent:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None


def progress(total: int, description: str, comm: MPI.Comm) -> Progress:
    """Return a bar over ``total`` units of work; not collective.

    It is shown on rank 0 if stderr is a terminal; elsewhere (other ranks, batch jobs, pipes) nothing is
    printed.
    """
    if comm.rank > 0 or _quiet.get() or not sys.stderr.isatty():
        return Silent()
    from tqdm import tqdm

    return tqdm(total=total, desc=description, leave=False, dynamic_ncols=True, file=sys.stderr)


@contextmanager
def without_progress() -> Iterator[None]:
    """Show no bar within the block: its work is a small part of what a bar outside counts."""
    before = _quiet.set(True)
    try:
        yield
    finally:
        _quiet.reset(before)
