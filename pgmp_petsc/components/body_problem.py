"""A free body at given parameter values: its factor, its lowest modes, and its answers to loads.

Everything comes from one factor of ``K - sigma M`` with a negative shift of the order of the first elastic eigenvalue,
so that it is positive definite although K has the body's rigid motion in its null space. A second factor counts the
eigenvalues below a gap; it is not kept.

Displacement fields that are polynomials of the place: first guesses of modes.

A body's affine matrices in PETSc: ``A = sum_i w_i A_i`` with weights w_i that parameter values give.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.polynomial.legendre import legval
from scipy.linalg import eigh

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.components.block_lanczos import BlockLanczos
from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.petsc import aij_matrix, times
from pgmp_petsc.runtime.resources import give_back
from pgmp_petsc.solvers.shifted_factor import ShiftedFactor

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc


Terms = Mapping[Monomial, "PETSc.Mat"]


def petsc_terms(rows: dict[Monomial, sp.csr_matrix], comm: MPI.Comm) -> dict[Monomial, PETSc.Mat]:
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
    """A free body's matrices and factor at given parameter values. Collective on `comm`.

    Parameters
    ----------
    mass, stiffness
        By weight; they stay the caller's.
    values
        Parameter values.
    places
        This rank's nodes, shape (n, d), m.
    comm
        Ranks that share the body.
    memory
        What the factor may take on this rank, bytes; beyond that it is kept in files. None for as much as there is.
    name
        The body's, for messages.
    """

    def __init__(
        self,
        mass: Terms,
        stiffness: Terms,
        values: Mapping[str, float],
        places: np.ndarray,
        comm: MPI.Comm,
        memory: float | None = None,
        name: str = "",
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

        Raises
        ------
        InputError
            If the stiffness is not positive, or more than rigid motion is free of it.
        RunError
            If modes do not converge or are missing.
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
        from mpi4py import MPI

        fields = polynomial_fields(self._places, self.comm)
        products = [fields.T @ times(matrix, fields) for matrix in (self.stiffness, self.mass)]
        stiffness, mass = self.comm.allreduce(np.array(products), op=MPI.SUM)
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


def polynomial_fields(places: np.ndarray, comm: MPI.Comm, degree: int = DEGREE) -> np.ndarray:
    """Return polynomials up to a degree in every direction, as products of Legendre's over the body's box.

    Collective on `comm`, whose ranks have different places.

    Parameters
    ----------
    places
        This rank's nodes, shape (n, d), m.

    Returns
    -------
    ndarray, shape (n d, n_fields)
    """
    from mpi4py import MPI

    n, d = places.shape
    lowest, highest = places.min(axis=0, initial=np.inf), places.max(axis=0, initial=-np.inf)
    comm.Allreduce(MPI.IN_PLACE, lowest, MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, highest, MPI.MAX)
    scaled = (2.0 * places - lowest - highest) / (highest - lowest)
    along = [[legval(x, np.eye(degree + 1)[k]) for k in range(degree + 1)] for x in scaled.T]
    powers = [power for power in product(range(degree + 1), repeat=d) if sum(power) <= degree]
    scalars = [np.prod([along[i][k] for i, k in enumerate(power)], axis=0) for power in powers]
    fields = np.einsum("fn,ij->nifj", np.array(scalars).reshape(len(powers), n), np.eye(d))
    return fields.reshape(n * d, -1)
