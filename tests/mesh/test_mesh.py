"""Line meshes: what is read, how points are named, and every way in which a file is refused."""

import importlib.machinery
import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
from refusals import assert_refused

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mesh import LineMesh, read_line_mesh, reading
from pgmp_petsc.mesh.solid_mesh_reading import read_solid_mesh

ROOT = Path(__file__).resolve().parents[2]
ENTRY = "bodies.crank.mesh"
LINE_OF_THREE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 1.0, 0.0]]


def written(tmp_path: Path, points: list, cells: list, suffix: str = "vtu", **data: object) -> Path:
    path = tmp_path / f"mesh.{suffix}"
    meshio.Mesh(np.array(points, dtype=float), [(kind, np.array(rows)) for kind, rows in cells], **data).write(path)
    return path


@pytest.mark.parametrize(("body", "hinge", "tip"), [("crank", 0.0, 0.3), ("rod", 0.3, 1.0)])
@pytest.mark.parametrize("n_elements", [5, 40])
def test_shipped_meshes_run_from_hinge_to_tip(body: str, hinge: float, tip: float, n_elements: int) -> None:
    mesh = read_line_mesh(ROOT / "meshes" / f"{body}_{n_elements}.msh", ENTRY)
    # The file holds 16 significant digits, so coordinates are exact to a few units in the last place.
    np.testing.assert_allclose(mesh.nodes[:, 0], np.linspace(hinge, tip, n_elements + 1), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(mesh.nodes[:, 1], 0.0)
    np.testing.assert_array_equal(mesh.cells, np.column_stack([np.arange(n_elements), np.arange(1, n_elements + 1)]))
    assert mesh.points == {"hinge": 0, "tip": n_elements}
    assert (mesh.n_nodes, mesh.n_cells) == (n_elements + 1, n_elements)
    np.testing.assert_allclose(mesh.lengths, (tip - hinge) / n_elements, rtol=0, atol=1e-15)


@pytest.mark.skipif(importlib.util.find_spec("gmsh") is None, reason="gmsh's Python module is not installed")
def test_make_meshes_writes_what_is_shipped(tmp_path: Path) -> None:
    subprocess.run([sys.executable, ROOT / "scripts" / "make_meshes", "-o", tmp_path, "-n", "5", "3"], check=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["crank_3.msh", "crank_5.msh", "rod_3.msh", "rod_5.msh"]
    for name in ("crank_5.msh", "rod_5.msh"):
        made, shipped = (read_line_mesh(directory / name, ENTRY) for directory in (tmp_path, ROOT / "meshes"))
        np.testing.assert_array_equal(made.nodes, shipped.nodes)
        np.testing.assert_array_equal(made.cells, shipped.cells)
        assert made.points == shipped.points
    command = [sys.executable, ROOT / "scripts" / "make_meshes", "-o", tmp_path, "-n", "0"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 2 and "--elements 0: at least 1" in result.stderr


def test_make_meshes_imports_gmsh_only_when_it_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gmsh", None)  # from here on, importing gmsh raises ImportError
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    loader = importlib.machinery.SourceFileLoader("make_meshes", str(ROOT / "scripts" / "make_meshes"))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("make_meshes", loader))
    loader.exec_module(module)
    assert set(module.BODIES) == {"crank", "rod"}


def test_nodes_on_no_line_are_dropped(tmp_path: Path) -> None:
    points = [[9.0, 9.0, 9.0], *LINE_OF_THREE]
    mesh = read_line_mesh(written(tmp_path, points, [("vertex", [[0]]), ("line", [[1, 2], [3, 2]])]), ENTRY)
    np.testing.assert_array_equal(mesh.nodes, np.array(LINE_OF_THREE)[:, :2])
    np.testing.assert_array_equal(mesh.cells, [[0, 1], [2, 1]])
    np.testing.assert_allclose(mesh.lengths, [1.0, np.sqrt(2.0)], rtol=1e-15)


def test_abaqus_node_sets_name_points(tmp_path: Path) -> None:
    path = tmp_path / "beam.inp"
    path.write_text(
        "*NODE\n1, 0., 0., 0.\n2, 1., 0., 0.\n3, 2., 0., 0.\n*ELEMENT, TYPE=B31\n1, 1, 2\n2, 2, 3\n"
        "*NSET, NSET=hinge\n1\n*NSET, NSET=both\n1, 3\n"
    )
    mesh = read_line_mesh(path, ENTRY)
    assert {name.lower(): node for name, node in mesh.points.items()} == {"hinge": 0}
    assert {name.lower(): count for name, count in mesh.groups.items()} == {"both": 2}


def test_gmsh_groups_of_several_or_no_line_nodes_are_explained(tmp_path: Path) -> None:
    points = [*LINE_OF_THREE, [5.0, 0.0, 0.0]]
    cells = [("vertex", [[0], [2], [1], [3]]), ("line", [[0, 1], [1, 2]])]
    path = written(tmp_path, points, cells, "vtu")
    mesh = meshio.read(path)
    mesh.cell_data["gmsh:physical"] = [np.array([1, 1, 2, 4]), np.array([3, 3])]
    mesh.cell_data["gmsh:geometrical"] = [np.array([1, 2, 3, 4]), np.array([1, 1])]
    tags = {"ends": [1, 0], "middle": [2, 0], "beam": [3, 1], "aside": [4, 0]}
    mesh.field_data = {name: np.array(tag) for name, tag in tags.items()}
    meshio.write(tmp_path / "mesh.msh", mesh, file_format="gmsh22")
    line_mesh = read_line_mesh(tmp_path / "mesh.msh", ENTRY)
    assert line_mesh.points == {"middle": 1}
    assert line_mesh.groups == {"ends": 2, "aside": 0}
    with pytest.raises(InputError, match=r'joints.a.connect = "ends": this group holds 2 nodes.*exactly one'):
        line_mesh.point("ends", "joints.a.connect")
    assert_refused("holds 0 nodes of line cells", line_mesh.point, "aside", "joints.a.connect")


@pytest.fixture
def mesh() -> LineMesh:
    return LineMesh(np.array(LINE_OF_THREE)[:, :2], np.array([[0, 1], [1, 2]]), {"hinge": 0, "tip": 2, "7": 1})


@pytest.mark.parametrize(("name", "node"), [("hinge", 0), ("tip", 2), ("1", 1), ("2", 2), ("7", 1)])
def test_points_by_name_and_index(mesh: LineMesh, name: str, node: int) -> None:
    assert mesh.point(name, "joints.a.connect") == node


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hing", r'joints.a.connect = "hing": the mesh has no point of this name; did you mean \'hinge\'\?'),
        ("xyz", r"known: 7, hinge, tip \(or a node's index, 0 to 2\)"),
        ("3", r'joints.a.connect = "3": there is no such node; allowed: 0 to 2'),
        ("-1", "no point of this name"),
        ("9" * 5000, r"9999 \.\.\.\": there is no such node; allowed: 0 to"),
        ("²", "no point of this name"),
    ],
)
def test_unknown_points_are_refused(mesh: LineMesh, name: str, message: str) -> None:
    assert_refused(message, mesh.point, name, "joints.a.connect")


