"""Terms of second order in the deformation of a body of continuum elements, for a few displacement fields.

The strain energy of `elasticity` has at rest, for fields u, v, w of a body, with E' = sym grad u and E''[u, v] =
sym(grad u^T grad v) the third derivative

    W3[u, v, w] = int E''[u, v] : C : E'[w] + E''[v, w] : C : E'[u] + E''[w, u] : C : E'[v] dV;

in a subspace that answers loads statically (`Component`) it is all of third order (docs/method.md, bodies of cells).

*Stretching* tells fields that stretch a slender body from those that bend or twist it. The body is cut across its long
principal axis t into pieces of the volume V_s; with the mean strain e_s along t of each, the energy
``1/2 sum_s E V_s e_s^2`` is at most the strain energy, all of it where the body is stretched, and none where it bends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.elasticity import Geometry, Lame, volumes_of
from pgmp_petsc.bodies.solid import Region, Solid
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mesh.solid_mesh import reference_element

NUMBERS_AT_ONCE = 4_000_000  # of products of pairs of fields at quadrature points: 32 MB
SLENDER = 3.0  # longest over second extent of a body that has a long axis


@dataclass(frozen=True, eq=False)
class LargeDeformation:
    """Terms of n displacement fields of a body, by weight; what remains when the weight is taken out."""

    third: dict[Monomial, np.ndarray]  # W3, symmetric, shape (n, n, n)
    stretching: dict[Monomial, np.ndarray]  # stiffness against the mean strains of pieces, shape (n, n)
    #: longest over second extent of the body along its principal axes: below `SLENDER` stretching means nothing
    slenderness: float

    @property
    def slender(self) -> bool:
        """Whether the body has a long axis."""
        return self.slenderness >= SLENDER


class LongAxis:
    """The long principal axis of a mesh, and pieces across it as long as the body's smallest extent."""

    def __init__(self, solid: Solid) -> None:
        mesh = solid.mesh
        volumes = volumes_of(mesh.nodes[mesh.cells], reference_element(mesh.kind).stiffness).sum(axis=1)
        middles = mesh.nodes[mesh.cells].mean(axis=1)
        centre = volumes @ middles / volumes.sum()
        about = (middles - centre).T @ ((middles - centre) * volumes[:, None])
        axes = np.linalg.eigh(about)[1]
        extents = np.sort(np.ptp(mesh.nodes @ axes, axis=0))
        self.direction = axes[:, -1]
        self.slenderness = float(extents[-1] / extents[-2])
        self.n_pieces = max(1, int(extents[-1] / extents[0] + 1e-9))
        self._lowest, self._length = float(np.min(mesh.nodes @ self.direction)), float(extents[-1])

    @property
    def is_long(self) -> bool:
        """Whether the body has a long axis to be stretched along."""
        return self.slenderness >= SLENDER

    def pieces(self, points: np.ndarray) -> np.ndarray:
        """Return the number of the piece that each of the points (..., d) is in."""
        along = (points @ self.direction - self._lowest) / self._length
        return np.clip((self.n_pieces * along).astype(int), 0, self.n_pieces - 1)


