"""What moves in a joint: the relative rotation of a revolute one, the displacement along the line of a sliding one."""

from __future__ import annotations

from typing import Any

from pgmp_petsc.effects.measures import ROTATION, SLIDE
from pgmp_petsc.mechanism.joints import PointOnLine
from pgmp_petsc.mechanism.mechanism import Mechanism


def joint_measure(mechanism: Mechanism, joint: str) -> dict[str, Any]:
    """Return measure, attachments and direction of a joint, as `Action` takes them."""
    connection = mechanism.connection(joint)
    if isinstance(connection.joint, PointOnLine):
        return {"measure": SLIDE, "a": connection.a, "b": connection.b, "direction": connection.joint.direction}
    return {"measure": ROTATION, "a": connection.a, "b": connection.b}
