"""Outputs that are read of the frames of nodes: angles, distances, places, and speeds of points and in joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.effects import bases_of
from pgmp_petsc.effects.action import joint_measure
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import along, angle, distance
from pgmp_petsc.outputs.readings import AXES, Absolute, AnyReading, Rate, Reading, RigidReference
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import GROUND_ORIGIN, Connection, Point, refusal
from pgmp_petsc.scene.messages import Finding, doubt, problem
from pgmp_petsc.scene.outputs import Axis, OutputEntry
from pgmp_petsc.scene.uses import slides


class FromOutside(OutputEntry):
    """A place or speed that may be seen from outside of a base that moves."""

    absolute: bool = Field(
        False,
        strict=True,
        description="whether it counts from outside of a base that moves (`base_motion`), not from the base",
    )

    @property
    def is_stated(self) -> bool:
        return not self.absolute

    def doubts(self, scene: Scene, name: str) -> Iterator[Finding]:
        if self.absolute and not any(bases_of(scene)):
            yield doubt(f"outputs.{name}.absolute", "without effect, as there is no base_motion; leave it out", True)


class OfStatement(OutputEntry):
    """The value of a statement about two frames, which `stated` returns: by default the motion in a joint."""

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> AnyReading:
        return _measured(self.stated(name, kinematics.mechanism), kinematics)

    def stated(self, name: str, mechanism: Mechanism) -> dict[str, Any]:
        return joint_measure(mechanism, self)


def _measured(stated: dict[str, Any], kinematics: RigidKinematics) -> Reading:
    return Reading("MEASURE", (stated["a"], stated["b"]), stated["statement"], kinematics.mechanism.space)


class Angle(OfStatement):
    """Relative rotation in a joint (rad), measured on the flexible bodies' nodes."""

    type: Literal["angle"]
    reads, unit, joints = ("frames",), "rad", ("turning",)
    joint: str = Field(description="name of a joint that turns")

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> Reading:
        """Return the joint's angle, which counts turns."""
        return Reading.of_angle(kinematics.mechanism.connection(self.joint), kinematics, start)


class Sliding(OfStatement):
    """Displacement along the line or axis of a joint that slides (m)."""

    type: Literal["sliding"]
    reads, unit, joints = ("frames",), "m", ("sliding",)
    joint: str = Field(description="name of a joint that slides")


class Distance(OfStatement):
    """Distance of two points (m)."""

    type: Literal["distance"]
    reads, unit = ("frames",), "m"
    points: Connection = Field(description='two points, "body:point" or "ground:point"')

    def stated(self, name: str, mechanism: Mechanism) -> dict[str, Any]:
        return mechanism.between(distance(mechanism.space.dimension), self.points, f"{name}.points")


class Rotation(OutputEntry):
    """Rotation of a point's cross-section in space (rad)."""

    type: Literal["rotation"]
    reads, unit = ("frames",), "rad"
    point: Point = Field(description='point of a body, "body:point"')

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        if scene.dimension == 3:
            why = "a rotation in space is no single number; take the angle of a joint"
            yield problem(f"outputs.{name}.type", why, self.type)

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> Reading:
        return Reading.at_point("ROTATION", self.point, name, kinematics)

    def stated(self, name: str, mechanism: Mechanism) -> dict[str, Any]:
        return mechanism.between(angle(np.eye(2), np.eye(2)), (GROUND_ORIGIN, self.point), f"{name}.point")


class AlongAxis(OutputEntry):
    """A coordinate of a point along an axis."""

    point: Point = Field(description='point of a body, "body:point"')
    axis: Axis = Field(description="x or y, in space also z")
    reads, unit = ("frames",), "m"


class OnTheGround(FromOutside, AlongAxis):
    """A coordinate of a point along an axis of the ground, whose points move with the base."""

    reads = ("frames", "time", "parameters")

    def stated(self, name: str, mechanism: Mechanism) -> dict[str, Any]:
        """Return the place along the axis; a displacement has another zero."""
        return _along_axis(self.point, self.axis, name, mechanism)


def _along_axis(point: str, axis: str, name: str, mechanism: Mechanism) -> dict[str, Any]:
    statement = along(np.eye(mechanism.space.dimension)[AXES[axis]])
    return mechanism.between(statement, (GROUND_ORIGIN, point), f"{name}.point")


class Position(OnTheGround):
    """Position of a point along an axis in space (m)."""

    type: Literal["position"]

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> AnyReading:
        found = Reading.at_point("POSITION", self.point, name, kinematics, AXES[self.axis])
        return Absolute(found) if self.absolute else found


class Displacement(OnTheGround):
    """Position of a point along an axis minus that of the rigid mechanism at the start of the run (m): where a run
    starts in equilibrium, static deformation and what springs give way count."""

    type: Literal["displacement"]
    of_deformation = True  # where the mechanism rests

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> AnyReading:
        """Return the place along the axis, from that of the rigid mechanism at the start."""
        found = Reading.at_point("POSITION", self.point, name, kinematics, AXES[self.axis])
        origin = float(found.sides[0].frame_of_pose(kinematics.poses(start[None]))[found.axis, 0])
        found = replace(found, origin=origin)
        return Absolute(found, from_start=True) if self.absolute else found


class Deformation(AlongAxis):
    """Position of a point along an axis minus that of the rigid mechanism at the same joint angle (m)."""

    type: Literal["deformation"]
    of_deformation = True
    frame: Literal["ground", "body"] = Field(
        "ground", description="whose axes: the ground's, or those of the rigid body that carries the point"
    )

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> Reading:
        """Return how far the point is from that of the rigid mechanism."""
        found = Reading.at_point("DEFORMATION", self.point, name, kinematics, AXES[self.axis])
        return replace(found, in_body=self.frame == "body", of_coordinates=RigidReference(kinematics).nodes)


class Speed(FromOutside):
    """Speed of a point along an axis in space (m/s), or of the rotation (rad/s) or sliding (m/s) in a joint."""

    type: Literal["speed"]
    one_of = ("point", "joint")
    reads, unit, joints = ("frames", "time", "parameters"), "m/s", ("turning", "sliding")
    derivative = 1
    point: Point | None = Field(None, description='point of a body, "body:point"')
    axis: Axis | None = Field(None, description="of a point: x or y, in space also z")
    joint: str | None = Field(None, description="name of a joint that turns about an axis, or slides")
    motion: Literal["turning", "sliding"] | None = Field(
        None, description="which motion of a cylindrical joint; others have one"
    )

    def check_entries(self) -> None:
        if (self.point is None) != (self.axis is None):
            raise refusal("a point has a speed along an axis, a joint has one of its own", "axis")
        if self.absolute and self.point is None:
            raise refusal("a joint's speed is that of one body against the other; leave it out", "absolute")

    def unit_in(self, scene: Scene) -> str:
        return "m/s" if slides(scene, self) else "rad/s"

    def reading(self, name: str, start: np.ndarray, kinematics: RigidKinematics) -> AnyReading:
        if self.point is not None:
            found = Reading.at_point("POSITION", self.point, name, kinematics, AXES[self.axis])
            return Rate(Absolute(found) if self.absolute else found)
        mechanism = kinematics.mechanism
        if not slides(mechanism.scene, self):
            return Rate(Reading.of_angle(mechanism.connection(self.joint), kinematics, start))
        return Rate(_measured(joint_measure(mechanism, self), kinematics))

    def stated(self, name: str, mechanism: Mechanism) -> dict[str, Any]:
        of_joint = self.joint is not None
        return joint_measure(mechanism, self) if of_joint else _along_axis(self.point, self.axis, name, mechanism)
