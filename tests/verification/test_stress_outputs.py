"""Stress outputs of all models, single and in ensembles, against statics, Kirsch's hole, and the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import meshio
import numpy as np
import pytest
from mpi4py import MPI
from scenes import HEADER
from solids import box_mesh, rectangle_mesh

from pgmp_petsc.cli.models import components_of
from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.mesh.solid_mesh_reading import solid_mesh
from pgmp_petsc.mesh.straight_beam import straight_beam
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.simulate import simulate_full, simulate_reduced

WITHIN = 0.02  # what stress outputs are asked to be within
LENGTH, HEIGHT, WIDTH, FORCE = 1.0, 0.1, 0.01, 100.0
MODELS = ("full", "components", "reduced")

HELD = (
    HEADER
    + """
[parameters.E1]
nominal = 210e9
distribution = {{ name = "uniform", loc = 190e9, scale = 40e9 }}
[materials.soft]
E = "E1"
nu = 0.3
rho = 7800.0
[bodies.bar]
mesh = "0.0:1.0:5"
element = "{element}"
material = "soft"
{more}
[joints.hinge]
type = "revolute"
connect = ["ground:origin", "bar:{root}"]
{axis}
[coordinates.theta]
joint = "hinge"
range = [-0.2, 0.2]
[effects.hold]
type = "prescribed_motion"
coordinate = "theta"
table = [[0.0, 0.0], [10.0, 0.0]]
[effects.pull]
type = "force"
point = "bar:{tip}"
direction = {direction}
table = [[0.0, 100.0], [10.0, 100.0]]
[initial]
equilibrium = true
[reduction]
modes = 4
static_modes = true
inertia_modes = true
angles = 6
interpolation = "spline"
[simulation]
duration = 2e-4
step = 1e-4
frames = 2
"""
)


def held(element: str, *overrides: str, direction: tuple[float, ...] = (0.0, -1.0)) -> Scene:
    """Return a body that is clamped at its first end and has a force at its other one, in static equilibrium."""
    solid, space = element.startswith("solid"), element.endswith("3d")
    section = f'section = {{ shape = "rectangle", height = {HEIGHT}, width = {WIDTH} }}'
    if solid:
        more = "" if space else f"thickness = {WIDTH}"
    else:
        more = section + ("\norientation = [0.0, 1.0, 0.0]" if space else "")
    words = {
        "element": element,
        "more": more,
        "root": "left" if solid else "hinge",
        "tip": "right" if solid else "tip",
        "axis": "axis = [0.0, 0.0, 1.0]" if space else "",
        "direction": [*direction, 0.0] if space else list(direction),
    }
    return scene_from_toml(HELD.format(**words), ".", overrides)


def asked(name: str, quantity: str, place: str = "", body: str = "bar") -> str:
    """Return the override that adds a stress output."""
    return f'outputs.{name}={{type="stress", body="{body}", quantity="{quantity}"{place and ", " + place}}}'


def runs(scene: Scene, meshes: Mapping, models: tuple[str, ...] = MODELS) -> dict[str, Trajectory]:
    """Return a run of every model."""
    return {name: run(model_of(name, scene, meshes)) for name in models}


def model_of(name: str, scene: Scene, meshes: Mapping) -> FullModel | ReducedModel:
    if name == "full":
        return FullModel(scene, meshes)
    if name == "components":
        return components_of(scene, meshes, MPI.COMM_SELF)
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        return ReducedModel(scene, build_rom(scene, meshes, group))


def run(model: FullModel | ReducedModel) -> Trajectory:
    found = (simulate_reduced if isinstance(model, ReducedModel) else simulate_full)(model, MPI.COMM_SELF)
    assert found.status == 0
    return found


def bar(kind: str) -> SolidMesh:
    """Return a bar of rectangular section, its axis on the x axis."""
    if kind.startswith("hex") or kind.startswith("tet"):
        mesh, size = box_mesh(kind, (10, 2, 1), (LENGTH, HEIGHT, WIDTH)), (0.0, HEIGHT, WIDTH)
    else:
        mesh, size = rectangle_mesh(kind, (10, 2), (LENGTH, HEIGHT)), (0.0, HEIGHT)
    return replace(mesh, nodes=mesh.nodes - 0.5 * np.array(size))


@pytest.mark.parametrize(("element", "kind"), [("solid2d", "quad8"), ("solid3d", "hexahedron20")])
def test_a_cantilever_of_cells_has_the_stresses_of_beam_theory(element: str, kind: str) -> None:
    """Bending F (L - x) y / I: at the root and half-way; all models, with the mesh's own error."""
    middle = [0.5 * LENGTH, 0.5 * HEIGHT] + [0.0] * (element == "solid3d")
    outputs = (
        asked("root", "von_mises", 'group="left"'),
        asked("pulled", "principal_max"),
        asked("pressed", "principal_min"),
        asked("middle", "principal_max", f"at={middle}"),
    )
    root = 6.0 * FORCE * LENGTH / (WIDTH * HEIGHT**2)
    expected = {"root": root, "pulled": root, "pressed": -root, "middle": 0.5 * root}
    for name, found in runs(held(element, *outputs), {"bar": bar(kind)}).items():
        for output, value in expected.items():
            assert abs(found.outputs[output][0] / value - 1.0) < WITHIN, (name, output, found.outputs[output][0])
            assert found.units[output] == "Pa"


