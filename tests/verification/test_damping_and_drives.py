"""Structural damping, prescribed motions and the balance of energy in the full-order model."""

import numpy as np
import pytest
from effect_scenes import BAR, BAR_INERTIA, CANTILEVER, G, linear_mode, recorded, run_batch, run_of, scene_of

from pgmp_petsc.effects import Motion

# a beam hinged at its middle: its antisymmetric free modes feel nothing of the hinge
SPINNER = CANTILEVER.replace('"beam:hinge"]', '"beam:middle"]').split("[effects.hold]")[0]
MIDDLE = (12, 13)  # x and y of the node there
DECAYS = {
    "stiffness": ("stiffness = 1e-3", lambda omega: 0.5e-3 * omega**2),
    "mass": ("mass = 2.0", lambda omega: 1.0),
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
    run = recorded(scene, small * shape, alone="ratios" not in name)
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
    run = recorded(scene, alone=True)
    turned = run.angle[-1] - run.angle[0]
    # it stretches by rho Omega^2 L^2 / 12 EA or so, 1e-5, and turns slower by twice that; half of (Omega h)^2 by the
    # scheme
    assert turned == pytest.approx(6.0, rel=1.5e-4)
    assert run.balance.work["loss"][-1] == pytest.approx(0.0, abs=1e-4 * run.balance.kinetic[0])
    assert run.balance.kinetic[-1] == pytest.approx(run.balance.kinetic[0], rel=2e-4)


def test_mass_damping_brakes_a_rotation() -> None:
    effects = '[effects.loss]\ntype = "structural_damping"\nmass = 1.5\n'
    run = recorded(scene_of(SPINNER, effects + run_of(1.0, 1e-2, velocity=3.0)), alone=True)
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
    drive = f'[effects.drive]\ntype = "prescribed_motion"\ncoordinate = "theta"\n{MOTIONS[name]}\n'
    base = CANTILEVER.split("[effects.hold]")[0] if flexible else BAR
    simulation = "[simulation]\nduration = 0.8\nstep = 2e-3\nspectral_radius = 0.8\n"
    scene = scene_of(base, drive + '[effects.weight]\ntype = "gravity"\n' + simulation)
    run = recorded(scene, alone=flexible or name != "table")
    motion = Motion("drive", scene.effects["drive"])
    angles, speeds, accelerations = np.array([motion.at(t) for t in run.time]).T
    np.testing.assert_allclose(run.angle, angles, rtol=0, atol=1e-11)
    if not flexible:
        torque = BAR_INERTIA * accelerations + 0.5 * G * np.cos(angles)
        work = np.concatenate([[0.0], np.cumsum(np.diff(angles) * (torque[1:] + torque[:-1]) / 2)])
        # trapezoidal rule here and there; accelerations that the scheme gives lag by half a step at most
        np.testing.assert_allclose(run.balance.work["drive"], work, rtol=0, atol=5e-3 * np.abs(work).max())
        np.testing.assert_allclose(run.balance.kinetic[1:], 0.5 * BAR_INERTIA * speeds[1:] ** 2, rtol=0, atol=2e-3)
    assert np.abs(run.balance.residual).max() < 5e-3 * run.balance.exchanged


WEIGHT = '[effects.weight]\ntype = "gravity"\n'
BALANCED = {
    "torque": '[effects.e]\ntype = "torque"\njoint = "hinge"\nharmonic = { amplitude = 3.0, frequency_hz = 1.0 }\n',
    "fixed force": '[effects.e]\ntype = "force"\npoint = "bar:tip"\ndirection = [1, 2]\n'
    "harmonic = { amplitude = 3.0, frequency_hz = 1.0 }\n",
    "following force": '[effects.e]\ntype = "force"\npoint = "bar:tip"\ndirection = [1, 2]\nfollows = true\n'
    "harmonic = { amplitude = 3.0, frequency_hz = 1.0 }\n",
    "pulling force": '[effects.e]\ntype = "force"\npoint = "bar:tip"\ntowards = "ground:anchor"\n'
    "harmonic = { amplitude = 3.0, frequency_hz = 1.0 }\n[ground.points]\nanchor = [0.5, 2.0]\n",
    "gravity": "",
    "point mass": '[effects.e]\ntype = "point_mass"\npoint = "bar:tip"\nmass = 0.7\n',
    "joint damping": '[effects.e]\ntype = "joint_damping"\njoint = "hinge"\ncoefficient = 0.4\n',
    "joint friction": '[effects.e]\ntype = "joint_friction"\njoint = "hinge"\nlimit = 0.4\nspeed = 0.5\n',
    "spring on a joint": '[effects.e]\ntype = "spring_damper"\njoint = "hinge"\nstiffness = 5.0\ndamping = 0.2\n',
    "spring between points": '[effects.e]\ntype = "spring_damper"\npoints = ["ground:anchor", "bar:tip"]\n'
    "stiffness = 9.0\ndamping = 0.2\nrest = 1.0\n[ground.points]\nanchor = [0.5, 2.0]\n",
    "prescribed motion": '[effects.e]\ntype = "prescribed_motion"\ncoordinate = "theta"\n'
    "harmonic = { amplitude = 1.0, frequency_hz = 1.0 }\n",
    "end stop": '[effects.e]\ntype = "end_stop"\njoint = "hinge"\nlower = -0.6\nstiffness = 100.0\ndamping = 0.1\n',
}
FLEXIBLE = {
    "stiffness damping": '[effects.e]\ntype = "structural_damping"\nstiffness = 2e-3\n',
    "mass damping": '[effects.e]\ntype = "structural_damping"\nmass = 0.7\n',
    "modal damping": '[effects.e]\ntype = "structural_damping"\nratios = [0.1, 0.05]\n',
}


@pytest.mark.parametrize("name", [*BALANCED, *FLEXIBLE])
def test_the_balance_of_energy_holds_at_second_order(name: str) -> None:
    largest = []
    for step in (4e-3, 2e-3) if name in FLEXIBLE else (1e-2, 5e-3):
        if name in FLEXIBLE:
            # a soft beam, so that steps resolve all of its modes that take part
            soft = (
                "bodies.beam.line.elements=2", "bodies.beam.section.axial=400.0", "bodies.beam.section.shear=400.0",
                "bodies.beam.section.bending=10.0", "bodies.beam.section.rotary_density=0.05",
            )  # fmt: skip
            scene = scene_of(SPINNER, FLEXIBLE[name] + WEIGHT + run_of(0.5, step, velocity=2.0), *soft)
            _, shape = linear_mode(scene, (3, 4), 1)
            run = run_batch(scene, 1, shape)
        else:
            start = "" if name == "prescribed motion" else "[simulation.initial.theta]\nvelocity = 1.0\n"
            simulation = f"[simulation]\nduration = 0.6\nstep = {step}\nspectral_radius = 0.8\n"
            run = run_batch(scene_of(BAR, BALANCED[name] + WEIGHT + simulation + start), 1)
        assert run.status == 0
        largest.append(np.abs(run.balance.residual).max())
        if "e" in run.model.scene.effects and name != "point mass":
            assert np.abs(run.balance.work["e"]).max() > 0.01, "the effect takes part"
    assert 3.3 < largest[0] / largest[1] < 5.0, largest
