"""What the full-order equations of one sample are made of on one rank, in the plane and in space.

`FullDistributed` solves them, whichever they are: numbering, constraints, masses, elements and forces come from here.
In the plane the unknowns are those of nodes, ``(x, y, phi)``; in space natural coordinates
(`mechanism.unknowns`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import assemble, meshed_rows, owned_rows, weighted_sum
from pgmp_petsc.dynamics.body_damping import BodyDampings
from pgmp_petsc.dynamics.local_forces import LocalForces
from pgmp_petsc.dynamics.rank_beams import RankBeams, rank_beams
from pgmp_petsc.dynamics.rank_elements import RankElements
from pgmp_petsc.dynamics.rank_solids import RankSolid, rank_solids
from pgmp_petsc.dynamics.spatial_masses import SpatialMasses, spatial_masses
from pgmp_petsc.effects import Effect, actions_of, loads_of
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import PLANE
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.unknowns import Unknowns


class FullEquations(Protocol):
    """The equations of one sample on one rank.

    Attributes
    ----------
    n_dofs
        Number of unknowns.
    rows
        Those that this rank owns.
    units
        What the unknowns are measured in, over the mechanism's size or 1 rad: factors, shape (n_dofs,).
    constraints
        Without those that follow from others.
    mass
        This rank's rows, shape (n_rows, n_dofs).
    elements
        Beams and masses of nodes in the plane.
    parts
        Other elements.
    load_effects, load_vectors
        Effects with constant vectors, shape (n_loads, n_rows).
    local
        Effects between points.
    damping
        Structural damping.
    """

    n_dofs: int
    rows: range
    units: np.ndarray
    constraints: ConstraintSet
    mass: sp.csr_matrix
    elements: RankElements
    parts: Sequence[RankSolid | RankBeams | SpatialMasses]
    load_effects: Sequence[Effect]
    load_vectors: np.ndarray
    local: LocalForces
    damping: BodyDampings

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Return unknowns and velocities (n_dofs,) of the undeformed mechanism at the start."""

    def place(self, theta: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return unknowns and velocities (n_dofs,) of the undeformed mechanism for coordinates and rates (n_theta,)."""

    def follow(self, q: np.ndarray, time: float) -> None:
        """Take note of a state at an instant, unknowns (n_dofs,), for what counts turns."""

    def forget(self) -> None:
        """Forget the states of an instant that is not kept."""

    def frames(self, q: np.ndarray) -> np.ndarray:
        """Return the frames of all nodes as outputs take them, shape (n_nodes, n_frame, 1), for unknowns (n_dofs,
        1)."""


class PlanarEquations:
    """A mechanism in the plane; see `FullEquations`."""

    def __init__(
        self,
        kinematics: RigidKinematics,
        effects: Sequence[Effect],
        values: Mapping[str, float],
        initial: tuple[np.ndarray, np.ndarray],
        comm: MPI.Comm,
    ) -> None:
        mechanism = self._mechanism = kinematics.mechanism
        self._kinematics, self._initial = kinematics, initial
        self.constraints = ConstraintSet(Unknowns(mechanism)).independent(self.start()[0])
        self.n_dofs = mechanism.n_dofs
        self.rows = owned_rows(self.n_dofs, comm.rank, comm.size)
        matrices = assemble(mechanism.bodies, self.rows)
        loads = loads_of(effects, matrices)
        by_name = {effect.name: effect for effect in effects}
        self.load_effects = [by_name[load.effect] for load in loads]
        vectors = [load.weight.evaluate(values) * load.vector for load in loads]
        self.load_vectors = np.array(vectors).reshape(len(loads), len(self.rows))
        of_sample = {name: np.array([value]) for name, value in values.items()}
        self.local = LocalForces(actions_of(effects), of_sample, 1, mechanism.node_dofs)
        self.damping = BodyDampings.of(effects, mechanism)
        self.elements = RankElements(mechanism.bodies, self.rows, values, self.damping)
        self.parts = tuple(rank_solids(mechanism.bodies, self.rows, values, self.damping))
        self.mass = weighted_sum(matrices.mass, values)
        self.units = np.full(self.n_dofs, 1.0 / kinematics.size)
        mechanism.by_node(self.units)[:, 2] = 1.0

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the start."""
        return self.place(*self._initial)

    def place(self, theta: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the undeformed mechanism."""
        return self._kinematics.undeformed(theta, rates)

    def follow(self, q: np.ndarray, time: float) -> None:
        """Do nothing: angles count turns."""

    def forget(self) -> None:
        """Do nothing."""

    def frames(self, q: np.ndarray) -> np.ndarray:
        """Return ``(x, y, phi)``."""
        return self._mechanism.by_node(q)


class SpatialEquations:
    """A mechanism in space; see `FullEquations`."""

    def __init__(
        self,
        kinematics: RigidKinematics,
        effects: Sequence[Effect],
        values: Mapping[str, float],
        initial: tuple[np.ndarray, np.ndarray],
        comm: MPI.Comm,
    ) -> None:
        mechanism = kinematics.mechanism
        unknowns = self._unknowns = Unknowns(mechanism)
        self._kinematics, self._initial = kinematics, initial
        joints = [c.connection for c in mechanism.coordinates]
        self._angles = StatementRows([j.angle for j in joints], [j.sides for j in joints], unknowns.frame, 3)
        self.n_dofs = unknowns.n_dofs
        self.rows = owned_rows(self.n_dofs, comm.rank, comm.size)
        actions = [action for effect in effects for action in effect.natural_actions()]
        of_sample = {name: np.array([value]) for name, value in values.items()}
        self.local = LocalForces(actions, of_sample, 1, unknowns.frame, 3)
        self.constraints = ConstraintSet(unknowns).independent(self.start()[0])
        self.damping = BodyDampings.of(effects, mechanism, unknowns.bodies)
        self.elements = RankElements((), self.rows, values, self.damping)
        masses = (
            *rank_beams(unknowns, self.rows, values, self.damping),
            *spatial_masses(unknowns, self.rows, values, self.damping),
        )
        self.parts = (*rank_solids(unknowns.bodies, self.rows, values, self.damping), *masses)
        self.mass = _mass(unknowns.bodies, masses, self.rows, values, self.n_dofs)
        vectors = {effect: effect.natural_load(unknowns, self.mass, self.rows, values) for effect in effects}
        vectors = {effect: vector for effect, vector in vectors.items() if vector is not None}
        self.load_effects = list(vectors)
        self.load_vectors = np.array(list(vectors.values())).reshape(len(vectors), len(self.rows))
        self.units = np.full(self.n_dofs, 1.0 / kinematics.size)
        unknowns.frames(self.units)[:, 3:] = 1.0

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the start, from where turns are counted."""
        return self.place(*self._initial)

    def place(self, theta: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the undeformed mechanism, from where turns are counted."""
        self._counted, self._known = np.array(theta, dtype=float), np.array(theta, dtype=float)
        self._time = 0.0
        self.local.count_from(self._counted)
        poses = self._kinematics.poses(theta)
        turning = self._kinematics.rates(poses)[..., 0] @ rates
        return self._unknowns.place(poses[..., 0]), self._unknowns.place(turning)

    def follow(self, q: np.ndarray, time: float) -> None:
        """Count the turns of the coordinates from the instant before."""
        if time != self._time:
            self._known, self._time = self._counted.copy(), time
        if np.all(np.isfinite(q)):
            self._counted = self._angles.values(q, self._known)

    def forget(self) -> None:
        """Go back to the instant before."""
        self._counted = self._known.copy()
        self.local.forget(np.ones(1, dtype=bool))

    def frames(self, q: np.ndarray) -> np.ndarray:
        """Return position, directors and the coordinates."""
        self.follow(q[:, 0], self._time)
        frames = self._unknowns.frames(q)
        counted = np.broadcast_to(self._counted[None, :, None], (len(frames), self._counted.size, 1))
        return np.concatenate([frames, counted], axis=1)


def full_equations(
    kinematics: RigidKinematics,
    effects: Sequence[Effect],
    values: Mapping[str, float],
    initial: tuple[np.ndarray, np.ndarray],
    comm: MPI.Comm,
) -> FullEquations:
    """Return the equations of one sample on this rank.

    Parameters
    ----------
    kinematics
        Rigid kinematics; the start is an undeformed configuration.
    effects
        Effects of the scene.
    values
        Parameter values.
    initial
        Positions (rad) and velocities (rad/s) of the rigid coordinates at the start, each of shape (n_theta,).
    comm
        Ranks that share the model.
    """
    make = PlanarEquations if kinematics.mechanism.space is PLANE else SpatialEquations
    return make(kinematics, effects, values, initial, comm)


def _mass(
    bodies: Sequence[Body],
    masses: Sequence[RankBeams | SpatialMasses],
    rows: range,
    values: Mapping[str, float],
    n_dofs: int,
) -> sp.csr_matrix:
    """Return the given rows of the mass matrix of meshes, beams and frames."""
    row, column, data = [], [], []
    for body in bodies:
        if body.meshed is not None:
            for weight, matrix in meshed_rows(body, rows, "mass").items():
                row.append(matrix.row)
                column.append(matrix.col)
                data.append(float(weight.evaluate(values)) * matrix.data)
    for part in masses:
        row.append(np.repeat(part.dofs, part.dofs.shape[1], axis=1).ravel())
        column.append(np.tile(part.dofs, (1, part.dofs.shape[1])).ravel())
        data.append(part.mass.ravel())
    row, column, data = map(np.concatenate, (row, column, data))
    owned = (row >= rows.start) & (row < rows.stop)
    return sp.coo_matrix((data[owned], (row[owned] - rows.start, column[owned])), shape=(len(rows), n_dofs)).tocsr()
