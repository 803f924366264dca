"""What moves in a joint: its rotation about its axis, or the displacement along its line."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import along
from pgmp_petsc.scene.slides import slides


def joint_measure(mechanism: Mechanism, entry: Any) -> dict[str, Any]:
    """Return statement, attachments and coordinate of an effect's joint, as `Action` takes them."""
    connection = mechanism.connection(entry.joint)
    place = {"a": connection.a, "b": connection.b}
    if slides(mechanism.scene, entry):
        return {"statement": along(np.array(mechanism.scene.joints[entry.joint].axes[0])), **place}
    numbers = [k for k, c in enumerate(mechanism.coordinates) if c.connection is connection]
    return {"statement": connection.angle, "coordinate": numbers[0] if numbers else -1, **place}
