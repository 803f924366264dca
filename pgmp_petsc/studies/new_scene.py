"""Scenes to begin with that are made of a file of another program: of a part of CAD.

The part is held at its widest bore (or pin, or at one end), and a force acts on the bore that is farthest from there.
What a user does not know yet has a number that fits the part: the force bends a bar of the part's length and volume
to a third of the yield stress of mild steel, and a period of the first bending between hinged ends has twenty steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.mesh.cad_part import CadPart, read_part
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.scene.bodies import CAD
from pgmp_petsc.scene.loading import scene_from_toml
from pgmp_petsc.studies.plausibility.bodies import sizes_of
from pgmp_petsc.studies.robot_scene import ROBOT

MILLIMETRE = 1e-3
STEEL = {"E": 210e3, "nu": 0.3, "rho": 7.85e-9, "yields": 250.0}  # in mm, t, s
STEPS_A_PERIOD, PERIODS = 20.0, 15.0
ROUND_OFF = 1e-9  # of the largest moment of inertia


@dataclass(frozen=True, eq=False)
class PartScene:
    """The scene of a part, in mm, t, s."""

    text: str  # of the scene's file
    lines: list[str]  # about the part
    part: CadPart


@dataclass(frozen=True)
class _Place:
    """A group of faces to hold a part at."""

    name: str
    centre: np.ndarray  # shape (3,)
    axis: np.ndarray | None  # of a cylinder


def scene_of_part(source: Path, file: Path) -> PartScene:
    """Return the scene of a STEP file; `file` is where the scene will be. Raises `InputError` as `read_part`."""
    if source.suffix.lower() not in CAD:
        raise InputError(
            f"--from {source}: a scene is made of a part of CAD as STEP ({', '.join(CAD)}; export it so from CAD), or "
            f"of a robot ({', '.join(ROBOT)})"
        )
    part = read_part(source, shortened(f"--from {source}"), MILLIMETRE)
    name = _name(source.stem)
    hold, load = _places(part)
    step, shape = 1e-3, replace(part.mesh, nodes=MILLIMETRE * part.mesh.nodes)
    for _ in range(2):  # the second time with a step that fits the part's size
        text = _text(part, name, file, source, hold, load, step)
        scene = scene_from_toml(text, file.parent)
        frequency = sizes_of(scene, {name: shape})[name].frequency_hz
        step = float(f"{1.0 / (STEPS_A_PERIOD * frequency):.1g}")
    return PartScene(text, _lines(part, name, hold, load), part)


def _name(stem: str) -> str:
    """Return a name for a body that a scene takes."""
    word = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in stem).strip("_")
    return word if word[:1].isalpha() else f"part_{word}".rstrip("_")


def _places(part: CadPart) -> tuple[_Place, _Place]:
    """Return where the part is held and where it is loaded."""
    mesh = part.mesh
    round_ones = sorted(part.cylinders, key=lambda one: not one.inner)
    places = [_Place(one.name, one.centre, one.axis) for one in round_ones]
    ends = []
    long = int(np.argmax(np.ptp(mesh.nodes, axis=0)))
    for k in range(1, part.n_faces + 1):
        nodes = mesh.nodes[np.unique(mesh.groups[f"face{k}"])]
        ends.append(_Place(f"face{k}", nodes.mean(axis=0), None))
    ends.sort(key=lambda one: one.centre[long])
    hold = places[0] if places else ends[0]
    beside = [place for place in places[1:] if _apart(place, hold) > 0.05 * float(np.ptp(mesh.nodes, axis=0).max())]
    return hold, max(beside or ends, key=lambda place: _apart(place, hold))


def _apart(one: _Place, other: _Place) -> float:
    return float(np.linalg.norm(one.centre - other.centre))


def _directions(hold: _Place, load: _Place) -> tuple[np.ndarray, np.ndarray]:
    """Return the axis of the hinge, and the direction of the force, across it and across the part."""
    arm = load.centre - hold.centre
    axis = hold.axis
    if axis is None or np.linalg.norm(np.cross(axis, arm)) < 1e-3 * np.linalg.norm(arm):
        flat = np.eye(3)[int(np.argmin(np.abs(arm)))]
        if axis is None:
            axis = np.cross(np.cross(arm, flat), arm)
    across = np.cross(axis, arm)
    if np.linalg.norm(across) < 1e-3 * np.linalg.norm(arm):
        across = np.cross(flat, arm)
    return axis / np.linalg.norm(axis), across / np.linalg.norm(across)


def _numbers(values: Sequence[float]) -> str:
    return "[" + ", ".join(repr(float(f"{value:.9g}") + 0.0) for value in values) + "]"


def _text(part: CadPart, name: str, file: Path, source: Path, hold: _Place, load: _Place, step: float) -> str:
    """Return the text of the scene."""
    axis, across = _directions(hold, load)
    extent = float(np.ptp(part.mesh.nodes, axis=0).max())
    across_part = part.volume / extent
    bending = 0.35 * STEEL["yields"] * across_part**1.5 / 6.0 / max(_apart(load, hold), 0.1 * extent)
    force = float(f"{bending:.1g}")
    mesh = source.name if source.parent.resolve() == file.parent.resolve() else str(source.resolve())
    duration = float(f"{PERIODS * STEPS_A_PERIOD * step:.2g}")
    places = "\n".join(f"#   {line}" for line in _cylinder_lines(part)) or "#   none"
    deflection = "xyz"[int(np.argmax(np.abs(across)))]
    return f'''# {source.name}: held at {hold.name}, loaded at {load.name}.
# Lengths are in mm, forces in N, stresses in MPa, masses in t.
#
#   pgmp run {file.name}                       check, build, simulate, compare, ensemble, report
#   pgmp check {file.name} --plot mechanism.png
#
# Points of the part: every face is one (face1 to face{part.n_faces}), and so are its whole cylinders:
{places}

[scene]
name = "{name}"
units = "mm"

[parameters.load]
nominal = 1.0
description = "strength of the force, as a share of its table"
distribution = {{ name = "norm", loc = 1.0, scale = 0.15 }}          # any of scipy.stats, and its arguments
bounds = [0.4, 1.6]                  # samples stay between these

[parameters.modulus]
nominal = 210.0                      # where the reduced basis is built
unit = "GPa"                         # of all numbers of this parameter
distribution = {{ name = "norm", loc = 210.0, scale = 5.0 }}
bounds = [190.0, 230.0]

[materials.steel]
E = "modulus"
nu = {STEEL["nu"]}
rho = {STEEL["rho"]}                        # t/mm3

[bodies.{name}]
mesh = {_quoted(mesh)}
# mesh_size = 3.0                    # mm, the largest size of a cell; by the thickness of the walls if left out
element = "solid3d"
material = "steel"

[ground.points]
held = {_numbers(hold.centre)}       # mm

[joints.hold]
type = "revolute"
connect = ["ground:held", "{name}:{hold.name}"]
axis = {_numbers(axis)}

[coordinates.angle]
joint = "hold"
range = [-0.1, 0.1]                  # rad

# The hinge is held. Leave this out to let the part swing, over a wider range of its angle.
[effects.held]
type = "prescribed_motion"
coordinate = "angle"
constant_speed = {{ speed = 0.0 }}     # rad/s

[effects.weight]
type = "gravity"
direction = {_numbers(-across)}

[effects.force]
type = "force"
point = "{name}:{load.name}"
direction = {_numbers(-across)}
table = [[0.0, 0.0], [{0.3 * duration:.2g}, {force:g}], [{duration:g}, {force:g}]]      # s, N; linear between the rows
scale = "load"

[effects.material_damping]
type = "structural_damping"
stiffness = {2.0 * step:.1g}                  # s

# The reduced model: which shapes the part may take.
[reduction]
modes = 6
static_modes = true                  # and the static answer to each load
inertia_modes = true                 # and to the inertia forces of the motion
angles = 5                           # sampled angles

[initial]
equilibrium = true                   # under the loads at time zero

[simulation]
duration = {duration:g}                      # s
step = {step:g}                          # s
spectral_radius = 0.8                # of generalised-alpha; 1 is without numerical damping
frames = 61                          # instants at which the whole shape is kept, for pictures

[reference]
model = "components"                 # what the reduced model is compared with; "mesh" takes some minutes

[ensemble]
sampler = "sobol"
extremes = true                      # keep the largest and the smallest value of every output over time

[ensemble.probabilities.yields]
output = "worst_stress"
above = {STEEL["yields"]}                        # MPa
when = "ever"                        # at any time; "end" is the end of the run

[outputs.deflection]                 # mm
type = "deformation"
point = "{name}:{load.name}"
axis = "{deflection}"

[outputs.worst_stress]               # MPa, the largest of the whole part
type = "stress"
body = "{name}"
quantity = "von_mises"
'''


def solid_volume(mesh: SolidMesh) -> float:
    """Return the volume of a mesh."""
    return Solid("part", mesh, ()).volume


def _quoted(path: str) -> str:
    return f'"{path}"' if '"' not in path and "\\" not in path else f"'{path}'"


def _cylinder_lines(part: CadPart) -> list[str]:
    return [
        f"{one.name}: radius {one.radius:.6g}, {one.length:.6g} long, middle {_numbers(one.centre)}, "
        f"axis {_numbers(one.axis)}"
        for one in part.cylinders
    ]


def _lines(part: CadPart, name: str, hold: _Place, load: _Place) -> list[str]:
    """Return what to say of a part: size, mass properties of steel, cylinders."""
    mesh, density = part.mesh, STEEL["rho"] * 1e3
    box = " x ".join(f"{extent:.4g}" for extent in np.ptp(mesh.nodes, axis=0))
    centre = ", ".join(f"{x:.5g}" for x in part.centre)
    inertia = np.where(np.abs(part.inertia) > ROUND_OFF * np.abs(part.inertia).max(), part.inertia, 0.0)
    moments = ", ".join(f"{x:.4g}" for x in (density * inertia)[np.triu_indices(3)])
    share = solid_volume(mesh) / part.volume - 1.0
    n_pins = sum(not one.inner for one in part.cylinders)
    lines = _cylinder_lines(part)
    mass = f"whose mass is that of the solid to {abs(share):.1g}"
    return [
        f"  part          {name}: {box} mm, {part.volume:.6g} mm3, {part.n_faces} faces, "
        f"{len(part.cylinders) - n_pins} bores, {n_pins} pins",
        f"  of steel      {density * part.volume:.4g} kg, centre of mass ({centre}) mm, inertia about it "
        f"(xx, xy, xz, yy, yz, zz) {moments} kg mm2",
        *(f"  {'bore' if one.inner else 'pin':12}  {line}" for one, line in zip(part.cylinders, lines)),
        f"  mesh          {mesh.n_nodes} nodes, {mesh.n_cells} {mesh.kind}, {mass}",
        f"  scene         held at {hold.name}, loaded at {load.name}",
    ]
