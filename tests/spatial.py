"""Mechanisms in space made in memory: scenes, and meshes of square bars of solid elements.

As in `scenes`, the entry ``mesh`` of a body is ``"first:last:n"``: here a bar of n hexahedra (in the plane,
quadrilaterals) whose axis is the x axis of the body's frame, from x = first to x = last (m). Its ends are the groups of
faces hinge and tip.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from conftest import ROOT
from solids import box_mesh, rectangle_mesh

from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml
from scenes import HEADER, TURN, of_text, tables

WIDTH = 0.01  # of the square bars, m
DENSITY = 7800.0  # of steel, kg/m3

# the slider-crank of `scenes`, crank 0.3 m and rod 0.7 m, with hinges in space
SLIDER_CRANK = HEADER + tables(f"""
bodies.crank: mesh = "0.0:0.3:2"; element = "solid3d"; material = "steel"
bodies.rod: mesh = "0.3:1.0:3"; element = "solid3d"; material = "steel"
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]; axis = [0.0, 0.0, 1.0]
joints.elbow: type = "revolute"; connect = ["crank:tip", "rod:hinge"]; axis = [0.0, 0.0, 1.0]
joints.slider: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = [1.0, 0.0, 0.0]
coordinates.theta: joint = "crank_hinge"; {TURN}
reduction: modes = 4; angles = 16
""")
slider_crank_in_space = of_text(SLIDER_CRANK)
LIMITED = ("coordinates.theta.range=[-1.0,1.0]", "coordinates.theta.periodic=false")

# two bars, the second one hinged to the first about an axis that is neither along it nor at a right angle
UPPER, LOWER = 0.5, 0.4
SECOND_AXIS = np.array([0.6, 0.0, 0.8])
ARM = HEADER + tables(f"""
bodies.upper: mesh = "0.0:{UPPER}:2"; element = "solid3d"; material = "steel"
bodies.lower: mesh = "0.0:{LOWER}:2"; element = "solid3d"; material = "steel"
joints.shoulder: type = "revolute"; connect = ["ground:origin", "upper:hinge"]; axis = [0.0, 0.0, 1.0]
joints.elbow: type = "revolute"; connect = ["upper:tip", "lower:hinge"]; axis = {SECOND_AXIS.tolist()}
coordinates.theta1: joint = "shoulder"; {TURN}
coordinates.theta2: joint = "elbow"; {TURN}
reduction: modes = 3; angles = 6
""")
arm = of_text(ARM)

# the repository's spatial slider-crank: crank, rod, and the bearing of the crank
CRANK, ROD, BEARING = 0.1, 0.3, np.array([0.0, 0.1, 0.12])
SPATIAL_BARS = (
    'bodies.crank.mesh="0.0:0.1:2"', 'bodies.rod.mesh="0.0:0.3:3"', 'bodies.slider.mesh="0.0:0.05:1"',
)  # fmt: skip


@cache
def bar(first: float, last: float, n: int, dimension: int = 3) -> SolidMesh:
    """Return a square bar along the x axis, in the plane a rectangle, of quadratic cells."""
    size = (last - first, WIDTH, WIDTH)
    mesh = box_mesh("hexahedron20", (n, 1, 1), size) if dimension == 3 else rectangle_mesh("quad8", (n, 1), size[:2])
    nodes = mesh.nodes + np.array([first, -WIDTH / 2, -WIDTH / 2])[:dimension]
    return replace(mesh, nodes=nodes, groups={"hinge": mesh.groups["left"], "tip": mesh.groups["right"]})


def part_of_arm(end: float) -> tuple[str, ...]:
    """Return overrides that let the arm turn so far to both sides."""
    return tuple(
        f"coordinates.theta{k}.{entry}" for k in (1, 2) for entry in (f"range=[-{end},{end}]", "periodic=false")
    )


def spatial_slider_crank(*overrides: str) -> Scene:
    """Return the repository's spatial slider-crank with square bars, from an undeformed start."""
    start = "initial={equilibrium=false}"
    return load_scene(ROOT / "scenes" / "spatial_slider_crank.toml", (*SPATIAL_BARS, start, *overrides))


def table(name: str, **entries: object) -> str:
    """Return a table of TOML; values are text, numbers, or lists of numbers or of texts."""

    def text(value: object) -> str:
        if isinstance(value, str):
            return f'"{value}"'
        if isinstance(value, (list, tuple, np.ndarray)):
            return f"[{', '.join(text(part) for part in value)}]"
        return repr(float(value))

    return "\n".join([f"[{name}]", *(f"{key} = {text(value)}" for key, value in entries.items()), ""])


def solid(
    name: str, length: float, origin: Sequence[float] | None = None, rotation: Sequence[float] | None = None
) -> str:
    """Return the table of a bar of steel, and its placement."""
    text = table(f"bodies.{name}", mesh=f"0.0:{length!r}:1", element="solid3d", material="steel")
    if origin is None:
        return text
    return text + table(
        f"bodies.{name}.placement", origin=origin, rotation=(0.0, 0.0, 0.0) if rotation is None else rotation
    )


def assembled(*parts: str, joint: str = "drive", coordinate: str = TURN) -> Scene:
    """Return a scene of tables with one coordinate, the angle of a joint."""
    text = HEADER + "".join(parts) + tables(f'coordinates.theta: joint = "{joint}"; {coordinate}\n')
    return scene_from_toml(text, ".")


def slider_place(theta: np.ndarray) -> np.ndarray:
    """Return the slider's x (m) of the spatial slider-crank, shape (n,): the crank's tip, and the rod's length from
    there."""
    _, y, z = crank_tip(theta)
    return np.sqrt(ROD**2 - y**2 - z**2)


def crank_tip(theta: np.ndarray) -> np.ndarray:
    """Return the place of the tip of the spatial slider-crank's crank, shape (3, n): it hangs from its bearing at 0."""
    circle = np.array([0.0 * theta, np.sin(theta), -np.cos(theta)])
    return BEARING[:, None] + CRANK * circle
