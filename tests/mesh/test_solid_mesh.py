"""Plane and solid meshes: what is read, how faces and regions are named, and every way in which a file is refused."""

import dataclasses
import importlib.util
import math
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from conftest import ROOT
from refusals import assert_refused, cases
from solids import SIDES, box_mesh, dimension_of, grid, jacobian_determinants, rectangle_mesh

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mesh import LineMesh, SolidMesh
from pgmp_petsc.mesh.meshes import PLANE_KINDS, SOLID_KINDS, cell_faces, reference_element, refined, shape_gradients
from pgmp_petsc.mesh.solid_mesh_reading import entity_groups, read_solid_mesh, solid_mesh

ENTRY = "bodies.crank.mesh"
KINDS = (*PLANE_KINDS, *SOLID_KINDS)
COUNTS, LENGTHS = (4, 3, 2), (2.0, 1.5, 0.5)
TETRA = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
SQUARES = [[x, y, 0.0] for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)]  # two unit squares side by side
TWO_QUADS = [[0, 1, 4, 3], [1, 2, 5, 4]]


def small_grid(kind: str) -> meshio.Mesh:
    d = dimension_of(kind)
    return grid(kind, COUNTS[:d], LENGTHS[:d])


def read(mesh: meshio.Mesh, dimension: int) -> SolidMesh:
    return solid_mesh(mesh, dimension, "received")


def shuffled(mesh: meshio.Mesh, kind: str) -> meshio.Mesh:
    """Return the mesh with its nodes and the cells of every block in a random order."""
    random = np.random.default_rng(20261120)
    order = random.permutation(len(mesh.points))
    numbers = np.argsort(order)
    blocks = [(block.type, numbers[random.permutation(block.data)]) for block in mesh.cells]
    return meshio.Mesh(mesh.points[order], blocks, cell_data=mesh.cell_data, field_data=mesh.field_data)


def measure(kind: str, nodes: np.ndarray, cells: np.ndarray) -> float:
    """Return the length, area or volume of cells, which may have fewer dimensions than the space."""
    mass = reference_element(kind).mass
    tangents = np.einsum("cni,qdn->cqid", nodes[cells], mass.gradients)
    squares = np.linalg.det(np.einsum("cqid,cqie->cqde", tangents, tangents))
    return float((np.sqrt(squares) @ mass.weights).sum())


