"""A flexible body of beams, in the plane or in space; its elements are those of `beam2d` and `beam3d`.

Of the third derivative of the strain energy at rest, with the strains ``e = S v`` of the elements at rest, it has

    K3_i[v_j, v_k] = S^T f_i(e_j, e_k),

f from `beam2d.third_derivative` or `beam3d.third_derivative`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies import beam2d, beam3d
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.beam2d import undeformed_stiffness
from pgmp_petsc.bodies.body import Body, Entries, Pairs, ThirdPart, element_dofs
from pgmp_petsc.bodies.profile import UNIFORM, Profiles
from pgmp_petsc.bodies.random_fields import profiles_of
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.stresses import BeamStresses
from pgmp_petsc.mesh.meshes import LineMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body as BodyEntry

NODE_SECONDS = {2: 1.0e-7, 3: 6.0e-6}  # of a step, by the dimension


@dataclass(frozen=True, kw_only=True)
class Beam(Body):
    """A body of beams."""

    section: BeamSection  # sectional coefficients
    #: axes of the elements in space, shape (n_elements, 3, 3), see `beam3d`; None in the plane
    axes: np.ndarray | None = None
    profiles: Profiles = UNIFORM  # what the constants are multiplied by, element by element
    lever: float = 0.0  # `BeamSection.lever` of the nominal section in space

    fibred = True

    @classmethod
    def takes(cls, entry: BodyEntry, shape: object) -> bool:
        return isinstance(shape, LineMesh) and entry.flexible

    @classmethod
    def of(cls, scene: Scene, name: str, shape: LineMesh) -> Beam:
        section, profiles = BeamSection.of(scene, name), profiles_of(scene, name, shape)
        if scene.dimension == 2:
            return cls(name, shape, shape, section=section, profiles=profiles)
        axes, lever = axes_of(scene, name, shape), section.lever(scene.nominal)
        return cls(name, shape, shape, section=section, axes=axes, profiles=profiles, lever=lever)

    @property
    def planar(self) -> bool:
        """Whether it is in the plane."""
        return self.axes is None

    strains_follow_frames = True

    @property
    def n_own_sections(self) -> int:
        return len(self.mesh.cells) if self.profiles else 0

    @property
    def step_seconds(self) -> float:
        return NODE_SECONDS[self.dimension] * self.n_nodes

    @property
    def elements(self) -> np.ndarray:
        """Global node numbers of the elements, shape (n_elements, 2)."""
        return self.mesh.cells + self.first_node

    @cached_property
    def directions(self) -> np.ndarray:
        """Directions of the elements in the plane, shape (n_elements,), rad."""
        edges = np.diff(self.mesh.nodes[self.mesh.cells], axis=1)[:, 0]
        return np.arctan2(edges[:, 1], edges[:, 0])

    @property
    def _turns(self) -> np.ndarray:
        """Rotations of the elements, row by row: directions, or axes."""
        return self.directions if self.planar else self.axes

    @property
    def _element(self) -> ModuleType:
        return beam2d if self.planar else beam3d

    @cached_property
    def strain_gradients(self) -> np.ndarray:
        """Linear strains of the elements per displacement and rotation of their nodes in the body's frame, shape
        (n_elements, 3, 6), in space (n_elements, 6, 12)."""
        return self._element.strain_gradients(self.mesh.lengths, self._turns)

    @cached_property
    def rest_strains(self) -> np.ndarray:
        """What strains of higher order are made of likewise, shape (n_elements, 3, 6), in space (n_elements, 9, 12)."""
        return self._element.rest_strains(self.mesh.lengths, self._turns)

    @cached_property
    def rest_operator(self) -> sp.csr_matrix:
        """The same of the displacements of all nodes: strains of all elements, one kind after the other; in the plane
        with their curvatures behind them."""
        strains = self.rest_strains
        if self.planar:
            strains = np.concatenate([strains, self.strain_gradients[:, 2:]], axis=1)
        n, n_kinds, n_dofs = strains.shape
        rows = np.arange(n)[:, None] + n * np.arange(n_kinds)
        columns = np.repeat(element_dofs(self.mesh.cells, self.node_dofs), n_kinds, axis=0)
        entries = strains.ravel(), (np.repeat(rows.ravel(), n_dofs), columns.ravel())
        return sp.csr_matrix(entries, shape=(n * n_kinds, self.node_dofs * self.n_nodes))

    def stresses(self, scene: Scene) -> BeamStresses:
        return BeamStresses(scene, self)

    @property
    def by_node(self) -> np.ndarray:
        return self.displacements(np.eye(self.dofs.size))

    def displacements(self, y: np.ndarray) -> np.ndarray:
        return y.reshape(self.n_nodes, self.node_dofs, -1)

    # matrices

    def blocks(self, kernel: str) -> Sequence[Beam]:
        return (self,) if kernel == f"beam{self.dimension}d" else ()

    def sections(self, kind: str) -> dict[Monomial, np.ndarray]:
        """Return the coefficients of ``"mass"`` or ``"stiffness"`` of all elements by weight, shape (n_elements,
        n_coefficients), in the order of `BeamSection`."""
        n = len(self.mesh.cells)
        terms = {weight: np.tile(values, (n, 1)) for weight, values in self.section.terms(kind).items()}
        return self.profiles.of(kind).over(terms, np.arange(n))

    def own_weights(self, kind: str) -> set[Monomial]:
        return self.profiles.of(kind).weights(set(self.section.terms(kind)))

    def _translating_weights(self) -> set[Monomial]:
        return self.profiles.mass.weights({weight for weight, (line, *_) in self.section.terms("mass").items() if line})

    def entries(self, kind: str, rows: range) -> Iterator[Entries]:
        chosen = self.touching(rows)
        dofs, values = element_dofs(self.elements[chosen], self.node_dofs), self.of_elements(kind, chosen)
        row, column = np.repeat(dofs, dofs.shape[1], axis=1), np.tile(dofs, (1, dofs.shape[1]))
        yield row.ravel(), column.ravel(), {weight: part.ravel() for weight, part in values.items()}
        yield from super().entries(kind, rows)

    def touching(self, rows: range) -> np.ndarray:
        """Return the numbers of the elements that touch the given rows, shape (n_chosen,)."""
        first = self.node_dofs * self.elements
        touches = (first < rows.stop) & (first + self.node_dofs > rows.start)
        return np.flatnonzero(touches.any(axis=1))

    def of_elements(self, kind: str, chosen: np.ndarray) -> dict[Monomial, np.ndarray]:
        """Return consistent masses, tangents at rest or what of these resists extension of some elements, in the body's
        frame, shape (n_chosen, 6, 6), in space (n_chosen, 12, 12), by weight."""
        matrices, of_each, of = undeformed_stiffness, self.strain_gradients, "stiffness"
        if kind == "mass":
            matrices, of_each, of = self._element.consistent_mass, self._turns, "mass"
        terms, own = self.section.terms(of), (self.mesh.lengths[chosen], of_each[chosen])
        if kind == "stretching":
            terms = {weight: (axial, *[0.0] * len(others)) for weight, (axial, *others) in terms.items() if axial}
        found = {weight: matrices(*own, np.array(coefficients)) for weight, coefficients in terms.items()}
        return self.profiles.of(of).over(found, chosen)

    def _section_turns(self, mean: np.ndarray) -> np.ndarray:
        """Return how sections turn at the nodes with a linear field ``u = A X``, in space as their fibres do.

        A is taken row by row. A section's fibres move with the second and third columns of A in the element's axes; the
        rotation with the same moment of momentum is ``((J_22 A_32 - J_33 A_23) / (J_22 + J_33), A_13, -A_12)``. For
        spins it is the rotation itself; for strain rates it gives the moments of centripetal accelerations. Where the
        shape of the section depends on parameters, the share of J is that at the nominal values.
        """
        if self.planar:
            return mean
        local = np.zeros((3, 3, 3))
        local[0, 2, 1], local[0, 1, 2] = 0.5 * (1.0 + self.lever), -0.5 * (1.0 - self.lever)
        local[1, 0, 2], local[2, 0, 1] = 1.0, -1.0
        turned = np.einsum("ear,rst,ebs,ect->eabc", self.axes, local, self.axes, self.axes, optimize=True)
        lengths = self.mesh.lengths
        shares, found = np.zeros(self.n_nodes), np.zeros((self.n_nodes, 3, 9))
        for nodes in self.mesh.cells.T:
            np.add.at(shares, nodes, lengths)
            np.add.at(found, nodes, lengths[:, None, None] * turned.reshape(-1, 3, 9))
        return found / shares[:, None, None]

    def moments(self) -> Iterator[tuple[Monomial, np.ndarray, np.ndarray]]:
        dofs, lengths = element_dofs(self.mesh.cells, self.node_dofs), self.mesh.lengths
        if self.planar:
            gradient = np.zeros((2, 2, 6))  # of the places of both nodes
            for node in range(2):
                gradient[0, node, 3 * node] = gradient[1, node, 3 * node + 1] = 1.0
        else:
            gradient = beam3d.at_rest().reshape(2 * beam3d.N_FRAME // 3, 3, 12).swapaxes(0, 1)
        found = {}
        for weight, coefficients in self.section.terms("mass").items():
            if self.planar:
                mass = coefficients[0] * lengths[:, None, None] * beam2d.CONSISTENT
            else:
                mass = beam3d.natural_mass(lengths, self.axes, np.array(coefficients))[:, ::3, ::3]
            found[weight] = np.einsum("iak,eab,jbl->eijkl", gradient, mass, gradient, optimize=True)
        for weight, moments in self.profiles.mass.over(found, np.arange(lengths.size)).items():
            yield weight, dofs, moments

    def director_inertia(self) -> Iterator[tuple[Monomial, np.ndarray, np.ndarray]]:
        for weight, coefficients in self.sections("mass").items():
            density = np.einsum("eis,es,ejs->eij", self.axes[:, :, 1:], coefficients[:, [2, 1]], self.axes[:, :, 1:])
            for nodes in self.mesh.cells.T:
                yield weight, nodes, 0.5 * self.mesh.lengths[:, None, None] * density

    def third_derivative(self, rows: range, n_dofs: int) -> ThirdPart:
        return _Third(self, rows, n_dofs)


class _Third(ThirdPart):
    """Its terms are sectional coefficients."""

    def __init__(self, body: Beam, rows: range, n_dofs: int) -> None:
        chosen = body.touching(rows)
        self._lengths, self._contracted = body.mesh.lengths[chosen], body._element.third_derivative
        strains = body.rest_strains[chosen]
        dofs, self._n = element_dofs(body.elements[chosen], body.node_dofs), strains.shape[1]
        columns, starts = np.repeat(dofs, self._n, axis=0), dofs.shape[1] * np.arange(dofs.shape[0] * self._n + 1)
        self._strains = sp.csr_matrix((strains.ravel(), columns.ravel(), starts), shape=(starts.size - 1, n_dofs))
        self._on_rows = self._strains.T.tocsr()[rows.start : rows.stop]
        terms = body.sections("stiffness")
        self.weights, self.terms = list(terms), [coefficients[chosen].T for coefficients in terms.values()]

    def forces(self, terms: Iterable[np.ndarray], vectors: np.ndarray, pairs: Pairs) -> Iterable[np.ndarray]:
        """Yield the forces on the strains for sections, each of shape (n_elements n_strains, n_pairs)."""
        strains = (self._strains @ vectors).reshape(self._lengths.size, self._n, vectors.shape[1])
        one, other = strains[..., pairs[0]], strains[..., pairs[1]]
        for section in terms:
            forces = self._contracted(one, other, section) * self._lengths[:, None, None]
            yield forces.reshape(self._strains.shape[0], pairs[0].size)

    def add(self, forces: np.ndarray, total: np.ndarray) -> None:
        total += self._on_rows @ forces


def axes_of(scene: Scene, name: str, mesh: LineMesh) -> np.ndarray:
    """Return the axes of the elements of a body of beams in space, shape (n_elements, 3, 3).

    Raises `InputError` if the orientation of its section is parallel to one of its elements.
    """
    entry = scene.bodies[name]
    edges = np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0]
    axes = beam3d.section_axes(edges, None if entry.orientation is None else np.array(entry.orientation))
    parallel = np.flatnonzero(np.isnan(axes).any(axis=(1, 2)))
    if parallel.size:
        raise InputError(
            f"bodies.{name}.orientation = {list(entry.orientation)}: parallel to element {parallel[0]} of the body, "
            f"along {(edges[parallel[0]] / np.linalg.norm(edges[parallel[0]])).round(6).tolist()} in its frame; "
            "needed: orientation = [x, y, z], a direction across all elements, that of the section's height"
        )
    return axes
