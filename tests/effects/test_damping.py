"""Elastic modes of free bodies and the modal damping made of them; Kelvin-Voigt damping of the beam element."""

import numpy as np
import pytest
from compiled_elements import damped_beam2d
from effect_scenes import BAR, CANTILEVER, scene_of
from slopes import slopes

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.effects import effects_of
from pgmp_petsc.effects.damping import free_modes, modal_damping
from scenes import mechanism_of, meshes_of

# shear and rotary inertia lower the third frequency by (k^2 EI / GA + k^2 rho I / rho A) / 2 or so, 1e-4, k = 11; more
# slender still, and round-off relative to the highest frequencies is seen in the lowest
SLENDER = {"axial": 1e6, "shear": 1e6, "rotary_density": 1e-6}
FREE_FREE = np.array([4.730040744862704, 7.853204624095838, 10.995607838001671])  # roots of cosh x cos x = 1


def beam(n_elements: int, **section: float) -> Body:
    """Return the beam of the cantilever, EI = rho A = L = 1."""
    overrides = [f"bodies.beam.section.{key}={value}" for key, value in section.items()]
    scene = scene_of(CANTILEVER, "", f"bodies.beam.line.elements={n_elements}", *overrides)
    return mechanism_of(scene).bodies[0]


@pytest.mark.parametrize("n_elements", [64, 128], ids=["dense solver", "sparse solver"])
def test_the_frequencies_of_a_free_beam(n_elements: int) -> None:
    body = beam(n_elements, **SLENDER)
    omega, phi, _ = free_modes(body, {}, 3, "entry")
    # elements of second order: (k h)^2 / 8 or less, k = 11, and 1e-4 by shear
    np.testing.assert_allclose(omega, FREE_FREE**2, rtol=(11 / n_elements) ** 2 / 8 + 1e-4)
    mass = weighted_sum(AffineMatrices([body], range(phi.shape[0])).mass, {})
    np.testing.assert_allclose(phi.T @ (mass @ phi), np.eye(3), rtol=0, atol=1e-6)


def test_the_error_of_frequencies_falls_at_second_order() -> None:
    wrong = [free_modes(beam(n, **SLENDER), {}, 1, "e")[0][0] / FREE_FREE[0] ** 2 - 1 for n in (8, 16, 32)]
    np.testing.assert_allclose(np.log2(np.array(wrong[:-1]) / wrong[1:]), 2.0, atol=0.1)


def test_modal_damping_gives_the_ratios_and_leaves_rigid_motions_alone() -> None:
    ratios = (0.02, 0.0, 0.05)
    scene = scene_of(CANTILEVER, f'[effects.loss]\ntype = "structural_damping"\nratios = {list(ratios)}')
    mechanism = mechanism_of(scene)
    (damping,) = modal_damping(effects_of(scene, mechanism), mechanism.bodies, {})
    body = mechanism.bodies[0]
    omega, phi, _ = free_modes(body, {}, 3, "entry")
    within = phi.T @ damping.factor @ damping.factor.T @ phi
    np.testing.assert_allclose(within, np.diag(2.0 * np.array(ratios) * omega), rtol=0, atol=1e-6 * omega[-1])
    x = body.mesh.nodes[:, 0]
    rigid = np.zeros((x.size, 3, 3))
    rigid[:, 0, 0] = rigid[:, 1, 1] = rigid[:, 2, 2] = 1.0
    rigid[:, 1, 2] = x
    np.testing.assert_allclose(damping.factor.T @ rigid.reshape(-1, 3), 0.0, atol=1e-6)
    assert damping.levers.sum() == pytest.approx(1.0)


def test_rigid_bodies_have_no_modes_and_no_damping() -> None:
    scene = scene_of(BAR)
    assert meshes_of(scene)["bar"].points["tip"] == 2
    mechanism = mechanism_of(scene)
    assert modal_damping(effects_of(scene, mechanism), mechanism.bodies, {}) == ()


LENGTH, ALPHA, BETA, GAIN_V = 0.7, 0.4, 0.03, 250.0
SECTION = np.array([3.0, 2.0, 0.5])
STEP = 1e-6


def strains(u: np.ndarray) -> np.ndarray:
    """Return (eps, gamma, kappa) of one element, as the docstring of `beam2d` states them."""
    dx, dy, psi = u[3] - u[0], u[4] - u[1], 0.5 * (u[2] + u[5]) + ALPHA
    stretch, across = np.cos(psi) * dx + np.sin(psi) * dy, np.cos(psi) * dy - np.sin(psi) * dx
    return np.array([stretch - LENGTH, across, u[5] - u[2]]) / LENGTH


def damped(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return force (6,), full tangent (6, 6) and power of one element."""
    return damped_beam2d(u, v, LENGTH, ALPHA, SECTION, BETA, GAIN_V)


def states() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return strongly deformed states and their rates."""
    rng = np.random.default_rng(4)
    return [
        (np.array([0.1, -0.2, 0.3, 0.85, 0.15, -0.4]) + rng.normal(0, 0.3, 6), rng.normal(size=6)) for _ in range(5)
    ]


def test_stresses_follow_the_rate_of_the_strains() -> None:
    for u, v in states():
        changes = slopes(strains, u, STEP).T
        rates = (strains(u + STEP * v) - strains(u - STEP * v)) / (2 * STEP)
        force, _, power = damped(u, v)
        # central differences: round-off over the step, 1e-10
        np.testing.assert_allclose(force, LENGTH * changes @ (BETA * SECTION * rates), rtol=0, atol=1e-9)
        assert power == pytest.approx(-LENGTH * BETA * SECTION @ rates**2, rel=0, abs=1e-9)
        assert power == pytest.approx(-force @ v, rel=1e-12)


def test_the_tangent_is_that_of_the_rates() -> None:
    for u, v in states():
        _, tangent, _ = damped(u, v)
        changes = slopes(lambda rates: damped(u, rates)[0], v, STEP)
        np.testing.assert_allclose(tangent, GAIN_V * changes, rtol=0, atol=GAIN_V * 1e-9)


def test_a_rigid_motion_is_not_damped_however_deformed_the_element_is() -> None:
    for u, _ in states():
        turning = 1.7 * np.array([-u[1], u[0], 1.0, -u[4], u[3], 1.0]) + np.array([0.4, -0.3, 0, 0.4, -0.3, 0])
        force, _, power = damped(u, turning)
        np.testing.assert_allclose(force, 0.0, atol=1e-14)
        assert power == pytest.approx(0.0, abs=1e-15)
