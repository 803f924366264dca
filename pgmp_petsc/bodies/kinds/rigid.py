"""A rigid body: its only node is its centre of mass. In the plane its mass is that of the node."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.bodies.affine import Monomial, Quantity, total_at
from pgmp_petsc.bodies.body import Body, Entries, LumpedMass, Lumps, dense_entries, frame_mesh
from pgmp_petsc.bodies.component import (
    Component,
    directors,
    of_directors,
    rigid_component,
    rigid_line,
    rigid_of_properties,
)
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.bodies.framed_solid import framed_solid
from pgmp_petsc.bodies.kinds.beam import axes_of
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body as BodyEntry

STEP_SECONDS = 1.0e-6
LEAST = 1e-3  # of the trace of the tensor of inertia: what a body lends at least


@dataclass(frozen=True, kw_only=True)
class RigidBody(Body):
    """A rigid body, from its mass properties, lines, a mesh or matrices, or a point mass."""

    #: its mass in space; None in the plane, and of a point mass, where `lumps` have it
    component: Component | None = None
    drawn: SolidMesh | LineMesh | None = None  # what pictures show; None where it is not known
    length: float | None = None  # its extent, m; None where it follows from the others

    flexible = False

    @classmethod
    def takes(cls, entry: BodyEntry, shape: BodyShape) -> bool:
        return shape.rigid if isinstance(shape, Component) else not (entry.flexible or isinstance(shape, FloatingBody))

    @classmethod
    def of(cls, scene: Scene, name: str, shape: BodyShape) -> RigidBody:
        """See `Body`; raises as `rigid_component`."""
        given = scene.bodies[name].rigid
        if given is not None:
            length = given.extent(lambda value: scene.number(value, scene.nominal))
            body = cls(name, cls._centre(shape.nodes[0]), shape, drawn=shape, length=length)
            if given.dimension == 3:
                return replace(body, component=rigid_of_properties(shape, given, scene.nominal))
            mass, inertia = Quantity.of(given.mass), Quantity.of(given.inertia)
            body = body.with_lumps(0, {mass.monomial: LumpedMass(mass.coefficient, 0.0)})
            return body.with_lumps(0, {inertia.monomial: LumpedMass(0.0, inertia.coefficient)})
        if isinstance(shape, LineMesh):
            section = BeamSection.of(scene, name)
            if scene.dimension == 2:
                return cls.of_lines(name, shape, section)
            component = rigid_line(shape, section.terms("mass"), axes_of(scene, name, shape))
            return cls(name, cls._centre(component.centre_of_mass), shape, component=component, drawn=shape)
        known = isinstance(shape, Component)
        component = shape if known else rigid_component(framed_solid(scene, name, shape).at(scene.values))
        body = cls.of_component(name, component)
        return body if body.drawn is not None else replace(body, drawn=body.shape)

    @classmethod
    def of_lines(cls, name: str, mesh: LineMesh, section: BeamSection) -> RigidBody:
        """Return a rigid body in the plane with the mass of beams along the lines of a mesh.

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
        return cls(name, cls._centre(centre), mesh, {0: lumps}, drawn=mesh)

    @classmethod
    def of_component(cls, name: str, component: Component) -> RigidBody:
        """Return a rigid body from the component that it is."""
        shape, mesh = frame_mesh(component.centres, component.frames), cls._centre(component.centre_of_mass)
        drawn = None if component.recovery is None else component.recovery.carrier
        if component.centres.shape[1] == 3:
            return cls(name, mesh, shape, component=component, drawn=drawn)
        lumps = {weight: LumpedMass(m[0, 0], m[2, 2]) for weight, m in component.mass.items()}
        return cls(name, mesh, shape, {0: lumps}, drawn=drawn)

    @staticmethod
    def _centre(place: np.ndarray) -> LineMesh:
        return LineMesh(place[None], np.empty((0, 2), dtype=int))

    @property
    def extent(self) -> float:
        if self.length is not None:
            return self.length
        if self.component is not None:
            return self.component.extent
        # one that a single joint holds: the bar with its radius of gyration
        return super().extent or max(
            float(np.sqrt(12.0 * lump.inertia / lump.mass)) for lump in self.lumps[0].values() if lump.mass
        )

    step_seconds = STEP_SECONDS

    @property
    def probes(self) -> np.ndarray | None:
        return None if self.component is None else self.component.probes

    @property
    def _mass(self) -> Mapping[Monomial, np.ndarray]:
        """The mass in space by weight, shape (6, 6)."""
        return {} if self.component is None else self.component.mass

    def mass_at(self, values: Mapping[str, float]) -> float:
        """Return the mass at parameter values, kg."""
        lumped = {weight: lump.mass for weight, lump in self.lumps.get(0, {}).items()}
        return total_at(lumped, values) + total_at({weight: float(m[0, 0]) for weight, m in self._mass.items()}, values)

    def carrying(self, node: int, lumps: Lumps, name: str) -> tuple[RigidBody, RigidBody]:
        """Return the body, and a point mass at a node of `shape` as a body of its own, to be welded to it: the mass
        matrices then stay constant, and affine in the parameters.

        The point mass borrows moment of inertia, by weight: both turn as one, so that nothing changes, but a particle
        without any would make the mass matrix singular.
        """
        own, lent = (self._lending_in_plane if self.component is None else self._lending_in_space)()
        mesh = self._centre(self.shape.nodes[node])
        return own, RigidBody(name, mesh, mesh, {0: dict(lumps)}, drawn=mesh).with_lumps(0, lent)

    def _lending_in_plane(self) -> tuple[RigidBody, dict[Monomial, LumpedMass]]:
        """Lend half the moment of inertia."""
        own = {weight: LumpedMass(lump.mass, 0.5 * lump.inertia) for weight, lump in self.lumps[0].items()}
        lent = {weight: LumpedMass(0.0, lump.inertia) for weight, lump in own.items() if lump.inertia}
        return replace(self, lumps={0: own}), lent

    def _lending_in_space(self) -> tuple[RigidBody, dict[Monomial, LumpedMass]]:
        """Lend the same moment of inertia about every axis, so little that a real body could have what is left.

        With the tensor of inertia J that body has ``int rho X X^T dV = 1/2 tr(J) 1 - J``, positive definite; half its
        smallest eigenvalue is left. Of a flat body, and of terms that are no bodies by themselves, it is a small share
        of the trace of J.
        """
        mass, lent = {}, {}
        shares = {w: float(np.linalg.eigvalsh(directors(m[3:, 3:]))[0]) for w, m in self.component.mass.items()}
        traces = {w: float(np.trace(m[3:, 3:])) for w, m in self.component.mass.items()}
        if any(share < LEAST * traces[w] or share < 0.0 for w, share in shares.items()):
            shares = {w: LEAST * trace for w, trace in traces.items()}
        for weight, matrix in self.component.mass.items():
            share = shares[weight]
            mass[weight] = matrix - np.diag([0.0, 0.0, 0.0, share, share, share])
            lent[weight] = LumpedMass(0.0, share)
        return replace(self, component=replace(self.component, mass=mass)), lent

    def own_weights(self, kind: str) -> set[Monomial]:
        return set(self._mass) if kind == "mass" else set()

    def _translating_weights(self) -> set[Monomial]:
        return {weight for weight, matrix in self._mass.items() if matrix[0, 0]}

    def entries(self, kind: str, rows: range) -> Iterator[Entries]:
        if self.component is not None:
            yield dense_entries(self.dofs, self.component.terms(kind))
        yield from super().entries(kind, rows)

    def node_masses(self) -> Iterator[tuple[int, dict[Monomial, tuple[float, np.ndarray]]]]:
        yield from super().node_masses()
        if self.component is not None:
            yield 0, {w: (float(np.trace(m[:3, :3])) / 3.0, m[3:, 3:]) for w, m in self._mass.items()}

    def linear_fields(self) -> np.ndarray:
        """See `Body`; in space the rigid motion that has the momenta of the fields."""
        return super().linear_fields() if self.component is None else self.component.fields

    def lost_momenta(self) -> Mapping[Monomial, np.ndarray]:
        return {} if self.component is None else self.component.lost_momenta

    def moments(self) -> Iterator[tuple[Monomial, np.ndarray, np.ndarray]]:
        for weight, matrix in self._mass.items():
            moments = of_directors(directors(matrix[3:, 3:])[None])
            for i in range(3):
                for j in range(3):
                    moments[0, i, j, i, j] += matrix[0, 0]
            yield weight, np.arange(self.dofs.size)[None], moments

    def director_inertia(self) -> Iterator[tuple[Monomial, np.ndarray, np.ndarray]]:
        for weight, matrix in self._mass.items():
            yield weight, np.array([0]), directors(matrix[3:, 3:])[None]
