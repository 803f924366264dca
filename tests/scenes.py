"""Scenes and meshes made in memory, for tests of everything between a scene and its reduced-order model.

In these scenes the entry ``mesh`` of a body is no path but ``"first:last:n"``: a straight line of n cells on the x axis
of the body's own frame, from x = first to x = last (m), or a bar of `spatial`. `meshes_of` makes the meshes; they have
the points, or groups of faces, hinge and tip.
"""

import re
from collections.abc import Callable

import numpy as np

from pgmp_petsc.bodies.shape import BodyShape, shape_in_scene
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh import LineMesh, read_line_mesh
from pgmp_petsc.mesh.meshes import straight_beam
from pgmp_petsc.scene import Scene, scene_from_toml

CRANK, ROD, RADIUS = 0.3, 0.7, 5.6e-3
STEEL = {"E": 210e9, "nu": 0.3, "rho": 7800.0}
TURN = "range = [0.0, 6.283185307179586]; periodic = true"
SHEAR_FACTOR = 6 * 1.3 / (7 + 6 * 0.3)  # of a circle, nu = 0.3


def tables(text: str) -> str:
    """Return TOML of lines ``table: entry; entry``; a line that ends in a semicolon goes on, indented, in the next."""
    lines = re.compile(r"^([\w.]+): (.*(?:(?<=;)\n +.*)*)$", re.MULTILINE)
    return lines.sub(lambda row: "\n".join([f"[{row[1]}]", *re.split(r";\s+", row[2])]), text)


def of_text(text: str, *overrides: str) -> Callable[..., Scene]:
    """Return what makes the scene of a text with these overrides and those that it is given."""
    return lambda *more: scene_from_toml(text, ".", (*overrides, *more))


HEADER = tables("""
scene: name = "test"
materials.steel: E = 210e9; nu = 0.3; rho = 7800.0
""")

# the slider-crank of the paper, crank 0.3 m and rod 0.7 m of 5 cells each, with few modes and angles
SLIDER_CRANK = HEADER + tables("""
parameters.r1: nominal = 5.6e-3; unit = "m"
bodies.crank: mesh = "0.0:0.3:5"; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = "r1" }
bodies.rod: mesh = "0.3:1.0:5"; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 5.6e-3 }
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
joints.slider: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = [1.0, 0.0]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.motor: type = "torque"; joint = "crank_hinge"; table = [[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]
reduction: modes = 5; angles = 24
""")
slider_crank = of_text(SLIDER_CRANK)

# a slender beam hinged to the ground at one end
PENDULUM = HEADER + tables("""
bodies.arm: mesh = "0.0:1.0:10"; element = "beam2d"; material = "steel"; section = { shape = "circle", radius = 2e-4 }
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:hinge"]
coordinates.phi: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
reduction: modes = 2; angles = 6
""")
pendulum = of_text(PENDULUM)

# ground 1 m, crank 0.3 m, coupler 0.9 m, rocker 0.7 m: the crank turns all the way round (Grashof)
FOUR_BAR = HEADER + tables("""
ground.points: pivot = [1.0, 0.0]
bodies.crank: mesh = "0.0:0.3:2"; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 5e-3 }
bodies.coupler: mesh = "0.0:0.9:2"; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 5e-3 }; placement = { origin = [0.3, 0.0], angle = 0.8 }
bodies.rocker: mesh = "0.0:0.7:2"; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 1e-2, height = 5e-3 }; placement = { origin = [1.0, 0.0], angle = 1.5 }
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "coupler:hinge"]
joints.knee: type = "revolute"; connect = ["coupler:tip", "rocker:tip"]
joints.rocker_hinge: type = "revolute"; connect = ["rocker:hinge", "ground:pivot"]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 6.283185307179586]; periodic = true
reduction: modes = 4; angles = 24
""")
four_bar = of_text(FOUR_BAR)

# A rod of 1 m with its ends on the x and the y axis, and a crank of 0.5 m from the origin to its middle. The crank
# follows from the rod, so one constraint is redundant without being the repetition of another. The angle between crank
# and rod is twice the rod's angle, so that it is back after half a turn of the rod.
TRAMMEL = HEADER + tables("""
bodies.rod: mesh = "0.0:1.0:4"; element = "beam2d"; material = "steel"; section = { shape = "circle", radius = 5e-3 };
    placement = { origin = [1.0, 0.0], angle = 3.141592653589793 }
bodies.crank: mesh = "0.0:0.5:2"; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 5e-3 }
joints.along_x: type = "point_on_line"; connect = ["ground:origin", "rod:hinge"]; direction = [1.0, 0.0]
joints.along_y: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = [0.0, -2.0]
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.middle: type = "revolute"; connect = ["rod:2", "crank:tip"]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 6.283185307179586]; periodic = true
reduction: modes = 3; angles = 16
""")
trammel = of_text(TRAMMEL)


def straight(first: float, last: float, n_cells: int) -> LineMesh:
    """Return a straight mesh on the x axis."""
    nodes = np.column_stack([np.linspace(first, last, n_cells + 1), np.zeros(n_cells + 1)])
    cells = np.column_stack([np.arange(n_cells), np.arange(1, n_cells + 1)])
    return LineMesh(nodes, cells, {"hinge": 0, "tip": n_cells})


def meshes_of(scene: Scene) -> dict[str, BodyShape]:
    return {name: shape_in_scene(scene, name) or _mesh(scene, name) for name in scene.bodies}


def _mesh(scene: Scene, name: str) -> BodyShape:
    body = scene.bodies[name]
    if ":" not in body.mesh:
        return read_line_mesh(scene.path_of(body.mesh), name)
    first, last, n = (kind(part) for kind, part in zip((float, float, int), body.mesh.split(":")))
    if body.continuum:
        from spatial import bar  # its libraries are loaded where there are cells alone

        return bar(first, last, n, body.dimension)
    return straight_beam(last - first, n, first, 3) if body.dimension == 3 else straight(first, last, n)


def mechanism_of(scene: Scene) -> Mechanism:
    return Mechanism.from_scene(scene, meshes_of(scene))


def kinematics_of(scene: Scene) -> RigidKinematics:
    return RigidKinematics(mechanism_of(scene))
