"""What joints that are off build into a mechanism, at any configuration: the static answer to a unit of each offset.

Displacements are ``rho(theta) + X p + Psi delta``, with the offsets p that entries of ``offset`` name, and a 1 for
their numbers,

    c(rho(theta)) = gamma(theta) p,     [K C^T; C 0] [X; L] = [0; -gamma],     T X = 0,

and the statements T of the coordinates: X stands in the basis behind Psi, with amplitudes that are given
(docs/method.md, joints that are off). It is a displacement of the nodes at the joints that closes the gaps, and the
static answer to the forces of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.closure import size_of
from pgmp_petsc.mechanism.mechanism import BodyStatements, ConstraintJacobian, Mechanism
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.uses import offset_directions

STEP = 1e-4  # of differences, rad or of the mechanism's size: gaps are linear in places, and off by its square in turns
CLOSED = 1e-9  # share of a gap that displacements may leave; of an offset, a gap that is round-off


@dataclass(frozen=True, eq=False)
class _Gap:
    """A unit of one offset: the mechanisms on either side of none, and what lies between."""

    above: Mechanism
    below: Mechanism
    between: float

    @cached_property
    def _sides(self) -> tuple[tuple[StatementRows, ConstraintJacobian], ...]:
        return tuple((_statements(side), ConstraintJacobian(side)) for side in (self.above, self.below))

    def at(self, poses: np.ndarray) -> np.ndarray:
        """Return by how much the constraints change at poses (n_bodies, n_pose), m or 1 per unit."""
        above, below = (rows.values(poses.ravel()) for rows, _ in self._sides)
        return (above - below) / self.between

    def slopes_at(self, poses: np.ndarray) -> sp.csr_matrix:
        """Return by how much their derivatives with unknowns in body frames change, (n_constraints, n_dofs)."""
        above, below = (jacobian.at(poses) for _, jacobian in self._sides)
        return (above - below)[: self._sides[0][0].n] / self.between


@dataclass(frozen=True, eq=False)
class GapDerivatives:
    """Derivatives of the constraints with offsets at one configuration."""

    #: slopes, bends: with an offset and unknowns in body frames, (n_held, n_dofs) each, and with two, (n_offsets,
    #: n_offsets, n_held)
    slopes: Sequence[sp.csr_matrix]
    bends: np.ndarray


class Closing:
    """Static answers to gaps of the constraints, with theta held, and what elastic joints release. Collective on the
    problem's communicator."""

    def __init__(self, problem: ModalProblem) -> None:
        self._problem, mechanism = problem, problem.mechanism
        still = [(c.statement, c.sides) for c in mechanism.coordinates]
        still += [(part.statement, c.sides) for c in mechanism.connections for part in c.released]
        still += [(c.combination, c.sides) for c in mechanism.couplings if c.elastic]
        self._still = BodyStatements(mechanism, still)

    def at(self, modes: ModeSet, gaps: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
        """Return what closes gaps (n_constraints, n) at the configuration that the problem is at, in body frames, local
        rows (n_local, n), and what it leaves of them.

        Raises `RunError` if the refinement of an answer does not converge; `what` is what it is of.
        """
        problem = self._problem
        poses = problem.kinematics.motion(modes.theta).poses
        constraints = problem.constraints.at(poses)
        moved = np.unique(constraints.indices)
        slopes = constraints[:, moved].toarray()
        placed = -np.linalg.lstsq(slopes, gaps, rcond=None)[0]
        everywhere = np.zeros((problem.mechanism.n_dofs, gaps.shape[1]))
        everywhere[moved] = placed
        found = everywhere[problem.rows.start : problem.rows.stop]
        found = found + problem.static_answers(modes.unstrained, -problem.times_stiffness(found), what)
        # less the rigid and released motion in it, as its statements measure it
        motion = np.hstack([modes.rigid[:, modes.free], modes.released])
        measured = np.append(modes.free, np.arange(len(problem.mechanism.coordinates), self._still.n))
        entries = self._still.values(poses), (self._still.rows, self._still.dofs)
        of_motion = sp.csr_matrix(entries, shape=(self._still.n, problem.mechanism.n_dofs))[measured]
        shown, n = of_motion @ problem.all_rows(np.hstack([motion, found])), motion.shape[1]
        found = found - motion @ np.linalg.lstsq(shown[:, :n], shown[:, n:], rcond=None)[0]
        return found, np.abs(slopes @ placed + gaps)


class BuiltIn:
    """The static answers X of a scene's offsets. Collective on the problem's communicator.

    The problem is that of the mechanism with no joint off, at the nominal parameters.
    """

    def __init__(self, problem: ModalProblem, scene: Scene, shapes: Mapping[str, BodyShape]) -> None:
        self._problem, self._n_held, self._closing = problem, problem.mechanism.n_held, Closing(problem)
        self._by, self._scene, self._shapes = offset_directions(scene), scene, shapes
        size = size_of(problem.mechanism)
        self._steps = [_step(scene, size, name) for name in self._by]
        self._units = STEP * size / np.array(self._steps)  # of a gap that a unit of each offset may make, m
        self._gaps = [
            _Gap(self._off_by({name: step}), self._off_by({name: -step}), 2.0 * step)
            for name, step in zip(self._by, self._steps)
        ]

    @property
    def n(self) -> int:
        """Number of offsets."""
        return len(self._gaps)

    def derivatives(self, theta: np.ndarray) -> GapDerivatives:
        """Return the derivatives of the constraints with offsets at a configuration (n_theta,)."""
        poses = self._problem.kinematics.motion(theta).poses
        bends = np.zeros((self.n, self.n, self._n_held))
        for (i, j), four in self._pairs.items():
            near, *far = (rows.values(poses.ravel()) for rows in four)
            bends[i, j] = bends[j, i] = (near - far[0] - far[1] + far[2]) / (4.0 * self._steps[i] * self._steps[j])
        return GapDerivatives([gap.slopes_at(poses) for gap in self._gaps], bends)

    @cached_property
    def _pairs(self) -> dict[tuple[int, int], list[StatementRows]]:
        """The constraints about no offset, with two offsets of one joint forwards or backwards, by their numbers; those
        of different joints add up."""
        entries = {joint: entry.offset for joint, entry in self._scene.joints.items() if entry.offset is not None}
        joints = [{joint for joint, offset in entries.items() if offset.has(name)} for name in self._by]
        found = {}
        for i, j in zip(*np.tril_indices(self.n)):
            if joints[i] & joints[j]:
                both = [(k * self._steps[i], l * self._steps[j]) for k, l in product((1.0, -1.0), repeat=2)]
                found[i, j] = [
                    _statements(self._off_by({self._by[j]: b, self._by[i]: a + (b if i == j else 0.0)}))
                    for a, b in both
                ]
        return found

    def _off_by(self, sizes: Mapping[str | None, float]) -> Mechanism:
        """Return the mechanism with some offsets, by their parameters, 0 of others."""
        joints = {
            name: joint if joint.offset is None else joint.model_copy(update={"offset": joint.offset.part(sizes)})
            for name, joint in self._scene.joints.items()
        }
        return Mechanism.from_scene(self._scene.with_entries(joints=joints), self._shapes)

    def at(self, modes: ModeSet) -> np.ndarray:
        """Return X at the configuration that the problem is at, in body frames, local rows, (n_local, n_offsets).

        Raises `InputError` where nothing takes an offset, `RunError` if the refinement of an answer does not converge.
        """
        problem = self._problem
        if not self._gaps:
            return np.zeros((len(modes.rigid), 0))
        poses = problem.kinematics.motion(modes.theta).poses
        gaps = np.zeros((problem.constraints.at(poses).shape[0], len(self._gaps)))
        for column, gap in zip(gaps.T, self._gaps):
            column[: self._n_held] = gap.at(poses)
        gaps[np.abs(gaps) < CLOSED * self._units] = 0.0  # what elastic joints take
        found, left = self._closing.at(modes, gaps, "stress that joints that are off build in")
        if np.max(left, initial=0.0) > CLOSED * np.max(np.abs(gaps), initial=0.0):
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


def _step(scene: Scene, size: float, name: str | None) -> float:
    """Return the step of differences of the offsets that name a parameter, or of those that are numbers."""
    offsets = [joint.offset for joint in scene.joints.values() if joint.offset is not None]
    if name is None:
        own = [offset.part({None: 1.0}) for offset in offsets]
        return STEP / max(abs(x) for one in own for x in (*one.turn, *(x / size for x in one.place)))
    return STEP * size if any(name in offset.place for offset in offsets) else STEP


def _statements(mechanism: Mechanism) -> StatementRows:
    """Return the constraints of the joints in the poses of the bodies."""
    return StatementRows.on_poses([part for one in mechanism.holders for part in one.holding(True)], mechanism.space)
