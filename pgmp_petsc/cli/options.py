"""Options that several commands share.

The options that name a model: that of a ROM.h5, or of a SCENE the full-order or the component model.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import NoReturn, TypeVar

import click

from pgmp_petsc.runtime.errors import InputError

Command = TypeVar("Command", bound=Callable[..., object])


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
    kind.fail(f"{str(value)!r} is not a {what} in the range {shown}", param, ctx)


def scene_options(command: Command) -> Command:
    """Add the repeatable ``--set NAME=VALUE`` and ``--override KEY=VALUE``.

    The function receives ``settings`` and ``overrides``, tuples of str as they were typed, which
    :func:`pgmp_petsc.scene.loading.load_scene` takes and checks.
    """
    command = click.option(
        "--override",
        "overrides",
        multiple=True,
        metavar="KEY=VALUE",
        help="Replace the scene's entry with dotted key KEY by a TOML value; repeatable.",
    )(command)
    return click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="NAME=VALUE",
        help="Set parameter NAME to a number, SI units; repeatable.",
    )(command)


def files_argument(command: Command) -> Command:
    """Add the names of one or more files; the function receives ``files`` (tuple of Path)."""
    path = PathName()
    return click.argument("files", nargs=-1, required=True, metavar="FILE...", type=path)(command)


def output_option(command: Command) -> Command:
    """Add the required ``-o/--output FILE``; the function receives ``output`` (Path)."""
    return click.option(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        type=PathName(),
        help="File to write; it replaces an older one when it is complete.",
    )(command)


def ranks_per_angle_option(command: Command) -> Command:
    """Add ``--ranks-per-angle N``; the function receives ``ranks_per_angle`` (int)."""
    return click.option(
        "--ranks-per-angle",
        default=1,
        show_default=True,
        metavar="N",
        type=Whole(min=1),
        help="Ranks that share one eigenproblem; more than one where a rank's memory is too small.",
    )(command)


def with_plugins(command: click.Command) -> click.Command:
    """Add the repeatable ``--plugin FILE.py`` to a command: what the files declare is known before it begins."""
    if any(parameter.name == "plugins" for parameter in command.params):
        return command
    of_command = command.callback

    @wraps(of_command)
    def with_them(*arguments: object, plugins: tuple[Path, ...], **options: object) -> object:
        if plugins:
            from pgmp_petsc.api.scenes import use  # few calls have some

            for file in plugins:
                use(file, comm=click.get_current_context().obj.comm)
        return of_command(*arguments, **options)

    command.callback = with_them
    told = "Run a Python file that declares effects or outputs of your own; repeatable."
    file_name = PathName()
    command.params.append(
        click.Option(["--plugin", "plugins"], multiple=True, metavar="FILE.py", type=file_name, help=told)
    )
    return command


def model_options(command: Command) -> Command:
    """Add ``--full`` and ``--components``; the function receives both (bool)."""
    components = "Take the component model of a SCENE: flexible bodies in floating frames."
    command = click.option("--components", is_flag=True, help=components)(command)
    return click.option("--full", is_flag=True, help="Take the full-order model of a SCENE.")(command)


def one_model(full: bool, components: bool) -> None:
    """Refuse two models at once."""
    if full and components:
        raise InputError("--full and --components: two models; give one of them, or run the command twice")


def model_of(full: bool, components: bool) -> str | None:
    """Return what the interface calls the model that the options ask for; None is that of a ROM.h5."""
    return "full" if full else "components" if components else None
