"""Strains, stresses and fields of bodies in the reduced model, from its coordinates.

Coordinates y of bodies follow from the modes, ``y = Psi(theta) delta`` (Naets et al. 2015, eq. (4)), and strains from
them as of all bodies that are condensed (`models.body_fields`). What modes leave out of the static answers to loads and
inertia forces is in the strains as far as the basis has it: `reduction.static_modes` and `reduction.inertia_modes`, on
bodies that are condensed with the answers to their own inertia forces.

Away from the nominal parameters a basis misses of the forces what hardly bends; `reduction.missed_answers` has what is
added to the strains.

Of second order in them, bodies of cells have the strains that `Recovery.curved` stands for besides. Linear strains of
what a body that bends is shorter by are none of it: of a rod of 0.3 m they were 0.4 % of its largest stress.

A reduced model of second order has beams with ``u = Psi delta + 1/2 chi delta delta``; their strains are taken in full
there, as those of the same order cancel in an extension: ``u' + 1/2 w'^2``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.bodies.beam_strains import BeamStrains
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.stresses import BeamLaw, SolidLaw, Strains
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import space_of
from pgmp_petsc.models.body_fields import (
    FieldPoints,
    Fields,
    FieldSet,
    carried,
    in_blocks,
    linear_maps,
    of_coordinates,
    placed,
    values_of,
    with_stresses,
)
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.missed_answers import Missed
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.border import si_values

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
