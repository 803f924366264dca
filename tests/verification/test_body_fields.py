"""Bodies over a run's frames: a cantilever in pure bending, read back from XDMF; modes; bodies of every kind."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fielded import last_grid
from refusals import assert_refused
from runs import MODELS, ONE_RANK, built_rom, full_model, reduced_model, trajectory
from solids import rectangle_mesh
from spatial import slider_crank_in_space
from two_coordinates import double_pendulum

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.mesh.meshes import straight_beam
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Trajectory
from pgmp_petsc.results.trajectory import write_xdmf
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.field_frames import fields_at, mode_shape
from pgmp_petsc.studies.modes_table import tabulate_modes
from scenes import HEADER, meshes_of, slider_crank, tables

LENGTH, HEIGHT, WIDTH, ARM, FORCE, YOUNG = 1.0, 0.1, 0.01, 0.2, 100.0, 210e9
MOMENT, INERTIA = ARM * FORCE, WIDTH * HEIGHT**3 / 12.0
# forces along the bar at both ends of a rigid arm across its end: a couple
BENT = HEADER + tables(f"""
bodies.bar: mesh = "0.0:{LENGTH}:8"; element = "{{element}}"; material = "steel"
{{section}}
bodies.arm: mesh = "{-ARM / 2}:{ARM / 2}:2"; element = "beam2d"; material = "steel";
    section = {{{{ shape = "circle", radius = 0.01 }}}}; flexible = false;
    placement = {{{{ origin = [{LENGTH}, 0.0], angle = {np.pi / 2} }}}}
