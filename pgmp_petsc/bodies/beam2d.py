"""Planar large-rotation beam element (Reissner; Simo and Vu-Quoc; Geradin and Cardona).

Strain energy of an element of length L between nodes ``(x1, y1, phi1)`` and ``(x2, y2, phi2)``, one-point quadrature
(which removes shear locking), with ``psi = (phi1 + phi2) / 2 + alpha`` and alpha the direction in the mesh::

    eps   =  (cos(psi) dx + sin(psi) dy) / L - 1
    gamma = (-sin(psi) dx + cos(psi) dy) / L
    kappa =  (phi2 - phi1) / L
    U     = L / 2 (EA eps^2 + GA gamma^2 + EI kappa^2)

The kinetic energy has the consistent constant mass matrix with rotary inertia. Element unknowns are ordered
``(x1, y1, phi1, x2, y2, phi2)``; symmetric 6 x 6 matrices are packed as their lower triangle row by row (21 entries).
The functions below work on many elements or samples at once: the last axis is contiguous and vectorised.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.runtime.compiled import njit

N_PACKED = 21
PACKED_ROWS, PACKED_COLUMNS = np.tril_indices(6)


@njit(cache=True, error_model="numpy")
def force_and_tangent(u, length, alpha, section, force, tangent, with_tangent=True):
    """Evaluate gradient and Hessian of the strain energy of one element for several states.

    Parameters
    ----------
    u
        Element unknowns, shape (6, n).
    length, alpha
        Length (m) and direction in the mesh (rad) of the element.
    section
        ``(EA, k_s GA, EI)``, shape (3, n).
    force, tangent
        Results: gradient, shape (6, n), and packed Hessian, shape (21, n).
    with_tangent
        Whether the Hessian is wanted; its array is a work array otherwise.
    """
    n = u.shape[1]
    inv = 1.0 / length
    for k in range(n):
        psi = 0.5 * (u[2, k] + u[5, k]) + alpha
        # parked in the results, so that the loops below have no calls and vectorise
        tangent[0, k] = np.cos(psi)
        tangent[1, k] = np.sin(psi)
    for k in range(n):
        cos, sin = tangent[0, k], tangent[1, k]
        axial, shear, bending = section[0, k], section[1, k], section[2, k]
        stretch, gamma, n_force, q_force = _stretched(u, k, cos, sin, inv, axial, shear)
        moment = bending * (u[5, k] - u[2, k]) * inv
        # internal force resolved along x and y, and its couple about the element's middle
        fx = n_force * cos - q_force * sin
        fy = n_force * sin + q_force * cos
        couple = 0.5 * length * (n_force * gamma - q_force * stretch)
        force[0, k] = -fx
        force[1, k] = -fy
        force[2, k] = couple - moment
        force[3, k] = fx
        force[4, k] = fy
        force[5, k] = couple + moment
    for k in range(n if with_tangent else 0):
        cos, sin = tangent[0, k], tangent[1, k]
        axial, shear, bending = section[0, k], section[1, k], section[2, k]
        stretch, gamma, n_force, q_force = _stretched(u, k, cos, sin, inv, axial, shear)
        # d(fx, fy)/d(dx, dy) and the derivatives with psi (each phi has half of psi)
        kxx = (axial * cos * cos + shear * sin * sin) * inv
        kxy = (axial - shear) * cos * sin * inv
        kyy = (axial * sin * sin + shear * cos * cos) * inv
        kxp = 0.5 * ((axial * cos * gamma + shear * sin * stretch) - n_force * sin - q_force * cos)
        kyp = 0.5 * ((axial * sin * gamma - shear * cos * stretch) + n_force * cos - q_force * sin)
        kpp = 0.25 * length * (axial * gamma * gamma + shear * stretch * stretch - n_force * stretch - q_force * gamma)
        kb = bending * inv
        tangent[0, k] = kxx
        tangent[1, k] = kxy
        tangent[2, k] = kyy
        tangent[3, k] = -kxp
        tangent[4, k] = -kyp
        tangent[5, k] = kpp + kb
        tangent[6, k] = -kxx
        tangent[7, k] = -kxy
        tangent[8, k] = kxp
        tangent[9, k] = kxx
        tangent[10, k] = -kxy
        tangent[11, k] = -kyy
        tangent[12, k] = kyp
        tangent[13, k] = kxy
        tangent[14, k] = kyy
        tangent[15, k] = -kxp
        tangent[16, k] = -kyp
        tangent[17, k] = kpp - kb
        tangent[18, k] = kxp
        tangent[19, k] = kyp
        tangent[20, k] = kpp + kb


@njit(inline="always")
def _stretched(u, k, cos, sin, inv, axial, shear):
    """Return stretch and shear of element k, and the normal and the transverse force that they give."""
    dx, dy = u[3, k] - u[0, k], u[4, k] - u[1, k]
    stretch = (cos * dx + sin * dy) * inv
    gamma = (cos * dy - sin * dx) * inv
    return stretch, gamma, axial * (stretch - 1.0), shear * gamma


@njit(cache=True, error_model="numpy")
def add_damping(u, v, length, alpha, section, beta, gain_v, force, tangent, power, with_tangent=True):
    """Add the forces of Kelvin-Voigt damping: stresses by ``beta`` times the rates of the strains.

    The rates are ``b v`` with the gradient b of each strain; the tangent holds ``gain_v beta L S b b^T`` and leaves out
    the change of b.

    Parameters
    ----------
    u, v
        Element unknowns and their rates, shape (6, n).
    length, alpha, section
        As for `force_and_tangent`.
    beta
        s, shape (n,).
    gain_v
        Derivative of v with u, 1/s.
    force, tangent
        Added to, shapes (6, n) and (21, n).
    power
        Result: power of the damping forces on the element, never positive, shape (n,), W.
    with_tangent
        Whether to add to the tangent.
    """
    b = np.empty((3, 6))
    for k in range(u.shape[1]):
        psi = 0.5 * (u[2, k] + u[5, k]) + alpha
        cos, sin = np.cos(psi), np.sin(psi)
        dx, dy = u[3, k] - u[0, k], u[4, k] - u[1, k]
        stretch, gamma = (cos * dx + sin * dy) / length, (cos * dy - sin * dx) / length
        b[0, 0], b[0, 1], b[0, 2], b[0, 3], b[0, 4], b[0, 5] = (
            -cos,
            -sin,
            0.5 * length * gamma,
            cos,
            sin,
            0.5 * length * gamma,
        )
        turning = -0.5 * length * stretch
        b[1, 0], b[1, 1], b[1, 2], b[1, 3], b[1, 4], b[1, 5] = sin, -cos, turning, -sin, cos, turning
        b[2, 0], b[2, 1], b[2, 2], b[2, 3], b[2, 4], b[2, 5] = 0.0, 0.0, -1.0, 0.0, 0.0, 1.0
        power[k] = 0.0
        for strain in range(3):
            rate = 0.0
            for i in range(6):
                rate += b[strain, i] * v[i, k]
            stress = section[strain, k] * beta[k] / length
            power[k] -= stress * rate * rate
            at = 0
            for i in range(6):
                force[i, k] += stress * rate * b[strain, i]
                for j in range(i + 1 if with_tangent else 0):
                    tangent[at, k] += gain_v * stress * b[strain, i] * b[strain, j]
                    at += 1


@njit(cache=True, error_model="numpy")
def strain_energy(u, length, alpha, section):
    """Return the strain energy (J) of one element with unknowns u (6,) and section ``(EA, k_s GA, EI)``."""
    psi = 0.5 * (u[2] + u[5]) + alpha
    cos, sin = np.cos(psi), np.sin(psi)
    dx, dy = u[3] - u[0], u[4] - u[1]
    eps, gamma, kappa = (cos * dx + sin * dy) / length - 1.0, (cos * dy - sin * dx) / length, (u[5] - u[2]) / length
    return 0.5 * length * (section[0] * eps * eps + section[1] * gamma * gamma + section[2] * kappa * kappa)


def undeformed_stiffness(lengths: np.ndarray, alphas: np.ndarray, section: np.ndarray) -> np.ndarray:
    """Return the tangents of elements at rest in the mesh's own frame.

    At rest the stress resultants vanish, so the tangent is the sum of three rank-one terms.

    Parameters
    ----------
    lengths, alphas
        Shape (n_elements,): m and rad.
    section
        ``(EA, k_s GA, EI)``, shape (3,).

    Returns
    -------
    ndarray, shape (n_elements, 6, 6)
    """
    cos, sin, zero, one = np.cos(alphas), np.sin(alphas), np.zeros_like(alphas), np.ones_like(alphas)
    half = lengths / 2
    gradients = np.array(  # of eps, gamma, kappa, each times the length: shape (3, 6, n_elements)
        [
            [-cos, -sin, zero, cos, sin, zero],
            [sin, -cos, -half, -sin, cos, -half],
            [zero, zero, -one, zero, zero, one],
        ]
    )
    return np.einsum("s,sie,sje,e->eij", section, gradients, gradients, 1 / lengths)


def third_derivative(
    lengths: np.ndarray,
    alphas: np.ndarray,
    section: np.ndarray,
    vectors: np.ndarray,
    pairs: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Contract the third derivative of the strain energy at rest with pairs of vectors, in the mesh's own frame.

    At rest the strains e vanish, and the third derivative is the sum of ``S (e''[a, b] e'[c] + e''[b, c] e'[a] +
    e''[c, a] e'[b])`` over them, times the length. With extension ``u`` and deflection ``w`` of the second node against
    the first, along and across the element, and ``psi`` the mean rotation of the nodes::

        eps'   = u / L           eps''[a, b]   = (psi_a w_b + w_a psi_b) / L - psi_a psi_b
        gamma' = w / L - psi     gamma''[a, b] = -(psi_a u_b + u_a psi_b) / L

    The curvature kappa is linear, so bending takes no part.

    Parameters
    ----------
    lengths, alphas
        Shape (n_elements,): m and rad.
    section
        ``(EA, k_s GA, EI)``, shape (3,).
    vectors
        Element unknowns, shape (n_elements, 6, m).
    pairs
        Numbers i and j of the vectors of every pair, shape (n_pairs,) each.

    Returns
    -------
    ndarray, shape (n_elements, 6, n_pairs)
        ``K3[v_i, v_j]``.
    """
    cos, sin, zero = np.cos(alphas), np.sin(alphas), np.zeros_like(alphas)
    half = np.full_like(alphas, 0.5)
    along = np.array([-cos, -sin, zero, cos, sin, zero]).T / lengths[:, None]
    across = np.array([sin, -cos, zero, -sin, cos, zero]).T / lengths[:, None]
    mean = np.array([zero, zero, half, zero, zero, half]).T
    i, j = pairs
    u, w, psi = (np.einsum("ek,ekm->em", row, vectors)[:, None] for row in (along, across, mean))
    along, across, mean = along[..., None], across[..., None], mean[..., None]
    # e'' applied to one vector: its gradient in the other, shape (n_elements, 6, m)
    curved_eps = mean * (w - psi) + across * psi
    curved_gamma = -(mean * u + along * psi)
    result = np.zeros((len(lengths), 6, i.size))
    for stiffness, slope, gradient, curved in (
        (section[0], u, along, curved_eps),
        (section[1], w - psi, across - mean, curved_gamma),
    ):
        second = np.einsum("ekp,ekp->ep", curved[:, :, i], vectors[:, :, j])[:, None]
        result += stiffness * (gradient * second + slope[..., i] * curved[..., j] + slope[..., j] * curved[..., i])
    return lengths[:, None, None] * result


def consistent_mass(lengths: np.ndarray, line_density: float, rotary_density: float) -> np.ndarray:
    """Return consistent mass matrices, constant in any frame.

    Parameters
    ----------
    lengths
        Shape (n_elements,), m.
    line_density, rotary_density
        rho A (kg/m) and rho I (kg m).

    Returns
    -------
    ndarray, shape (n_elements, 6, 6)
    """
    density = np.diag([line_density, line_density, rotary_density])
    unit = np.kron(np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0, density)
    return lengths[:, None, None] * unit
