"""A second, independent formulation of flexible mechanisms, to check the package's full-order model against.

Nothing of the package's mechanics is used: strain energy and consistent mass of the planar beam are written out again,
forces are complex-step gradients of the energy, and the multipliers are eliminated from

    M q'' + C^T lambda = f(t, q),   C q'' = -(dC/dt) v

so that an explicit Runge-Kutta method integrates an ordinary differential equation.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.integrate

TINY = 1e-30  # of complex steps: no subtraction, so no round-off


@dataclass(frozen=True)
class Beams:
    """Elements of planar beams."""

    dofs: np.ndarray  # unknowns (x1, y1, phi1, x2, y2, phi2) of the elements, (n_e, 6)
    length: np.ndarray  # (n_e,), m; all elements lie along the x axis of their body
    section: np.ndarray  # (EA, k_s GA, EI, rho A, rho I), (n_e, 5)
    n_dofs: int

    def energy(self, q: np.ndarray) -> np.ndarray:
        """Return the strain energy, J, shape (...), for q of shape (..., n_dofs)."""
        x1, y1, phi1, x2, y2, phi2 = np.moveaxis(q[..., self.dofs], -1, 0)
        psi, dx, dy = 0.5 * (phi1 + phi2), (x2 - x1) / self.length, (y2 - y1) / self.length
        stretch = np.cos(psi) * dx + np.sin(psi) * dy - 1.0
        shear = -np.sin(psi) * dx + np.cos(psi) * dy
        bending = (phi2 - phi1) / self.length
        axial_stiffness, shear_stiffness, bending_stiffness = self.section[:, :3].T
        density = axial_stiffness * stretch**2 + shear_stiffness * shear**2 + bending_stiffness * bending**2
        return np.sum(0.5 * self.length * density, axis=-1)

    def forces(self, q: np.ndarray) -> np.ndarray:
        """Return the gradient of the energy, shape (n_dofs,), by complex steps."""
        return self.energy(q + 1j * TINY * np.eye(self.n_dofs)).imag / TINY

    def mass(self) -> np.ndarray:
        """Return the consistent mass matrix."""
        mass = np.zeros((self.n_dofs, self.n_dofs))
        for dofs, length, (*_, line, rotary) in zip(self.dofs, self.length, self.section):
            for local, density in enumerate((line, line, rotary)):
                pair = dofs[[local, local + 3]]
                mass[np.ix_(pair, pair)] += density * length / 6 * np.array([[2.0, 1.0], [1.0, 2.0]])
        return mass


def circle(radius: float, young: float, density: float, nu: float = 0.3) -> list[float]:
    """Return ``(EA, k_s GA, EI, rho A, rho I)`` of a solid circular section."""
    area, inertia = np.pi * radius**2, np.pi * radius**4 / 4
    shear = 6 * (1 + nu) / (7 + 6 * nu) * young * area / (2 * (1 + nu))
    return [young * area, shear, young * inertia, density * area, density * inertia]


def chain(n_cells: tuple[int, ...], lengths: tuple[float, ...], sections: list[list[float]]) -> Beams:
    """Return straight bodies of equal cells, their unknowns numbered one body after the other."""
    dofs, length, section, first = [], [], [], 0
    for n, whole, properties in zip(n_cells, lengths, sections):
        for cell in range(n):
            dofs.append(3 * (first + cell) + np.arange(6))
            length.append(whole / n)
            section.append(properties)
        first += n + 1
    return Beams(np.array(dofs), np.array(length), np.array(section), 3 * first)


@dataclass(frozen=True)
class Eliminated:
    """Beams with constraints and loads."""

    beams: Beams
    residual: Callable[[np.ndarray], np.ndarray]  # constraints c(q), an analytic function of complex q
    jacobian: Callable[[np.ndarray], np.ndarray]  # C(q), likewise
    load: Callable[[float], np.ndarray]  # nodal loads at a time, (n_dofs,)

    def accelerations(self, time: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mass, jacobian = self.beams.mass(), self.jacobian(q).real
        drift = (self.jacobian(q + 1j * TINY * v) @ v).imag / TINY
        n, m = self.beams.n_dofs, len(jacobian)
        matrix = np.block([[mass, jacobian.T], [jacobian, np.zeros((m, m))]])
        solution = np.linalg.solve(matrix, np.concatenate([self.load(time) - self.beams.forces(q), -drift]))
        return solution[:n], solution[n:]

    def integrate(self, q: np.ndarray, v: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q, v and multipliers at the end, good to nine digits or more."""
        mass, n = self.beams.mass(), self.beams.n_dofs
        inverse = np.linalg.inv(mass)

        def rate(time: float, y: np.ndarray) -> np.ndarray:
            q, v = y[:n], y[n:]
            jacobian = self.jacobian(q).real
            drift = (self.jacobian(q + 1j * TINY * v) @ v).imag / TINY
            free = inverse @ (self.load(time) - self.beams.forces(q))
            push = inverse @ jacobian.T
            multipliers = np.linalg.solve(jacobian @ push, jacobian @ free + drift)
            return np.concatenate([v, free - push @ multipliers])

        end = scipy.integrate.solve_ivp(
            rate, (0.0, duration), np.concatenate([q, v]), method="DOP853", rtol=1e-11, atol=1e-13
        ).y[:, -1]
        return end[:n], end[n:], self.accelerations(duration, end[:n], end[n:])[1]
