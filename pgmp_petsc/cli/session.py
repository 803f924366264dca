"""One call of ``pgmp``: its ranks, the options for PETSc, and whether it prints words, nothing, or JSON.

What a person at a terminal sees: colours of warnings and verdicts, texts of its width, and of a report the answer.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TextIO

import click

from pgmp_petsc.base.progress import without_progress
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.ranks.petsc import start_petsc


@dataclass
class Session:
    """One call of ``pgmp``; click's context object (``context.obj``)."""

    comm: Comm  # all ranks of the run
    petsc_options: Sequence[str] = ()  # what stood after ``--`` on the command line
    quiet: bool = False  # whether `say` prints nothing
    json: bool = False  # whether the command prints its figures as JSON, and nothing else
    verbose: bool = False  # whether a terminal shows all of a report
    petsc_started: bool = field(default=False, init=False)  # whether PETSc was started for the command

    def start_petsc(self) -> None:
        """Start PETSc with the user's options; anything that imports PETSc is imported after this."""
        start_petsc(self.petsc_options)
        self.petsc_started = True


def say(context: click.Context, text: str) -> None:
    """Print ``text`` on rank 0, at once, unless the session is quiet; not collective."""
    if context.obj.comm.rank == 0 and not context.obj.quiet:
        click.echo(for_terminal(text, False) if at_terminal() else text)


def take_json(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    """Take ``--json``."""
    if wanted:
        context.obj.json = context.obj.quiet = True


def take_verbose(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    """Take ``--verbose``."""
    if wanted:
        context.obj.verbose = True


#: What is coloured in lines, and how.
_COLOURS = (
    (re.compile(rb"^(pgmp: )?error:"), {"fg": "red", "bold": True}),
    (re.compile(rb"^ *(pgmp: )?warning:|not decided by this model|NOT MET|\b[1-9]\d* failed"), {"fg": "yellow"}),
    (re.compile(rb"^ *note:"), {"dim": True}),
    (re.compile(rb"P\([^()]*\)\s+=\s[^;\]]*\]"), {"fg": "green"}),
)
_KEPT = re.compile(r"^ *warning:|not decided by this model|NOT MET|\d failed")  # of what a terminal shows in short


def at_terminal() -> bool:
    """Return whether a person looks: mpirun gives its ranks a terminal for standard output alone, also for logs."""
    return all(stream is not None and stream.isatty() for stream in (sys.stdout, sys.stderr))


def painter(is_terminal: bool) -> Callable[[bytes], bytes] | None:
    """Return what colours lines for a terminal; None where there is none, or who reads wants none (``NO_COLOR``)."""
    if not is_terminal or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return None

    def paint(lines: bytes) -> bytes:
        for words, look in _COLOURS:
            multiline = re.compile(words.pattern, re.MULTILINE)
            lines = multiline.sub(lambda found: click.style(found[0].decode(errors="replace"), **look).encode(), lines)
        return lines

    return paint


def complain(text: str, stream: TextIO) -> None:
    """Write a message to standard error, at once."""
    line = f"{text}\n"
    paint = painter(stream.isatty())
    stream.write(line if paint is None else paint(line.encode()).decode())
    stream.flush()


def for_terminal(text: str, brief: bool) -> str:
    """Return a report for a terminal: prose within its width and, where `brief`, the first line and warnings alone."""
    width = shutil.get_terminal_size().columns
    first, *rest = text.splitlines() or [""]
    kept = [line for line in rest if _KEPT.search(line)] if brief else rest
    if len(kept) < len(rest):
        kept.append(f"  {len(rest) - len(kept)} more lines of figures and notes: --verbose")
    return "\n".join([_wrapped(first, width), *(_wrapped(line, width) for line in kept)])


def _wrapped(line: str, width: int) -> str:
    """Return a line of prose in as many lines as it takes; a table's rows stay as they are."""
    indent = len(line) - len(line.lstrip())
    is_row = indent and not re.match(r" *(note|warning):", line)
    return line if is_row else click.wrap_text(line, width, "", " " * (indent + 2))


def take_quiet(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    """Take ``--quiet``."""
    if wanted:
        context.obj.quiet = True
        context.with_resource(without_progress())
