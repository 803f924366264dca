"""Kinetic and strain energy of the reduced model, from the same interpolated tables as its equations of motion."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.dynamics.reduced_terms import ReducedTerms
from pgmp_petsc.reduction.interpolation import Interpolant
from pgmp_petsc.reduction.second_order import unpacked

SINGULAR = 1e-13  # least eigenvalue of a matrix with a unit diagonal that factors need, some hundred times round-off


def reduced_energy(
    terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the energies of a sample in several states, or of several samples.

    Parameters
    ----------
    values
        Parameter values, each a number or of shape (n,).
    q, v
        Reduced coordinates and velocities, shape (n, n_eta).

    Returns
    -------
    kinetic, strain
        Each of shape (n,), J. Terms of second order in the deformation are in them where the model has them.
    """
    layout = terms.layout
    weights, r = evaluate_weights(terms.weights, values), len(layout.rigid)
    entries = _weighted(terms.terms, weights, q[:, :r])
    entries[:, : layout.n_rigid] = _weighted(terms.rigid, weights, q[:, :r])
    delta, rate = q[:, r:], v[:, r:]
    mass, coupling, stiffness, cubic, swing, gyroscopic, _ = np.split(entries, layout[2:8], axis=1)
    k, j, times = _pairs(r)
    turning = v[:, k] * v[:, j] * times
    coupling = coupling.reshape(len(q), layout.n_rigid, -1)
    kinetic = 0.5 * _form(mass, v) + np.einsum("np,npi,ni->n", turning, coupling, delta)
    strain = 0.5 * _form(stiffness, delta)
    if layout.second_order:
        i, j = _apart(delta.shape[1])
        swept = delta[:, i] * rate[:, j] - delta[:, j] * rate[:, i]
        kinetic += np.einsum("nk,nkp,np->n", v[:, :r], gyroscopic.reshape(len(q), r, -1), swept)
        for pair, part in enumerate(np.split(swing, layout.n_rigid, axis=1)):
            kinetic -= 0.5 * turning[:, pair] * _form(part, delta)
        strain += _cubic_form(cubic, delta) / 6.0
    return kinetic, strain


