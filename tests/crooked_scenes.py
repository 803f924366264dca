"""Four-bars in space with parallel hinges, of which some may be a little off: as crank-rockers of slender beams."""

from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, tables

# data of Bauchau's four-bar (Flexible Multibody Dynamics, 2011, section 17): 0.24 m, 0.08 m, 0.24 m, 0.16 m
FOUR_BAR = HEADER + tables("""
ground.points: D = [0.24, 0.0, 0.0]
bodies.crank: line = { length = 0.08, elements = 2 }; element = "beam3d"; material = "steel";
    section = { shape = "rectangle", width = 0.016, height = 0.016 }; orientation = [0.0, 1.0, 0.0];
    placement = { origin = [0.0, 0.0, 0.0], rotation = [0.0, 0.0, 1.5707963267948966] }
bodies.coupler: line = { length = 0.24, elements = 4 }; element = "beam3d"; material = "steel";
    section = { shape = "rectangle", width = 0.016, height = 0.016 }; orientation = [0.0, 1.0, 0.0];
    placement = { origin = [0.0, 0.08, 0.0], rotation = [0.0, 0.0, 0.3373074814297669] }
bodies.rocker: line = { length = 0.16, elements = 2 }; element = "beam3d"; material = "steel";
    section = { shape = "rectangle", width = 0.008, height = 0.008 }; orientation = [0.0, 1.0, 0.0];
    placement = { origin = [0.22647580015448898, 0.15942740046346704, 0.0], rotation = [0.0, 0.0, -1.4861691005072084] }
joints.A: type = "revolute"; connect = ["ground:origin", "crank:hinge"]; axis = [0.0, 0.0, 1.0]
joints.B: type = "revolute"; connect = ["crank:tip", "coupler:hinge"]; axis = [0.0, 0.0, 1.0]
joints.C: type = "revolute"; connect = ["coupler:tip", "rocker:hinge"]; axis = [0.0, 0.0, 1.0]
joints.D: type = "revolute"; connect = ["ground:D", "rocker:tip"]; axis = [0.0, 0.0, 1.0]
coordinates.theta: joint = "A"; range = [-0.5, 0.5]
effects.motor: type = "torque"; joint = "A"; table = [[0.0, 0.0], [0.01, 1.0]]
reduction: modes = 4; angles = 12
simulation: duration = 0.005; step = 2.5e-4
outputs.angle: type = "angle"; joint = "D"
outputs.aside: type = "displacement"; point = "coupler:tip"; axis = "z"
""")


def spatial_four_bar(*overrides: str) -> Scene:
    """Return the four-bar, which closes without a gap unless overrides make it crooked."""
    return scene_from_toml(FOUR_BAR, ".", overrides)


def pivot_off(distance: float) -> str:
    """Return an override that moves a bearing of the ground out of the plane, m."""
    return f"ground.points.D=[0.24,0.0,{distance}]"
