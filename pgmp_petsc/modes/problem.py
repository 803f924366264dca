"""The constrained eigenproblem of a mechanism over its configurations (Naets et al. 2015, eqs. (15)-(17)):

    (N^T K N - Lambda N^T M N) psi = 0,    Psi = N psi,

in body frames, where K and M are constant and theta enters through N alone. The zero eigenvalues, one for each free
coordinate, belong to the rigid motion ``d rho / d theta``, known exactly from the kinematics; it takes their place in
the basis. What elastic joints release is no constraint, and their springs are not in K: the rigid motions that they
allow with theta held have zero eigenvalues too, are known as exactly, and are in the basis behind the modes. Prescribed
coordinates are clamped: the relative rotation of their joint's nodes is one more constraint, so that no flexible vector
turns a driven joint. Their columns of ``d rho / d theta`` do, and are in the basis too, but the flexible vectors are
not orthogonal to them.

What an eigenproblem finds at one configuration.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError, PgmpError, RunError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.matrices import AffineMatrices, owned_rows, weighted_sum
from pgmp_petsc.mechanism.constraint_set import NullSpace, NullSpaces
from pgmp_petsc.mechanism.kinematics import RigidKinematics, RigidMotion
from pgmp_petsc.mechanism.mechanism import ConstraintJacobian, linear_motion
from pgmp_petsc.modes.pencils import MOST_UNKNOWNS, DensePencil, SparsePencil, cholesky, forward
from pgmp_petsc.ranks.petsc import options_of
from pgmp_petsc.scene.numerics import Reduction


@dataclass(frozen=True)
class ModeSet:
    """Rigid and flexible modes at one configuration, local rows, in body frames."""

    theta: np.ndarray  # the configuration, shape (n_theta,), rad
    eigenvalues: np.ndarray  # of the flexible modes, ascending, shape (n_modes,), (rad/s)^2
    rigid: np.ndarray  # ``d rho / d theta``, shape (n_local, n_theta)
    rigid_curvature: np.ndarray  # ``d2 rho / d theta2``, shape (n_local, n_theta, n_theta)
    #: m-orthonormal at the parameters of the problem and M-orthogonal to `unstrained`, shape (n_local, n_modes)
    flexible: np.ndarray
    free: np.ndarray  # numbers of the coordinates that are not prescribed
    #: rigid motions that elastic joints allow (`ModalProblem.released_motion`), m-orthonormal, shape (n_local,
    #: n_released)
    released: np.ndarray

    @property
    def unstrained(self) -> np.ndarray:
        """Vectors of zero eigenvalues: of free coordinates, and of elastic joints, shape (n_local, n_unstrained)."""
        return np.hstack([self.rigid[:, self.free], self.released])

    @property
    def kept(self) -> np.ndarray:
        """What a basis takes up beside the rigid motion: modes, and what elastic joints allow, (n_local, n_kept)."""
        return np.hstack([self.flexible, self.released])

    @property
    def eigenvectors(self) -> np.ndarray:
        """All vectors of the eigenproblem, those of its zero eigenvalues first, shape (n_local, n_unstrained +
        n_modes)."""
        return np.hstack([self.unstrained, self.flexible])

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Eigenfrequencies, shape (n_modes,)."""
        return np.sqrt(np.maximum(self.eigenvalues, 0.0)) / (2 * np.pi)


PREFIX = "pgmp_modes_"
SCALE_PREFIX = "pgmp_scale_"  # of the first solve, with a guessed shift
MAX_REFINEMENTS = 60
REFINEMENT_FLOOR = 1e-6
SETTLED = 2  # number of the first step whose contraction holds for the next ones, where steps are not exact
ROUND_OFF = 1e-15
TAKEN_UP = 1e-11  # of a load: what round-off leaves of one that the constraints take up
DEPENDENT_TOLERANCE = 1e-8  # of a vector's own size: what is left of it beside the others
RIGID_TOLERANCE = 1e-5  # largest "zero" eigenvalue over the first flexible one; largest angle to d rho/d theta


