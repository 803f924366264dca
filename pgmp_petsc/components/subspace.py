"""A subspace of a body's displacements that grows, orthonormal in the mass: columns distributed over ranks by rows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.runtime.matrices import times

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc

# what is left of a vector's M-norm beside the basis when it counts as a combination of it, and of the smallest square
# among the singular values of new vectors of norm 1: both far above their round-off
DEPENDENT = 1e-9
DEPENDENT_AMONG = 1e-12


class Subspace:
    """An M-orthonormal basis V with ``M V`` and ``K V`` beside it. Collective on `comm`.

    Parameters
    ----------
    mass, stiffness
        Symmetric, distributed by rows.
    comm
        Their ranks.

    Attributes
    ----------
    vectors, mass_vectors, stiffness_vectors
        V, M V, K V: local rows, shape (n_local, n).
    """

    def __init__(self, mass: PETSc.Mat, stiffness: PETSc.Mat, comm: MPI.Comm) -> None:
        self._mass, self._stiffness, self.comm = mass, stiffness, comm
        self.vectors = self.mass_vectors = self.stiffness_vectors = np.empty((mass.getLocalSize()[0], 0))

    @property
    def n(self) -> int:
        """Number of vectors."""
        return self.vectors.shape[1]

    def inner(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return ``left^T right`` over the rows of all ranks."""
        from mpi4py import MPI

        return self.comm.allreduce(left.T @ right, op=MPI.SUM)

    def turn_to(self, mass: PETSc.Mat, stiffness: PETSc.Mat) -> None:
        """Make the same span orthonormal in another mass."""
        vectors, self._mass, self._stiffness = self.vectors, mass, stiffness
        self.vectors = self.mass_vectors = self.stiffness_vectors = np.empty((len(vectors), 0))
        self.add(vectors)

    def add(self, columns: np.ndarray) -> int:
        """Add the span of columns (n_local, k), without what is there already; return how many vectors were new."""
        fresh, size = self._normed(columns)
        for _ in range(2):  # twice is enough (Kahan): the second pass removes what round-off left
            left, size = self._normed(fresh - self.vectors @ self.inner(self.mass_vectors, fresh))
            # what vanishes beside the others is round-off, which is not the same in every run
            fresh = left[:, size > DEPENDENT]
        squares, directions = np.linalg.eigh(self.inner(fresh, times(self._mass, fresh)))
        chosen = squares > DEPENDENT_AMONG
        fresh = fresh @ (directions[:, chosen] / np.sqrt(squares[chosen]))
        for _ in range(2):
            fresh = fresh - self.vectors @ self.inner(self.mass_vectors, fresh)
            fresh = fresh @ np.linalg.inv(np.linalg.cholesky(self.inner(fresh, times(self._mass, fresh)))).T
        self.vectors = np.hstack([self.vectors, fresh])
        self.mass_vectors = np.hstack([self.mass_vectors, times(self._mass, fresh)])
        self.stiffness_vectors = np.hstack([self.stiffness_vectors, times(self._stiffness, fresh)])
        return int(chosen.sum())

    def _normed(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return columns with M-norm 1, and the norms that they had, shape (k,)."""
        sizes = np.sqrt(np.diag(self.inner(columns, times(self._mass, columns))))
        return columns / np.where(sizes > 0.0, sizes, 1.0), sizes
