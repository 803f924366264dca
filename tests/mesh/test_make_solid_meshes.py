"""Meshes of continuum elements from gmsh: their cells, groups, volumes and shapes, and every option refused."""

import importlib.util
import math
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from pgmp_petsc.mesh.meshes import PLANE_KINDS, SOLID_KINDS, reference_element

# Not importorskip: gmsh's module takes over the signal handlers and brings its own copy of PETSc.
pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("gmsh") is None, reason="gmsh's Python module is not installed"
)

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "make_solid_meshes"
RADIUS = 5.6e-3
HEIGHT = math.sqrt(3.0) * RADIUS
BODIES = {"crank": (0.0, 0.3), "rod": (0.3, 1.0)}
PAIRS = list(zip(PLANE_KINDS, SOLID_KINDS))
# The share of a round bar's volume that is missing with 2 cells across the core, thus 8 edges around the circle. Sides
# of hexahedra make an octagon; quadratic edges lose 7.8e-4 (see `lost_by_parabolas`); the faces of free tetrahedra also
# run across the cylinder, which takes about as much as the octagon.
MISSING = {"tetra": 0.11, "tetra10": 1e-3, "hexahedron": 0.1, "hexahedron20": 1e-3, "hexahedron27": 1e-3}


def run(*options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, SCRIPT, *(str(option) for option in options)], capture_output=True, text=True
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, str]]:
    """Directory of the meshes of each kind with the default sizes, and what the script printed."""
    results = {}
    for kinds in PAIRS:
        directory = tmp_path_factory.mktemp("meshes")
        result = run("-o", directory, "-k", *kinds)
        assert (result.returncode, result.stderr) == (0, "")
        results |= {kind: (directory, result.stdout) for kind in kinds}
    return results


def dimension_of(kind: str) -> int:
    return 2 if kind in PLANE_KINDS else 3


def cells_of(mesh: meshio.Mesh, kind: str, group: str) -> np.ndarray:
    """Return the cells of a type that are in a physical group, shape (n, n_cell_nodes)."""
    tag = mesh.field_data[group][0]
    tags = mesh.cell_data["gmsh:physical"]
    return np.concatenate([block.data[t == tag] for block, t in zip(mesh.cells, tags) if block.type == kind])


