"""Bodies from matrices against the meshes that these were assembled from: modes, mechanisms, motion, mass."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from alike import assert_alike
from assembled import WRITERS, labels_of, write_body, write_csv
from mpi4py import MPI
from pencils import free_hz
from runs import built_rom, motion
from scipy.linalg import eigh
from solid_scenes import GRAVITY, HEIGHT, THICKNESS, solid_meshes, solid_slider_crank
from solids import body_of, matrices_of, mesh_of
from spatial import SLIDER_CRANK as IN_SPACE
from spatial import bar

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.assembled import Assembled, AssembledBody
from pgmp_petsc.bodies.assembled_reading import read_assembled
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.components.component_modes import condense
from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.check import describe_scene

MODULUS, DENSITY, N_MODES = 210e9, 7800.0, 6
MM_T_S = (1e-3, 1e3, 1.0)
UNITS = 'units={length="mm", mass="t"}'
# what frequencies owe to the round-off of files with 16 digits, and to that of two eigensolvers
SAME = 1e-9
MOVING = ("simulation.initial.theta.velocity=4.0", "simulation.duration=0.05", "simulation.step=1e-3")


def steel(mesh: SolidMesh, thickness: float = 1.0):
    return body_of(mesh, MODULUS * thickness, DENSITY * thickness)


def written(folder: Path, kind: str = "abaqus.mtx", units=(1.0, 1.0, 1.0), extra: str = "") -> Scene:
    """Return the plane slider-crank with the rod of `solid_meshes` from the files of its matrices."""
    mesh = solid_meshes()["rod"]
    stiffness, mass = matrices_of(steel(mesh, THICKNESS))
    table = write_body(folder, "rod", mesh, stiffness, mass, kind, units)
    table = table.replace("}", f"{', ' if extra else ''}{extra}}}")
    rod = f'bodies.rod={{element="solid2d", matrices={table}}}'
    return solid_slider_crank(GRAVITY, rod, f"reduction.modes={N_MODES}", *MOVING)


@pytest.mark.parametrize(
    ("kind", "units"), [*((kind, (1.0, 1.0, 1.0)) for kind in WRITERS), ("abaqus.mtx", MM_T_S), ("sparse.npz", MM_T_S)]
)
def test_free_frequencies_are_those_of_the_mesh_in_the_plane(kind: str, units, tmp_path: Path) -> None:
    body = read_assembled(written(tmp_path, kind, units, UNITS if units == MM_T_S else ""), "rod")
    known = free_hz(*matrices_of(steel(solid_meshes()["rod"], THICKNESS)), N_MODES, 3)
    np.testing.assert_allclose(free_hz(body.matrix("stiffness"), body.matrix("mass"), N_MODES, 3), known, rtol=SAME)


@lru_cache
def in_space() -> tuple[SolidMesh, np.ndarray, np.ndarray]:
    mesh = bar(0.3, 1.0, 3, 3)
    return mesh, *matrices_of(steel(mesh))


@pytest.mark.parametrize("kind", ["abaqus.mtx", "hbmat.matrix"])
def test_condensed_bodies_in_space_have_the_free_frequencies_of_the_mesh(kind: str, tmp_path: Path) -> None:
    mesh, stiffness, mass = in_space()
    table = write_body(tmp_path, "rod", mesh, stiffness, mass, kind, MM_T_S).replace("}", f", {UNITS}}}")
    scene = scene_from_toml(IN_SPACE, ".", (f'bodies.rod={{element="solid3d", matrices={table}}}',))
    points = {"hinge": "one", "tip": "other"}
    framed = FramedSolid.assembled("rod", scene.bodies["rod"], read_assembled(scene, "rod"), points)
    component = condense(framed.solid, framed.frames, [{}], N_MODES, MPI.COMM_SELF)[0]
    (small_mass,), (small_stiffness,) = component.mass.values(), component.stiffness.values()
    squares = eigh(small_stiffness, small_mass, eigvals_only=True)[6 : 6 + N_MODES]
    np.testing.assert_allclose(np.sqrt(squares) / (2.0 * np.pi), free_hz(stiffness, mass, N_MODES), rtol=SAME)
    # and frames are the same means over the same faces
    own = FramedSolid.of("rod", scene.bodies["crank"], scene.materials, mesh, points)
    for name, frame in own.frames.items():
        np.testing.assert_allclose(framed.frames[name].centre, frame.centre, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(np.sort(framed.frames[name].weights), np.sort(frame.weights), rtol=1e-12)


@lru_cache
def on_the_mesh() -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return frequencies over the angles, and outputs of the reduced and of the component run, of the meshes."""
    return runs_of(solid_slider_crank(GRAVITY, f"reduction.modes={N_MODES}", *MOVING), solid_meshes())


