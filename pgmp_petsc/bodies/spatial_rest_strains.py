"""Beams in space near rest: strains of second order in the displacements u and rotation vectors phi of the nodes.

With ``exp(phi)`` the rotation of a node, the middle rotation and the one between the nodes of an element (`beam3d`) are
``exp(m)`` and ``exp(theta)``,

    m = (phi_1 + phi_2) / 2,      theta = delta - 1/2 m x delta,      delta = phi_2 - phi_1,

but for terms of third order (Baker, Campbell, Hausdorff). In the element's axes, the first one e along it, with
``w = (u_2 - u_1) / L`` and ``k = delta / L`` the strains are, to second order,

    gamma = w - m x e - m x w + 1/2 m x (m x e),      kappa = k - 1/2 m x k.
"""

from __future__ import annotations

import numpy as np

N_STRAINS = 9  # w, m, k
ALONG = np.array([1.0, 0.0, 0.0])


def rest_strains(lengths: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return ``(w, m, k)`` in the axes of the elements for displacements and rotations of both nodes.

    Parameters
    ----------
    lengths, axes
        Shape (n,), m, and axes, one a column, shape (n, 3, 3).

    Returns
    -------
    ndarray, shape (n, 9, 12)
    """
    rows = np.zeros((len(lengths), N_STRAINS, 12))
    turned, over = axes.swapaxes(1, 2), axes.swapaxes(1, 2) / lengths[:, None, None]
    for node, sign in enumerate((-1.0, 1.0)):
        first = 6 * node
        rows[:, :3, first : first + 3] = sign * over
        rows[:, 3:6, first + 3 : first + 6] = 0.5 * turned
        rows[:, 6:, first + 3 : first + 6] = sign * over
    return rows


def second_order(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the second derivatives of ``(gamma, kappa)`` in the directions a and b, shape (6, ...).

    Parameters
    ----------
    a, b
        ``(w, m, k)`` of both, shape (9, ...).
    """
    (w_a, m_a, k_a), (w_b, m_b, k_b) = _parts(a), _parts(b)
    gamma = -_cross(m_a, w_b) - _cross(m_b, w_a) + 0.5 * (_cross(m_a, _tilted(m_b)) + _cross(m_b, _tilted(m_a)))
    return np.concatenate([gamma, -0.5 * (_cross(m_a, k_b) + _cross(m_b, k_a))])


def strains_of(rest: np.ndarray, curved: bool) -> np.ndarray:
    """Return ``(gamma, kappa)``, shape (6, ...), of `rest_strains` (9, ...), to first order or, curved, to second."""
    w, m, k = _parts(rest)
    linear = np.concatenate([w - _tilted(m), k])
    return linear + 0.5 * second_order(rest, rest) if curved else linear


def third_derivative(a: np.ndarray, b: np.ndarray, section: np.ndarray) -> np.ndarray:
    """Contract the third derivative of the strain energy at rest with pairs of vectors, of a unit of length.

    At rest the strains e vanish, and the third derivative is the sum of ``C (e''[a, b] e'[c] + e''[b, c] e'[a] +
    e''[c, a] e'[b])`` over them with the coefficients C of the section.

    Parameters
    ----------
    a, b
        Strains `rest_strains` of both vectors of every pair, shape (n_elements, 9, n_pairs).
    section
        ``(EA, GA_2, GA_3, GJ, EI_2, EI_3)``, shape (6,), or of every element (6, n_elements).

    Returns
    -------
    ndarray, shape (n_elements, 9, n_pairs)
        Coefficients of the strains of c.
    """
    a, b = a.swapaxes(0, 1), b.swapaxes(0, 1)
    stiffness = section.reshape(6, -1, 1)
    bent = stiffness * second_order(a, b)
    force, moment = bent[:3], bent[3:]
    # e'[c] = (w - m x e, k)
    on_w, on_m, on_k = force.copy(), _cross(force, _along(force)), moment.copy()
    for (w, m, k), (other_w, other_m, other_k) in ((_parts(a), _parts(b)), (_parts(b), _parts(a))):
        force, moment = stiffness[:3] * (w - _tilted(m)), stiffness[3:] * k
        # the forces of one vector on e''[c, .] of the other
        turned = _cross(force, other_m)
        on_w -= turned
        on_m += _cross(force, other_w) + 0.5 * (_cross(_along(turned), turned) + _cross(_tilted(other_m), force))
        on_k -= 0.5 * _cross(moment, other_m)
        on_m += 0.5 * _cross(moment, other_k)
    return np.concatenate([on_w, on_m, on_k]).swapaxes(0, 1)


def _parts(strains: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return strains[:3], strains[3:6], strains[6:]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.cross(a, b, axis=0)


def _along(like: np.ndarray) -> np.ndarray:
    return np.broadcast_to(ALONG.reshape(3, *[1] * (like.ndim - 1)), like.shape)


def _tilted(turn: np.ndarray) -> np.ndarray:
    """Return ``m x e``."""
    return _cross(turn, _along(turn))
