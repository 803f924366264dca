"""The output of what a controller puts on its joint.

Of a sampled controller it is, where the force jumps, what is held from there on.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from pgmp_petsc.base.errors import nearest_name
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.outputs import OutputEntry
from pgmp_petsc.scene.uses import slides


class ControlForce(OutputEntry):
    """Torque (N m), or force (N) on what slides, of a controller."""

    type: Literal["control_force"]
    reads, unit = ("beside",), "N m"
    controller: str = Field(description="name of the controller")

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if there is no such controller."""
        if self.controller not in scene.controllers:
            hint = nearest_name(self.controller, scene.controllers)
            yield problem(f"outputs.{name}.controller", f"there is no such controller{hint}", self.controller)

    def unit_in(self, scene: Scene) -> str:
        """Return N for what slides."""
        found = scene.controllers.get(self.controller)
        return "N" if found is not None and slides(scene, found) else "N m"
