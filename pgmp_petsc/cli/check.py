"""``pgmp check``: is the scene sound, and what is in it?"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import click

from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.cli.options import scene_options
from pgmp_petsc.cli.output_form import output_form, say_figures
from pgmp_petsc.cli.report import say, say_remarks
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.components.trial import try_largest
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.assembly import assembly_of
from pgmp_petsc.studies.check import describe_scene, describe_trial
from pgmp_petsc.studies.effect_sizes import estimate_effects
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.scene_summary import summary_of_scene


@click.command()
@click.argument("scene", metavar="SCENE", type=click.Path(path_type=Path))
@click.option(
    "--effects",
    "sizes",
    is_flag=True,
    help="Also estimate the size of every available effect: what to keep, what to leave.",
)
@click.option("--trial", is_flag=True, help="Also factorise the largest continuum body, and predict time and memory.")
@click.option(
    "--plot",
    "picture",
    metavar="FILE.png",
    type=click.Path(path_type=Path),
    help="Also draw the assembled mechanism with the names of bodies, joints and points.",
)
@output_form
@click.option("--strict", is_flag=True, help="End with status 2 if there are warnings.")
@scene_options
@click.pass_context
def check(
    context: click.Context,
    scene: Path,
    sizes: bool,
    trial: bool,
    picture: Path | None,
    strict: bool,
    settings: tuple[str, ...],
    overrides: tuple[str, ...],
) -> None:
    """Validate SCENE and print its bodies, unknowns, active effects and estimated memory; solve nothing.

    With --trial the largest continuum body is factorised once on all ranks, which tells what a build will take. With
    --effects the mechanism runs once with rigid bodies, and modes are computed at a few of its configurations; bodies
    of continuum elements are condensed for that, as in a build.

    What cannot be meant is refused with its entry's name. What probably is not meant is named in a warning: with
    --strict these end the check with status 2 too.
    """
    comm = context.obj.comm
    if picture is not None:
        on_root(comm, check_output, picture, "picture", (scene,))
    loaded, meshes = read_scene(scene, overrides, settings, comm, Purpose.SIZES if sizes else Purpose.CHECK)
    say(context, on_root(comm, describe_scene, loaded, meshes))
    say_remarks(context, loaded)
    if picture is not None:
        say(context, f"  picture       {on_root(comm, draw_assembly, loaded, meshes, picture)}")
    figures = on_root(comm, summary_of_scene, loaded, meshes) if context.obj.json else {}
    if trial:
        found = try_largest(loaded, meshes, comm)
        figures["trial"] = found
        say(context, "  trial         no continuum bodies: nothing to try" if found is None else describe_trial(found))
    if sizes:
        with RankGroup.split(comm, 1) as group:
            shapes = condensed(loaded, meshes, group, large=True)
        estimated = on_root(comm, lambda: estimate_effects(loaded, meshes, shapes=shapes))
        say(context, "\n".join(estimated.lines()))
        figures["sizes_of_effects"] = estimated
    say_figures(context, figures)
    if strict and loaded.remarks:
        n = len(loaded.remarks)
        raise InputError(f"{scene}: {n} warning{'s' if n > 1 else ''}, see above, and --strict takes none")


def draw_assembly(scene: Scene, meshes: Mapping[str, BodyShape], picture: Path) -> Path:
    """Draw the assembled mechanism, and return the picture's path; by one process only."""
    from pgmp_petsc.figures.assembly import assembly  # matplotlib takes a noticeable time
    from pgmp_petsc.figures.style import save

    return save(assembly(assembly_of(scene, meshes)), picture)
