"""Planar large-rotation beam element (Reissner; Simo and Vu-Quoc; Geradin and Cardona; docs/method.md).

Its direction is ``psi = (phi1 + phi2) / 2 + alpha``, alpha that in the mesh, between nodes ``(x1, y1, phi1)`` and
``(x2, y2, phi2)``, which are its unknowns in this order; symmetric 6 x 6 matrices are packed as their lower triangle
row by row (21 entries). Compiled functions are those of one element, with numbers of one sample or of several in a
vector.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.lanes.compiled import njit

N_PACKED = 21
PACKED_ROWS, PACKED_COLUMNS = np.tril_indices(6)
CONSISTENT = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0  # mass of a unit of length, linear between two nodes


@njit(error_model="numpy", forceinline=True)
def strains(u, cos, sin, length):
    """Return ``eps + 1``, gamma and kappa of unknowns u (6,), cos and sin of psi, and a length, m."""
    dx, dy, inverse = u[3] - u[0], u[4] - u[1], 1.0 / length
    return (cos * dx + sin * dy) * inverse, (cos * dy - sin * dx) * inverse, (u[5] - u[2]) * inverse


@njit(error_model="numpy", forceinline=True)
def strain_rates(v, strain, cos, sin, length):
    """Return the rates of the strains for six rates of the unknowns, 1/s."""
    stretching, shearing, bending = strains(v, cos, sin, length)
    turning = 0.5 * (v[2] + v[5])
    return stretching + strain[1] * turning, shearing - strain[0] * turning, bending


@njit(error_model="numpy", forceinline=True)
def stresses(strain, section):
    """Return normal and transverse force (N) and moment (Nm) for ``(EA, k_s GA, EI)``."""
    return section[0] * (strain[0] - 1.0), section[1] * strain[1], section[2] * strain[2]


@njit(error_model="numpy", forceinline=True)
def viscous_stresses(rate, section, beta):
    """Return those of Kelvin-Voigt damping by rates of the strains, beta in s."""
    return beta * section[0] * rate[0], beta * section[1] * rate[1], beta * section[2] * rate[2]


@njit(error_model="numpy", forceinline=True)
def work_of(strain, stress, length):
    """Return ``L sum stress strain``; with strains that begin at zero twice the energy, with rates a power."""
    return length * (stress[0] * strain[0] + stress[1] * strain[1] + stress[2] * strain[2])


@njit(error_model="numpy", forceinline=True)
def forces(strain, stress, cos, sin, length):
    """Return the six forces on the unknowns that do the work of the stresses."""
    normal, across, moment = stress
    fx, fy = normal * cos - across * sin, normal * sin + across * cos  # resolved along x and y
    couple = 0.5 * length * (normal * strain[1] - across * strain[0])  # about the element's middle
    return -fx, -fy, couple - moment, fx, fy, couple + moment


@njit(error_model="numpy", forceinline=True)
def fill_tangent(strain, stress, section, cos, sin, length, tangent):
    """Fill the packed Hessian (21,) of the strain energy.

    With damping the stiffnesses in `section` are larger by the factor ``1 + gain_v beta``, whereas the stresses are the
    elastic ones: what a change of the directions makes of the damping forces is left out.
    """
    stretch, gamma, _ = strain
    normal, across, _ = stress
    axial, shear, bending = section
    inverse = 1.0 / length
    # d(fx, fy)/d(dx, dy) and the derivatives with psi (each phi has half of psi)
    kxx = (axial * cos * cos + shear * sin * sin) * inverse
    kxy = (axial - shear) * cos * sin * inverse
    kyy = (axial * sin * sin + shear * cos * cos) * inverse
    along, beside = axial * gamma - across, shear * stretch - normal
    kxp = 0.5 * (cos * along + sin * beside)
    kyp = 0.5 * (sin * along - cos * beside)
    kpp = 0.25 * length * (axial * gamma * gamma + shear * stretch * stretch - normal * stretch - across * gamma)
    kb = bending * inverse
    tangent[0] = tangent[9] = kxx
    tangent[1] = tangent[13] = kxy
    tangent[2] = tangent[14] = kyy
    tangent[3] = tangent[15] = -kxp
    tangent[4] = tangent[16] = -kyp
    tangent[5] = tangent[20] = kpp + kb
    tangent[6] = -kxx
    tangent[7] = tangent[10] = -kxy
    tangent[11] = -kyy
    tangent[8] = tangent[18] = kxp
    tangent[12] = tangent[19] = kyp
    tangent[17] = kpp - kb


def strain_gradients(lengths: np.ndarray, alphas: np.ndarray) -> np.ndarray:
    """Return strains ``(eps, gamma, kappa)`` per displacement and rotation of the nodes at rest, shape (n, 3, 6), of
    elements of lengths (m) and angles (rad) in the mesh's own frame."""
    cos, sin, zero = np.cos(alphas), np.sin(alphas), np.zeros_like(alphas)
    first = np.array([[-cos, -sin, zero], [sin, -cos, zero], [zero, zero, zero - 1.0]]) / lengths
    rows = np.concatenate([first, -first], axis=1)
    rows[1, [2, 5]] = -0.5  # of the mean rotation
    return np.moveaxis(rows, -1, 0)


