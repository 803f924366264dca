"""Terms of second order in the deformation of a condensed body, on the ranks that share its mesh.

The strain energy of `elasticity` has at rest, for fields u, v, w of a body, with E' = sym grad u and E''[u, v] =
sym(grad u^T grad v) the third derivative

    W3[u, v, w] = int E''[u, v] : C : E'[w] + E''[v, w] : C : E'[u] + E''[w, u] : C : E'[v] dV;

in a subspace that answers loads statically (`Component`) it is all of third order (docs/method.md, bodies of cells).

*Stretching* tells fields that stretch a slender body from those that bend or twist it. The body is cut across its long
principal axis t into pieces of the volume V_s; with the mean strain e_s along t of each, the energy
``1/2 sum_s E V_s e_s^2`` is at most the strain energy, all of it where the body is stretched, and none where it bends.

Foreshortening: the displacements of second order of a slender body that bends or twists.

A body that bends becomes shorter, and follows that at once (docs/components.md, foreshortening): amplitudes xi
represent displacements ``Psi (xi + 1/2 xi^T c xi)``, and

    c_ij = -S K^-1 W3[B e_i, B e_j, .],    S = s^2 (3 - 2 s),    s = K^-1 K_s,    B = 1 - S,

with the stiffness K, the part K_s of it that resists stretching, and the third derivative W3 of the strain energy at
rest. Left to the amplitudes that stretch the body, shortening would stiffen the bending, and take these amplitudes with
all their inertia and a cubic strain energy that has no lower bound.

It is the same for beams, whose W3 follows from strains (`bodies.matrices`), and for bodies of cells. The fields answer
forces at frames and inertia forces of rigid motion statically, so that these do all of their work on c.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import ConvexHull

from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.affine import Monomial, total_at
from pgmp_petsc.bodies.assembled import AssembledBody
from pgmp_petsc.bodies.component import SLENDER, Component, LargeDeformation
from pgmp_petsc.bodies.elasticity import Geometry, Lame, volumes_of
from pgmp_petsc.bodies.solid import Region, Solid
from pgmp_petsc.components.component_modes import elastic_modes, own_nodes
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mesh.meshes import reference_element

NUMBERS_AT_ONCE = 4_000_000  # of products of pairs of fields at quadrature points: 32 MB

Contraction = Callable[[np.ndarray], np.ndarray]


def contraction_of(third: np.ndarray) -> Contraction:
    """Return what makes ``W3[., V e_i, V e_j]``, (n, m, m), of vectors V (n, m), from W3, symmetric, (n, n, n)."""
    return lambda vectors: np.einsum("kab,ai,bj->kij", third, vectors, vectors, optimize=True)


def foreshortening(third: Contraction, stiffness: np.ndarray, stretching: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Return c of some fields, amplitudes of shape (n, m), the second derivatives of all amplitudes, shape (n, m, m),
    1/m, the amplitude that is moved first.

    `third` is W3 of the amplitudes times pairs of vectors (see `contraction_of`), N/m2; K, positive definite, and K_s
    have shape (n, n), N/m.
    """
    n, m = fields.shape
    share = np.linalg.solve(stiffness, stretching)
    stretched = share @ share @ (3.0 * np.eye(n) - 2.0 * share)
    forces = third(fields - stretched @ fields).reshape(n, m * m)
    found = -(stretched @ np.linalg.solve(stiffness, forces)).reshape(n, m, m)
    return 0.5 * (found + found.swapaxes(1, 2))


