"""Static modes: what modes miss of the static answers to loads, orthonormal beside them; and vibrations on springs.

At single configurations an answer r(theta) may be a combination of the modes and of the answers before it: where a
rod's motion is a translation, its weight along the motion is its inertia force. The space that the answers span has a
limit there: what is left of r beside the others vanishes with a power of the distance, odd or even, and the basis
continues with the direction of ``r(theta + h) - r(theta - h)`` or ``r(theta + h) + r(theta - h)``, the larger one.

With the blocks K_s of linear springs in body frames (`effects.springs`), which hold what belongs to second derivatives
of their statements, and the work of forces on the curvature of the rigid motion (docs/effects.md, springs in
frequencies and bases, preload), the eigenproblem of `pgmp modes`, not that of the basis, is

    (N^T (K + K_s(theta)) N - Lambda N^T M N) psi = 0.

Mass and stiffness have the springs' entries at all configurations, so that the nonzero pattern stays one. Negative
eigenvalues are motions that grow: the shift of the solver is moved below them (none is below it, by inertia).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.effects import Action, Effect
from pgmp_petsc.effects.effect import UnitForces
from pgmp_petsc.effects.springs import Block, moving_dofs, spring_block, spring_force
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import BodyStatements, linear_motion, to_body
from pgmp_petsc.modes.problem import DEPENDENT_TOLERANCE, PREFIX, ModalProblem, ModeSet
from pgmp_petsc.solvers.shift_invert import EigenPairs

# h of a limit, as a share of a coordinate's range: the direction is off by the square of this, and where what is left
# of an answer vanishes with the square, 7 of its 13 digits are left
LIMIT_STEP = 1e-3

# shares of the ranges at which loads and springs are looked at, far from every symmetry
PLACES = np.array([[0.236, 0.414, 0.327], [0.618, 0.732, 0.871], [0.854, 0.142, 0.563]])

LoadsAt = Callable[[ModalProblem, ModeSet], np.ndarray]


def off_symmetry(kinematics: RigidKinematics) -> np.ndarray:
    """Return configurations at which nothing vanishes by symmetry, shape (n_places, n_theta), rad."""
    lower, upper = (np.array([getattr(c, end) for c in kinematics.coordinates]) for end in ("lower", "upper"))
    return lower + PLACES[:, : lower.size] * (upper - lower)


def static_modes(problem: ModalProblem, modes: ModeSet, loads_at: LoadsAt) -> np.ndarray:
    """Return what the modes miss of the static answers to loads (`ModalProblem.static_answers`), M-orthonormal and
    M-orthogonal to them, shape (n_local, n_static).

    `loads_at` gives the loads where the problem is, in body frames, local rows, shape (n_local, n_loads). Collective on
    the problem's communicator. Raises `RunError` if an answer is a combination of the modes and the others at
    neighbouring configurations too.
    """
    kept, loads = modes.eigenvectors, loads_at(problem, modes)
    if not len(loads.T):
        return np.empty((len(kept), 0))
    answers = problem.static_answers(kept, loads)
    sizes = problem.norms(answers)
    basis, dependent, _ = _extended(problem, kept, answers, sizes)
    if dependent.any():
        basis, dependent, _ = _extended(problem, kept, _limits(problem, modes, loads_at), sizes)
    if dependent.any():
        raise RunError(
            f"reduction.static_modes at {problem.kinematics.describe(modes.theta)}: a load's static "
            "answer is a combination of the modes and the other answers, and so it is beside; take fewer modes, or no "
            "static ones (reduction.static_modes, reduction.spring_modes)"
        )
    return basis[:, kept.shape[1] :]


def dependent_loads(problem: ModalProblem, modes: ModeSet, loads: np.ndarray) -> np.ndarray:
    """Return whose static answers are combinations of the modes and of the answers before, shape (n_loads,); loads are
    in body frames, local rows, shape (n_local, n_loads)."""
    answers = problem.static_answers(modes.eigenvectors, loads)
    return _extended(problem, modes.eigenvectors, answers, problem.norms(answers))[1]


def _extended(
    problem: ModalProblem, kept: np.ndarray, answers: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vectors extended by orthonormal answers, which answers depend on those before and are left out, and what
    is left of each beside these, (n_local, n_loads).

    Sizes (n_loads,) are those of which round-off leaves a share of `DEPENDENT_TOLERANCE`.
    """
    rests, basis, m_basis, dependent = answers.copy(), kept, problem.times_mass(kept), np.zeros(len(sizes), dtype=bool)
    inverse, own = np.linalg.inv(problem.inner(kept, m_basis)), slice(kept.shape[1])
    for number, (rest, size) in enumerate(zip(answers.T[..., None], sizes)):
        for _ in range(2):  # twice is enough (Kahan): the second pass removes what round-off left
            shares = problem.inner(m_basis, rest)
            shares[own] = inverse @ shares[own]
            rest = rest - basis @ shares
        rests[:, number], m_rest = rest[:, 0], problem.times_mass(rest)
        left = np.sqrt(problem.inner(rest, m_rest)[0, 0])
        dependent[number] = not left > DEPENDENT_TOLERANCE * size
        if not dependent[number]:
            basis, m_basis = np.hstack([basis, rest / left]), np.hstack([m_basis, m_rest / left])
    return basis, dependent, rests


