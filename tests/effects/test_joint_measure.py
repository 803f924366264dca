"""What effects measure in joints that slide, turn, or do both, in space."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from spatial import assembled, bars_of, solid, table

from pgmp_petsc.effects.joint_effects import joint_measure
from pgmp_petsc.mechanism.mechanism import Mechanism

AXIS, TURNED, MOVED = np.array([0.48, -0.6, 0.64]), 0.7, 0.2


def mechanism(kind: str) -> tuple[Mechanism, np.ndarray]:
    """Return a bar on a joint of the ground, and its pose turned about the axis and moved along it."""
    scene = assembled(
        solid("bar", 0.5, (0.0, 0.0, 0.0), (0.2, 0.5, -0.4)),
        solid("wheel", 0.2, (0.0, 0.0, 0.0)),
        table("joints.guide", type=kind, connect=["ground:origin", "bar:hinge"], axis=AXIS),
        table("joints.drive", type="revolute", connect=["bar:tip", "wheel:hinge"], axis=(0.0, 0.0, 1.0)),
    )
    made = Mechanism.from_scene(scene, bars_of(scene))
    poses = made.first_guess.copy()
    poses[0, 3:] = Rotation.from_rotvec(TURNED * AXIS).apply(poses[0, 3:].reshape(3, 3)).ravel()
    poses[0, :3] = MOVED * AXIS
    return made, poses


@pytest.mark.parametrize(
    ("kind", "motion", "expected"),
    [("cylindrical", "turning", TURNED), ("cylindrical", "sliding", MOVED), ("prismatic", None, MOVED),
     ("revolute", None, TURNED)],
)  # fmt: skip
def test_the_motion_in_a_joint(kind: str, motion: str | None, expected: float) -> None:
    made, poses = mechanism(kind)
    place = joint_measure(made, SimpleNamespace(joint="guide", motion=motion))
    frames = [place[side].frame_of_pose(poses) for side in "ab"]
    assert place["statement"].value(*frames) == pytest.approx(expected, abs=1e-12)
    assert joint_measure(made, SimpleNamespace(joint="drive"))["statement"] is made.coordinates[0].statement