def with_second_order(
    component: Component,
    solid: Solid | AssembledBody,
    recovery: np.ndarray,
    comm: Comm,
    nominal: Mapping[str, float],
    n_followed: int | None = None,
    all_fields: bool = True,
) -> Component:
    """Return a condensed body with its foreshortening, and with what is of second order in all of its fields, which
    takes longest, where that is wanted. Collective on `comm`.

    Nothing of it is known where the cross-section is scaled or matrices were assembled elsewhere, and no foreshortening
    of a body that is not slender. The fields are this rank's rows, shape (n_local, n); see `condense`. The
    foreshortening is that at nominal parameter values, of the slowest `n_followed` free modes; None for all.
    """
    if not solid.third_derivative_known:
        return component
    fields = FieldsOnRanks(solid, recovery, comm)
    stretching, slenderness = fields.stretching(), fields.axis.slenderness
    third, modes = partial(fields.third_with, values=nominal), elastic_modes(component, nominal)
    stiffness, resisting = (modes.T @ total_at(terms, nominal) @ modes for terms in (component.stiffness, stretching))
    if all_fields:
        of_pairs = fields.of_pairs()
        whole = {weight: cyclic(part, recovery.shape[1]) for weight, part in of_pairs.items()}
        large = LargeDeformation(whole, stretching, slenderness)
        third = contraction_of(total_at(whole, nominal))
        forces = total_at(of_pairs, nominal) @ modes
        curved = np.linalg.solve(stiffness, forces.T).T @ modes.T
        kept = component.recovery and replace(component.recovery, curved=curved)
        component = replace(component, large=large, recovery=kept)
    if not fields.axis.is_long:
        return component
    n, m = len(stiffness), len(stiffness) if n_followed is None else min(n_followed, len(stiffness))
    curvature = np.zeros((n, n, n))
    curvature[:, :m, :m] = foreshortening(
        lambda vectors: np.tensordot(modes.T, third(modes @ vectors), 1), stiffness, resisting, np.eye(n)[:, :m]
    )
    return replace(component, foreshortening=curvature)


class LongAxis:
    """The long principal axis of a mesh, and pieces across it as long as the body's smallest extent.

    That is the least width across the axis, which is between two parallels of which one lies on an edge of the convex
    hull: of a square bar the axes across are any, and round-off would choose between its width and its diagonal.
    """

    def __init__(self, solid: Solid) -> None:
        mesh = solid.mesh
        volumes = volumes_of(mesh.nodes[mesh.cells], reference_element(mesh.kind).stiffness).sum(axis=1)
        middles = mesh.nodes[mesh.cells].mean(axis=1)
        centre = volumes @ middles / volumes.sum()
        about = (middles - centre).T @ ((middles - centre) * volumes[:, None])
        axes = np.linalg.eigh(about)[1]
        along, across = mesh.nodes @ axes[:, -1], mesh.nodes @ axes[:, :-1]
        if across.shape[1] == 2:
            hull = ConvexHull(across)
            ways = hull.equations[:, :2].T  # normals of its edges
            narrowest = ways[:, np.argmin(np.ptp(across[hull.vertices] @ ways, axis=0))]
            across = across @ np.column_stack([narrowest, [-narrowest[1], narrowest[0]]])
        self.direction, self._lowest, self._length = axes[:, -1], float(along.min()), float(np.ptp(along))
        extents = np.ptp(across, axis=0)
        self.slenderness = float(self._length / extents.max())
        self.n_pieces = max(1, int(self._length / extents.min() + 1e-9))

    @property
    def is_long(self) -> bool:
        """Whether the body has a long axis to be stretched along."""
        return self.slenderness >= SLENDER

    def pieces(self, points: np.ndarray) -> np.ndarray:
        """Return the number of the piece that each of the points (..., d) is in."""
        along = (points @ self.direction - self._lowest) / self._length
        return np.clip((self.n_pieces * along).astype(int), 0, self.n_pieces - 1)


