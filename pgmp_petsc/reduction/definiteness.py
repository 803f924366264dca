"""Whether interpolated mass and stiffness are still positive definite between the samples.

At the samples they are by construction; a sum of interpolated entries need not be. A reduced model with a negative mass
or stiffness runs away as soon as the steps are small enough to see it (Amsallem et al. 2009 interpolate on the manifold
of definite matrices for that; here a basis that is smooth enough is asked for instead).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.reduction.tables import ReducedTables

PLACES = (0.25, 0.5, 0.75)  # of every interval between samples
MIDDLE = (0.5,)  # the same over several coordinates, whose cells are many
SMALLEST = 1e-6  # eigenvalue of a matrix with unit diagonal


def indefinite_between(tables: ReducedTables, scheme: str, values: Mapping[str, np.ndarray], n_samples: int) -> str:
    """Say where flexible mass or stiffness is indefinite between samples; empty where it is nowhere.

    Parameters
    ----------
    tables
        In the continuous basis.
    scheme
        Interpolation over the samples.
    values, n_samples
        Parameter values to look at, shape (n_samples,) each.

    Returns
    -------
    str
        Which matrix, where, with which parameters, and what helps.
    """
    samples, r = tables.samples, tables.n_coordinates
    places = PLACES if samples.n_coordinates == 1 else MIDDLE
    theta = SampleGrid(tuple(_between(axis, places) for axis in samples)).theta
    for name, table, weights in (
        ("mass", tables.mass[:, :, r:, r:], tables.mass_weights),
        ("stiffness", tables.stiffness, tables.stiffness_weights),
    ):
        between = interpolant(samples, table, scheme)(theta)
        for k in range(n_samples):
            point = {key: float(column[k]) for key, column in values.items()}
            matrices = _scaled(np.tensordot(evaluate_weights(weights, point), between, axes=(0, 1)))
            if _all_above(matrices, SMALLEST):
                continue
            smallest = np.linalg.eigvalsh(matrices)[:, 0]
            worst = int(np.argmin(smallest))
            if smallest[worst] < SMALLEST:
                where = "".join(f", {key} = {value:.4g}" for key, value in point.items())
                return (
                    f"with {' x '.join(map(str, samples.shape))} angles the interpolated {name} matrix is not positive "
                    f"definite at {', '.join(f'{value:.4g}' for value in theta[worst])} rad{where} (smallest "
                    f"eigenvalue {smallest[worst]:.2g}, diagonal 1): the model runs away with small steps; take "
                    f"{smoother(scheme)}"
                )
    return ""


def smoother(scheme: str) -> str:
    """Return what makes interpolated matrices follow the samples more closely than with this interpolation."""
    if scheme == "spline":
        return "more reduction.angles or fewer reduction.modes"
    return 'more reduction.angles, fewer reduction.modes, or reduction.interpolation = "spline"'


def _between(samples: Samples, places: Sequence[float]) -> Samples:
    """Return places, as shares of every interval, between the samples of one coordinate."""
    ends = np.append(samples.theta[1:], samples.upper) if samples.periodic else samples.theta[1:]
    starts = samples.theta[: ends.size]
    return replace(samples, theta=np.concatenate([starts + place * (ends - starts) for place in places]))


def _scaled(matrices: np.ndarray) -> np.ndarray:
    """Return matrices (n, m, m) scaled to a unit diagonal; the negative identity for those that cannot be."""
    diagonal = np.einsum("nii->ni", matrices)
    positive = np.all(diagonal > 0.0, axis=1)
    scale = 1.0 / np.sqrt(np.where(positive[:, None], diagonal, 1.0))
    return np.where(positive[:, None, None], matrices * scale[:, :, None] * scale[:, None, :], -np.eye(len(scale.T)))


def _all_above(matrices: np.ndarray, bound: float) -> bool:
    """Return whether no matrix (n, m, m) has an eigenvalue below a bound: by factors, far cheaper than eigenvalues."""
    try:
        np.linalg.cholesky(matrices - bound * np.eye(matrices.shape[-1]))
    except np.linalg.LinAlgError:
        return False
    return True
