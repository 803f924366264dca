"""The output of stresses and section forces, which models observe of their own strains (`models.stresses`)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effect_checks import stress_problems
from pgmp_petsc.scene.fields import Vector
from pgmp_petsc.scene.outputs import OutputEntry


class Stress(OutputEntry):
    """Stress of a flexible body, or the force or moment in a section of a beam, largest of what it is asked of."""

    type: Literal["stress"]
    reads = "stresses"
    body: str = Field(description="name of a flexible body")
    quantity: Literal[
        "von_mises",
        "principal_max",
        "principal_min",
        "axial_force",
        "shear_force",
        "shear_force_2",
        "shear_force_3",
        "torsion_moment",
        "bending_moment",
        "bending_moment_2",
        "bending_moment_3",
        "stress_max",
        "stress_min",
    ] = Field(
        description="von_mises, principal_max, principal_min (Pa) of solids; of beams axial_force, shear_force (N), "
        "bending_moment (N m), stress_max, stress_min of the outermost fibres (Pa), in space shear_force_2 and _3, "
        "bending_moment_2 and _3, torsion_moment"
    )
    at: Vector | None = Field(None, description="place in the body's own frame, that of its mesh (m)")
    group: str | None = Field(
        None, description="group of faces of a solid, or named point of a beam: the largest value there"
    )
    region: str | None = Field(None, description="region of cells of a solid: the largest value there")

    @property
    def kinked(self) -> bool:
        """Whether it is asked of more than one place."""
        return self.at is None

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line for each entry that does not fit its body."""
        return stress_problems(scene, name, self)