def plate(n_around: int, n_out: int, hole: float = 1.0, half_width: float = 20.0) -> SolidMesh:
    """Return a square plate of quad8 with a round hole, its group hole, and left and right."""
    radial = np.linspace(0.0, 1.0, n_out + 1) ** 2.5
    radial = np.interp(np.arange(2 * n_out + 1) / 2.0, np.arange(n_out + 1), radial)
    angle = 2.0 * np.pi * np.arange(2 * n_around) / (2 * n_around)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edge = half_width / np.abs(out).max(axis=1)
    reach = hole + radial[:, None] * (edge - hole)
    places = reach[..., None] * out  # (radial, around, 2), every second one a corner
    number = np.arange(places.shape[0] * places.shape[1]).reshape(places.shape[:2])
    around = lambda k: k % (2 * n_around)  # noqa: E731
    cells, inner, outer = [], [], []
    for i in range(0, 2 * n_out, 2):
        for j in range(0, 2 * n_around, 2):
            at = lambda r, a: number[i + r, around(j + a)]  # noqa: B023, E731
            corners = [at(0, 0), at(2, 0), at(2, 2), at(0, 2)]
            cells.append([*corners, at(1, 0), at(2, 1), at(1, 2), at(0, 1)])
            if i == 0:
                inner.append([at(0, 0), at(0, 2), at(0, 1)])
            if i == 2 * n_out - 2:
                outer.append([at(2, 0), at(2, 2), at(2, 1)])
    used, cells = np.unique(cells, return_inverse=True)
    renumber = np.full(number.size, -1)
    renumber[used] = np.arange(used.size)
    places, outer = places.reshape(-1, 2)[used], renumber[outer]
    sides = {
        name: outer[np.isclose(places[outer, 0], x).all(axis=1)]
        for name, x in (("left", -half_width), ("right", half_width))
    }
    faces = {"hole": renumber[inner], **sides}
    blocks = [("quad8", cells.reshape(-1, 8)), *(("line3", face) for face in faces.values())]
    tags = [np.full(len(block), k) for k, (_, block) in enumerate(blocks, start=1)]
    names = {"plate": np.array([1, 2])} | {name: np.array([k, 1]) for k, name in enumerate(faces, start=2)}
    points = np.column_stack([places, np.zeros(len(places))])
    data = {"gmsh:physical": tags, "gmsh:geometrical": list(tags)}
    return solid_mesh(meshio.Mesh(points, blocks, cell_data=data, field_data=names), 2, "plate")


