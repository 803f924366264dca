"""What joints that are off build into a mechanism, at any configuration: the static answer to a unit of each offset.

The rigid mechanism closes with its joints where they should be. There the constraints of the motion miss by gaps that
are linear in small offsets p, the parameters that entries of ``offset`` name and a 1 for their numbers,

    c(rho(theta)) = gamma(theta) p,     [K C^T; C 0] [X; L] = [0; -gamma],     T X = 0,

with the statements T of the coordinates, so that theta stays what the joints show. Displacements are ``rho(theta) + X p
+ Psi delta``: X stands in the basis behind the flexible vectors Psi, as coordinates whose amplitudes are given and do
not change in time. All else follows as for these: the energy ``1/2 p^T X^T K X p``, of which the slope is a torque on
theta, outputs and strains, the work of loads and of local effects on X p, and what X p does to the inertia at first
order. ``Psi^T K X = -(C Psi)^T L = 0`` at the nominal parameters; at others the coupling is in the tables. Left out are
what is of second order in p, which is p over a length or p in rad of what is there, the inertia of X p as a load on
Psi, and, as of all vectors, the velocity ``X' p theta'`` in outputs.

X is a displacement of the nodes at the joints that closes the gaps, and the static answer to the forces of that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.closure import size_of
from pgmp_petsc.mechanism.body_frames import BodyGradients
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.joints import Offset
from pgmp_petsc.scene.uses import offset_directions

STEP = 1e-4  # of differences, rad or of the mechanism's size: gaps are linear in places, and off by its square in turns
CLOSED = 1e-9  # share of a gap that displacements may leave


@dataclass(frozen=True, eq=False)
class _Gap:
    """A unit of one offset: the statements of the joints on either side of none, and what lies between."""

    above: StatementRows
    below: StatementRows
    between: float
    rows: np.ndarray  # numbers of these among the constraints

    def at(self, poses: np.ndarray) -> np.ndarray:
        """Return by how much the statements change at poses (n_bodies, n_pose), m or 1 per unit."""
        return (self.above.values(poses.ravel()) - self.below.values(poses.ravel())) / self.between


class Closing:
    """Static answers to gaps of the constraints, with theta held, and what elastic joints release. Collective on the
    problem's communicator."""

    def __init__(self, problem: ModalProblem) -> None:
        self._problem, mechanism = problem, problem.mechanism
        still = [(c.statement, c.sides) for c in mechanism.coordinates]
        still += [(part.statement, c.sides) for c in mechanism.connections for part in c.released]
        still += [(c.combination, c.sides) for c in mechanism.couplings if c.elastic]
        self._still = BodyGradients(mechanism, still)

    def at(self, modes: ModeSet, gaps: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
        """Return what closes gaps (n_constraints, n) at the configuration that the problem is at, in body frames, local
        rows (n_local, n), and what it leaves of them.

        Raises `RunError` if the refinement of an answer does not converge; `what` is what it is of.
        """
        problem = self._problem
        poses = problem.kinematics.motion(modes.theta).poses
        constraints = problem.constraints_at(poses)
        moved = np.unique(constraints.indices)
        slopes = constraints[:, moved].toarray()
        placed = -np.linalg.lstsq(slopes, gaps, rcond=None)[0]
        everywhere = np.zeros((problem.mechanism.n_dofs, gaps.shape[1]))
        everywhere[moved] = placed
        found = everywhere[problem.rows.start : problem.rows.stop]
        found = found + problem.static_answers(modes.unstrained, -problem.times_stiffness(found), what)
        return found - self._turning(modes, poses, found), np.abs(slopes @ placed + gaps)

    def _turning(self, modes: ModeSet, poses: np.ndarray, found: np.ndarray) -> np.ndarray:
        """Return the rigid and released motion in displacements (n_local, n), as its statements measure it."""
        problem, n_theta = self._problem, len(self._problem.mechanism.coordinates)
        motion = np.hstack([modes.rigid[:, modes.free], modes.released])
        measured = np.append(modes.free, np.arange(n_theta, self._still.n))
        entries = self._still.values(poses), (self._still.rows, self._still.dofs)
        slopes = sp.csr_matrix(entries, shape=(self._still.n, problem.mechanism.n_dofs))[measured]
        shown = slopes @ problem.all_rows(np.hstack([motion, found]))
        n = motion.shape[1]
        return motion @ np.linalg.lstsq(shown[:, :n], shown[:, n:], rcond=None)[0]


class BuiltIn:
    """The static answers X of a scene's offsets. Collective on the problem's communicator.

    Parameters
    ----------
    problem
        Of the mechanism with no joint off, at the nominal parameters.
    scene, shapes
        The scene, and the shapes of its bodies.
    """

    def __init__(self, problem: ModalProblem, scene: Scene, shapes: Mapping[str, BodyShape]) -> None:
        self._problem, mechanism, self._closing = problem, problem.mechanism, Closing(problem)
        self._by = offset_directions(scene)
        self._gaps = [_gap(scene, shapes, mechanism, name) for name in self._by]

    def at(self, modes: ModeSet) -> np.ndarray:
        """Return X at the configuration that the problem is at, in body frames, local rows, (n_local, n_offsets).

        Raises `InputError` where nothing takes an offset, `RunError` if the refinement of an answer does not converge.
        """
        problem = self._problem
        if not self._gaps:
            return np.zeros((len(modes.rigid), 0))
        poses = problem.kinematics.motion(modes.theta).poses
        gaps = np.zeros((problem.constraints_at(poses).shape[0], len(self._gaps)))
        for column, gap in zip(gaps.T, self._gaps):
            column[gap.rows] = gap.at(poses)
        found, left = self._closing.at(modes, gaps, "stress that joints that are off build in")
        if np.max(left) > CLOSED * np.max(np.abs(gaps)):
            self._refuse(left, problem.kinematics.describe(modes.theta))
        return found

    def _refuse(self, left: np.ndarray, where: str) -> None:
        """Refuse gaps of the constraints for a unit of each offset, (n_constraints, n_offsets): nothing closes them."""
        row, column = np.unravel_index(np.argmax(left), left.shape)
        held = [(one.name, part) for one in self._problem.mechanism.holders for part, _ in one.holding(moving=True)]
        (joint, part), by = held[row], self._by[column]
        what, unit = ("a gap", "m") if part.is_length else ("an angle", "rad")
        per = "" if by is None else f" for 1 of {by}"
        raise InputError(
            f"joints.{joint}: {what} of {left[row, column]:.3g} {unit}{per} remains at {where}: joints are off by what "
            "no redundancy explains and no elasticity takes. Let bodies that they hold be flexible, or take joints "
            "that hold less"
        )


def _gap(scene: Scene, shapes: Mapping[str, BodyShape], mechanism: Mechanism, name: str | None) -> _Gap:
    """Return the gap of a unit of the offsets that name a parameter, or of those that are numbers."""
    offsets = {joint: entry.offset for joint, entry in scene.joints.items() if entry.offset is not None}
    size, step = size_of(mechanism), STEP
    if name is None:
        step /= max(abs(x) for offset in offsets.values() for x in _numbers(offset, size))
    elif any(name in offset.place for offset in offsets.values()):
        step *= size
    sides = []
    for amplitude in (step, -step):
        joints = dict(scene.joints)
        for joint, offset in offsets.items():
            joints[joint] = joints[joint].model_copy(update={"offset": offset.part(name, amplitude)})
        other = Mechanism.from_scene(scene.model_copy(update={"joints": joints}), shapes)
        parts = [
            part for connection in other.connections if connection.name in offsets for part in connection.holding(True)
        ]
        n_pose = mechanism.space.n_pose
        sides.append(
            StatementRows(
                [statement for statement, _ in parts],
                [tuple(side.on_pose() for side in pair) for _, pair in parts],
                lambda body: n_pose * body + np.arange(n_pose),
                mechanism.space.dimension,
            )
        )
    return _Gap(*sides, 2.0 * step, _rows(mechanism, offsets))


def _numbers(offset: Offset, size: float) -> tuple[float, ...]:
    """Return the numbers of an offset, in rad and in units of a size (m), 0 for parameters."""
    own = offset.part(None, 1.0)
    return *own.turn, *(x / size for x in own.place)


def _rows(mechanism: Mechanism, joints: Mapping[str, object]) -> np.ndarray:
    """Return the numbers of the constraints of some joints."""
    first, found = 0, []
    for one in mechanism.holders:
        count = len(one.holding(moving=True))
        if one.name in joints:
            found.append(np.arange(first, first + count))
        first += count
    return np.concatenate(found)
