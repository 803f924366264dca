"""A subspace of a body's displacements that grows, orthonormal in the mass: columns distributed over ranks by rows."""

from __future__ import annotations

from collections.abc import Callable
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


#: What an operator makes of vectors v, given v and M v, local rows (n_local, k).
Operator = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Subspace:
    """An M-orthonormal basis V with ``M V`` and its images under an operator beside it. Collective on `comm`.

    Parameters
    ----------
    mass
        Symmetric, distributed by rows.
    operator
        Linear, symmetric.
    comm
        The ranks of both.

    Attributes
    ----------
    vectors, mass_vectors, images
        V, M V, and the operator's images of V: local rows, shape (n_local, n).
    """

    def __init__(self, mass: PETSc.Mat, operator: Operator, comm: MPI.Comm) -> None:
        self._mass, self._operator, self.comm = mass, operator, comm
        self.vectors = self.mass_vectors = self.images = np.empty((mass.getLocalSize()[0], 0))

    @property
    def n(self) -> int:
        """Number of vectors."""
        return self.vectors.shape[1]

    def inner(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return ``left^T right`` over the rows of all ranks."""
        from mpi4py import MPI

        return self.comm.allreduce(left.T @ right, op=MPI.SUM)

    def turn_to(self, mass: PETSc.Mat, operator: Operator) -> None:
        """Make the same span orthonormal in another mass."""
        vectors, self._mass, self._operator = self.vectors, mass, operator
        self.vectors = self.mass_vectors = self.images = np.empty((len(vectors), 0))
        self.add(vectors)

    def keep(self, turn: np.ndarray) -> None:
        """Keep the span of ``V turn`` only; turn has orthonormal columns, shape (n, k)."""
        self.vectors, self.mass_vectors = self.vectors @ turn, self.mass_vectors @ turn
        self.images = self.images @ turn

    def add(self, columns: np.ndarray) -> int:
        """Add the span of columns (n_local, k), without what is there already; return how many vectors were new."""
        fresh, momenta, _ = self._normed(columns)
        # twice is enough (Kahan): the second pass removes what round-off left. Products with the mass cost most here;
        # those of what is added to or taken from vectors follow, and are found anew where a difference may be small
        fresh, momenta, size = self._normed(self._beside(fresh, momenta)[0])
        # what vanishes beside the others is round-off, which is not the same in every run
        fresh, momenta = self._beside(fresh[:, size > DEPENDENT], momenta[:, size > DEPENDENT])
        squares, directions = np.linalg.eigh(self.inner(fresh, momenta))
        chosen = squares > DEPENDENT_AMONG
        if not chosen.any():  # a mesh of few unknowns, whose whole space is here; no solver takes no columns
            return 0
        fresh = fresh @ (directions[:, chosen] / np.sqrt(squares[chosen]))
        for _ in range(2):
            momenta = times(self._mass, fresh)
            fresh, momenta = self._beside(fresh, momenta)
            turn = np.linalg.inv(np.linalg.cholesky(self.inner(fresh, momenta))).T
            fresh, momenta = fresh @ turn, momenta @ turn
        self.vectors = np.hstack([self.vectors, fresh])
        self.mass_vectors = np.hstack([self.mass_vectors, momenta])
        self.images = np.hstack([self.images, self._operator(fresh, momenta)])
        return int(chosen.sum())

    def norms(self, columns: np.ndarray) -> np.ndarray:
        """Return the M-norms of local columns (n_local, k), shape (k,)."""
        from mpi4py import MPI

        squares = np.einsum("ik,ik->k", columns, times(self._mass, columns))
        return np.sqrt(self.comm.allreduce(squares, op=MPI.SUM))

    def _beside(self, columns: np.ndarray, momenta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return columns, and their products with the mass, without their parts in the basis."""
        parts = self.inner(self.mass_vectors, columns)
        return columns - self.vectors @ parts, momenta - self.mass_vectors @ parts

    def _normed(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return columns with M-norm 1, their products with the mass, and the norms that they had, shape (k,)."""
        momenta = times(self._mass, columns)
        sizes = np.sqrt(np.diag(self.inner(columns, momenta)))
        scale = np.where(sizes > 0.0, sizes, 1.0)
        return columns / scale, momenta / scale, sizes
