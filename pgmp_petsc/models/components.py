"""The component model of a scene: flexible bodies in floating frames, joined by constraints."""

from __future__ import annotations

from collections.abc import Mapping

from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.models.full import FullModel
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene


class ComponentModel(FullModel):
    """The equations of the full-order model with another kind of flexible body; see `Model` and `bodies.floating`.

    Parameters
    ----------
    scene
        The scene.
    shapes
        Of the bodies, the flexible ones as `components.floating_frames` makes them.
    kinematics
        Of the same mechanism, where they are at hand.

    Raises
    ------
    InputError
        If the scene has modal damping, which component modes do not have.
    """

    name = "components"
    title = "component"

    def __init__(
        self, scene: Scene, shapes: Mapping[str, BodyShape], kinematics: RigidKinematics | None = None
    ) -> None:
        for name, effect in scene.effects.items():
            if effect.type == "structural_damping" and any(effect.ratios):
                raise InputError(
                    f"effects.{name}.ratios = {list(effect.ratios)}: bodies in floating frames have no modal damping; "
                    "take stiffness and mass of structural_damping, or pgmp simulate --full"
                )
        super().__init__(scene, shapes, kinematics)

    @property
    def n_amplitudes(self) -> dict[str, int]:
        """Number of component modes of every flexible body."""
        return {body.name: body.floating.n for body in self.kinematics.mechanism.bodies if body.floating is not None}