joints.hinge: type = "revolute"; connect = ["ground:origin", "bar:{{root}}"]
joints.weld: type = "fixed"; connect = ["bar:{{tip}}", "arm:1"]
coordinates.theta: joint = "hinge"; range = [-0.2, 0.2]
effects.hold: type = "prescribed_motion"; coordinate = "theta"; table = [[0.0, 0.0], [10.0, 0.0]]
effects.above: type = "force"; point = "arm:tip"; direction = [1.0, 0.0]; table = [[0.0, {FORCE}], [10.0, {FORCE}]]
effects.below: type = "force"; point = "arm:hinge"; direction = [-1.0, 0.0]; table = [[0.0, {FORCE}], [10.0, {FORCE}]]
initial: equilibrium = true
reduction: modes = 4; static_modes = true; angles = 6; interpolation = "spline"
simulation: duration = 2e-4; step = 1e-4; frames = 2
""")


def bent(element: str, *overrides: str) -> tuple[Scene, Mapping]:
    """Return a cantilever of cells or of beams in pure bending, and its meshes."""
    solid = element == "solid2d"
    section = f'section = {{ shape = "rectangle", height = {HEIGHT}, width = {WIDTH} }}'
    words = {"element": element, "section": f"thickness = {WIDTH}" if solid else section}
    words |= {"root": "left", "tip": "right"} if solid else {"root": "hinge", "tip": "tip"}
    mesh = rectangle_mesh("quad8", (8, 2), (LENGTH, HEIGHT))
    bar = replace(mesh, nodes=mesh.nodes - [0.0, 0.5 * HEIGHT]) if solid else straight_beam(LENGTH, 8)
    return scene_from_toml(BENT.format(**words), ".", overrides), {"bar": bar, "arm": straight_beam(ARM, 2, -ARM / 2)}


@pytest.mark.parametrize("name", MODELS)
def test_a_cantilever_in_pure_bending_is_read_back_from_xdmf(name: str, tmp_path: Path) -> None:
    """sigma = M y / I at nodes and in cells, deflection M x^2 / (2 E I); no output asks for stresses."""
    scene, meshes = bent("solid2d")
    run = trajectory(name, scene, meshes)
    assert not [remark for remark in run.record.remarks if "not stored" in remark.text]
    run.write(tmp_path / "run.h5")
    write_xdmf(tmp_path / "run.h5", tmp_path / "run.xdmf")
    found = last_grid(tmp_path / "run.xdmf", "bar")
    nodes, cells = meshes["bar"].nodes, meshes["bar"].cells
    assert found.cells[0].type == "quad8"
    np.testing.assert_array_equal(found.cells[0].data, cells)
    outermost = MOMENT * 0.5 * HEIGHT / INERTIA
    # quadratic elements have linear strains without error; ends are clamped and loaded in the mean alone (St. Venant)
    middle = np.abs(nodes[:, 0] - 0.5 * LENGTH) <= 0.25 * LENGTH
    stress = MOMENT * np.abs(nodes[:, 1]) / INERTIA
    np.testing.assert_allclose(found.point_data["von_mises"][middle], stress[middle], rtol=0, atol=2e-3 * outermost)
    places = nodes[cells[:, :4]].mean(axis=1)
    inner = np.abs(places[:, 0] - 0.5 * LENGTH) <= 0.25 * LENGTH
    of_cells = MOMENT * np.abs(places[:, 1]) / INERTIA
    np.testing.assert_allclose(found.cell_data["von_mises"][0][inner], of_cells[inner], rtol=0, atol=2e-3 * outermost)
    axis = np.abs(nodes[:, 1]) < 1e-12
    deflection = -MOMENT * nodes[axis, 0] ** 2 / (2.0 * YOUNG * INERTIA)
    bound = 5e-3 * np.abs(deflection).max()
    np.testing.assert_allclose(found.point_data["deformation"][axis, 1], deflection, rtol=0, atol=bound)
    np.testing.assert_allclose(found.points[axis, 1], deflection, rtol=0, atol=bound)
    import pyvista  # a second of every process that looks for tests

    reader = pyvista.get_reader(tmp_path / "run.xdmf")
    assert reader.time_values == run.frames.time.tolist()
    reader.set_active_time_value(run.frames.time[-1])
    seen = reader.read()["bar"]
    there = seen.find_closest_point((0.5 * LENGTH, 0.5 * HEIGHT, 0.0))
    assert seen.point_data["von_mises"][there] == pytest.approx(outermost, rel=2e-3)
    assert np.abs(found.point_data["displacement"]).max() < bound  # it starts in equilibrium


@pytest.mark.parametrize("name", MODELS)
def test_beams_are_seen_too(name: str) -> None:
    """Stress and deflection of the same cantilever of beams, at nodes and in the middles of elements."""
    scene, meshes = bent("beam2d")
    run = trajectory(name, scene, meshes)
    bar, arm = run.fields["bar"], run.fields["arm"]
    assert (bar.kind, bar.rigid, arm.rigid) == ("line", False, True) and bar.cells.shape == (8, 2)
    outermost = MOMENT * 0.5 * HEIGHT / INERTIA
    for place in (bar.at_nodes, bar.at_cells):
        np.testing.assert_allclose(place["stress_max"], outermost, rtol=2e-3)
    # r^2 = 4 I / A of the rectangle
    assert bar.radius == pytest.approx(HEIGHT / np.sqrt(3.0), rel=1e-12)
    deflection = -MOMENT * bar.nodes[:, 0] ** 2 / (2.0 * YOUNG * INERTIA)
    np.testing.assert_allclose(bar.deformation[-1, :, 1], deflection, rtol=0, atol=5e-3 * np.abs(deflection).max())
    # a rigid body is carried along: its deformation is what it is displaced by those that deform
    tip = arm.positions[-1, np.argmin(np.abs(arm.nodes[:, 0]))]
    np.testing.assert_allclose(tip, bar.positions[-1, -1], atol=1e-12)


def test_what_is_enlarged_stays_joined() -> None:
    """In the rigid mechanism bodies meet where the deformed ones do, so that any multiple of the deformation does."""
    scene = slider_crank("simulation.duration=0.05", "simulation.step=1e-3", "simulation.frames=6")
    # the full-order model meets its constraints to round-off, the reduced one as well as its tables are interpolated
    for model, share in ((full_model(scene), 1e-9), (reduced_model(scene), 0.01)):
        run = trajectory(model)
        crank, rod = run.fields["crank"], run.fields["rod"]
        largest = np.abs(crank.deformation).max()
        assert largest > 1e-7
        for scale in (1.0, 1000.0):
            ends = [own.positions + (scale - 1.0) * own.deformation for own in (crank, rod)]
            assert np.abs(ends[0][:, -1] - ends[1][:, 0]).max() < share * scale * largest
            assert np.abs(ends[1][:, -1, 1]).max() < share * scale * largest  # the slider's line


def test_bodies_at_any_instant_of_a_reduced_run() -> None:
    """At the instants of frames what the run keeps itself; between steps in between."""
    model = reduced_model(slider_crank("simulation.duration=0.02", "simulation.step=1e-3", "simulation.frames=3"))
    run = trajectory(model)
    again = fields_at(model, run, run.frames.time)
    for name, own in run.fields.items():
        np.testing.assert_allclose(again[name].positions, own.positions, rtol=0, atol=1e-12)
        np.testing.assert_allclose(again[name].at_nodes["stress_max"], own.at_nodes["stress_max"], rtol=1e-9, atol=1e-6)
    between = fields_at(model, run, [0.0103])["rod"].positions[0]
    both = fields_at(model, run, [0.010, 0.011])["rod"].positions
    np.testing.assert_allclose(between, 0.7 * both[0] + 0.3 * both[1], rtol=0, atol=1e-8)
    assert_refused("times: 0.5 s is outside the run, from 0 to 0.02 s", fields_at, model, run, [0.01, 0.5])
    assert_refused("^no body can be seen: no instant is given, or no mesh is known$", fields_at, model, run, [])
    with pytest.raises(InputError, match="the run is of a full model with 1 coordinates"):
        fields_at(model, replace(run, model="full", modal=None), [0.01])


def cranks(kind: str) -> ReducedModel:
    """Return a slider-crank of beams, one with a rigid crank, or one of solids in space with a rigid crank."""
    if kind == "space":
        scene = slider_crank_in_space("bodies.crank.flexible=false", "reduction.angles=6", "simulation.frames=1")
        return reduced_model(scene)
    return reduced_model(slider_crank("simulation.frames=1", f"bodies.crank.flexible={str(kind == 'plane').lower()}"))


@pytest.mark.parametrize("kind", ["plane", "rigid", "space"])
def test_a_mode_is_the_derivative_of_the_motion(kind: str) -> None:
    """Displacements of a mode against central differences of the positions; its frequency is that of the tables."""
    model = cranks(kind)
    theta = np.array([0.7])
    shape = mode_shape(model, 2, {"theta": 0.7})
    scheme = model.scene.interpolation
    expected = model.rom.tables.frequencies_hz(model.scene.values, at=model.rom.tables.over(scheme, theta[:, None]))[0]
    assert shape.frequency_hz == pytest.approx(expected[1], rel=1e-9)
    assert (shape.number, shape.configuration) == (2, "theta = 0.7 rad")
    moved = {name: own.deformation[0] for name, own in shape.fields.items()}
    assert max(np.linalg.norm(part, axis=1).max() for part in moved.values()) == pytest.approx(1.0, rel=1e-12)
    # the vector of the mode, from its displacements: they are linear in it
    fields, n_eta = model.fields(), 1 + model.rom.tables.n_modes
    rest = np.concatenate([theta, np.zeros(n_eta - 1)])
    columns = []
    for k in range(n_eta):
        step = 1e-6 * np.eye(n_eta)[k]
        both = fields.of(np.array([rest + step, rest - step]), model.scene.values)
        moves = [own.positions[..., 0] - own.positions[..., 1] for own in both.values()]
        columns.append(np.concatenate([move.ravel() for move in moves]) / 2e-6)
    columns = np.array(columns).T
    wanted = np.concatenate([moved[name].ravel() for name in fields.seen.points])
    v, *_ = np.linalg.lstsq(columns, wanted, rcond=None)
    np.testing.assert_allclose(columns @ v, wanted, rtol=0, atol=1e-7)
    # and that is an eigenvector of the tables: K v = omega^2 M v
    tables = model.rom.tables
    weights = (evaluate_weights(own, model.scene.values) for own in (tables.mass_weights, tables.stiffness_weights))
    mass, stiffness = (
        np.einsum("t,tij->ij", weight, interpolant(tables.samples, table, scheme)(theta[None])[0])
        for weight, table in zip(weights, (tables.mass, tables.stiffness))
    )
    left = np.concatenate([[0.0], stiffness @ v[1:]])
    right = (2.0 * np.pi * shape.frequency_hz) ** 2 * (mass @ v)
    np.testing.assert_allclose(left, right, rtol=0, atol=1e-4 * np.abs(right).max())  # v has the error of differences


@pytest.mark.parametrize(("number", "at", "message"), [
    (0, {}, "--mode 0: the reduced model has modes 1 to"), (99, {}, "--mode 99: the reduced model has modes 1 to"),
    (1, {"phi": 0.0}, "--at phi: no such coordinate; those of this model are theta"),
])  # fmt: skip
def test_modes_that_are_not_there(number: int, at: dict, message: str) -> None:
    assert_refused(message, mode_shape, reduced_model(slider_crank("simulation.frames=1")), number, at)


def test_large_fields_are_left_out_and_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A body that no output names is left out where its frames are too large, one that is named never."""
    monkeypatch.setattr("pgmp_petsc.models.body_fields.LARGEST", 1000)
    scene, meshes = bent("solid2d")
    run = trajectory("full", scene, meshes)
    (said,) = [remark.text for remark in run.record.remarks if "not stored" in remark.text]
    assert run.fields.keys() == {"arm"} and "2 frames of it take" in said and "simulation.frames=N" in said
    asked = 'outputs.worst={type="stress", body="bar", quantity="von_mises"}'
    scene, meshes = bent("solid2d", asked)
    assert "bar" in trajectory("full", scene, meshes).fields
    monkeypatch.setattr("pgmp_petsc.components.component_modes.MOST_KEPT", 0)
    scene, meshes = bent("solid2d")
    rom = built_rom(scene, meshes=meshes)
    assert rom.meshes["bar"].recovery is None
    run = trajectory(ReducedModel(scene, rom))
    assert "the reduced model is without its large mesh" in run.record.remarks[-1].text + str(run.record.remarks)
    rom.write(tmp_path / "rom.h5")
    assert ReducedOrderModel.read(tmp_path / "rom.h5").meshes["bar"].recovery is None


