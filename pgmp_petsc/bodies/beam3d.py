"""Geometrically exact beam element in space, in natural coordinates (docs/beams_in_space.md, the element).

A node has the twelve numbers ``(p, d_1, d_2, d_3)`` of its frame (Betsch and Steinmann 2002; Romero 2004), R with the
columns d_k. Nodes at rest have the axes of the body's frame; T holds those of the element there, its first column along
the element, its second and third along the section's axes. R_m, the middle rotation, is that in the polar decomposition
of the nodes' mean ``(R_1 + R_2) / 2``, so that with

    g_i = d_i . (p_2 - p_1) / L (d_i the nodes' mean),    w = axial(R_1^T R_2),    tau = tr(R_1^T R_2),
    c = cos(|Theta| / 2) = sqrt(1 + tau) / 2,

    R_m^T (p_2 - p_1) / L = g / c - w (w . g) / (4 c^3 (1 + c)),    Theta = f(tau) w,    f = |Theta| / sin |Theta|.

Strains are thus functions of seven quadratic forms ``z = (g, w, tau)`` of the unknowns u, and

    U' = sum_m U_m B_m u,    U'' = sum_mn U_mn (B_m u) (B_n u)^T + sum_m U_m B_m.

The kinetic energy interpolates p and d_k linearly, ``1/2 int rho A p'.p' + J_22 d_2'.d_2' + J_33 d_3'.d_3'`` in the
element's axes with ``J_22 = rho I_3``, ``J_33 = rho I_2``: the mass matrix is constant. Rotations between the nodes of
an element stay below pi.

Beams in space near rest: strains of second order in the displacements u and rotation vectors phi of the nodes. The
middle rotation and the one between the nodes of an element are ``exp(m)`` and ``exp(theta)``,

    m = (phi_1 + phi_2) / 2,      theta = delta - 1/2 m x delta,      delta = phi_2 - phi_1,

but for terms of third order (Baker, Campbell, Hausdorff). In the element's axes, the first one e along it, with
``w = (u_2 - u_1) / L`` and ``k = delta / L`` the strains are, to second order,

    gamma = w - m x e - m x w + 1/2 m x (m x e),      kappa = k - 1/2 m x k.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.beam2d import CONSISTENT
from pgmp_petsc.lanes.compiled import njit

N_FRAME = 12
N_ELEMENT = 2 * N_FRAME
N_FORMS = 7
PARALLEL = 1e-6  # sine of the angle between an element and the orientation of its section
SMALL = 0.05  # of s = sin^2(|Theta| / 2), below which f is a power series in it: 14 terms leave 1e-18
# arcsin(sqrt s) / sqrt(s (1 - s)) = 1 + 2/3 s + 8/15 s^2 + ..., the highest power first
SERIES = tuple(np.cumprod([1.0, *(2.0 * (n + 1.0) / (2.0 * n + 3.0) for n in range(14))])[::-1].tolist())


def section_axes(edges: np.ndarray, orientation: np.ndarray | None) -> np.ndarray:
    """Return the axes T of elements, one a column, shape (n, 3, 3); NaN where an element is parallel to the
    orientation.

    Edges (n, 3), m, go from the first node to the second in the body's frame. The orientation (3,) is the section's
    second axis, or what it comes closest to at a right angle to the element; where None the axis of the body's frame
    that is furthest from the element.
    """
    first = edges / np.linalg.norm(edges, axis=1)[:, None]
    wanted = np.eye(3)[np.argmin(np.abs(first), axis=1)]
    if orientation is not None:
        wanted = np.broadcast_to(orientation / np.linalg.norm(orientation), first.shape)
    second = wanted - np.sum(wanted * first, axis=1)[:, None] * first
    size = np.linalg.norm(second, axis=1)
    second = second / np.where(size > PARALLEL, size, np.nan)[:, None]
    return np.stack([first, second, np.cross(first, second)], axis=2)


class BeamWork(NamedTuple):
    """Work arrays of one element."""

    gradients: np.ndarray  # B_m u, shape (7, 24)
    slope: np.ndarray  # derivatives of the strains ``(T gamma, Theta)`` in the forms z, shape (6, 7)
    second: np.ndarray  # second derivatives of the energy in the forms, shape (7, 7)
    resists: np.ndarray  # what gives the stresses from these strains, shape (2, 3, 3)
    half: np.ndarray  # ``second`` times ``gradients``, shape (7, 24)
    #: forms, strain, stress: shapes (7,), (6,), (6,)
    forms: np.ndarray
    strain: np.ndarray
    stress: np.ndarray


@njit(cache=True, error_model="numpy")
def beam_work():
    """Return work arrays of one element."""
    return BeamWork(
        np.zeros((N_FORMS, N_ELEMENT)), np.zeros((6, N_FORMS)), np.zeros((N_FORMS, N_FORMS)), np.empty((2, 3, 3)),
        np.empty((N_FORMS, N_ELEMENT)), np.empty(N_FORMS), np.empty(6), np.empty(6),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def stretch(u, length, axes, section, work):
    """Evaluate strains and stresses of an element in the directors' axes, of unknowns u (24,) of both nodes, a length,
    m, axes T (3, 3) and a section ``(EA, GA_2, GA_3, GJ, EI_2, EI_3)``; return its strain energy, J. All of `work`,
    from `beam_work`, is filled but for what a tangent alone needs."""
    for i in range(3):
        for j in range(3):
            force, moment = 0.0, 0.0
            for s in range(3):
                force += axes[i, s] * section[s] * axes[j, s] * length
                moment += axes[i, s] * section[3 + s] * axes[j, s] / length
            work.resists[0, i, j], work.resists[1, i, j] = force, moment
    _evaluate_forms(u, length, work)
    (a, da, _), (b, db, _), (f, df, _) = _coefficients(work.forms[6])
    g, w, slope = work.forms[:3], work.forms[3:6], work.slope
    wg = w[0] * g[0] + w[1] * g[1] + w[2] * g[2]
    energy = 0.0
    for i in range(3):
        for j in range(3):
            same = 1.0 if i == j else 0.0
            slope[i, j] = a * same - b * w[i] * w[j]
            slope[i, 3 + j] = -b * (wg * same + w[i] * g[j])
            slope[3 + i, 3 + j] = f * same
        slope[i, 6] = da * g[i] - db * wg * w[i]
        slope[3 + i, 6] = df * w[i]
        work.strain[i] = a * g[i] - b * wg * w[i] - axes[i, 0]
        work.strain[3 + i] = f * w[i]
    for k in range(2):
        for i in range(3):
            stress = 0.0
            for j in range(3):
                stress += work.resists[k, i, j] * work.strain[3 * k + j]
            work.stress[3 * k + i] = stress
            energy += 0.5 * stress * work.strain[3 * k + i]
    return energy


@njit(cache=True, error_model="numpy")
def add_force(work, stress, force):
    """Add what does the work of ``stress``, shape (6,), on the strains' changes to a force, shape (24,)."""
    for m in range(N_FORMS):
        factor = 0.0
        for s in range(6):
            factor += stress[s] * work.slope[s, m]
        for i in range(N_ELEMENT):
            force[i] += factor * work.gradients[m, i]


