"""A command's call of the Python interface: what it asks for by its arguments, as options of click by the kinds of
these, and what it prints.

The interface logs what it does on the way, which goes on as it is. A result is with the first rank alone, which prints
its report, or its figures as JSON and nothing else.

One call of ``pgmp`` has its ranks, the options for PETSc, and whether it prints words, nothing, or JSON. A person at a
terminal sees colours of warnings and verdicts, texts of its width, and of a report the answer.
"""

from __future__ import annotations

import inspect
import json
import logging
import math
import os
import re
import shlex
import shutil
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any, TextIO

import click
from click.shell_completion import CompletionItem

from pgmp_petsc.api.arguments import Range, by_command_line
from pgmp_petsc.api.declared import Argument, Command
from pgmp_petsc.api.ranks import ABOUT, LOGGER, REMARK, RESULT, SCENE, WAY, petsc_is_seen_to
from pgmp_petsc.base.errors import InputError, Remark, RunError, visible
from pgmp_petsc.base.progress import doing, without_progress
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.files.claims import is_table
from pgmp_petsc.ranks.agreement import on_root
from pgmp_petsc.ranks.petsc import petsc_runs, start_petsc
from pgmp_petsc.results.summary import json_text


@dataclass
class Session:
    """One call of ``pgmp``; click's context object (``context.obj``)."""

    comm: Comm  # all ranks of the run
    petsc_options: Sequence[str] = ()  # what stood after ``--`` on the command line
    quiet: bool = False  # whether `say` prints nothing
    json: bool = False  # whether the command prints its figures as JSON, and nothing else
    verbose: bool = False  # whether a terminal shows all of a report
    began: float = field(default_factory=monotonic)  # when it was called, s
    petsc_started: bool = field(default=False, init=False)  # whether PETSc was started for the command

    def start_petsc(self) -> None:
        """Start PETSc with the user's options; anything that imports PETSc is imported after this."""
        start_petsc(self.petsc_options)
        self.petsc_started = True


def say(context: click.Context, text: str) -> None:
    """Print ``text`` on rank 0, at once, unless the session is quiet; not collective."""
    if context.obj.comm.rank == 0 and not context.obj.quiet:
        click.echo(for_terminal(text, False) if at_terminal() else text)


