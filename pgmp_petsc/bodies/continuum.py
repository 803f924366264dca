"""Continuum elements evaluated side by side, compiled: forces, tangents, damping and energy; see `elasticity`.

Columns of all arrays are elements of one material, or samples of one element: each has its own geometry, and nothing
passes between them. Tangents are packed as lower triangles row by row, unknowns node after node.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.runtime.compiled import njit


class Cells(NamedTuple):
    """What cells have in their reference places, n columns of them.

    Attributes
    ----------
    gradients
        ``dN_a/dX_j``, shape (n_q, n_a, d, n), 1/m.
    volumes
        Of the quadrature points, shape (n_q, n), m^d.
    """

    gradients: np.ndarray
    volumes: np.ndarray


class CellWork(NamedTuple):
    """Work arrays of one quadrature point, each with the columns last."""

    deformation: np.ndarray
    rate: np.ndarray
    stress: np.ndarray
    viscous: np.ndarray
    pushed: np.ndarray
    pulled: np.ndarray
    dilated: np.ndarray
    sheared: np.ndarray
    left: np.ndarray
    factors: np.ndarray


@njit(cache=True, error_model="numpy")
def cell_work(n_nodes, d, n):
    """Return work arrays for n columns of cells."""
    square, of_nodes = (d, d, n), (n_nodes, d, n)
    return CellWork(
        np.empty(square), np.empty(square), np.empty(square), np.empty(square), np.empty(of_nodes), np.empty(of_nodes),
        np.empty(of_nodes), np.empty(of_nodes), np.empty(square), np.empty((4, n)),
    )  # fmt: skip


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def evaluate_cells(
    cells, lame, modulus, beta, gain_v, places, rates, damped, fresh, work, forces, tangents, powers
):  # fmt: skip
    """Evaluate internal and damping forces of columns of cells, and what the iteration takes of them.

        P = F (S + beta S'),    S = E_Y (lambda tr E 1 + 2 mu E),    f_ai = sum_q P_ij G_aj,
        K = sum_q  delta_ij G_a.S G_b + (1 + beta gain_v) (lambda (F G_a)_i (F G_b)_j
                + mu ((F G_b)_i (F G_a)_j + (F F^T)_ij G_a.G_b))

    What a change of places makes of the damping forces is left out of K.

    Parameters
    ----------
    cells
        Their geometry.
    lame
        Both Lame constants over Young's modulus.
    modulus
        Young's modulus E_Y, shape (n,), Pa (N/m in the plane).
    beta, gain_v
        Damping by stiffness (s), and the derivative of velocities with positions (1/s).
    places, rates
        Of the nodes, shape (n_a, d, n); rates are read where `damped`.
    damped, fresh
        Whether the material damps, and whether tangents are wanted.
    work
        From `cell_work`.
    forces, tangents, powers
        Results: shapes (n_a, d, n) and (m (m + 1) / 2, n) with m = d n_a, and the power of the damping (n,), W.
    """
    f, rate, stress, viscous, _, _, _, _, _, _ = work
    n_q, n_nodes, d, n = cells.gradients.shape
    first, shear = lame
    forces[:] = 0.0
    powers[:] = 0.0
    if fresh:
        tangents[:] = 0.0
    for q in range(n_q):
        g, volumes = cells.gradients[q], cells.volumes[q]
        _gradient(places, g, f)
        _elastic_stress(f, first, shear, modulus, volumes, stress)
        viscous[:] = stress
        if damped:
            _gradient(rates, g, rate)
            _add_viscous_stress(f, rate, first, shear, modulus, volumes, beta, viscous, powers)
        for i in range(d):
            for j in range(d):
                for c in range(n):
                    rate[i, j, c] = f[i, 0, c] * viscous[0, j, c]
                    for k in range(1, d):
                        rate[i, j, c] += f[i, k, c] * viscous[k, j, c]  # P = F S
            for a in range(n_nodes):
                for j in range(d):
                    for c in range(n):
                        forces[a, i, c] += rate[i, j, c] * g[a, j, c]  # P_ij G_aj
        if fresh:
            _add_tangents(f, stress, g, volumes, modulus, lame, 1.0 + beta * gain_v, work, tangents)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def strain_energies(cells, lame, modulus, places, work, energies):
    """Fill the strain energies of columns of cells, shape (n,), J."""
    f, _, stress = work[0], work[1], work[2]
    d, n = f.shape[1:]
    energies[:] = 0.0
    for q in range(cells.volumes.shape[0]):
        _gradient(places, cells.gradients[q], f)
        _elastic_stress(f, lame[0], lame[1], modulus, cells.volumes[q], stress)
        for i in range(d):
            for j in range(d):
                for c in range(n):
                    strain = -1.0 if i == j else 0.0
                    for k in range(d):
                        strain += f[k, i, c] * f[k, j, c]
                    energies[c] += 0.25 * stress[i, j, c] * strain  # S : E / 2


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _gradient(nodal, g, result):
    """Fill ``sum_a x_ai G_aj``."""
    n_nodes, d, n = g.shape
    for i in range(d):
        for j in range(d):
            for c in range(n):
                result[i, j, c] = nodal[0, i, c] * g[0, j, c]
            for a in range(1, n_nodes):
                for c in range(n):
                    result[i, j, c] += nodal[a, i, c] * g[a, j, c]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _elastic_stress(f, first, shear, modulus, volumes, stress):
    """Fill ``E_Y dV (lambda tr E 1 + 2 mu E)`` with ``E = (F^T F - 1) / 2``."""
    d, n = f.shape[1:]
    for i in range(d):
        for j in range(d):
            less = 1.0 if i == j else 0.0
            for c in range(n):
                strain = f[0, i, c] * f[0, j, c] - less
                for k in range(1, d):
                    strain += f[k, i, c] * f[k, j, c]
                stress[i, j, c] = modulus[c] * volumes[c] * shear * strain
    for c in range(n):
        trace = 0.0
        for i in range(d):
            trace += stress[i, i, c]
        for i in range(d):
            stress[i, i, c] += 0.5 * first / shear * trace


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _add_viscous_stress(f, rate, first, shear, modulus, volumes, beta, stress, powers):
    """Add ``beta E_Y dV (lambda tr E' 1 + 2 mu E')`` with ``2 E' = F^T F' + F'^T F``, and take its power off."""
    d, n = f.shape[1:]
    for c in range(n):
        factor = beta * modulus[c] * volumes[c]
        trace = 0.0
        for i in range(d):
            for k in range(d):
                trace += f[k, i, c] * rate[k, i, c]
        for i in range(d):
            for j in range(d):
                change = 0.0  # E'_ij
                for k in range(d):
                    change += 0.5 * (f[k, i, c] * rate[k, j, c] + rate[k, i, c] * f[k, j, c])
                own = factor * (2.0 * shear * change + (first * trace if i == j else 0.0))
                stress[i, j, c] += own
                powers[c] -= own * change


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _add_tangents(f, stress, g, volumes, modulus, lame, viscosity, work, tangents):
    """Add what one quadrature point gives the tangents; see `evaluate_cells`."""
    _, _, _, _, pushed, pulled, dilated, sheared, left, factors = work
    n_nodes, d, n = g.shape
    for i in range(d):
        for a in range(n_nodes):
            for c in range(n):
                pushed[a, i, c] = f[i, 0, c] * g[a, 0, c]
                pulled[a, i, c] = stress[i, 0, c] * g[a, 0, c]
            for j in range(1, d):
                for c in range(n):
                    pushed[a, i, c] += f[i, j, c] * g[a, j, c]  # (F G_a)_i
                    pulled[a, i, c] += stress[i, j, c] * g[a, j, c]  # (S G_a)_i
        for j in range(d):
            for c in range(n):
                left[i, j, c] = f[i, 0, c] * f[j, 0, c]
            for k in range(1, d):
                for c in range(n):
                    left[i, j, c] += f[i, k, c] * f[j, k, c]  # (F F^T)_ij
    first, shear, dot, geometric = factors[0], factors[1], factors[2], factors[3]
    for c in range(n):
        first[c] = viscosity * modulus[c] * volumes[c] * lame[0]
        shear[c] = viscosity * modulus[c] * volumes[c] * lame[1]
    for a in range(n_nodes):
        for i in range(d):
            for c in range(n):
                dilated[a, i, c] = first[c] * pushed[a, i, c]
                sheared[a, i, c] = shear[c] * pushed[a, i, c]
    # a loop a product: with more arrays in it the compiler cannot tell that none overlaps, and makes scalar code
    for a in range(n_nodes):
        for b in range(a + 1):
            for c in range(n):
                dot[c], geometric[c] = 0.0, 0.0
            for k in range(d):
                for c in range(n):
                    dot[c] += g[a, k, c] * g[b, k, c]  # G_a.G_b
                for c in range(n):
                    geometric[c] += g[a, k, c] * pulled[b, k, c]  # G_a.S G_b
            for c in range(n):
                dot[c] *= shear[c]
            for i in range(d):
                row = (a * d + i) * (a * d + i + 1) // 2 + b * d
                for j in range(d if b < a else i + 1):
                    for c in range(n):
                        tangents[row + j, c] += dilated[a, i, c] * pushed[b, j, c]  # lambda (F G_a)_i (F G_b)_j
                    for c in range(n):
                        tangents[row + j, c] += pushed[b, i, c] * sheared[a, j, c]  # mu (F G_b)_i (F G_a)_j
                    for c in range(n):
                        tangents[row + j, c] += left[i, j, c] * dot[c]  # mu (F F^T)_ij G_a.G_b
                for c in range(n):
                    tangents[row + i, c] += geometric[c]