def undeformed_stiffness(lengths: np.ndarray, gradients: np.ndarray, section: np.ndarray) -> np.ndarray:
    """Return tangents at rest, where stress resultants vanish, in the mesh's own frame, shape (n, n_dofs, n_dofs).

    In the plane and in space alike: of lengths, m, `strain_gradients` (n, n_strains, n_dofs), and a section of shape
    (n_strains,).
    """
    return np.einsum("s,esi,esj,e->eij", section, gradients, gradients, lengths)


def rest_strains(lengths: np.ndarray, alphas: np.ndarray) -> np.ndarray:
    """Return what `third_derivative` is made of, linear in the unknowns: ``(u / L, w / L, psi)`` of every element of
    lengths (m) and angles (rad), shape (n_elements, 3, 6).

    Extension u and deflection w are those of the second node against the first, along and across the element, and psi
    the mean rotation of the nodes.
    """
    cos, sin, zero = np.cos(alphas) / lengths, np.sin(alphas) / lengths, np.zeros_like(alphas)
    half = np.full_like(alphas, 0.5)
    rows = [[-cos, -sin, zero, cos, sin, zero], [sin, -cos, zero, -sin, cos, zero], [zero, zero, half] * 2]
    return np.moveaxis(np.array(rows), -1, 0)


def third_derivative(a: np.ndarray, b: np.ndarray, section: np.ndarray) -> np.ndarray:
    """Contract the third derivative of the strain energy at rest with pairs of vectors, of a unit of length.

    At rest the strains e vanish, and the third derivative is the sum of ``S (e''[a, b] e'[c] + e''[b, c] e'[a] + e''[c,
    a] e'[b])`` over them, times the length. With u, w and psi of `rest_strains`::

        eps'   = u              eps''[a, b]   = psi_a w_b + w_a psi_b - psi_a psi_b
        gamma' = w - psi        gamma''[a, b] = -(psi_a u_b + u_a psi_b)

    The curvature kappa is linear, so bending takes no part. Of strains a and b of both vectors, and results, the
    coefficients of the strains of c, the shape is (n_elements, 3, n_pairs); sections ``(EA, k_s GA, EI)`` have (3,), or
    (3, n_elements).
    """
    (u_a, w_a, psi_a), (u_b, w_b, psi_b) = np.moveaxis(a, 1, 0), np.moveaxis(b, 1, 0)
    gamma_a, gamma_b = w_a - psi_a, w_b - psi_b
    eps, gamma = psi_a * gamma_b + w_a * psi_b, -(psi_a * u_b + u_a * psi_b)
    mixed, sheared = u_a * gamma_b + u_b * gamma_a, gamma_a * psi_b + gamma_b * psi_a
    stretched = np.stack([eps, -gamma, mixed], axis=1)
    axial, shear, _ = section.reshape(3, -1, 1, 1)
    return axial * stretched + shear * np.stack([-sheared, gamma, -gamma - mixed], axis=1)


def consistent_mass(lengths: np.ndarray, alphas: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return consistent mass matrices of elements of lengths (m), constant in any frame and so at any angles (rad),
    shape (n_elements, 6, 6).

    The inertia is ``(rho A, rho I)``, kg/m and kg m.
    """
    line, rotary = inertia
    return lengths[:, None, None] * np.kron(CONSISTENT, np.diag([line, line, rotary]))