def runs_of(scene: Scene, meshes: dict) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    rom = built_rom(scene, meshes=meshes)
    stiffness, mass = rom.tables.stiffness[:, 0], rom.tables.mass[:, 0]
    reduced = motion(ReducedModel(scene, rom))
    whole = motion("components", scene, meshes)
    squares = [eigh(k, m[1:, 1:], eigvals_only=True) for k, m in zip(stiffness, mass)]
    return np.sqrt(np.array(squares)[:, :N_MODES]) / (2.0 * np.pi), reduced.outputs, whole.outputs


def test_a_mechanism_moves_as_with_the_mesh(tmp_path: Path) -> None:
    scene = written(tmp_path, "abaqus.mtx", MM_T_S, UNITS)
    meshes = solid_meshes() | {"rod": read_assembled(scene, "rod")}
    found, known = runs_of(scene, meshes), on_the_mesh()
    # the condensed answers of the frames are exact to 1e-10; deformations are differences of motions
    np.testing.assert_allclose(found[0], known[0], rtol=1e-9)
    for own, other in zip(found[1:], known[1:]):
        assert_alike(other, own, 1e-8)


def test_mass_properties_are_those_of_the_mesh(tmp_path: Path) -> None:
    length, width = 0.7, HEIGHT
    scene = written(tmp_path)
    body = read_assembled(scene, "rod")
    found = body.properties
    assert found.mass == pytest.approx(DENSITY * THICKNESS * length * width, rel=1e-12)
    np.testing.assert_allclose(found.centre, (0.3 + 0.5 * length, 0.0), atol=1e-12)
    np.testing.assert_allclose(found.inertia, [[found.mass * (length**2 + width**2) / 12.0]], rtol=1e-12)
    # plane stress, without lateral strain
    assert body.wave_speed == pytest.approx(np.sqrt(MODULUS / (1.0 - 0.3**2) / DENSITY), rel=1e-9)
    said = describe_scene(scene, solid_meshes() | {"rod": body})
    assert "rod: 0.5379" in said and "3 rigid-body motions without stiffness" in said


def test_a_rigid_body_has_the_inertia_of_its_matrices(tmp_path: Path) -> None:
    mesh, stiffness, mass = in_space()
    table = write_body(tmp_path, "rod", mesh, stiffness, mass)
    of_matrices = f'bodies.rod={{element="solid3d", flexible=false, matrices={table}}}'
    scene = scene_from_toml(IN_SPACE, ".", (of_matrices,))
    body = read_assembled(scene, "rod")
    (found,) = AssembledBody("rod", body, Quantity(1.0), Quantity(1.0)).second_moments().values()
    (known,) = steel(mesh).second_moments().values()
    np.testing.assert_allclose(found, known, rtol=1e-12, atol=1e-15 * np.abs(known).max())
    np.testing.assert_allclose(body.properties.inertia[0, 0], known[1, 1] + known[2, 2], rtol=1e-9)


