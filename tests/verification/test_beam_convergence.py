"""Beams against closed forms, with observed order: deflection, roll-up to a circle, bending modes of a hinged beam."""

import compiled_elements
import numpy as np
import pytest
from mpi4py import MPI

from pgmp_petsc.bodies.body import DOFS_PER_NODE, element_dofs
from pgmp_petsc.modes.problem import ModalProblem
from scenes import SHEAR_FACTOR, STEEL, kinematics_of, pendulum, straight

N_ELEMENTS = (10, 20, 40)


def solve_cantilever(n: int, section: np.ndarray, load: np.ndarray, n_steps: int) -> np.ndarray:
    """Return the nodal unknowns (n + 1, 3) of a cantilever of 1 m under a load (3,) on its tip, by Newton's method."""
    mesh = straight(0.0, 1.0, n)
    dofs = element_dofs(mesh.cells)
    u = np.column_stack([mesh.nodes, np.zeros(n + 1)]).ravel()
    free = np.arange(DOFS_PER_NODE, u.size)
    for factor in np.linspace(0.0, 1.0, n_steps + 1)[1:]:
        for _ in range(30):
            residual, tangent = np.zeros(u.size), np.zeros((u.size, u.size))
            residual[-3:] = -factor * load
            for element, length in zip(dofs, mesh.lengths):
                force, local = compiled_elements.beam2d(u[element], length, 0.0, section)
                residual[element] += force
                tangent[np.ix_(element, element)] += local
            step = np.linalg.solve(tangent[np.ix_(free, free)], residual[free])
            u[free] -= step
            if np.max(np.abs(step)) < 1e-10:
                break
        else:
            pytest.fail("Newton's method does not converge")
    return u.reshape(n + 1, DOFS_PER_NODE)


def observed_order(errors: list[float]) -> np.ndarray:
    """Return the order of convergence between grids, each twice as fine as the one before."""
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize("slenderness", [1e1, 1e4])
def test_the_deflection_of_a_cantilever(slenderness: float) -> None:
    # P L^3 / (3 EI) + P L / (k_s G A); the tip's load is small enough for the linear answer
    section = np.array([slenderness**2, 0.4 * slenderness**2, 1.0])
    force = 1e-5
    exact = force / 3 + force / section[1]
    errors = []
    for n in N_ELEMENTS:
        tip = solve_cantilever(n, section, np.array([0.0, force, 0.0]), 1)[-1, 1]
        errors.append(abs(tip - exact) / exact)
    # one-point quadrature does not lock: the bending part errs by 1 / (4 n^2), whatever the slenderness
    np.testing.assert_allclose(observed_order(errors), 2.0, rtol=0, atol=0.02)
    assert errors[-1] == pytest.approx(0.25 / 40**2 * (force / 3) / exact, rel=0.01)


@pytest.mark.parametrize(("angle", "n_steps", "reach"), [(np.pi / 2, 4, 1.0), (2 * np.pi, 12, 2.0)])
def test_a_couple_rolls_a_beam_up(angle: float, n_steps: int, reach: float) -> None:
    """A couple EI angle / L on the tip bends a beam to an arc; the largest coordinate is `reach` times the radius."""
    section = np.array([1e4, 4e3, 1.0])
    radius, errors = 1.0 / angle, []
    for n in N_ELEMENTS:
        q = solve_cantilever(n, section, np.array([0.0, 0.0, angle]), n_steps)
        phi = np.linspace(0.0, angle, n + 1)
        # the curvature of pure bending is constant, so rotations are exact
        np.testing.assert_allclose(q[:, 2], phi, rtol=0, atol=1e-9)
        exact = radius * np.column_stack([np.sin(phi), 1 - np.cos(phi)])
        errors.append(np.max(np.abs(q[:, :2] - exact)))
        # elements are as long as the arcs whose chords they are
        half = angle / n / 2
        assert errors[-1] == pytest.approx(reach * radius * (half / np.sin(half) - 1), rel=1e-6)
    np.testing.assert_allclose(observed_order(errors), 2.0, rtol=0, atol=0.02)


def test_the_bending_modes_of_a_hinged_beam() -> None:
    """Pinned at one end, free at the other: tan(b L) = tanh(b L), b L = 3.9266, 7.0686 (Euler and Bernoulli)."""
    radius, shift = 2e-4, np.array([3.92660231, 7.06858275])
    area, inertia = np.pi * radius**2, np.pi * radius**4 / 4
    exact = shift**2 * np.sqrt(STEEL["E"] * inertia / (STEEL["rho"] * area)) / (2 * np.pi)
    errors = []
    for n in N_ELEMENTS:
        kinematics = kinematics_of(pendulum(f'bodies.arm.mesh="0.0:1.0:{n}"'))
        with ModalProblem(kinematics, {}, 2, MPI.COMM_SELF) as problem:
            frequencies = problem.solve(0.3).frequencies_hz
        errors.append(np.abs(frequencies / exact - 1))
    # shear and rotary inertia take (b L r / L)^2 (1 + E / (k_s G)) / 8 = 3e-6 at most off, 1/500 of the finest error
    assert (shift[1] * radius) ** 2 * (1 + 2 * 1.3 / SHEAR_FACTOR) / 8 < 3e-6
    for mode in range(2):
        np.testing.assert_allclose(observed_order([e[mode] for e in errors]), 2.0, rtol=0, atol=0.06)
    assert errors[-1].max() < 5e-3
