"""A body that another finite element program has assembled: its nodes, its stiffness and its mass, and no elements.

In its own frame the body has ``K`` and ``M`` of all displacements of its nodes. Only their factors may be parameters,

    K = s_K K_0,    M = s_M M_0,

so that a modulus or a density of the whole body can be varied, and no more is known: no strains inside, no cells, no
third derivative of the energy. The mass is ``m`` along every axis, ``M = m (x) 1``, which inertia forces of large
rotations need (`bodies.matrices`); `assembled_reading` sees to that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError, nearest_name
from pgmp_petsc.base.units import UnitSystem
from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.profile import UNIFORM, Profiles, SectionScale
from pgmp_petsc.bodies.solid import FaceFrame, tensor_of_inertia
from pgmp_petsc.mesh.meshes import SolidMesh, outer_faces, reference_element

ROUND_OFF = 1e-13  # of coordinates: a centre of mass nearer to 0 is there


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass, centre of mass and inertia of a body."""

    mass: float  # kg
    centre: np.ndarray  # in the frame of the nodes, shape (d,), m
    second: np.ndarray  # ``int rho x x^T dV`` about the centre of mass, shape (d, d), kg m2

    @property
    def inertia(self) -> np.ndarray:
        """The moment of inertia of the plane, shape (1, 1), or the tensor, shape (3, 3), about the centre, kg m2."""
        return tensor_of_inertia(self.second)


