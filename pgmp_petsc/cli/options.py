"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., object])


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
    path = click.Path(path_type=Path)
    return click.argument("files", nargs=-1, required=True, metavar="FILE...", type=path)(command)


def output_option(command: Command) -> Command:
    """Add the required ``-o/--output FILE``; the function receives ``output`` (Path)."""
    return click.option(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        type=click.Path(path_type=Path),
        help="File to write; it replaces an older one when it is complete.",
    )(command)


def ranks_per_angle_option(command: Command) -> Command:
    """Add ``--ranks-per-angle N``; the function receives ``ranks_per_angle`` (int)."""
    return click.option(
        "--ranks-per-angle",
        default=1,
        show_default=True,
        metavar="N",
        type=click.IntRange(min=1),
        help="Ranks that share one eigenproblem; more than one where a rank's memory is too small.",
    )(command)