def places(nodes: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the coordinates of all nodes of each cell, in an order that does not depend on any numbering."""
    rows = nodes[cells].reshape(len(cells), -1)
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize("kind", KINDS)
def test_volume_and_sides_of_every_kind(kind: str) -> None:
    d = dimension_of(kind)
    mesh = (rectangle_mesh if d == 2 else box_mesh)(kind, COUNTS[:d], LENGTHS[:d])
    mass = reference_element(kind).mass
    volume = math.prod(LENGTHS[:d])
    # Round-off of sums over a few thousand points.
    assert (jacobian_determinants(mesh.nodes, mesh.cells, mass.gradients) @ mass.weights).sum() == pytest.approx(
        volume, rel=1e-13
    )
    assert (mesh.kind, mesh.dimension, mesh.nodes.shape) == (kind, d, (mesh.n_nodes, d))
    assert mesh.n_cells == len(mesh.cells)
    np.testing.assert_array_equal(mesh.region("body", "x"), np.arange(mesh.n_cells))
    face_kind = reference_element(kind).face_kind
    for axis, sides in enumerate(SIDES[d]):
        for name, place in zip(sides, (0.0, LENGTHS[axis])):
            faces = mesh.faces(name, "x")
            np.testing.assert_array_equal(mesh.nodes[faces][..., axis], place)
            assert measure(face_kind, mesh.nodes, faces) == pytest.approx(volume / LENGTHS[axis], rel=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_reading_a_file_keeps_the_geometry(kind: str, tmp_path: Path) -> None:
    made = shuffled(small_grid(kind), kind)
    path = tmp_path / "mesh.msh"
    made.write(path, file_format="gmsh22")
    mesh = read_solid_mesh(path, dimension_of(kind), ENTRY)
    points = made.points[:, : mesh.dimension]
    np.testing.assert_array_equal(places(mesh.nodes, mesh.cells), places(points, made.cells[0].data))
    for block, name in zip(made.cells[1:], sum(SIDES[mesh.dimension], ())):
        np.testing.assert_array_equal(places(mesh.nodes, mesh.groups[name]), places(points, block.data))
    again = read_solid_mesh(path, mesh.dimension, ENTRY)
    np.testing.assert_array_equal(again.nodes, mesh.nodes)
    np.testing.assert_array_equal(again.cells, mesh.cells)


@pytest.mark.parametrize("kind", KINDS)
def test_contiguous_shares_of_nodes_are_compact(kind: str) -> None:
    d = dimension_of(kind)
    counts, lengths = (24, 2, 2)[:d], (12.0, 1.0, 1.0)[:d]
    mesh = read(shuffled(grid(kind, counts, lengths), kind), d)
    lowest = mesh.cells.min(axis=1)
    assert (np.diff(lowest) >= 0).all()
    # A quarter of a bar is 3 long; a layer of nodes adds up to its width at both ends, slanted as tetrahedra lie.
    for share in np.array_split(mesh.nodes, 4):
        assert np.ptp(share[:, 0]) <= 3.0 + 2 * 1.0
    # nodes that are coupled are at most two layers of one node distance (that of the cells' neighbours) apart
    layer = mesh.n_nodes / counts[0]
    assert np.ptp(mesh.cells, axis=1).max() <= 3 * layer


def test_faces_come_in_the_order_of_the_element_whatever_the_file_has() -> None:
    made = small_grid("hexahedron20")
    expected = read(made, 3)
    made.cells[1].data = made.cells[1].data[::-1][:, [2, 1, 0, 3, 5, 4, 7, 6]]  # other way round, from another corner
    mesh = read(made, 3)
    np.testing.assert_array_equal(mesh.groups["left"], expected.groups["left"])
    faces_of_cells = cell_faces(mesh.kind, mesh.cells).tolist()
    assert all(face in faces_of_cells for face in mesh.groups["left"].tolist())


def test_nodes_in_no_cell_are_left_out() -> None:
    cells = [("vertex", [[6]]), ("line", [[0, 6]]), ("quad", np.array(TWO_QUADS) + 1)]
    mesh = read(meshio.Mesh([[9, 9, 0], *SQUARES, [5, 0, 0]], cells, point_sets={"a": [0, 1, 4]}), 2)
    np.testing.assert_array_equal(np.sort(mesh.nodes, axis=0), np.sort(np.array(SQUARES)[:, :2], axis=0))
    np.testing.assert_array_equal(mesh.nodes[mesh.groups["a"]], [[[0.0, 1.0], [0.0, 0.0]]])


def test_face_cells_outside_groups_are_ignored() -> None:
    cells = [("line", [[0, 1], [5, 0]]), ("quad", TWO_QUADS), ("vertex", [[3]]), ("line3", [[0, 1, 2]])]
    mesh = read(meshio.Mesh(SQUARES, cells), 2)
    assert (mesh.groups, mesh.regions, mesh.small_groups) == ({}, {}, {})
    # but a group may be inside the body, and goes before a node set of its name
    cells, sets = [("quad", TWO_QUADS), ("line", [[4, 1]])], {"a": [0, 1, 2, 3]}
    mesh = read(meshio.Mesh(SQUARES, cells, cell_sets={"a": [[], [0]]}, point_sets=sets), 2)
    np.testing.assert_array_equal(mesh.nodes[mesh.groups["a"]], [[[1.0, 0.0], [1.0, 1.0]]])


def test_node_sets_and_element_sets_of_abaqus(tmp_path: Path) -> None:
    path = tmp_path / "block.inp"
    made = small_grid("hexahedron20")
    x, y = made.points[:, 0], made.points[:, 1]
    sets = {"left": x == 0.0, "edge": (x == 0.0) & (y == 0.0), "corners": (x == 0.0) & (y % 0.5 == 0.0)}
    sets["inside"] = x == 0.5
    meshio.Mesh(
        made.points,
        made.cells[:1],
        point_sets={name: np.flatnonzero(held) for name, held in sets.items()},
        cell_sets={"half": [np.arange(12)]},
    ).write(path)
    mesh = read_solid_mesh(path, 3, ENTRY)
    assert {name.lower() for name in mesh.groups} == {"left"}
    assert measure("quad8", mesh.nodes, mesh.groups["left"]) == pytest.approx(LENGTHS[1] * LENGTHS[2], rel=1e-13)
    assert len(mesh.groups["left"]) == COUNTS[1] * COUNTS[2]
    assert {name: mesh.small_groups[name] for name in ("edge", "inside")} == {
        "edge": 2 * COUNTS[2] + 1,
        "inside": np.count_nonzero(sets["inside"]),
    }
    # the first twelve cells of the file are those with x < 1
    assert (mesh.nodes[mesh.cells[mesh.region("half", "x")]][..., 0] <= 1.0).all()
    assert len(mesh.region("half", "x")) == 12
    assert_refused(f"holds {2 * COUNTS[2] + 1} nodes but no whole face on the surface", mesh.faces, "edge", "x")


def test_node_sets_of_plane_points(tmp_path: Path) -> None:
    path = tmp_path / "plate.inp"
    path.write_text(
        "*NODE\n10, 0., 0.\n20, 1., 0.\n30, 1., 1.\n40, 0., 1.\n*ELEMENT, TYPE=CPS4\n7, 10, 20, 30, 40\n"
        "*NSET, NSET=left\n10, 40\n*NSET, NSET=nobody\n"
    )
    mesh = read_solid_mesh(path, 2, ENTRY)
    np.testing.assert_array_equal(np.sort(mesh.nodes[mesh.groups["left"]][0], axis=0), [[0.0, 0.0], [0.0, 1.0]])
    assert mesh.small_groups == {"nobody": 0}


PLATES = """*NODE
1, 0., 0.
2, 1., 0.
3, 2., 0.
4, 0., 1.
5, 1., 1.
6, 2., 1.
** a comment
*Element, type=CPS4{first}
1, 1, 2, 5, 4
*ELEMENT, TYPE=CPS4{second}
2, 2, 3, 6, 5
*NSET, NSET=left
1, 4
"""
ON_A, ON_B = ", ELSET=a", ", ELSET=b"


def plates(tmp_path: Path, first: str = "", second: str = "", end: str = "") -> Path:
    path = tmp_path / "plates.inp"
    path.write_text(PLATES.format(first=first, second=second) + end)
    return path


def test_sets_of_element_cards(tmp_path: Path) -> None:
    mesh = read_solid_mesh(plates(tmp_path, ON_A, ON_B, "*ELSET, ELSET=both, GENERATE\n1, 2, 1\n"), 2, ENTRY)
    assert {name: len(cells) for name, cells in mesh.regions.items()} == {"a": 1, "b": 1, "both": 2}
    assert (mesh.nodes[mesh.cells[mesh.regions["a"]]][..., 0] <= 1.0).all()
    assert (mesh.nodes[mesh.cells[mesh.regions["b"]]][..., 0] >= 1.0).all()
    assert len(mesh.groups["left"]) == 1


@pytest.mark.parametrize(
    ("first", "second", "end", "regions", "held"),
    [
        (ON_A, ON_A, "", {"a": 2}, {}),
        (ON_A, ON_B, "*ELSET, ELSET=A\n2\n", {"a": 2, "b": 1}, {}),
        ("", "", "*NSET, NSET=LEFT\n2\n*NSET, NSET=all\n Left, 5\n", {}, {"left": 2, "all": 3}),
        ("", ON_B, "", {"b": 1}, {}),
        (ON_A, ON_B, "*ELSET, ELSET=ba\nb\na\n", {"a": 1, "b": 1, "ba": 2}, {}),
        ("", "", "*SYSTEM\n*INCLUDE, INPUT=more.inp\n", {"most": 2}, {"bottom": 2}),
    ],
)
def test_sets_of_abaqus_in_pieces_of_others_and_included(
    first: str, second: str, end: str, regions: dict, held: dict, tmp_path: Path
) -> None:
    faces = "*ELEMENT, TYPE=T3D2, ELSET=bottom\n8, 1, 2\n9, 2, 3\n"
    (tmp_path / "more.inp").write_text(faces + "*ELSET, ELSET=most, GENERATE\n1, 2\n")
    mesh = read_solid_mesh(plates(tmp_path, first, second, end), 2, ENTRY)
    assert {name: len(cells) for name, cells in mesh.regions.items()} == regions
    assert {name: len(faces) for name, faces in mesh.groups.items()} == {"left": 1, **held}


@pytest.mark.parametrize(
    ("end", "message"),
    [
        ("*ELEMENT, TYPE=DCOUP2D\n7, 1\n", "elements of type DCOUP2D, which are not known; leave them out"),
        ("*ELEMENT, TYPE=CPS4\n2, 1, 2, 5, 4\n", "element 2 is there twice"),
        ("*ELSET, ELSET=a\nb\n", 'a set is made from the set "b", which is not there before it'),
        ("*NSET, NSET=a, GENERATE\n1, 99999999999\n", "a set has 99999999999 members"),
        ("*ELGEN\n1, 2, 1, 1\n", "what a card ELGEN makes is not read; write all nodes"),
        ("*NODE, SYSTEM=C\n90, 1, 45\n", "what a card NODE makes is not read"),
        ("*INCLUDE, INPUT=none.inp\n", "INCLUDE = .*none.inp.*: no such file"),
        ("*INCLUDE, INPUT=plates.inp\n", "INCLUDE = .*plates.inp.*: the file includes itself"),
        ("*ELEMENT, TYPE=\n7, 1\n", "elements of type none, which are not known"),
    ],
)
def test_abaqus_files_that_are_refused(end: str, message: str, tmp_path: Path) -> None:
    path = plates(tmp_path, end=end)
    with pytest.raises(InputError, match=message) as caught:
        read_solid_mesh(path, 2, ENTRY)
    assert str(caught.value).startswith(f'{ENTRY} = "{path}": ')


@pytest.mark.parametrize("kind", ["triangle6", "quad8", "quad9", "tetra10", "hexahedron20"])
def test_quadratic_elements_of_abaqus_with_their_faces(kind: str, tmp_path: Path) -> None:
    """gmsh writes the faces of groups as trusses and plane elements."""
    types = {"triangle6": "CPS6", "quad8": "CPS8", "quad9": "S9R5", "tetra10": "C3D10", "hexahedron20": "C3D20"}
    types |= {"line3": "T3D3"} | ({} if kind == "triangle6" else {"triangle6": "CPE6", "quad8": "CPS8"})
    made, lines, number = small_grid(kind), ["*NODE"], 0
    lines += [f"{k + 1}, {', '.join(map(repr, map(float, point)))}" for k, point in enumerate(made.points)]
    for block in made.cells:
        lines.append(f"*ELEMENT, TYPE={types[block.type]}, ELSET=of_{block.type}")
        for cell in block.data:
            number += 1
            lines.append(f"{number}, {', '.join(str(node + 1) for node in cell)}")
    path = tmp_path / "mesh.inp"
    path.write_text("\n".join(lines))
    mesh, expected = read_solid_mesh(path, dimension_of(kind), ENTRY), read(made, dimension_of(kind))
    np.testing.assert_array_equal(mesh.nodes, expected.nodes)
    np.testing.assert_array_equal(mesh.cells, expected.cells)
    assert {len(faces) for faces in mesh.groups.values()} == {sum(len(b.data) for b in made.cells[1:])}


def test_gmsh_groups_of_other_dimensions_are_explained() -> None:
    made = small_grid("tetra")
    count = len(made.points)
    made = meshio.Mesh(
        made.points,
        [*made.cells, ("vertex", [[0], [1]]), ("line", [[0, 1]])],
        cell_data={"gmsh:physical": [*made.cell_data["gmsh:physical"], np.array([1, 1]), np.array([1])]},
        field_data={
            **made.field_data, "points": np.array([1, 0]), "curve": np.array([1, 1]), "nothing": np.array([9, 2]),
            "void": np.array([9, 3]), "time": np.array([0.5]),
        },
    )  # fmt: skip
    mesh = read(made, 3)
    assert mesh.n_nodes == count
    assert set(mesh.groups) == set(sum(SIDES[3], ()))  # the tag 1 of points and curves is not that of the body
    assert len(mesh.regions["body"]) == mesh.n_cells
    assert mesh.small_groups == {"points": 2, "curve": 2, "nothing": 0, "void": 0}
    entry = "bodies.crank.interfaces.hinge"
    with pytest.raises(InputError, match=f'{entry} = "points": this name holds 2 nodes but no whole face.*known: back'):
        mesh.faces("points", entry)
    with pytest.raises(InputError, match=f'{entry} = "nothing": this name holds nothing; a group of faces is needed'):
        mesh.faces("nothing", entry)
    with pytest.raises(InputError, match='"void": this name holds nothing; a region of cells is needed; known: body'):
        mesh.region("void", entry)


def test_a_block_may_be_in_several_groups() -> None:
    """meshio tells the first group of a block of MSH 4.1 in the tags, and others in the sets."""
    made = small_grid("quad")
    empty = np.empty(0, dtype=np.uint64)
    ends = [empty, *(np.arange(len(block.data), dtype=np.uint64) for block in made.cells[1:3]), empty, empty]
    made.field_data["ends"] = np.array([77, 1])
    made.cell_sets = {"ends": ends, "gmsh:bounding_entities": [np.array([1, 2])] * 5}
    mesh = read(made, 2)
    assert len(mesh.groups["ends"]) == 2 * COUNTS[1]
    assert "gmsh:bounding_entities" not in {**mesh.groups, **mesh.regions, **mesh.small_groups}


MSH_41 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
3
1 1 "left"
1 2 "ends"
2 3 "plate"
$EndPhysicalNames
$Entities
0 2 1 0
4 0 0 0 0 1 0 {left} 0
5 2 0 0 2 1 0 1 -2 2 7 -8
1 0 0 0 2 1 0 1 3 2 4 5
$EndEntities
$Nodes
1 6 1 6
2 1 0 6
1
2
3
4
5
6
0 0 0
1 0 0
2 0 0
0 1 0
1 1 0
2 1 0
$EndNodes
$Elements
3 4 1 4
1 4 1 1
1 1 4
1 5 1 1
2 3 6
2 1 3 2
3 1 2 5 4
4 2 3 6 5
$EndElements
"""


@pytest.mark.parametrize("left", ["2 1 2", "2 -1 2", "2 -2 -1"])
def test_reversed_entities_are_in_all_groups_of_a_gmsh_file(left: str, tmp_path: Path) -> None:
    path = tmp_path / "mesh.msh"
    path.write_text(MSH_41.format(left=left))
    mesh = read_solid_mesh(path, 2, ENTRY)
    np.testing.assert_array_equal(np.unique(mesh.nodes[mesh.groups["left"]][..., 0]), [0.0])
    np.testing.assert_array_equal(np.unique(mesh.nodes[mesh.groups["ends"]][..., 0]), [0.0, 2.0])
    np.testing.assert_array_equal(mesh.regions["plate"], [0, 1])


def test_gmsh_files_without_entities_have_the_tags_only(tmp_path: Path) -> None:
    path = tmp_path / "mesh.msh"
    beginning, _, end = MSH_41.partition("$Entities")
    path.write_text(beginning + end.partition("$EndEntities\n")[2])
    assert entity_groups(path) == {}
    mesh = read_solid_mesh(path, 2, ENTRY)
    assert (mesh.n_cells, mesh.groups, mesh.small_groups) == (2, {}, {"left": 0, "ends": 0, "plate": 0})


@pytest.fixture
def mesh() -> SolidMesh:
    return rectangle_mesh("quad", (2, 1), (2.0, 1.0))


@pytest.mark.parametrize(
    ("method", "name", "message"),
    [
        ("faces", "lefd", r'joints.a = "lefd": the mesh has no group of faces of this name; did you mean \'left\'\?'),
        ("faces", "xyz", "known: bottom, left, right, top"),
        ("faces", "body", 'joints.a = "body": this is a region of 2 cells; a group of faces is needed; known: bottom'),
        ("region", "boddy", r"has no region of cells of this name; did you mean 'body'\?"),
        ("region", "left", "this is a group of 1 faces; a region of cells is needed; known: body"),
    ],
)
def test_unknown_names_are_refused(mesh: SolidMesh, method: str, name: str, message: str) -> None:
    assert_refused(message, getattr(mesh, method), name, "joints.a")


def test_names_of_a_mesh_without_groups() -> None:
    mesh = read(meshio.Mesh(TETRA, [("tetra", [[0, 1, 2, 3]])]), 3)
    assert_refused("none is defined", mesh.faces, "left", "joints.a")
    with pytest.raises(dataclasses.FrozenInstanceError):
        mesh.kind = "tetra10"


def changed(kind: str, **changes: object) -> meshio.Mesh:
    """Return the body of a grid with other points (a function of them) or other cells."""
    mesh = small_grid(kind)
    points = changes["points"](mesh.points.copy()) if "points" in changes else mesh.points
    cells = changes["cells"](mesh.cells[0].data.copy()) if "cells" in changes else mesh.cells[0].data
    return meshio.Mesh(points, [(kind, cells)])


def with_value(array: np.ndarray, index: object, value: object) -> np.ndarray:
    array[index] = value
    return array


def two_boxes(kind: str) -> meshio.Mesh:
    mesh = small_grid(kind)
    cells, count = mesh.cells[0].data, len(mesh.points)
    return meshio.Mesh(np.vstack([mesh.points, mesh.points + 5.0]), [(kind, np.vstack([cells, cells + count]))])


#: The dimension of a body, its mesh, and what is said of it.
REFUSED = cases(r"""
3, meshio.Mesh(TETRA, []) -> no cells of dimension 3 \(it has: no cells at all\); solid
3, small_grid("quad8") ->
    no cells of dimension 3 \(it has: 14 line3 and 12 quad8\); solid bodies take cells of one of the types tetra
2, small_grid("tetra10") ->
    it has 144 tetra10 cells, which cannot be used here; plane bodies take cells of one of the types triangle
3, meshio.Mesh([*TETRA, [1, 0, 1], [0, 1, 1]], [("wedge", [[0, 1, 2, 3, 4, 5]])]) ->
    it has 1 wedge cells, which cannot be used here; solid bodies
3, meshio.Mesh([*TETRA, [1, 0, 1], [0, 1, 1]], [("wedge", [[0, 1, 2, 3, 4, 5]]), ("tetra", [[0, 1, 2, 3]])]) ->
    it has 1 wedge cells
2, meshio.Mesh([*SQUARES, [0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0]], [("triangle6", [[0, 1, 3, 6, 7, 8]]), ("triangle",
    [[1, 4, 3]]), ("triangle", [[1, 2, 4], [2, 5, 4]])]) ->
    it has 3 triangle and 1 triangle6 cells together; plane bodies .* the same shape and order throughout
2, meshio.Mesh(SQUARES, [("triangle", [[0, 1, 4], [0, 4, 3]]), ("quad", TWO_QUADS[1:])]) ->
    it has 1 quad and 2 triangle cells together
2, meshio.Mesh(SQUARES, [("quad", [*TWO_QUADS, [2, 9, 10, 5]])]) ->
    1 of 3 cells of type quad name a node that the file does not hold; the first is cell 2 with the nodes
2, meshio.Mesh(SQUARES, [("quad", [[0, 1, -2, 3], [-1, 2, 5, 4]])]) ->
    2 of 2 cells of type quad name a node .* cell 0 with the nodes \[0, 1, -2, 3\]
3, changed("hexahedron", points=lambda x: with_value(x, [7, 9], np.nan)) ->
    2 of 60 nodes have coordinates that are not finite; the first is node 7 at \[nan, nan, nan\]
2, changed("quad", points=lambda x: with_value(x, (3, 2), np.inf)) ->
    1 of 20 nodes have coordinates that are not finite; the first is node 3
2, changed("quad", points=lambda x: with_value(x, ([5, 8], 2), 1e-6)) ->
    2 of 20 nodes are off the plane z = 0, where plane bodies lie; the first is node 5 at \[0.5, 0.5, 1e-06\]
2, changed("quad", points=lambda x: x + [0, 0, 1]) -> 20 of 20 nodes are off the plane
2, meshio.Mesh(SQUARES, [("quad", [TWO_QUADS[0], TWO_QUADS[1][::-1]])]) ->
    1 of 2 cells of type quad are inverted or have no area; the first is cell 1 with the nodes \[4, 5, 2, 1\], where
2, changed("triangle6", cells=lambda cells: cells[:, [0, 2, 1, 5, 4, 3]]) -> all 24 cells of type triangle6 are inverted
3, changed("tetra10", points=lambda x: x * [-1, 1, 1]) ->
    all 144 cells of type tetra10 are inverted or have no volume; .*; it must be positive throughout each cell
3, changed("hexahedron", points=lambda x: x * [1, 1, 0]) ->
    all 24 cells of type hexahedron are inverted or have no volume; .* falls to 0; it must be
3, changed("tetra", points=lambda x: x[:, :2]) -> all 144 cells of type tetra are inverted or have no volume
2, meshio.Mesh(SQUARES[:5], [("quad", [[0, 1, 4, 3], [1, 2, 2, 4]])]) ->
    1 of 2 cells of type quad are inverted or have no area; the first is cell 1 .* falls to 0; it must be
# with the middle at 1/4 the determinant is zero at the corner and positive at all quadrature points
2, meshio.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.25, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0]], [("triangle6", [[0, 1, 2,
    3, 4, 5]])]) ->
    all 1 cells of type triangle6 are inverted
3, changed("hexahedron20", cells=lambda cells: cells[:, [*range(12), *range(16, 20), *range(12, 16)]]) ->
    all 24 cells of type hexahedron20 are inverted
3, two_boxes("tetra") ->
    the cells form 2 separate pieces of \[144, 144\] cells; the first that does not hang together with cell 0 is cell
2, meshio.Mesh([[x + 3.0 * i, y, 0.0] for i in range(12) for x, y in ((0, 0), (1, 0), (0, 1))], [("triangle",
    np.arange(36).reshape(12, 3))]) ->
    12 separate pieces of \[1, 1, 1, 1, 1, 1, 1, 1, \.\.\.\] cells; .* cell 1 with the nodes \[3, 4, 5\]
2, meshio.Mesh(SQUARES, [("quad", TWO_QUADS), ("quad", [[2, 5, 4, 1], [4, 1, 2, 5]])]) ->
    2 of 4 cells of type quad repeat the nodes of another one; the first is cell 2, which has the nodes \[2, 5, 4, 1\]
2, meshio.Mesh([*TETRA[:3], [0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0]], [("triangle6", [[0, 1, 2, 3, 4, 5]]), ("line",
    [[2, 0]])], cell_sets={"left": [[], [0]]}) ->
    mixed element orders: the group "left" has 1 faces of type line, the first with the nodes \[2, 0\]; faces of
2, meshio.Mesh(SQUARES, [("line", [[0, 1], [0, 4], [3, 5]]), ("quad", TWO_QUADS)], cell_sets={"left": [[0, 1, 2],
    []]}) ->
    the group "left" has 2 of 3 faces that are no face of any quad cell; the first has the nodes \[0, 4\]
2, meshio.Mesh(SQUARES, [("line", [[0, 1], [0, 9]]), ("quad", TWO_QUADS)], cell_sets={"left": [[0, 1], []]}) ->
    the group "left" has 1 of 2 faces that are no face of any quad cell; the first has the nodes \[0, 9\]
2, meshio.Mesh(SQUARES, [("quad", TWO_QUADS)], cell_sets={"all": [[np.array([0]), np.array([0, 1])]]}) ->
    the cells of the set "all" cannot be told from what meshio reads
2, meshio.Mesh(SQUARES, [("quad", TWO_QUADS[:1]), ("quad", TWO_QUADS[1:])], cell_sets={"all": [[0]]}) ->
    the cells of the set "all" cannot be told
2, meshio.Mesh(SQUARES, [("quad", TWO_QUADS)], cell_sets={"all": [[0, 2]]}) -> the cells of the set "all" cannot be told
""")


@pytest.mark.parametrize(("made", "message"), REFUSED)
def test_unusable_meshes_are_refused(made: str, message: str) -> None:
    dimension, mesh = eval(made)
    with pytest.raises(InputError, match=message) as caught:
        solid_mesh(mesh, dimension, f'{ENTRY} = "a.msh"')
    assert str(caught.value).startswith(f'{ENTRY} = "a.msh": ')
    assert "\n" not in str(caught.value)


def test_slender_cells_far_above_round_off_are_taken() -> None:
    """A plate a millionth of its length thick, in one layer: what counts is the thinnest measure, not the volume."""
    made = grid("hexahedron27", (1, 1, 1), (1.0, 1.0, 1e-6))
    assert read(made, 3).n_cells == 1
    assert_refused("no volume", read, grid("hexahedron27", (1, 1, 1), (1.0, 1.0, 1e-13)), 3)


needs_gmsh = pytest.mark.skipif(
    importlib.util.find_spec("gmsh") is None, reason="gmsh's Python module is not installed"
)


def cylinder(kind: str, path: Path, *options: str) -> Path:
    subprocess.run([sys.executable, ROOT / "tests" / "gmsh_cylinder.py", kind, path, *options], check=True)
    return path


def linear_weights(points: np.ndarray, in_simplex: bool) -> np.ndarray:
    """Return the weights of a tetrahedron's or hexahedron's corners at reference points."""
    if in_simplex:
        return np.column_stack([1.0 - points.sum(axis=1), points])
    corners = reference_element("hexahedron").nodes
    return np.where(corners == 1.0, points[:, None], 1.0 - points[:, None]).prod(axis=2)


@needs_gmsh
@pytest.mark.parametrize(
    ("kind", "options"), [("tetra10", ()), ("hexahedron20", ()), ("hexahedron27", ()), ("tetra10", ("binary",))]
)
def test_curved_cylinder_of_gmsh(kind: str, options: tuple[str, ...], tmp_path: Path) -> None:
    radius, length = 0.5, 2.0
    mesh = read_solid_mesh(cylinder(kind, tmp_path / "cylinder.msh", *options), 3, ENTRY)
    assert mesh.kind == kind
    element = reference_element(kind)
    determinants = jacobian_determinants(mesh.nodes, mesh.cells, element.mass.gradients)
    assert (determinants > 0).all()
    assert (jacobian_determinants(mesh.nodes, mesh.cells, shape_gradients(kind, element.nodes)) > 0).all()
    # Twelve parabolas or more around the circle leave out at most a share (pi/12)^4 / 30 = 1.6e-4 of it.
    disc = math.pi * radius**2
    assert (determinants @ element.mass.weights).sum() == pytest.approx(disc * length, rel=2e-4)
    areas = {"left": disc, "right": disc, "ends": 2 * disc, "mantle": 2 * math.pi * radius * length}
    assert set(mesh.groups) == set(areas)
    for name, area in areas.items():
        assert measure(element.face_kind, mesh.nodes, mesh.faces(name, "x")) == pytest.approx(area, rel=2e-4)
    np.testing.assert_array_equal(mesh.region("body", "x"), np.arange(mesh.n_cells))
    # Every node on an edge, in a face or in the cell is close to the middle of its corners: the order is meshio's.
    # On the surface it is off by the sagitta of an arc, at most (pi/6)^2 / 8 = 3 % of the radius for 12 arcs.
    weights = linear_weights(element.nodes, kind.startswith("tetra"))
    corners = mesh.nodes[mesh.cells[:, : weights.shape[1]]]
    assert np.linalg.norm(mesh.nodes[mesh.cells] - weights @ corners, axis=2).max() < 0.04 * radius


@needs_gmsh
def test_cells_of_gmsh_outside_physical_groups_are_refused_with_the_cure(tmp_path: Path) -> None:
    path = cylinder("tetra10", tmp_path / "cylinder.msh", "save_all")
    assert_refused("gmsh must save the cells of physical groups only", read_solid_mesh, path, 3, ENTRY)


BENT = LineMesh(
    np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 3.0]]), np.array([[0, 1], [2, 1]]), {"hinge": 0, "tip": 2}, {"both": 2}
)


