"""Scenes of mechanisms with two rigid coordinates, made in memory as those of `scenes`."""

from collections.abc import Sequence

from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, beam, joint, placed, reduction, torque, turning

UPPER, LOWER = 0.5, 0.4

DOUBLE_PENDULUM = (
    HEADER
    + beam("upper", f"0.0:{UPPER}:4", "5e-3")
    + beam("lower", f"0.0:{LOWER}:4", "4e-3")
    + joint("shoulder", "ground:origin", "upper:hinge")
    + joint("elbow", "upper:tip", "lower:hinge")
    + turning("theta1", "shoulder")
    + turning("theta2", "elbow")
    + torque("elbow")
    + reduction(3, 8)
)

# two driven cranks on a ground of 0.6 m, joined by two couplers that meet at a pin
BASE, LEFT, RIGHT, COUPLER = 0.6, 0.2, 0.25, 0.6
FIVE_BAR = (
    HEADER
    + f"[ground.points]\nright = [{BASE}, 0.0]\n"
    + beam("left", f"0.0:{LEFT}:2", "5e-3", placed(0.0, 0.0, 2.0))
    + beam("right", f"0.0:{RIGHT}:2", "5e-3", placed(BASE, 0.0, 1.0))
    + beam("first", f"0.0:{COUPLER}:4", "4e-3", placed(-0.1, 0.2, 0.8))
    + beam("second", f"0.0:{COUPLER}:4", "4e-3", placed(0.75, 0.2, 2.3))
    + joint("left_hinge", "ground:origin", "left:hinge")
    + joint("right_hinge", "ground:right", "right:hinge")
    + joint("left_elbow", "left:tip", "first:hinge")
    + joint("right_elbow", "right:tip", "second:hinge")
    + joint("pin", "first:tip", "second:tip")
    + turning("theta1", "left_hinge")
    + turning("theta2", "right_hinge")
    + reduction(3, 12)
)


def double_pendulum(*overrides: str) -> Scene:
    """Return two bars of 0.5 m and 0.4 m that hang from each other, four cells each."""
    return scene_from_toml(DOUBLE_PENDULUM, ".", overrides)


def five_bar(*overrides: str) -> Scene:
    """Return a five-bar linkage with two driven cranks, both of which turn all the way round."""
    return scene_from_toml(FIVE_BAR, ".", overrides)


def over(scene: Scene, angles: Sequence[int]) -> Scene:
    """Return a scene with its own number of angles for each coordinate."""
    return scene.model_copy(update={"reduction": scene.reduction.model_copy(update={"angles": tuple(angles)})})
