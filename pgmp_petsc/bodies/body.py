"""A body: its nodes in its own frame, its place among the unknowns, and its affine matrices.

The nodes of a beam are those of its mesh; a rigid body has one, its centre of mass. A continuum body has one for each
of its frames, the groups of faces that joints and effects hold, and internal coordinates beside them: of a condensed
body the amplitudes of its component modes, which do not turn with it; otherwise the positions of the nodes of its mesh.

In the body's frame the mass and the tangent stiffness at rest are constant for every configuration of the mechanism,
so both are made once (`Body.stiffness_entries`, `Body.mass_entries`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies import beam2d, beam3d
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.profile import UNIFORM, Profiles
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.mesh.line_mesh import LineMesh

if TYPE_CHECKING:
    from pgmp_petsc.bodies.component import Component
    from pgmp_petsc.bodies.floating import FloatingBody
    from pgmp_petsc.bodies.framed_solid import FramedSolid

DOFS_PER_NODE = 3  # x, y, phi
DOFS_IN_SPACE = 6  # displacement and rotation


@dataclass(frozen=True)
class LumpedMass:
    """What remains of a node's own mass (kg) and moment of inertia (kg m2) when their weight is taken out."""

    mass: float
    inertia: float

    def __add__(self, other: LumpedMass) -> LumpedMass:
        return LumpedMass(self.mass + other.mass, self.inertia + other.inertia)


def joined(lumps: Mapping[Monomial, LumpedMass], more: Mapping[Monomial, LumpedMass]) -> dict[Monomial, LumpedMass]:
    """Return the masses of a node with further ones, those of the same weight together."""
    nothing = LumpedMass(0.0, 0.0)
    return {weight: lumps.get(weight, nothing) + more.get(weight, nothing) for weight in {**lumps, **more}}


