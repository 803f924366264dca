"""Scenes of mechanisms with two rigid coordinates, made in memory as those of `scenes`."""

from collections.abc import Sequence

from pgmp_petsc.scene import Scene
from scenes import HEADER, TURN, of_text, tables

UPPER, LOWER = 0.5, 0.4

# two bars of four cells that hang from each other
DOUBLE_PENDULUM = HEADER + tables(f"""
bodies.upper: mesh = "0.0:{UPPER}:4"; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = 5e-3 }}
bodies.lower: mesh = "0.0:{LOWER}:4"; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = 4e-3 }}
joints.shoulder: type = "revolute"; connect = ["ground:origin", "upper:hinge"]
joints.elbow: type = "revolute"; connect = ["upper:tip", "lower:hinge"]
coordinates.theta1: joint = "shoulder"; {TURN}
coordinates.theta2: joint = "elbow"; {TURN}
effects.motor: type = "torque"; joint = "elbow"; table = [[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]
reduction: modes = 3; angles = 8
""")
double_pendulum = of_text(DOUBLE_PENDULUM)
# a third bar on the double pendulum, with a coordinate
THIRD = (
    'bodies.hand={mesh="0.0:0.1:2",element="beam2d",material="steel",section={shape="circle",radius=4e-3}}',
    'joints.wrist={type="revolute",connect=["lower:tip","hand:hinge"]}',
    'coordinates.theta3={joint="wrist",range=[0.0,1.0]}',
)

# two driven cranks on a ground of 0.6 m, joined by two couplers that meet at a pin
BASE, LEFT, RIGHT, COUPLER = 0.6, 0.2, 0.25, 0.6
FIVE_BAR = HEADER + tables(f"""
ground.points: right = [{BASE}, 0.0]
bodies.left: mesh = "0.0:{LEFT}:2"; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = 5e-3 }}; placement = {{ origin = [0.0, 0.0], angle = 2.0 }}
bodies.right: mesh = "0.0:{RIGHT}:2"; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = 5e-3 }}; placement = {{ origin = [{BASE}, 0.0], angle = 1.0 }}
bodies.first: mesh = "0.0:{COUPLER}:4"; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = 4e-3 }}; placement = {{ origin = [-0.1, 0.2], angle = 0.8 }}
bodies.second: mesh = "0.0:{COUPLER}:4"; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = 4e-3 }}; placement = {{ origin = [0.75, 0.2], angle = 2.3 }}
joints.left_hinge: type = "revolute"; connect = ["ground:origin", "left:hinge"]
joints.right_hinge: type = "revolute"; connect = ["ground:right", "right:hinge"]
joints.left_elbow: type = "revolute"; connect = ["left:tip", "first:hinge"]
joints.right_elbow: type = "revolute"; connect = ["right:tip", "second:hinge"]
joints.pin: type = "revolute"; connect = ["first:tip", "second:tip"]
coordinates.theta1: joint = "left_hinge"; {TURN}
coordinates.theta2: joint = "right_hinge"; {TURN}
reduction: modes = 3; angles = 12
""")
five_bar = of_text(FIVE_BAR)


def over(scene: Scene, angles: Sequence[int]) -> Scene:
    """Return a scene with its own number of angles for each coordinate."""
    return scene.model_copy(update={"reduction": scene.reduction.model_copy(update={"angles": tuple(angles)})})