@pytest.mark.parametrize(("make", "name"), zip([slider_crank, slider_crank_in_space, double_pendulum], MODELS))
def test_no_frames_no_fields(make: Callable, name: str, tmp_path: Path) -> None:
    run = trajectory(name, make("simulation={duration=2e-3,step=1e-3,frames=0}", "reduction.angles=6"))
    assert run.fields == {} and run.frames is None
    run.write(tmp_path / "run.h5")
    assert Trajectory.read(tmp_path / "run.h5").fields == {}


@pytest.mark.parametrize("name", MODELS)
def test_a_rigid_solid_has_its_mesh(name: str) -> None:
    """A block that does not deform goes where the bar's end takes it, whole: all of its distances stay."""
    arm = (
        f'bodies.arm={{mesh="none", element="solid2d", material="steel", thickness={WIDTH}, flexible=false, '
        f"placement={{origin=[{LENGTH}, 0.0], angle={np.pi / 2}}}}}"
    )
    joined = ('joints.weld.connect=["bar:right", "arm:top"]', 'effects.above.point="arm:right"')
    scene, meshes = bent("solid2d", arm, *joined, 'effects.below.point="arm:left"')
    block = rectangle_mesh("quad", (4, 1), (ARM, 0.02))
    meshes["arm"] = replace(block, nodes=block.nodes - [0.5 * ARM, 0.02])
    run = trajectory(name, scene, meshes)
    own = run.fields["arm"]
    assert own.rigid and own.kind == "quad" and own.units == {}
    sides = np.linalg.norm(np.diff(own.positions[:, own.cells], axis=2), axis=3)
    np.testing.assert_allclose(sides, np.broadcast_to(sides[0], sides.shape), rtol=1e-12)
    # its end turns by M L / (E I)
    turned = np.subtract(*own.positions[-1, [block.groups["top"].max(), block.groups["top"].min()]])
    angle = np.arctan2(turned[1], turned[0]) - np.pi / 2
    assert np.mod(angle + np.pi / 2, np.pi) - np.pi / 2 == pytest.approx(-MOMENT * LENGTH / (YOUNG * INERTIA), rel=0.02)


@pytest.mark.parametrize("springs", [(), ('effects.coil={type="spring_damper", joint="elbow", stiffness=1.0}',)])
def test_modes_where_the_interpolated_mass_is_none_are_refused(springs: tuple[str, ...]) -> None:
    """Few angles and many modes; the build warns of it. No table of all modes is begun."""
    model = reduced_model(slider_crank("simulation.frames=1", *springs))
    mass = model.rom.tables.mass.copy()
    mass[..., 1, 2] = mass[..., 2, 1] = 10.0 * np.abs(mass).max()
    broken, said = copy(model), ": the interpolated mass matrix is not positive definite there; build with more"
    broken.rom = replace(model.rom, tables=replace(model.rom.tables, mass=mass))
    assert_refused(f"--at theta = 0.7 rad{said}", mode_shape, broken, 1, {"theta": 0.7})
    with pytest.raises(InputError, match=f"--rom, at some of 5 configurations{said}"):
        tabulate_modes(model.scene, meshes_of(model.scene), broken.rom, 5, ONE_RANK)
