"""A flexible body in a floating frame: small deformation in a frame that makes large motions, inertia exact.

A point X of the body is at ``r = p + sum_k d_k w_k`` with the frame's position p and directors d_k, of a body that
follows its foreshortening (`components.component_modes`) with the last term too,

    w_k = X_k + Psi_k(X) xi + 1/2 xi^T chi_k(X) xi

(docs/components.md, equations; foreshortening). All that inertia does follows from the moments ``int rho f_a f_b dV``
of the scalar fields ``f = (1, X_1 .. X_d, Psi_1 .. Psi_d)`` (Zwoelfer and Gerstmayr, Multibody Syst. Dyn. 2020), and
``int rho X_k chi_l dV``, without what is of third order in xi. Psi and chi are M-orthogonal to the rigid motions.

`Recovery` leads back from few coordinates to the mesh that the body was condensed from, by `products` of matrices of
which a column has the same bits whatever the others are: a sample's stress depends neither on the batch that it is in
nor on the number of ranks. A library's products choose their order of summation by the number of columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from pgmp_petsc.bodies.affine import ByWeight, Monomial, total_at
from pgmp_petsc.bodies.profile import Profiles
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import LANES, aligned_zeros, load, spread, store
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.scene import Scene


class Beams(Protocol):
    """A body of flexible beams, as strains and stresses see it; see `kinds.beam`."""

    name: str
    mesh: LineMesh
    axes: np.ndarray | None
    profiles: Profiles
    planar: bool
    dimension: int
    directions: np.ndarray
    strain_gradients: np.ndarray
    extent: float

    def sections(self, kind: str) -> dict[Monomial, np.ndarray]: ...

    def stresses(self, scene: Scene) -> Any: ...


@dataclass(frozen=True, eq=False)
class Recovery:
    """The displacements that a condensed body's coordinates describe."""

    carrier: SolidMesh | Beams  # the mesh of continuum elements, or the body of beams, as it was before
    #: displacements (of beams and rotations) of the nodes in the body's frame for a unit of each coordinate, node after
    #: node, shape (n_mesh_dofs, n)
    shapes: np.ndarray
    #: whether the shapes hold the body's static answers to its own inertia forces, as stress outputs ask for
    answered: bool = True
    #: of pairs i >= j of coordinates those whose linear strains stand for ``E''_ij = sym(grad u_i^T grad u_j)``:
    #: against all fields T of the shapes they balance these, ``T^T K T curved_ij = int E''_ij : C : E'[T] dV``. Strains
    #: of second order are those of a motion's curvature and of these together; what T has not of them the body relieves
    #: itself. Shape (n (n + 1) / 2, n); None where terms of second order in the body are not known
    curved: np.ndarray | None = None

    @property
    def mesh(self) -> SolidMesh | LineMesh:
        """The mesh of the carrier."""
        return self.carrier if isinstance(self.carrier, SolidMesh) else self.carrier.mesh

    @property
    def by_node(self) -> np.ndarray:
        """The shapes as (n_nodes, n_of_a_node, n)."""
        return self.shapes.reshape(self.mesh.n_nodes, -1, self.shapes.shape[1])


