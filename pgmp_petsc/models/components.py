"""The component model of a scene: flexible bodies in floating frames, joined by constraints."""

from __future__ import annotations

from collections.abc import Mapping

from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.models.full import FullModel
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
    n_ranks
        Ranks that condensed the bodies, each on one.
    """

    name = "components"
    title = "component"

    def __init__(
        self,
        scene: Scene,
        shapes: Mapping[str, BodyShape],
        kinematics: RigidKinematics | None = None,
        n_ranks: int = 1,
    ) -> None:
        super().__init__(scene, shapes, kinematics)
        self.n_ranks = n_ranks

    @property
    def _scaling(self) -> set[str | None]:
        """None: cross-sections that scale are weights of moments and stiffness as all parameters are."""
        return set()

    @property
    def n_amplitudes(self) -> dict[str, int]:
        """Number of component modes of every flexible body."""
        return {body.name: body.floating.n for body in self.kinematics.mechanism.bodies if body.floating is not None}
