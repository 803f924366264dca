"""Joints whose two points share their position."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.mechanism.joints import aligned, meeting, weld
from pgmp_petsc.mechanism.statements import Statement, perpendicular
from pgmp_petsc.scene.fields import Axis, refusal
from pgmp_petsc.scene.joints import JointEntry, are_parallel
from pgmp_petsc.scene.messages import problem


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
