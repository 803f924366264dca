"""How a command calls the Python interface: what it asks for by its arguments, and what the interface says on the way.

A command's texts go on as they are. Its result is with the first rank alone, which prints it.

What a command is given besides its options: the ranks, and the options for PETSc.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pgmp_petsc.api.ranks import ABOUT, LOGGER, REMARK, RESULT, SCENE, WAY, petsc_is_seen_to
from pgmp_petsc.cli.report import say, say_figures, say_warning
from pgmp_petsc.runtime.claims import is_table
from pgmp_petsc.runtime.errors import Remark
from pgmp_petsc.runtime.petsc import petsc_runs, start_petsc

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.api.result import Result


class Call(logging.Handler):
    """A command's call of the interface.

    What the interface logs is printed until the command ends, but for remarks on results, which reports have.

    Parameters
    ----------
    context
        Of the command.
    output, settings, overrides
        What all commands have.

    Attributes
    ----------
    said
        Remarks that were printed.
    """

    def __init__(
        self,
        context: click.Context,
        output: Path | None,
        settings: tuple[str, ...] = (),
        overrides: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self._context, self._output, self.said = context, output, list[Remark]()
        self._changes = {"parameters": settings, "overrides": overrides} if settings or overrides else {}
        context.with_resource(self._heard())
        if petsc_runs():
            petsc_is_seen_to()

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments that functions of the interface have for it; the result is with the first rank alone."""
        return {**self._changes, "output": self._output, "on_all_ranks": False, "comm": self._context.obj.comm}

    def say(self, result: Result, report: Callable[..., str], name: Path | None = None) -> None:
        """Print a result that was made: its table, or its figures as JSON. Not collective.

        Parameters
        ----------
        report
            Gets the data, the name that stands for the result, and the remarks that were said.
        name
            Where there is no file.
        """
        if self._output is not None and is_table(self._output):
            lacking = "rows and columns alone; a file *.h5 has the scene, remarks, estimates and statistics too"
            say(self._context, f"{self._output}: {lacking}")
        if result.data is not None:
            say(self._context, report(result.data, self._output or name, self.said))
            say_figures(self._context, {"file": self._output, **result.summary()})

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record; an output that cannot be written is the command's failure."""
        about, remark = getattr(record, ABOUT, WAY), getattr(record, REMARK, None)
        if remark is not None:
            say_warning(self._context, remark)
        if about == SCENE:
            self.said.append(remark)
        if about != RESULT:
            say(self._context, f"  {record.getMessage()}" if about == SCENE else record.getMessage())

    @contextmanager
    def _heard(self) -> Iterator[None]:
        before = LOGGER.level, LOGGER.propagate
        LOGGER.addHandler(self)
        LOGGER.setLevel(logging.INFO)
        LOGGER.propagate = False
        try:
            yield
        finally:
            LOGGER.removeHandler(self)
            LOGGER.setLevel(before[0])
            LOGGER.propagate = before[1]


@dataclass
class Session:
    """One call of ``pgmp``; click's context object (``context.obj``).

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
        All ranks of the run.
    petsc_options : sequence of str
        What stood after ``--`` on the command line.
    quiet : bool
        Whether `cli.report.say` prints nothing.
    json : bool
        Whether the command prints its figures as JSON, and nothing else.

    Attributes
    ----------
    petsc_started : bool
        Whether PETSc was started for the command.
    """

    comm: MPI.Comm
    petsc_options: Sequence[str] = ()
    quiet: bool = False
    json: bool = False
    petsc_started: bool = field(default=False, init=False)

    def start_petsc(self) -> None:
        """Start PETSc with the user's options; anything that imports PETSc is imported after this."""
        start_petsc(self.petsc_options)
        self.petsc_started = True
