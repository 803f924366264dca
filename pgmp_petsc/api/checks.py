"""What a program's scene is, before anything is solved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgmp_petsc.api.arguments import checked
from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.scenes import Overrides, Parameters, overrides_of, settings_of
from pgmp_petsc.api.sources import scene_and_meshes
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.check import describe_scene, describe_trial, summary_of_scene

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.bodies.shape import BodyShape
    from pgmp_petsc.components.trial import Trial
    from pgmp_petsc.results.effect_sizes import EffectSizes


@dataclass(frozen=True, eq=False)
class Checked:
    """A scene that holds together.

    Attributes
    ----------
    scene, meshes
        The scene, whose `remarks` say what is probably not meant, and the mesh of every body.
    text
        What is in it: bodies, unknowns, active effects, estimated memory.
    picture
        File of the assembled mechanism; None where none was asked for.
    trial
        What a build will take; None where it was not tried, or there are no continuum bodies.
    sizes
        Sizes of all effects; None where they were not asked for.
    """

    scene: Scene
    meshes: Mapping[str, BodyShape]
    text: str
    picture: Path | None = None
    trial: Trial | None = None
    sizes: EffectSizes | None = None

    @property
    def trial_text(self) -> str:
        """What the trial found, in words."""
        if self.trial is None:
            return "  trial         no continuum bodies: nothing to try"
        return describe_trial(self.trial)

    def summary(self) -> dict[str, Any]:
        """Return the figures of ``pgmp check --json``."""
        found = {"trial": self.trial, "sizes_of_effects": self.sizes}
        return summary_of_scene(self.scene, self.meshes) | {k: v for k, v in found.items() if v is not None}


@checked
def check(
    scene: Scene | str | PathLike[str],
    *,
    effects: bool = False,
    trial: bool = False,
    picture: str | PathLike[str] | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    comm: MPI.Comm | None = None,
) -> Checked:
    """Look whether a scene is sound and what is in it, as ``pgmp check``. Collective on `comm`.

    Parameters
    ----------
    scene, parameters, overrides
        As of `build`.
    effects
        Whether to estimate the size of every effect that there is.
    trial
        Whether to factorise the largest continuum body, which tells what a build will take.
    picture
        File to draw the assembled mechanism in, with the names of bodies, joints and points.

    Raises
    ------
    InputError
        If the scene cannot be meant, or the picture cannot be written.
    """
    comm = solving_ranks_of(comm) if effects or trial else ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        texts, settings = overrides_of(overrides), settings_of(parameters)
        target = None if picture is None else Path(picture)
    inputs = () if isinstance(scene, Scene) else (Path(fspath(scene)),)
    if target is not None:
        on_root(comm, check_output, target, "picture", inputs)
    purpose = Purpose.SIZES if effects else Purpose.CHECK
    loaded, meshes = scene_and_meshes(scene, purpose, texts, settings, comm)
    text = on_root(comm, describe_scene, loaded, meshes)
    tell(comm, text)
    tell_remarks(comm, loaded.remarks)
    return Checked(
        loaded,
        meshes,
        text,
        None if target is None else on_root(comm, _draw, loaded, meshes, target),
        _tried(loaded, meshes, comm) if trial else None,
        _sizes(loaded, meshes, comm) if effects else None,
    )


def _draw(scene: Scene, meshes: Mapping[str, BodyShape], picture: Path) -> Path:
    """Draw the assembled mechanism, and return the picture's path; by one process only."""
    from pgmp_petsc.figures.assembly import assembly  # matplotlib takes a noticeable time
    from pgmp_petsc.figures.style import save
    from pgmp_petsc.studies.assembly import assembly_of

    return save(assembly(assembly_of(scene, meshes)), picture)


def _tried(scene: Scene, meshes: Mapping[str, BodyShape], comm: MPI.Comm) -> Trial | None:
    from pgmp_petsc.components.trial import try_largest

    return try_largest(scene, meshes, comm)


def _sizes(scene: Scene, meshes: Mapping[str, BodyShape], comm: MPI.Comm) -> EffectSizes:
    """Return the sizes of effects, bodies of continuum cells condensed as in a build. Collective on `comm`."""
    from pgmp_petsc.components.condensing import condensed
    from pgmp_petsc.runtime.groups import RankGroup
    from pgmp_petsc.studies.effect_sizes import estimate_effects

    with RankGroup.split(comm, 1) as group:
        shapes = condensed(scene, meshes, group, large=True)
    return on_root(comm, lambda: estimate_effects(scene, meshes, shapes=shapes))
