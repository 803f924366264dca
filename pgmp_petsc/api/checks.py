"""The check of a scene, before anything is solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgmp_petsc.api.declared import Argument, command
from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.scenes import SCENE, Overrides, Parameters
from pgmp_petsc.base.errors import InputError, counted
from pgmp_petsc.base.progress import doing
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.files.claims import check_output
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mesh.meshes import SolidMesh
from pgmp_petsc.ranks.agreement import on_root
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.check import describe_scene, describe_trial, summary_of_scene
from pgmp_petsc.studies.inputs import read_scene

if TYPE_CHECKING:
    from pgmp_petsc.components.condensing import Trial
    from pgmp_petsc.results.selection import EffectSizes


@dataclass(frozen=True, eq=False)
class Checked:
    """A scene that holds together."""

    #: scene, meshes: the scene, whose `remarks` say what is probably not meant, and the mesh of every body
    scene: Scene
    meshes: Mapping[str, BodyShape]
    text: str  # what is in it: bodies, unknowns, active effects, estimated memory
    picture: Path | None = None  # file of the assembled mechanism; None where none was asked for
    trial: Trial | None = None  # what a build will take; None where it was not tried, or there are no continuum bodies
    sizes: EffectSizes | None = None  # sizes of all effects; None where they were not asked for
    #: tried, name: whether a trial was asked for, and what messages call the scene
    tried: bool = False
    name: str = "the scene"

    @property
    def trial_text(self) -> str:
        """Findings of the trial, in words."""
        if self.trial is None:
            return "  trial         no continuum bodies: nothing to try"
        return describe_trial(self.trial)

    def summary(self) -> dict[str, Any]:
        """Return the figures of ``pgmp check --json``."""
        found = {"trial": self.trial, "sizes_of_effects": self.sizes}
        return summary_of_scene(self.scene, self.meshes) | {k: v for k, v in found.items() if v is not None}


def _report(found: Checked, name: Path, said: object, strict: bool) -> str:
    """Return what was found besides the scene itself, which was printed before."""
    lines = [found.trial_text] if found.tried else []
    return "\n".join([*lines, *([] if found.sizes is None else found.sizes.lines())])


def _status(found: Checked, strict: bool) -> None:
    if strict and found.scene.remarks:
        warnings = counted(len(found.scene.remarks), "warning")
        raise InputError(f"{found.name}: {warnings}, see above, and --strict takes none")


@command(
    "check", "Validate a scene and say what is in it.", 30, report=_report, status=_status,
    figures=lambda found, strict: found.summary() | ({"trial": found.trial} if found.tried else {}),
    scene=SCENE,
    effects=Argument("Also estimate the size of every available effect: what to keep, what to leave."),
    trial=Argument("Also factorise the largest continuum body, and predict time and memory."),
    picture=Argument(
        "Also draw the assembled mechanism with the names of bodies, joints and points; beside it, as FILE_BODY.png, "
        "each part of cells with its named faces.", "--plot", "FILE.png"
    ),
    shell={"strict": Argument("End with status 2 if there are warnings.")},
)  # fmt: skip
def check(
    scene: Scene | str | PathLike[str],
    *,
    effects: bool = False,
    trial: bool = False,
    picture: str | PathLike[str] | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    comm: Comm | None = None,
) -> Checked:
    """Validate `scene` and print its bodies, unknowns, active effects and estimated memory; solve nothing.

    With `trial` the largest continuum body is factorised once on all ranks, which tells what a build will take. With
    `effects` the mechanism runs once with rigid bodies, and modes are computed at a few of its configurations; bodies
    of continuum elements are condensed for that, as in a build.

    What cannot be meant is refused with its entry's name. What probably is not meant is named in a warning: with
    `strict` these end the check with status 2 too.
    """
    comm = solving_ranks_of(comm) if effects or trial else ranks_of(comm)
    target = None if picture is None else Path(picture)
    inputs = () if isinstance(scene, Scene) else (Path(fspath(scene)),)
    if target is not None:
        on_root(comm, check_output, target, "picture", inputs)
    loaded, meshes = read_scene(scene, overrides, parameters, comm, Purpose.SIZES if effects else Purpose.CHECK)
    text = on_root(comm, describe_scene, loaded, meshes)
    tell(comm, text)
    tell_remarks(comm, loaded.remarks)
    if target is not None:
        for line in on_root(comm, _draw, loaded, meshes, target, inputs):
            tell(comm, line)
    if trial:
        from pgmp_petsc.components.condensing import try_largest
    return Checked(
        loaded,
        meshes,
        text,
        target,
        try_largest(loaded, meshes, comm) if trial else None,
        _sizes(loaded, meshes, comm) if effects else None,
        trial,
        "the scene" if isinstance(scene, Scene) else fspath(scene),
    )


def _draw(scene: Scene, meshes: Mapping[str, BodyShape], picture: Path, inputs: Sequence[Path]) -> list[str]:
    """Draw the assembled mechanism and its parts of cells, and say where; by one process only."""
    from pgmp_petsc.figures.mechanism import assembly  # matplotlib takes a noticeable time
    from pgmp_petsc.figures.solids import meshed_part
    from pgmp_petsc.figures.style import letters_lacking, save
    from pgmp_petsc.studies.field_frames import assembly_of

    parts = {name: mesh for name, mesh in meshes.items() if isinstance(mesh, SolidMesh)}
    files = {name: picture.with_name(f"{picture.stem}_{name}.png") for name in parts}
    for file in files.values():
        check_output(file, "picture", inputs)
    with letters_lacking() as lacking:
        lines = [f"  picture       {save(assembly(assembly_of(scene, meshes)), picture)}"]
        with doing("drawing parts"):
            for name, file in files.items():
                nodes, metre = scene.system.named(parts[name].nodes, "m")
                part = meshed_part(replace(parts[name], nodes=nodes), name, metre)
                lines.append(f"  faces         {save(part, file)}")
    return [*lines, *(f"  note: {line}" for line in lacking)]


def _sizes(scene: Scene, meshes: Mapping[str, BodyShape], comm: Comm) -> EffectSizes:
    from pgmp_petsc.components.condensing import condensed
    from pgmp_petsc.ranks.groups import RankGroup
    from pgmp_petsc.studies.building import estimate_effects

    with RankGroup.split(comm, 1) as group:
        shapes = condensed(scene, meshes, group, large=True)
    return on_root(comm, lambda: estimate_effects(scene, meshes, shapes=shapes), doing="estimating effects")
