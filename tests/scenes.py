"""Scenes and meshes made in memory, for tests of everything between a scene and its reduced-order model.

In these scenes the entry ``mesh`` of a body is no path but ``"first:last:n"``: a straight line of n cells on the x axis
of the body's own frame, from x = first to x = last (m). `meshes_of` makes the meshes; they have the points hinge and
tip.
"""

import numpy as np

from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh import LineMesh
from pgmp_petsc.scene import Scene, scene_from_toml

CRANK, ROD, RADIUS = 0.3, 0.7, 5.6e-3
STEEL = {"E": 210e9, "nu": 0.3, "rho": 7800.0}
FULL_TURN = "range = [0.0, 6.283185307179586]\nperiodic = true"
SHEAR_FACTOR = 6 * 1.3 / (7 + 6 * 0.3)  # of a circle, nu = 0.3

HEADER = """
[scene]
name = "test"
[materials.steel]
E = 210e9
nu = 0.3
rho = 7800.0
"""


def beam(name: str, mesh: str, radius: str, more: str = "", element: str = "beam2d") -> str:
    """Return the table of a round beam of steel; the radius as TOML writes it."""
    section = f'section = {{ shape = "circle", radius = {radius} }}'
    return f'[bodies.{name}]\nmesh = "{mesh}"\nelement = "{element}"\nmaterial = "steel"\n{section}\n{lined(more)}'


def joint(name: str, a: str, b: str, more: str = "", kind: str = "revolute") -> str:
    """Return the table of a joint between two points."""
    return f'[joints.{name}]\ntype = "{kind}"\nconnect = ["{a}", "{b}"]\n{lined(more)}'


def slide(name: str, a: str, b: str, direction: str = "[1.0, 0.0]") -> str:
    """Return the table of a joint that keeps point b on a line through point a."""
    return joint(name, a, b, f"direction = {direction}", "point_on_line")


def turning(name: str, joint: str, area: str = FULL_TURN) -> str:
    """Return the table of a coordinate, the angle of a joint."""
    return f'[coordinates.{name}]\njoint = "{joint}"\n{area}\n'


def torque(joint: str, table: str = "[[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]") -> str:
    """Return the table of a motor at a joint."""
    return f'[effects.motor]\ntype = "torque"\njoint = "{joint}"\ntable = {table}\n'


def reduction(modes: int, angles: int) -> str:
    return f"[reduction]\nmodes = {modes}\nangles = {angles}\n"


def placed(x: float, y: float, angle: float) -> str:
    """Return the entry of a body's placement."""
    return f"placement = {{ origin = [{x}, {y}], angle = {angle} }}"


def lined(text: str) -> str:
    return text and text + "\n"


def output(name: str, kind: str, **entries: str) -> str:
    """Return the table of an output whose entries are texts."""
    return f'[outputs.{name}]\ntype = "{kind}"\n' + "".join(f'{key} = "{text}"\n' for key, text in entries.items())


WEIGHT = '[effects.weight]\ntype = "gravity"\n'
OUTPUTS = output("crank_angle", "angle", joint="crank_hinge") + output(
    "slider_deformation", "deformation", point="rod:tip", axis="x"
)
RADIUS_OF_CRANK = '[parameters.r1]\nnominal = 5.6e-3\nunit = "m"\n'
SLIDER_CRANK = (
    HEADER
    + RADIUS_OF_CRANK
    + beam("crank", "0.0:0.3:5", '"r1"')
    + beam("rod", "0.3:1.0:5", "5.6e-3")
    + joint("crank_hinge", "ground:origin", "crank:hinge")
    + joint("elbow", "crank:tip", "rod:hinge")
    + slide("slider", "ground:origin", "rod:tip")
    + turning("theta", "crank_hinge")
    + torque("crank_hinge")
    + reduction(5, 24)
)
PENDULUM = (
    HEADER
    + beam("arm", "0.0:1.0:10", "2e-4")
    + joint("hinge", "ground:origin", "arm:hinge")
    + turning("phi", "hinge")
    + reduction(2, 6)
)
# ground 1 m, crank 0.3 m, coupler 0.9 m, rocker 0.7 m: the crank turns all the way round (Grashof)
FOUR_BAR = (
    HEADER
    + "[ground.points]\npivot = [1.0, 0.0]\n"
    + beam("crank", "0.0:0.3:2", "5e-3")
    + beam("coupler", "0.0:0.9:2", "5e-3", placed(0.3, 0.0, 0.8))
    + beam("rocker", "0.0:0.7:2", "5e-3", placed(1.0, 0.0, 1.5)).replace(
        '"circle", radius = 5e-3', '"rectangle", width = 1e-2, height = 5e-3'
    )
    + joint("crank_hinge", "ground:origin", "crank:hinge")
    + joint("elbow", "crank:tip", "coupler:hinge")
    + joint("knee", "coupler:tip", "rocker:tip")
    + joint("rocker_hinge", "rocker:hinge", "ground:pivot")
    + turning("theta", "crank_hinge")
    + reduction(4, 24)
)
# A rod of 1 m with its ends on the x and the y axis, and a crank of 0.5 m from the origin to its middle: one constraint
# is redundant without being the repetition of another. The angle between them is back after half a turn of the rod.
TRAMMEL = (
    HEADER
    + beam("rod", "0.0:1.0:4", "5e-3", placed(1.0, 0.0, np.pi))
    + beam("crank", "0.0:0.5:2", "5e-3")
    + slide("along_x", "ground:origin", "rod:hinge")
    + slide("along_y", "ground:origin", "rod:tip", "[0.0, -2.0]")
    + joint("crank_hinge", "ground:origin", "crank:hinge")
    + joint("middle", "rod:2", "crank:tip")
    + turning("theta", "crank_hinge")
    + reduction(3, 16)
)


def slider_crank(*overrides: str) -> Scene:
    """Return the slider-crank of the paper, with few modes and angles; crank 0.3 m, rod 0.7 m, 5 cells each."""
    return scene_from_toml(SLIDER_CRANK, ".", overrides)


def pendulum(*overrides: str) -> Scene:
    """Return a slender beam of 1 m hinged to the ground at one end."""
    return scene_from_toml(PENDULUM, ".", overrides)


def four_bar(*overrides: str) -> Scene:
    """Return a crank-rocker of 0.3 m, 0.9 m and 0.7 m on a ground of 1 m."""
    return scene_from_toml(FOUR_BAR, ".", overrides)


def trammel(*overrides: str) -> Scene:
    """Return an elliptic trammel with a redundant crank."""
    return scene_from_toml(TRAMMEL, ".", overrides)


def straight(first: float, last: float, n_cells: int) -> LineMesh:
    """Return a straight mesh on the x axis."""
    nodes = np.column_stack([np.linspace(first, last, n_cells + 1), np.zeros(n_cells + 1)])
    cells = np.column_stack([np.arange(n_cells), np.arange(1, n_cells + 1)])
    return LineMesh(nodes, cells, {"hinge": 0, "tip": n_cells})


def meshes_of(scene: Scene) -> dict[str, LineMesh]:
    """Return the meshes that a scene's entries ``mesh`` describe."""
    parts = {name: body.mesh.split(":") for name, body in scene.bodies.items()}
    return {name: straight(float(first), float(last), int(n)) for name, (first, last, n) in parts.items()}


def mechanism_of(scene: Scene) -> Mechanism:
    """Return the mechanism of a scene."""
    return Mechanism.from_scene(scene, meshes_of(scene))


def kinematics_of(scene: Scene) -> RigidKinematics:
    """Return the rigid kinematics of a scene."""
    return RigidKinematics(mechanism_of(scene))