class FieldsOnRanks:
    """The displacement fields of a condensed body on the ranks that share its mesh; methods are collective.

    The body's cross-section is not scaled; the fields are at this rank's nodes, shape (d n_nodes, n), and the axis is
    the long one.
    """

    def __init__(self, solid: Solid, recovery: np.ndarray, comm: Comm) -> None:
        mesh, nodes = solid.mesh, own_nodes(solid.mesh.n_nodes, comm)
        # every cell is evaluated once, by the rank that has its first node
        own = np.flatnonzero((mesh.cells[:, 0] >= nodes.start) & (mesh.cells[:, 0] < nodes.stop))
        wanted = np.unique(mesh.cells[own])
        self._solid, self._comm, self.axis = solid, comm, LongAxis(solid)
        self._row = np.full(mesh.n_cells, -1)  # of a cell among those that this rank evaluates
        self._row[own] = np.arange(own.size)
        # displacements of nodes for a unit of every field, (n_wanted, d, n), and where each cell's are among them
        self._fields = _fetched(wanted, nodes, recovery.reshape(len(nodes), mesh.dimension, -1), comm)
        self._places = np.searchsorted(wanted, mesh.cells[own])

    def of_pairs(self) -> dict[Monomial, np.ndarray]:
        """Return ``int E''[u_i, u_j] : C : E'[u_k] dV`` by weight, pairs i >= j packed, shape (n (n + 1) / 2, n), of
        which W3 is the cyclic sum."""
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
        return _summed(found, self._comm)

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
        return _total(mixed, self._comm)

    def stretching(self) -> dict[Monomial, np.ndarray]:
        """Return the stiffness against the mean strains of pieces by weight, shape (n, n)."""
        (d, n), axis = self._fields.shape[1:], self.axis
        twice = np.outer(axis.direction, axis.direction).ravel()
        strains = np.zeros((axis.n_pieces, 1 + n))  # over every piece, its volume first
        moduli: dict[Monomial, np.ndarray] = {}
        for region, cells, geometry, gradients, points in self._shares(d * d * n):
            volumes, pieces = geometry.volumes.ravel(), axis.pieces(points)
            along = twice @ gradients.reshape(-1, d * d, n)
            gathered = csr_matrix((volumes, pieces, np.arange(volumes.size + 1)), (volumes.size, axis.n_pieces)).T
            strains += gathered @ np.column_stack([np.ones(volumes.size), along])
            by_cell = {region.modulus.monomial: region.modulus.coefficient * geometry.volumes}
            for weight, own in self._solid.profiles.stiffness.over(by_cell, cells).items():
                moduli[weight] = moduli.get(weight, 0.0) + np.bincount(pieces, own.ravel(), axis.n_pieces)
        strains, moduli = _total(strains, self._comm), _summed(moduli, self._comm)
        means = strains[:, 1:] / np.where(strains[:, 0] > 0.0, strains[:, 0], 1.0)[:, None]
        return {weight: means.T @ (modulus[:, None] * means) for weight, modulus in moduli.items()}

    def _shares(self, numbers: int) -> Iterator[tuple[Region, np.ndarray, Geometry, np.ndarray, np.ndarray]]:
        """Yield shares of cells of one region, so that `numbers` for each quadrature point stay in bounds: numbers,
        geometry, ``du_k/dX_l`` of every field at all quadrature points, shape (n_points, d, d, n), and the points."""
        mesh, rule = self._solid.mesh, reference_element(self._solid.mesh.kind).stiffness
        d, n = self._fields.shape[1:]
        step = max(1, NUMBERS_AT_ONCE // (rule.weights.size * numbers))
        for region in self._solid.regions:
            mine = region.cells[self._row[region.cells] >= 0]
            for chosen in (mine[first : first + step] for first in range(0, mine.size, step)):
                places = mesh.nodes[mesh.cells[chosen]]
                geometry, own = Geometry.of(places, rule), self._fields[self._places[self._row[chosen]]]
                gradients = geometry.gradients @ own.reshape(chosen.size, 1, -1, d * n)
                gradients = np.ascontiguousarray(gradients.reshape(-1, d, d, n).swapaxes(1, 2))
                points = np.einsum("qa,eai->eqi", rule.values, places).reshape(-1, d)
                yield region, chosen, geometry, gradients, points


def _fetched(wanted: np.ndarray, nodes: range, own: np.ndarray, comm: Comm) -> np.ndarray:
    """Return the rows of wanted nodes (sorted) from the ranks that have them, rows (n_own, ...) of each."""
    firsts = np.array(comm.allgather(nodes.start))
    owner = np.searchsorted(firsts, wanted, side="right") - 1
    # ranks without nodes start where the next one does: the last of them has the node
    asked = comm.alltoall([wanted[owner == rank] for rank in range(comm.size)])
    given = comm.alltoall([own[numbers - nodes.start] for numbers in asked])
    result = np.empty((wanted.size, *own.shape[1:]))
    for rank, rows in enumerate(given):
        result[owner == rank] = rows
    return result


def _summed(terms: dict[Monomial, np.ndarray], comm: Comm) -> dict[Monomial, np.ndarray]:
    """Return terms summed over the ranks, some of which may not have all of them."""
    shapes = {}
    for own in comm.allgather({weight: part.shape for weight, part in terms.items()}):
        shapes |= own
    return {weight: _total(terms.get(weight, np.zeros(shape)), comm) for weight, shape in sorted(shapes.items())}


def _total(part: np.ndarray, comm: Comm) -> np.ndarray:
    part = np.ascontiguousarray(part)
    total = np.empty_like(part)
    comm.Allreduce(part, total)
    return total


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
