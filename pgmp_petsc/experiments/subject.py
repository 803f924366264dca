"""What experiments are about: a scene, its bodies as they come and condensed, and their rigid kinematics, made once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.condensing import angle_group, condensed
from pgmp_petsc.experiments.period import first_period
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene


@dataclass(frozen=True)
class Subject:
    """A scene and its bodies.

    Attributes
    ----------
    scene
        As the user gave it.
    meshes
        The mesh of every body.
    shapes
        The same, bodies of continuum cells condensed.
    kinematics
        Of the mechanism of `shapes`.
    n_modes
        Modes that bodies are condensed for.
    """

    scene: Scene
    meshes: Mapping[str, BodyShape]
    shapes: Mapping[str, BodyShape]
    kinematics: RigidKinematics
    n_modes: int

    @classmethod
    def of(cls, scene: Scene, meshes: Mapping[str, BodyShape], group: RankGroup, n_modes: int) -> Self:
        """Condense the bodies for so many modes, and follow the rigid motion. Collective on ``group.world``."""
        serving = scene.model_copy(
            update={"reduction": scene.reduction.model_copy(update={"modes": n_modes, "tolerance": None})}
        )
        shapes = condensed(serving, meshes, group, large=takes_second_order(scene))
        with agreed(group.world, "rigid kinematics"):
            kinematics = RigidKinematics(Mechanism.from_scene(scene, shapes))
        return cls(scene, meshes, shapes, kinematics, n_modes)

    def first_period(self, group: RankGroup) -> float:
        """Return the period of the first flexible mode at the start (s). Collective on ``group.world``."""
        with angle_group(self.shapes, group) as angles:
            return first_period(self.scene, self.kinematics, angles.world, angles.comm)


def takes_second_order(scene: Scene) -> bool:
    """Return whether a reduced model of the scene may have terms of second order."""
    asked = scene.reduction.model_copy(update={"second_order": True, "tolerance": None})
    try:
        check_capabilities(scene.model_copy(update={"reduction": asked}), Purpose.BUILD)
    except InputError:
        return False
    return True
