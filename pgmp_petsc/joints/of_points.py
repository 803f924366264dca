"""Joints of two points, which share their position, or the second moves on a line or a plane through the first."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.mechanism.joints import aligned, guided, meeting, parallel, weld
from pgmp_petsc.mechanism.statements import Statement, along, perpendicular
from pgmp_petsc.scene.fields import Axis, Connection, Direction, refusal
from pgmp_petsc.scene.joints import JointEntry, are_parallel
from pgmp_petsc.scene.messages import COMPONENTS, problem


class PointOnLine(JointEntry):
    """The second point moves on a line through the first."""

    type: Literal["point_on_line"]
    dimensions = (2, 3)
    motions = ("sliding",)
    also_in_plane = ("turning",)
    loose = "across"
    connect: Connection = Field(description="the point that carries the line, then the point that moves on it")
    direction: Direction = Field(
        description="direction of the line, (x, y) or in space (x, y, z), fixed to the owner of the first point"
    )

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        return guided(in_a)


class PointOnBeam(PointOnLine):
    """The second point moves along a beam as it bends, on the straight run of its nodes through the first point."""

    type: Literal["point_on_beam"]
    rides = True
    loose = ""
    connect: Connection = Field(description="a point of the beam, then the point that moves along it")
    direction: Direction = Field(
        description="direction of the run of nodes at rest, (x, y) or in space (x, y, z), in the beam's frame"
    )

    def problems(self, scene, name):
        owner = self.connect[0].partition(":")[0]
        body = scene.bodies.get(owner)
        if owner == "ground" or body is not None and body.element not in ("beam2d", "beam3d"):
            words = f"a point of a beam is needed first; {owner} is none: the joint point_on_line has a straight line"
            yield problem(f"joints.{name}.connect", words, list(self.connect))
        for entry in ("elastic", "offset"):
            if getattr(self, entry) is not None:
                words = "this joint is rigid and where it should be; let a body between it and the load be elastic"
                yield problem(f"joints.{name}.{entry}", words)


class PointOnPlane(JointEntry):
    """The second point moves on a plane through the first."""

    type: Literal["point_on_plane"]
    dimensions = (3,)
    normal: Axis = Field(description="normal (x, y, z) of the plane, fixed to the owner of the first point")

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        return [along(in_a[:, 0])]


class Cylindrical(JointEntry):
    """The second point moves on an axis through the first, and turns about it."""

    type: Literal["cylindrical"]
    dimensions = (3,)
    motions = ("turning", "sliding")
    loose = "across"
    axis: Axis = Field(description="axis (x, y, z) in the frame of the first point's owner")

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        return [*guided(in_a), *aligned(in_a, in_b)]


class Prismatic(JointEntry):
    """The second point moves on an axis through the first without turning."""

    type: Literal["prismatic"]
    dimensions = (2, 3)
    motions = ("sliding",)
    loose = "across"
    axis: Direction = Field(description="axis (x, y), in space (x, y, z), in the frame of the first point's owner")

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        return [*guided(in_a), *parallel(in_a, in_b)]

    def problems(self, scene, name):
        if len(self.axis) != scene.dimension:
            yield problem(f"joints.{name}.axis", COMPONENTS[scene.dimension], list(self.axis))


class Planar(JointEntry):
    """The second point moves on a plane through the first, and its body turns about the plane's normal."""

    type: Literal["planar"]
    dimensions = (3,)
    motions = ("turning",)
    normal: Axis = Field(description="normal (x, y, z) of the plane, fixed to the owner of the first point")

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        return [along(in_a[:, 0]), *aligned(in_a, in_b)]


class Revolute(JointEntry):
    """Two points share their position; the relative rotation is free, in space about an axis."""

    type: Literal["revolute"]
    dimensions = (2, 3)
    motions = ("turning",)
    loose = "across"
    axis: Axis | None = Field(None, description="axis (x, y, z) in the frame of the first point's owner; in space")

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        return [*meeting(len(in_a)), *(aligned(in_a, in_b) if len(in_a) == 3 else ())]

    def problems(self, scene, name):
        if scene.dimension == 2 and self.axis is not None:
            yield problem(f"joints.{name}.axis", "for mechanisms in space; in the plane the axis is z", list(self.axis))
        if scene.dimension == 3 and self.axis is None:
            yield problem(f"joints.{name}.axis", "missing; needed in space: axis (x, y, z) of the rotation")


class Fixed(JointEntry):
    """Two points share position and rotation: their bodies are welded at the angle that they are placed at."""

    type: Literal["fixed"]
    dimensions = (2, 3)

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        return weld(in_a, in_b)


class Spherical(JointEntry):
    """Two points share their position; every rotation is free."""

    type: Literal["spherical"]
    dimensions = (3,)
    motions = ("spin",)
    loose = "everywhere"

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        return meeting(3)

    def without_spin(self, axes: np.ndarray) -> str:
        """Return the entries of a universal joint."""
        one, other = (", ".join(f"{x:.4g}" for x in np.where(np.abs(axis) > 1e-6, axis, 0.0)) for axis in axes.T)
        return f'type = "universal", axis = [{one}], second_axis = [{other}]'


class Universal(JointEntry):
    """Two points share their position, and an axis of each body stays at a right angle to one of the other."""

    type: Literal["universal"]
    dimensions = (3,)
    motions = ("spin",)
    axis: Axis = Field(description="axis (x, y, z) fixed in the first body, in its frame")
    second_axis: Axis = Field(description="axis fixed in the second body; in the frame of the first one, as assembled")

    def check_entries(self) -> None:
        if are_parallel(self.axis, self.second_axis):
            raise refusal("must not have the direction of axis; both axes are at a right angle", "second_axis")

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        """Return that the points meet, and that the first axis, in a, is across the second one, in b."""
        return [*meeting(3), perpendicular(in_a[:, 0], in_b[:, 1])]
