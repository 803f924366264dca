"""Continuum elements with the positions of their nodes as unknowns: St. Venant-Kirchhoff strain energy, constant mass.

    W = int  lambda/2 (tr E)^2 + mu E:E  dV,    E = (F^T F - 1) / 2,    F = dx/dX

in the reference volume V. In plane stress the normal stress across the plane vanishes; the same energy with
``lambda* = 2 lambda mu / (lambda + 2 mu)`` then holds for E in the plane. All functions take many elements at once, for
a Young's modulus, a density and a thickness of 1: these are factors (`Quantity`), taken out as weights.

Compiled functions are those of forces, tangents, damping and energy.

Numbers are those of one cell, or vectors of several: elements of one material, or samples of one element. Tangents are
packed as lower triangles row by row, unknowns node after node.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mesh.meshes import Quadrature


@dataclass(frozen=True)
class Lame:
    """Lame's constants over Young's modulus."""

    first: float
    shear: float

    @classmethod
    def of(cls, nu: float, plane_stress: bool) -> Lame:
        """Return the constants for Poisson's ratio nu."""
        if plane_stress:
            return cls(nu / (1.0 - nu**2), 0.5 / (1.0 + nu))
        return cls(nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), 0.5 / (1.0 + nu))


@dataclass(frozen=True, eq=False)
class Geometry:
    """Elements at their quadrature points."""

    gradients: np.ndarray  # ``dN_a/dX_j``, shape (n_e, n_q, d, n_a), 1/m
    volumes: np.ndarray  # determinant of the Jacobian times weight, shape (n_e, n_q), m^d

    @classmethod
    def of(cls, places: np.ndarray, quadrature: Quadrature) -> Geometry:
        """Map elements whose nodes are at places (n_e, n_a, d), m."""
        jacobians = np.einsum("qja,eai->eqij", quadrature.gradients, places, optimize=True)
        # dX_i/dxi_j; its inverse turns reference gradients into those in X
        inverse, determinants = np.linalg.inv(jacobians), np.linalg.det(jacobians)
        return cls(
            np.einsum("eqji,qja->eqia", inverse, quadrature.gradients, optimize=True), determinants * quadrature.weights
        )


def volumes_of(places: np.ndarray, quadrature: Quadrature) -> np.ndarray:
    """Return ``Geometry.volumes`` alone, shape (n_e, n_q)."""
    jacobians = np.einsum("qja,eai->eqij", quadrature.gradients, places, optimize=True)
    return np.linalg.det(jacobians) * quadrature.weights


def stiffness(geometry: Geometry, lame: Lame, pairs: np.ndarray | None = None) -> np.ndarray:
    """Return tangents at rest, shape (n_e, n_a, d, n_b, d): ``d2W / dx_ai dx_bj``.

    With `pairs`, shape (d, d), only what pairs ``dN_a/dX_k dN_b/dX_l`` of derivatives give for which ``pairs[k, l]`` is
    true (`SectionScale`).
    """
    g, volumes = geometry.gradients, geometry.volumes
    n_e, n_q, d, n_a = g.shape
    # one product over quadrature points and no larger arrays: (n_e, d n_a, d n_a)
    weighted = (g * volumes[:, :, None, None]).reshape(n_e, n_q, d * n_a)
    outer = np.matmul(weighted.transpose(0, 2, 1), g.reshape(n_e, n_q, d * n_a)).reshape(n_e, d, n_a, d, n_a)
    if pairs is not None:
        outer *= pairs[:, None, :, None]
    result = lame.first * outer.transpose(0, 2, 1, 4, 3)  # G_ai G_bj
    result += lame.shear * outer.transpose(0, 2, 3, 4, 1)  # G_aj G_bi
    dot = lame.shear * np.einsum("eiaib->eab", outer)
    for i in range(d):
        result[:, :, i, :, i] += dot
    return result


def mass(volumes: np.ndarray, quadrature: Quadrature) -> np.ndarray:
    """Return ``int N_a N_b dV``, shape (n_e, n_a, n_b): the same for every direction."""
    return np.einsum("eq,qa,qb->eab", volumes, quadrature.values, quadrature.values, optimize=True)


