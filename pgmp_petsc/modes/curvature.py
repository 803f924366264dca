"""Curvature of the flexible shapes: static modal derivatives (Wu and Tiso 2016; as a manifold: Jain et al. 2017).

docs/method.md (second order in the deformation) has their equations and why; chi is M-orthogonal to the rigid motion
and to Psi, in space with the momenta of sections that turn (`RotaryCurvature`), but

- of vectors that answer offsets of joints (`modes.built_in`), with gaps ``gamma p + 1/2 gamma' p p``: chi keeps its
  part along them, that of two of them along all vectors, which is at rest, and none of what is stiff in other pairs;
- along stiff vectors (`static_stretching`), with ``K = Psi^T K Psi``, ``M = Psi^T M Psi``, of which chi keeps

      F M^-1 Psi^T M chi[(1 - S) psi_i, (1 - S) psi_j],
      S = s^2 (3 - 2 s),  s = K^-1 K_axial,      F = (1 + a^2)^-1 a^2,  a = tr(A^-1) A / STIFF,  A = M^-1 K,

  and of eigenvectors of A with the values lambda, the part along k of the pair i, j only with the factors
  ``lambda_k^2 / (lambda_k^2 + lambda_i^2)`` and that of j;
- of vectors psi_r without strain, as elastic joints allow them, with which elastic forces turn by rotations phi:

      K chi_rj + K3[psi_r, psi_j] + C^T nu_rj = phi x (K psi_j),    C chi_rj = -c''[psi_r, psi_j],

  of which chi keeps chi_rr along Psi, and chi_rj with the factors F and ``lambda_k^2 / (lambda_k^2 + lambda_j^2)``.

Rotations in space add to inertia at second order: a node's directors are ``d_k = R exp(phi) e_k``, whose second
derivative in two vectors a and b, ``1/2 (a x (b x e_k) + b x (a x e_k))``, is added to chi wherever chi meets the mass.
With the inertia J of the directors at a node (`bodies.matrices`) its momentum on a rotation phi is
``phi . 1/2 ((J a) x b + (J b) x a)``, and accelerations ``A e_k`` of the directors do the work
``a . (sym(A J) - tr(A J) 1) b`` on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh

from pgmp_petsc.bodies.affine import Monomial, total_at
from pgmp_petsc.bodies.beam3d import cross
from pgmp_petsc.bodies.body import Pairs
from pgmp_petsc.bodies.matrices import ThirdDerivative, director_inertia, weighted_sum
from pgmp_petsc.mechanism.constraint_set import RANK_TOLERANCE
from pgmp_petsc.mechanism.mechanism import ConstraintHessian, ConstraintHessians, Mechanism, linear_motion
from pgmp_petsc.mechanism.space import SPATIAL, turning_of_second_order
from pgmp_petsc.modes.built_in import BuiltIn, GapDerivatives
from pgmp_petsc.modes.problem import ModalProblem, ModeSet

# squares of frequencies over that of the softest vectors: five times as fast, a vector is at rest for vibrations of
# twice the softest frequency
STIFF = 25.0


@dataclass(frozen=True, eq=False)
class Curvature:
    """Second derivatives at one configuration, local rows, pairs packed as ``np.tril_indices`` orders them; none are of
    two answers to gaps."""

    pairs: Pairs
    chi: np.ndarray  # second derivatives of the displacement in body frames, shape (n_local, n_pairs)
    #: ``K3_t[psi_i, psi_j]`` for every affine term t, each of shape (n_local, n_pairs)
    third: dict[Monomial, np.ndarray]


class CurvatureProblem:
    """Static modal derivatives at any configuration, at the nominal parameters. Collective on the communicator of
    `problem`.

    `static_stretching` tells whether chi keeps its part along stiff vectors, which stretch the bodies; the last vectors
    of a basis answer the offsets `built_in`.
    """

    def __init__(self, problem: ModalProblem, static_stretching: bool = False, built_in: BuiltIn | None = None) -> None:
        self._problem, self._built_in = problem, built_in
        self._third = ThirdDerivative(problem.mechanism.bodies, problem.rows)
        self.rotary = RotaryCurvature(problem.mechanism)
        self._joints = ConstraintHessians(problem.mechanism, problem.clamped)
        self._axial = weighted_sum(problem.matrices.stretching, problem.values) if static_stretching else None

    def solve(
        self, modes: ModeSet, shape: np.ndarray, answered: np.ndarray, loose: np.ndarray | None = None, n_open: int = 0
    ) -> Curvature:
        """Compute the curvature of the flexible vectors of a basis, `shape`, local rows, (n_local, m), that holds the
        modes at the configuration that the problem is at.

        Each of them answers a load, `answered`, (n_local, m), as from `answered_loads` and combinations of them, zero
        where none is known (joints then take of its elastic forces what they can). Those that are `loose`, (m,), are
        without strain, as elastic joints allow them; none by default. The last ones answer offsets, or without any
        n_open of them gaps of constraints, which are the same wherever the mechanism is. Raises `RunError` if the
        refinement of an answer does not converge.
        """
        loose = np.zeros(shape.shape[1], dtype=bool) if loose is None else loose
        problem, (i, j) = self._problem, np.tril_indices(shape.shape[1])
        known = j < shape.shape[1] - n_open
        i, j = pairs = i[known], j[known]
        everywhere = problem.all_rows(shape)
        third = self._third.times(everywhere, pairs)
        forces = np.zeros((len(problem.rows), i.size)) + total_at(third, problem.values)
        if loose.any():
            elastic = problem.all_rows(problem.times_stiffness(shape))
            forces -= self._turned_forces(modes, everywhere, elastic, loose, pairs)
        what = f"static modal derivatives at {problem.kinematics.describe(modes.theta)}"
        rigid = modes.unstrained
        gaps = None if self._built_in is None or not self._built_in.n else self._built_in.derivatives(modes.theta)
        # modes may be stiff too, and what answers offsets alone, or turns without strain, stays whole
        deflated = modes.eigenvectors if self._axial is None and gaps is None and not loose.any() else rigid
        taken = ~(loose[pairs[0]] | loose[pairs[1]])
        chi = self._answers(modes, deflated, shape, answered, pairs, forces, what, gaps, taken)
        momenta = self.rotary.momenta(everywhere, pairs, problem.values)[problem.rows.start : problem.rows.stop]
        moving = ~loose
        if gaps is not None:
            moving[-self._built_in.n :] = False
        if n_open:
            moving[-n_open:] = False
        bent = shape[:, moving]
        own, free = moving[i] & moving[j], (moving[i] | moving[j]) & ~loose[i] & ~loose[j]
        crossed = free & ~own if self._axial is not None else free
        chi[:, crossed] -= self._along(np.hstack([rigid, bent]), chi[:, crossed], momenta[:, crossed])
        chi[:, ~crossed] -= self._along(rigid, chi[:, ~crossed], momenta[:, ~crossed])
        for number in np.flatnonzero(loose):
            turned = (i == number) & moving[j] | (j == number) & moving[i]  # in the order of the others
            part = problem.inner(bent, problem.times_mass(chi[:, turned]) + momenta[:, turned])
            chi[:, turned] -= bent @ self._left_behind(bent, part)
        if self._axial is not None:
            part = problem.inner(bent, problem.times_mass(chi[:, own]) + momenta[:, own])
            chi[:, own] -= bent @ self._dropped_part(bent, part)
        return Curvature(pairs, chi, third)

    def _turned_forces(
        self, modes: ModeSet, shape: np.ndarray, elastic: np.ndarray, loose: np.ndarray, pairs: Pairs
    ) -> np.ndarray:
        """Return what elastic forces (n_dofs, m) change by as they turn with bodies that move without strain, for pairs
        of vectors, local rows, shape (n_local, n_pairs)."""
        problem, mechanism = self._problem, self._problem.mechanism
        motion, d = problem.kinematics.motion(modes.theta), mechanism.space.dimension
        fields = np.concatenate([motion.velocities[..., modes.free], motion.released], axis=2)
        shares = np.linalg.lstsq(linear_motion(mechanism, fields), shape[:, loose], rcond=None)[0]
        gradients = np.zeros((len(fields), d, d, loose.size))
        gradients[..., loose] = (fields[:, d:] @ shares).reshape(len(fields), d, d, -1)
        (i, j), result = pairs, np.zeros((len(shape), pairs[0].size))
        for body, own in zip(mechanism.bodies, gradients):
            dofs = body.dofs[: body.node_dofs * body.n_nodes].reshape(-1, body.node_dofs)
            # a couple on a rotation vector: (1 - 1/2 phi x) (1 + phi x) of it; angles in the plane add up
            for share, part in ((1.0, dofs[:, :d]), (0.5, dofs[:, d:] if d == 3 else dofs[:, :0])):
                for one, other in ((i, j), (j, i)) if part.size else ():
                    result[part] += share * np.einsum("abp,nbp->nap", own[..., one], elastic[part][..., other])
        return result[problem.rows.start : problem.rows.stop]

    def stiffness_answers(self, modes: ModeSet) -> np.ndarray:
        """Return what tells how a load changes the stiffness of each mode, local rows, shape (n_local, n_modes).

        Under a static load f the eigenvalue of psi_k changes by ``h_k.f``, and under accelerations of the mechanism by
        the work of their inertia forces on h_k. With the static answer u, ``K u + C^T mu = f``, the change is

            psi_k.K3[u] psi_k + mu.c''[psi_k, psi_k] + 2 mu_k.c''[u, psi_k] = - f.chi_kk,

        so that h is ``-chi_kk``, chi deflated of the rigid motion alone. Raises `RunError` if the refinement of an
        answer does not converge.
        """
        problem, flexible = self._problem, modes.flexible
        each = (np.arange(flexible.shape[1]),) * 2
        everywhere = problem.all_rows(flexible)
        forces = self._third.weighted(everywhere, each, problem.values)
        answered = modes.eigenvalues * problem.times_mass(flexible)
        rigid, what = modes.unstrained, "influence of loads on the stiffness"
        chi = self._answers(modes, rigid, flexible, answered, each, forces, what)
        momenta = self.rotary.momenta(everywhere, each, problem.values)[problem.rows.start : problem.rows.stop]
        return self._along(rigid, chi, momenta) - chi

    def _answers(
        self,
        modes: ModeSet,
        kept: np.ndarray,
        shape: np.ndarray,
        answered: np.ndarray,
        pairs: Pairs,
        forces: np.ndarray,
        what: str,
        gaps: GapDerivatives | None = None,
        taken: np.ndarray | bool = True,
    ) -> np.ndarray:
        """Return chi for pairs of vectors but for multiples of kept eigenvectors, given ``K3[psi_i, psi_j]``; forces in
        joints turn with these in the pairs that are `taken`, shape (n_pairs,)."""
        problem = self._problem
        chi = np.zeros_like(forces)
        poses = problem.kinematics.motion(modes.theta).poses
        hessians = self._joints.at(poses)
        if hessians or gaps is not None:
            reactions = problem.all_rows(answered - problem.times_stiffness(shape))
            joints = _TurningJoints(problem.constraints.at(poses), hessians, problem.all_rows(shape), pairs, gaps)
            own = slice(problem.rows.start, problem.rows.stop)
            chi = joints.displacements()[own]
            forces = forces + np.where(taken, joints.forces(reactions)[own], 0.0) + problem.times_stiffness(chi)
        return chi + problem.static_answers(kept, -forces, what)

    def _along(self, basis: np.ndarray, chi: np.ndarray, momenta: np.ndarray) -> np.ndarray:
        """Return the combinations of a basis that have chi's momenta and given ones along the basis."""
        problem = self._problem
        gram = problem.inner(basis, problem.times_mass(basis))
        return basis @ np.linalg.solve(gram, problem.inner(basis, problem.times_mass(chi) + momenta))

    def _left_behind(self, shape: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Return of momenta along Psi (m, m), of what turns with Psi, the components that do not follow at once."""
        problem = self._problem
        stiffness = problem.inner(shape, problem.times_stiffness(shape))
        gram, vectors, stiff, ahead = self._spectrum(stiffness, shape)
        inverse, along = vectors.T @ gram, np.linalg.solve(gram, part)
        return along - vectors @ (stiff[:, None] * ahead * (inverse @ along @ vectors)) @ inverse

    def _spectrum(
        self, stiffness: np.ndarray, shape: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return M along Psi, eigenvectors of stiffness along it, F of each, (m,), and how much faster each is than
        others, as factors, (m, m)."""
        problem = self._problem
        # Psi is M-orthonormal at the nominal parameters but for parameter modes
        gram = problem.inner(shape, problem.times_mass(shape))
        squares, vectors = eigh(stiffness, gram)
        stiff = 1.0 / (1.0 + (STIFF / (squares * np.sum(1.0 / squares))) ** 2)
        return gram, vectors, stiff, 1.0 / (1.0 + (squares / squares[:, None]) ** 2)

    def _dropped_part(self, shape: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Return of momenta along Psi (m, n_pairs) the components that chi does not keep.

        S and F are smooth over the configurations, whatever the basis.
        """
        problem, m, everywhere = self._problem, shape.shape[1], self._problem.all_rows(shape)
        rows, columns = np.tril_indices(m)
        stiffness = problem.inner(shape, problem.times_stiffness(shape))
        gram, vectors, stiff, ahead = self._spectrum(stiffness, shape)
        share = np.linalg.solve(stiffness, problem.inner(shape, self._axial @ everywhere))
        bending = np.eye(m) - share @ share @ (3.0 * np.eye(m) - 2.0 * share)
        inverse, bending = vectors.T @ gram, bending @ vectors
        along = np.empty((m, m, m))
        along[:, rows, columns] = along[:, columns, rows] = np.linalg.solve(gram, part)
        kept = bending.T @ np.tensordot(inverse, along, axes=1) @ bending
        kept *= stiff[:, None, None] * ahead[:, :, None] * ahead[:, None]
        return (along - inverse.T @ np.tensordot(vectors, kept, axes=1) @ inverse)[:, rows, columns]

    def answered_loads(self, modes: ModeSet, static: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Return the loads that modes and static modes answer, shape (n_local, n_modes + n_static).

        Those of modes are their inertia forces; those of static modes, local rows, shape (n_local, n_static),
        combinations of the given loads, in their order, of the same shape in body frames, balanced by inertia forces.
        """
        problem = self._problem
        inertia = modes.eigenvalues * problem.times_mass(modes.flexible)
        if not static.shape[1]:
            return inertia
        kept = modes.eigenvectors
        m_kept = problem.times_mass(kept)
        balanced = loads - m_kept @ np.linalg.solve(problem.inner(kept, m_kept), problem.inner(kept, loads))
        # S = K^-1 B R with an unknown R, so that S^T K S = S^T B R
        stiffness = problem.inner(static, problem.times_stiffness(static))
        # a load may vanish at a configuration where its answer is the limit of those beside
        shares = np.linalg.lstsq(problem.inner(static, balanced), stiffness, rcond=None)[0]
        return np.hstack([inertia, balanced @ shares])


class _TurningJoints:
    """Contribution of joints that turn with a body to displacements and forces of second order; all rows, every rank.

    In body frames are C, shape (n_constraints, n_dofs), second derivatives of the joints that are not linear, and Psi,
    shape (n_dofs, m); pairs are the numbers i and j of vectors, shape (n_pairs,) each, and gaps those of the offsets
    that the last vectors answer, if there are any.
    """

    def __init__(
        self,
        jacobian: sp.csr_matrix,
        hessians: list[ConstraintHessian],
        shape: np.ndarray,
        pairs: Pairs,
        gaps: GapDerivatives | None,
    ) -> None:
        self._touched, self._hessians, self._shape, self._pairs = np.unique(jacobian.indices), hessians, shape, pairs
        self._jacobian = jacobian[:, self._touched].toarray()
        self._bends = np.zeros((0, 0, 0)) if gaps is None else gaps.bends
        slopes = () if gaps is None else gaps.slopes
        self._slopes = dict(enumerate((own[:, self._touched] for own in slopes), shape.shape[1] - len(slopes)))

    def _beside(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield the number of every vector that answers an offset, pairs that it is in and the others in these."""
        for k in self._slopes:
            for own, others in (self._pairs, self._pairs[::-1]):
                yield k, np.flatnonzero(own == k), others[own == k]

    def displacements(self) -> np.ndarray:
        """Return some vectors with ``C x_ij = -c''[psi_i, psi_j]``, shape (n_dofs, n_pairs)."""
        i, j = self._pairs
        closing = np.zeros((len(self._jacobian), i.size))
        for hessian in self._hessians:
            psi = self._shape[hessian.dofs]
            closing[hessian.rows] = -np.einsum("ckl,kp,lp->cp", hessian.values, psi[:, i], psi[:, j])
        for k, which, others in self._beside():
            closing[: self._slopes[k].shape[0], which] -= self._slopes[k] @ self._shape[self._touched][:, others]
        first = self._shape.shape[1] - len(self._slopes)
        both = np.flatnonzero((i >= first) & (j >= first))
        closing[: self._bends.shape[2], both] -= self._bends[i[both] - first, j[both] - first].T
        result = np.zeros((len(self._shape), i.size))
        result[self._touched] = np.linalg.lstsq(self._jacobian, closing, rcond=RANK_TOLERANCE)[0]
        return result

    def forces(self, reactions: np.ndarray) -> np.ndarray:
        """Return ``(mu_i.c'') psi_j + (mu_j.c'') psi_i``, shape (n_dofs, n_pairs), from ``C^T mu_i``, shape (n_dofs,
        m)."""
        i, j = self._pairs
        multipliers = np.linalg.lstsq(self._jacobian.T, reactions[self._touched], rcond=RANK_TOLERANCE)[0]
        result = np.zeros((len(self._shape), i.size))
        for hessian in self._hessians:
            turned = np.einsum("cm,ckl,ln->kmn", multipliers[hessian.rows], hessian.values, self._shape[hessian.dofs])
            result[hessian.dofs] += turned[:, i, j] + turned[:, j, i]
        for k, which, others in self._beside():
            slope = self._slopes[k]
            result[np.ix_(self._touched, which)] += slope.T @ multipliers[: slope.shape[0], others]
        return result


class RotaryCurvature:
    """The directors of all nodes of a mechanism; bodies on meshes and condensed ones have none with mass."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._n_dofs = mechanism.n_dofs
        self._parts: list[tuple[int, Monomial, np.ndarray, np.ndarray]] = []  # body, weight, rotations, J
        if mechanism.space is not SPATIAL:
            return
        for number, body in enumerate(mechanism.bodies):
            turns = 6 * np.arange(body.nodes.start, body.nodes.stop)[:, None] + np.arange(3, 6)
            self._parts += [(number, weight, turns, inertia) for weight, inertia in director_inertia(body).items()]

    def momenta(self, vectors: np.ndarray, pairs: Pairs, values: Mapping[str, float]) -> np.ndarray:
        """Return the momenta on all unknowns for pairs of vectors (n_dofs, m), shape (n_dofs, n_pairs)."""
        result = np.zeros((self._n_dofs, pairs[0].size))
        for _, weight, turns, inertia in self._parts:
            a, b = vectors[turns][:, :, pairs[0]], vectors[turns][:, :, pairs[1]]
            held_a, held_b = inertia @ a, inertia @ b
            crossed = cross(held_a, b, axis=1) + cross(held_b, a, axis=1)
            result[turns] += 0.5 * float(weight.evaluate(values)) * crossed
        return result

    def work(self, accelerations: np.ndarray, vectors: np.ndarray, pairs: Pairs, weight: Monomial) -> np.ndarray:
        """Return the work of accelerations on pairs of vectors (n_dofs, m) in one term of the mass, shape (k, n_pairs).

        Accelerations are linear fields of every body, shape (n_bodies, 12, k): `Space.acceleration_field`.
        """
        result = np.zeros((accelerations.shape[2], pairs[0].size))
        for number, own, turns, inertia in self._parts:
            if own != weight:
                continue
            gradients = np.moveaxis(accelerations[number, 3:].reshape(3, 3, -1), -1, 0)
            curved = turning_of_second_order(gradients[:, None] @ inertia)
            a, b = vectors[turns][:, :, pairs[0]], vectors[turns][:, :, pairs[1]]
            result += np.einsum("knij,nip,njp->kp", curved, a, b, optimize=True)
        return result