#: What is coloured in lines, and how.
_COLOURS = (
    (re.compile(rb"(?m)^(pgmp: )?error:"), {"fg": "red", "bold": True}),
    (re.compile(rb"(?m)^ *(pgmp: )?warning:|not decided by this model|NOT MET|\b[1-9]\d* failed"), {"fg": "yellow"}),
    (re.compile(rb"(?m)^ *note:"), {"dim": True}),
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
            lines = words.sub(lambda found: click.style(found[0].decode(errors="replace"), **look).encode(), lines)
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
    with by_command_line(session.began):
        function = command.function if command.choose is None else command.choose(arguments, session.comm)
        named = command.given_to(function, arguments)
        _refuse_incomplete(command, function, named)
        own = {"comm": session.comm, "on_all_ranks": False}
        own = {name: value for name, value in own.items() if name in inspect.signature(function).parameters}
        try:
            with doing(command.name):
                result = function(**named, **own)
        except RunError as stopped:
            if getattr(stopped, "result", None) is not None:
                _say_result(context, command, stopped.result, arguments, shell, said)
            raise
        _say_result(context, command, result, arguments, shell, said)
        status = None
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
        if session.json or not at_terminal():
            click.echo(text)
            return
        click.echo(for_terminal(text, bool(command.then) and not session.verbose))
        if command.then and output is not None and not is_table(output):
            click.echo(f"next: {command.then.format(file=shlex.quote(str(output)))}")


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


QUIET = "Write nothing but errors and warnings on standard error."
PLUGIN = "Run a Python file with effects, joints, outputs, controllers or sections of your own; repeatable."
VERBOSE = "Print all figures at a terminal too; elsewhere they are always printed."
JSON = "Write the figures as JSON on standard output, and nothing else there."


class PathName(click.Path):
    """The path of a file or a folder; the function receives a Path.

    An empty word is refused, which is what a shell makes of a variable that nobody set: as a path it is the current
    folder, which no one asked for.
    """

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        if not str(value):
            self.fail("it is empty; a name is needed, or . for the current folder", param, ctx)
        return super().convert(value, param, ctx)


class Whole(click.IntRange):
    """A whole number in a range; whatever else comes, the message says which numbers are allowed."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
        return super().convert(_number(int, "whole number", self, value, param, ctx), param, ctx)


class Number(click.FloatRange):
    """A finite number in a range: click takes nan for one in every range, as it is neither below nor above an end."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        return super().convert(_number(float, "number", self, value, param, ctx), param, ctx)


def _number(
    read: Callable[[object], Any], what: str, kind: click.IntRange | click.FloatRange, value: object, *at: Any
) -> Any:
    """Return a word's number; refuse one that is none, with the range as click writes it: ``x>=2``, ``0<=x<=1``."""
    with suppress(ValueError):
        number = read(value)
        if abs(number) < math.inf:
            return number
    low, high = ("" if is_open else "=" for is_open in (kind.min_open, kind.max_open))
    shown = f"x>{low}{kind.min}" if kind.max is None else f"{kind.min}<{low}x<{high}{kind.max}"
    within = "" if kind.min is None else f" in the range {shown}"
    kind.fail(f"{str(value)!r} is not a {what}{within}", *at)


class Declared(click.Command):
    """A command of a declaration."""

    def __init__(self, command: Command) -> None:
        self.declaration = command
        # words in the order of the function, then options, of which those of every command are the last
        parameters = [one for argument in command.arguments.values() for one in _parameters(argument, command)]
        words = [one for one in parameters if isinstance(one, click.Argument)]
        options = [one for one in parameters if isinstance(one, click.Option)]
        options.append(
            click.Option(["--plugin", "plugins"], multiple=True, metavar="FILE.py", type=PathName(), help=PLUGIN)
        )
        own = {
            "--json": JSON if command.has_figures else "",
            "--verbose": VERBOSE if command.then else "",
            "--quiet": QUIET,
        }
        options += [click.Option([name], is_flag=True, help=text) for name, text in own.items() if text]
        super().__init__(command.name, params=[*words, *options], help=command.description, callback=self._called)

    def _called(
        self, plugins: tuple[Path, ...], quiet: bool, json: bool = False, verbose: bool = False, **values: object
    ) -> None:
        context = click.get_current_context()
        session = context.obj
        session.json, session.verbose, session.quiet = json, verbose, session.quiet or quiet or json
        if quiet:
            context.with_resource(without_progress())
        if plugins:
            from pgmp_petsc.api.scenes import use  # few calls have some

            for file in plugins:
                use(file, comm=session.comm)
        typed = {
            name: value
            for name, value in values.items()
            if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        }
        given = dict(_given(self.declaration.arguments, typed))
        if self.declaration.ending is not None and "output" not in given:
            given["output"] = self.declaration.file_of(given)
        run_command(context, self.declaration, given)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List names that an argument may be, with what each is."""
        for argument in self.declaration.arguments.values():
            if argument.listed is not None:
                with formatter.section(f"{argument.word.capitalize()}s"):
                    formatter.write_dl(list(argument.listed().items()))


def _parameters(argument: Argument, command: Command) -> Iterator[click.Parameter]:
    for value, text in argument.flags.items():
        yield click.Option([f"{argument.name}_{value}", f"--{value}"], is_flag=True, help=text)
    for part in argument.parts.values():
        yield from _parameters(part, command)
    if argument.flags or argument.parts:
        return
    name, kind = argument.name.replace(".", "_"), kind_of(argument)
    if not argument.options:
        n = -1 if argument.repeated else 1
        complete = None if argument.listed is None else _completing(argument.listed)
        metavar = argument.word + "..." * argument.repeated
        metavar = metavar if argument.required else f"[{metavar}]"
        required = argument.required
        yield click.Argument([name], metavar=metavar, nargs=n, required=required, type=kind, shell_complete=complete)
        return
    text = command.spelled(argument.meaning) + " Repeatable." * argument.repeated
    options = [name, *argument.options]
    complete = _completing_parameters if argument.name == "parameters" else None
    if argument.kinds == ("bool",):
        yield click.Option(options, is_flag=True, help=text)
        return
    more: dict[str, Any] = {} if argument.empty is None else {"is_flag": False, "flag_value": argument.empty}
    if isinstance(argument.default, (int, float)) and "." not in argument.name:
        more |= {"default": argument.default, "show_default": True}
    yield click.Option(
        options, metavar=None if isinstance(kind, click.Choice) else argument.word, type=kind, help=text,
        required=argument.required and "." not in argument.name, multiple=argument.repeated, shell_complete=complete,
        **more,
    )  # fmt: skip


def kind_of(argument: Argument) -> click.ParamType:
    """Return what click takes for an argument."""
    limits, text = argument.allowed, " ".join(argument.kinds)
    if argument.read is not None and argument.empty is None:
        return click.STRING
    if "PathLike[str]" in text:
        return PathName()
    if isinstance(limits, tuple):
        return click.Choice(limits)
    for name, number in (("int", Whole), ("float", Number)):
        if name in argument.kinds:
            return number(limits.least, limits.most, min_open=limits.above) if isinstance(limits, Range) else number()
    return click.STRING


def _completing(listed: Callable[[], Mapping[str, str]]) -> Callable[..., list[CompletionItem]]:
    def complete(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
        return [CompletionItem(name, help=about) for name, about in listed().items() if name.startswith(begun)]

    return complete


def _completing_parameters(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete ``NAME=`` by the parameters of the scene, the model or the result that the command line names."""
    found: dict[str, Any] = {}
    for file in filter(Path.is_file, map(Path, context.args)):  # click leaves words there where an option has no value
        with suppress(OSError, ValueError, LookupError, TypeError, AttributeError):  # no scene and no result has none
            if file.suffix == ".toml":
                entries = tomllib.loads(file.read_text(encoding="utf-8")).get("parameters", {})
                found |= {name: entry.get("nominal", "") for name, entry in entries.items()}
            else:
                from h5py import File  # takes a noticeable time, and scenes do without

                with File(file) as opened:
                    found |= json.loads(opened.attrs["parameters"])
    return [CompletionItem(f"{name}=", help=f"{value}") for name, value in found.items() if name.startswith(begun)]


def _given(arguments: Mapping[str, Argument], typed: Mapping[str, object]) -> Iterator[tuple[str, object]]:
    """Yield what was given, as functions take it; raises `InputError`."""
    for name, argument in arguments.items():
        flags = [value for value in argument.flags if typed.get(f"{name}_{value}")]
        if len(flags) > 1:
            options = " and ".join(f"--{value}" for value in flags)
            raise InputError(f"{options}: two {name}s; give one of them, or run the command twice")
        if flags:
            yield name, flags[0]
        if argument.parts:
            fields = {part.name.rpartition(".")[2]: part for part in argument.parts.values()}
            known = {key: typed[f"{name}_{key}"] for key in fields if f"{name}_{key}" in typed}
            if known:
                yield name, _made(argument, known)
        elif name in typed:
            value = typed[name]
            yield name, value if argument.read is None else argument.read(value)


def _made(argument: Argument, known: Mapping[str, object]) -> object:
    for key, part in argument.parts.items():
        if part.required and key not in known:
            words = " and ".join(f"{argument.parts[item].called} {value}" for item, value in known.items())
            why = f"for {argument.meaning[0].lower()}{argument.meaning[1:].rstrip('.')}"
            raise InputError(f"{words}: {why}; give {part.called} {part.word} too, or leave it out")
    read = {key: argument.parts[key].read or (lambda value: value) for key in known}
    return argument.made(**{key: read[key](value) for key, value in known.items()})
