"""Scenes with elastic joints: a machine frame on mounts, a rotor in bearings."""

import numpy as np
from mpi4py import MPI
from pencils import modal_problem

from pgmp_petsc.modes.static_modes import VibrationProblem, frequencies_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.modes_table import springs_of
from scenes import HEADER, kinematics_of, of_text, tables

# a frame of 1 m on two mounts, on its middle a balanced wheel that a torque may turn
RIGID = HEADER + tables("""
ground.points: left = [0.0, 0.0]; right = [1.0, 0.0]
parameters.k: nominal = 4e4
bodies.frame: rigid = { mass = 10.0, centre = [0.5, 0.0], inertia = 1.5, points = { left = [0, 0], right = [1, 0] } }
bodies.wheel: rigid = { mass = 2.0, centre = [0, 0], inertia = 0.1, points = { } }; placement = { origin = [0.5, 0.0] }
joints.hub: type = "revolute"; connect = ["frame:centre", "wheel:centre"]
joints.one: type = "fixed"; connect = ["ground:left", "frame:left"];
    elastic = { reference = [[1.0, 0.0]], stiffness = [2e4, "k"], damping = [60.0, 90.0], turning_stiffness = [0.0] }
joints.two: type = "fixed"; connect = ["ground:right", "frame:right"];
    elastic = { reference = [[1.0, 0.0]], stiffness = [1e4, "k"], damping = [0.0, 30.0], turning_stiffness = [0.0] }
coordinates.theta: joint = "hub"; range = [-3.0, 3.0]
effects.weight: type = "gravity"
simulation: duration = 0.5; step = 2e-3
outputs.y: type = "displacement"; point = "frame:centre"; axis = "y"
outputs.x: type = "displacement"; point = "frame:centre"; axis = "x"
outputs.left: type = "displacement"; point = "frame:left"; axis = "y"
""")
rigid_frame = of_text(RIGID)

# the same with a flexible frame and a flexible crank
MACHINE = HEADER + tables("""
ground.points: left = [0.0, 0.0]; right = [1.0, 0.0]
parameters.k: nominal = 2e6; distribution = { name = "uniform", loc = 1.5e6, scale = 1e6 }
parameters.c: nominal = 200.0
bodies.frame: line = { length = 1.0, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.05, height = 0.1 }
bodies.crank: line = { length = 0.3, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.02, height = 0.02 }; placement = { origin = [0.5, 0.0] }
joints.hub: type = "revolute"; connect = ["frame:middle", "crank:hinge"]
joints.one: type = "fixed"; connect = ["ground:left", "frame:hinge"];
    elastic = { reference = [[1.0, 0.0]], stiffness = [1e6, "k"], damping = ["c", "c"], turning_stiffness = [0.0] }
joints.two: type = "fixed"; connect = ["ground:right", "frame:tip"];
    elastic = { reference = [[1.0, 0.0]], stiffness = [1e6, "k"], damping = ["c", "c"], turning_stiffness = [0.0] }
coordinates.theta: joint = "hub"; range = [0.0, 6.283185307179586]; periodic = true
effects.motor: type = "torque"; joint = "hub"; table = [[0.0, 0.0], [0.1, 5.0], [1.0, 5.0]]
reduction: modes = 4; angles = 24
simulation: duration = 0.2; step = 2.5e-4
outputs.lift: type = "displacement"; point = "frame:tip"; axis = "y"
outputs.bent: type = "deformation"; point = "crank:tip"; axis = "y"; frame = "body"
outputs.theta: type = "angle"; joint = "hub"
""")
machine = of_text(MACHINE)
# the same in space, on soft mounts, without a motor
MACHINE_IN_SPACE = HEADER + tables("""
ground.points: left = [0.0, 0.0, 0.0]; right = [1.0, 0.0, 0.0]
bodies.frame: line = { length = 1.0, elements = 4 }; element = "beam3d"; material = "steel";
    orientation = [0.0, 1.0, 0.0]; section = { shape = "rectangle", width = 0.05, height = 0.1 }
bodies.crank: line = { length = 0.3, elements = 4 }; element = "beam3d"; material = "steel";
    orientation = [0.0, 1.0, 0.0]; section = { shape = "rectangle", width = 0.02, height = 0.02 };
    placement = { origin = [0.5, 0.0, 0.0] }
joints.hub: type = "revolute"; connect = ["frame:middle", "crank:hinge"]; axis = [0.0, 0.0, 1.0]
joints.one: type = "fixed"; connect = ["ground:left", "frame:hinge"]
joints.one.elastic: reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]; stiffness = [1e6, 4e4, 5e4];
    turning_stiffness = [1e4, 0.0, 0.0]
joints.two: type = "fixed"; connect = ["ground:right", "frame:tip"]
joints.two.elastic: reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]; stiffness = [1e6, 1e4, 2e4];
    turning_stiffness = [1e4, 0.0, 0.0]
coordinates.theta: joint = "hub"; range = [0.0, 6.283185307179586]; periodic = true
""")
machine_in_space = of_text(MACHINE_IN_SPACE)
# a boom, level at 0.7 rad, and at its end a head that an elastic belt holds
BOOM = HEADER + tables("""
bodies.boom: line = { length = 3.0, elements = 6 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.03, height = 0.06 }; placement = { angle = -0.7 }
bodies.head: rigid = { mass = 20.0, centre = [0.1, -0.2], inertia = 0.3, points = { axle = [0.0, 0.0] } };
    placement = { origin = [2.2945265618534654, -1.9326530617130731] }
joints.pivot: type = "revolute"; connect = ["ground:origin", "boom:hinge"]
joints.axle: type = "revolute"; connect = ["boom:tip", "head:axle"]
joints.belt: type = "belt"; joints = ["pivot", "axle"]; ratio = -1.0; elastic = { stiffness = 1e3 }
coordinates.theta: joint = "pivot"; range = [0.3, 1.1]
""")
boom = of_text(BOOM)
# a tube that sags under a panel beside its axis, on a flange that turns
TUBE = HEADER + tables("""
ground.points: post = [12.0, 0.0, 0.0]
bodies.hub: rigid = { mass = 30.0, inertia = [0.8, 0.5, 0.5, 0.0, 0.0, 0.0], points = { axis = [0.0, 0.0, 0.0] } }
bodies.tube: line = { length = 12.0, elements = 6 }; element = "beam3d"; material = "steel";
    orientation = [0.0, 1.0, 0.0]; section = { shape = "hollow_rectangle", width = 0.12, height = 0.12, wall = 4e-3 }
bodies.panel: placement = { origin = [8.0, 0.0, 0.0] };
    rigid = { mass = 260.0, centre = [0.0, 0.0, 0.12], inertia = [90, 820, 900, 0, 0, 0], points = { on = [0, 0, 0] } }
joints.drive: type = "revolute"; connect = ["ground:origin", "hub:axis"]; axis = [1.0, 0.0, 0.0]
joints.flange: type = "fixed"; connect = ["hub:axis", "tube:hinge"]
joints.flange.elastic: reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]; turning_stiffness = [2e4, inf, inf]
joints.post: type = "cylindrical"; connect = ["ground:post", "tube:tip"]; axis = [1.0, 0.0, 0.0]
joints.clamp: type = "fixed"; connect = ["tube:4", "panel:on"]
coordinates.tilt: joint = "drive"; range = [-0.5, 0.5]
effects.hold: type = "prescribed_motion"; coordinate = "tilt"; table = [[0.0, 0.0], [9.0, 0.0]]
effects.weight: type = "gravity"; direction = [0.0, 0.0, -1.0]
effects.wind: type = "law"; joint = "post"; motion = "turning"; force = "600 * min(5 * t, 1)"
effects.second: type = "geometric_stiffening"
effects.inertia: type = "mode_inertia"
reduction: modes = 6; angles = 9; static_modes = true; inertia_modes = true
initial: equilibrium = true
simulation: duration = 1.0; step = 2e-3
outputs.aside: type = "deformation"; point = "panel:on"; axis = "y"
outputs.twist: type = "angle"; joint = "post"
""")
tube = of_text(TUBE)

