"""``pgmp check``: is the scene sound, and what is in it?"""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.cli.options import scene_options
from pgmp_petsc.cli.report import say
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.studies.check import describe_scene
from pgmp_petsc.studies.inputs import read_scene


@click.command()
@click.argument("scene", metavar="SCENE", type=click.Path(path_type=Path))
@scene_options
@click.pass_context
def check(context: click.Context, scene: Path, settings: tuple[str, ...], overrides: tuple[str, ...]) -> None:
    """Validate SCENE and print its bodies, unknowns, active effects and estimated memory; solve nothing."""
    comm = context.obj.comm
    loaded, meshes = read_scene(scene, overrides, settings, comm)
    say(context, on_root(comm, describe_scene, loaded, meshes))
