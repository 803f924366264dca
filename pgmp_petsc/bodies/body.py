"""A body: its nodes in its own frame, its place among the unknowns, and what the rest of the program asks it for.

The nodes of a beam are those of its mesh; a rigid body has one, its centre of mass. A continuum body has one for each
of its frames, the groups of faces that joints and effects hold, and internal coordinates beside them.

In the body's frame the mass and the tangent stiffness at rest are constant for every configuration of the mechanism,
so both are made once (`bodies.matrices`).

Kinds of bodies are the subclasses in `bodies.kinds`, which are found. Nobody asks for the kind: what differs are
traits, and what a body hands out, here as of a body that has nothing of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from pgmp_petsc.base.errors import counted
from pgmp_petsc.base.units import UnitSystem
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import TURNS, linear_fields
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh

if TYPE_CHECKING:
    from pgmp_petsc.bodies.framed_solid import FramedSolid
    from pgmp_petsc.bodies.shape import BodyShape
    from pgmp_petsc.bodies.solid import FaceFrame
    from pgmp_petsc.bodies.stresses import BodyStresses
    from pgmp_petsc.scene import Scene
    from pgmp_petsc.scene.bodies import Body as BodyEntry

DOFS_PER_NODE = 3  # x, y, phi
Pairs = tuple[np.ndarray, np.ndarray]  # numbers of one vector and of the other, each (n_pairs,)
Entries = tuple[np.ndarray, np.ndarray, dict[Monomial, np.ndarray]]  # rows, columns, and values by weight, each (n,)


@dataclass(frozen=True)
class LumpedMass:
    """Rest of a node's own mass (kg) and moment of inertia (kg m2) when their weight is taken out."""

    mass: float
    inertia: float

    def __add__(self, other: LumpedMass) -> LumpedMass:
        return LumpedMass(self.mass + other.mass, self.inertia + other.inertia)


Lumps = Mapping[Monomial, LumpedMass]


def joined(lumps: Lumps, more: Lumps) -> dict[Monomial, LumpedMass]:
    """Return the masses of a node with further ones, those of the same weight together."""
    nothing = LumpedMass(0.0, 0.0)
    return {weight: lumps.get(weight, nothing) + more.get(weight, nothing) for weight in {**lumps, **more}}