class Cells(NamedTuple):
    """Geometry of cells in their reference places."""

    gradients: np.ndarray  # ``dN_a/dX_j``, shape (n_q, n_a, d), 1/m
    volumes: np.ndarray  # of the quadrature points, shape (n_q,), m^d


class CellWork(NamedTuple):
    """Work arrays of one quadrature point, (d, d) and (n_a, d)."""

    deformation: np.ndarray
    rate: np.ndarray
    stress: np.ndarray
    viscous: np.ndarray
    left: np.ndarray
    pushed: np.ndarray
    pulled: np.ndarray
    dilated: np.ndarray
    sheared: np.ndarray


@njit(cache=True, error_model="numpy")
def n_work(n_nodes, d):
    """Return how many numbers `cell_work` needs."""
    return 5 * d * d + 4 * n_nodes * d


@njit(inline="always")
def cell_work(n_nodes, d, space):
    """Return work arrays of cells in a space of `n_work` numbers or vectors."""
    n, square, nodal = d * d, (d, d), (n_nodes, d)
    m, first = n_nodes * d, 5 * n
    return CellWork(
        space[:n].reshape(square), space[n : 2 * n].reshape(square), space[2 * n : 3 * n].reshape(square),
        space[3 * n : 4 * n].reshape(square), space[4 * n : first].reshape(square),
        space[first : first + m].reshape(nodal), space[first + m : first + 2 * m].reshape(nodal),
        space[first + 2 * m : first + 3 * m].reshape(nodal), space[first + 3 * m : first + 4 * m].reshape(nodal),
    )  # fmt: skip


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def evaluate_cells(cells, lame, modulus, beta, gain_v, places, rates, damped, fresh, work, forces, tangents):
    """Evaluate internal and damping forces of cells, and what the iteration takes of them; return the power of damping.

        P = F (S + beta S'),    S = E_Y (lambda tr E 1 + 2 mu E),    f_ai = sum_q P_ij G_aj,
        K = sum_q  delta_ij G_a.S G_b + (1 + beta gain_v) (lambda (F G_a)_i (F G_b)_j
                + mu ((F G_b)_i (F G_a)_j + (F F^T)_ij G_a.G_b))

    What a change of places makes of the damping forces is left out of K. Lame's constants are over the modulus E_Y, Pa
    (N/m in the plane), beta is the damping by stiffness, s, and gain_v the derivative of velocities with positions,
    1/s. Places and rates are those of the nodes, (n_a, d); rates are read where the material is `damped`. `work` is
    from `cell_work`. Filled are forces (n_a, d) and, if `fresh`, tangents (m (m + 1) / 2,) with m = d n_a.
    """
    f, rate, stress, viscous = work.deformation, work.rate, work.stress, work.viscous
    n_q, n_nodes, d = cells.gradients.shape
    power = modulus * 0.0
    for a in range(n_nodes):
        for i in range(d):
            forces[a, i] = 0.0
    for at in range(tangents.size if fresh else 0):
        tangents[at] = 0.0
    for q in range(n_q):
        g, stiffness = cells.gradients[q], modulus * cells.volumes[q]
        _gradient(places, g, f)
        _elastic_stress(f, lame, stiffness, stress)
        for i in range(d):
            for j in range(d):
                viscous[i, j] = stress[i, j]
        if damped:
            _gradient(rates, g, rate)
            power -= _add_viscous_stress(f, rate, lame, beta * stiffness, viscous)
        for i in range(d):
            for j in range(d):
                pushing = f[i, 0] * viscous[0, j]
                for k in range(1, d):
                    pushing += f[i, k] * viscous[k, j]  # P = F S
                for a in range(n_nodes):
                    forces[a, i] += pushing * g[a, j]  # P_ij G_aj
        if fresh:
            _add_tangents(f, stress, g, lame, (1.0 + beta * gain_v) * stiffness, work, tangents)
    return power


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def strain_energies(cells, lame, modulus, places, work):
    """Return the strain energies of cells, J."""
    f, stress = work.deformation, work.stress
    d = places.shape[1]
    energy = modulus * 0.0
    for q in range(cells.volumes.size):
        _gradient(places, cells.gradients[q], f)
        _elastic_stress(f, lame, modulus * cells.volumes[q], stress)
        for i in range(d):
            for j in range(d):
                strain = f[0, i] * f[0, j] - (1.0 if i == j else 0.0)
                for k in range(1, d):
                    strain += f[k, i] * f[k, j]
                energy += 0.25 * stress[i, j] * strain  # S : E / 2
    return energy


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _gradient(nodal, g, result):
    """Fill ``sum_a x_ai G_aj``."""
    n_nodes, d = g.shape
    for i in range(d):
        for j in range(d):
            total = nodal[0, i] * g[0, j]
            for a in range(1, n_nodes):
                total += nodal[a, i] * g[a, j]
            result[i, j] = total


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _elastic_stress(f, lame, stiffness, stress):
    """Fill ``E_Y dV (lambda tr E 1 + 2 mu E)`` with ``E = (F^T F - 1) / 2``."""
    first, shear = lame
    d = f.shape[0]
    trace = stiffness * 0.0
    for i in range(d):
        for j in range(d):
            strain = f[0, i] * f[0, j] - (1.0 if i == j else 0.0)
            for k in range(1, d):
                strain += f[k, i] * f[k, j]
            own = stiffness * shear * strain
            stress[i, j] = own
            if i == j:
                trace += own
    for i in range(d):
        stress[i, i] += 0.5 * first / shear * trace


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _add_viscous_stress(f, rate, lame, viscosity, stress):
    """Add ``beta E_Y dV (lambda tr E' 1 + 2 mu E')`` with ``2 E' = F^T F' + F'^T F``; return its power."""
    first, shear = lame
    d = f.shape[0]
    power = trace = viscosity * 0.0
    for i in range(d):
        for k in range(d):
            trace += f[k, i] * rate[k, i]
    for i in range(d):
        for j in range(d):
            change = viscosity * 0.0  # E'_ij
            for k in range(d):
                change += 0.5 * (f[k, i] * rate[k, j] + rate[k, i] * f[k, j])
            own = 2.0 * shear * change
            if i == j:
                own += first * trace
            own *= viscosity
            stress[i, j] += own
            power += own * change
    return power


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _add_tangents(f, stress, g, lame, stiffness, work, tangents):
    """Add what one quadrature point gives the tangents; see `evaluate_cells`."""
    pushed, pulled, dilated, sheared, left = work.pushed, work.pulled, work.dilated, work.sheared, work.left
    n_nodes, d = g.shape
    first, shear = stiffness * lame[0], stiffness * lame[1]
    for i in range(d):
        for a in range(n_nodes):
            push, pull = f[i, 0] * g[a, 0], stress[i, 0] * g[a, 0]
            for j in range(1, d):
                push += f[i, j] * g[a, j]  # (F G_a)_i
                pull += stress[i, j] * g[a, j]  # (S G_a)_i
            pushed[a, i], pulled[a, i], dilated[a, i], sheared[a, i] = push, pull, first * push, shear * push
        for j in range(d):
            total = f[i, 0] * f[j, 0]
            for k in range(1, d):
                total += f[i, k] * f[j, k]  # (F F^T)_ij
            left[i, j] = total
    for a in range(n_nodes):
        for b in range(a + 1):
            dot, geometric = g[a, 0] * g[b, 0], g[a, 0] * pulled[b, 0]
            for k in range(1, d):
                dot += g[a, k] * g[b, k]  # G_a.G_b
                geometric += g[a, k] * pulled[b, k]  # G_a.S G_b
            dot *= shear
            for i in range(d):
                row = (a * d + i) * (a * d + i + 1) // 2 + b * d
                for j in range(d if b < a else i + 1):
                    own = dilated[a, i] * pushed[b, j]  # lambda (F G_a)_i (F G_b)_j
                    own += pushed[b, i] * sheared[a, j]  # mu (F G_b)_i (F G_a)_j
                    own += left[i, j] * dot  # mu (F F^T)_ij G_a.G_b
                    if i == j:
                        own += geometric
                    tangents[row + j] += own