@pytest.mark.parametrize("parts", [2, 3, 8])
def test_every_cell_is_cut_into_equal_parts(parts: int) -> None:
    fine = refined(BENT, parts)
    assert (fine.n_cells, fine.n_nodes) == (2 * parts, 3 + 2 * (parts - 1))
    np.testing.assert_allclose(fine.lengths, np.repeat([1.0, 3.0], parts) / parts, rtol=1e-14)
    steps = np.diff(fine.nodes[fine.cells], axis=1)[:, 0]
    np.testing.assert_allclose(steps, np.repeat([[1.0, 0.0], [0.0, -3.0]], parts, axis=0) / parts, atol=1e-15)
    # every node but the ends of the chain is on two cells
    assert sorted(np.bincount(fine.cells.ravel()))[:3] == [1, 1, 2]


def test_old_nodes_keep_their_numbers_and_names() -> None:
    fine = refined(BENT, 5)
    np.testing.assert_array_equal(fine.nodes[:3], BENT.nodes)
    assert fine.points == BENT.points and fine.groups == BENT.groups
    assert fine.point("2", "joints.elbow.connect") == 2


def test_one_part_is_the_mesh_itself() -> None:
    assert refined(BENT, 1) is BENT
    with pytest.raises(ValueError, match="at least 1"):
        refined(BENT, 0)
