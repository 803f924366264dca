"""The output of speeds: how fast a point moves along an axis, or a joint turns or slides."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.readings import AXES, Reading
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import Point, exactly_one, refusal
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.outputs import Axis, OutputEntry
from pgmp_petsc.scene.uses import slides


class Speed(OutputEntry):
    """Speed of a point along an axis in space (m/s), or of the rotation (rad/s) or sliding (m/s) in a joint."""

    type: Literal["speed"]
    reads, unit, joints = "rates", "m/s", ("turning", "sliding")
    point: Point | None = Field(None, description='point of a body, "body:point"')
    axis: Axis | None = Field(None, description="of a point: x or y, in space also z")
    joint: str | None = Field(None, description="name of a joint that turns about an axis, or slides")
    motion: Literal["turning", "sliding"] | None = Field(
        None, description="which motion of a cylindrical joint; others have one"
    )

    @model_validator(mode="after")
    def _of_one(self) -> Self:
        exactly_one(self, "point", "joint")
        if (self.point is None) != (self.axis is None):
            raise refusal("a point has a speed along an axis, a joint has one of its own", "axis")
        return self

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if there is no such axis."""
        if scene.dimension == 2 and self.axis == "z":
            yield problem(f"outputs.{name}.axis", "x or y is needed in the plane", "z")

    def unit_in(self, scene: Scene) -> str:
        """Return rad/s for what turns."""
        return "m/s" if slides(scene, self) else "rad/s"

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> Reading:
        """Return the place or angle, whose rate this is."""
        if self.point is not None:
            return Reading.at_point("POSITION", self.point, name, kinematics, AXES[self.axis])
        mechanism = kinematics.mechanism
        connection = mechanism.connection(self.joint)
        if not slides(mechanism.scene, self):
            return Reading.of_angle(connection, kinematics, start)
        return Reading("MEASURE", connection.sides, connection.measure("sliding"), space=mechanism.space)
