"""A free body at given parameter values: its factor, its lowest modes, and its answers to loads.

Everything comes from one factor of ``K - sigma M`` with a negative shift of the order of the first elastic eigenvalue,
so that it is positive definite although K has the body's rigid motion in its null space. A second factor counts the
eigenvalues below a gap; it is not kept. A body's affine matrices are in PETSc: ``A = sum_i w_i A_i`` with weights w_i
that parameter values give.

Elastic modes of a free body are found by block Lanczos with the inverse of its shifted stiffness. The lowest
eigenvalues of ``K x = lambda M x`` are the highest ones nu of

    (K - sigma M)^-1 M x = nu x,    lambda = sigma + 1 / nu,

self-adjoint in the mass. An M-orthonormal basis V with its images W under that operator grows by the residuals ``W y -
nu V y`` of the Ritz pairs that have not converged yet: the same spaces as those of block Lanczos, without new
directions for pairs that are done. A block costs one pass over the factor where vectors one by one cost one each, and a
pass is what takes the time: a large factor comes from memory, or from a disk.

Polynomials of the place are the first block. They are near the lowest modes of slender bodies and hold the rigid
motion; rough waves besides see to it that no mode is orthogonal to all of them. The basis that grows is distributed
over ranks by rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.polynomial.legendre import legval
from scipy.linalg import eigh

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.resources import give_back
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import incommensurate
from pgmp_petsc.ranks.petsc import aij_matrix, times
from pgmp_petsc.solvers.shift_invert import ShiftedFactor, check_complete, check_residuals

if TYPE_CHECKING:
    from petsc4py import PETSc

# what is left of a vector's M-norm beside the basis when it counts as a combination of it, and of the smallest square
# among the singular values of new vectors of norm 1: both far above their round-off
DEPENDENT = 1e-9
DEPENDENT_AMONG = 1e-12


#: What an operator makes of vectors v, given v and M v, local rows (n_local, k).
Operator = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Subspace:
    """An M-orthonormal basis V with ``M V`` and its images under an operator beside it. Collective on `comm`.

    The mass is symmetric, distributed by rows, and the operator linear and symmetric; V, M V and the images are local
    rows, shape (n_local, n).
    """

    def __init__(self, mass: PETSc.Mat, operator: Operator, comm: Comm) -> None:
        self._mass, self._operator, self.comm = mass, operator, comm
        self.vectors = self.mass_vectors = self.images = np.empty((mass.getLocalSize()[0], 0))

    @property
    def n(self) -> int:
        """Number of vectors."""
        return self.vectors.shape[1]

    def inner(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return ``left^T right`` over the rows of all ranks."""
        return self.comm.allreduce(left.T @ right)

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
        return np.sqrt(self.comm.allreduce(np.einsum("ik,ik->k", columns, times(self._mass, columns))))

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
    """The lowest modes of one body, which ranks share. Collective on `comm`.

    Mass and stiffness are symmetric, of one pattern, distributed by rows; the inverse is ``(K - sigma M)^-1`` times
    local columns (n_local, k), with sigma below all eigenvalues. The first block begins with the columns `start`.
    """

    def __init__(
        self,
        mass: PETSc.Mat,
        stiffness: PETSc.Mat,
        inverse: Callable[[np.ndarray], np.ndarray],
        shift: float,
        start: np.ndarray,
        comm: Comm,
    ) -> None:
        self._mass, self._stiffness, self._shift = mass, stiffness, shift
        self._basis = Subspace(mass, lambda _, momenta: inverse(momenta), comm)
        self._basis.add(np.hstack([start, self._waves(0)]))

    def solve(
        self, n_rigid: int, n_flexible: int, count_below: Callable[[float], int], where: str
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest eigenvalues (n,), rigid ones first, and modes (n_local, n), after they passed all checks.

        Raises `RunError` if they do not converge, a residual is too large, or eigenvalues are missing.
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
        rows, numbers = np.arange(*self._mass.getOwnershipRange()), 1 + N_WAVES * attempt + np.arange(N_WAVES)
        return incommensurate(rows, self._mass.getSize()[0], numbers)


Terms = Mapping[Monomial, "PETSc.Mat"]


def petsc_terms(rows: dict[Monomial, sp.csr_matrix], comm: Comm) -> dict[Monomial, PETSc.Mat]:
    """Return distributed matrices of this rank's rows by weight, and empty `rows`: large ones are held once only."""
    terms = {}
    for weight in list(rows):
        local = rows.pop(weight)
        terms[weight] = aij_matrix(local, comm, local.shape[0])
    return terms


def matrix_sum(terms: Terms, values: Mapping[str, float]) -> tuple[PETSc.Mat, bool]:
    """Return the sum at parameter values, and whether it is a new matrix: a single term of weight 1 is its own sum."""
    (first, matrix), *others = ((float(weight.evaluate(values)), matrix) for weight, matrix in terms.items())
    if not others and first == 1.0:
        return matrix, False
    total = matrix.duplicate(copy=True)
    total.scale(first)
    for weight, other in others:
        total.axpy(weight, other, structure=other.Structure.SAME_NONZERO_PATTERN)
    return total, True


PREFIX = "pgmp_body_"
ZERO = 1e-4  # of the shift, which is of the order of the first elastic eigenvalue: what counts as none
DEPENDENT_FIELDS = 1e-9  # of the largest square, for polynomials between -1 and 1


class BodyProblem:
    """A free body's matrices and factor at given parameter values. Collective on `comm`, whose ranks share it.

    Terms come by weight; they stay the caller's. Places are those of this rank's nodes, shape (n, d), m. Beyond
    `memory` bytes on this rank the factor is kept in files; None is as much as there is. Messages have the body's name.
    """

    def __init__(
        self,
        mass: Terms,
        stiffness: Terms,
        values: Mapping[str, float],
        places: np.ndarray,
        comm: Comm,
        memory: float | None,
        name: str,
    ) -> None:
        d = places.shape[1]
        self.comm, self._places, self._n_rigid, self._where = comm, places, d * (d + 1) // 2, f"body {name}".strip()
        self._sums = [matrix_sum(terms, values) for terms in (mass, stiffness)]
        self.mass, self.stiffness = (matrix for matrix, _ in self._sums)
        for matrix in (self.mass, self.stiffness):
            matrix.setOption(matrix.Option.SYMMETRIC, True)
        self._memory, self._factor, self._entry = memory, None, f"bodies.{name}"

    def modes(self, n_modes: int) -> tuple[np.ndarray, np.ndarray]:
        """Return eigenvalues (n_modes,) and elastic modes (n_local, n_modes) of the free body; after `factor`.

        Raises `InputError` if the stiffness is not positive, or more than rigid motion is free of it; `RunError` if
        modes do not converge or are missing.
        """
        start = polynomial_fields(self._places, self.comm)
        lanczos = BlockLanczos(self.mass, self.stiffness, self.answers, self._shift, start, self.comm)
        try:
            values, vectors = lanczos.solve(self._n_rigid, n_modes, self._count_below, self._where)
        except RunError:
            self._check_stiffness()
            raise
        return values[self._n_rigid :], vectors[:, self._n_rigid :]

    def _check_stiffness(self) -> None:
        """Refuse a stiffness that explains why modes were not found: their checks are shares of the first elastic
        eigenvalue, which then is no more than that of a rigid motion."""
        n_negative, n_low = (self._count_below(sign * ZERO * abs(self._shift)) for sign in (-1.0, 1.0))
        if n_negative:
            raise self._not_positive(f"{n_negative} of its eigenvalues are negative")
        if n_low > self._n_rigid:
            raise InputError(
                f"{self._entry}: {n_low} motions are free of stiffness, and {self._n_rigid} of them are rigid; the "
                "others are hinges or slides inside of it, or hourglass modes of elements with reduced integration: "
                "let each body be one elastic piece, of fully integrated elements"
            )

    def _not_positive(self, found: str) -> InputError:
        return InputError(
            f"{self._entry}: its stiffness is not positive: {found}; it must be that of an elastic body at rest, "
            "without preload"
        )

    def factor(self) -> None:
        """Factor ``K - sigma M`` for `modes` and `answers`."""
        give_back()  # what the assembly needed
        self._shift = -0.5 * self._lowest()
        self._factor = ShiftedFactor(self.mass.getComm(), f"{PREFIX}st_", self._memory)
        what = f"{self._where}, factorisation with the shift {self._shift:.6g}"
        self._factor.factor(self.stiffness, self.mass, self._shift, what)

    def _count_below(self, tau: float) -> int:
        """Return the number of eigenvalues below tau; nothing of what it takes stays."""
        give_back()  # the larger part of the basis
        count = ShiftedFactor(self.mass.getComm(), f"{PREFIX}count_", counts=True)
        try:
            count.factor(self.stiffness, self.mass, tau, f"{self._where}, count of the eigenvalues below {tau:.6g}")
            return count.negative_pivots()
        finally:
            count.close()

    def _lowest(self) -> float:
        """Return an upper bound of the first elastic eigenvalue, of its order: Rayleigh-Ritz with polynomials of the
        place."""
        fields = polynomial_fields(self._places, self.comm)
        products = [fields.T @ times(matrix, fields) for matrix in (self.stiffness, self.mass)]
        stiffness, mass = self.comm.allreduce(np.array(products))
        # few nodes across a body do not tell all polynomials apart
        squares, directions = eigh(mass)
        chosen = squares > DEPENDENT_FIELDS * squares[-1]
        basis = directions[:, chosen] / np.sqrt(squares[chosen])
        found = float(eigh(basis.T @ stiffness @ basis, eigvals_only=True)[self._n_rigid])
        if not found > 0.0:
            raise self._not_positive(f"a smooth displacement has the Rayleigh quotient {found:.3g}")
        return found

    def answers(self, loads: np.ndarray) -> np.ndarray:
        """Return ``(K - sigma M)^-1`` times local columns (n_local, k); after `factor`."""
        return self._factor.apply_inverse(loads, f"{self._where}, linear system with the shift {self._shift:.6g}")

    def close(self) -> None:
        """Destroy the PETSc objects."""
        if self._factor is not None:
            self._factor.close()
        for matrix, own in self._sums:
            if own:
                matrix.destroy()
        give_back()


DEGREE = 3


def polynomial_fields(places: np.ndarray, comm: Comm) -> np.ndarray:
    """Return polynomials up to `DEGREE` in every direction, as products of Legendre's over the body's box, shape (n d,
    n_fields).

    Collective on `comm`, whose ranks have different places, those of their nodes, shape (n, d), m.
    """
    from mpi4py import MPI

    n, d = places.shape
    lowest, highest = places.min(axis=0, initial=np.inf), places.max(axis=0, initial=-np.inf)
    comm.Allreduce(MPI.IN_PLACE, lowest, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, highest, MPI.MAX)
    scaled = (2.0 * places - lowest - highest) / (highest - lowest)
    along = [[legval(x, np.eye(DEGREE + 1)[k]) for k in range(DEGREE + 1)] for x in scaled.T]
    powers = [power for power in product(range(DEGREE + 1), repeat=d) if sum(power) <= DEGREE]
    scalars = [np.prod([along[i][k] for i, k in enumerate(power)], axis=0) for power in powers]
    return np.einsum("fn,ij->nifj", np.array(scalars).reshape(len(powers), n), np.eye(d)).reshape(n * d, -1)
