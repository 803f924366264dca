"""The outer faces of meshes as triangles between the meshes' own nodes: what is known at nodes is drawn as it is.

A face of a quadratic cell has nodes between its corners: its edges are drawn as two straight pieces each.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mesh import reference_element as reference

# by the beginning of a kind's name: edges, then faces or, in the plane, the cell itself, by their corners
_SHAPES = {
    "triangle": (reference.EDGES_OF_TRIANGLE, ((0, 1, 2),)),
    "quad": (reference.EDGES_OF_QUAD, ((0, 1, 2, 3),)),
    "tetra": (reference.EDGES_OF_TETRA, reference.FACES_OF_TETRA),
    "hexahedron": (reference.EDGES_OF_HEXAHEDRON, reference.FACES_OF_HEXAHEDRON),
}
_LINEAR = ("triangle", "quad", "tetra", "hexahedron")
# of a face by its number of nodes, one after the other around it
_TRIANGLES = {
    3: ((0, 1, 2),),
    4: ((0, 1, 2), (0, 2, 3)),
    6: ((0, 1, 5), (1, 2, 3), (3, 4, 5), (1, 3, 5)),
    8: ((0, 1, 7), (1, 2, 3), (3, 4, 5), (5, 6, 7), (1, 3, 7), (3, 5, 7)),
}


def outer_faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Return the faces that one cell alone has, in the plane all cells, by the nodes around them, shape (n_faces, k).

    Parameters
    ----------
    kind
        meshio's name of the cells.
    cells
        Their nodes, shape (n_cells, n_a).
    """
    shape = next(name for name in _SHAPES if kind.startswith(name))
    edges, faces = _SHAPES[shape]
    n_corners = 1 + max(max(face) for face in faces)
    between = {frozenset(edge): n_corners + number for number, edge in enumerate(edges)}
    around = []
    for face in faces:
        ring: list[int] = []
        for corner, following in zip(face, (*face[1:], face[0])):
            ring += [corner] if kind in _LINEAR else [corner, between[frozenset((corner, following))]]
        around.append(ring)
    found = cells[:, np.array(around)].reshape(-1, len(around[0]))
    if len(faces) == 1:
        return found
    corners = np.sort(found if kind in _LINEAR else found[:, ::2], axis=1)
    _, which, counts = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    return found[counts[which.reshape(-1)] == 1]


def triangles(faces: np.ndarray) -> np.ndarray:
    """Return the triangles of faces (n_faces, k), shape (n_triangles, 3)."""
    return faces[:, np.array(_TRIANGLES[faces.shape[1]])].reshape(-1, 3)


def outlines(faces: np.ndarray, nodes: np.ndarray, sharp: float = 0.5) -> np.ndarray:
    """Return the pieces of edges that show a body's shape, shape (n, 2): those of one face, and between faces whose
    normals are more than `sharp` radians apart.

    Parameters
    ----------
    faces
        Shape (n_faces, k).
    nodes
        Where their nodes are, shape (n_nodes, d).
    """
    n_faces, k = faces.shape
    pieces = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    owner = np.repeat(np.arange(n_faces), k)
    keys, which, counts = np.unique(np.sort(pieces, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    starts = np.cumsum(counts) - counts
    shown = counts == 1
    if nodes.shape[1] == 3:
        twice = np.flatnonzero(counts == 2)
        first, second = (normals(faces, nodes)[owner[order[starts[twice] + j]]] for j in (0, 1))
        shown[twice] = np.sum(first * second, axis=1) < np.cos(sharp)
    return keys[shown]


def normals(faces: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return unit normals of faces (n_faces, k) in space, shape (n_faces, 3): those of the vector areas."""
    around = nodes[faces] - nodes[faces[:, :1]]
    areas = np.cross(around, np.roll(around, -1, axis=1)).sum(axis=1)
    return areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-300)


def coarsened(
    nodes: np.ndarray, triangles: np.ndarray, weights: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes that stand for all others of a surface, and its triangles between these.

    Nodes in the same cube become one, that of the largest weight among them (Rossignac and Borrel, Multi-resolution 3D
    approximations for rendering complex scenes, 1993).

    Parameters
    ----------
    nodes
        Shape (n_nodes, d).
    triangles
        Shape (n_triangles, 3).
    weights
        Shape (n_nodes,).
    most
        Nodes that are kept at most.
    """
    corners = nodes[triangles]
    sides = np.zeros((len(triangles), 2, 3))
    sides[..., : nodes.shape[1]] = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
    size = np.sqrt(area / most)
    while True:
        cubes = np.floor((nodes - nodes.min(axis=0)) / size).astype(np.int64)
        _, cube = np.unique(cubes, axis=0, return_inverse=True)
        cube = cube.reshape(-1)
        if cube.max() < most:
            break
        size *= 1.2
    order = np.lexsort((weights, cube))
    kept = order[np.append(np.diff(cube[order]) > 0, True)]
    found = cube[triangles]
    alive = (found[:, 0] != found[:, 1]) & (found[:, 1] != found[:, 2]) & (found[:, 2] != found[:, 0])
    _, first = np.unique(np.sort(found[alive], axis=1), axis=0, return_index=True)
    return kept, found[alive][np.sort(first)]
