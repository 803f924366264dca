"""Effects in the full-order model: closed forms of rigid and flexible bodies, and published benchmarks."""

from collections.abc import Callable

import numpy as np
import pytest
from cantilevers import PUBLISHED
from conftest import ROOT
from effect_scenes import (
    BAR,
    BAR_INERTIA,
    BLOCK,
    CANTILEVER,
    STEP,
    G,
    Recorded,
    bar,
    linear_mode,
    recorded,
    run_batch,
    run_of,
    scene_of,
    turning,
)  # fmt: skip
from scipy.optimize import brentq, curve_fit
from scipy.special import ellipk

from pgmp_petsc.scene import load_scene
from scenes import tables


def pull(angle: float, force: float) -> float:
    """Return the torque of a force from the tip towards (0.3, 1.4)."""
    x, y = np.cos(angle), np.sin(angle)
    return force * (1.4 * x - 0.3 * y) / np.hypot(0.3 - x, 1.4 - y)


def strut(angle: float, speed: float) -> float:
    """Return the torque of a spring and damper between these points."""
    length = np.hypot(0.3 - np.cos(angle), 1.4 - np.sin(angle))
    return pull(angle, 20.0 * (length - 0.9) - 0.7 * pull(angle, 1.0) * speed)


def stop(angle: float, speed: float, damping: float) -> float:
    """Return the torque of weight and stop on a bar that falls."""
    return -0.5 * G * np.cos(angle) + max(0.0, 2000.0 * max(0.0, -0.5 - angle) * (1.0 - damping * speed))


WEIGHT, ANCHOR = 'effects.weight: type = "gravity"', "ground.points: anchor = [0.3, 1.4]"
PUSH = 'effects.e: type = "force"; direction = [3.0, 4.0]; table = [[0.0, 0.0], [0.5, 2.0]]; point = '
STOP = 'effects.e: type = "end_stop"; joint = "hinge"; lower = -0.5; stiffness = 2000.0; damping = '
STRUT = 'effects.e: type = "spring_damper"; stiffness = 20.0; damping = 0.7; rest = 0.9; points = '
Row = tuple[str, Callable[[float, float, float], float], float, float, dict[str, float], float]
#: Effects; torque about the hinge of (t, angle, speed); further moment of inertia; duration and start; tolerance: of
#: the scheme (omega h)^2 / 12 of what swings, and as much again by the circle that the centre of mass makes.
TURNED: dict[str, Row] = {
    "harmonic torque": (
        'effects.e: type = "torque"; joint = "hinge"; scale = 1.5; '
        "harmonic = { amplitude = 0.7, frequency_hz = 2.0, phase = 0.4, mean = 0.2 }",
        lambda t, a, w: 1.5 * (0.7 * np.sin(4.0 * np.pi * t + 0.4) + 0.2), 0.0, 0.3, {"velocity": 0.3}, 1e-5,
    ),
    # on the centre of mass it is a load, elsewhere an action; in the hinge it does nothing
    **{
        f"force on bar:{point}": (
            f'{PUSH}"bar:{point}"',
            lambda t, a, w, arm=arm: 4.0 * t * arm * (0.8 * np.cos(a) - 0.6 * np.sin(a)),
            0.0, 0.3, {"velocity": 0.3}, 1e-5,
        )
        for point, arm in {"tip": 1.0, "middle": 0.5, "hinge": 0.0}.items()
    },
    "following force": ('effects.e: type = "force"; point = "bar:tip"; direction = [1.0, 1.0]; follows = true; '
        "harmonic = { amplitude = 0.0, frequency_hz = 1.0, mean = 2.0 }",
        lambda t, a, w: np.sqrt(0.5) * 2.0, 0.0, 0.3, {"position": 0.4}, 2e-6,),
    "pulling force": (f'{ANCHOR}\neffects.e: type = "force"; point = "bar:tip"; towards = "ground:anchor"; '
        "table = [[0.0, 0.5], [0.5, 1.5]]", lambda t, a, w: pull(a, 0.5 + 2.0 * t), 0.0, 0.3, {}, 1e-5,),
    "point mass": ("parameters.m: nominal = 0.5; value = 0.8\n"
        'effects.weight: type = "gravity"; direction = [0.0, -3.0]; acceleration = 9.0\n'
        'effects.bob: type = "point_mass"; point = "bar:tip"; mass = "m"; inertia = 0.05',
        lambda t, a, w: -(0.5 + 0.8) * 9.0 * np.cos(a), 0.85, 0.4, {}, 4e-5,),
    "joint damping": ('effects.e: type = "joint_damping"; joint = "hinge"; coefficient = 0.5',
        lambda t, a, w: -0.5 * w, 0.0, 0.5, {"velocity": 2.0}, 4e-6,),
    # it stops after J w / limit = 0.667 s
    "joint friction": ('effects.e: type = "joint_friction"; joint = "hinge"; limit = 0.5; speed = 0.1',
        lambda t, a, w: -0.5 * np.tanh(w / 0.1), 0.0, 0.8, {"velocity": 1.0}, 2e-6,),
    "spring in a joint": (
        'effects.e: type = "spring_damper"; joint = "hinge"; stiffness = 40.0; damping = 0.6; rest = 0.2',
        lambda t, a, w: -40.0 * (a - 0.2) - 0.6 * w, 0.0, 0.5, {}, 1e-4,),
    "spring from a point": (
        f'{ANCHOR}\n{STRUT}["ground:anchor", "bar:tip"]', lambda t, a, w: strut(a, w), 0.0, 0.4, {}, 1e-4),
    "spring to a point": (
        f'{ANCHOR}\n{STRUT}["bar:tip", "ground:anchor"]', lambda t, a, w: strut(a, w), 0.0, 0.4, {}, 1e-4
    ),
    # within the stop omega h = 0.15, of half a period's 0.04 s at 5 rad/s; four times as much of the damping
    "stop": (f"{WEIGHT}\n{STOP}0.0", lambda t, a, w: stop(a, w, 0.0), 0.0, 0.64, {}, 4e-4),
    "damped stop": (f"{WEIGHT}\n{STOP}0.3", lambda t, a, w: stop(a, w, 0.3), 0.0, 0.64, {}, 3e-3),
}  # fmt: skip