def test_factors_scale_stiffness_and_mass(tmp_path: Path) -> None:
    scene = written(tmp_path)
    body = AssembledBody("rod", read_assembled(scene, "rod"), Quantity.of("s"), Quantity.of(2.0))
    nodes = range(3, 7)
    ((weight, rows),) = body.stiffness(nodes).items()
    assert str(weight) == "s" and body.weights("stiffness") == {weight}
    whole = body.mesh.matrix("stiffness")[6:14]
    assert abs(rows - whole).max() == 0.0
    (rows,) = body.mass(nodes).values()
    assert abs(rows - 2.0 * body.mesh.matrix("mass")[6:14]).max() == 0.0


def test_points_may_be_numbers_of_nodes_that_count_alike(tmp_path: Path) -> None:
    mesh = mesh_of("quad", (4, 2), (0.4, 0.1))
    stiffness, mass = matrices_of(steel(mesh))
    write_csv(tmp_path / "nodes.csv", mesh)
    body = Assembled.of(mesh.nodes, labels_of(mesh), {}, None, stiffness, mass)
    chosen = np.flatnonzero(mesh.nodes[:, 0] == 0.0)
    frame = body.frame(tuple(int(n) for n in labels_of(mesh)[chosen]), "entry")
    np.testing.assert_allclose(frame.centre, (0.0, 0.05), atol=1e-15)
    # a rigid motion of the nodes is that of the frame
    turn = np.column_stack([-mesh.nodes[:, 1], mesh.nodes[:, 0]]).ravel()
    np.testing.assert_allclose(frame.functionals(mesh.n_nodes) @ turn, (-0.05, 0.0, 1.0), atol=1e-14)


def test_numbers_of_nodes_on_a_mesh_are_weighted_by_the_areas_of_their_faces(tmp_path: Path) -> None:
    """Of an uneven edge the middle has its lever; numbers of nodes are those of the set with the same faces."""
    mesh = mesh_of("quad", (4, 3), (0.4, 0.1))
    uneven = np.where(mesh.nodes[:, 1] > 0.05, mesh.nodes[:, 1], 0.3 * mesh.nodes[:, 1])
    mesh = replace(mesh, nodes=np.column_stack([mesh.nodes[:, 0], uneven]))
    stiffness, mass = matrices_of(steel(mesh))
    body = Assembled.of(mesh.nodes, labels_of(mesh), {}, mesh, stiffness, mass)
    chosen = np.flatnonzero(mesh.nodes[:, 0] == 0.0)
    numbers = tuple(int(n) for n in labels_of(mesh)[chosen])
    frame = body.frame(numbers, "entry")
    np.testing.assert_allclose(frame.centre, (0.0, 0.05), atol=1e-15)
    assert abs(body.nodes[chosen, 1].mean() - 0.05) > 5e-3
    # inside, and of nodes beside whole faces, no faces are known
    inner = np.flatnonzero(mesh.nodes[:, 0] == 0.2)
    faces, found = body.faces_of(tuple(int(n) for n in labels_of(mesh)[inner]), "entry")
    assert not len(faces) and set(found) == set(inner)
    assert not len(body.faces_of((*numbers, int(labels_of(mesh)[inner[1]])), "entry")[0])


@pytest.mark.parametrize("kind", ["csv", "inp"])
def test_a_check_says_of_each_point_what_it_is_the_mean_over(kind: str, tmp_path: Path) -> None:
    scene = written(tmp_path)
    if kind == "csv":
        write_csv(tmp_path / "rod.csv", solid_meshes()["rod"])
        mesh, ends = solid_meshes()["rod"], ("left", "right")
        faces = {end: [int(n) for n in labels_of(mesh)[np.unique(mesh.groups[end])]] for end in ends}
        rod = scene.bodies["rod"]
        given = rod.matrices.model_copy(update={"nodes": str(tmp_path / "rod.csv"), "faces": faces})
        scene = scene.model_copy(update={"bodies": scene.bodies | {"rod": rod.model_copy(update={"matrices": given})}})
    said = describe_scene(scene, solid_meshes() | {"rod": read_assembled(scene, "rod")})
    means = {"csv": "over nodes that count alike, as their faces are not known", "inp": "over areas of faces"}
    assert means[kind] in said and not any(text in said for other, text in means.items() if other != kind)