def test_the_edge_of_a_hole_has_three_times_the_stress_converging_with_the_mesh() -> None:
    """Kirsch (1898), of an infinite plate; Heywood's formula for the finite one is 3.008 at this width."""
    outputs = (asked("edge", "principal_max", 'group="hole"'), asked("top", "principal_max", "at=[0.0, 1.0]"))
    scene = held("solid2d", *outputs, direction=(1.0, 0.0))
    far = FORCE / (WIDTH * 40.0)
    errors = [
        abs(run(model_of("components", scene, {"bar": plate(n, n // 2)})).outputs["edge"][0] / far - 3.008)
        for n in (16, 32, 48)
    ]
    assert errors[1] < 0.5 * errors[0] and errors[2] < errors[1] / 1.5, errors
    for name, found in runs(scene, {"bar": plate(48, 8)}).items():
        assert abs(found.outputs["edge"][0] / far / 3.0 - 1.0) < WITHIN, (name, found.outputs["edge"][0] / far)
        # the largest is on the hole's side, where the place is
        assert found.outputs["top"][0] == pytest.approx(found.outputs["edge"][0], rel=1e-6)


@pytest.mark.parametrize("element", ["beam2d", "beam3d"])
def test_a_cantilever_of_beams_has_the_forces_of_statics(element: str) -> None:
    """Exact for any number of elements but for what is of second order: the force's arm is shorter by 1e-5."""
    space = element == "beam3d"
    bending, shear = ("bending_moment_3", "shear_force_2") if space else ("bending_moment", "shear_force")
    middle = [0.3] + [0.0] * (2 if space else 1)
    outputs = (
        asked("root", bending, 'group="hinge"'),
        asked("middle", bending, f"at={middle}"),
        asked("shear", shear),
        asked("axial", "axial_force"),
        asked("fibre", "stress_max"),
        asked("pressed", "stress_min", 'group="hinge"'),
    )
    direction = np.array([0.6, -0.8])
    scene = held(element, *outputs, direction=tuple(direction))
    axial, across = FORCE * direction
    fibre = 6.0 * abs(across) * LENGTH / (WIDTH * HEIGHT**2)
    expected = {
        "root": across * LENGTH,
        "middle": across * (LENGTH - 0.3),
        "shear": across,
        "axial": axial,
        "fibre": fibre + axial / (WIDTH * HEIGHT),
        "pressed": -fibre + axial / (WIDTH * HEIGHT),
    }
    for name, found in runs(scene, {"bar": straight_beam(LENGTH, 5, 0.0, 3 if space else 2)}).items():
        for output, value in expected.items():
            assert found.outputs[output][0] == pytest.approx(value, rel=1e-3), (name, output)
        assert [found.units[output] for output in ("root", "shear", "fibre")] == ["N m", "N", "Pa"]


def spinning(element: str, *overrides: str) -> Scene:
    """Return a bar that turns about its end at a constant speed, 30 rad/s."""
    turning = (
        'effects={hold={type="prescribed_motion", coordinate="theta", spin_up={speed=30.0, time=0.4}}}',
        "coordinates.theta.range=[0.0, 6.283185307179586]",
        "coordinates.theta.periodic=true",
        "initial.equilibrium=false",
        "simulation.duration=0.6",
        "simulation.step=1e-3",
    )
    return held(element, *turning, *overrides)


@pytest.mark.parametrize(("element", "kind"), [("solid2d", "quad8"), ("beam2d", "")])
def test_a_spinning_bar_is_pulled_by_centripetal_forces(element: str, kind: str) -> None:
    """rho omega^2 (L^2 - x^2) / 2 at x: no joint's load does it, the answers to inertia forces have to."""
    place = "at=[0.5, 0.0]"
    tip = f'outputs.tip={{type="position", point="bar:{"right" if kind else "tip"}", axis="x"}}'
    scene = spinning(element, asked("middle", "principal_max" if kind else "stress_max", place), tip)
    mesh = bar(kind) if kind else straight_beam(LENGTH, 10, 0.0, 2)
    expected = 7800.0 * 30.0**2 * (LENGTH**2 - 0.5**2) / 2.0
    for name, found in runs(scene, {"bar": mesh}).items():
        values = found.outputs["middle"][found.time > 0.5]
        assert abs(values.mean() / expected - 1.0) < WITHIN, (name, values.mean() / expected)