@pytest.mark.parametrize(
    ("points", "cells", "message"),
    [
        (LINE_OF_THREE, [("triangle", [[0, 1, 2]]), ("line", [[0, 1]])], "cells of type triangle; the element beam2d"),
        (LINE_OF_THREE, [("line3", [[0, 2, 1]])], "cells of type line3; the element beam2d takes two-node"),
        (LINE_OF_THREE, [("vertex", [[0]])], r"no cells of type line.*\(it has: vertex\)"),
        ([*LINE_OF_THREE[:2], [2.0, 0.0, 0.1]], [("line", [[0, 1], [1, 2]])], r"off the plane z = 0, .* is node 2 at"),
        ([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], [("line", [[0, 1]])], "off the plane z = 0"),
        ([*LINE_OF_THREE[:2], [1.0, 0.0, 0.0]], [("line", [[0, 1], [1, 2]])], r"cell 1 between the nodes \[1, 2\]"),
        (LINE_OF_THREE, [("line", [[0, 1], [1, 2], [2, 1]])], r"repeat .* cell 2, which has the nodes \[2, 1\]"),
        ([*LINE_OF_THREE, [3.0, 0.0, 0.0]], [("line", [[0, 1], [2, 3]])], "form 2 separate pieces"),
        ([*LINE_OF_THREE[:2], 3 * [np.nan]], [("line", [[0, 1], [1, 2]])], r"not finite; the first is node 2 at \[nan"),
        # nodes are numbered as in the file
        ([[9.0] * 3, [0.0] * 3, [1.0, 0.0, 1.0]], [("line", [[1, 2]])], "off the plane .* is node 2 at"),
        (LINE_OF_THREE, [("line", [[0, 3]])], "names a node that the file does not hold"),
    ],
)
def test_unusable_meshes_are_refused(tmp_path: Path, points: list, cells: list, message: str) -> None:
    path = written(tmp_path, points, cells)
    with pytest.raises(InputError, match=message) as caught:
        read_line_mesh(path, ENTRY)
    assert str(caught.value).startswith(f'{ENTRY} = "{path}": ')


