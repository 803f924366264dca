"""What an effect on a joint, or between points, acts on: a rotation, or a displacement along a line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


def slides(scene: Scene, entry: Any) -> bool:
    """Whether an effect or output acts along a line: between two points, or on a joint that slides."""
    if getattr(entry, "points", None) is not None:
        return True
    joint = scene.joints.get(getattr(entry, "joint", None))
    motions = () if joint is None else joint.motions
    return getattr(entry, "motion", None) == "sliding" if len(motions) > 1 else motions == ("sliding",)
