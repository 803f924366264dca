"""Cantilevers of 1 m on a hub that is driven: of cells, of solids and of beams in space.

In units in which E I of bending in the plane of rotation and rho A are 1.
"""

from dataclasses import replace

import numpy as np
from effect_scenes import CANTILEVER, scene_of
from solids import box_mesh, rectangle_mesh

from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.scene import Scene
from scenes import tables

THICKNESS, WIDTH = 0.02, 0.03
# fundamental frequencies in the plane of rotation over the spin, in units of sqrt(EI / rho A L^4), as is the spin
PUBLISHED = [(0.0, 3.516), (2.0, 3.622), (4.0, 3.898), (6.0, 4.263), (10.0, 5.049)]
SPINS = PUBLISHED[::2]


def cantilever(body: str, text: str = "", *overrides: str) -> Scene:
    """Return `effect_scenes.CANTILEVER` with another body and further tables."""
    start, end = CANTILEVER.index("[bodies.beam]"), CANTILEVER.index("[joints.hub]")
    return scene_of(CANTILEVER[:start] + body + CANTILEVER[end:], text, *overrides)


def of_cells(element: str, width: float, more: str = "") -> str:
    """Return the tables of a bar with a section of THICKNESS by a width."""
    young, rho = 12.0 / (width * THICKNESS**3), 1.0 / (width * THICKNESS)
    return (
        f"[materials.m]\nE = {young}\nrho = {rho}\nnu = 0.3\n"
        f'[bodies.beam]\nmesh = "none"\nelement = "{element}"\nmaterial = "m"\n{more}\n'
    )


def ends(mesh: SolidMesh) -> SolidMesh:
    """Return a bar's mesh about the x axis with the groups hinge and tip."""
    middle = 0.5 * np.ptp(mesh.nodes, axis=0)
    middle[0] = 0.0
    return replace(mesh, nodes=mesh.nodes - middle, groups={"hinge": mesh.groups["left"], "tip": mesh.groups["right"]})


def plate_mesh() -> SolidMesh:
    return ends(rectangle_mesh("quad8", (12, 1), (1.0, THICKNESS)))


def bar_mesh() -> SolidMesh:
    return ends(box_mesh("hexahedron20", (20, 1, 1), (1.0, THICKNESS, WIDTH)))


PLATE, BAR = of_cells("solid2d", 1.0, "thickness = 1.0"), of_cells("solid3d", WIDTH)
IN_SPACE = 'joints.hub={type="revolute", connect=["ground:origin", "beam:hinge"], axis=[0.0, 0.0, 1.0]}'
#: E I_2 (out of the plane of rotation) over E I_3 is RATIO; rho I_2 > rho I_3, as the width is along the axis of spin
RATIO, TORSION, ROTARY = 4.0, 5e-3, (4e-5, 1e-5)
BEAM_IN_SPACE = tables(f"""
bodies.beam: line = {{ length = 1.0, elements = 16 }}; element = "beam3d"; orientation = [0.0, 1.0, 0.0]
bodies.beam.section: shape = "coefficients3d"; axial = 1e5; shear_2 = 1e5; shear_3 = 1e5; torsion = {TORSION};
    bending_2 = {RATIO}; bending_3 = 1.0; line_density = 1.0; rotary_2 = {ROTARY[0]}; rotary_3 = {ROTARY[1]}
""")