def _weighted(terms: Interpolant, weights: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return the sum of all terms at theta (n, n_theta), shape (n, n_entries).

    Weights have the shape (n_terms,) for several states of one sample, whose terms are added up before they are
    interpolated, or (n_terms, n).
    """
    if weights.ndim == 1:
        return Interpolant(terms.axes, np.tensordot(weights, terms.rows, (0, terms.n_theta)))(theta)
    return np.einsum("tn,nte->ne", weights, terms(theta))


def least_stiffness(terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray) -> np.ndarray:
    """Return the least share of the stiffness at rest that is left in the deformed state, shape (n,).

    The lowest eigenvalue of the tangent of the strain energy, ``K + V delta``, beside K: 1 without terms of second
    order, and negative where their cubic energy, which has no lower bound, has pulled the state over its crest. NaN
    where K itself is not positive definite, as between samples that are too few for their interpolation.
    """
    layout = terms.layout
    weights = np.broadcast_to(evaluate_weights(terms.weights, values).T, (len(q), len(terms.weights)))
    r = len(layout.rigid)
    entries = np.einsum("nt,nte->ne", weights, terms.terms(q[:, :r]))
    stiffness = unpacked(entries[:, layout.stiffness : layout.cubic])
    bent = np.zeros_like(stiffness)
    if layout.second_order:
        bent = np.einsum("nijk,nk->nij", _unpacked_cubic(entries[:, layout.cubic : layout.swing]), q[:, r:])
    # both scaled to a unit diagonal of K, so that round-off decides on nothing but a singular one
    diagonal = np.einsum("nii->ni", stiffness)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    stiffness, bent = (matrix * scale[:, :, None] * scale[:, None, :] for matrix in (stiffness, bent))
    positive = np.linalg.eigvalsh(stiffness)[:, 0] > SINGULAR
    share = np.full(len(q), np.nan)
    lower = np.linalg.inv(np.linalg.cholesky(stiffness[positive]))
    share[positive] = 1.0 + np.linalg.eigvalsh(lower @ bent[positive] @ np.swapaxes(lower, 1, 2))[:, 0]
    return share


def load_powers(
    terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray, v: np.ndarray
) -> dict[str, np.ndarray]:
    """Return each effect's power per unit amplitude, ``Q.eta' + sum_k theta_k' (d_k Q_delta).delta``, shape (n,), W."""
    tables, r, n_eta = terms.tables, terms.tables.n_coordinates, terms.layout.n_eta
    theta, delta, rate = q[:, :r], q[:, r:], v[:, r:]
    load, slopes = terms.load(theta), [terms.load.slope(theta, k) for k in range(r)]
    power = np.einsum("nli,ni->ln", load[:, :, :n_eta], v)
    for k, slope in enumerate(slopes):
        power += v[:, k] * np.einsum("nli,ni->ln", slope[:, :, r:n_eta], delta)
    if terms.layout.second_order:
        # d/dt of 1/2 delta^T B delta
        for number in range(len(power)):
            bent = load[:, number, n_eta:]
            crossed = 0.5 * (_form(bent, delta + rate) - _form(bent, delta) - _form(bent, rate))
            power[number] += crossed
            for k, slope in enumerate(slopes):
                power[number] += 0.5 * v[:, k] * _form(slope[:, number, n_eta:], delta)
    weighted = np.broadcast_to(evaluate_weights(tables.load_weights, values).T, power.T.shape).T * power
    result: dict[str, np.ndarray] = {}
    for name, part in zip(tables.load_effects, weighted):
        result[name] = result.get(name, 0.0) + part
    return result


def damping_power(
    terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Return the power ``-eta'^T D eta'`` of structural damping but for what brakes the momentum, shape (n,), W."""
    entries = terms.terms(q[:, : terms.tables.n_coordinates])[:, :, terms.layout.damping :]
    weights = np.broadcast_to(evaluate_weights(terms.weights, values).T, (len(q), len(terms.weights)))
    return -_form(np.einsum("nt,nte->ne", weights, entries), v)


def _form(packed: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ``x^T A x`` for packed symmetric matrices (n, n_packed) and x (n, m)."""
    i, j, times = _pairs(x.shape[1])
    return np.sum(packed * times * x[:, i] * x[:, j], axis=1)


@cache
def _pairs(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows and columns of a packed symmetric matrix, and how often each entry stands in it."""
    i, j = np.tril_indices(n)
    return i, j, np.where(i == j, 1.0, 2.0)


@cache
def _apart(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of a packed skew matrix."""
    return np.tril_indices(n, -1)


@cache
def _triples(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the indices of a packed symmetric tensor, and how often each entry stands in it."""
    i, j, k = np.indices((n,) * 3).reshape(3, -1)
    chosen = (i >= j) & (j >= k)
    i, j, k = i[chosen], j[chosen], k[chosen]
    return i, j, k, np.where(i == k, 1.0, np.where((i == j) | (j == k), 3.0, 6.0))


def _unpacked_cubic(packed: np.ndarray) -> np.ndarray:
    """Return tensors packed over ``i >= j >= k``, k fastest, as symmetric ones (n, m, m, m)."""
    m = next(m for m in range(packed.shape[1] + 1) if m * (m + 1) * (m + 2) == 6 * packed.shape[1])
    indices = np.indices((m, m, m))
    i, j, k = np.sort(indices, axis=0)[::-1]
    return packed[:, i * (i + 1) * (i + 2) // 6 + j * (j + 1) // 2 + k]


def _cubic_form(packed: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return ``T_ijk x_i x_j x_k`` for symmetric tensors packed over ``i >= j >= k``."""
    i, j, k, times = _triples(x.shape[1])
    return np.sum(packed * times * x[:, i] * x[:, j] * x[:, k], axis=1)
