"""Beams that are clamped at both ends, one of which is off, beside a pendulum: a mechanism has a coordinate."""

import numpy as np

from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, tables

LENGTH, WIDTH, HEIGHT = 0.5, 0.02, 0.01
E, NU = 210e9, 0.3
G, SHEAR = E / (2.0 * (1.0 + NU)), 10.0 * (1.0 + NU) / (12.0 + 11.0 * NU)  # Cowper 1966, of rectangles
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


def clamped_beam(*overrides: str) -> Scene:
    """Return the beam, which is straight unless overrides give its right end an offset."""
    return scene_from_toml(CLAMPED, ".", overrides)


def offset(joint: str, **given: object) -> str:
    """Return an override that moves or turns a joint."""
    entries = ", ".join(f"{key} = {value}" for key, value in given.items())
    return f"joints.{joint}.offset={{{entries}}}"


def clamped_stiffness() -> np.ndarray:
    """Return force and moment at the end of a clamped Timoshenko beam for its displacement and rotation there."""
    inertia, area = WIDTH * HEIGHT**3 / 12.0, WIDTH * HEIGHT
    phi = 12.0 * E * inertia / (SHEAR * G * area * LENGTH**2)
    own = np.array([[12.0, -6.0 * LENGTH], [-6.0 * LENGTH, (4.0 + phi) * LENGTH**2]])
    return E * inertia / (LENGTH**3 * (1.0 + phi)) * own