def _limits(problem: ModalProblem, modes: ModeSet, loads_at: LoadsAt) -> np.ndarray:
    """Return the directions of what is left of each answer in the limit of the configuration of the modes.

    Along the coordinate that leaves most; shape (n_local, n_loads). All of them come from the neighbours: what is left
    beside a limit vanishes with it only then. The problem returns to the configuration.
    """
    found = []
    for k, coordinate in enumerate(problem.kinematics.coordinates):
        step = LIMIT_STEP * (coordinate.upper - coordinate.lower)
        ends = modes.theta[k] + np.array([-step, step])
        if not coordinate.periodic:  # at an end of the range of one side alone
            ends = np.clip(ends, coordinate.lower, coordinate.upper)
        before, after = (_left_at(problem, modes, k, end, loads_at) for end in ends)
        found += [after - before, after + before]
    problem.resume(modes.theta, modes.eigenvalues, modes.flexible)
    largest = np.argmax([problem.norms(vectors) for vectors in found], axis=0)
    return np.array(found)[largest, :, np.arange(len(largest))].T


def _left_at(problem: ModalProblem, modes: ModeSet, k: int, value: float, loads_at: LoadsAt) -> np.ndarray:
    """Return what is left of each answer beside those before it, with coordinate k at a value, (n_local, n_loads)."""
    theta = modes.theta.copy()
    theta[k] = value
    there = problem.solve(theta)
    answers = problem.static_answers(there.eigenvectors, loads_at(problem, there))
    return _extended(problem, there.eigenvectors, answers, np.zeros(answers.shape[1]))[2]


RESISTED = 1e-10  # stiffness of a rigid motion, as a share of what its springs would have without cancellation
NEGATIVE = 1e-12  # eigenvalue of a block, as a share of its largest one


