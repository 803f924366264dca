"""Geometrically exact beam element in space, in natural coordinates (Reissner 1981; Simo 1985).

A node has the twelve numbers ``(p, d_1, d_2, d_3)`` of its frame (Betsch and Steinmann 2002; Romero 2004), R with the
columns d_k. Nodes at rest have the axes of the body's frame; T holds those of the element there, its first column along
the element, its second and third along the section's axes. With ``exp(Theta) = R_1^T R_2`` the rotation from the first
node to the second and ``R_m = R_1 exp(Theta / 2)``, one-point quadrature (which removes shear locking) has the strains

    gamma = T^T R_m^T (p_2 - p_1) / L - e_1,      kappa = T^T Theta / L,
    U     = L / 2 (EA gamma_1^2 + GA_2 gamma_2^2 + GA_3 gamma_3^2 + GJ kappa_1^2 + EI_2 kappa_2^2 + EI_3 kappa_3^2).

Both follow a rigid motion unchanged, whatever its size (Crisfield and Jelenic 1999); in the plane they are those of
`beam2d`. R_m is the rotation in the polar decomposition of the nodes' mean ``(R_1 + R_2) / 2``, so that with

    g_i = d_i . (p_2 - p_1) / L (d_i the nodes' mean),    w = axial(R_1^T R_2),    tau = tr(R_1^T R_2),
    c = cos(|Theta| / 2) = sqrt(1 + tau) / 2,

    R_m^T (p_2 - p_1) / L = g / c - w (w . g) / (4 c^3 (1 + c)),    Theta = f(tau) w,    f = |Theta| / sin |Theta|.

Strains are thus functions of seven quadratic forms ``z = (g, w, tau)`` of the unknowns u, and

    U' = sum_m U_m B_m u,    U'' = sum_mn U_mn (B_m u) (B_n u)^T + sum_m U_m B_m.

The kinetic energy interpolates p and d_k linearly, ``1/2 int rho A p'.p' + J_22 d_2'.d_2' + J_33 d_3'.d_3'`` in the
element's axes with ``J_22 = rho I_3``, ``J_33 = rho I_2``: the mass matrix is constant.

Elements are evaluated together, unknowns of shape (n, 24); rotations between the nodes of an element stay below pi.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

N_FRAME = 12
N_ELEMENT = 2 * N_FRAME
N_FORMS = 7
PARALLEL = 1e-6  # sine of the angle between an element and the orientation of its section
SMALL = 0.05  # of s = sin^2(|Theta| / 2), below which f is a power series in it: 14 terms leave 1e-18
# arcsin(sqrt s) / sqrt(s (1 - s)) = 1 + 2/3 s + 8/15 s^2 + ..., and its derivatives
SERIES = [np.cumprod([1.0, *(2.0 * (n + 1.0) / (2.0 * n + 3.0) for n in range(14))])[::-1]]
SERIES += [np.polyder(SERIES[0], order) for order in (1, 2)]


def _forms() -> tuple[np.ndarray, np.ndarray]:
    """Return the patterns of the forms over (p, d_1, d_2, d_3) of both nodes, (7, 8, 8): those that are divided by the
    length, and the others."""
    over_length, others = np.zeros((N_FORMS, 8, 8)), np.zeros((N_FORMS, 8, 8))

    def add(patterns: np.ndarray, form: int, i: int, j: int, factor: float) -> None:
        patterns[form, i, j] += factor
        patterns[form, j, i] += factor

    for i in range(3):
        for director in (1 + i, 5 + i):
            add(over_length, i, director, 4, 0.5)
            add(over_length, i, director, 0, -0.5)
        j, k = (i + 1) % 3, (i + 2) % 3
        # axial(Q)_i = (Q_kj - Q_jk) / 2 with Q_kj = d_k of the first node . d_j of the second one
        add(others, 3 + i, 1 + k, 5 + j, 0.5)
        add(others, 3 + i, 1 + j, 5 + k, -0.5)
        add(others, 6, 1 + i, 5 + i, 1.0)
    return over_length, others


OVER_LENGTH, OTHERS = _forms()


def section_axes(edges: np.ndarray, orientation: np.ndarray | None) -> np.ndarray:
    """Return the axes T of elements.

    Parameters
    ----------
    edges
        From the first node to the second in the body's frame, shape (n, 3), m.
    orientation
        The section's second axis, or what it comes closest to at a right angle to the element, shape (3,); where None
        the axis of the body's frame that is furthest from the element.

    Returns
    -------
    ndarray, shape (n, 3, 3)
        One axis a column; NaN where an element is parallel to the orientation.
    """
    first = edges / np.linalg.norm(edges, axis=1)[:, None]
    wanted = np.eye(3)[np.argmin(np.abs(first), axis=1)]
    if orientation is not None:
        wanted = np.broadcast_to(orientation / np.linalg.norm(orientation), first.shape)
    second = wanted - np.sum(wanted * first, axis=1)[:, None] * first
    size = np.linalg.norm(second, axis=1)
    second = second / np.where(size > PARALLEL, size, np.nan)[:, None]
    return np.stack([first, second, np.cross(first, second)], axis=2)


@dataclass(frozen=True, eq=False)
class Stretch:
    """Elements evaluated in one state, in the directors' axes.

    Attributes
    ----------
    forms, gradients
        z, shape (n, 7), and B_m u, shape (n, 7, 24).
    coefficients
        Of `_coefficients`.
    slope
        Derivatives of the strains in z, shape (n, 6, 7).
    strain, stress
        ``T gamma`` and ``Theta``, and what does work on them: the force times L, the moment; shape (n, 6).
    """

    forms: np.ndarray
    gradients: np.ndarray
    coefficients: tuple[tuple[np.ndarray, ...], ...]
    slope: np.ndarray
    strain: np.ndarray
    stress: np.ndarray


class Beams3d:
    """Elements with their sections.

    Parameters
    ----------
    lengths
        Shape (n,), m.
    axes
        T, shape (n, 3, 3).
    section
        ``(EA, GA_2, GA_3, GJ, EI_2, EI_3)``, shape (6,) or (n, 6).
    """

    def __init__(self, lengths: np.ndarray, axes: np.ndarray, section: np.ndarray) -> None:
        self._rest = axes[:, :, 0]
        self._patterns = OVER_LENGTH / lengths[:, None, None, None] + OTHERS
        section = np.broadcast_to(section, (len(lengths), 6))
        # in the directors' axes; of curvatures Theta / L
        self._resists = np.zeros((len(lengths), 6, 6))
        self._resists[:, :3, :3] = np.einsum("eis,es,ejs,e->eij", axes, section[:, :3], axes, lengths)
        self._resists[:, 3:, 3:] = np.einsum("eis,es,ejs,e->eij", axes, section[:, 3:], axes, 1.0 / lengths)

    def at(self, u: np.ndarray) -> Stretch:
        """Evaluate the strains for unknowns of shape (n, 24)."""
        vectors = u.reshape(-1, 8, 3)
        gradients = self._patterns @ vectors[:, None]
        forms = 0.5 * np.sum(gradients * vectors[:, None], axis=(2, 3))
        g, w, tau = forms[:, :3], forms[:, 3:6], forms[:, 6]
        (a, da, _), (b, db, _), (f, df, _) = coefficients = _coefficients(tau)
        wg = np.sum(w * g, axis=1)
        eye = np.eye(3)
        slope = np.zeros((len(forms), 6, N_FORMS))
        slope[:, :3, :3] = a[:, None, None] * eye - b[:, None, None] * w[:, :, None] * w[:, None]
        slope[:, :3, 3:6] = -b[:, None, None] * (wg[:, None, None] * eye + w[:, :, None] * g[:, None])
        slope[:, :3, 6] = da[:, None] * g - (db * wg)[:, None] * w
        slope[:, 3:, 3:6] = f[:, None, None] * eye
        slope[:, 3:, 6] = df[:, None] * w
        strain = np.concatenate([a[:, None] * g - (b * wg)[:, None] * w - self._rest, f[:, None] * w], axis=1)
        stress = (self._resists @ strain[:, :, None])[:, :, 0]
        return Stretch(forms, gradients.reshape(-1, N_FORMS, N_ELEMENT), coefficients, slope, strain, stress)

    def forces(self, now: Stretch) -> np.ndarray:
        """Return the gradient of the strain energy, shape (n, 24)."""
        return ((now.stress[:, None] @ now.slope) @ now.gradients)[:, 0]

    def tangents(self, now: Stretch) -> np.ndarray:
        """Return its Hessian, shape (n, 24, 24)."""
        second = np.swapaxes(now.slope, 1, 2) @ self._resists @ now.slope + _bending_of(now)
        tangents = np.swapaxes(now.gradients, 1, 2) @ second @ now.gradients
        # sum_m U_m B_m, the same for every direction in space
        factors = (now.stress[:, None] @ now.slope)[:, 0, :, None, None]
        geometric = np.sum(factors * self._patterns, axis=1)
        by_direction = tangents.reshape(-1, 8, 3, 8, 3)
        for i in range(3):
            by_direction[:, :, i, :, i] += geometric
        return tangents

    def strain_energy(self, now: Stretch) -> np.ndarray:
        """Return the strain energy, shape (n,), J."""
        return 0.5 * np.sum(now.stress * now.strain, axis=1)

    def viscosity(self, now: Stretch) -> np.ndarray:
        """Return what gives the forces of unit viscosity (Kelvin and Voigt) from the rates of the unknowns.

        ``E^T C E`` with the gradients E of the strains, shape (n, 24, 24).
        """
        gradients = now.slope @ now.gradients
        return np.swapaxes(gradients, 1, 2) @ self._resists @ gradients


def _bending_of(now: Stretch) -> np.ndarray:
    """Return the second derivatives of ``stress . strain`` in the forms with the stress held, (n, 7, 7)."""
    forms, stress = now.forms, now.stress
    g, w = forms[:, :3], forms[:, 3:6]
    (_, da, dda), (b, db, ddb), (_, df, ddf) = now.coefficients
    force, moment = stress[:, :3], stress[:, 3:]
    wg, fw, fg = (np.sum(x * y, axis=1) for x, y in ((w, g), (force, w), (force, g)))
    found = np.zeros((len(forms), N_FORMS, N_FORMS))
    of_gw = w[:, :, None] * force[:, None] + fw[:, None, None] * np.eye(3)
    found[:, :3, 3:6] = -b[:, None, None] * of_gw
    found[:, 3:6, 3:6] = -b[:, None, None] * (force[:, :, None] * g[:, None] + g[:, :, None] * force[:, None])
    found[:, :3, 6] = da[:, None] * force - (db * fw)[:, None] * w
    found[:, 3:6, 6] = -db[:, None] * (wg[:, None] * force + fw[:, None] * g) + df[:, None] * moment
    found[:, 3:6, :3] = np.swapaxes(found[:, :3, 3:6], 1, 2)
    found[:, 6, :6] = found[:, :6, 6]
    found[:, 6, 6] = dda * fg - ddb * wg * fw + ddf * np.sum(moment * w, axis=1)
    return found


def _coefficients(tau: np.ndarray) -> tuple[tuple[np.ndarray, ...], ...]:
    """Return ``1 / c``, ``1 / (4 c^3 (1 + c))`` and f, each with its first and second derivative in tau."""
    one = 1.0 + tau
    inverse = (2.0 * one**-0.5, -(one**-1.5), 1.5 * one**-2.5)
    c = 0.5 * np.sqrt(one)
    dc, ddc = 1.0 / (8.0 * c), -1.0 / (64.0 * c**3)
    p, dp, ddp = c**3 + c**4, 3.0 * c**2 + 4.0 * c**3, 6.0 * c + 12.0 * c**2
    first, second = -0.25 * dp / p**2, 0.25 * (2.0 * dp**2 / p**3 - ddp / p**2)
    return inverse, (0.25 / p, first * dc, second * dc**2 + first * ddc), _angle_over_sine(tau)


def _angle_over_sine(tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return f and its derivatives: with ``x = cos`` of the angle, ``(1 - x^2) f_x = x f - 1``.

    On the way to orthonormal directors x may be beyond 1, where the same function is ``arcosh x / sqrt(x^2 - 1)``.
    """
    s = 0.25 * (3.0 - tau)  # sin^2 of half the angle
    near = np.abs(s) < SMALL
    x = np.where(near, 0.0, 1.0 - 2.0 * s)
    across = 1.0 - x**2
    size = np.sqrt(np.abs(across))
    far = np.where(x > 1.0, np.arcsinh(size), np.arctan2(size, x)) / size
    slope = (x * far - 1.0) / across
    bend = (far + 3.0 * x * slope) / across
    small = np.where(near, s, 0.0)
    series = [np.polyval(factors, small) for factors in SERIES]
    return (
        np.where(near, series[0], far),
        np.where(near, -0.25 * series[1], 0.5 * slope),
        np.where(near, 0.0625 * series[2], 0.25 * bend),
    )