@dataclass(frozen=True)
class Body(ABC):
    """A body of some kind."""

    name: str  # name in the scene
    #: nodes (m) in the body's own frame, and line cells; of a rigid body its centre of mass, without cells
    mesh: LineMesh
    shape: LineMesh  # the mesh that the scene gives, with the named points; `mesh` itself for a beam
    #: masses at nodes, by node (of the mesh) and weight
    lumps: dict[int, dict[Monomial, LumpedMass]] = field(default_factory=dict)
    first_node: int = 0  # number of the body's first node among all nodes of the mechanism
    first_internal: int = 0  # number of the body's first internal coordinate among all unknowns of the mechanism

    #: Whether the body deforms.
    flexible: ClassVar[bool] = True
    #: Whether all its flexible unknowns act on each other.
    dense: ClassVar[bool] = False
    #: Whether strains of its outermost fibres are known, of sections along lines.
    fibred: ClassVar[bool] = False
    #: Number of unknowns that are amplitudes of displacement fields in a frame of its own.
    n_amplitudes: ClassVar[int] = 0
    #: Number of elements that have sections of their own, not that of the body.
    n_own_sections: ClassVar[int] = 0
    #: What tells modes apart whatever its internal coordinates are, shape (n_dofs, n_probes), where these mean nothing.
    probes: ClassVar[np.ndarray | None] = None
    #: Number of internal coordinates: positions of the nodes of a mesh, or amplitudes.
    n_internal: ClassVar[int] = 0
    #: The global numbers of nodes that are no more than frames of what is behind them.
    tied_nodes: ClassVar[slice] = slice(0)
    #: Groups of faces on the mesh that the nodes follow, by name.
    face_frames: ClassVar[Mapping[str, FaceFrame]] = MappingProxyType({})
    #: Whether strains of second order follow from the unknowns as the frames of its nodes.
    strains_follow_frames: ClassVar[bool] = False
    #: See `Recovery.curved`; None where nothing of the kind is known, or needed.
    curved_strains: ClassVar[np.ndarray | None] = None
    #: The mesh or the matrices that a build condenses.
    to_condense: ClassVar[Sequence[FramedSolid]] = ()
    #: Whether its unknowns hold all that stresses need.
    answered: ClassVar[bool] = True
    #: Whether the third derivative of the strain energy is known.
    third_derivative_known: ClassVar[bool] = True

    @classmethod
    @abstractmethod
    def takes(cls, entry: BodyEntry, shape: BodyShape) -> bool:
        """Whether a scene's body, made of a shape, is of this kind."""

    @classmethod
    @abstractmethod
    def of(cls, scene: Scene, name: str, shape: Any) -> Body:
        """Make the body of a scene, which may be rigid; raises `InputError`."""

    # numbering

    def with_lumps(self, node: int, lumps: Lumps) -> Self:
        """Return the body with further masses at a node."""
        return replace(self, lumps={**self.lumps, node: joined(self.lumps.get(node, {}), lumps)})

    def numbered(self, first_node: int, first_internal: int) -> Self:
        """Return the body with its place in the numbering of all nodes and all unknowns."""
        return replace(self, first_node=first_node, first_internal=first_internal)

    def alone(self) -> Self:
        """Return the body as the only one of a mechanism."""
        return self.numbered(0, self.node_dofs * self.n_nodes)

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.mesh.nodes.shape[1]

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
        return self.dimension + len(TURNS[self.dimension])

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
    def own_dofs(self) -> np.ndarray:
        """The unknowns that have mass and stiffness, shape (n_own,)."""
        return self.dofs

    # what is known of it

    @property
    def points(self) -> np.ndarray:
        """Places at rest of what the internal coordinates are the positions of, shape (n, d), m."""
        return np.zeros((0, self.dimension))

    def at_points(self, vectors: np.ndarray) -> np.ndarray:
        """View what vectors (n_dofs, ...) have at the `points`, shape (n, d, ...)."""
        first, points = self.first_internal, self.points
        return vectors[first : first + points.size].reshape(*points.shape, *vectors.shape[1:])

    def moving_nodes(self, q: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Return where the nodes are that strains follow from, from unknowns (n_dofs, n) and frames of all nodes."""
        return frames[self.nodes]

    @property
    def extent(self) -> float:
        """A length that is typical of the body: its largest extent along an axis of its frame, or nearly so, m."""
        return float(np.max(np.ptp(self.shape.nodes, axis=0)))

    @property
    def drawn(self) -> SolidMesh | LineMesh | None:
        """Mesh that pictures show; None where it is not known."""
        return self.shape

    @property
    def size(self) -> tuple[int, int]:
        """Number of nodes and of cells of what the scene gives."""
        return len(self.shape.nodes), len(self.shape.cells)

    def described(self, system: UnitSystem) -> str:
        """Return the body in words: nodes and cells, and its size in units of a system."""
        n = len(self.mesh.cells)
        length = self.mesh.lengths.sum()
        return f"{self.n_nodes} nodes, {counted(n, 'element')}, {system.text(length, 'm', '.6g')}"

    @property
    @abstractmethod
    def step_seconds(self) -> float:
        """About how much of a processor a step of one sample takes on the mesh, s."""

    def stresses(self, scene: Scene) -> BodyStresses | None:
        """Return where and how the body has stresses; None where it is not known."""
        return None

    @property
    def by_node(self) -> np.ndarray:
        """Displacements of the nodes in the body's frame (of beams and rotations) for a unit of each unknown, or of
        each amplitude, shape (n_nodes, n_of_a_node, n)."""
        raise NotImplementedError

    def displacements(self, y: np.ndarray) -> np.ndarray:
        """Return those of unknowns (n_dofs, n), or of amplitudes, shape (n_nodes, n_of_a_node, n)."""
        return np.tensordot(self.by_node, y, 1)

    def in_frame(self, vectors: np.ndarray, n_frame_dofs: int) -> np.ndarray:
        """Return vectors (n, n_dofs, k) in the unknowns of the body condensed, which begin with those of its frames, in
        these."""
        return vectors

    def carrying(self, node: int, lumps: Lumps, name: str) -> tuple[Body, Body | None]:
        """Return the body with a point mass at a node of `shape`, and the body of some name that the mass is where it
        is one of its own."""
        return self.with_lumps(node, lumps), None

    # matrices

    def blocks(self, kernel: str) -> Sequence[Any]:
        """Return what a compiled kernel of elements takes: ``"beam2d"`` and ``"beam3d"`` bodies of beams, ``"cells"``
        solids, ``"floating"`` a `FloatingBody`."""
        return ()

    def own_weights(self, kind: str) -> set[Monomial]:
        """Return the weights of ``"mass"`` or ``"stiffness"`` without those of masses at nodes."""
        return set()

    def weights(self, kind: str) -> set[Monomial]:
        """Return the weights of the affine terms of ``"mass"`` or ``"stiffness"``; none of the stiffness of a rigid
        body."""
        return self.own_weights(kind) | (self._lumped_weights if kind == "mass" else set())

    @property
    def translational_weights(self) -> set[Monomial]:
        """Weights of the mass terms that resist translation."""
        lumped = {weight for lumps in self.lumps.values() for weight, lump in lumps.items() if lump.mass}
        return lumped | self._translating_weights()

    def _translating_weights(self) -> set[Monomial]:
        return self.own_weights("mass")

    @property
    def stiffness_ways(self) -> set[Monomial]:
        """Weights by which parameters change the stiffness otherwise than as a whole; none where it has but one."""
        every = self.own_weights("stiffness")
        return {weight for weight in every if weight.powers} if len(every) > 1 else set()

    def condensed_weights(self, kind: str) -> set[Monomial]:
        """Return the `weights` in a reduced model: those of the condensed body, if it is one."""
        return self.weights(kind)

    @property
    def _lumped_weights(self) -> set[Monomial]:
        return {weight for lumps in self.lumps.values() for weight in lumps}

    def entries(self, kind: str, rows: range) -> Iterator[Entries]:
        """Yield entries of ``"mass"``, ``"stiffness"`` or ``"stretching"``, the part of it that resists extension:
        those of some rows among all unknowns at least, in the body's frame."""
        if kind == "mass" and self.lumps:
            dofs, values = self.lumped_entries()
            yield dofs, dofs, values

    def lumped_entries(self) -> tuple[np.ndarray, dict[Monomial, np.ndarray]]:
        """Return the unknowns of nodes with masses of their own, and these masses by weight, each (n_lumped,)."""
        nodes, (n, d) = np.array(list(self.lumps), dtype=int), (self.node_dofs, self.dimension)
        values = {weight: np.zeros((nodes.size, n)) for weight in sorted(self._lumped_weights)}
        for row, lumps in enumerate(self.lumps.values()):
            for weight, lump in lumps.items():
                values[weight][row, :d], values[weight][row, d:] = lump.mass, lump.inertia
        dofs = n * (self.first_node + nodes)[:, None] + np.arange(n)
        return dofs.ravel(), {weight: part.ravel() for weight, part in values.items()}

    def node_masses(self) -> Iterator[tuple[int, dict[Monomial, tuple[float, np.ndarray]]]]:
        """Yield nodes in space with masses of their own, and these by weight: kg, and tensors of inertia (3, 3)."""
        for node, lumps in self.lumps.items():
            yield node, {weight: (lump.mass, lump.inertia * np.eye(3)) for weight, lump in lumps.items()}

    def linear_fields(self) -> np.ndarray:
        """Return the linear displacement fields of the body in its own frame, shape (n_body_dofs, d (d + 1)).

        They are ordered as in `linear_fields`; nodes follow those that are no rigid motion, turning as they do in the
        mean.
        """
        d, n = self.dimension, self.n_nodes
        nodal = np.zeros((n, self.node_dofs, d + d * d))
        nodal[:, :d] = linear_fields(self.mesh.nodes).reshape(n, d, -1)
        for row, (i, j) in enumerate(TURNS[d], d):
            nodal[:, row, d + d * j + i], nodal[:, row, d + d * i + j] = 0.5, -0.5
        nodal[:, d:, d:] = self._section_turns(nodal[:, d:, d:])
        return np.concatenate([nodal.reshape(-1, d + d * d), linear_fields(self.points)])

    def _section_turns(self, mean: np.ndarray) -> np.ndarray:
        """Return how the nodes turn with linear fields, shape (n_nodes, n_turns, d^2), from how they do in the mean."""
        return mean

    def lost_momenta(self) -> Mapping[Monomial, np.ndarray]:
        """Return by weight, shape (n_body_dofs, d (d + 1)), what inertia forces of `linear_fields` have beyond the mass
        terms times these: of terms that are no multiples of each other. At the nominal values it is nothing in sum."""
        return {}

    def moments(self) -> Iterator[tuple[Monomial, np.ndarray, np.ndarray]]:
        """Yield weights, unknowns (n_e, k) of the body alone and moments of inertia (n_e, d, d, k, k); see
        `bodies.matrices.inertia_moments`."""
        yield from ()

    def director_inertia(self) -> Iterator[tuple[Monomial, np.ndarray, np.ndarray]]:
        """Yield weights, nodes (n,) in space and the inertia of their directors (n, 3, 3), kg m2, but for `lumps`."""
        yield from ()

    def third_derivative(self, rows: range, n_dofs: int) -> ThirdPart | None:
        """Return the part of some rows of it; None of a body without strain energy."""
        return None


class ThirdPart(ABC):
    """The third derivative of the strain energy of a body, for rows among all unknowns."""

    #: weights, terms: of the affine terms
    weights: list[Monomial]
    terms: list[np.ndarray]

    @abstractmethod
    def forces(self, terms: Iterable[np.ndarray], vectors: np.ndarray, pairs: Pairs) -> Iterable[np.ndarray]:
        """Yield terms times pairs of vectors (n_dofs, m): forces on strains or unknowns, each of shape (n, n_pairs)."""

    @abstractmethod
    def add(self, forces: np.ndarray, total: np.ndarray) -> None:
        """Add forces to those on the rows, shape (n_rows, n_pairs)."""


@cache
def kinds() -> tuple[type[Body], ...]:
    """Return the kinds of bodies: all classes in `bodies.kinds`."""
    room = import_module("pgmp_petsc.bodies.kinds")
    for module in iter_modules(room.__path__, f"{room.__name__}."):
        import_module(module.name)
    return tuple(Body.__subclasses__())


def body_of(scene: Scene, name: str, shape: BodyShape) -> Body:
    """Return the body of a scene that is made of a shape. Raises `InputError` if shape and scene do not fit."""
    entry = scene.bodies[name]
    (kind,) = (kind for kind in kinds() if kind.takes(entry, shape))  # none or two are an error of the program
    return kind.of(scene, name, shape)


def dense_entries(dofs: np.ndarray, terms: Mapping[Monomial, np.ndarray]) -> Entries:
    """Return the entries of full matrices (n, n) by weight of some unknowns (n,)."""
    return np.repeat(dofs, dofs.size), np.tile(dofs, dofs.size), {w: matrix.ravel() for w, matrix in terms.items()}


def frame_mesh(centres: np.ndarray, points: Mapping[str, int]) -> LineMesh:
    """Return frames as nodes, joined one to the next for pictures."""
    order = np.arange(len(centres))
    return LineMesh(centres, np.column_stack([order[:-1], order[1:]]), dict(points), numbered=False)


def element_dofs(elements: np.ndarray, per_node: int = DOFS_PER_NODE) -> np.ndarray:
    """Return the unknowns of two-node elements, shape (n_elements, 2 per_node)."""
    return (per_node * elements[:, :, None] + np.arange(per_node)).reshape(len(elements), 2 * per_node)
