"""Steps that end where a law has an edge: a bar that bounces between its stops."""

import numpy as np
from effect_scenes import BAR, BAR_INERTIA, scene_of
from runs import full_model, watched

from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State
from scenes import tables

STIFFNESS, SPEED, GAP = 200.0, 1.0, 0.1
CONTACT = np.pi * np.sqrt(BAR_INERTIA / STIFFNESS)  # half a period of the spring, s


def bouncing(step: float, duration: float, upper: float = GAP, stiffness: object = STIFFNESS, more: str = "") -> Scene:
    """Return a bar that turns freely between stops at ``-GAP`` and `upper`."""
    value = f'"{stiffness}"' if isinstance(stiffness, str) else stiffness
    return scene_of(
        BAR,
        tables(f"""
effects.stop: type = "end_stop"; joint = "hinge"; lower = {-GAP}; upper = {upper}; stiffness = {value}
simulation: duration = {duration}; step = {step}; spectral_radius = 1.0
[simulation.initial.theta]
velocity = {SPEED}
{more}
"""),
    )


def exact(time: float) -> float:
    """Return the angle of a bar that bounces between two springs."""
    period = 2 * (2 * GAP / SPEED + CONTACT)
    t = (time + GAP / SPEED) % period  # since it left the lower stop
    sign = 1.0
    if t > 0.5 * period:
        t, sign = t - 0.5 * period, -1.0
    if t <= 2 * GAP / SPEED:
        return sign * (-GAP + SPEED * t)
    rate = np.sqrt(STIFFNESS / BAR_INERTIA)
    return sign * (GAP + SPEED / rate * np.sin(rate * (t - 2 * GAP / SPEED)))


def angles(scene: Scene, n: int = 1, **values: np.ndarray) -> np.ndarray:
    """Return the angle of every sample at every step, shape (n_t, n)."""
    system = full_model(scene).batch(values, n)
    return np.array(watched(system, scene.simulation, lambda _, state: system.unpack(state.q)[2])[1])


def test_the_time_of_contact_is_half_a_period_of_the_spring() -> None:
    # free, in contact, free again; long after the last contact the error is that of the time within the spring
    duration = 0.4
    wrong = []
    for step in (4e-3, 2e-3, 1e-3):
        last = angles(bouncing(step, duration))[-1, 0]
        wrong.append(abs(last - exact(duration)))
    assert exact(duration) < GAP
    # the scheme's period is longer by (omega h)^2 / 12 of half a period, 8e-6 at the finest step
    assert wrong[-1] < 2e-5
    np.testing.assert_allclose(np.log2(np.array(wrong[:-1]) / wrong[1:]), 2.0, atol=0.15)


def test_many_contacts_with_both_stops() -> None:
    step = 2e-3
    found = angles(bouncing(step, 1.2))[:, 0]
    times = step * np.arange(found.size)
    # four contacts, each late by (omega h)^2 / 12 of itself, 2e-5 s; speed 1 rad/s
    np.testing.assert_allclose(found, [exact(t) for t in times], rtol=0, atol=2e-4)
    free = np.abs(found) < GAP - 2 * step
    speeds = np.abs(np.diff(found)) / step
    # energy is kept: the same speed after every contact
    np.testing.assert_allclose(speeds[free[:-1] & free[1:]], SPEED, rtol=0, atol=1e-4)


def test_a_sample_with_events_does_not_change_the_others() -> None:
    """Bit for bit: those that never touch a stop, and those that touch at other times."""
    more = (
        "[parameters.k]\nnominal = 200.0\n[parameters.g]\nnominal = 0.0\n"
        '[effects.field]\ntype = "gravity"\nacceleration = "g"'
    )
    scene = bouncing(2e-3, 0.4, stiffness="k", more=more)
    k = np.array([200.0, 150.0, 200.0, 900.0, 200.0, 200.0, 200.0, 333.0, 200.0, 210.0])
    g = np.array([0.0, 0.0, 8.0, -3.0, 60.0, 1.0, 0.0, 0.0, 0.3, 0.1])
    together = angles(scene, 10, k=k, g=g)
    for sample in (0, 2, 4, 7, 9):
        alone = angles(scene, 1, k=k[[sample]], g=g[[sample]])
        np.testing.assert_array_equal(together[:, sample], alone[:, 0])


def test_a_start_within_a_stop_is_no_event_until_it_is_left() -> None:
    scene = bouncing(1e-3, 0.2, upper=-0.05)
    model = full_model(scene)
    system = model.batch({}, 1)
    state = system.start()
    assert system.n_events == 2 and full_model(scene_of(BAR)).batch({}, 1).n_events == 0
    depths = system.depths(np.zeros(1), state.alone, np.ones(1, dtype=bool))
    np.testing.assert_array_equal(depths[0, :, 0] > 0.0, [False, True])
    found = angles(scene)[:, 0]
    rate = np.sqrt(STIFFNESS / BAR_INERTIA)
    times = np.linspace(0.0, 0.2, 201)
    within = times < 0.05
    expected = -0.05 + 0.05 * np.cos(rate * times) + SPEED / rate * np.sin(rate * times)
    # (omega h)^2 / 12 of omega t
    np.testing.assert_allclose(found[within], expected[within], rtol=0, atol=5e-6)


def test_edges_are_looked_for_at_many_instants_at_once() -> None:
    """Of some samples, in one block of two, at each instant what the bar's angle says."""
    system, some = full_model(bouncing(1e-3, 0.2)).batch({}, 10), np.arange(10) > 7
    turned = 0.02 * np.arange(1.0, 5.0)[:, None] * (np.arange(10.0) - 4.0)
    states = State.along([system.start()] * 4)
    states.q[:, :, 2] = system.pack(turned[:, None], 1)[:, :, 0]
    found = system.depths(np.zeros(4), states, some)
    assert found.shape == (4, 2, 10)
    beyond = np.stack([-GAP - turned, turned - GAP], axis=1)  # the lower stop is the first
    np.testing.assert_allclose(found[:, :, some], beyond[:, :, some], rtol=0, atol=1e-12)
