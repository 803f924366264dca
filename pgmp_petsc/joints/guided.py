"""Joints whose second point moves on a line or a plane through the first.

The joint between two bodies that slide and turn on a plane.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.mechanism.joints import aligned, guided, parallel
from pgmp_petsc.mechanism.statements import Statement, along
from pgmp_petsc.scene.fields import Axis, Connection, Direction
from pgmp_petsc.scene.joints import JointEntry
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