def products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the products of matrices (n, m, k) and (n, k, n_columns), shape (n, m, n_columns): of each column the same
    bits, whichever are beside it."""
    (n, m, k), n_columns = left.shape, right.shape[2]
    n_vectors = -(-n_columns // LANES)
    columns, result = aligned_zeros((n * k, n_vectors * LANES)), aligned_zeros((n * m, n_vectors * LANES))
    columns[:, :n_columns] = right.reshape(n * k, n_columns)
    of_vectors = (each.reshape(-1, LANES) for each in (columns, result))
    _fill_products(np.ascontiguousarray(left), *of_vectors, n_vectors)
    return np.ascontiguousarray(result[:, :n_columns]).reshape(n, m, n_columns)


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_products(left, columns, result, n_vectors):
    """Fill rows of all products, of LANES columns a vector; sums of four of them stay in registers."""
    n, m, k = left.shape
    for e in range(n):
        for v in range(n_vectors):
            for i in range(0, m, 4):
                a, b, c, d = i, min(i + 1, m - 1), min(i + 2, m - 1), min(i + 3, m - 1)
                of_a, of_b, of_c, of_d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
                for term in range(k):
                    x = load(columns, (e * k + term) * n_vectors + v)
                    of_a = of_a + x * left[e, a, term]
                    of_b = of_b + x * left[e, b, term]
                    of_c = of_c + x * left[e, c, term]
                    of_d = of_d + x * left[e, d, term]
                store(result, (e * m + a) * n_vectors + v, of_a)
                store(result, (e * m + b) * n_vectors + v, of_b)
                store(result, (e * m + c) * n_vectors + v, of_c)
                store(result, (e * m + d) * n_vectors + v, of_d)


NOISE = 1e-10  # share of both fields' own moments or stiffness that round-off leaves of fields that are apart
HEAVY = 1e-3  # of the mass of the heaviest term: lighter ones say nothing of a body's extent


@dataclass(frozen=True, eq=False)
class FloatingBody:
    """A flexible body in its floating frame."""

    frames: dict[str, int]  # name and number (from 0) of every frame that joints, effects and outputs hold
    centres: np.ndarray  # of the frames in the body's frame, shape (n_frames, d), m
    #: displacement and small rotation of every frame for a unit of each amplitude, shape (n_frames, 3, n), in space
    #: (n_frames, 6, n)
    shapes: np.ndarray
    #: ``int rho f_a f_b dV`` by weight, shape (1 + d + d n, 1 + d + d n): of 1, of the coordinates, of Psi_1, of Psi_2
    #: ..
    moments: dict[Monomial, np.ndarray]
    stiffness: dict[Monomial, np.ndarray]  # of the amplitudes, by weight, shape (n, n)
    #: second derivatives of the frames' displacements in the amplitudes, shape (n_frames, d, n, n), 1/m; zero where the
    #: body does not follow its foreshortening
    bent: np.ndarray
    curved: dict[Monomial, np.ndarray]  # ``int rho X_k chi_l dV`` by weight, shape (d, d, n, n); empty likewise
    #: the fields on the mesh, of condensed bodies as far as these have them: from the body's own and from `parts`
    recovery: Recovery | None = field(default=None, compare=False)
    #: small displacement and rotation of the frame, and amplitudes, that a unit of every unknown of the condensed body
    #: is, shape (n_rigid + n, n_rigid + n); None of a body of beams
    parts: np.ndarray | None = None

    @property
    def n(self) -> int:
        """Number of amplitudes."""
        return self.shapes.shape[2]

    @property
    def extent(self) -> float:
        """Largest extent of the frames along an axis of the body's frame, m; with one frame that of the straight bar
        with the body's largest radius of gyration."""
        between, d = float(np.max(np.ptp(self.centres, axis=0))), self.centres.shape[1]
        if between > 0.0:
            return between
        return bar_length([moments[: 1 + d, : 1 + d] for moments in self.moments.values()])

    def modal(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return the mass (kg) and the stiffness (N/m) of every amplitude by itself, each of shape (n,)."""
        moments, stiffness = (total_at(terms, values) for terms in (self.moments, self.stiffness))
        both = second_moments(moments, self.centres.shape[1])[2]
        return np.einsum("kkii->i", both), np.diagonal(stiffness)


def bar_length(terms: Sequence[np.ndarray]) -> float:
    """Return the length of the straight bar that has a body's largest radius of gyration along an axis of its frame, m,
    from the moments of 1 and the coordinates of each term of its mass, (1 + d, 1 + d)."""
    heaviest = max(moments[0, 0] for moments in terms)
    # lighter ones turn with sections alone, or are what a random field adds
    heavy = [moments / moments[0, 0] for moments in terms if not moments[0, 0] < HEAVY * heaviest]
    return float(np.sqrt(12.0 * max(np.max(np.diag(one)[1:] - one[0, 1:] ** 2) for one in heavy)))


def without_noise(
    moments: ByWeight, stiffness: ByWeight, nominal: Mapping[str, float], d: int
) -> tuple[ByWeight, ByWeight]:
    """Return moments and stiffness with zeros for what is round-off at nominal parameters, as between fields that bend
    a straight body in two planes. Terms that are 0 there, as those of random fields, stay as they are."""
    weights = {weight: float(weight.evaluate(nominal)) for weight in {*moments, *stiffness}}
    whole = total_at(moments, nominal)
    own = np.sqrt(np.einsum("kkii->i", second_moments(whole, d)[2]))
    place = np.sqrt(np.trace(whole[1 : 1 + d, 1 : 1 + d]))
    of_fields = np.concatenate([[np.sqrt(whole[0, 0])], np.full(d, place), np.tile(own, d)])
    stiff = np.sqrt(np.diag(total_at(stiffness, nominal)))
    return tuple(
        {
            w: np.where(np.abs(weights[w] * part) > NOISE * np.outer(size, size), part, 0.0) if weights[w] else part
            for w, part in terms.items()
        }
        for terms, size in ((moments, of_fields), (stiffness, stiff))
    )


def first_moments(moments: np.ndarray, d: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mass and ``int rho X`` (1 + d, ...), and ``int rho Psi`` (d, n, ...), of moments (r, r, ...)."""
    n = (len(moments) - 1 - d) // d
    return moments[0, : 1 + d], moments[0, 1 + d :].reshape(d, n, *moments.shape[2:])


def second_moments(moments: np.ndarray, d: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``int rho X_k X_l`` (d, d, ...), ``int rho X_k Psi_l`` (d, d, n, ...) and ``int rho Psi_k Psi_l``
    (d, d, n, n, ...) of moments (r, r, ...)."""
    n, trailing = (len(moments) - 1 - d) // d, moments.shape[2:]
    of_places, mixed, of_fields = moments[1 : 1 + d, 1 : 1 + d], moments[1 : 1 + d, 1 + d :], moments[1 + d :, 1 + d :]
    both = of_fields.reshape(d, n, d, n, *trailing)
    return of_places, mixed.reshape(d, d, n, *trailing), np.moveaxis(both, 2, 1)
