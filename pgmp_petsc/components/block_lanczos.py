"""Elastic modes of a free body by block Lanczos with the inverse of its shifted stiffness.

The lowest eigenvalues of ``K x = lambda M x`` are the highest ones nu of

    (K - sigma M)^-1 M x = nu x,    lambda = sigma + 1 / nu,

self-adjoint in the mass. An M-orthonormal basis V with its images W under that operator grows by the residuals
``W y - nu V y`` of the Ritz pairs that have not converged yet: the same spaces as those of block Lanczos, without new
directions for pairs that are done. A block costs one pass over the factor where vectors one by one cost one each, and
a pass is what takes the time: a large factor comes from memory, or from a disk.

Polynomials of the place are the first block. They are near the lowest modes of slender bodies and hold the rigid
motion; rough waves besides see to it that no mode is orthogonal to all of them.

A subspace of a body's displacements that grows, orthonormal in the mass: columns distributed over ranks by rows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh

from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.petsc import times
from pgmp_petsc.solvers.eigenpair_checks import check_complete, check_residuals

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


TOLERANCE = 1e-9  # of a mode shape in the norm of the mass; the eigenvalue's error is of the order of its square
USABLE = 1e-3  # the same, of a mode beyond those wanted that helps to find a gap
SPARE = 3  # of those
MAX_ROUNDS = 60
ATTEMPTS = 3  # with other waves each, where modes were missed
N_WAVES = 4


class BlockLanczos:
    """The lowest modes of one body. Collective on `comm`.

    Parameters
    ----------
    mass, stiffness
        Symmetric, of one pattern, distributed by rows.
    inverse
        ``(K - sigma M)^-1`` times local columns (n_local, k).
    shift
        sigma, below all eigenvalues.
    start
        Local columns of the first block.
    comm
        Ranks that share the body.
    """

    def __init__(
        self,
        mass: PETSc.Mat,
        stiffness: PETSc.Mat,
        inverse: Callable[[np.ndarray], np.ndarray],
        shift: float,
        start: np.ndarray,
        comm: MPI.Comm,
    ) -> None:
        self._mass, self._stiffness, self._shift = mass, stiffness, shift
        self._basis = Subspace(mass, lambda _, momenta: inverse(momenta), comm)
        self._basis.add(np.hstack([start, self._waves(0)]))

    def solve(
        self, n_rigid: int, n_flexible: int, count_below: Callable[[float], int], where: str
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest eigenvalues (n,), rigid ones first, and modes (n_local, n), after they passed all checks.

        Raises
        ------
        RunError
            If they do not converge, a residual is too large, or eigenvalues are missing.
        """
        n_pairs = n_rigid + n_flexible
        for attempt in range(1, ATTEMPTS + 1):
            values, vectors = self._converged(n_pairs, where)
            check_residuals(self._stiffness, self._mass, values[:n_pairs], vectors, abs(values[n_rigid]), where)
            if values.size == self._mass.getSize()[0]:
                break
            try:
                check_complete(count_below, values, n_pairs, where)
                break
            except RunError:
                if attempt == ATTEMPTS:
                    raise
            self._basis.add(self._waves(attempt))
        return values[:n_pairs], vectors

    def _converged(self, n_pairs: int, where: str) -> tuple[np.ndarray, np.ndarray]:
        """Grow the basis until the lowest pairs have settled; return their eigenvalues and usable ones beyond, and
        the modes of the former. The basis is then that of all of them."""
        basis = self._basis
        for _ in range(MAX_ROUNDS):
            projected = basis.inner(basis.mass_vectors, basis.images)
            nu, turn = (part[..., ::-1][..., : n_pairs + SPARE] for part in eigh(0.5 * (projected + projected.T)))
            images = basis.images @ turn
            residuals = images - basis.vectors @ (turn * nu)
            errors = basis.norms(residuals) / nu
            waiting = errors > TOLERANCE
            if not waiting[:n_pairs].any() or basis.add(residuals[:, waiting]) == 0:
                break
        if nu.size < n_pairs or errors[:n_pairs].max() > USABLE:
            raise RunError(
                f"eigenproblem at {where}: {int((errors[:n_pairs] <= TOLERANCE).sum())} of {n_pairs} eigenpairs "
                f"converged in {MAX_ROUNDS} rounds with the tolerance {TOLERANCE:g}"
            )
        basis.keep(turn)
        # what the inverse makes of a Ritz vector is the better and smoother one
        vectors = images[:, :n_pairs] / basis.norms(images[:, :n_pairs])
        n_usable = n_pairs + int(np.cumprod(errors[n_pairs:] < USABLE).sum())
        return self._shift + 1.0 / nu[:n_usable], vectors

    def _waves(self, attempt: int) -> np.ndarray:
        """Return incommensurate waves over the unknowns, local columns."""
        first, last = self._mass.getOwnershipRange()
        rows, numbers = np.arange(first, last), 1 + N_WAVES * attempt + np.arange(N_WAVES)
        places = 1.0 + rows * (np.sqrt(5.0) / self._mass.getSize()[0])
        return np.cos(np.outer(places, 1.0 + np.sqrt(2.0) * numbers))
