"""Four-bars in space and clamped beams whose joints may be off, beside a pendulum: a mechanism has a coordinate."""

import numpy as np

from scenes import HEADER, of_text, tables

LENGTH, WIDTH, HEIGHT = 0.5, 0.02, 0.01
E, NU = 210e9, 0.3
G, SHEAR = E / (2.0 * (1.0 + NU)), 10.0 * (1.0 + NU) / (12.0 + 11.0 * NU)  # Cowper 1966, of rectangles
# a beam that is straight unless overrides give its right end an offset
CLAMPED = HEADER + tables(f"""
ground.points: end = [{LENGTH}, 0.0]; beside = [0.0, -0.2]
bodies.beam: line = {{ length = {LENGTH}, elements = 4 }}; element = "beam2d"; material = "steel";
    section = {{ shape = "rectangle", width = {WIDTH}, height = {HEIGHT} }}
bodies.arm: line = {{ length = 0.1, elements = 1 }}; element = "beam2d"; material = "steel"; flexible = false;
    section = {{ shape = "rectangle", width = 0.01, height = 0.01 }}
joints.left: type = "fixed"; connect = ["ground:origin", "beam:hinge"]
joints.right: type = "fixed"; connect = ["ground:end", "beam:tip"]
joints.hinge: type = "revolute"; connect = ["ground:beside", "arm:hinge"]
coordinates.theta: joint = "hinge"; range = [-1.0, 1.0]
simulation: duration = 0.01; step = 1e-3
reduction: modes = 2; angles = 6
outputs.middle: type = "displacement"; point = "beam:middle"; axis = "y"
""")
clamped_beam = of_text(CLAMPED)


def offset(joint: str, **given: object) -> str:
    entries = ", ".join(f"{key} = {value}" for key, value in given.items())
    return f"joints.{joint}.offset={{{entries}}}"


def clamped_stiffness() -> np.ndarray:
    """Return force and moment at the end of a clamped Timoshenko beam for its displacement and rotation there."""
    inertia, area = WIDTH * HEIGHT**3 / 12.0, WIDTH * HEIGHT
    phi = 12.0 * E * inertia / (SHEAR * G * area * LENGTH**2)
    own = np.array([[12.0, -6.0 * LENGTH], [-6.0 * LENGTH, (4.0 + phi) * LENGTH**2]])
    return E * inertia / (LENGTH**3 * (1.0 + phi)) * own


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
spatial_four_bar = of_text(FOUR_BAR)


def pivot_off(distance: float) -> str:
    """Return an override that moves a bearing of the ground out of the plane, m."""
    return f"ground.points.D=[0.24,0.0,{distance}]"
