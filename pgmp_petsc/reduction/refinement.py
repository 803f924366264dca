"""Adaptive sampling over one coordinate: more configurations where the interpolated tables differ from a fresh solve.

After each round the tables that were interpolated before are compared with the samples that came since. Where they
differ by more than the tolerance, both halves of the interval are sampled in the next round. Differences are relative
to what they act beside: mass to the modes' unit mass, stiffness entry (i, j) to the geometric mean of the diagonal
ones, loads and inertia forces to their own largest values. Tables of second order in the deformation follow, but are
not compared: they correct the others by small amounts, and may vanish but for round-off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.modes.continuity import procrustes
from pgmp_petsc.reduction.continuous_basis import ContinuousBasis
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.samples import Samples
from pgmp_petsc.reduction.tables import ReducedTables


def midpoints(samples: Samples, chosen: np.ndarray | None = None) -> np.ndarray:
    """Return the middles of the intervals between samples, shape (n,); of all, or of those chosen by a mask."""
    ends = samples.theta[1:]
    if samples.periodic:
        ends = np.append(ends, samples.upper)
    middles = 0.5 * (samples.theta[: ends.size] + ends)
    return middles if chosen is None else middles[chosen]


def interpolation_errors(
    before: ContinuousBasis, now: ContinuousBasis, theta: np.ndarray, values: Mapping[str, float]
) -> np.ndarray:
    """Compare the tables of the round before with what was found since.

    Parameters
    ----------
    before, now
        The round before, and this one with the new samples. A new sample is turned to the interpolated basis first,
        within the groups of the round before: more samples resolve more, so that groups can only become smaller.
    theta
        The new samples, shape (n_new,).
    values
        Nominal parameters, which weight the terms.

    Returns
    -------
    ndarray, shape (n_new,)
        Largest relative difference at every new sample.
    """
    old = before.tables
    rows = np.searchsorted(now.tables.samples.axes[0].theta, theta)
    guessed = interpolant(old.samples, before.projection, "spline")(theta)
    rotations = np.array([_align(now.projection[row], guess, before.groups) for row, guess in zip(rows, guessed)])
    fresh = now.tables.at(rows).turned(rotations)
    errors = np.zeros(theta.size)
    for name, weights in (("mass", old.mass_weights), ("inertia", old.mass_weights), ("load", old.load_weights)):
        scale = 1.0 if name == "mass" else _largest(getattr(old, name), weights, values)
        errors = np.maximum(errors, _difference(name, old, fresh, theta, weights, values) / scale)
    stiffness = _weighted(fresh.stiffness, old.stiffness_weights, values)
    diagonal = np.sqrt(np.einsum("nii->ni", np.abs(stiffness)))
    guess = _weighted(interpolant(old.samples, old.stiffness, "spline")(theta), old.stiffness_weights, values)
    relative = np.abs(stiffness - guess) / (diagonal[:, :, None] * diagonal[:, None, :])
    return np.maximum(errors, relative.max(axis=(1, 2), initial=0.0))


def _align(fresh: np.ndarray, guess: np.ndarray, groups: Sequence[np.ndarray]) -> np.ndarray:
    """Return the rotation of a fresh basis (n_dofs, m), group by group, to an interpolated one."""
    rotation = np.zeros((fresh.shape[1], fresh.shape[1]))
    for group in groups:
        rotation[np.ix_(group, group)], _ = procrustes(fresh[:, group].T @ guess[:, group])
    return rotation


def _difference(
    name: str, old: ReducedTables, fresh: ReducedTables, theta: np.ndarray, weights: tuple, values: Mapping[str, float]
) -> np.ndarray:
    guess = interpolant(old.samples, getattr(old, name), "spline")(theta)
    if name == "mass":
        # the rigid inertia comes from the kinematics and is not interpolated
        guess[:, :, : old.n_coordinates, : old.n_coordinates] = fresh.mass[
            :, :, : old.n_coordinates, : old.n_coordinates
        ]
    difference = np.abs(_weighted(guess - getattr(fresh, name), weights, values))
    return difference.reshape(theta.size, -1).max(axis=1, initial=0.0)


def _largest(table: np.ndarray, weights: tuple, values: Mapping[str, float]) -> float:
    return max(float(np.max(np.abs(_weighted(table, weights, values)), initial=0.0)), 1e-300)


def _weighted(table: np.ndarray, weights: tuple, values: Mapping[str, float]) -> np.ndarray:
    """Sum the terms (axis 1) at given parameter values."""
    return np.einsum("t,nt...->n...", evaluate_weights(weights, values), table)