class SpringStiffness:
    """Stiffness of springs and preload at any configuration.

    Weights are conservative effects that load the mechanism; None for the unloaded state. `dofs` are unknowns of every
    block, the same at all configurations.
    """

    def __init__(
        self,
        kinematics: RigidKinematics,
        springs: Sequence[Action],
        values: Mapping[str, float],
        weights: Sequence[Effect] | None = None,
    ) -> None:
        self.kinematics, self._values = kinematics, dict(values)
        self._mechanism = kinematics.mechanism
        self._springs, self._weights, self._free = tuple(springs), weights, self._mechanism.free
        self.dofs = [moving_dofs(spring) for spring in self._springs]
        self._forces = UnitForces(self._springs, self._mechanism)
        self._measured = [BodyStatements(self._mechanism, [(one.statement, one.sides)]) for one in self._springs]
        moved = [kinematics.coordinates[k] for k in self._free]
        self._moving = BodyStatements(self._mechanism, [(c.statement, c.sides) for c in moved])
        if weights is not None and self._free.size:
            self.dofs.append(np.unique(self._moving.dofs))

    def at(self, theta: np.ndarray, matrices: AffineMatrices, comm: Comm) -> list[Block]:
        """Return the blocks at a configuration (n_theta,), rad; the same on all ranks. Collective on `comm`.

        Weights are made of the mechanism's matrices, of which a rank has its rows.
        """
        poses = self.kinematics.motion(theta).poses
        loaded = self._weights is not None
        forces = [
            spring_force(spring, self._mechanism, poses, theta, self._values) if loaded else 0.0
            for spring in self._springs
        ]
        gradients = self._forces.at(poses)
        preloads = [force * one.second(poses)[0] if force else 0.0 for force, one in zip(forces, self._measured)]
        blocks = [
            spring_block(spring, gradient[dofs], self._values, preload)
            for spring, gradient, dofs, preload in zip(self._springs, gradients.T, self.dofs, preloads)
        ]
        if loaded and self._free.size:
            dofs = self.dofs[-1]
            turning = self._moving.dense(poses)[:, dofs].T
            blocks.append(Block(dofs, turning @ self._of_curvature(theta, forces, matrices, comm) @ turning.T))
        return blocks

    def n_resisted(self, matrices: AffineMatrices, comm: Comm) -> int:
        """Return how many independent rigid motions, of free coordinates and elastic joints, have a stiffness, but for
        single configurations.

        Parameters are those of `at`. Collective on `comm`.
        """
        most = 0
        for theta in off_symmetry(self.kinematics):
            motion = self.kinematics.motion(theta)
            velocities = [motion.velocities[..., self._free], motion.released]
            rigid = linear_motion(self._mechanism, np.concatenate(velocities, axis=2))
            found, scale = np.zeros((2, rigid.shape[1], rigid.shape[1]))
            for block in self.at(theta, matrices, comm):
                own = rigid[block.dofs]
                found += own.T @ block.matrix @ own
                scale += np.abs(own).T @ np.abs(block.matrix) @ np.abs(own)
            sizes = np.abs(np.linalg.eigvalsh(found))
            most = max(most, int(np.sum(sizes > RESISTED * np.max(scale, initial=0.0))))
        return most

    def _of_curvature(
        self, theta: np.ndarray, forces: Sequence[float], matrices: AffineMatrices, comm: Comm
    ) -> np.ndarray:
        """Return ``-(sum_j F_j g_j + f).rho,kl`` of the free coordinates, shape (n_free, n_free), N m."""
        motion = self.kinematics.motion(theta)
        poses = motion.poses
        curvature = linear_motion(self._mechanism, motion.accelerations)
        curvature = curvature[:, self._free][:, :, self._free]
        pulled = self._forces.at(poses) @ np.array(forces)
        own = slice(matrices.rows.start, matrices.rows.stop)
        # the weights in body frames, local rows, shape (n_local,)
        weight = np.zeros(len(matrices.rows))
        for effect in self._weights:
            for load in effect.loads(matrices):
                term, field = load.body_force
                strength = float(load.weight.evaluate(self._values))
                weight += strength * (matrices.mass[term] @ to_body(self._mechanism, poses, field))
        work = comm.allreduce(np.tensordot(weight, curvature[own], axes=1))
        return -(np.tensordot(pulled, curvature, axes=1) + work)


def is_negative(block: Block) -> bool:
    """Return whether a block gives energy for some displacement."""
    values = np.linalg.eigvalsh(block.matrix)
    return bool(values[0] < -NEGATIVE * max(values[-1], -values[0], 0.0)) if values.size else False


FURTHER = 8.0  # from one shift to the next, on the way below all eigenvalues
MOST_SHIFTS = 20
ROUND_OFF = 1e-12  # of an eigenvalue, as a share of the first one that is of the bodies


