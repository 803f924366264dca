"""Commands of click from declarations: words and options by the kinds of arguments, values as functions take them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import click
from click.shell_completion import CompletionItem

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, Command
from pgmp_petsc.cli.calls import run_command
from pgmp_petsc.cli.session import take_json, take_quiet
from pgmp_petsc.runtime.errors import InputError

QUIET = "Write nothing but errors and warnings on standard error."
PLUGIN = "Run a Python file that declares effects or outputs of your own; repeatable."
JSON = "Write the figures as JSON on standard output, and nothing else there."


class PathName(click.Path):
    """The path of a file or a folder; the function receives a Path.

    An empty word is refused, which is what a shell makes of a variable that nobody set: as a path it is the current
    folder, which no one asked for.
    """

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path of a word."""
        if not str(value):
            self.fail("it is empty; a name is needed, or . for the current folder", param, ctx)
        return super().convert(value, param, ctx)


class Whole(click.IntRange):
    """A whole number in a range; whatever else comes, the message says which numbers are allowed."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the number of a word."""
        try:
            number = int(value)
        except ValueError:
            _refuse(self, value, "whole number", param, ctx)
        return super().convert(number, param, ctx)


class Number(click.FloatRange):
    """A finite number in a range: click takes nan for one in every range, as it is neither below nor above an end."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number of a word."""
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            _refuse(self, value, "number", param, ctx)
        return super().convert(number, param, ctx)


def _refuse(
    kind: click.IntRange | click.FloatRange,
    value: object,
    what: str,
    param: click.Parameter | None,
    ctx: click.Context | None,
) -> NoReturn:
    """Refuse a word that is no number, with the range as click writes it: ``x>=2``, ``0<=x<=1``."""
    low, high = ("" if is_open else "=" for is_open in (kind.min_open, kind.max_open))
    shown = f"x>{low}{kind.min}" if kind.max is None else f"{kind.min}<{low}x<{high}{kind.max}"
    within = "" if kind.min is None else f" in the range {shown}"
    kind.fail(f"{str(value)!r} is not a {what}{within}", param, ctx)


class Declared(click.Command):
    """A command of a declaration."""

    def __init__(self, command: Command) -> None:
        self.declaration = command
        # words in the order of the function, then options, of which those of every command are the last
        parameters = [one for argument in command.arguments.values() for one in _parameters(argument, command)]
        words = [one for one in parameters if isinstance(one, click.Argument)]
        options = [one for one in parameters if isinstance(one, click.Option)]
        options.append(click.Option(["--plugin", "plugins"], multiple=True, metavar="FILE.py", type=PathName(), help=PLUGIN))
        if command.has_figures:
            options.append(_of_session("--json", JSON, take_json))
        options.append(_of_session("--quiet", QUIET, take_quiet))
        super().__init__(command.name, params=[*words, *options], help=command.description, callback=self._called)

    def _called(self, plugins: tuple[Path, ...], **values: object) -> None:
        context = click.get_current_context()
        if plugins:
            from pgmp_petsc.api.scenes import use  # few calls have some

            for file in plugins:
                use(file, comm=context.obj.comm)
        typed = {
            name: value
            for name, value in values.items()
            if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        }
        given = dict(_given(self.declaration.arguments, typed))
        run_command(context, self.declaration, given)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List names that an argument may be, with what each is."""
        for argument in self.declaration.arguments.values():
            if argument.listed is not None:
                with formatter.section(f"{argument.word.capitalize()}s"):
                    formatter.write_dl(list(argument.listed().items()))


def _of_session(option: str, text: str, take: Callable[..., None]) -> click.Option:
    return click.Option([option], is_flag=True, expose_value=False, callback=take, help=text)


def _parameters(argument: Argument, command: Command) -> Iterator[click.Parameter]:
    """Yield the words or options of an argument."""
    for value, text in argument.flags.items():
        yield click.Option([_flag(argument, value), f"--{value}"], is_flag=True, help=text)
    for part in argument.parts.values():
        yield from _parameters(part, command)
    if argument.flags or argument.parts:
        return
    name, kind = argument.name.replace(".", "_"), kind_of(argument)
    if not argument.options:
        n = -1 if argument.repeated else 1
        complete = None if argument.listed is None else _completing(argument.listed)
        metavar = argument.word + "..." * argument.repeated
        yield click.Argument([name], metavar=metavar, nargs=n, required=True, type=kind, shell_complete=complete)
        return
    text = command.spelled(argument.meaning) + " Repeatable." * argument.repeated
    options = [name, *argument.options]
    if argument.kinds == ("bool",):
        yield click.Option(options, is_flag=True, help=text)
        return
    more: dict[str, Any] = {} if argument.empty is None else {"is_flag": False, "flag_value": argument.empty}
    if isinstance(argument.default, (int, float)) and "." not in argument.name:
        more |= {"default": argument.default, "show_default": True}
    yield click.Option(
        options, metavar=None if isinstance(kind, click.Choice) else argument.word, type=kind, help=text,
        required=argument.required and "." not in argument.name, multiple=argument.repeated, **more,
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


def _flag(argument: Argument, value: str) -> str:
    return f"{argument.name}_{value}"


def _given(arguments: Mapping[str, Argument], typed: Mapping[str, object]) -> Iterator[tuple[str, object]]:
    """Yield what was given, as functions take it; raises `InputError`."""
    for name, argument in arguments.items():
        flags = [value for value in argument.flags if typed.get(_flag(argument, value))]
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
    """Return the object of which fields were given."""
    for key, part in argument.parts.items():
        if part.required and key not in known:
            words = " and ".join(f"{argument.parts[item].called} {value}" for item, value in known.items())
            why = f"for {argument.meaning[0].lower()}{argument.meaning[1:].rstrip('.')}"
            raise InputError(f"{words}: {why}; give {part.called} {part.word} too, or leave it out")
    read = {key: argument.parts[key].read or (lambda value: value) for key in known}
    return argument.made(**{key: read[key](value) for key, value in known.items()})

