"""A continuum body: its mesh, its materials, and its affine matrices in its own frame.

The unknowns are the displacements (or positions) of the nodes, ``d n_nodes`` of them. Young's modulus, density and, in
plane stress, the thickness are factors of the elements' matrices, so that

    K = sum_regions  E t K_region,    M = sum_regions  rho t M_region

is affine in them, and the weights of terms are their products (`Quantity`); so it is in powers of a scale of the
cross-section (`SectionScale`), and in what multiplies them cell by cell (`Profile`).

A joint or an effect holds a continuum body by the frame of a group of faces (`FaceFrame`), which has their mean
position and mean rotation (docs/solids.md, meshes and groups).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.units import UnitSystem
from pgmp_petsc.bodies import elasticity
from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.elasticity import Geometry, Lame
from pgmp_petsc.bodies.profile import UNIFORM, Profile, Profiles, SectionScale
from pgmp_petsc.mesh.meshes import SolidMesh, reference_element

Part = tuple[Quantity, Callable[[np.ndarray], np.ndarray]]  # a factor, and element matrices from the places of nodes

ENTRIES_AT_ONCE = 2_000_000  # of element matrices: 16 MB, which stays near the processor and bounds the memory


@dataclass(frozen=True)
class Region:
    """Cells of one material."""

    cells: np.ndarray  # numbers of the cells, shape (n,)
    #: modulus, density: Young's modulus (Pa) and density (kg/m3); in plane stress times the thickness (N/m, kg/m2)
    modulus: Quantity
    density: Quantity
    nu: float  # Poisson's ratio


@dataclass(frozen=True, eq=False)
class Solid:
    """A continuum body."""

    name: str  # name in the scene
    mesh: SolidMesh  # of one kind of cells, in the body's frame, m
    regions: tuple[Region, ...]  # materials; every cell is in one of them
    section_scale: SectionScale | None = None  # what scales the cross-section
    profiles: Profiles = UNIFORM  # what the constants are multiplied by, cell by cell

    @property
    def n_dofs(self) -> int:
        """Number of unknowns."""
        return self.mesh.dimension * self.mesh.n_nodes

    def stiffness(self, nodes: range) -> dict[Monomial, sp.csr_matrix]:
        """Return the rows of K that belong to nodes, shape (d n, n_dofs), by weight, in one pattern."""

        def parts(region: Region) -> Iterator[Part]:
            lame = Lame.of(region.nu, self.mesh.dimension == 2)
            for power, pairs in self._powers():
                yield region.modulus * power, partial(self._stiffness, lame=lame, pairs=pairs)

        return self._assemble(nodes, parts, self.profiles.stiffness)

    def mass(self, nodes: range) -> dict[Monomial, sp.csr_matrix]:
        """Return the rows of the consistent mass that belong to nodes, as `stiffness`."""
        return self._assemble(nodes, lambda region: [(self._density(region), self._mass)], self.profiles.mass)

    def second_moments(self) -> dict[Monomial, np.ndarray]:
        """Return ``int rho (x, 1) (x, 1)^T dV`` by weight, shape (d + 1, d + 1)."""
        rule, found = self._element.mass, {}
        for region in self.regions:
            places = self.mesh.nodes[self.mesh.cells[region.cells]]
            points = np.einsum("qa,eai->eqi", rule.values, places)
            points = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
            volumes = elasticity.volumes_of(places, rule)
            density = self._density(region)
            own = density.coefficient * np.einsum("eq,eqi,eqj->ij", volumes, points, points, optimize=True)
            found[density.monomial] = found.get(density.monomial, 0.0) + own
        return found

    @property
    def third_derivative_known(self) -> bool:
        """Whether the third derivative of the strain energy is known: not of a scaled cross-section, of which it has
        other powers of the scale."""
        return self.section_scale is None

    @property
    def n_entries(self) -> int:
        """Entries of a matrix, roughly: neighbouring cells share some, about half of those of all elements are left."""
        return self.mesh.n_cells * (self.mesh.dimension * self.mesh.cells.shape[1]) ** 2 // 2

    def described(self, system: UnitSystem) -> str:
        """Return the body in words: cells and volume, in units of a system."""
        return f"{self.mesh.n_cells} {self.mesh.kind}, {system.text(self.volume, f'm{self.mesh.dimension}', '.6g')}"

    @property
    def volume(self) -> float:
        """Volume of the mesh, m3 (in the plane its area, m2)."""
        return float(elasticity.volumes_of(self.mesh.nodes[self.mesh.cells], self._element.mass).sum())

    def weights(self, kind: str) -> set[Monomial]:
        """Return the weights of the affine terms of ``"mass"`` or ``"stiffness"``."""
        if kind == "mass":
            own = {self._density(region).monomial for region in self.regions}
        else:
            own = {(region.modulus * power).monomial for region in self.regions for power, _ in self._powers()}
        return self.profiles.of(kind).weights(own)

    @property
    def _element(self):
        return reference_element(self.mesh.kind)

    def _powers(self) -> list[tuple[Quantity, np.ndarray | None]]:
        """Return what multiplies a modulus, and the pairs of derivatives in its term; None for all."""
        if self.section_scale is None:
            return [(Quantity(1.0), None)]
        return list(self.section_scale.pairs(self.mesh.dimension))

    def _density(self, region: Region) -> Quantity:
        return region.density if self.section_scale is None else region.density * self.section_scale.area

    def _stiffness(self, places: np.ndarray, lame: Lame, pairs: np.ndarray | None) -> np.ndarray:
        return elasticity.stiffness(Geometry.of(places, self._element.stiffness), lame, pairs)

    def _mass(self, places: np.ndarray) -> np.ndarray:
        rule = self._element.mass
        scalar = elasticity.mass(elasticity.volumes_of(places, rule), rule)
        return np.einsum("eab,ij->eaibj", scalar, np.eye(self.mesh.dimension))

    def _assemble(
        self, nodes: range, parts_of: Callable[[Region], Iterable[Part]], profile: Profile
    ) -> dict[Monomial, sp.csr_matrix]:
        pattern = BlockPattern(self.mesh.cells, nodes, self.mesh.n_nodes)
        d = self.mesh.dimension
        terms: dict[Monomial, np.ndarray] = {}
        for region in self.regions:
            for factor, entries in parts_of(region):
                for weight in sorted(profile.weights({factor.monomial})):
                    terms.setdefault(weight, np.zeros((pattern.n_blocks, d, d)))
                for chosen in _shares(region.cells[pattern.touches(region.cells)], d * self.mesh.cells.shape[1]):
                    own = {factor.monomial: factor.coefficient * entries(self.mesh.nodes[self.mesh.cells[chosen]])}
                    for weight, values in profile.over(own, chosen).items():
                        pattern.add(terms[weight], self.mesh.cells[chosen], values)
        return {weight: pattern.matrix(data) for weight, data in terms.items()}


class BlockPattern:
    """The nonzero pattern of a share of rows, those of a range of nodes, one block a pair of nodes of all cells, shape
    (n_cells, n_cell_nodes)."""

    def __init__(self, cells: np.ndarray, nodes: range, n_nodes: int) -> None:
        self._nodes, self._n_nodes = nodes, n_nodes
        self._touching = self._mine(cells).any(axis=1)
        keys = [np.zeros(0, dtype=np.int64)]
        # few keys repeat within a share of cells, and most do between all of them: unite as we go
        for chosen in _shares(np.flatnonzero(self._touching), cells.shape[1]):
            keys.append(np.unique(self._keys(cells[chosen])[self._rows_mine(cells[chosen])]))
        self._blocks = np.unique(np.concatenate(keys))

    @property
    def n_blocks(self) -> int:
        """Number of blocks."""
        return self._blocks.size

    def touches(self, cells: np.ndarray) -> np.ndarray:
        """Return which of the numbered cells have a node of the share."""
        return self._touching[cells]

    def add(self, data: np.ndarray, cells: np.ndarray, entries: np.ndarray) -> None:
        """Add element matrices (n_e, n_a, d, n_b, d) of cells (n_e, n_a) to blocks (n_blocks, d, d)."""
        mine = self._rows_mine(cells)
        place = np.searchsorted(self._blocks, self._keys(cells)[mine])
        blocks = entries.swapaxes(2, 3)[mine]
        for i in range(data.shape[1]):
            for j in range(data.shape[2]):
                data[:, i, j] += np.bincount(place, weights=blocks[:, i, j], minlength=self.n_blocks)

    def matrix(self, data: np.ndarray) -> sp.csr_matrix:
        """Return blocks (n_blocks, d, d) as a matrix of shape (d n, d n_nodes)."""
        row, column = np.divmod(self._blocks, self._n_nodes)
        starts = np.searchsorted(row, np.arange(len(self._nodes) + 1))
        d = data.shape[1]
        return sp.bsr_matrix((data, column, starts), shape=(d * len(self._nodes), d * self._n_nodes)).tocsr()

    def _mine(self, nodes: np.ndarray) -> np.ndarray:
        return (nodes >= self._nodes.start) & (nodes < self._nodes.stop)

    def _rows_mine(self, cells: np.ndarray) -> np.ndarray:
        """Return which pairs of nodes (n_e, n_a, n_b) have their row in the share."""
        n = cells.shape[1]
        return np.broadcast_to(self._mine(cells)[:, :, None], (len(cells), n, n))

    def _keys(self, cells: np.ndarray) -> np.ndarray:
        """Number the pairs of nodes of cells by row and column, shape (n_e, n_a, n_b)."""
        return (cells[:, :, None].astype(np.int64) - self._nodes.start) * self._n_nodes + cells[:, None, :]


def _shares(numbers: np.ndarray, n_unknowns: int) -> Iterator[np.ndarray]:
    """Split numbers of cells with n_unknowns each so that the matrices of a share stay small."""
    step = max(1, ENTRIES_AT_ONCE // n_unknowns**2)
    for first in range(0, numbers.size, step):
        yield numbers[first : first + step]


SMALLEST_RADIUS = 1e-6  # of gyration, over the extent of the mesh: below, a rotation would be round-off


@dataclass(frozen=True, eq=False)
class FaceFrame:
    """A frame that follows a group of faces."""

    centre: np.ndarray  # X_c in the body's frame, shape (d,), m
    nodes: np.ndarray  # nodes of the faces, shape (n,)
    weights: np.ndarray  # ``1/A int N_i dA``, shape (n,); their sum is 1
    arms: np.ndarray  # ``1/A int N_i X' dA``, shape (n, d), m
    inertia: np.ndarray  # ``H / A``, shape (3, 3), or the scalar of the plane as (1, 1), m2

    @classmethod
    def of(cls, places: np.ndarray, faces: np.ndarray, kind: str) -> FaceFrame:
        """Make the frame of faces, shape (n_faces, n_face_nodes) in the order of their type `kind`, on nodes at places
        in the body's frame, shape (n_nodes, d), m."""
        nodes, local = np.unique(faces, return_inverse=True)
        local = local.reshape(faces.shape)
        rule = reference_element(kind).mass
        corners = places[faces]
        tangents = np.einsum("qja,eai->eqij", rule.gradients, corners)
        areas = np.sqrt(np.linalg.det(np.einsum("eqik,eqil->eqkl", tangents, tangents))) * rule.weights
        points = np.einsum("qa,eai->eqi", rule.values, corners)
        area = areas.sum()
        centre = np.einsum("eq,eqi->i", areas, points) / area
        shares = np.einsum("eq,qa->ea", areas, rule.values) / area
        moments = np.einsum("eq,qa,eqi->eai", areas, rule.values, points - centre, optimize=True) / area
        weights, arms = np.zeros(nodes.size), np.zeros((nodes.size, places.shape[1]))
        np.add.at(weights, local, shares)
        np.add.at(arms, local, moments)
        return cls(centre, nodes, weights, arms, tensor_of_inertia(arms.T @ places[nodes]))

    @classmethod
    def of_nodes(cls, places: np.ndarray, nodes: np.ndarray) -> FaceFrame:
        """Make the frame of nodes (n,) that count alike, where faces are not known: means over nodes in place of areas.

        Places are those of all nodes in the body's frame, shape (n_nodes, d), m.
        """
        weights, centre = np.full(nodes.size, 1.0 / nodes.size), places[nodes].mean(axis=0)
        arms = (places[nodes] - centre) / nodes.size
        return cls(centre, nodes, weights, arms, tensor_of_inertia(arms.T @ places[nodes]))

    @property
    def radius(self) -> float:
        """Smallest radius of gyration of the faces, m: how well the group carries a rotation."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.inertia)[0], 0.0)))

    def functionals(self, n_nodes: int) -> sp.csr_matrix:
        """Return what maps nodal displacements to those of the frame, its rotation at the end.

        Shape (3, 2 n_nodes) in the plane, ``(x, y, phi)``, and (6, 3 n_nodes) in space.
        """
        d = self.arms.shape[1]
        position = np.einsum("n,ij->inj", self.weights, np.eye(d))
        turning = np.einsum("ki,inj->knj", np.linalg.inv(self.inertia), _crossing(self.arms))
        values = np.concatenate([position, turning])
        columns = np.broadcast_to(d * self.nodes[:, None] + np.arange(d), values.shape)
        rows = np.broadcast_to(np.arange(len(values))[:, None, None], values.shape)
        return sp.coo_matrix((values.ravel(), (rows.ravel(), columns.ravel())), (len(values), d * n_nodes)).tocsr()


def tensor_of_inertia(second: np.ndarray) -> np.ndarray:
    """Return H / A from the mean of ``X' X^T``, shape (1, 1) in the plane, or (3, 3)."""
    return np.trace(second) * np.eye(3) - second if len(second) == 3 else np.array([[np.trace(second)]])


def _crossing(arms: np.ndarray) -> np.ndarray:
    """Return the matrix of ``u -> arms x u``, shape (3, n, 3), or (1, n, 2) in the plane."""
    if arms.shape[1] == 2:
        return np.stack([-arms[:, 1], arms[:, 0]], axis=1)[None]
    x, y, z = arms.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(0, 2, 1)