@njit(cache=True, error_model="numpy")
def viscous_stress(work, v, stress):
    """Fill the stresses of unit viscosity (Kelvin and Voigt), shape (6,), for rates of the unknowns (24,); return what
    work they do, W."""
    power = 0.0
    rate = np.zeros(6)
    for m in range(N_FORMS):
        along = 0.0
        for i in range(N_ELEMENT):
            along += work.gradients[m, i] * v[i]
        for s in range(6):
            rate[s] += work.slope[s, m] * along
    for k in range(2):
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += work.resists[k, i, j] * rate[3 * k + j]
            stress[3 * k + i] = total
            power += total * rate[3 * k + i]
    return power


@njit(cache=True, error_model="numpy")
def fill_tangent(work, length, viscosity, tangent):
    """Fill the packed lower triangle, shape (300,), of ``U'' + viscosity E^T C E`` with the gradients E of the strains,
    after `stretch`."""
    slope, second, gradients, half = work.slope, work.second, work.gradients, work.half
    for m in range(N_FORMS):
        for n in range(N_FORMS):
            total = 0.0
            for k in range(2):
                for i in range(3):
                    along = 0.0
                    for j in range(3):
                        along += work.resists[k, i, j] * slope[3 * k + j, n]
                    total += slope[3 * k + i, m] * along
            second[m, n] = (1.0 + viscosity) * total
    _add_bending(work, second)
    for m in range(N_FORMS):
        for i in range(N_ELEMENT):
            half[m, i] = 0.0
        for n in range(N_FORMS):
            for i in range(N_ELEMENT):
                half[m, i] += second[m, n] * gradients[n, i]
    at = 0
    for i in range(N_ELEMENT):
        for j in range(i + 1):
            total = 0.0
            for m in range(N_FORMS):
                total += gradients[m, i] * half[m, j]
            tangent[at] = total
            at += 1
    # sum_m U_m B_m, the same for every direction in space
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        along, turning = 0.0, 0.0
        for s in range(6):
            along += 0.5 / length * work.stress[s] * slope[s, i]
            turning += 0.5 * work.stress[s] * slope[s, 3 + i]
        closing = 0.0
        for s in range(6):
            closing += work.stress[s] * slope[s, 6]
        for row, column, value in (
            (4, 1 + i, along), (1 + i, 0, -along), (5 + i, 4, along), (5 + i, 0, -along), (5 + j, 1 + k, turning),
            (5 + k, 1 + j, -turning), (5 + i, 1 + i, closing),
        ):  # fmt: skip
            for c in range(3):
                tangent[(3 * row + c) * (3 * row + c + 1) // 2 + 3 * column + c] += value


@njit(cache=True, error_model="numpy")
def _evaluate_forms(u, length, work):
    """Fill z and its gradients: g_i, w_i and tau of the nodes' places ``u[0:3], u[12:15]`` and directors."""
    z, gradients = work.forms, work.gradients
    z[6] = 0.0
    for i in range(3):
        one, other = 3 + 3 * i, 15 + 3 * i  # d_i of both nodes
        j, k = (i + 1) % 3, (i + 2) % 3
        z[i], z[3 + i] = 0.0, 0.0
        for c in range(3):
            away, mean = (u[12 + c] - u[c]) / length, 0.5 * (u[one + c] + u[other + c])
            z[i] += mean * away
            gradients[i, c], gradients[i, 12 + c] = -mean / length, mean / length
            gradients[i, one + c] = gradients[i, other + c] = 0.5 * away
            # axial(Q)_i = (Q_kj - Q_jk) / 2 with Q_kj = d_k of the first node . d_j of the second one
            first_j, first_k, second_j, second_k = 3 + 3 * j + c, 3 + 3 * k + c, 15 + 3 * j + c, 15 + 3 * k + c
            z[3 + i] += 0.5 * (u[first_k] * u[second_j] - u[first_j] * u[second_k])
            gradients[3 + i, first_k], gradients[3 + i, second_j] = 0.5 * u[second_j], 0.5 * u[first_k]
            gradients[3 + i, first_j], gradients[3 + i, second_k] = -0.5 * u[second_k], -0.5 * u[first_j]
            z[6] += u[one + c] * u[other + c]
            gradients[6, one + c], gradients[6, other + c] = u[other + c], u[one + c]


@njit(cache=True, error_model="numpy")
def _add_bending(work, second):
    """Add the second derivatives of ``stress . strain`` in the forms with the stress held."""
    (_, da, dda), (b, db, ddb), (_, df, ddf) = _coefficients(work.forms[6])
    g, w, force, moment = work.forms[:3], work.forms[3:6], work.stress[:3], work.stress[3:]
    wg, fw, fg, mw = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        wg += w[i] * g[i]
        fw += force[i] * w[i]
        fg += force[i] * g[i]
        mw += moment[i] * w[i]
    for i in range(3):
        for j in range(3):
            mixed = -b * (w[i] * force[j] + (fw if i == j else 0.0))
            second[i, 3 + j] += mixed
            second[3 + j, i] += mixed
            second[3 + i, 3 + j] -= b * (force[i] * g[j] + g[i] * force[j])
        with_g = da * force[i] - db * fw * w[i]
        with_w = -db * (wg * force[i] + fw * g[i]) + df * moment[i]
        second[i, 6] += with_g
        second[6, i] += with_g
        second[3 + i, 6] += with_w
        second[6, 3 + i] += with_w
    second[6, 6] += dda * fg - ddb * wg * fw + ddf * mw


@njit(cache=True, error_model="numpy")
def _coefficients(tau):
    """Return ``1 / c``, ``1 / (4 c^3 (1 + c))`` and f, each with its first and second derivative in tau."""
    one = 1.0 + tau
    root = np.sqrt(one)
    inverse = (2.0 / root, -1.0 / (one * root), 1.5 / (one * one * root))
    c = 0.5 * root
    dc, ddc = 1.0 / (8.0 * c), -1.0 / (64.0 * c**3)
    p, dp, ddp = c**3 + c**4, 3.0 * c**2 + 4.0 * c**3, 6.0 * c + 12.0 * c**2
    first, second = -0.25 * dp / p**2, 0.25 * (2.0 * dp**2 / p**3 - ddp / p**2)
    return inverse, (0.25 / p, first * dc, second * dc**2 + first * ddc), _angle_over_sine(tau)


@njit(cache=True, error_model="numpy")
def _angle_over_sine(tau):
    """Return f and its derivatives: with ``x = cos`` of the angle, ``(1 - x^2) f_x = x f - 1``.

    On the way to orthonormal directors x may be beyond 1, where the same function is ``arcosh x / sqrt(x^2 - 1)``.
    """
    s = 0.25 * (3.0 - tau)  # sin^2 of half the angle
    if abs(s) < SMALL:
        value, slope, bend = 0.0, 0.0, 0.0
        for factor in SERIES:  # Horner's scheme
            bend = bend * s + 2.0 * slope
            slope = slope * s + value
            value = value * s + factor
        return value, -0.25 * slope, 0.0625 * bend
    x = 1.0 - 2.0 * s
    across = 1.0 - x**2
    size = np.sqrt(abs(across))
    value = (np.arcsinh(size) if x > 1.0 else np.arctan2(size, x)) / size
    slope = (x * value - 1.0) / across
    return value, 0.5 * slope, 0.25 * (value + 3.0 * x * slope) / across


def natural_mass(lengths: np.ndarray, axes: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return consistent mass matrices in natural coordinates, shape (n, 24, 24).

    Lengths are in m, axes T of shape (n, 3, 3), and the inertia ``(rho A, rho I_2, rho I_3)``, kg/m and kg m.
    """
    density = np.zeros((len(lengths), 4, 4))
    density[:, 0, 0] = inertia[0]
    # the fibre at (y, z) moves with y d_2 + z d_3
    density[:, 1:, 1:] = np.einsum("eis,s,ejs->eij", axes[:, :, 1:], inertia[[2, 1]], axes[:, :, 1:])
    matrix = np.einsum("e,ab,ekl,ij->eakiblj", lengths, CONSISTENT, density, np.eye(3))
    return matrix.reshape(-1, N_ELEMENT, N_ELEMENT)


def at_rest() -> np.ndarray:
    """Return the change of both nodes' frames with displacements and rotations (u, phi) at rest, shape (24, 12)."""
    gradient = np.zeros((N_FRAME, 6))
    gradient[:3, :3] = np.eye(3)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        gradient[3 + 3 * k + i, 3 + j], gradient[3 + 3 * k + j, 3 + i] = 1.0, -1.0  # phi x e_k
    return np.kron(np.eye(2), gradient)


def consistent_mass(lengths: np.ndarray, axes: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return mass matrices for displacements and rotations of the nodes at rest, shape (n, 12, 12); see
    `natural_mass`."""
    gradient = at_rest()
    return gradient.T @ natural_mass(lengths, axes, inertia) @ gradient


def strain_gradients(lengths: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return strains ``(gamma, kappa)`` per displacement and rotation of the nodes at rest, shape (n, 6, 12).

    With u_2 - u_1 and the mean rotation phi resolved along T: ``gamma = (u_2 - u_1) / L - phi x e_1``, ``kappa =
    (phi_2 - phi_1) / L``.
    """
    return np.moveaxis(strains_of(np.moveaxis(rest_strains(lengths, axes), 1, 0), curved=False), 0, 1)


N_STRAINS = 9  # w, m, k


def rest_strains(lengths: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return ``(w, m, k)`` in the axes of the elements for displacements and rotations of both nodes, shape (n, 9, 12).

    Lengths are in m, and axes, one a column, of shape (n, 3, 3).
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
    """Return the second derivatives of ``(gamma, kappa)`` in the directions a and b, shape (6, ...), from ``(w, m, k)``
    of both, shape (9, ...)."""
    (w_a, m_a, k_a), (w_b, m_b, k_b) = _parts(a), _parts(b)
    gamma = -cross(m_a, w_b) - cross(m_b, w_a) + 0.5 * (cross(m_a, _tilted(m_b)) + cross(m_b, _tilted(m_a)))
    return np.concatenate([gamma, -0.5 * (cross(m_a, k_b) + cross(m_b, k_a))])


def strains_of(rest: np.ndarray, curved: bool) -> np.ndarray:
    """Return ``(gamma, kappa)``, shape (6, ...), of `rest_strains` (9, ...), to first order or, curved, to second."""
    w, m, k = _parts(rest)
    linear = np.concatenate([w - _tilted(m), k])
    return linear + 0.5 * second_order(rest, rest) if curved else linear


def third_derivative(a: np.ndarray, b: np.ndarray, section: np.ndarray) -> np.ndarray:
    """Contract the third derivative of the strain energy at rest with pairs of vectors, of a unit of length.

    At rest the strains e vanish, and the third derivative is the sum of ``C (e''[a, b] e'[c] + e''[b, c] e'[a] + e''[c,
    a] e'[b])`` over them with the coefficients C of the section, ``(EA, GA_2, GA_3, GJ, EI_2, EI_3)``, shape (6,) or
    (6, n_elements). Of `rest_strains` a and b of both vectors, and results, the coefficients of the strains of c, the
    shape is (n_elements, 9, n_pairs).
    """
    a, b = a.swapaxes(0, 1), b.swapaxes(0, 1)
    stiffness = section.reshape(6, -1, 1)
    bent = stiffness * second_order(a, b)
    force, moment = bent[:3], bent[3:]
    # e'[c] = (w - m x e, k)
    on_w, on_m, on_k = force.copy(), _tilted(force), moment.copy()
    for (w, m, k), (other_w, other_m, other_k) in ((_parts(a), _parts(b)), (_parts(b), _parts(a))):
        force, moment = stiffness[:3] * (w - _tilted(m)), stiffness[3:] * k
        # the forces of one vector on e''[c, .] of the other
        turned = cross(force, other_m)
        on_w -= turned
        on_m += cross(force, other_w) + 0.5 * (cross(_tilted(other_m), force) - _tilted(turned))
        on_k -= 0.5 * cross(moment, other_m)
        on_m += 0.5 * cross(moment, other_k)
    return np.concatenate([on_w, on_m, on_k]).swapaxes(0, 1)


def _parts(strains: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return strains[:3], strains[3:6], strains[6:]


def cross(a: np.ndarray, b: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return ``a x b`` along an axis of arrays of as many axes; numpy's own function looks at axes for ten times as
    long as it computes."""
    (a_1, a_2, a_3), (b_1, b_2, b_3) = a.swapaxes(0, axis), b.swapaxes(0, axis)
    return np.array([a_2 * b_3 - a_3 * b_2, a_3 * b_1 - a_1 * b_3, a_1 * b_2 - a_2 * b_1]).swapaxes(0, axis)


def _tilted(turn: np.ndarray) -> np.ndarray:
    """Return ``m x e``."""
    return np.stack([np.zeros_like(turn[0]), turn[2], -turn[1]])
