"""Terms of the reduced model that a scene adds or leaves out by name; they make no forces of their own.

What is of second order in the deformation has two halves, and each alone is wrong where bodies spin: without the
stiffness by inertia forces a spinning beam softens and buckles at a speed where it does not (Kane, Ryan and Banerjee
1987); without the inertia of the turning shapes it is stiffer in the plane than it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import EffectEntry
from pgmp_petsc.scene.messages import problem


class Gyroscopic(EffectEntry):
    """The inertia forces that are quadratic in velocities: there unless a slow scene leaves them out."""

    type: Literal["gyroscopic"]
    acts = "reduction"
    single = True
    keep: bool = Field(True, strict=True, description="false leaves them out of the reduced model")

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        named = [f"effects.{other}" for other, effect in scene.effects.items() if effect.second_order]
        if not self.keep and scene.second_order:
            reason = named[0] if named else "reduction.second_order"
            yield problem(
                f"effects.{name}.keep",
                f"leaves out the forces by velocities whose stiffening {reason} asks for; keep them, or leave out both",
                False,
            )

    @property
    def keeps_velocity_forces(self) -> bool:
        return self.keep

    @property
    def adds(self) -> str:
        return "kept" if self.keep else "left out of the reduced model"


class Half(EffectEntry):
    """Half of what is of second order in the deformation."""

    other_half: ClassVar[str]
    acts = "reduction"
    single = True
    second_order = True
    adds = "tables of second order in the reduced model"

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        if all(effect.type != self.other_half for effect in scene.effects.values()):
            yield problem(
                f"effects.{name}",
                "is half of what is of second order in the deformation, and wrong by itself where bodies spin; name an "
                f'effect of type "{self.other_half}" too, or neither',
            )


class GeometricStiffening(Half):
    """Stiffness by forces that act: axial loads and inertia forces (of reduced and component models; the full-order one
    has it)."""

    type: Literal["geometric_stiffening"]
    other_half = "mode_inertia"
    stretching: Literal["static", "dynamic"] = Field(
        "static",
        description="how bodies follow their shortening by bending: at once, which holds for large deflections, or by "
        "the coordinates that stretch them, which is more accurate for small ones at high frequencies (as "
        "reduction.second_order)",
    )

    @property
    def is_stretching(self) -> str | None:
        return self.stretching


class ModeInertia(Half):
    """Inertia of mode shapes that change with the configuration (the reduced model's; the full-order one has it)."""

    type: Literal["mode_inertia"]
    other_half = "geometric_stiffening"