class FieldsOnCells:
    """Displacement fields on some cells of a body, by their numbers, and their sums over these cells.

    The body's cross-section is not scaled. `places` says where the nodes of each cell are in `fields`, shape (n_cells,
    n_cell_nodes): displacements of the nodes for a unit of every field, shape (n_nodes, d, n).
    """

    def __init__(self, solid: Solid, cells: np.ndarray, places: np.ndarray, fields: np.ndarray) -> None:
        self._solid, self._fields = solid, fields
        self._row = np.full(solid.mesh.n_cells, -1)
        self._row[cells] = np.arange(cells.size)
        self._places = places

    def of_pairs(self) -> dict[Monomial, np.ndarray]:
        """Return ``int E''[u_i, u_j] : C : E'[u_k] dV`` by weight, pairs i >= j packed, shape (n (n + 1) / 2, n)."""
        d, n = self._fields.shape[1:]
        axes, n_pairs = np.tril_indices(d), n * (n + 1) // 2
        found: dict[Monomial, np.ndarray] = {}
        for region, cells, geometry, gradients, _ in self._shares(axes[0].size * n_pairs):
            strains = np.empty((geometry.volumes.size, axes[0].size, n_pairs))
            _fill_strains(np.ascontiguousarray(gradients), strains)
            stresses = _on_pairs(_stresses(region, gradients), axes, geometry.volumes.ravel())
            by_cell = {region.modulus.monomial: region.modulus.coefficient * stresses.reshape(cells.size, -1, n)}
            for weight, own in self._solid.profiles.stiffness.over(by_cell, cells).items():
                part = strains.reshape(-1, n_pairs).T @ own.reshape(-1, n)
                found[weight] = found.get(weight, 0.0) + part
        return found

    def third_with(self, vectors: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Return ``W3[., v_i, v_j]`` of the fields ``v = sum_a vectors[a] u_a`` at parameter values.

        Vectors have shape (n, m), the result (n, m, m). Of few vectors it takes a small part of the time of `third`.
        """
        d, n = self._fields.shape[1:]
        m = vectors.shape[1]
        axes, n_pairs = np.tril_indices(d), m * (m + 1) // 2
        packed, mixed = np.zeros((n_pairs, n)), np.zeros((n, m, m))
        for region, cells, geometry, gradients, _ in self._shares(d * d * (n + m * m)):
            by_cell = {region.modulus.monomial: region.modulus.coefficient * geometry.volumes}
            parts = self._solid.profiles.stiffness.over(by_cell, cells)
            weight = sum(float(monomial.evaluate(values)) * part for monomial, part in parts.items()).ravel()
            own = gradients @ vectors
            strains = np.empty((weight.size, axes[0].size, n_pairs))
            _fill_strains(np.ascontiguousarray(own), strains)
            # E''[v_i, v_j] : C : E'[u]
            packed += strains.reshape(-1, n_pairs).T @ _on_pairs(_stresses(region, gradients), axes, weight)
            # E''[u, v_i] : C : E'[v_j], with the symmetric stress of v_j
            weighted = (weight[:, None, None, None] * own).swapaxes(2, 3)
            moved = weighted[:, :, None] @ _stresses(region, own)[:, None]
            mixed += (gradients.reshape(-1, n).T @ moved.reshape(-1, m * m)).reshape(n, m, m)
        i, j = np.tril_indices(m)
        mixed = mixed + mixed.swapaxes(1, 2)
        mixed[:, i, j] += packed.T
        mixed[:, j, i] = mixed[:, i, j]
        return mixed

    def mean_strains(self, axis: LongAxis) -> tuple[np.ndarray, dict[Monomial, np.ndarray]]:
        """Return the integrals of the strains along the axis over every piece, shape (n_pieces, 1 + n), the volume
        first, and of Young's modulus by weight, shape (n_pieces,)."""
        d, n = self._fields.shape[1:]
        twice = np.outer(axis.direction, axis.direction).ravel()
        strains: np.ndarray = np.zeros((axis.n_pieces, 1 + n))
        moduli: dict[Monomial, np.ndarray] = {}
        for region, cells, geometry, gradients, points in self._shares(d * d * n):
            volumes, pieces = geometry.volumes.ravel(), axis.pieces(points)
            along = twice @ gradients.reshape(-1, d * d, n)
            gathered = csr_matrix((volumes, pieces, np.arange(volumes.size + 1)), (volumes.size, axis.n_pieces)).T
            strains += gathered @ np.column_stack([np.ones(volumes.size), along])
            by_cell = {region.modulus.monomial: region.modulus.coefficient * geometry.volumes}
            for weight, own in self._solid.profiles.stiffness.over(by_cell, cells).items():
                part = np.bincount(pieces, own.ravel(), axis.n_pieces)
                moduli[weight] = moduli.get(weight, 0.0) + part
        return strains, moduli

    def _shares(self, numbers: int) -> Iterator[tuple[Region, np.ndarray, Geometry, np.ndarray, np.ndarray]]:
        """Yield shares of cells of one region, so that `numbers` for each quadrature point stay in bounds: numbers,
        geometry, ``du_k/dX_l`` of every field at all quadrature points, shape (n_points, d, d, n), and the points."""
        mesh, rule = self._solid.mesh, reference_element(self._solid.mesh.kind).stiffness
        d, n = self._fields.shape[1:]
        for region, chosen in self._chosen(rule.weights.size * numbers):
            places = mesh.nodes[mesh.cells[chosen]]
            geometry, own = Geometry.of(places, rule), self._fields[self._places[self._row[chosen]]]
            gradients = geometry.gradients @ own.reshape(chosen.size, 1, -1, d * n)
            gradients = np.ascontiguousarray(gradients.reshape(-1, d, d, n).swapaxes(1, 2))
            yield region, chosen, geometry, gradients, np.einsum("qa,eai->eqi", rule.values, places).reshape(-1, d)

    def _chosen(self, numbers: int) -> Iterator[tuple[Region, np.ndarray]]:
        """Yield regions and shares of their cells, so that `numbers` a cell stay in bounds."""
        step = max(1, NUMBERS_AT_ONCE // numbers)
        for region in self._solid.regions:
            own = region.cells[self._row[region.cells] >= 0]
            for first in range(0, own.size, step):
                yield region, own[first : first + step]


def _stresses(region: Region, gradients: np.ndarray) -> np.ndarray:
    """Return the stresses over Young's modulus of displacements with gradients (n_points, d, d, n), of that shape."""
    d = gradients.shape[1]
    lame = Lame.of(region.nu, d == 2)
    stresses = lame.shear * (gradients + gradients.swapaxes(1, 2))
    stresses[:, np.arange(d), np.arange(d)] += lame.first * np.trace(gradients, axis1=1, axis2=2)[:, None]
    return stresses


def _on_pairs(stresses: np.ndarray, axes: tuple[np.ndarray, np.ndarray], weight: np.ndarray) -> np.ndarray:
    """Return weighted stresses on pairs of axes, shape (n_points n_axes, n): off the diagonal both orders of them."""
    twice = np.where(axes[0] == axes[1], 1.0, 2.0)[:, None]
    return (stresses[:, axes[0], axes[1]] * twice * weight[:, None, None]).reshape(-1, stresses.shape[3])


@njit(cache=True, error_model="numpy")
def _fill_strains(gradients, strains):
    """Fill ``E''_kl = sum_c sym(du_c/dX_k dv_c/dX_l)`` of pairs of fields, shape (n_points, d (d + 1) / 2, n (n + 1) /
    2), axes k >= l and fields u >= v packed, from ``du_c/dX_k`` at points, shape (n_points, d, d, n)."""
    n_points, d, _, n = gradients.shape
    for p in range(n_points):
        pair = 0
        for k in range(d):
            for l in range(k + 1):
                at = 0
                for u in range(n):
                    for v in range(u + 1):
                        strains[p, pair, at + v] = 0.0
                    for c in range(d):
                        one, other = 0.5 * gradients[p, c, k, u], 0.5 * gradients[p, c, l, u]
                        for v in range(u + 1):
                            strains[p, pair, at + v] += one * gradients[p, c, l, v] + other * gradients[p, c, k, v]
                    at += u + 1
                pair += 1


def cyclic(packed: np.ndarray, n: int) -> np.ndarray:
    """Return the sum of ``G[ij, k]``, packed over i >= j, over the three places of k, symmetric to the last bit."""
    i, j = np.tril_indices(n)
    whole = np.empty((n, n, n))
    whole[i, j] = whole[j, i] = packed
    a, b, c = np.sort(np.indices((n, n, n)), axis=0)
    return whole[a, b, c] + whole[b, c, a] + whole[a, c, b]
