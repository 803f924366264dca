"""The planar beam element: force and tangent against its energy, which no rigid motion changes; stiffness at rest."""

import compiled_elements
import numpy as np
import pytest

from pgmp_petsc.bodies import beam2d

LENGTH, ALPHA = 0.7, 0.4
SECTION = np.array([3.0, 2.0, 0.5])  # of one order, so that every term is seen
START = np.array([0.1, -0.2, 0.3, 0.85, 0.15, -0.4])


def energy(u: np.ndarray, alpha: float = ALPHA) -> complex:
    """Return the strain energy of one element, as the docstring of `beam2d` states it; u may be complex."""
    dx, dy = u[3] - u[0], u[4] - u[1]
    psi = (u[2] + u[5]) / 2 + alpha
    eps = (np.cos(psi) * dx + np.sin(psi) * dy) / LENGTH - 1
    gamma = (-np.sin(psi) * dx + np.cos(psi) * dy) / LENGTH
    kappa = (u[5] - u[2]) / LENGTH
    return LENGTH / 2 * (SECTION[0] * eps**2 + SECTION[1] * gamma**2 + SECTION[2] * kappa**2)


def kernel(u: np.ndarray, alpha: float = ALPHA, section: np.ndarray = SECTION) -> tuple[np.ndarray, np.ndarray]:
    """Return force (6, n) and full tangents (6, 6, n) of states u of shape (6, n)."""
    forces, tangents = zip(*(compiled_elements.beam2d(own, LENGTH, alpha, section) for own in u.T))
    return np.array(forces).T, np.moveaxis(np.array(tangents), 0, 2)


def states(n: int) -> np.ndarray:
    """Return n strongly deformed states, shape (6, n)."""
    return START[:, None] + np.random.default_rng(1).normal(0.0, 0.5, (6, n))


def test_the_force_is_the_gradient_of_the_energy() -> None:
    u = states(20)
    force, _ = kernel(u)
    for k in range(u.shape[1]):
        gradient = [energy(u[:, k] + 1e-30j * unit).imag / 1e-30 for unit in np.eye(6)]
        # complex step: no cancellation, so round-off only
        np.testing.assert_allclose(force[:, k], gradient, rtol=0, atol=1e-13 * np.abs(force).max())


def test_the_tangent_is_the_derivative_of_the_force() -> None:
    u, step = states(20), 1e-3
    _, tangent = kernel(u)
    for i, unit in enumerate(np.eye(6)):
        ahead, behind = (kernel(u + s * step * unit[:, None])[0] for s in (1, -1))
        far_ahead, far_behind = (kernel(u + 2 * s * step * unit[:, None])[0] for s in (1, -1))
        # fourth order: the error is step^4 times the fifth derivative, about 1e-12
        slope = (8 * (ahead - behind) - (far_ahead - far_behind)) / (12 * step)
        np.testing.assert_allclose(tangent[:, i], slope, rtol=0, atol=1e-10 * np.abs(tangent).max())


@pytest.mark.parametrize("alpha", [0.0, 0.4, np.pi / 2, np.pi, -2.8])
def test_the_stiffness_at_rest_is_the_kernels_tangent(alpha: float) -> None:
    length = np.array([LENGTH])
    gradients = beam2d.strain_gradients(length, np.array([alpha]))
    stiffness = beam2d.undeformed_stiffness(length, gradients, SECTION)[0]
    at_rest = np.array([0.2, 0.1, 0.0, 0.2 + LENGTH * np.cos(alpha), 0.1 + LENGTH * np.sin(alpha), 0.0])
    _, tangent = kernel(at_rest[:, None], alpha)
    np.testing.assert_allclose(stiffness, tangent[..., 0], rtol=0, atol=1e-13)