@pytest.mark.parametrize("name", TURNED)
def test_a_bar_turns_as_its_torques_say(name: str) -> None:
    """What the balance of energy leaves falls as the square of the step; of damped impacts instants count, too."""
    entries, torque, further, duration, start, tolerance = TURNED[name]
    scene, finer = (bar(tables(entries + "\n"), duration, step, **start) for step in (2e-3, 1e-3))
    run = recorded(scene)
    expected = turning(torque, run.time, inertia=BAR_INERTIA + further, **start)
    np.testing.assert_allclose(run.angle, expected, rtol=0, atol=tolerance)
    if name == "force on bar:hinge":
        assert run.balance.exchanged < 1e-9
        return
    coarse, fine = (np.abs(one.balance.residual).max() for one in (run, run_batch(finer, 1)))
    assert 3.0 < coarse / fine < 5.0 and coarse < 1e-2 * run.balance.exchanged
    assert np.abs(run.balance.work["weight" if name == "point mass" else "e"]).max() > 1e-2


def test_a_following_force_at_the_tip_of_a_flexible_beam() -> None:
    """Statics: the tip of a cantilever under a small following couple of forces bends as under a fixed one."""
    push = tables("""
effects.push: type = "force"; point = "beam:tip"; direction = [0.0, 1.0]; follows = true;
    table = [[0.0, 0.0], [10.0, 0.03], [20.0, 0.03]]
effects.loss: type = "structural_damping"; stiffness = 0.1
""")
    run = recorded(scene_of(CANTILEVER, push + run_of(20.0, 0.1, 0.5)))
    # F L^3 / 3 EI; elements of second order, (1 / 8)^2 / 4, and finite rotations 1e-4
    assert run.point("beam:tip")[-1, 1] == pytest.approx(0.01, rel=6e-3)


