"""A command's call of the Python interface: what it asks for by its arguments, and what it prints.

The interface logs what it does on the way, which goes on as it is. A result is with the first rank alone, which prints
its report, or its figures as JSON and nothing else.
"""

from __future__ import annotations

import inspect
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import click

from pgmp_petsc.api.arguments import by_command_line
from pgmp_petsc.api.declared import Command
from pgmp_petsc.api.ranks import ABOUT, LOGGER, REMARK, RESULT, SCENE, WAY, petsc_is_seen_to
from pgmp_petsc.cli.session import say
from pgmp_petsc.results.summary import json_text
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import is_table
from pgmp_petsc.runtime.errors import InputError, Remark, RunError, visible
from pgmp_petsc.runtime.petsc import petsc_runs


def run_command(context: click.Context, command: Command, given: Mapping[str, Any]) -> None:
    """Call a command's function with what was given, print its result, and end with its status. Collective."""
    session = context.obj
    if isinstance(command.petsc, str) and command.petsc in given:
        session.start_petsc()
    said = context.with_resource(_Heard(context).heard())
    if petsc_runs():
        petsc_is_seen_to()
    shell = {name: given.get(name, False) for name in command.shell}
    arguments = {name: value for name, value in given.items() if name not in shell}
    with by_command_line():
        function = command.function if command.choose is None else command.choose(arguments, session.comm)
        named = command.given_to(function, arguments)
        _refuse_incomplete(command, function, named)
        own = {"comm": session.comm, "on_all_ranks": False}
        own = {name: value for name, value in own.items() if name in inspect.signature(function).parameters}
        try:
            result = function(**named, **own)
        except RunError as stopped:
            if getattr(stopped, "result", None) is not None:
                _say_result(context, command, stopped.result, arguments, shell, said)
            raise
        _say_result(context, command, result, arguments, shell, said)
        status = 0
        if command.status is not None:
            status = on_root(session.comm, lambda: command.status(getattr(result, "data", result), **shell))
    if status:
        context.exit(status)


def _refuse_incomplete(command: Command, function: Any, given: Mapping[str, Any]) -> None:
    """Refuse what was given for another function of the command, or is not there for this one."""
    known = command.arguments
    for name in given:
        if name not in function.declared:
            raise InputError(f"{known[name].called}: it has no part here; leave it out")
    for name, argument in function.declared.items():
        if name not in given and inspect.signature(function).parameters[name].default is inspect.Parameter.empty:
            raise InputError(f"{argument.called}: missing; {command.spelled(argument.meaning)}")


def _say_result(
    context: click.Context, command: Command, result: Any, given: Mapping[str, Any], shell: Mapping[str, Any],
    said: Sequence[Remark],
) -> None:  # fmt: skip
    """Print the report of a result, or its figures as JSON. Collective."""
    if command.report is None:
        return
    session, output = context.obj, given.get("output")
    if output is not None and is_table(output):
        lacking = "rows and columns alone; a file *.h5 has the scene, remarks, estimates and statistics too"
        say(context, f"{output}: {lacking}")

    def describing_the_result() -> str:
        if not session.json:
            name = given.get(command.about) if output is None else output
            return command.report(getattr(result, "data", result), name, said, **shell)
        file = {"file": output} if "output" in command.arguments else {}
        return json_text(file | dict(command.figures(result, **shell)))

    text = "" if session.quiet and not session.json else on_root(session.comm, describing_the_result)
    if text and session.comm.rank == 0:
        click.echo(text)


class _Heard(logging.Handler):
    """Prints what the interface logs, but for remarks on results, which reports have."""

    def __init__(self, context: click.Context) -> None:
        super().__init__()
        self._context, self._said = context, list[Remark]()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record; an output that cannot be written is the command's failure."""
        about, remark = getattr(record, ABOUT, WAY), getattr(record, REMARK, None)
        session = self._context.obj
        if remark is not None and session.quiet and session.comm.rank == 0 and remark.kind == "warning":
            click.echo(visible(f"pgmp: {remark}"), err=True)
        if about == SCENE:
            self._said.append(remark)
        if about != RESULT:
            say(self._context, f"  {record.getMessage()}" if about == SCENE else record.getMessage())

    @contextmanager
    def heard(self) -> Iterator[list[Remark]]:
        """Listen within the block; yield the remarks that were printed."""
        before = LOGGER.level, LOGGER.propagate
        LOGGER.addHandler(self)
        LOGGER.setLevel(logging.INFO)
        LOGGER.propagate = False
        try:
            yield self._said
        finally:
            LOGGER.removeHandler(self)
            LOGGER.setLevel(before[0])
            LOGGER.propagate = before[1]
