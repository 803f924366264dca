"""Outer faces of meshes as triangles: their area, their normals and their edges are those of the body."""

import numpy as np
import pytest
from solids import box_mesh, rectangle_mesh, straightened

from pgmp_petsc.figures.motion import normals, outer_faces, outlines, triangles
from pgmp_petsc.mesh.solid_mesh import PLANE_KINDS, SOLID_KINDS

LENGTHS = (2.0, 1.0, 0.5)


def areas(nodes: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the vector areas of triangles, shape (n, 3)."""
    places = np.zeros((len(nodes), 3))
    places[:, : nodes.shape[1]] = nodes
    a, b, c = (places[found[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def length(nodes: np.ndarray, edges: np.ndarray) -> float:
    return float(np.linalg.norm(nodes[edges[:, 1]] - nodes[edges[:, 0]], axis=1).sum())


@pytest.mark.parametrize("kind", SOLID_KINDS)
def test_the_surface_of_a_box(kind: str) -> None:
    mesh = straightened(box_mesh(kind, (3, 2, 2), LENGTHS))
    faces = outer_faces(mesh.kind, mesh.cells)
    found = areas(mesh.nodes, triangles(faces))
    x, y, z = LENGTHS
    assert np.linalg.norm(found, axis=1).sum() == pytest.approx(2.0 * (x * y + y * z + z * x), rel=1e-12)
    # closed, and turned outwards: by the divergence of the position it encloses three times the volume
    middles = mesh.nodes[triangles(faces)].mean(axis=1)
    assert np.abs(found.sum(axis=0)).max() < 1e-12
    assert np.sum(middles * found) == pytest.approx(3.0 * x * y * z, rel=1e-12)
    assert np.abs(np.abs(normals(faces, mesh.nodes)).max(axis=1) - 1.0).max() < 1e-12
    assert length(mesh.nodes, outlines(faces, mesh.nodes)) == pytest.approx(4.0 * (x + y + z), rel=1e-12)


@pytest.mark.parametrize("kind", PLANE_KINDS)
def test_cells_in_the_plane(kind: str) -> None:
    mesh = straightened(rectangle_mesh(kind, (3, 2), LENGTHS[:2]))
    faces = outer_faces(mesh.kind, mesh.cells)
    found = areas(mesh.nodes, triangles(faces))
    assert found[:, 2].min() > 0.0 and found[:, 2].sum() == pytest.approx(2.0, rel=1e-12)
    assert length(mesh.nodes, outlines(faces, mesh.nodes)) == pytest.approx(6.0, rel=1e-12)


def test_nodes_between_corners_are_drawn_where_they_are() -> None:
    """A curved edge has two straight pieces: the area is that of the polygon through all nodes."""
    mesh = rectangle_mesh("quad8", (1, 1), (1.0, 1.0))
    nodes = mesh.nodes.copy()
    top = np.flatnonzero((nodes[:, 1] == 1.0) & (nodes[:, 0] == 0.5))
    nodes[top, 1] += 0.2
    found = areas(nodes, triangles(outer_faces(mesh.kind, mesh.cells)))
    assert found[:, 2].sum() == pytest.approx(1.0 + 0.5 * 0.2, rel=1e-12)