class ModalProblem(AbstractContextManager):
    """Modes of a mechanism at any configuration, for the fixed parameter values at which M and K are taken. Collective
    on `comm`, the ranks that share one eigenproblem; `matrices` are the rows that this rank has (`owned_rows`), where
    they are assembled already.

    Of the `n_available` flexible modes of the mesh it has `n_modes` at most. Elastic joints allow `n_released` motions;
    with free coordinates there are `n_unstrained` vanishing eigenvalues. `clamped` are coordinates that follow given
    motions; in the Jacobian of the `constraints` they are held.

    Raises `InputError` if the mesh has no flexible modes.
    """

    def __init__(
        self,
        kinematics: RigidKinematics,
        values: Mapping[str, float],
        n_modes: int,
        comm: Comm,
        matrices: AffineMatrices | None = None,
    ) -> None:
        self.kinematics = kinematics
        self.mechanism = kinematics.mechanism
        self.free = self.mechanism.free
        self.clamped = [coordinate for coordinate in kinematics.coordinates if coordinate.prescribed]
        first = self.mechanism.n_held
        self._clamp_rows = slice(first, first + len(self.clamped))
        self.n_released = kinematics.motion(self._lowest()).released.shape[-1]
        self.n_unstrained = self.free.size + self.n_released
        self.constraints = ConstraintJacobian(self.mechanism, self.clamped)
        self._null_spaces = NullSpaces(self.constraints.pattern)
        self._last: dict[RigidMotion, NullSpace] = {}  # problems at other parameter values come to the same places
        loose = [c for c in self.mechanism.connections if c.released] + [
            c for c in self.mechanism.couplings if c.elastic
        ]
        sides = [side for one in (*self.mechanism.coordinates, *loose) for side in one.sides if not side.on_ground]
        self._loose = np.unique([side.dofs for side in sides])
        self.comm = comm
        self.n_modes = n_modes
        self.values = dict(values)
        if matrices is None:
            matrices = AffineMatrices(self.mechanism.bodies, owned_rows(self.mechanism.n_dofs, comm.rank, comm.size))
        self.matrices, self.rows = matrices, matrices.rows
        null = self._null_space(self._lowest())
        self.n_available = null.independent.size - self.n_unstrained
        if self.n_available < 1:
            raise InputError("the mesh has no flexible modes; take a finer one")
        self.n_modes = min(self.n_modes, self.n_available)
        self.n_redundant = null.n_redundant
        self._open()

    def at_values(self, values: Mapping[str, float]) -> ModalProblem:
        """Return the problem at other parameter values, to be closed by itself; what they leave as it is is shared."""
        other = copy(self)
        other.values = dict(values)
        other._open()
        return other

    def _open(self) -> None:
        """Make the pencil at the parameter values, and find its shift."""
        self._pencil = _pencil(
            self._sum(self.matrices.mass), self._sum(self.matrices.stiffness), self._loose, self.comm
        )
        self._known: ModeSet | None = None
        try:
            self._find_shift()
        except PgmpError:
            self.close()
            raise

    def close(self) -> None:
        """Destroy the PETSc objects."""
        self._pencil.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def solve(self, theta: np.ndarray | float) -> ModeSet:
        """Compute the modes at one configuration (n_theta,).

        Raises `RunError` if the eigensolver fails, or the zero eigenvalues are not the mechanism's rigid motion.
        """
        theta = np.atleast_1d(theta)
        rigid, curvature = self._move_to(theta)
        released = self.released_motion(theta, rigid)
        unstrained, where = np.hstack([rigid[:, self.free], released]), self.kinematics.describe(theta)
        n = unstrained.shape[1]
        pairs = self._pencil.solve(n, self.n_modes, where)
        self._check_rigid(pairs.values, pairs.vectors[:, :n], unstrained, where)
        flexible = self._deflate(pairs.vectors[:, n:], unstrained)
        self._known = ModeSet(theta, pairs.values[n:], rigid, curvature, flexible, self.free, released)
        return self._known

    def resume(self, theta: np.ndarray, eigenvalues: np.ndarray, flexible: np.ndarray) -> ModeSet:
        """Return to a configuration (n_theta,), rad, whose modes were found so: `static_answers` holds there again."""
        rigid, curvature = self._move_to(theta)
        released = self.released_motion(theta, rigid)
        self._known = ModeSet(theta, eigenvalues, rigid, curvature, flexible, self.free, released)
        return self._known

    def _null_space(self, theta: np.ndarray) -> NullSpace:
        motion = self.kinematics.motion(theta)
        if motion not in self._last:
            self._last.clear()
            self._last[motion] = self._null_spaces.of(self.constraints.at(motion.poses).data)
        return self._last[motion]

    def _move_to(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Refill the matrices for a configuration; return its rigid velocity and curvature, local rows."""
        self._pencil.move_to(self._null_space(theta))
        self._known = None
        return self.rigid_motion(theta)

    def rigid_motion(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``d rho / d theta`` and ``d2 rho / d theta2`` at a configuration, local rows, as in `ModeSet`."""
        motion, own = self.kinematics.motion(theta), slice(self.rows.start, self.rows.stop)
        parts = (motion.velocities, motion.accelerations)
        return tuple(linear_motion(self.mechanism, part)[own] for part in parts)

    def released_motion(self, theta: np.ndarray, rigid: np.ndarray) -> np.ndarray:
        """Return what elastic joints allow at a configuration with its rigid velocity, local rows, as in `ModeSet`.

        Joints carry what is on them along: with theta held, the mechanism moves with a frame on its mounts as it is,
        and no table changes (docs/method.md, second order). What couplings but cams release is motion between
        coordinates and what they drive, and clearance is small: there the coordinates keep as much of it as they can.

        Raises `RunError` if the directions that they release do not part these motions there.
        """
        everywhere = linear_motion(self.mechanism, self.kinematics.motion(theta).released)
        released = everywhere[self.rows.start : self.rows.stop]
        if not released.shape[1]:
            return released
        carries = self.kinematics.carries
        released, first = released[:, np.argsort(~carries, kind="stable")], int(np.sum(carries))
        for _ in range(2):  # twice is enough (Kahan): the second pass removes what round-off left
            released = np.hstack([released[:, :first], self._deflate(released[:, first:], rigid[:, self.free])])
            gram = self.inner(released, self.times_mass(released))
            scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
            factor = cholesky(gram * scale * scale[:, None], f"elastic joints at {self.kinematics.describe(theta)}")
            released = forward(factor, (released * scale).T).T
        return released

    def lost_inertia(self, theta: np.ndarray) -> dict[Monomial, np.ndarray]:
        """Return what inertia forces of ``d2 rho / d theta2`` at a configuration have beyond the mass terms times it
        (`Body.lost_momenta`), by weight, local rows, shape (n_local, n_theta, n_theta); no bodies but few have any."""
        found: dict[Monomial, np.ndarray] = {}
        for body, own in zip(self.mechanism.bodies, self.kinematics.motion(theta).accelerations):
            for weight, momenta in body.lost_momenta().items():
                forces = found.setdefault(weight, np.zeros((self.mechanism.n_dofs, *own.shape[1:])))
                forces[body.dofs] += np.tensordot(momenta, own, axes=1)
        return {weight: forces[self.rows.start : self.rows.stop] for weight, forces in found.items()}

    def work_of_motion(self, modes: ModeSet, vectors: np.ndarray, inertia: np.ndarray) -> np.ndarray:
        """Return ``(d2 rho / d theta2)^T M_i v`` of every mass term, shape (n_terms, n_theta, n_theta, k), for local
        columns v (n_local, k) and ``M_i v``, (n_terms, n_local, k)."""
        n_theta, weights = modes.rigid.shape[1], self.mechanism.mass_weights
        work = self.inner(modes.rigid_curvature.reshape(len(vectors), n_theta**2), inertia)
        for weight, forces in self.lost_inertia(modes.theta).items():
            work[weights.index(weight)] += self.inner(forces.reshape(len(vectors), n_theta**2), vectors)
        return work.reshape(len(weights), n_theta, n_theta, -1)

    def independent(self, loads: np.ndarray) -> np.ndarray:
        """Leave out the loads, in body frames, local rows, shape (n_local, n_loads), that are combinations of those
        before them, or that clamped joints take up."""
        clamps = self.constraints.at(self.mechanism.first_guess)[self._clamp_rows].toarray().T
        chosen = np.empty((len(loads), 0))
        for load in np.hstack([clamps[self.rows.start : self.rows.stop], loads]).T[..., None]:
            rest, whole = load, np.sqrt(self.inner(load, load)[0, 0])
            for _ in range(2):
                rest = rest - chosen @ self.inner(chosen, rest)
            size = np.sqrt(self.inner(rest, rest)[0, 0])
            if size > DEPENDENT_TOLERANCE * whole:
                chosen = np.hstack([chosen, rest / size])
        return chosen[:, clamps.shape[1] :]

    def static_answers(self, kept: np.ndarray, loads: np.ndarray, what: str = "static mode") -> np.ndarray:
        """Return ``K^-1 f`` of loads in body frames, local rows, shape (n_local, n_loads), in the null space of the
        constraints and M-orthogonal to `kept`, by iterative refinement.

        `kept` are eigenvectors at the configuration that the problem is at, local rows, shape (n_local, n_kept), and
        deflated from f. Steps of a dense pencil are exact but for round-off. A sparse one takes the shift-invert factor
        at hand, ``x <- x + (K - sigma M)^-1 (f - K x)``, which contracts by ``|sigma| / (lambda + |sigma|)`` along an
        eigenvector. Along those that are known, the slowest ones, the step is made exact: what is left contracts as the
        first unknown one does. Raises `RunError` if the refinement does not converge, with what is being computed.
        """
        m_kept = self.times_mass(kept)
        inverse = np.linalg.inv(self.inner(kept, m_kept))
        balanced = loads - m_kept @ (inverse @ self.inner(kept, loads))
        rigid, inertia = kept[:, : self.n_unstrained], m_kept[:, : self.n_unstrained]
        # of what is deflated too: an answer that vanishes beside it is round-off and never settles
        undeflated = self.norms(self._pencil.static_steps(loads, rigid))
        answers, m_answers = np.zeros((2, *loads.shape))
        last, settled = np.full(loads.shape[1], np.inf), 1 if self._pencil.exact else SETTLED
        # those that the constraints and the inertia of rigid motions do not take up altogether, as that of a rigid body
        # takes up a couple in its joint with the ground
        bending = loads - inertia @ np.linalg.solve(self.inner(rigid, inertia), self.inner(rigid, loads))
        squares = [np.sum(part**2, axis=0) for part in (self._pencil.felt(bending), loads)]
        felt, whole = np.sqrt(self._summed(np.array(squares)))
        active = np.flatnonzero(felt > TAKEN_UP * whole)
        if not active.size:
            return answers
        for number in range(MAX_REFINEMENTS):
            step = self._steps(balanced[:, active] - self.times_stiffness(answers[:, active]), rigid)
            m_step = self.times_mass(step)
            known = inverse @ self.inner(kept, m_step)
            step -= kept @ known
            m_step -= m_kept @ known
            answers[:, active] += step
            m_answers[:, active] += m_step
            squares = [np.einsum("dk,dk->k", step, m_step)]
            squares.append(np.einsum("dk,dk->k", answers[:, active], m_answers[:, active]))
            size, whole = np.sqrt(np.maximum(self._summed(np.array(squares)), 0.0))
            # the first steps are exact along what is known: only then is the contraction that of what is left
            ahead = size * size / last[active] if number >= settled else size
            # round-off of stiff directions may hold the steps up before that, but never far above
            stalled = (size > 0.5 * last[active]) & (size <= REFINEMENT_FLOOR * whole)
            last[active] = size
            going = (np.minimum(size, ahead) > np.maximum(1e-13 * whole, ROUND_OFF * undeflated[active])) & ~stalled
            if not going.any():
                return answers
            worst = np.max(size[going] / whole[going])
            active = active[going]
        raise RunError(
            f"{what}: {MAX_REFINEMENTS} refinements left a step of {worst:.2g} of the answer; the mesh may "
            "be too fine for double precision"
        )

    def _steps(self, residual: np.ndarray, rigid: np.ndarray) -> np.ndarray:
        """Return the pencil's static steps from residuals (n_local, k), with ``K^-1`` of their part along known
        modes."""
        step = self._pencil.static_steps(residual, rigid)
        if self._known is not None and not self._pencil.exact:
            flexible, values = self._known.flexible, self._known.eigenvalues
            missed = 1.0 / values - 1.0 / (values - self._pencil.shift)
            step += flexible @ (missed[:, None] * self.inner(flexible, residual))
        return step

    def onto(self, basis: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Return the M-orthogonal projection of vectors onto a basis."""
        m_basis = self.times_mass(basis)
        return basis @ np.linalg.solve(self.inner(basis, m_basis), self.inner(m_basis, vectors))

    def norms(self, vectors: np.ndarray) -> np.ndarray:
        """Return the M-norms of local columns (n_local, k), shape (k,)."""
        return np.sqrt(self._summed(np.einsum("dk,dk->k", vectors, self.times_mass(vectors))))

    def times_mass(self, vectors: np.ndarray) -> np.ndarray:
        """Return M times local columns (n_local, k)."""
        return self._pencil.times_mass(vectors)

    def times_stiffness(self, vectors: np.ndarray) -> np.ndarray:
        """Return K times local columns (n_local, k)."""
        return self._pencil.times_stiffness(vectors)

    def inner(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return ``left^T right`` over all rows (those of all ranks), for right of shape (..., n_local, k)."""
        return self._summed(left.T @ right)

    def _summed(self, part: np.ndarray) -> np.ndarray:
        """Return a new array's sum over the ranks."""
        if self.comm.size == 1:
            return part
        from mpi4py import MPI

        part = np.ascontiguousarray(part)
        self.comm.Allreduce(MPI.IN_PLACE, part, op=MPI.SUM)
        return part

    def all_rows(self, columns: np.ndarray) -> np.ndarray:
        """Gather local columns (n_local, k) of all ranks, shape (n_dofs, k)."""
        return columns if self.comm.size == 1 else np.concatenate(self.comm.allgather(columns))

    def keep(self, reduction: Reduction, n_static: int = 0) -> bool:
        """Find as many modes as a basis has beside static ones, and return whether they are fewer than all.

        Raises `InputError` as `Reduction.fitting` does.
        """
        self.n_modes = reduction.fitting(self.n_available, n_static).modes
        return self.n_modes < self.n_available

    def _find_shift(self) -> None:
        """Set a shift that fits the first flexible eigenvalue.

        The shift must be negative, far from zero for round-off's sake, and not far beyond the first flexible
        eigenvalue, or zero eigenvalues converge late; a first solve with a guess finds the scale.
        """
        n, lowest = self.n_unstrained, self._lowest()
        self._move_to(lowest)
        stiffness, mass = self._pencil.norms()
        self._pencil.shift_to(-1e-9 * stiffness / mass, SCALE_PREFIX)
        pairs = self._pencil.solve(n, 1, self.kinematics.describe(lowest))
        self._pencil.shift_to(-0.5 * pairs.values[n], PREFIX)

    def _sum(self, terms: Mapping[Monomial, sp.csr_matrix]) -> sp.csr_matrix:
        """Return the local rows of a matrix at the problem's parameter values."""
        return weighted_sum(terms, self.values)

    def _lowest(self) -> np.ndarray:
        """Return the configuration at the lower end of every coordinate, shape (n_theta,)."""
        return np.array([coordinate.lower for coordinate in self.kinematics.coordinates])

    def _deflate(self, vectors: np.ndarray, rigid: np.ndarray) -> np.ndarray:
        """Make vectors M-orthogonal to the free rigid motion to the last digits."""
        return vectors if not rigid.shape[1] else vectors - self.onto(rigid, vectors)

    def _check_rigid(self, values: np.ndarray, zeros: np.ndarray, rigid: np.ndarray, where: str) -> None:
        n_free = zeros.shape[1]
        if not n_free:
            return
        largest = np.max(np.abs(values[:n_free])) / values[n_free] if values.size > n_free else 0.0
        if not largest < RIGID_TOLERANCE:
            raise RunError(
                f"eigenproblem at {where}: {n_free} eigenvalues should vanish, but the largest is {largest:.2g} of "
                "the first flexible one"
            )
        m_rigid = self.times_mass(rigid)
        norm = self.inner(rigid, m_rigid)
        part = self.inner(m_rigid, zeros)
        captured = np.trace(np.linalg.solve(norm, part @ part.T)) / n_free
        if not abs(captured - 1.0) < RIGID_TOLERANCE:
            raise RunError(
                f"eigenproblem at {where}: the modes of frequency zero are not the mechanism's rigid motion "
                f"(they share {captured:.6f} of its kinetic energy)"
            )


def _pencil(mass: sp.csr_matrix, stiffness: sp.csr_matrix, loose: np.ndarray, comm: Comm) -> SparsePencil | DensePencil:
    """Return a pencil, given unknowns that tell its rigid motions; PETSc's and SLEPc's where ranks share it, it is
    large, or the user has options for them."""
    small = comm.size == 1 and mass.shape[0] <= MOST_UNKNOWNS
    if small and not any(options_of(prefix) for prefix in (PREFIX, SCALE_PREFIX)):
        return DensePencil(mass, stiffness, loose)
    return SparsePencil(mass, stiffness, comm)
