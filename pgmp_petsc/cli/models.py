"""The options that name a model: that of a ROM.h5, or of a SCENE the full-order or the component model."""

from __future__ import annotations

import click

from pgmp_petsc.cli.options import Command
from pgmp_petsc.runtime.errors import InputError


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