@dataclass(frozen=True, eq=False)
class Assembled:
    """Matrices and nodes, in the scene's units; both matrices on one pattern of rows that are compressed."""

    nodes: np.ndarray  # in the body's frame, shape (n_nodes, d), m
    labels: np.ndarray  # numbers of the nodes in their file, shape (n_nodes,)
    sets: dict[str, np.ndarray]  # nodes of every named set, shape (n,)
    groups: dict[str, np.ndarray]  # of names that hold faces of a mesh, these, shape (n_faces, n_face_nodes)
    surface: np.ndarray  # faces that bound one cell of a mesh; none without
    face_kind: str  # type of the faces; empty without
    #: starts, columns: of the rows ``d node + direction``, shapes (d n_nodes + 1,) and (n_entries,)
    starts: np.ndarray
    columns: np.ndarray
    #: stiffness, mass: entries, shape (n_entries,), N/m and kg
    stiffness: np.ndarray
    mass: np.ndarray

    @classmethod
    def of(
        cls, nodes: np.ndarray, labels: np.ndarray, sets: Mapping, mesh: SolidMesh | None, stiffness, mass
    ) -> Assembled:
        """Put sparse symmetric matrices on one pattern."""
        stiffness, mass = stiffness.tocoo(), mass.tocoo()
        row, column = (np.concatenate([getattr(a, key) for a in (stiffness, mass)]) for key in ("row", "col"))
        shape, none = stiffness.shape, (np.zeros(stiffness.nnz), np.zeros(mass.nnz))
        both = [
            sp.coo_matrix((np.concatenate(parts), (row, column)), shape=shape).tocsr()
            for parts in ((stiffness.data, none[1]), (none[0], mass.data))
        ]
        for matrix in both:
            matrix.sort_indices()
        groups, surface, kind = {}, np.zeros((0, 1), dtype=int), ""
        if mesh is not None:
            groups, kind = mesh.groups, reference_element(mesh.kind).face_kind
            surface = outer_faces(mesh.kind, mesh.cells)
        k, m = both
        return cls(nodes, labels, dict(sets), groups, surface, kind, k.indptr, k.indices, k.data, m.data)

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.nodes.shape[1]

    @property
    def n_rigid(self) -> int:
        """Number of rigid-body motions."""
        return self.dimension * (self.dimension + 1) // 2

    @property
    def n_cells(self) -> int:
        """Number of cells that are known: none."""
        return 0

    def matrix(self, kind: str) -> sp.csr_matrix:
        """Return ``"stiffness"`` or ``"mass"``, shape (d n_nodes, d n_nodes)."""
        n = self.nodes.size
        return sp.csr_matrix((getattr(self, kind), self.columns, self.starts), shape=(n, n))

    @cached_property
    def scalar_mass(self) -> sp.csr_matrix:
        """The mass m along one axis, shape (n_nodes, n_nodes), kg."""
        return self.matrix("mass")[:: self.dimension, :: self.dimension]

    @property
    def properties(self) -> MassProperties:
        """Mass, centre and inertia."""
        weights = np.asarray(self.scalar_mass.sum(axis=0)).ravel()
        mass = float(weights.sum())
        centre = weights @ self.nodes / mass
        centre[np.abs(centre) < ROUND_OFF * np.abs(self.nodes).max()] = 0.0
        arms = self.nodes - centre
        return MassProperties(mass, centre, arms.T @ (self.scalar_mass @ arms))

    @property
    def wave_speed(self) -> float:
        """``sqrt(int C_1111 dV / int rho dV)``, m/s: from the energy of the displacement ``u = x`` along x."""
        stretched = np.zeros(self.nodes.shape)
        stretched[:, 0] = self.nodes[:, 0]
        energy = float(stretched.ravel() @ (self.matrix("stiffness") @ stretched.ravel()))
        return float(np.sqrt(max(energy, 0.0) / self.properties.mass))

    def frame(self, wanted: str | tuple[int, ...], entry: str) -> FaceFrame:
        """Return the frame of a named set or of numbered nodes: of faces by their area where these are known, as those
        of a mesh are that all belong to what is chosen; else of nodes that count alike.

        Raises `InputError` if there is no such set or node; `entry` is the scene's entry to blame, with what it asks
        for.
        """
        faces, chosen = self.faces_of(wanted, entry)
        if len(faces):
            return FaceFrame.of(self.nodes, faces, self.face_kind)
        return FaceFrame.of_nodes(self.nodes, chosen)

    def faces_of(self, wanted: str | tuple[int, ...], entry: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the faces (n, n_face_nodes) that make up what is chosen, none where they are not known or leave some
        of its nodes out, and its nodes; raises as `frame`."""
        if isinstance(wanted, str) and wanted in self.groups:
            return self.groups[wanted], np.unique(self.groups[wanted])
        if isinstance(wanted, str):
            if wanted not in self.sets:
                known = {*self.groups, *self.sets}
                raise InputError(f"{entry}: the file of the nodes has no set of this name{nearest_name(wanted, known)}")
            chosen = self.sets[wanted]
        else:
            chosen = np.flatnonzero(np.isin(self.labels, wanted))
            lost = [number for number in wanted if number not in self.labels]
            if lost:
                raise InputError(f"{entry}: the file of the nodes has no node {lost[0]}")
        faces = self.surface[np.isin(self.surface, chosen).all(axis=1)]
        return (faces if np.isin(chosen, faces).all() else faces[:0]), chosen


@dataclass(frozen=True, eq=False)
class AssembledBody:
    """Matrices with their factors; to what condenses bodies it is what a `Solid` is."""

    name: str  # name in the scene
    mesh: Assembled  # nodes and matrices
    #: modulus, density: factors of stiffness and mass
    modulus: Quantity
    density: Quantity
    section_scale: SectionScale | None = None
    profiles: Profiles = UNIFORM
    third_derivative_known = False

    @property
    def n_dofs(self) -> int:
        """Number of unknowns."""
        return self.mesh.nodes.size

    @property
    def n_entries(self) -> int:
        """Entries of a matrix."""
        return self.mesh.columns.size

    def described(self, system: UnitSystem) -> str:
        """Return the body in words."""
        return "assembled matrices"

    def stiffness(self, nodes: range) -> dict[Monomial, sp.csr_matrix]:
        """Return the rows of K that belong to nodes, shape (d n, n_dofs), by weight."""
        return self._rows("stiffness", self.modulus, nodes)

    def mass(self, nodes: range) -> dict[Monomial, sp.csr_matrix]:
        """Return the rows of M, as `stiffness`."""
        return self._rows("mass", self.density, nodes)

    def weights(self, kind: str) -> set[Monomial]:
        """Return the weights of the affine terms of ``"mass"`` or ``"stiffness"``."""
        return {(self.density if kind == "mass" else self.modulus).monomial}

    def second_moments(self) -> dict[Monomial, np.ndarray]:
        """Return ``int rho (x, 1) (x, 1)^T dV`` by weight, shape (d + 1, d + 1)."""
        points = np.column_stack([self.mesh.nodes, np.ones(self.mesh.n_nodes)])
        return {self.density.monomial: self.density.coefficient * points.T @ (self.mesh.scalar_mass @ points)}

    def _rows(self, kind: str, factor: Quantity, nodes: range) -> dict[Monomial, sp.csr_matrix]:
        d, mesh = self.mesh.dimension, self.mesh
        first, last = mesh.starts[[d * nodes.start, d * nodes.stop]]
        starts = mesh.starts[d * nodes.start : d * nodes.stop + 1] - first
        data = factor.coefficient * getattr(mesh, kind)[first:last]
        shape = (d * len(nodes), self.n_dofs)
        return {factor.monomial: sp.csr_matrix((data, mesh.columns[first:last], starts), shape=shape)}
