"""The unknowns that no constraint touches, eliminated from a dense pencil once for all configurations.

Constraints move with the configuration, and only the unknowns that they touch (o) change their part in the problem with
them. With the others (i) first, ``A = K - sigma M`` is

    A = [ L  0 ] [ I  0 ] [ L^T  X ]        X = L^-1 A_io,   A_ii = L L^T,   S = A_oo - X^T X,
        [X^T I ] [ 0  S ] [ 0    I ],

where L, X and S are constant. In the unknowns ``xi = L^T u_i + X u_o`` and u_o the mass is constant as well:

    [ C    Y ]      C = L^-1 M_ii L^-T,   Q = L^-1 M_io,   Y = Q - C X,
    [ Y^T  Z ],     Z = M_oo - X^T Q - Q^T X + X^T C X.

This is block Cholesky factorisation (Golub, Van Loan 2013, section 4.2.9), as stable as that of the whole matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from pgmp_petsc.runtime.errors import RunError


@dataclass(frozen=True, eq=False)
class Interior:
    """What is constant over the configurations.

    Attributes
    ----------
    inner, outer
        Numbers of the unknowns that no constraint touches and of the others, shapes (n_i,) and (n_o,).
    factor
        L, lower, shape (n_i, n_i).
    coupling
        X, shape (n_i, n_o).
    remainder
        S, shape (n_o, n_o).
    mass, mixed_mass, outer_mass
        C, of which the upper triangle is not set, Y and Z, shapes (n_i, n_i), (n_i, n_o) and (n_o, n_o).
    """

    inner: np.ndarray
    outer: np.ndarray
    factor: np.ndarray
    coupling: np.ndarray
    remainder: np.ndarray
    mass: np.ndarray
    mixed_mass: np.ndarray
    outer_mass: np.ndarray

    @classmethod
    def of(cls, mass: np.ndarray, shifted: np.ndarray, outer: np.ndarray, what: str) -> Interior:
        """Eliminate all unknowns but the outer ones from M and ``K - sigma M``, shapes (n_dofs, n_dofs).

        Raises
        ------
        RunError
            If ``K - sigma M`` is not positive definite; `what` says of what.
        """
        inner = np.setdiff1d(np.arange(len(mass)), outer)
        ii, io, oo = np.ix_(inner, inner), np.ix_(inner, outer), np.ix_(outer, outer)
        factor = cholesky(shifted[ii], what)
        x, q = forward(factor, shifted[io]), forward(factor, mass[io])
        c = congruent(mass[ii], factor)
        cx = np.tril(c) @ x + np.tril(c, -1).T @ x
        xq = x.T @ q
        return cls(inner, outer, factor, x, shifted[oo] - x.T @ x, c, q - cx, mass[oo] - xq - xq.T + x.T @ cx)


def cholesky(matrix: np.ndarray, what: str) -> np.ndarray:
    """Return the lower Cholesky factor.

    Raises
    ------
    RunError
        If the matrix is not positive definite, or not finite.
    """
    if not len(matrix):
        return matrix
    factor, failed = lapack.dpotrf(matrix, lower=1)
    if failed or not np.isfinite(factor).all():
        raise RunError(f"{what}: the matrix is not positive definite; the mesh may be too fine for double precision")
    return factor


def forward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return ``L^-1`` times columns (n, k), for a lower factor L."""
    return lapack.dtrtrs(factor, right, lower=1)[0] if right.size else right


def backward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return ``L^-T`` times columns (n, k), for a lower factor L."""
    return lapack.dtrtrs(factor, right, lower=1, trans=1)[0] if right.size else right


def congruent(matrix: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the lower triangle of ``L^-1 A L^-T`` for that of a symmetric matrix; the other entries mean nothing."""
    return lapack.dsygst(matrix, factor, itype=1, lower=1)[0] if len(matrix) else matrix