@pytest.mark.parametrize("flexible", [False, True])
def test_the_period_of_a_pendulum(flexible: bool) -> None:
    start = -0.3
    swing = np.pi / 2 + start
    period = 4.0 * np.sqrt(2.0 / (3.0 * G)) * ellipk(np.sin(swing / 2.0) ** 2)
    soft = (
        "bodies.bar.flexible=true", "bodies.bar.section.axial=1e5", "bodies.bar.section.shear=1e5",
        "bodies.bar.section.bending=1e3", "bodies.bar.section.rotary_density=1e-5",
    )  # fmt: skip
    weight = '[effects.weight]\ntype = "gravity"' + run_of(period, 2e-3, 0.8, position=start)
    run = recorded(scene_of(BAR, weight, *(soft if flexible else ())))
    middle = run.angle[len(run.time) // 2]
    # turning back the angle stands still: what an error of the period does there is of second order; half a period on,
    # too
    assert run.angle[-1] == pytest.approx(start, abs=2e-4)
    assert middle == pytest.approx(-np.pi - start, abs=2e-4)
    quarter = np.interp(period / 4, run.time, run.angle)
    # (omega h)^2 / 12 of a quarter of a turn; bent by its own weight at most 1e-3 where it is flexible
    assert quarter == pytest.approx(-np.pi / 2, abs=2e-3 if flexible else 5e-5)


def test_a_mass_at_the_tip_of_a_cantilever() -> None:
    ratio = 0.5
    bob = tables(f'effects.bob: type = "point_mass"; point = "beam:tip"; mass = {ratio}\n')
    scene = scene_of(CANTILEVER, bob + run_of(2.5, 5e-3))
    omega, shape = linear_mode(scene, [0, 1, 2], 0)
    root = brentq(
        lambda k: 1 + np.cosh(k) * np.cos(k) + ratio * k * (np.cos(k) * np.sinh(k) - np.sin(k) * np.cosh(k)), 1.0, 1.8
    )
    # elements of second order, (1 / 8)^2 / 8
    assert omega == pytest.approx(root**2, rel=3e-3)
    small = 1e-4
    run = recorded(scene, small * shape)
    # the period is longer by (omega h)^2 / 12, 8e-6, over 1 period
    np.testing.assert_allclose(
        run.point("beam:tip")[:, 1], small * shape[-2] / omega * np.sin(omega * run.time), rtol=0,
        atol=2e-4 * small / omega,
    )  # fmt: skip


def block(effects: str, duration: float) -> Recorded:
    """Run a block of 1 kg on rails, which a crank drive's massless bars leave alone; its speed is 0.5 m/s."""
    start = "[simulation.initial.theta]"
    simulation = f"\n[simulation]\nduration = {duration}\nstep = {STEP}\nspectral_radius = 0.99\n{start}"
    return recorded(scene_of(BLOCK.replace(start, simulation) + "velocity = -1.0\n" + effects))


START = np.sqrt(0.75)  # of the block, m
RUBS = "limit = 1.0; speed = 0.05"
#: Effects, and the force of (t, way, speed). What the scheme leaves is (omega h)^2 / 12 of 0.05 m and of the time at a
#: stop, 3e-5, and as much are the bars of 1e-6 kg.
SLID = {
    "damping": ('type = "joint_damping"; joint = "slide"; coefficient = 3.0', lambda t, x, v: -3.0 * v),
    "friction": (f'type = "joint_friction"; joint = "slide"; {RUBS}', lambda t, x, v: -np.tanh(v / 0.05)),
    "friction at a point": (
        f'type = "point_friction"; point = "rod:tip"; direction = [3.0, 0.0]; {RUBS}',
        lambda t, x, v: -np.tanh(v / 0.05),
    ),
    "spring": (
        f'type = "spring_damper"; joint = "slide"; stiffness = 100.0; damping = 2.0; rest = {START}',
        lambda t, x, v: -100.0 * x - 2.0 * v,
    ),
    "stop": (
        f'type = "end_stop"; joint = "slide"; upper = {START + 0.05}; stiffness = 2500.0',
        lambda t, x, v: -2500.0 * max(x - 0.05, 0.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SLID)
def test_a_block_slides_as_its_forces_say(name: str) -> None:
    entries, force = SLID[name]
    run = block(tables(f"effects.e: {entries}\n"), 0.6)
    expected = turning(force, run.time, 0.0, 0.5, 1.0)
    np.testing.assert_allclose(
        run.point("rod:tip")[:, 0] - START, expected, rtol=0, atol=6e-5 if name == "stop" else 2e-5
    )
    assert np.abs(run.balance.residual).max() < 1e-4 * run.balance.exchanged


@pytest.mark.parametrize(("spin", "expected"), PUBLISHED)
def test_the_frequency_of_a_rotating_beam(spin: float, expected: float) -> None:
    """In the plane of rotation, in units of sqrt(EI / rho A L^4), from a short free vibration."""
    scene = scene_of(
        CANTILEVER, "[simulation]\nduration = 2.5\nstep = 5e-3\nspectral_radius = 0.6\n",
        f"effects.hold.constant_speed.speed={spin}", "bodies.beam.line.elements=16",
    )  # fmt: skip
    _, shape = linear_mode(scene, [0, 1, 2], 0)
    run = run_batch(scene, 1, 1e-3 * shape)
    x, y = run.frames[:, -1, 0], run.frames[:, -1, 1]
    across = y * np.cos(spin * run.time) - x * np.sin(spin * run.time)

    def swing(t: np.ndarray, omega: float, cos: float, sin: float, decay: float) -> np.ndarray:
        return np.exp(-decay * t) * (cos * np.cos(omega * t) + sin * np.sin(omega * t))

    fitted, _ = curve_fit(swing, run.time, across, p0=(expected, 0.0, across.max(), 0.0))
    # 16 elements: 1e-3; steps: (spin h)^2 at the highest spin, 2.5e-3
    assert fitted[0] == pytest.approx(expected, rel=5e-3)


def test_the_double_four_bar_goes_through_its_singular_positions() -> None:
    """All rods in one line, twice a turn; the scene's whole 10 s keep the energy to 1e-5 with its step of 0.5 ms."""
    wrong = []
    for step in (8e-3, 4e-3):
        scene = load_scene(
            ROOT / "scenes" / "double_four_bar.toml", ["simulation.duration=2.0", f"simulation.step={step}"]
        )
        run = run_batch(scene, 1)
        assert run.status == 0
        energy = run.balance.kinetic + run.balance.potential
        wrong.append(np.abs(energy - energy[0]).max() / energy[0])
        directions = run.frames[:, :, 2]
        assert directions[-1, 0] < -np.pi, "beyond the singular positions at 0 and -pi"
        # it stays a parallelogram: no other branch is taken
        np.testing.assert_allclose(directions[:, :3], directions[:, :1].repeat(3, axis=1), rtol=0, atol=1e-9)
        np.testing.assert_allclose(directions[:, 3:], 0.0, rtol=0, atol=1e-9)
    # 64 times what the scene's step leaves
    assert wrong[1] < 64 * 1e-5
    assert 3.5 < wrong[0] / wrong[1] < 4.5


def test_a_beam_welded_to_a_held_hub_is_a_clamped_one() -> None:
    push = tables("""
effects.push: type = "force"; point = "beam:tip"; direction = [0.0, 1.0]; table = [[0.0, 1.0], [1.0, 1.0]]
""") + run_of(0.5, 5e-3)
    clamped = recorded(scene_of(CANTILEVER, push))
    welded = recorded(
        scene_of(
            CANTILEVER.replace('"ground:origin", "beam:hinge"', '"ground:origin", "hub:hinge"'),
            tables("""
bodies.hub: line = { length = 0.2, elements = 1 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1.0 };
    placement = { angle = 0.7 }
joints.weld: type = "fixed"; connect = ["hub:hinge", "beam:hinge"]
""")
            + push,
            "effects.hold.constant_speed.start=0.7",
        ),
    )
    np.testing.assert_allclose(welded.point("beam:tip"), clamped.point("beam:tip"), rtol=0, atol=1e-9)
    np.testing.assert_allclose(welded.balance.strain, clamped.balance.strain, rtol=0, atol=1e-9)
    assert np.abs(clamped.point("beam:tip")[:, 1]).max() > 0.3