@pytest.mark.parametrize(
    "read", [read_line_mesh, lambda path, entry: read_solid_mesh(path, 3, entry)], ids=["lines", "cells"]
)
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("absent.msh", None, "no such file; a mesh file that meshio reads"),
        ("broken.msh", "this is no mesh", "meshio cannot read this file"),
        ("broken.vtu", "<VTKFile", "meshio cannot read this file"),
        ("empty.inp", "", "it has no nodes"),
        ("scene.toml", "a = 1", "meshio cannot read this file"),
        (
            "deck.bdf",
            "BEGIN BULK\nINCLUDE 'nodes.inc'\nCTRIA3  1       1       1       2       3\nENDDATA\n",
            r"KeyError\(.*\.inp",
        ),
        ("broken.ply", "ply\nformat ascii 1.0\nend_header", "meshio cannot read this file"),
    ],
)
def test_unreadable_files_are_refused(
    tmp_path: Path, read: Callable, name: str, content: str | None, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path / name, ENTRY)
    assert str(caught.value).startswith(f'{ENTRY} = "{tmp_path / name}": ') and "\n" not in str(caught.value)
    assert capsys.readouterr() == ("", "")
    assert_refused("this is a directory", read, tmp_path, ENTRY)


def test_a_reader_that_does_not_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Looks for the next line of a file that has no more."""
    monkeypatch.setattr(reading, "LONGEST_READING", 3.0)
    (tmp_path / "endless.off").write_text("OFF\n")
    assert_refused("its reader had not ended after 3 s", read_line_mesh, tmp_path / "endless.off", ENTRY)
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # and one that does, of the same kind
    meshio.write(tmp_path / "cells.off", meshio.Mesh(points, [("triangle", [[0, 1, 2]])]))
    monkeypatch.undo()
    assert np.array_equal(reading.read_mesh(tmp_path / "cells.off", ENTRY).points, points)


def test_a_line_in_space_keeps_its_third_coordinate(tmp_path: Path) -> None:
    path, places = tmp_path / "bow.vtu", np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.25], [2.0, 0.0, 1.0]])
    meshio.write(path, meshio.Mesh(places, [("line", np.array([[0, 1], [1, 2]]))]))
    mesh = read_line_mesh(path, ENTRY, 3)
    np.testing.assert_array_equal(mesh.nodes, places)
    np.testing.assert_allclose(mesh.lengths, np.linalg.norm(np.diff(places, axis=0), axis=1))
    assert_refused("are off the plane z = 0", read_line_mesh, path, ENTRY)
    meshio.write(path, meshio.Mesh(places, [("triangle", np.array([[0, 1, 2]]))]))
    assert_refused("the element beam3d takes two-node cells of type line only", read_line_mesh, path, ENTRY, 3)
