"""``pgmp check``: is the scene sound, and what is in it?"""

from __future__ import annotations

from pathlib import Path

import click

from pgmp_petsc.api.checks import check as checked
from pgmp_petsc.cli.calls import Call
from pgmp_petsc.cli.options import PathName, scene_options
from pgmp_petsc.cli.report import output_form, say, say_figures
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.errors import InputError, counted


@click.command()
@click.argument("scene", metavar="SCENE", type=PathName())
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
    type=PathName(),
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
    Call(context, None)
    found = checked(
        scene, effects=sizes, trial=trial, picture=picture, parameters=settings, overrides=overrides,
        comm=context.obj.comm,
    )  # fmt: skip
    if found.picture is not None:
        say(context, f"  picture       {found.picture}")
    if trial:
        say(context, found.trial_text)
    if found.sizes is not None:
        say(context, "\n".join(found.sizes.lines()))
    if context.obj.json:
        say_figures(context, on_root(context.obj.comm, found.summary) | ({"trial": found.trial} if trial else {}))
    if strict and found.scene.remarks:
        warnings = counted(len(found.scene.remarks), "warning")
        raise InputError(f"{scene}: {warnings}, see above, and --strict takes none")
