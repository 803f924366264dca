"""A joint between two attachments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.joints import Joint
from pgmp_petsc.mechanism.statements import Statement, angle


@dataclass(frozen=True, eq=False)
class Connection:
    """A named joint between two attachments, and the rows of its constraints.

    Attributes
    ----------
    axes
        The joint's axes in the frames of a and of b, shape (d, d) each, one axis a column; see `joints.joint`.
    """

    name: str
    joint: Joint
    a: Attachment
    b: Attachment
    rows: slice
    axes: tuple[np.ndarray, np.ndarray]

    @property
    def sides(self) -> tuple[Attachment, Attachment]:
        """Both attachments."""
        return self.a, self.b

    @cached_property
    def angle(self) -> Statement:
        """How far b is turned against a about the joint's axis; in the plane from where both bodies are parallel, in
        space from where they are assembled."""
        return angle(*self.axes)
