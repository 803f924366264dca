"""Kinetic and strain energy of the reduced model, from the same interpolated tables as its equations of motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.reduced.lagrangian_terms import fill_energies
from pgmp_petsc.reduced.terms import ReducedTerms
from pgmp_petsc.reduction.cell_products import unpacked
from pgmp_petsc.reduction.interpolation import Interpolant
from pgmp_petsc.reduction.tables import with_units

SINGULAR = 1e-13  # least eigenvalue of a matrix with a unit diagonal that factors need, some hundred times round-off


def reduced_energy(
    terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return kinetic and strain energies, each of shape (n,), J, of a sample in several states, or of several samples.

    Parameter values are numbers or of shape (n,), reduced coordinates and velocities of shape (n, n_eta). Terms of
    second order in the deformation are in the energies where the model has them.
    """
    layout = terms.layout
    weights, r = evaluate_weights(terms.weights, values), len(layout.rigid)
    entries = _weighted(terms.terms, weights, q[:, :r])
    entries[:, : layout.n_rigid] = _weighted(terms.rigid, weights, q[:, :r])
    kinetic, strain = np.zeros((2, len(q)))
    fill_energies(layout, entries, np.ascontiguousarray(q), np.ascontiguousarray(v), kinetic, strain)
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
    stiffness = with_units(unpacked(entries[:, layout.stiffness : layout.cubic]))
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
    theta, delta, rate = q[:, :r], np.ascontiguousarray(q[:, r:]), np.ascontiguousarray(v[:, r:])
    load, slopes = terms.load(theta), [terms.load.slope(theta, k) for k in range(r)]
    power = np.einsum("nli,ni->ln", load[:, :, :n_eta], v)
    for k, slope in enumerate(slopes):
        power += v[:, k] * np.einsum("nli,ni->ln", slope[:, :, r:n_eta], delta)
    if terms.layout.second_order:
        # d/dt of 1/2 delta^T B delta
        for number in range(len(power)):
            first = number * load.shape[2] + n_eta
            crossed = [_form(load, first, x) for x in (delta + rate, delta, rate)]
            power[number] += 0.5 * (crossed[0] - crossed[1] - crossed[2])
            for k, slope in enumerate(slopes):
                power[number] += 0.5 * v[:, k] * _form(slope, first, delta)
    weighted = np.broadcast_to(evaluate_weights(tables.load_weights, values).T, power.T.shape).T * power
    result: dict[str, np.ndarray] = {}
    for name, part in zip(tables.load_effects, weighted):
        result[name] = result.get(name, 0.0) + part
    return result


def damping_power(
    terms: ReducedTerms, values: Mapping[str, float | np.ndarray], q: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Return the power ``-eta'^T D eta'`` of structural damping but for what brakes the momentum, shape (n,), W."""
    entries = terms.damping_terms(q[:, : terms.tables.n_coordinates])
    weights = np.broadcast_to(evaluate_weights(terms.weights, values).T, (len(q), len(terms.weights)))
    return -_form(np.einsum("nt,nte->ne", weights, entries), 0, v)


def _form(entries: np.ndarray, first: int, x: np.ndarray) -> np.ndarray:
    """Return ``x^T A x`` for symmetric matrices packed from an entry on, in tables (n, ...), and x (n, m)."""
    result = np.zeros(len(x))
    _add_forms(entries.reshape(len(x), -1), first, np.ascontiguousarray(x), result)
    return result


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def _add_forms(entries, first, x, result):
    """Add ``x^T A x`` to a result (n,); see `_form`."""
    for k in range(x.shape[0]):
        entry = first
        for i in range(x.shape[1]):
            row = 0.0
            for j in range(i):
                row += entries[k, entry + j] * x[k, j]
            result[k] += x[k, i] * (2.0 * row + entries[k, entry + i] * x[k, i])
            entry += i + 1


def _unpacked_cubic(packed: np.ndarray) -> np.ndarray:
    """Return tensors packed over ``i >= j >= k``, k fastest, as symmetric ones (n, m, m, m)."""
    m = next(m for m in range(packed.shape[1] + 1) if m * (m + 1) * (m + 2) == 6 * packed.shape[1])
    indices = np.indices((m, m, m))
    i, j, k = np.sort(indices, axis=0)[::-1]
    return packed[:, i * (i + 1) * (i + 2) // 6 + j * (j + 1) // 2 + k]
