"""Vibrations of a mechanism on its springs: the eigenproblem of `problem` with the stiffness of springs added,

    (N^T (K + K_s(theta)) N - Lambda N^T M N) psi = 0.

A spring that the rigid motion stretches gives it a stiffness: its frequency, zero without, is the first one of the
mechanism. Springs couple unknowns of different bodies; mass and stiffness have all these entries at all configurations,
so that the nonzero pattern stays one. Springs of negative stiffness, and forces that are there already, may leave
negative eigenvalues, motions that grow: the shift of the solver is moved below them (none is below it, by inertia).

The basis of a reduced model is made of other vectors (`reduction.static_loads`). It holds the rigid motion itself, and
modes with the springs are a poor choice beside it: at 10 MN/m on the slider of the paper's slider-crank the first four
frequencies come out up to 370 % wrong with five of them, 5 % with those of the unsprung mechanism, and 0.04 % with four
of these and the static answer to the spring's force, which holds for any stiffness (tests/verification/
test_spring_modes.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.matrices import weighted_sum
from pgmp_petsc.effects.springs import Block
from pgmp_petsc.modes.problem import PREFIX, ModalProblem
from pgmp_petsc.modes.static_modes import SpringStiffness, is_negative
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.solvers.shift_invert import EigenPairs

if TYPE_CHECKING:
    from mpi4py import MPI

FURTHER = 8.0  # from one shift to the next, on the way below all eigenvalues
MOST_SHIFTS = 20
ROUND_OFF = 1e-12  # of an eigenvalue, as a share of the first one that is of the bodies


class VibrationProblem(ModalProblem):
    """Vibrations at any configuration, for fixed parameter values. Collective on `comm`.

    Parameters
    ----------
    springs
        What springs add to the stiffness; it knows kinematics and parameter values.
    values, n_modes, comm
        As for `ModalProblem`; `n_modes` counts all frequencies but those of rigid motions that no spring resists.

    Attributes
    ----------
    n_rigid
        Number of these rigid motions.
    """

    def __init__(self, springs: SpringStiffness, values: Mapping[str, float], n_modes: int, comm: MPI.Comm) -> None:
        self._springs = springs
        super().__init__(springs.kinematics, values, n_modes, comm)
        self._elastic = weighted_sum(self.matrices.stiffness, values)
        self.n_rigid = self.free.size - springs.n_resisted(self.matrices, comm)

    def eigenvalues(self, theta: np.ndarray) -> np.ndarray:
        """Return the eigenvalues at one configuration (n_theta,), ascending, shape (n_modes,), (rad/s)^2.

        Raises `RunError` if the eigensolver fails, or rigid motions that no spring resists are not what vanishing
        eigenvalues belong to.
        """
        where = self.kinematics.describe(theta)
        blocks = self._springs.at(theta, self.matrices, self.comm)
        self._put(blocks)
        rigid = self._move_to(theta)[0][:, self.free]
        pairs = self._pairs(any(is_negative(block) for block in blocks), where)
        vectors = pairs.vectors
        values = self._refined(vectors, rigid, blocks)
        # no more of them vanish than there are free coordinates
        scale = np.sort(np.abs(values))[: self.free.size + 1][-1]
        values[np.abs(values) < ROUND_OFF * scale] = 0.0
        order = np.argsort(np.abs(values), kind="stable")
        zero, others = np.split(order, [self.n_rigid])
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

    def _put(self, blocks: list[Block]) -> None:
        """Set the stiffness to that of the bodies and of the springs."""
        matrix = self._sum(self.matrices.stiffness)
        matrix.sort_indices()
        place = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)) * matrix.shape[1] + matrix.indices
        for block in blocks:
            own = np.flatnonzero((block.dofs >= self.rows.start) & (block.dofs < self.rows.stop))
            keys = (block.dofs[own, None] - self.rows.start) * matrix.shape[1] + block.dofs
            np.add.at(matrix.data, np.searchsorted(place, keys), block.matrix[own])
        self._pencil.set_stiffness(matrix)

    def _pairs(self, negative: bool, where: str) -> EigenPairs:
        """Return the lowest eigenpairs: rigid motions that no spring resists, and all that is wanted."""
        n_free = self.free.size
        wanted = max(1, self.n_modes - (n_free - self.n_rigid))
        if not negative:
            return self._pencil.solve(n_free, wanted, where)
        usual = shift = self._pencil.shift
        try:
            for _ in range(MOST_SHIFTS):
                self._pencil.shift_to(shift, PREFIX)
                if self._pencil.count_below(shift) == 0:
                    return self._pencil.solve(n_free, wanted, where)
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
