"""Displacement fields that are polynomials of the place: first guesses of modes."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial.legendre import legval

if TYPE_CHECKING:
    from mpi4py import MPI

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
