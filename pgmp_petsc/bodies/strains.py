"""Strains of beams and of continuum bodies at points that stresses are asked for (docs/solids.md, stresses).

**Beams**, and the forces and moments in their sections that follow. Moments change as the transverse forces say, ``M' =
-Q`` in the plane, ``M_2' = Q_3,  M_3' = -Q_2`` in space. At a node every element has a value of its own. Strains are
those of `beam2d` and `beam3d`, in space in the axes of the element, (gamma_1, gamma_2, gamma_3, kappa_1, kappa_2,
kappa_3), in the plane (eps, gamma, kappa); then follows the shear in the middle of the element.

**Continuum bodies**, at the nodes of the mesh, recovered from the points where its elements know them best and averaged
there (Barlow 1976; Hinton and Campbell 1974). Strains are Green and Lagrange's, ``E = (F^T F - 1) / 2`` with ``F =
dx/dX``, or for small displacements in the body's frame their linear part ``(G + G^T) / 2``, ``G = du/dX``. Their
components are (xx, yy, xy) in the plane and (xx, yy, zz, xy, xz, yz) in space, of tensors: shear is half the change of
a right angle.

Rigid motion changes none of them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.bodies.beam2d import strains
from pgmp_petsc.bodies.floating import Beams, products
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh, reference_element, shape_gradients, shape_values

STRAIGHT = 1e-9  # 1 - cosine of the angle between elements in one direction: half of 4e-5 rad squared
ON_LINE = 1e-6  # of the body's extent: how far from an element a place may be that counts as on it
#: Components of a symmetric tensor by dimension.
COMPONENTS = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))}
INSIDE = 1e-6  # of a reference cell: how far outside a place may be that counts as in it
ROUNDS = 30  # of Newton's method for the place in a reference cell
CLOSE = 1e-12


@dataclass(frozen=True, eq=False)
class BeamStrains:
    """Points of a body of beams, each in an element."""

    body: Beams  # of flexible beams
    elements: np.ndarray  # their elements, shape (n_points,)
    along: np.ndarray  # places in these, 0 at the first node and 1 at the second, shape (n_points,)
    #: what continues extension and shear from the middle of a point's element to the point: its distance over that of
    #: the middles of two elements, shape (n_points,), and the numbers of these, before and after, each (n_points,)
    continued: tuple[np.ndarray, np.ndarray, np.ndarray]

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.elements.size

    @property
    def width(self) -> int:
        """Numbers that an instant takes while strains are evaluated."""
        return self.n_points

    @property
    def nodes(self) -> np.ndarray:
        """The nodes that the points are at, of ends of elements, shape (n_points,)."""
        return self.body.mesh.cells[self.elements, self.along.astype(int)]

    def of_places(self, frames: np.ndarray) -> np.ndarray:
        """Return the strains of the points, shape (n_points, n_strains, n), for frames of the nodes.

        Frames are (n_nodes, 3, n) in the plane, and in space (n_nodes, 12, n): positions and directors.
        """
        mesh, cells = self.body.mesh, self.body.mesh.cells
        first, second, lengths = frames[cells[:, 0]], frames[cells[:, 1]], mesh.lengths[:, None]
        if not self.body.planar:
            return self._at_points(_in_space(first[:, :12], second[:, :12], lengths, self.body.axes))
        psi = 0.5 * (first[:, 2] + second[:, 2]) + self.body.directions[:, None]
        both = np.moveaxis(np.concatenate([first, second], axis=1), 1, 0)
        stretch, gamma, kappa = strains.py_func(both, np.cos(psi), np.sin(psi), lengths)
        return self._at_points(np.stack([stretch - 1.0, gamma, kappa], axis=1))

    def of_displacements(self, displacements: np.ndarray) -> np.ndarray:
        """Return linear strains, shape (n_points, n_strains, n), for small displacements and rotations in the body's
        frame, shape (n_nodes, 3, n), in space (n_nodes, 6, n)."""
        ends = displacements[self.body.mesh.cells]
        return self._at_points(products(self.body.strain_gradients, ends.reshape(len(ends), -1, ends.shape[-1])))

    def _at_points(self, middles: np.ndarray) -> np.ndarray:
        """Return the strains of the points from those in the middles of all elements, (n_elements, 3 or 6, n)."""
        n_forces, own, (far, before, after) = (2 if self.body.planar else 3), middles[self.elements], self.continued
        rise = middles[after, :n_forces] - middles[before, :n_forces]
        at_points = own[:, :n_forces] + far[:, None, None] * rise
        return np.concatenate([at_points, own[:, n_forces:], own[:, 1:n_forces]], axis=1)

    def forces(self, found: np.ndarray, resists: np.ndarray) -> np.ndarray:
        """Return forces and moments in the sections of the points, (N, Q, M), in space (N, Q_2, Q_3, T, M_2, M_3), from
        strains (n_points, n_strains, n) and the `stiffnesses` of the points."""
        n = resists.shape[1]
        resultants, middle = found[:, :n] * resists, found[:, n:] * resists[:, 1 : 1 + found.shape[1] - n]
        arms = ((self.along - 0.5) * self.body.mesh.lengths[self.elements])[:, None]
        if not self.body.planar:
            resultants[:, 4] += arms * middle[:, 1]  # M_2' = Q_3
            resultants[:, 5] -= arms * middle[:, 0]  # M_3' = -Q_2
        else:
            resultants[:, 2] -= arms * middle[:, 0]  # M' = -Q
        return resultants

    def of_cells(self, values: np.ndarray) -> np.ndarray:
        """Return the values at the points, shape (n_points,), of what is constant in every element."""
        return values[self.elements]

    def stiffnesses(self, values: Values) -> np.ndarray:
        """Return what makes forces and moments of strains at the points, shape (n_points, n_strains, 1 or n)."""
        terms = self.body.sections("stiffness").items()
        return sum(np.multiply.outer(c[self.elements], np.atleast_1d(weight.evaluate(values))) for weight, c in terms)

    @classmethod
    def of(cls, body: Beams, elements: np.ndarray, along: np.ndarray, held: Collection[int] = ()) -> BeamStrains:
        """Take points of elements; `held` are the nodes at which a load or a joint may be."""
        mesh = body.mesh
        before, after = (others[elements] for others in _neighbours(mesh, held))
        # from the middle of the element before to that of the one after, or its own where there is none
        low, high = np.where(before >= 0, before, elements), np.where(after >= 0, after, elements)
        own, apart = mesh.lengths[elements], low != high
        behind = np.where(before >= 0, 0.5 * (own + mesh.lengths[low]), 0.0)
        ahead = np.where(after >= 0, 0.5 * (own + mesh.lengths[high]), 0.0)
        share = np.where(apart, (along - 0.5) * own / np.where(apart, behind + ahead, 1.0), 0.0)
        return cls(body, elements, along, (share, low, high))

    @classmethod
    def at_nodes(cls, body: Beams, held: Collection[int], nodes: np.ndarray) -> BeamStrains:
        """Take the ends of elements that are at some nodes; `held` as for `of`."""
        elements, ends = np.nonzero(np.isin(body.mesh.cells, nodes))
        return cls.of(body, elements, ends.astype(float), held)

    @classmethod
    def in_middles(cls, body: Beams, held: Collection[int]) -> BeamStrains:
        """Take the middles of all elements, whatever is held."""
        n = len(body.mesh.cells)
        elements = np.arange(n)
        return cls(body, elements, np.full(n, 0.5), (np.zeros(n), elements, elements))

    @classmethod
    def at_place(cls, body: Beams, held: Collection[int], place: np.ndarray) -> BeamStrains | None:
        """Take a place on a body, shape (d,), m, in every element that it is in; None where it is in none."""
        mesh = body.mesh
        starts, edges = mesh.nodes[mesh.cells[:, 0]], np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0]
        along = np.clip(np.sum((place - starts) * edges, axis=1) / mesh.lengths**2, 0.0, 1.0)
        away = np.linalg.norm(place - starts - along[:, None] * edges, axis=1)
        near = np.flatnonzero(away <= ON_LINE * float(np.ptp(mesh.nodes, axis=0).max()))
        return cls.of(body, near, along[near], held) if near.size else None


def _neighbours(mesh: LineMesh, held: Collection[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the elements that end where an element begins, and that begin where it ends, in its direction: -1 where
    there is none, or something may jump there; each of shape (n_elements,)."""
    directions = np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0] / mesh.lengths[:, None]
    counts = np.bincount(mesh.cells.ravel(), minlength=mesh.n_nodes)
    ends_at = {int(node): element for element, node in enumerate(mesh.cells[:, 1])}
    before, after = np.full((2, mesh.n_cells), -1)
    for element, node in enumerate(mesh.cells[:, 0]):
        other = ends_at.get(int(node), -1)
        if other >= 0 and counts[node] == 2 and node not in held:
            if directions[element] @ directions[other] > 1.0 - STRAIGHT:
                before[element], after[other] = other, element
    return before, after