def determinants(points: np.ndarray, cells: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """Return det J at some points of every cell, shape (n_cells, n_points)."""
    return np.linalg.det(np.einsum("cai,qja->cqij", points[cells], gradients))


def volume(mesh: meshio.Mesh, kind: str, group: str) -> float:
    """Return the group's volume (area), integrated with the mass quadrature."""
    element = reference_element(kind)
    cells = cells_of(mesh, kind, group)
    scales = determinants(mesh.points[:, : element.dimension], cells, element.mass.gradients)
    return float((scales @ element.mass.weights).sum())


def lost_by_parabolas(n_edges: int) -> float:
    """Return the share of a circle's area that is lost with equal quadratic edges whose nodes are on the circle.

    The edge (1 - (1 - c) t^2, s t), -1 <= t <= 1, with s, c = sin, cos(pi / n_edges), has a sector of the area
    s (1 + (1 - c) / 3).
    """
    half_angle = math.pi / n_edges
    return 1.0 - math.sin(half_angle) * (1.0 + (1.0 - math.cos(half_angle)) / 3.0) / half_angle


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("kind", [*PLANE_KINDS, *SOLID_KINDS])
def test_cells_groups_and_volume(made: dict[str, tuple[Path, str]], kind: str, body: str) -> None:
    element, dimension = reference_element(kind), dimension_of(kind)
    directory, printed = made[kind]
    path = directory / f"{body}_solid{dimension}d.msh"
    mesh = meshio.read(path)
    start, end = BODIES[body]

    assert {name: int(of_dimension) for name, (_, of_dimension) in mesh.field_data.items()} == {
        "hinge": dimension - 1,
        "tip": dimension - 1,
        body: dimension,
    }
    assert {block.type for block in mesh.cells} == {kind, element.face_kind}
    cells = cells_of(mesh, kind, body)
    assert len(cells) == sum(len(block.data) for block in mesh.cells if block.type == kind)
    np.testing.assert_array_equal(np.unique(cells), np.arange(len(mesh.points)))
    assert len(np.unique(mesh.points.round(9), axis=0)) == len(mesh.points)  # none at the same place
    unknowns = dimension * len(mesh.points)
    assert f"{path}: {len(cells)} {kind}, {len(mesh.points)} nodes, {unknowns} unknowns\n" in printed

    assert determinants(mesh.points[:, :dimension], cells, element.mass.gradients).min() > 0.0
    if dimension == 2:
        area, missing = HEIGHT, 1e-12
        assert not mesh.points[:, 2].any()
        np.testing.assert_allclose([mesh.points[:, 1].min(), mesh.points[:, 1].max()], [-HEIGHT / 2, HEIGHT / 2])
    else:
        area, missing = math.pi * RADIUS**2, MISSING[kind]
        assert np.linalg.norm(mesh.points[:, 1:], axis=1).max() == pytest.approx(RADIUS, rel=1e-12)
    assert -1e-12 < 1.0 - volume(mesh, kind, body) / ((end - start) * area) < missing
    for group, x in (("hinge", start), ("tip", end)):
        faces = cells_of(mesh, element.face_kind, group)
        np.testing.assert_allclose(mesh.points[faces][..., 0], x, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(np.unique(faces), np.flatnonzero(np.abs(mesh.points[:, 0] - x) < 1e-9))


@pytest.mark.parametrize("kind", ["hexahedron20", "hexahedron27"])
def test_nodes_of_quadratic_hexahedra_are_on_the_circle(made: dict[str, tuple[Path, str]], kind: str) -> None:
    mesh = meshio.read(made[kind][0] / "crank_solid3d.msh")
    n_layers, n_edges = 15, 8
    radii = np.linalg.norm(mesh.points[:, 1:], axis=1)
    on_circle = mesh.points[np.abs(radii / RADIUS - 1.0) < 1e-12]
    # between two layers hexahedron20 has nodes at corners only
    between = n_edges if kind == "hexahedron20" else 2 * n_edges
    assert len(on_circle) == 2 * n_edges * (n_layers + 1) + between * n_layers
    angles = np.unique((np.arctan2(on_circle[:, 2], on_circle[:, 1]) / (math.pi / n_edges)).round(6) % (2 * n_edges))
    np.testing.assert_allclose(angles, np.arange(2 * n_edges), atol=1e-6)
    expected = 0.3 * math.pi * RADIUS**2 * (1.0 - lost_by_parabolas(n_edges))
    assert volume(mesh, kind, "crank") == pytest.approx(expected, rel=1e-12)


def test_nodes_and_cells_are_numbered_from_hinge_to_tip(made: dict[str, tuple[Path, str]]) -> None:
    for kind in (*PLANE_KINDS, *SOLID_KINDS):
        mesh = meshio.read(made[kind][0] / f"rod_solid{dimension_of(kind)}d.msh")
        assert (np.diff(mesh.points[:, 0]) > -1e-9).all()
        assert (np.diff(cells_of(mesh, kind, "rod").min(axis=1)) >= 0).all()


@pytest.mark.parametrize("name", ["crank_solid2d", "rod_solid2d", "crank_solid3d", "rod_solid3d"])
def test_the_shipped_meshes_are_those_of_the_defaults(made: dict[str, tuple[Path, str]], name: str) -> None:
    kind, body = "quad8" if name.endswith("2d") else "hexahedron20", name.split("_")[0]
    face_kind = reference_element(kind).face_kind
    shipped = meshio.read(ROOT / "meshes" / f"{name}.msh")
    mesh = meshio.read(made[kind][0] / f"{name}.msh")
    # another version of gmsh may begin at other corners of the cells, and round differently
    np.testing.assert_allclose(mesh.points, shipped.points, rtol=0, atol=1e-15)
    for group, of_kind in ((body, kind), ("hinge", face_kind), ("tip", face_kind)):
        both = (np.sort(cells_of(found, of_kind, group), axis=1) for found in (mesh, shipped))
        np.testing.assert_array_equal(*both)
    assert (ROOT / "meshes" / f"{name}.msh").stat().st_size < 250_000


def test_size_and_number_across(tmp_path: Path) -> None:
    result = run("-o", tmp_path, "-s", 0.05, "-a", 4, "--suffix", "_fine", "--binary")
    assert result.returncode == 0, result.stderr
    names = [f"{body}_solid{dimension}d_fine.msh" for body in BODIES for dimension in (2, 3)]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    # 6 and 14 cells along; a core of 4 x 4 cells, with 16 around it in each of two rings
    n_cells = [
        len(cells_of(meshio.read(tmp_path / name), kind, name.split("_")[0]))
        for name, kind in zip(names, ["quad8", "hexahedron20"] * 2)
    ]
    assert n_cells == [6 * 4, 6 * 48, 14 * 4, 14 * 48]
    mesh = meshio.read(tmp_path / "rod_solid3d_fine.msh")
    expected = 0.7 * math.pi * RADIUS**2 * (1.0 - lost_by_parabolas(16))
    assert volume(mesh, "hexahedron20", "rod") == pytest.approx(expected, rel=1e-12)
    assert (tmp_path / names[0]).read_bytes().startswith(b"$MeshFormat\n4.1 1 8\n")


@pytest.mark.parametrize(("kind", "n_corners"), [("hexahedron20", 4), ("tetra10", 3)])
def test_one_cell_across_has_four_edges_around_the_circle(tmp_path: Path, kind: str, n_corners: int) -> None:
    assert run("-o", tmp_path, "-a", 1, "-s", 0.1, "-k", kind).returncode == 0
    mesh = meshio.read(tmp_path / "crank_solid3d.msh")
    corners = np.unique(cells_of(mesh, reference_element(kind).face_kind, "hinge")[:, :n_corners])
    radii = np.linalg.norm(mesh.points[corners, 1:], axis=1)
    assert np.isclose(radii, RADIUS, rtol=1e-12).sum() == 4


def test_other_bodies_and_radius(tmp_path: Path) -> None:
    result = run(
        "-o", tmp_path, "-r", 0.01, "-k", "quad9", "tetra10", "--body", "arm", -0.25, 0.25, "--body", "strut", 2, 2.001
    )
    assert result.returncode == 0, result.stderr
    assert len(list(tmp_path.iterdir())) == 4
    for name, start, end in (("arm", -0.25, 0.25), ("strut", 2.0, 2.001)):  # the strut is shorter than one cell
        plane, solid = (meshio.read(tmp_path / f"{name}_solid{dimension}d.msh") for dimension in (2, 3))
        assert volume(plane, "quad9", name) == pytest.approx((end - start) * math.sqrt(3.0) * 0.01, rel=1e-12)
        assert volume(solid, "tetra10", name) == pytest.approx((end - start) * math.pi * 0.01**2, rel=1e-3)
        for mesh in (plane, solid):
            np.testing.assert_allclose([mesh.points[0, 0], mesh.points[-1, 0]], [start, end], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-s", "0"], "--size 0.0: a finite length above 0"),
        (["-s", "-0.1"], "--size -0.1: a finite length above 0"),
        (["-s", "nan"], "--size nan: a finite length above 0"),
        (["-s", "1e-320"], "--size 1e-320 --across 2: more than about 1e+07 cells for a body of 0.7 m"),
        (["-a", "0"], "--across 0: at least 1"),
        (["-r", "inf"], "--radius inf: a finite length above 0"),
        (["-k", "hexahedron8"], "invalid choice: 'hexahedron8' (choose from 'triangle', 'triangle6'"),
        (["-k", "quad8", "quad9"], "--kind quad8 quad9: two of them would be written to the same file"),
        (["--suffix", "a/b"], "--suffix a/b: a part of a file's name"),
        (["--body", "tip", "0", "1"], "--body tip 0 1: a name of letters, digits, _ and -, other than hinge and tip"),
        (["--body", "a/b", "0", "1"], "--body a/b 0 1: a name of letters, digits, _ and -"),
        (["--body", "a", "0", "x"], "--body a 0 x: START and END must be numbers"),
        (["--body", "a", "1", "1"], "--body a 1 1: finite numbers are needed, END above START"),
        (["--body", "a", "0", "inf"], "--body a 0 inf: finite numbers are needed"),
        (["--body", "a", "0", "1", "--body", "a", "1", "2"], "--body a 1 2: there is another body of this name"),
    ],
)
def test_bad_options_are_refused(tmp_path: Path, options: list[str], message: str) -> None:
    result = run("-o", tmp_path / "new", *options)
    assert result.returncode == 2
    assert message in result.stderr.splitlines()[-1]
    assert not (tmp_path / "new").exists()


def test_an_output_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = run("-o", tmp_path / "file")
    assert result.returncode == 2
    assert f"--output {tmp_path / 'file'}: a directory that exists or can be made is needed" in result.stderr


def in_process(*lines: str) -> subprocess.CompletedProcess[str]:
    """Run lines with the script as `script`, in a process of their own because of gmsh."""
    start = [
        "import importlib.machinery, importlib.util, sys",
        "sys.dont_write_bytecode = True",
        f"loader = importlib.machinery.SourceFileLoader('script', {str(SCRIPT)!r})",
        "script = importlib.util.module_from_spec(importlib.util.spec_from_loader('script', loader))",
        "sys.modules['script'] = script",
        "loader.exec_module(script)",
    ]
    return subprocess.run([sys.executable, "-c", "\n".join([*start, *lines])], capture_output=True, text=True)


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        ("(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)", "falls to -0.25 m^2"),
        ("(0, 0, 0), (1, 0, 0), (0.2, 0.2, 0), (0, 1, 0)", "falls to -0.15 m^2"),
    ],
)
def test_unsound_cells_are_refused(corners: str, message: str) -> None:
    result = in_process(
        "import gmsh",
        "gmsh.initialize([], False)",
        "groups = {'plate': script.Group(2, 3, [(1, 2, 3, 4)])}",
        f"script.fill_model(gmsh.model, 'plate', [{corners}], groups)",
    )
    assert "RuntimeError: plate: 1 of 1 cells (Quadrilateral 4) are inverted or have no volume" in result.stderr
    assert message in result.stderr


def test_other_elements_than_asked_for_are_refused() -> None:
    result = in_process(
        "import gmsh",
        "gmsh.initialize([], False)",
        "gmsh.option.setNumber('General.Terminal', 0)",
        "script.KINDS['quad'] = script.KINDS['triangle']",  # quadrilaterals are made, triangles expected
        "script.mesh_bar(gmsh.model, script.Bar('plate', 0.0, 1.0, 0.1), 'quad', 0.5, 1)",
    )
    assert "RuntimeError: gmsh made the elements Quadrilateral 4 where all must be Triangle 3" in result.stderr


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("sys.modules['gmsh'] = None", "import of gmsh halted; None in sys.modules"),
        ("script.check_jacobians = lambda *_: exec('raise RuntimeError(\"unsound\")')", "unsound"),
    ],
)
def test_failures_are_one_message_and_no_file(tmp_path: Path, fault: str, message: str) -> None:
    result = in_process(fault, f"sys.argv = ['x', '-o', {str(tmp_path)!r}]", "script.main()")
    assert (result.returncode, result.stderr) == (1, f"make_solid_meshes: crank_solid2d.msh: {message}\n")
    assert not list(tmp_path.iterdir())
