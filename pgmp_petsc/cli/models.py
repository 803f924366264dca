"""The models that commands run: that of a ROM.h5, or of a SCENE the full-order or the component model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import click

from pgmp_petsc.cli.options import Command
from pgmp_petsc.cli.report import say_remarks
from pgmp_petsc.models import Model
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.inputs import read_rom, read_scene
from pgmp_petsc.studies.prepared import PURPOSES, mesh_model, reduced_model


def model_options(command: Command) -> Command:
    """Add ``--full`` and ``--components``; the function receives both (bool)."""
    components = "Take the component model of a SCENE: flexible bodies in floating frames."
    command = click.option("--components", is_flag=True, help=components)(command)
    return click.option("--full", is_flag=True, help="Take the full-order model of a SCENE.")(command)


def one_model(full: bool, components: bool) -> None:
    """Refuse two models at once."""
    if full and components:
        raise InputError("--full and --components: two models; give one of them, or run the command twice")


def read_model(
    context: click.Context,
    source: Path,
    overrides: Sequence[str],
    settings: Sequence[str],
    full: bool,
    components: bool,
    check: Callable[[Scene], None] = lambda scene: None,
) -> Model:
    """Return the model that is asked for, and say the remarks on its scene. Collective on the command's ranks.

    `check` refuses scenes for reasons of the command's own, the same on all ranks.
    """
    comm = context.obj.comm
    if not (full or components):
        scene, rom = read_rom(source, overrides, settings, comm)
        check(scene)
        say_remarks(context, scene)
        return reduced_model(scene, rom, comm)
    name = "components" if components else "full"
    scene, meshes = read_scene(source, overrides, settings, comm, PURPOSES[name])
    check(scene)
    say_remarks(context, scene)
    return mesh_model(scene, meshes, name, comm)
