"""What every eigensolver's pairs have to pass: residuals, and that none is missing below the highest."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.runtime.errors import RunError

if TYPE_CHECKING:
    from petsc4py import PETSc

RESIDUAL_TOLERANCE = 1e-6  # of |lambda| |B x|; the eigenvalue's own error is of the order of its square


def check_residuals(
    a: PETSc.Mat, b: PETSc.Mat, values: np.ndarray, vectors: np.ndarray, floor: float, where: str
) -> None:
    """Check residuals relative to the eigenvalue; those of zero eigenvalues to the first positive one.

    Parameters
    ----------
    a, b
        Of ``A x = lambda B x``.
    values, vectors
        Shape (n,), and local rows (n_local, n).
    floor
        The first positive eigenvalue.
    where
        Configuration, for messages.

    Raises
    ------
    RunError
        If one is too large.
    """
    x, ax, bx = a.createVecRight(), a.createVecLeft(), a.createVecLeft()
    try:
        for value, column in zip(values, vectors.T):
            x.setArray(column)
            a.mult(x, ax)
            b.mult(x, bx)
            scale = bx.norm() * max(abs(value), floor)
            ax.axpy(-value, bx)
            residual = ax.norm() / scale
            if not residual < RESIDUAL_TOLERANCE:
                raise RunError(
                    f"eigenproblem at {where}: eigenvalue {value:.6g} has the relative residual {residual:.2g}, "
                    f"above {RESIDUAL_TOLERANCE:g}; the mesh may be too fine for double precision"
                )
    finally:
        for work in (x, ax, bx):
            work.destroy()


def check_complete(
    count_below: Callable[[float], int], values: np.ndarray, n_pairs: int, where: str, cure: str = ""
) -> None:
    """Count the eigenvalues below a gap by inertia, and compare with those found.

    Parameters
    ----------
    count_below
        Number of eigenvalues below a value.
    values
        All that were found, ascending.
    n_pairs
        Number of the lowest ones that are wanted.
    where, cure
        Configuration, and what may help, for messages.

    Raises
    ------
    RunError
        If eigenvalues are missing.
    """
    # the widest relative gap at or above the last wanted pair, so that the count is not ambiguous
    candidates = np.arange(n_pairs, values.size)
    if candidates.size:
        sizes = np.abs(values) + np.finfo(float).tiny
        gaps = np.diff(values)[candidates - 1] / np.maximum(sizes[candidates], sizes[candidates - 1])
        found = int(candidates[np.argmax(gaps)])
        tau = 0.5 * (values[found - 1] + values[found])
    else:
        found, tau = n_pairs, values[n_pairs - 1] + 1e-6 * np.abs(values[n_pairs - 1])
    below = count_below(tau)
    if below != found:
        raise RunError(
            f"eigenproblem at {where}: {below} eigenvalues lie below {tau:.6g} (rad/s)^2 but {found} were found{cure}"
        )
