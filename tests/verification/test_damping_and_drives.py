"""Structural damping, prescribed motions and the balance of energy in the full-order model."""

import numpy as np
import pytest
from effect_scenes import BAR, BAR_INERTIA, CANTILEVER, G, linear_mode, recorded, run_batch, run_of, scene_of

# a beam hinged at its middle: its antisymmetric free modes feel nothing of the hinge
SPINNER = CANTILEVER.replace('"beam:hinge"]', '"beam:middle"]').split("[effects.hold]")[0]
MIDDLE = (12, 13)  # x and y of the node there
DECAYS = {
    "both": ("mass = 1.0\nstiffness = 5e-4", lambda omega: 0.5 + 0.25e-3 * omega**2),
    "ratios": ("ratios = [0.5, 0.03]", lambda omega: 0.03 * omega),
    "large ratios": ("ratios = [0.9, 0.6]", lambda omega: 0.6 * omega),
}


@pytest.mark.parametrize("name", DECAYS)
def test_the_decay_of_a_mode(name: str) -> None:
    text, decay = DECAYS[name]
    step = 5e-4
    scene = scene_of(SPINNER, f'[effects.loss]\ntype = "structural_damping"\n{text}\n' + run_of(0.3, step))
    # beyond the rotation about the hinge and the first symmetric mode with the middle held: found by its symmetry
    for number in range(1, 4):
        omega, shape = linear_mode(scene, MIDDLE, number)
        if abs(shape[1] + shape[-2]) < 1e-6:
            break
    assert omega == pytest.approx(7.8532**2, rel=0.1), "(k h)^2 / 8"
    small, rate = 1e-5, decay(omega)
    run = recorded(scene, small * shape)
    damped = np.sqrt(omega**2 - rate**2)
    expected = small * shape[-2] / damped * np.exp(-rate * run.time) * np.sin(damped * run.time)
    # the phase is late by (omega h)^2 / 12 of omega t at most, 1.6e-3
    np.testing.assert_allclose(run.point("beam:tip")[:, 1], expected, rtol=0, atol=2e-3 * small / omega)
    if "mass" not in text:
        # equal and opposite at the ends, and no rotation of the whole
        assert np.abs(run.frames[:, 0, 1] + run.frames[:, -1, 1]).max() < 1e-3 * small / omega
    work, gained = run.balance.work["loss"], run.balance.kinetic + run.balance.strain
    np.testing.assert_allclose(gained - gained[0], work, rtol=0, atol=2e-3 * gained[0])


@pytest.mark.parametrize("damping", ["stiffness = 1e-2", "ratios = [0.1, 0.1, 0.1]"])
def test_a_rotation_is_not_damped(damping: str) -> None:
    scene = scene_of(
        SPINNER, f'[effects.loss]\ntype = "structural_damping"\n{damping}\n' + run_of(2.0, 5e-3, 0.8, velocity=3.0)
    )
    run = recorded(scene)
    turned = run.angle[-1] - run.angle[0]
    # it stretches by rho Omega^2 L^2 / 12 EA or so, 1e-5, and turns slower by twice that; half of (Omega h)^2 by the
    # scheme
    assert turned == pytest.approx(6.0, rel=1.5e-4)
    assert run.balance.work["loss"][-1] == pytest.approx(0.0, abs=1e-4 * run.balance.kinetic[0])
    assert run.balance.kinetic[-1] == pytest.approx(run.balance.kinetic[0], rel=2e-4)


def test_mass_damping_brakes_a_rotation() -> None:
    effects = '[effects.loss]\ntype = "structural_damping"\nmass = 1.5\n'
    run = recorded(scene_of(SPINNER, effects + run_of(1.0, 1e-2, velocity=3.0)))
    # half of (Omega h)^2 of the turn
    np.testing.assert_allclose(run.angle, 3.0 / 1.5 * -np.expm1(-1.5 * run.time), rtol=0, atol=3e-4)


MOTIONS = {
    "table": "table = [[0.0, 0.2], [0.3, 0.9], [0.8, 0.4]]",
    "harmonic": "harmonic = { amplitude = 0.3, frequency_hz = 1.5, phase = 0.4, mean = 0.1 }",
    "spin_up": "spin_up = { speed = 2.0, time = 0.6, start = 0.3 }",
    "constant_speed": "constant_speed = { speed = 2.0, start = 0.3 }",
}


@pytest.mark.parametrize(
    ("name", "flexible"), [*((name, False) for name in MOTIONS), ("table", True), ("spin_up", True)]
)
def test_a_prescribed_motion_is_followed(name: str, flexible: bool) -> None:
    """Also by the work that it takes; what the balance of energy leaves falls as the square of the step."""
    drive = f'[effects.drive]\ntype = "prescribed_motion"\ncoordinate = "theta"\n{MOTIONS[name]}\n'
    base = CANTILEVER.split("[effects.hold]")[0] if flexible else BAR
    scene, finer = (scene_of(base, drive + WEIGHT + run_of(0.8, step, 0.8)) for step in (2e-3, 1e-3))
    run = recorded(scene)
    motion = scene.effects["drive"].motion("drive")
    angles, speeds, accelerations = np.array([motion.at(t) for t in run.time]).T
    np.testing.assert_allclose(run.angle, angles, rtol=0, atol=1e-11)
    assert np.abs(run.balance.residual).max() < 5e-3 * run.balance.exchanged
    if flexible:
        return
    torque = BAR_INERTIA * accelerations + 0.5 * G * np.cos(angles)
    work = np.concatenate([[0.0], np.cumsum(np.diff(angles) * (torque[1:] + torque[:-1]) / 2)])
    # trapezoidal rule here and there; accelerations that the scheme gives lag by half a step at most
    np.testing.assert_allclose(run.balance.work["drive"], work, rtol=0, atol=5e-3 * np.abs(work).max())
    np.testing.assert_allclose(run.balance.kinetic[1:], 0.5 * BAR_INERTIA * speeds[1:] ** 2, rtol=0, atol=2e-3)
    left = [np.abs(one.balance.residual).max() for one in (run, run_batch(finer, 1))]
    assert 3.5 < left[0] / left[1] < 4.5


WEIGHT = '[effects.weight]\ntype = "gravity"\n'
DAMPINGS = {"stiffness": "stiffness = 2e-3", "mass": "mass = 0.7", "modal": "ratios = [0.1, 0.05]"}


@pytest.mark.parametrize("name", DAMPINGS)
def test_the_balance_of_energy_of_a_damped_beam_holds_at_second_order(name: str) -> None:
    """Of a soft beam, so that steps resolve all of its modes that take part; of other effects: `test_effects_full`."""
    soft = (
        "bodies.beam.line.elements=2", "bodies.beam.section.axial=400.0", "bodies.beam.section.shear=400.0",
        "bodies.beam.section.bending=10.0", "bodies.beam.section.rotary_density=0.05",
    )  # fmt: skip
    damping, largest = f'[effects.e]\ntype = "structural_damping"\n{DAMPINGS[name]}\n', []
    for step in (4e-3, 2e-3):
        scene = scene_of(SPINNER, damping + WEIGHT + run_of(0.5, step, velocity=2.0), *soft)
        run = run_batch(scene, 1, linear_mode(scene, (3, 4), 1)[1])
        assert run.status == 0 and np.abs(run.balance.work["e"]).max() > 0.01
        largest.append(np.abs(run.balance.residual).max())
    assert 3.3 < largest[0] / largest[1] < 5.0, largest