def _in_space(first: np.ndarray, second: np.ndarray, lengths: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the strains of elements in space between frames (n_e, 12, n); see `beam3d`."""
    n_e, _, n = first.shape
    one, other = (part[:, 3:].reshape(n_e, 3, 3, n) for part in (first, second))  # directors: (element, k, component)
    turn = np.sum(one[:, :, None] * other[:, None], axis=3)  # R_1^T R_2
    trace = turn[:, 0, 0] + turn[:, 1, 1] + turn[:, 2, 2]
    w = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    c = 0.5 * np.sqrt(1.0 + trace)
    g = np.sum(0.5 * (one + other) * ((second - first)[:, :3] / lengths[:, None])[:, None], axis=2)
    along = np.sum(w * g, axis=1)
    gamma = g / c[:, None] - w * (along / (4.0 * c**3 * (1.0 + c)))[:, None]
    size = np.linalg.norm(w, axis=1)  # sin |Theta|
    small = size < 1e-4  # of |Theta| / sin |Theta| = 1 + s^2 / 6 + 3 s^4 / 40 the next term is below 1e-25
    angle = np.arctan2(size, 0.5 * (trace - 1.0))
    ratio = np.where(small, 1.0 + size**2 / 6.0 + 0.075 * size**4, angle / np.where(small, 1.0, size))
    strained, curved = (products(axes.swapaxes(1, 2), part) for part in (gamma, ratio[:, None] * w))
    strained[:, 0] -= 1.0
    return np.concatenate([strained, curved / lengths[:, None]], axis=1)


@dataclass(frozen=True, eq=False)
class SolidStrains:
    """Points of a mesh at which strains are wanted, each a node or a place as an element sees it."""

    mesh: SolidMesh  # the body's
    cells: np.ndarray  # numbers of the cells that take part, shape (n_c,)
    gradients: np.ndarray  # ``dN_a/dX_j`` at their sampling points, shape (n_c, n_g, d, n_a), 1/m
    #: what makes the strains of the points from those of all sampling points, shape (n_points, n_c n_g)
    weights: sp.csr_matrix
    material: np.ndarray  # number of the material of every point, shape (n_points,)
    nodes: np.ndarray  # nodes that the points are at, shape (n_points,); -1 at places between them

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.material.size

    @property
    def width(self) -> int:
        """Numbers that an instant takes while strains are evaluated."""
        return self.cells.size * self.gradients.shape[1] * 9

    def of_places(self, places: np.ndarray) -> np.ndarray:
        """Return Green and Lagrange's strains, shape (n_points, n_strains, n), for nodes at places (n_nodes, d, n)."""
        d = self.mesh.dimension
        f = self._gradients(places)
        found = [0.5 * (np.sum(f[:, :, i] * f[:, :, j], axis=2) - (i == j)) for i, j in COMPONENTS[d]]
        return self._at_points(np.stack(found, axis=2))

    def of_displacements(self, displacements: np.ndarray) -> np.ndarray:
        """Return linear strains, shape (n_points, n_strains, n), for displacements of the nodes (n_nodes, d, n)."""
        d = self.mesh.dimension
        g = self._gradients(displacements)
        return self._at_points(np.stack([0.5 * (g[:, :, i, j] + g[:, :, j, i]) for i, j in COMPONENTS[d]], axis=2))

    def _gradients(self, vectors: np.ndarray) -> np.ndarray:
        """Return ``dv_i/dX_j`` at all sampling points, shape (n_c, n_g, j, i, n), of vectors at the nodes (n_nodes, d,
        n)."""
        n_c, n_g, d, n_a = self.gradients.shape
        own = vectors[self.mesh.cells[self.cells]].reshape(n_c, n_a, -1)
        return products(self.gradients.reshape(n_c, n_g * d, n_a), own).reshape(n_c, n_g, d, d, -1)

    def _at_points(self, sampled: np.ndarray) -> np.ndarray:
        """Return what points have of strains at sampling points (n_c, n_g, n_strains, n)."""
        n_c, n_g, *shape = sampled.shape
        return (self.weights @ sampled.reshape(n_c * n_g, -1)).reshape(self.n_points, *shape)

    def of_cells(self, values: np.ndarray) -> np.ndarray:
        """Return the means at the points, shape (n_points,), of what is constant in every cell."""
        return self.weights @ np.repeat(values[self.cells], self.gradients.shape[1])

    def within(self, materials: Sequence[np.ndarray], cells: np.ndarray) -> SolidStrains:
        """Return the points whose material is that of some cells, shape (n,)."""
        chosen = np.flatnonzero(np.isin(self.material, _owners(self.mesh, materials)[cells]))
        return replace(self, **{name: getattr(self, name)[chosen] for name in ("weights", "material", "nodes")})

    @classmethod
    def at_nodes(cls, mesh: SolidMesh, materials: Sequence[np.ndarray], nodes: np.ndarray) -> SolidStrains:
        """Take strains at nodes of these numbers, one point for every material, by its cells, that a node is in."""
        owner = _owners(mesh, materials)
        chosen = np.flatnonzero(np.isin(mesh.cells, nodes).any(axis=1))
        of_cells = mesh.cells[chosen]
        row, column = np.nonzero(np.isin(of_cells, nodes))
        keys = np.column_stack([owner[chosen][row], of_cells[row, column]])
        points, place, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        continued = continuation(mesh.kind)
        n_g, place = continued.shape[1], place.reshape(-1)
        entries = continued[column] / count[place][:, None]
        columns = row[:, None] * n_g + np.arange(n_g)
        weights = sp.csr_matrix(
            (entries.ravel(), (np.repeat(place, n_g), columns.ravel())), shape=(len(points), chosen.size * n_g)
        )
        return cls(mesh, chosen, _gradients(mesh, chosen), weights, points[:, 0], points[:, 1])

    @classmethod
    def in_middles(cls, mesh: SolidMesh, materials: Sequence[np.ndarray]) -> SolidStrains:
        """Take the mean strain of the sampling points of every cell, which is that in its middle: of no other cell."""
        cells, gradients = np.arange(mesh.n_cells), _gradients(mesh, np.arange(mesh.n_cells))
        n_g = gradients.shape[1]
        weights = sp.kron(sp.identity(mesh.n_cells), np.full((1, n_g), 1.0 / n_g), format="csr")
        return cls(mesh, cells, gradients, weights, _owners(mesh, materials), np.full(mesh.n_cells, -1))

    @classmethod
    def at_place(cls, mesh: SolidMesh, materials: Sequence[np.ndarray], place: np.ndarray) -> SolidStrains | None:
        """Take the strain at a place of the mesh, shape (d,), m: that of the nodes, interpolated as displacements are.

        None where the place is outside the mesh. On the border of two materials it has the value of one of them.
        """
        found = _locate(mesh, place)
        if found is None:
            return None
        cell, at = found
        owner = _owners(mesh, materials)
        nodal = cls.at_nodes(mesh, materials, mesh.cells[cell])
        chosen = np.flatnonzero(nodal.material == owner[cell])
        order = chosen[[int(np.flatnonzero(nodal.nodes[chosen] == node)[0]) for node in mesh.cells[cell]]]
        weights = sp.csr_matrix(shape_values(mesh.kind, at[None])) @ nodal.weights[order]
        return cls(
            mesh, nodal.cells, nodal.gradients, weights.tocsr(), np.array([owner[cell]]), np.array([-1], dtype=int)
        )


@cache
def sampling_points(kind: str) -> np.ndarray:
    """Return where an element knows its strains best, shape (n_g, d), in reference coordinates."""
    d, linear = reference_element(kind).dimension, kind in ("triangle", "quad", "tetra", "hexahedron")
    simplex = kind.startswith("t")
    if linear:
        return np.full((1, d), 1.0 / (d + 1) if simplex else 0.5)
    if simplex:  # exact for polynomials of second degree, with one point near each corner
        near = {2: 2.0 / 3.0, 3: (5.0 + 3.0 * np.sqrt(5.0)) / 20.0}[d]
        barycentric = np.full((d + 1, d + 1), (1.0 - near) / d) + (near - (1.0 - near) / d) * np.eye(d + 1)
        return barycentric[:, 1:]
    half = 0.5 / np.sqrt(3.0)
    return 0.5 + half * (2.0 * np.indices((2,) * d).reshape(d, -1).T - 1.0)


@cache
def continuation(kind: str) -> np.ndarray:
    """Return what continues values at the sampling points of an element to its nodes, shape (n_a, n_g)."""
    points = sampling_points(kind)
    return _polynomials(kind, reference_element(kind).nodes, len(points)) @ np.linalg.inv(
        _polynomials(kind, points, len(points))
    )


def _polynomials(kind: str, places: np.ndarray, n: int) -> np.ndarray:
    """Return the polynomials that n sampling points decide on, at places (k, d): shape (k, n)."""
    d = places.shape[1]
    if n == 1:
        return np.ones((len(places), 1))
    if kind.startswith("t"):
        return np.column_stack([np.ones(len(places)), places])
    return np.prod(places[:, :, None] ** np.indices((2,) * d).reshape(d, -1), axis=1)


def _gradients(mesh: SolidMesh, cells: np.ndarray) -> np.ndarray:
    """Return ``dN_a/dX_j`` at the sampling points of cells, shape (n_c, n_g, d, n_a)."""
    reference = shape_gradients(mesh.kind, sampling_points(mesh.kind))
    jacobians = np.einsum("gja,cai->cgij", reference, mesh.nodes[mesh.cells[cells]], optimize=True)
    return np.einsum("cgji,gja->cgia", np.linalg.inv(jacobians), reference, optimize=True)


def _owners(mesh: SolidMesh, materials: Sequence[np.ndarray]) -> np.ndarray:
    """Return the number of every cell's material, shape (n_cells,)."""
    owner = np.zeros(mesh.n_cells, dtype=int)
    for number, cells in enumerate(materials):
        owner[cells] = number
    return owner


def _locate(mesh: SolidMesh, place: np.ndarray) -> tuple[int, np.ndarray] | None:
    """Return a cell that holds a place, and where that is in the reference cell, shape (d,); None outside the mesh."""
    corners = mesh.nodes[mesh.cells]
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = 0.1 * (high - low).max(axis=1, keepdims=True)  # cells with curved edges bulge beyond their nodes
    for cell in np.flatnonzero(((place >= low - margin) & (place <= high + margin)).all(axis=1)):
        at = _reference_place(mesh.kind, corners[cell], place)
        if at is not None:
            return int(cell), at
    return None


def _reference_place(kind: str, nodes: np.ndarray, place: np.ndarray) -> np.ndarray | None:
    """Return where a place is in the reference cell, shape (d,); None where it is outside."""
    simplex, d = kind.startswith("t"), place.size
    size = float(np.ptp(nodes, axis=0).max())
    at = np.full(d, 1.0 / (d + 1) if simplex else 0.5)
    for _ in range(ROUNDS):
        away = place - shape_values(kind, at[None])[0] @ nodes
        if np.abs(away).max() <= CLOSE * size:
            inside = at.min() >= -INSIDE and (at.sum() if simplex else at.max()) <= 1.0 + INSIDE
            return at if inside else None
        jacobian = (shape_gradients(kind, at[None])[0] @ nodes).T
        at = np.clip(at + np.linalg.lstsq(jacobian, away, rcond=None)[0], -1.0, 2.0)
    return None
