"""Where the nodes of bodies are, and their stresses at nodes, in cells and where outputs ask for them.

A full-order model has the positions of its meshes, and strains of these. A body that is condensed has ``x = p + R (X +
T y)`` with its pose and its coordinates y, and strains ``S y`` linear in these with a constant matrix S: those of the
displacements T y. In the component model y are the amplitudes of its fields. Visible are the bodies whose meshes a
model knows.

In the reduced model they follow from the modes, ``y = Psi(theta) delta`` (Naets et al. 2015, eq. (4)). What modes leave
out of the static answers to loads and inertia forces is in the strains as far as the basis has it:
`reduction.static_modes` and `reduction.inertia_modes`, on bodies that are condensed with the answers to their own
inertia forces.

Away from the nominal parameters a basis misses of the forces what hardly bends; `reduction.missed_answers` has what is
added to the strains.

Of second order in them, bodies of cells have the strains that `Recovery.curved` stands for besides. Linear strains of
what a body that bends is shorter by are none of it: of a rod of 0.3 m they were 0.4 % of its largest stress.

A reduced model of second order has beams with ``u = Psi delta + 1/2 chi delta delta``; their strains are taken in full
there, as those of the same order cancel in an extension: ``u' + 1/2 w'^2``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.floating import products
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.stresses import EXTREMES, FURTHEST, BeamLaw, SolidLaw, Strains
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.mechanism.space import Space, space_of
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.missed_answers import Missed
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.references import stressed_bodies
from pgmp_petsc.scene.units import si_values

if TYPE_CHECKING:
    from pgmp_petsc.outputs.stress import StressOutput


LARGEST = 2**28  # bytes of the fields of bodies that no stress output names, over all frames
AT_ONCE = 2**22  # numbers that are evaluated together: 32 MB
ROD = 0.02  # radius of the lines of a body without a section over its extent
Quantities = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Stresses:
    """Where and how a flexible body has stresses."""

    #: nodal, inner: points at the nodes, one for each material or element that meets there, and in the middles of the
    #: cells
    nodal: Strains
    inner: Strains
    law: SolidLaw | BeamLaw  # what makes quantities of strains
    units: dict[str, str]  # of the quantities

    def at_nodes(self, strains: np.ndarray, values: Mapping[str, float]) -> Quantities:
        """Return all quantities at the nodes, each of shape (n_nodes, n), for strains (n_points, n_strains, n)."""
        found = self.law.values(self.units, self.nodal, self.law.forces(self.nodal, strains, values), values)
        return {quantity: EXTREMES.get(quantity, FURTHEST)(own[self._by_node]) for quantity, own in found.items()}

    def at_cells(self, strains: np.ndarray, values: Mapping[str, float]) -> Quantities:
        """Return all quantities in the middles of the cells, each of shape (n_cells, n), as `at_nodes`."""
        return self.law.values(self.units, self.inner, self.law.forces(self.inner, strains, values), values)

    @cached_property
    def _by_node(self) -> np.ndarray:
        """The points of every node, the first of them again where there are fewer, shape (k, n_nodes)."""
        nodes = self.nodal.nodes
        order, counts = np.argsort(nodes, kind="stable"), np.bincount(nodes)
        return order[np.cumsum(counts) - counts + np.minimum(np.arange(counts.max())[:, None], counts - 1)]


@dataclass(frozen=True, eq=False)
class FieldPoints:
    """A body that can be seen."""

    number: int  # of the body
    mesh: SolidMesh | LineMesh  # its cells, or the lines of beams
    stresses: Stresses | None  # none of a rigid body
    radius: float | None  # of beams: that of the circle with the section's radius of gyration, m; None of cells

    @property
    def units(self) -> dict[str, str]:
        """Quantities with their units; none of a rigid body."""
        return {} if self.stresses is None else self.stresses.units

    @property
    def frame_bytes(self) -> int:
        """Memory that a frame takes, as results keep it."""
        n_nodes, n_cells = len(self.mesh.nodes), len(self.mesh.cells)
        return 8 * (n_nodes * (9 + len(self.units)) + n_cells * len(self.units))

    @property
    def width(self) -> int:
        """Numbers that an instant takes while it is evaluated."""
        return self.mesh.nodes.size if self.stresses is None else max(self.mesh.nodes.size, self.stresses.nodal.width)


@dataclass(frozen=True, eq=False)
class FieldSet:
    """The bodies whose fields are kept."""

    points: dict[str, FieldPoints]  # by body
    left_out: dict[str, str]  # why other bodies are not among them, by body, with the cure

    @classmethod
    def of(cls, scene: Scene, bodies: tuple[Body, ...], n_frames: int) -> FieldSet:
        """Choose them among the model's bodies; `n_frames` are stored."""
        if not n_frames:
            return cls({}, {})
        points, left_out = {}, {}
        for number, body in enumerate(bodies):
            if body.name not in scene.bodies:
                continue  # a point mass
            if scene.bodies[body.name].section_scale is not None:
                left_out[body.name] = "its cross-section scales, and its mesh is that of scale 1"
                continue
            mesh = body.drawn
            if mesh is None:
                left_out[body.name] = (
                    "the reduced model is without its large mesh; name a stress output of it, and build again"
                )
            elif len(mesh.cells):
                points[body.name] = _points(scene, number, body, mesh)
        asked, taken = stressed_bodies(scene), 0
        for name, field in sorted(points.items(), key=lambda item: (item[0] not in asked, item[1].frame_bytes)):
            size = n_frames * field.frame_bytes
            if name in asked or taken + size <= LARGEST:
                taken += 0 if name in asked else size
                continue
            del points[name]
            left_out[name] = (
                f"{n_frames} frames of it take {size / 1e6:.0f} MB; store fewer (--override simulation.frames=N), or "
                "name a stress output of it"
            )
        return cls(points, left_out)

    @property
    def at_once(self) -> int:
        """Instants that are best evaluated together."""
        return max(1, AT_ONCE // max([1, *(field.width for field in self.points.values())]))


def _points(scene: Scene, number: int, body: Body, mesh: SolidMesh | LineMesh) -> FieldPoints:
    stresses, here = None, body.stresses(scene)
    if here is not None:
        stresses = Stresses(here.everywhere(), here.in_middles(), here.law, here.units)
    return FieldPoints(number, mesh, stresses, _radius(scene, body) if mesh.kind == "line" else None)


def _radius(scene: Scene, body: Body) -> float:
    """Return the radius of a circle with the radius of gyration of a section of beams: ``r^2 = 4 I / A``, m; of a rigid
    body without a section one that is seen."""
    if scene.bodies[body.name].section is None:
        return ROD * body.extent
    section = BeamSection.of(scene, body.name)
    resists = np.mean([float(part.at(scene.values)) for part in section.bending])
    return float(2.0 * np.sqrt(resists / float(section.axial.at(scene.values))))


@dataclass(frozen=True, eq=False)
class BodyValues:
    """One body at some instants."""

    positions: np.ndarray  # of the nodes, ground frame, shape (n_nodes, d, n), m
    #: at_nodes, at_cells: quantities, of shape (n_nodes, n) and (n_cells, n)
    at_nodes: Quantities
    at_cells: Quantities


Fields = dict[str, BodyValues]


class FullFields:
    """Fields of the bodies wanted from the unknowns of a full-order or a component model."""

    def __init__(self, seen: FieldSet, unknowns: Unknowns) -> None:
        self.seen, self._unknowns = seen, unknowns

    def of(self, q: np.ndarray, values: Mapping[str, float]) -> Fields:
        """Return the fields for unknowns (n_dofs, n)."""
        frames = self._unknowns.frames(q)
        return {name: self._of(field, q, frames, values) for name, field in self.seen.points.items()}

    def _of(self, field: FieldPoints, q: np.ndarray, frames: np.ndarray, values: Mapping[str, float]) -> BodyValues:
        body, space = self._unknowns.bodies[field.number], self._unknowns.mechanism.space
        if not body.flexible:
            return carried(space, field, body, frames[body.nodes.start])
        if body.n_amplitudes:
            moved = body.displacements(q[body.internal])[:, : space.dimension]
            places = placed(space, frames[body.nodes.stop - 1], field.mesh.nodes[:, :, None] + moved)
        else:
            places = body.moving_nodes(q, frames)[:, : space.dimension]
        return with_stresses(
            field, places, lambda points: full_strains(self._unknowns, field.number, points, q), values
        )


def carried(space: Space, field: FieldPoints, body: Body, frame: np.ndarray) -> BodyValues:
    """Return a rigid body whose node, its centre of mass, has frames (n_frame, n)."""
    arms = field.mesh.nodes - body.mesh.nodes[0]
    return BodyValues(placed(space, frame, arms[:, :, None]), {}, {})


def with_stresses(
    field: FieldPoints, places: np.ndarray, strains: Callable[..., np.ndarray], values: Mapping[str, float]
) -> BodyValues:
    """Return a flexible body at places (n_nodes, d, n), with the stresses of the strains of points."""
    own = field.stresses
    return BodyValues(places, own.at_nodes(strains(own.nodal), values), own.at_cells(strains(own.inner), values))


def placed(space: Space, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return where points (n_nodes, d, n or 1) in a frame at poses (n_pose, n) are, shape (n_nodes, d, n):
    ``x = p + sum_k d_k X_k``."""
    natural, d = space.natural(pose), points.shape[1]
    return natural[:d] + np.einsum("akn,kcn->acn", points, natural[d:].reshape(d, d, -1))


def joined(parts: list[Fields]) -> Fields:
    """Return fields of instants one after the other."""

    def along(tables: list[Quantities]) -> Quantities:
        return {name: np.concatenate([table[name] for table in tables], axis=1) for name in tables[0]}

    return {
        name: BodyValues(
            np.concatenate([part[name].positions for part in parts], axis=2),
            along([part[name].at_nodes for part in parts]),
            along([part[name].at_cells for part in parts]),
        )
        for name in (parts[0] if parts else ())
    }


def full_strains(
    unknowns: Unknowns, number: int, points: Strains, q: np.ndarray, linear: np.ndarray | None = None
) -> np.ndarray:
    """Return the strains of points of a body, shape (n_points, n_strains, n), from the unknowns (n_dofs, n) of a
    full-order or a component model; `linear` is the matrix S of a body that is condensed, where it is at hand."""
    body = unknowns.bodies[number]
    if body.n_amplitudes:
        return of_coordinates(body, points, q[body.internal], linear)
    return points.of_places(body.moving_nodes(q, unknowns.frames(q)))


class FullStresses:
    """Stresses, outputs of the scene, from the unknowns of a full-order or a component model."""

    def __init__(self, outputs: OutputSet, unknowns: Unknowns) -> None:
        self._stresses, self._unknowns = outputs.stresses, unknowns
        self._linear = linear_maps(
            [s for s in outputs.stresses if unknowns.bodies[s.body].n_amplitudes], unknowns.bodies
        )

    def of(self, q: np.ndarray, values: Values) -> np.ndarray:
        """Return the stresses, shape (n_stresses, n), for unknowns (n_dofs, n); values are numbers or of shape (n,)."""

        def forces(number: int, part: slice) -> np.ndarray:
            stress = self._stresses[number]
            linear = self._linear.get(stress.name)
            strains = full_strains(self._unknowns, stress.body, stress.points, q[:, part], linear)
            return stress.law.forces(stress.points, strains, values_of(values, part))

        return in_blocks(self._stresses, forces, q.shape[1], values)


def of_coordinates(body: Body, points: Strains, y: np.ndarray, linear: np.ndarray | None) -> np.ndarray:
    """Return strains that are linear in a body's coordinates y (n_dofs, n), by the matrix S where it is at hand."""
    if linear is None:
        return points.of_displacements(body.displacements(y))
    return products(linear.reshape(1, -1, linear.shape[2]), y[None]).reshape(*linear.shape[:2], y.shape[1])


def linear_maps(stresses: Iterable[StressOutput], bodies: Sequence[Body]) -> dict[str, np.ndarray]:
    """Return S of each stress, shape (n_points, n_strains, n_dofs), by its name."""
    found = {}
    for stress in stresses:
        by_node = bodies[stress.body].by_node
        parts = (stress.points.of_displacements(by_node[..., part]) for part in _blocks(stress, by_node.shape[2]))
        found[stress.name] = np.concatenate(list(parts), axis=2)
    return found


def in_blocks(
    stresses: Sequence[StressOutput], forces: Callable[[int, slice], np.ndarray], n: int, values: Values
) -> np.ndarray:
    """Return stress outputs of n instants, shape (n_stresses, n), from the forces of some at a time."""
    found = np.empty((len(stresses), n))
    for number, (row, stress) in enumerate(zip(found, stresses)):
        for part in _blocks(stress, n):
            row[part] = stress.value(forces(number, part), values_of(values, part))
    return found


def _blocks(stress: StressOutput, n: int) -> Iterator[slice]:
    """Yield parts of n columns that are evaluated together."""
    step = max(1, AT_ONCE // max(1, stress.points.width))
    for first in range(0, n, step):
        yield slice(first, min(first + step, n))


def values_of(values: Values, part: slice) -> dict[str, np.ndarray | float]:
    """Return the parameter values of some samples; numbers are those of all."""
    return {name: value[part] if np.ndim(value) and np.size(value) > 1 else value for name, value in values.items()}


STATES = 2**12  # states in which the models of several lengths are evaluated together


class ReducedStrains:
    """Coordinates of the flexible bodies with these numbers in their frames and their strains, from reduced
    coordinates, by the model's projection and its interpolation."""

    def __init__(
        self, kinematics: RigidKinematics, rom: ReducedOrderModel, scheme: str, numbers: Collection[int]
    ) -> None:
        self.bodies = kinematics.mechanism.bodies
        self._nominal = si_values(kinematics.mechanism.scene, rom.record.parameters)
        self._curved, self._n_theta = rom.curvature is not None, rom.tables.n_coordinates
        self._shapes = {number: rom.displacements(scheme, self.bodies[number].dofs) for number in numbers}
        self._strained = {
            number: _strained(shapes, rom, self.bodies[number], scheme) for number, shapes in self._shapes.items()
        }
        models = () if rom.missed is None else rom.between or ((1.0, rom),)
        self._missed = [(share, Missed(one.missed, one.tables, scheme)) for share, one in models]
        self._rows = {
            number: np.searchsorted(rom.missed.dofs, self.bodies[number].dofs)
            for number in (() if rom.missed is None else numbers)
            if np.isin(self.bodies[number].dofs, rom.missed.dofs).all()
        }

    def coordinates(self, eta: np.ndarray) -> dict[int, np.ndarray]:
        """Return those of the bodies, each (n_dofs, n), for reduced coordinates (n, n_eta)."""
        return self._products(self._shapes, eta)

    def strained(self, eta: np.ndarray) -> dict[int, np.ndarray]:
        """Return those whose linear strains are the bodies', each (n_dofs, n): see `Recovery.curved`."""
        return self._products(self._strained, eta)

    def _products(self, shapes: Mapping[int, Interpolant], eta: np.ndarray) -> dict[int, np.ndarray]:
        theta, delta = eta[:, : self._n_theta], eta[:, self._n_theta :]
        return {number: own.product(theta, delta).T for number, own in shapes.items()}

    def missed(self, eta: np.ndarray, values: Values) -> dict[int, np.ndarray]:
        """Return what is missed of them away from the nominal parameters, (n_dofs, n), with the nominal stiffness;
        nothing of bodies without stress outputs when the model was built."""
        if not self._rows:
            return {}
        found = sum(share * one.of(eta, values) for share, one in self._missed)
        return {number: found[rows] for number, rows in self._rows.items()}

    def of(
        self, number: int, points: Strains, law: SolidLaw | BeamLaw, y: np.ndarray, missed: np.ndarray | None,
        values: Values, linear: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Return the strains of points of a body, shape (n_points, n_strains, n), for what `strained` and
        `missed` return of it."""
        body = self.bodies[number]
        # the forces are the same at other values, but for which the body is stiffer or softer
        softer = None if missed is None else law.softening(points, self._nominal, values)
        if self._curved and body.strains_follow_frames:
            found = _of_beams(body, points, y)
        elif softer is not None and softer.shape[:2] == (1, 1):  # one factor for all points
            return of_coordinates(body, points, y + softer[0] * missed, linear)
        else:
            found = of_coordinates(body, points, y, linear)
        return found if missed is None else found + softer * of_coordinates(body, points, missed, linear)


class ReducedStresses:
    """Stresses, outputs of the scene, from coordinates of a reduced model with its projection."""

    def __init__(self, scene: Scene, outputs: OutputSet, kinematics: RigidKinematics, rom: ReducedOrderModel) -> None:
        self.stresses, numbers = outputs.stresses, {stress.body for stress in outputs.stresses}
        self._strains = ReducedStrains(kinematics, rom, scene.interpolation, numbers)
        self._linear = linear_maps(outputs.stresses, kinematics.mechanism.bodies)

    def of(self, eta: np.ndarray, values: Values) -> np.ndarray:
        """Return the stresses, shape (n_stresses, n), for eta (n, n_eta); values are numbers, or of shape (n,)."""
        return in_blocks(self.stresses, self.forces(eta, values), len(eta), values)

    def forces(self, eta: np.ndarray, values: Values) -> Callable[[int, slice], np.ndarray]:
        """Return what gives the forces of the law of a stress with a number, shape (n_points, n_forces, k), in k of the
        states."""
        coordinates, missed = self._strains.strained(eta), self._strains.missed(eta, values)

        def forces(number: int, part: slice) -> np.ndarray:
            stress, own = self.stresses[number], values_of(values, part)
            unmet = missed.get(stress.body)
            strains = self._strains.of(
                stress.body, stress.points, stress.law, coordinates[stress.body][:, part],
                None if unmet is None else unmet[:, part], own, self._linear[stress.name],
            )  # fmt: skip
            return stress.law.forces(stress.points, strains, own)

        return forces


class LengthStresses:
    """Stresses of reduced samples with lengths of their own: what laws make of forces that are interpolated as the
    tables are, between those that the model at each point of the grid has.

    `shares` gives those of the models, shape (n_models, n). A place may lie where two elements meet at some lengths
    alone: forces there are those of one of them, twice, at the others.
    """

    def __init__(self, members: Sequence[ReducedStresses], shares: Callable[[Values, int], np.ndarray]) -> None:
        self._members, self._shares = members, shares
        self.stresses = tuple(
            max(each, key=lambda stress: stress.points.n_points) for each in zip(*(one.stresses for one in members))
        )

    def of(self, eta: np.ndarray, values: Values) -> np.ndarray:
        """Return the stresses; see `ReducedStresses.of`."""
        found = np.empty((len(self.stresses), len(eta)))
        for first in range(0, len(eta), STATES):  # every model keeps the coordinates of its bodies in these
            part = slice(first, first + STATES)
            found[:, part] = self._of(eta[part], values_of(values, part))
        return found

    def _of(self, eta: np.ndarray, values: Values) -> np.ndarray:
        shares = self._shares(values, len(eta))
        forces = [one.forces(eta, values) for one in self._members]

        def summed(number: int, part: slice) -> np.ndarray:
            points = np.arange(self.stresses[number].points.n_points)
            each = (own(number, part) for own in forces)
            return sum(share[part] * own[np.minimum(points, len(own) - 1)] for share, own in zip(shares, each))

        return in_blocks(self.stresses, summed, len(eta), values)


def _strained(shapes: Interpolant, rom: ReducedOrderModel, body: Body, scheme: str) -> Interpolant:
    """Return the shapes of a body with those of pairs of modes that have its strains."""
    of_pairs = None if rom.curvature is None else body.curved_strains
    if of_pairs is None:
        return shapes
    projection, rows = rom.projection[:, body.dofs], shapes.rows.copy()
    (n, n_dofs, m), packed = projection.shape, np.tril_indices(projection.shape[1])
    whole = np.empty((n_dofs, n_dofs, n_dofs))
    whole[packed] = whole[packed[::-1]] = of_pairs
    found, pairs = np.empty((n, m * (m + 1) // 2, n_dofs)), np.tril_indices(m)
    for modes, own in zip(projection, found):
        own[:] = np.einsum("maj,an->mnj", np.tensordot(modes.T, whole, 1), modes, optimize=True)[pairs]
    rows[..., m:, :] += interpolant(rom.tables.samples, found, scheme).rows
    return replace(shapes, rows=rows)


def _of_beams(body: Body, points: BeamStrains, y: np.ndarray) -> np.ndarray:
    """Return the strains of beams, those of second order in the deformation among them, for unknowns (n_dofs, n) in the
    body's frame."""
    space = space_of(body.dimension)
    rest = space.place(space.identity, body.mesh.nodes)[:, :, None]
    return points.of_places(space.displaced(rest, y.reshape(body.n_nodes, body.node_dofs, -1)))


class ReducedFields:
    """Fields of the bodies wanted from reduced coordinates, by the model's projection and its interpolation."""

    def __init__(self, seen: FieldSet, kinematics: RigidKinematics, rom: ReducedOrderModel, scheme: str) -> None:
        self.seen, self._kinematics, bodies = seen, kinematics, kinematics.mechanism.bodies
        numbers = [field.number for field in seen.points.values()]
        self._strains = ReducedStrains(
            kinematics, rom, scheme, [number for number in numbers if bodies[number].flexible]
        )
        self._rigid = {
            number: Reconstruction(kinematics, rom, scheme, [bodies[number].nodes.start])
            for number in numbers
            if not bodies[number].flexible
        }

    def of(self, eta: np.ndarray, values: Mapping[str, float]) -> Fields:
        """Return the fields for reduced coordinates (n, n_eta)."""
        poses = self._kinematics.poses(eta[:, : self._kinematics.n_coordinates])
        coordinates, strained = self._strains.coordinates(eta), self._strains.strained(eta)
        missed = self._strains.missed(eta, values)
        space, found = self._kinematics.mechanism.space, {}
        for name, field in self.seen.points.items():
            number, body = field.number, self._strains.bodies[field.number]
            if number in self._rigid:
                found[name] = carried(space, field, body, self._rigid[number].frames(eta)[0])
                continue
            moved = body.displacements(coordinates[number])[:, : space.dimension]
            places = placed(space, poses[number], field.mesh.nodes[:, :, None] + moved)

            def strains(points: Strains, field: FieldPoints = field) -> np.ndarray:
                y, unmet = strained[field.number], missed.get(field.number)
                return self._strains.of(field.number, points, field.stresses.law, y, unmet, values)

            found[name] = with_stresses(field, places, strains, values)
        return found
