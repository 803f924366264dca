"""Elastic modes of free bodies, and the modal damping made of them."""

import numpy as np
import pytest
from effect_scenes import BAR, CANTILEVER, line_meshes, mechanism_with_lines, scene_of

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.effects import effects_of
from pgmp_petsc.effects.damping import free_modes, modal_damping

# shear and rotary inertia lower the third frequency by (k^2 EI / GA + k^2 rho I / rho A) / 2 or so, 1e-4, k = 11; more
# slender still, and round-off relative to the highest frequencies is seen in the lowest
SLENDER = {"axial": 1e6, "shear": 1e6, "rotary_density": 1e-6}
FREE_FREE = np.array([4.730040744862704, 7.853204624095838, 10.995607838001671])  # roots of cosh x cos x = 1


def beam(n_elements: int, **section: float) -> Body:
    """Return the beam of the cantilever, EI = rho A = L = 1."""
    overrides = [f"bodies.beam.section.{key}={value}" for key, value in section.items()]
    scene = scene_of(CANTILEVER, "", f"bodies.beam.line.elements={n_elements}", *overrides)
    return mechanism_with_lines(scene).bodies[0]


@pytest.mark.parametrize("n_elements", [64, 128], ids=["dense solver", "sparse solver"])
def test_the_frequencies_of_a_free_beam(n_elements: int) -> None:
    body = beam(n_elements, **SLENDER)
    omega, phi, _ = free_modes(body, {}, 3, "entry")
    # elements of second order: (k h)^2 / 8 or less, k = 11, and 1e-4 by shear
    np.testing.assert_allclose(omega, FREE_FREE**2, rtol=(11 / n_elements) ** 2 / 8 + 1e-4)
    mass = weighted_sum(assemble([body], range(phi.shape[0])).mass, {})
    np.testing.assert_allclose(phi.T @ (mass @ phi), np.eye(3), rtol=0, atol=1e-6)


def test_the_error_of_frequencies_falls_at_second_order() -> None:
    wrong = [free_modes(beam(n, **SLENDER), {}, 1, "e")[0][0] / FREE_FREE[0] ** 2 - 1 for n in (8, 16, 32)]
    np.testing.assert_allclose(np.log2(np.array(wrong[:-1]) / wrong[1:]), 2.0, atol=0.1)


def test_modal_damping_gives_the_ratios_and_leaves_rigid_motions_alone() -> None:
    ratios = (0.02, 0.0, 0.05)
    scene = scene_of(CANTILEVER, f'[effects.loss]\ntype = "structural_damping"\nratios = {list(ratios)}')
    mechanism = mechanism_with_lines(scene)
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
    assert line_meshes(scene)["bar"].points["tip"] == 2
    mechanism = mechanism_with_lines(scene)
    assert modal_damping(effects_of(scene, mechanism), mechanism.bodies, {}) == ()