def natural_mass(lengths: np.ndarray, axes: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return consistent mass matrices in natural coordinates, shape (n, 24, 24).

    Parameters
    ----------
    lengths, axes
        As for `Beams3d`.
    inertia
        ``(rho A, rho I_2, rho I_3)``, shape (3,), kg/m and kg m.
    """
    density = np.zeros((len(lengths), 4, 4))
    density[:, 0, 0] = inertia[0]
    # the fibre at (y, z) moves with y d_2 + z d_3
    density[:, 1:, 1:] = np.einsum("eis,s,ejs->eij", axes[:, :, 1:], inertia[[2, 1]], axes[:, :, 1:])
    shared = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    matrix = np.einsum("e,ab,ekl,ij->eakiblj", lengths, shared, density, np.eye(3))
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
    n, inverse = len(lengths), 1.0 / lengths[:, None, None]
    turned = np.swapaxes(axes, 1, 2)
    gradients = np.zeros((n, 6, 12))
    gradients[:, :3, 6:9], gradients[:, :3, 0:3] = inverse * turned, -inverse * turned
    gradients[:, 3:, 9:12], gradients[:, 3:, 3:6] = inverse * turned, -inverse * turned
    mean = np.zeros((n, 3, 3))
    mean[:, 1], mean[:, 2] = -0.5 * turned[:, 2], 0.5 * turned[:, 1]  # -phi x e_1 = (0, -phi_3, phi_2)
    gradients[:, :3, 3:6] += mean
    gradients[:, :3, 9:12] += mean
    return gradients


def undeformed_stiffness(lengths: np.ndarray, axes: np.ndarray, section: np.ndarray) -> np.ndarray:
    """Return tangents at rest for displacements and rotations of the nodes in the body's frame, shape (n, 12, 12).

    Parameters
    ----------
    lengths, axes
        As for `Beams3d`.
    section
        Shape (6,).
    """
    gradients = strain_gradients(lengths, axes)
    return np.einsum("s,esi,esj,e->eij", section, gradients, gradients, lengths)