class VibrationProblem(ModalProblem):
    """Vibrations at any configuration, for fixed parameter values. Collective on `comm`.

    Springs know kinematics and parameter values. `n_modes` counts all frequencies but those of the `n_rigid` rigid
    motions that no spring resists; the rest is as for `ModalProblem`.
    """

    def __init__(self, springs: SpringStiffness, values: Mapping[str, float], n_modes: int, comm: Comm) -> None:
        self._springs = springs
        super().__init__(springs.kinematics, values, n_modes, comm)
        self._elastic = weighted_sum(self.matrices.stiffness, values)
        self.n_rigid = self.n_unstrained - springs.n_resisted(self.matrices, comm)

    def eigenvalues(self, theta: np.ndarray) -> np.ndarray:
        """Return the eigenvalues at one configuration (n_theta,), ascending, shape (n_modes,), (rad/s)^2.

        Raises `RunError` if the eigensolver fails, or rigid motions that no spring resists are not what vanishing
        eigenvalues belong to.
        """
        where = self.kinematics.describe(theta)
        blocks = self._springs.at(theta, self.matrices, self.comm)
        # the stiffness is that of the bodies and of the springs
        matrix = self._sum(self.matrices.stiffness)
        matrix.sort_indices()
        place = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)) * matrix.shape[1] + matrix.indices
        for block in blocks:
            own = np.flatnonzero((block.dofs >= self.rows.start) & (block.dofs < self.rows.stop))
            keys = (block.dofs[own, None] - self.rows.start) * matrix.shape[1] + block.dofs
            np.add.at(matrix.data, np.searchsorted(place, keys), block.matrix[own])
        self._pencil.set_stiffness(matrix)
        own = self._move_to(theta)[0]
        rigid = np.hstack([own[:, self.free], self.released_motion(theta, own)])
        vectors = self._pairs(any(is_negative(block) for block in blocks), where).vectors
        values = self._refined(vectors, rigid, blocks)
        # no more of them vanish than there are rigid motions
        scale = np.sort(np.abs(values))[: self.n_unstrained + 1][-1]
        values[np.abs(values) < ROUND_OFF * scale] = 0.0
        zero, others = np.split(np.argsort(np.abs(values), kind="stable"), [self.n_rigid])
        self._check_rigid(np.append(values[zero], scale), vectors[:, zero], rigid, where)
        return np.sort(values[others])[: self.n_modes]

    def _sum(self, terms: Mapping[Monomial, sp.csr_matrix]) -> sp.csr_matrix:
        """Return a weighted sum with the springs' entries in its pattern."""
        total = super()._sum(terms).tocoo()
        rows = [np.repeat(dofs, dofs.size) for dofs in self._springs.dofs]
        columns = [np.tile(dofs, dofs.size) for dofs in self._springs.dofs]
        row, column = (np.concatenate([np.zeros(0, dtype=int), *parts]) for parts in (rows, columns))
        own = (row >= self.rows.start) & (row < self.rows.stop)
        entries = (
            np.concatenate([total.data, np.zeros(own.sum())]),
            (np.concatenate([total.row, row[own] - self.rows.start]), np.concatenate([total.col, column[own]])),
        )
        return sp.coo_matrix(entries, shape=total.shape).tocsr()

    def _pairs(self, negative: bool, where: str) -> EigenPairs:
        """Return the lowest eigenpairs: rigid motions that no spring resists, and all that is wanted."""
        n = self.n_unstrained
        wanted = max(1, self.n_modes - (n - self.n_rigid))
        if not negative:
            return self._pencil.solve(n, wanted, where)
        usual = shift = self._pencil.shift
        try:
            for _ in range(MOST_SHIFTS):
                self._pencil.shift_to(shift, PREFIX)
                if self._pencil.count_below(shift) == 0:
                    return self._pencil.solve(n, wanted, where)
                shift *= FURTHER
        finally:
            self._pencil.shift_to(usual, PREFIX)
        raise RunError(
            f"eigenproblem at {where}: eigenvalues lie below {shift / FURTHER:.3g} (rad/s)^2: springs of negative "
            "stiffness, or forces of springs, are far beyond what the bodies bear"
        )

    def _refined(self, vectors: np.ndarray, rigid: np.ndarray, blocks: list[Block]) -> np.ndarray:
        """Return Rayleigh quotients, to which the rigid part of a vector adds no strain energy of the bodies.

        In the solver's own values of soft springs that is the round-off of stiff bodies.
        """
        bent, everywhere = self.all_rows(self._deflate(vectors, rigid)), self.all_rows(vectors)
        own = slice(self.rows.start, self.rows.stop)
        energies = np.diag(self.inner(bent[own], self._elastic @ bent)).copy()
        for block in blocks:
            moved = everywhere[block.dofs]
            energies += np.einsum("ik,ij,jk->k", moved, block.matrix, moved)
        return energies / self.norms(vectors) ** 2


def frequencies_of(eigenvalues: np.ndarray) -> np.ndarray:
    """Return frequencies, Hz; below zero those of motions that grow as ``exp(2 pi |f| t)`` instead of vibrating."""
    return np.sign(eigenvalues) * np.sqrt(np.abs(eigenvalues)) / (2 * np.pi)