@dataclass(frozen=True)
class Body:
    """A beam, or a rigid body whose only node is its centre of mass.

    Attributes
    ----------
    name
        Name in the scene.
    mesh
        Nodes (m) in the body's own frame, and line cells; of a rigid body its centre of mass, without cells.
    section
        Sectional coefficients; None for a particle.
    axes
        Axes of the elements of a beam in space, shape (n_elements, 3, 3); see `beam3d`.
    shape
        The mesh that the scene gives, with the named points; `mesh` itself for a beam.
    lumps
        Masses at nodes, by node (of the mesh) and weight.
    first_node
        Number of the body's first node among all nodes of the mechanism.
    component
        A continuum body, condensed.
    meshed
        A continuum body that is not condensed.
    floating
        A flexible body in a floating frame: its last node, behind those of the frames that hold it.
    lever
        `BeamSection.lever` of beams in space.
    profiles
        What the constants of a body of beams are multiplied by, element by element.
    first_internal
        Number of the body's first internal coordinate among all unknowns of the mechanism.
    """

    name: str
    mesh: LineMesh
    section: BeamSection | None
    shape: LineMesh
    lumps: dict[int, dict[Monomial, LumpedMass]] = field(default_factory=dict)
    first_node: int = 0
    component: Component | None = None
    meshed: FramedSolid | None = None
    first_internal: int = 0
    axes: np.ndarray | None = None
    floating: FloatingBody | None = None
    lever: float = 0.0
    profiles: Profiles = UNIFORM

    @classmethod
    def beam(cls, name: str, mesh: LineMesh, section: BeamSection, profiles: Profiles = UNIFORM) -> Body:
        """Return a flexible body in the plane."""
        return cls(name, mesh, section, mesh, profiles=profiles)

    @classmethod
    def beam_in_space(
        cls,
        name: str,
        mesh: LineMesh,
        section: BeamSection,
        axes: np.ndarray,
        profiles: Profiles = UNIFORM,
        lever: float = 0.0,
    ) -> Body:
        """Return a flexible body of beams in space, their axes of shape (n_elements, 3, 3)."""
        return cls(name, mesh, section, mesh, axes=axes, profiles=profiles, lever=lever)

    @classmethod
    def rigid(cls, name: str, mesh: LineMesh, section: BeamSection) -> Body:
        """Return a rigid body with the mass of beams along the lines of a mesh.

        A line of length L at the distance d of its middle from the centre of mass has the moment of inertia
        ``rho A L (d^2 + L^2 / 12) + rho I L``.
        """
        lengths, middles = mesh.lengths, mesh.nodes[mesh.cells].mean(axis=1)
        centre = lengths @ middles / lengths.sum()
        arms = np.sum((middles - centre) ** 2, axis=1) + lengths**2 / 12.0
        total, about = float(lengths.sum()), float(lengths @ arms)
        lumps = {
            weight: LumpedMass(line * total, line * about + rotary * total)
            for weight, (line, rotary) in section.terms("mass").items()
            if line or rotary
        }
        return cls(name, LineMesh(centre[None], np.empty((0, 2), dtype=int)), section, mesh, {0: lumps})

    @classmethod
    def condensed(cls, name: str, component: Component) -> Body:
        """Return a continuum body from its condensed matrices; it may be rigid."""
        shape = _frame_mesh(component.centres, component.frames)
        mesh = shape
        if component.rigid:
            mesh = LineMesh(component.centre_of_mass[None], np.empty((0, 2), dtype=int))
            if component.centres.shape[1] == 2:  # a mass on a node, as that of other rigid bodies in the plane
                lumps = {weight: LumpedMass(m[0, 0], m[2, 2]) for weight, m in component.mass.items()}
                return cls(name, mesh, None, shape, {0: lumps})
        return cls(name, mesh, None, shape, component=component)

    @classmethod
    def continuum(cls, name: str, meshed: FramedSolid) -> Body:
        """Return a flexible body on a mesh of continuum elements."""
        centres = np.array([frame.centre for frame in meshed.frames.values()])
        mesh = _frame_mesh(centres, {point: number for number, point in enumerate(meshed.frames)})
        return cls(name, mesh, None, mesh, meshed=meshed)

    @classmethod
    def in_floating_frame(cls, name: str, floating: FloatingBody) -> Body:
        """Return a flexible body in a floating frame, whose origin is that of the body's own."""
        frames = _frame_mesh(floating.centres, floating.frames)
        origin = np.zeros((1, floating.centres.shape[1]))
        mesh = LineMesh(np.concatenate([floating.centres, origin]), frames.cells, dict(floating.frames))
        return cls(name, mesh, None, mesh, floating=floating)

    @classmethod
    def particle(cls, name: str, place: np.ndarray, lumps: dict[Monomial, LumpedMass]) -> Body:
        """Return a rigid body that is a point mass at a place in its own frame, shape (d,), m."""
        mesh = LineMesh(place[None], np.empty((0, 2), dtype=int))
        return cls(name, mesh, None, mesh, {0: lumps})

    def lend_inertia(self) -> tuple[Body, dict[Monomial, LumpedMass]]:
        """Return a rigid body with half its moment of inertia, and the other half, by weight, for what is welded to it.

        Both turn as one, so that nothing changes; but a particle without any moment of inertia would make the mass
        matrix singular.
        """
        if self.component is not None:
            return self._lend_in_space()
        own = {weight: LumpedMass(lump.mass, 0.5 * lump.inertia) for weight, lump in self.lumps[0].items()}
        lent = {weight: LumpedMass(0.0, lump.inertia) for weight, lump in own.items() if lump.inertia}
        return replace(self, lumps={0: own}), lent

    def _lend_in_space(self) -> tuple[Body, dict[Monomial, LumpedMass]]:
        """Lend the same moment of inertia about every axis, so little that a real body could have what is left.

        With the tensor of inertia J that body has ``int rho X X^T dV = 1/2 tr(J) 1 - J``, positive definite; half its
        smallest eigenvalue is left.
        """
        mass, lent = {}, {}
        for weight, matrix in self.component.mass.items():
            inertia = matrix[3:, 3:]
            moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
            share = float(np.linalg.eigvalsh(moments)[0])
            mass[weight] = matrix - np.diag([0.0, 0.0, 0.0, share, share, share])
            lent[weight] = LumpedMass(0.0, share)
        return replace(self, component=replace(self.component, mass=mass)), lent

    def with_lumps(self, node: int, lumps: dict[Monomial, LumpedMass]) -> Body:
        """Return the body with further masses at a node."""
        return replace(self, lumps={**self.lumps, node: joined(self.lumps.get(node, {}), lumps)})

    def numbered(self, first_node: int, first_internal: int) -> Body:
        """Return the body with its place in the numbering of all nodes and all unknowns."""
        return replace(self, first_node=first_node, first_internal=first_internal)

    def alone(self) -> Body:
        """Return the body as the only one of a mechanism."""
        return self.numbered(0, self.node_dofs * self.n_nodes)

    @property
    def flexible(self) -> bool:
        """Whether the body deforms."""
        return self.is_beam or self.is_continuum and not (self.component is not None and self.component.rigid)

    @property
    def is_beam(self) -> bool:
        """Whether the body is made of flexible beams."""
        return len(self.mesh.cells) > 0 and not self.is_continuum

    @property
    def is_planar_beam(self) -> bool:
        """Whether the body is made of flexible beams in the plane."""
        return self.is_beam and self.axes is None

    @property
    def is_continuum(self) -> bool:
        """Whether the body is meshed with continuum elements, condensed or not."""
        return self.component is not None or self.meshed is not None or self.floating is not None

    @property
    def extent(self) -> float:
        """A length that is typical of the body: its largest extent along an axis of its frame, or nearly so, m."""
        if self.component is not None:
            return self.component.extent
        if self.floating is not None:
            return self.floating.extent
        nodes = self.shape.nodes if self.meshed is None else self.meshed.solid.mesh.nodes
        extent = float(np.max(np.ptp(nodes, axis=0)))
        if self.flexible or extent:
            return extent
        # a rigid continuum body that one joint holds: the bar with its radius of gyration
        return max(float(np.sqrt(12.0 * lump.inertia / lump.mass)) for lump in self.lumps[0].values() if lump.mass)

    @property
    def mass_weights(self) -> set[Monomial]:
        """Weights of its affine mass terms."""
        lumped = self._lumped_weights
        return lumped | self._own_weights("mass") if self.flexible or self.is_continuum else lumped

    @property
    def translational_weights(self) -> set[Monomial]:
        """Weights of the mass terms that resist translation."""
        lumped = {weight for lumps in self.lumps.values() for weight, lump in lumps.items() if lump.mass}
        if not (self.flexible or self.is_continuum):
            return lumped
        if not self.is_beam:
            return lumped | self._own_weights("mass")
        return lumped | self.profiles.mass.weights({w for w, (line, *_) in self.section.terms("mass").items() if line})

    @property
    def stiffness_weights(self) -> set[Monomial]:
        """Weights of its affine stiffness terms; none for a rigid body."""
        return self._own_weights("stiffness") if self.flexible else set()

    def condensed_weights(self, kind: str) -> set[Monomial]:
        """Return the weights of ``"mass"`` or ``"stiffness"`` in a reduced model: those of the condensed body, if it is
        one."""
        if self.meshed is None:
            return self.mass_weights if kind == "mass" else self.stiffness_weights
        lumped = self._lumped_weights if kind == "mass" else set()
        return lumped | self.meshed.condensed_weights(kind)

    @property
    def _lumped_weights(self) -> set[Monomial]:
        return {weight for lumps in self.lumps.values() for weight in lumps}

    def _own_weights(self, kind: str) -> set[Monomial]:
        if self.component is not None:
            return set(getattr(self.component, kind))
        if self.meshed is not None:
            return self.meshed.solid.weights(kind)
        if self.floating is not None:
            return set(self.floating.moments if kind == "mass" else self.floating.stiffness)
        return self.profiles.of(kind).weights(set(self.section.terms(kind)))

    def sections(self, kind: str) -> dict[Monomial, np.ndarray]:
        """Return the coefficients of ``"mass"`` or ``"stiffness"`` of all elements of beams by weight, shape
        (n_elements, n_coefficients), in the order of `BeamSection`."""
        terms = self.section.terms(kind).items()
        n = len(self.mesh.cells)
        return self.profiles.of(kind).over({weight: np.tile(values, (n, 1)) for weight, values in terms}, np.arange(n))

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.mesh.nodes)

    @property
    def nodes(self) -> slice:
        """The body's range of global node numbers."""
        return slice(self.first_node, self.first_node + self.n_nodes)

    @property
    def node_dofs(self) -> int:
        """Number of unknowns of a node: displacements and rotations, 3 in the plane and 6 in space."""
        return DOFS_PER_NODE if self.mesh.nodes.shape[1] == 2 else DOFS_IN_SPACE

    @property
    def n_internal(self) -> int:
        """Number of internal coordinates; those of a body on a mesh are the positions of the mesh's nodes, those in a
        floating frame the amplitudes of its fields."""
        if self.meshed is not None:
            return self.meshed.solid.n_dofs
        if self.floating is not None:
            return self.floating.n
        return 0 if self.component is None else self.component.n_internal

    @property
    def internal(self) -> slice:
        """The internal coordinates among all unknowns."""
        return slice(self.first_internal, self.first_internal + self.n_internal)

    @property
    def dofs(self) -> np.ndarray:
        """The body's unknowns: those of its nodes, then the internal ones."""
        nodal = self.node_dofs * self.first_node + np.arange(self.node_dofs * self.n_nodes)
        return np.concatenate([nodal, self.first_internal + np.arange(self.n_internal)])

    @property
    def elements(self) -> np.ndarray:
        """Global node numbers of the elements, shape (n_elements, 2)."""
        return self.mesh.cells + self.first_node

    @cached_property
    def directions(self) -> np.ndarray:
        """Directions of the elements of a mesh in the plane, shape (n_elements,), rad."""
        edges = np.diff(self.mesh.nodes[self.mesh.cells], axis=1)[:, 0]
        return np.arctan2(edges[:, 1], edges[:, 0])

    def stiffness_entries(self, chosen: np.ndarray) -> dict[Monomial, np.ndarray]:
        """Return element tangents at rest in the body's frame, (n_chosen, 6, 6), in space (n_chosen, 12, 12), by
        weight."""
        if not self.is_beam:
            return {}
        entries = {
            monomial: self._undeformed_stiffness(chosen, coefficients)
            for monomial, coefficients in self.section.terms("stiffness").items()
        }
        return self.profiles.stiffness.over(entries, chosen)

    def axial_entries(self, chosen: np.ndarray) -> dict[Monomial, np.ndarray]:
        """Return the part of `stiffness_entries` that resists extension."""
        if not self.is_beam:
            return {}
        others = [0.0] * (len(self.section.stiffness) - 1)
        entries = {
            monomial: self._undeformed_stiffness(chosen, (axial, *others))
            for monomial, axial in self.section.axial.terms
        }
        return self.profiles.stiffness.over(entries, chosen)

    def mass_entries(self, chosen: np.ndarray) -> dict[Monomial, np.ndarray]:
        """Return consistent element masses, (n_chosen, 6, 6), in space (n_chosen, 12, 12), by weight."""
        if not self.is_beam:
            return {}
        lengths, terms = self.mesh.lengths[chosen], self.section.terms("mass")
        if self.is_planar_beam:
            entries = {
                monomial: beam2d.consistent_mass(lengths, *coefficients) for monomial, coefficients in terms.items()
            }
        else:
            axes = self.axes[chosen]
            entries = {
                monomial: beam3d.consistent_mass(lengths, axes, np.array(coefficients))
                for monomial, coefficients in terms.items()
            }
        return self.profiles.mass.over(entries, chosen)

    def section_turns(self) -> np.ndarray:
        """Return how sections of a beam in space turn at its nodes with a linear field ``u = A X``, (n_nodes, 3, 9).

        A is taken row by row. A section's fibres move with the second and third columns of A in the element's axes; the
        rotation with the same moment of momentum is ``((J_22 A_32 - J_33 A_23) / (J_22 + J_33), A_13, -A_12)``. For
        spins it is the rotation itself; for strain rates it gives the moments of centripetal accelerations. Where the
        shape of the section depends on parameters, the share of J is that at the nominal values.
        """
        lever = self.lever
        local = np.zeros((3, 3, 3))
        local[0, 2, 1], local[0, 1, 2] = 0.5 * (1.0 + lever), -0.5 * (1.0 - lever)
        local[1, 0, 2], local[2, 0, 1] = 1.0, -1.0
        turned = np.einsum("ear,rst,ebs,ect->eabc", self.axes, local, self.axes, self.axes, optimize=True)
        lengths = self.mesh.lengths
        shares, found = np.zeros(self.n_nodes), np.zeros((self.n_nodes, 3, 9))
        for nodes in self.mesh.cells.T:
            np.add.at(shares, nodes, lengths)
            np.add.at(found, nodes, lengths[:, None, None] * turned.reshape(-1, 3, 9))
        return found / shares[:, None, None]

    def _undeformed_stiffness(self, chosen: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
        lengths = self.mesh.lengths[chosen]
        if self.is_planar_beam:
            return beam2d.undeformed_stiffness(lengths, self.directions[chosen], np.array(coefficients))
        return beam3d.undeformed_stiffness(lengths, self.axes[chosen], np.array(coefficients))


def _frame_mesh(centres: np.ndarray, points: Mapping[str, int]) -> LineMesh:
    """Return frames as nodes, joined one to the next for pictures."""
    order = np.arange(len(centres))
    return LineMesh(centres, np.column_stack([order[:-1], order[1:]]), dict(points))
