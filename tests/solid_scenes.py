"""The slider-crank of the repository's scenes with bodies of continuum elements, their meshes made in memory."""

from dataclasses import replace

import numpy as np
from conftest import ROOT
from solids import rectangle_mesh

from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.scene import Scene, load_scene
from scenes import CRANK, RADIUS, ROD

# a rectangle with the area and the second moment of the beams' circle
HEIGHT, THICKNESS = np.sqrt(3.0) * RADIUS, np.pi * RADIUS / np.sqrt(3.0)
BODY = f'{{mesh="none", element="solid2d", material="steel", thickness={THICKNESS}}}'
GRAVITY = 'effects.weight={type="gravity"}'
SOLID = (
    "parameters={}", f"bodies.crank={BODY}", f"bodies.rod={BODY}",
    'joints.crank_hinge.connect=["ground:origin", "crank:left"]', 'joints.elbow.connect=["crank:right", "rod:left"]',
    'joints.slider.connect=["ground:origin", "rod:right"]', 'outputs.slider_position.point="rod:right"',
    'outputs.slider_deformation.point="rod:right"', "reduction.parameter_modes=0", "reduction.second_order=false",
)  # fmt: skip


def solid_slider_crank(*overrides: str) -> Scene:
    return load_scene(ROOT / "scenes" / "slider_crank.toml", (*SOLID, *overrides))


def solid_meshes(kind: str = "quad8", n_per_metre: int = 40, n_across: int = 1) -> dict[str, SolidMesh]:
    """Return rectangles around the x axis, from 0 to the elbow and on to the slider; groups left and right."""
    meshes = {}
    for name, start, length in (("crank", 0.0, CRANK), ("rod", CRANK, ROD)):
        mesh = rectangle_mesh(kind, (round(n_per_metre * length), n_across), (length, HEIGHT))
        meshes[name] = replace(mesh, nodes=mesh.nodes + np.array([start, -0.5 * HEIGHT]))
    return meshes