SHAFT, N_ELEMENTS, SIDE = 0.8, 8, 0.02
DISCS = {"2": 3.0, "5": 2.0}  # kg, by the node that they are on
BEARINGS = (3e6, 2e6), (5e6, 4e6)  # N/m along y and z, at both ends
ROTOR = HEADER + tables(f"""
ground.points: left = [0.0, 0.0, 0.0]; right = [{SHAFT}, 0.0, 0.0]
bodies.shaft: line = {{ length = {SHAFT}, elements = {N_ELEMENTS} }}; element = "beam3d"; material = "steel";
    orientation = [0.0, 1.0, 0.0]; section = {{ shape = "rectangle", width = {SIDE}, height = {SIDE} }}
joints.left: type = "revolute"; connect = ["ground:left", "shaft:hinge"]; axis = [1.0, 0.0, 0.0]
joints.left.elastic: reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    stiffness = [inf, {BEARINGS[0][0]}, {BEARINGS[0][1]}]; turning_stiffness = [0.0, 0.0, 0.0]
joints.right: type = "cylindrical"; connect = ["ground:right", "shaft:tip"]; axis = [1.0, 0.0, 0.0]
joints.right.elastic: reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    stiffness = [0.0, {BEARINGS[1][0]}, {BEARINGS[1][1]}]; turning_stiffness = [0.0, 0.0, 0.0]
coordinates.spin: joint = "left"; range = [-0.2, 0.2]
effects.one: type = "point_mass"; point = "shaft:2"; mass = {DISCS["2"]}
effects.other: type = "point_mass"; point = "shaft:5"; mass = {DISCS["5"]}
reduction: modes = 6; angles = 4
""")
rotor = of_text(ROTOR)


def vibrations(scene: Scene, theta: float = 0.0) -> np.ndarray:
    """Return the frequencies of a scene on its springs at one configuration, Hz."""
    kinematics = kinematics_of(scene)
    springs, _ = springs_of(scene, kinematics)
    if springs is None:
        with modal_problem(kinematics, scene.values, scene.reduction.modes) as problem:
            return problem.solve(theta).frequencies_hz
    with VibrationProblem(springs, scene.values, scene.reduction.modes, MPI.COMM_SELF) as problem:
        return frequencies_of(problem.eigenvalues(np.array([theta])))
