"""Where the nodes of bodies are, and their stresses at nodes and in cells, at some instants of one sample.

The models know both in their own ways (`models.stresses`): a full-order model has the positions of its meshes. A body
that is condensed has ``x = p + R (X + T y)`` with its pose and its coordinates y, a reduced model ``y = Psi(theta)
delta``, and of second order ``1/2 chi delta delta`` besides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.stresses import Strains
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import Space
from pgmp_petsc.mechanism.unknowns import Unknowns
from pgmp_petsc.models.field_points import FieldPoints, FieldSet, Values
from pgmp_petsc.models.stresses import FullStrains, ReducedStrains
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel

AT_ONCE = 2**22  # numbers that are evaluated together: 32 MB


@dataclass(frozen=True, eq=False)
class BodyValues:
    """One body at some instants."""

    positions: np.ndarray  # of the nodes, ground frame, shape (n_nodes, d, n), m
    #: at_nodes, at_cells: quantities, of shape (n_nodes, n) and (n_cells, n)
    at_nodes: Values
    at_cells: Values


Fields = dict[str, BodyValues]


class FullFields:
    """Fields of the bodies wanted from the unknowns of a full-order or a component model."""

    def __init__(self, seen: FieldSet, unknowns: Unknowns) -> None:
        self.seen, self._unknowns, self._strains = seen, unknowns, FullStrains(unknowns)

    @property
    def at_once(self) -> int:
        """Instants that are best evaluated together."""
        return instants_at_once(self.seen)

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
            places = placed(space, frames[body.nodes.stop - 1], undeformed(field) + moved)
        else:
            places = body.moving_nodes(q, frames)[:, : space.dimension]
        return with_stresses(field, places, lambda points: self._strains.of(field.number, points, q), values)


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

    @property
    def at_once(self) -> int:
        """Instants that are best evaluated together."""
        return instants_at_once(self.seen)

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
            places = placed(space, poses[number], undeformed(field) + moved)

            def strains(points: Strains, field: FieldPoints = field) -> np.ndarray:
                y, unmet = strained[field.number], missed.get(field.number)
                return self._strains.of(field.number, points, field.stresses.law, y, unmet, values)

            found[name] = with_stresses(field, places, strains, values)
        return found


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


def undeformed(field: FieldPoints) -> np.ndarray:
    """Return a body's nodes in its frame, shape (n_nodes, d, 1)."""
    return field.mesh.nodes[:, :, None]


def placed(space: Space, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return where points (n_nodes, d, n or 1) in a frame at poses (n_pose, n) are, shape (n_nodes, d, n):
    ``x = p + sum_k d_k X_k``."""
    natural, d = space.natural(pose), points.shape[1]
    return natural[:d] + np.einsum("akn,kcn->acn", points, natural[d:].reshape(d, d, -1))


def instants_at_once(seen: FieldSet) -> int:
    """Return how many instants are best evaluated together."""
    return max(1, AT_ONCE // max([1, *(field.width for field in seen.points.values())]))


def joined(parts: list[Fields]) -> Fields:
    """Return fields of instants one after the other."""

    def along(tables: list[Values]) -> Values:
        return {name: np.concatenate([table[name] for table in tables], axis=1) for name in tables[0]}

    return {
        name: BodyValues(
            np.concatenate([part[name].positions for part in parts], axis=2),
            along([part[name].at_nodes for part in parts]),
            along([part[name].at_cells for part in parts]),
        )
        for name in (parts[0] if parts else ())
    }
