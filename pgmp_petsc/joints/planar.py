"""The joint between two bodies that slide and turn on a plane."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.mechanism.joints import aligned
from pgmp_petsc.mechanism.statements import Statement, along
from pgmp_petsc.scene.fields import Axis
from pgmp_petsc.scene.joints import JointEntry


class Planar(JointEntry):
    """The second point moves on a plane through the first, and its body turns about the plane's normal."""

    type: Literal["planar"]
    dimensions = (3,)
    motions = ("turning",)
    normal: Axis = Field(description="normal (x, y, z) of the plane, fixed to the owner of the first point")

    @property
    def axes(self):
        """The plane's normal."""
        return (self.normal,)

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
        """Return that the point is on the plane, and that the normals of both bodies agree."""
        return [along(in_a[:, 0]), *aligned(in_a, in_b)]
