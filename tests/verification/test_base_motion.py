"""A base that moves: against a cart that is driven, closed forms, and an integration of scipy's."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from exported import assert_same_in_c, needs_compiler
from machine_scenes import MODELS, RAIL_MASS, cart, rail, run
from refusals import cases, check_said, refusal
from runs import assert_close, motion, reduced_model, trajectory
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from test_formulas import LAWS, START

from pgmp_petsc.effects.motion import GIVEN, BaseMotion, acceleration_of
from pgmp_petsc.scene import scene_from_toml
from scenes import HEADER, tables

WAVE = "harmonic={amplitude=0.05,frequency_hz=3.0}"
BASE = 'effects.base={{type="base_motion",direction=[1.0,0.0],of="displacement",{}}}'
DRIVEN = 'effects.base={{type="prescribed_motion",coordinate="x",{}}}'
HELD = 'effects.held={type="prescribed_motion",coordinate="x",table=[[0.0,0.0],[1.0,0.0]]}'
TIP = tuple(
    f'outputs.{name}={{{{type="{kind}",point="pole:tip",axis="x",absolute={{0}}}}}}'
    for name, kind in (("place", "position"), ("moved", "displacement"), ("v", "speed"))
)
AWAY = "harmonic={amplitude=0.05,frequency_hz=3.0,phase=1.5707963267948966}"
ROWS = "table=[[0.0,0.0],[0.1,0.02],[0.2,-0.03],[0.3,0.0],[0.5,0.05]]"


@pytest.mark.parametrize(("model", "moved"), [*((model, WAVE) for model in MODELS), ("full", ROWS), ("full", AWAY)])
def test_a_shaken_base_is_a_driven_cart(model: str, moved: str) -> None:
    """A pole that hangs from a cart which is moved, and the same seen from the cart, which stays: the start of both is
    at rest against the cart."""
    _, driven = run(cart(DRIVEN.format(moved), *(one.format("false") for one in TIP)), model)
    found = motion(model, cart(HELD, BASE.format(moved), *(one.format("true") for one in TIP)))
    shaken, balance = found.outputs, found.balance
    # inertia forces between the instants of a step are those of the motion, or its second derivative: h^2 of both
    # a speed has what swings fast in the deformation, and its frequency times as much of it
    assert_close(driven, shaken, swing=1e-4, bent=5e-3, place=2e-4, moved=2e-4, v=5e-3)
    assert np.ptp(driven["swing"]) > 0.1
    if moved == WAVE:  # what the base works is what moves and is bent: 5e-5 and less, as the square of the step
        assert np.abs(balance.residual).max() < 2e-4 * balance.exchanged
        assert np.ptp(balance.work["base"]) > 0.1 * balance.exchanged


@pytest.mark.parametrize("model", MODELS)
def test_an_oscillator_on_a_base_that_is_accelerated(model: str) -> None:
    """x = -a m / k (1 - cos w t), half as much where the scale says so."""
    scene = rail(
        'effects.held={type="spring_damper",joint="rail",stiffness=400.0}', "parameters.half={nominal=0.5}",
        'effects.base={type="base_motion",direction=[0.0,2.0,0.0],table=[[0.0,3.0]],scale="half"}',
        "materials.steel.E=2e13", "simulation.step=5e-4", "simulation.duration=0.2",
    )  # fmt: skip
    times, found = run(scene, model)
    exact = -1.5 * RAIL_MASS / 400.0 * (1.0 - np.cos(np.sqrt(400.0 / RAIL_MASS) * times))
    np.testing.assert_allclose(found["x"], exact, rtol=0, atol=3e-4 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("table", "moved", "said"), [("[[0.0,3.0]]", 3.0, True), ("[[0.0,0.0],[0.1,0.0]]", 0.0, False)]
)
def test_an_equilibrium_on_a_base_that_is_accelerated_is_said(table: str, moved: float, said: bool) -> None:
    """x = -a m / k from the start on."""
    scene = rail(
        'effects.held={type="spring_damper",joint="rail",stiffness=400.0}', "materials.steel.E=2e13",
        f'effects.base={{type="base_motion",direction=[0.0,2.0,0.0],table={table}}}', "simulation.duration=0.02",
        "initial.equilibrium=true", 'initial.coordinates="free"',
    )  # fmt: skip
    found = trajectory("full", scene)
    np.testing.assert_allclose(found.outputs["x"], -moved * RAIL_MASS / 400.0, rtol=1e-6, atol=1e-12)
    assert said == any("the base's acceleration at time zero too" in one.text for one in found.record.remarks)


ALONG_A_SLIDE = HEADER + tables("""
bodies.arm: line = { length = 0.5, elements = 8 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.02, height = 0.004 }
joints.rail: type = "prismatic"; connect = ["ground:origin", "arm:hinge"]; axis = [1.0, 0.0]
coordinates.x: joint = "rail"; range = [-0.2, 0.2]
effects.weight: type = "gravity"
reduction: modes = 3; angles = 12; static_modes = true; inertia_modes = true; second_order = true
simulation: duration = 0.2; step = 2e-4
outputs.tip: type = "deformation"; point = "arm:tip"; axis = "y"
outputs.torque: type = "joint_torque"; joint = "rail"
""")
SHAKE = 'effects.shake={{type="{}",harmonic={{amplitude=0.005,frequency_hz=23.7}}}}'
SHAKEN = {
    "slide": (SHAKE.format('prescribed_motion",coordinate="x'),),
    "base": (SHAKE.format('base_motion",direction=[1.0,0.0],of="displacement'),
             'effects.held={type="prescribed_motion",coordinate="x",table=[[0.0,0.0],[1.0,0.0]]}'),
}  # fmt: skip


@pytest.mark.parametrize("way", SHAKEN)
def test_an_arm_along_a_slide_that_is_shaken(way: str, tmp_path: Path) -> None:
    """Its weight bends it, and 11 g along it change its stiffness by a twelfth: a motion that is prescribed and a base
    that moves do the same."""
    expected = motion("full", scene_from_toml(ALONG_A_SLIDE, ".", SHAKEN[way])).outputs
    model = reduced_model(scene_from_toml(ALONG_A_SLIDE, ".", SHAKEN[way]))
    found = motion(model)
    for name, share in (("tip", 5e-4), ("torque", 0.012)):  # the weight sets in at once, which few modes follow
        assert np.abs(found.outputs[name] - expected[name]).max() < share * np.abs(expected[name]).max(), name
    energy, work = found.balance.kinetic + found.balance.strain, sum(found.balance.work.values())
    assert np.abs(energy - energy[0] - work).max() < 1e-3 * energy.max()
    without = ("reduction.second_order=false",)
    first = trajectory("reduced", scene_from_toml(ALONG_A_SLIDE, ".", [*SHAKEN[way], *without]))
    off = np.abs(first.outputs["tip"] - expected["tip"]).max()
    assert off > 0.05 * np.abs(expected["tip"]).max() and off / 3.0 < first.errors.maximum("tip") < 3.0 * off
    if way == "slide":
        assert_same_in_c(model, tmp_path)


ALONG = np.array([0.6, 0.8, 0.0])


@pytest.mark.parametrize("model", MODELS)
def test_where_an_oscillator_on_a_shaken_base_is(model: str) -> None:
    """From rest against a base that goes along x(t) = a sin(p t + f), across the rail too: y'' + w^2 y = -x'' along it.
    Parameters of the scale and of the wave."""
    amplitude, rate, phase = -0.02, 2.0 * np.pi * 3.0, 0.4
    outputs = [
        f'outputs.{name}_{axis}={{type="{kind}",point="arm:hinge",axis="{axis}",absolute=true}}'
        for name, kind in (("place", "position"), ("moved", "displacement"), ("v", "speed"))
        for axis in "xyz"
    ]
    scene = rail(
        'effects.held={type="spring_damper",joint="rail",stiffness=400.0}', *outputs, "parameters.a={nominal=0.5}",
        f'effects.base={{type="base_motion",direction={(5 * ALONG).tolist()},scale="a",harmonic={{frequency_hz=3.0,'
        f"amplitude={-2.0 * amplitude * rate**2},phase={phase}}}}}",
        "materials.steel.E=2e13", "simulation.step=5e-4", "simulation.duration=0.2",
    )  # fmt: skip
    times, found = run(scene, model)
    w, x = np.sqrt(400.0 / RAIL_MASS), (0.0, amplitude * np.sin(rate * times + phase))
    v = amplitude * rate * np.cos(rate * times + phase)
    push = ALONG[1] * amplitude * rate**2 / (w**2 - rate**2)  # y = push sin(p t + f) and what starts it from rest
    c, s = -push * np.sin(phase), -push * rate * np.cos(phase) / w
    y = push * np.sin(rate * times + phase) + c * np.cos(w * times) + s * np.sin(w * times)
    dy = push * rate * np.cos(rate * times + phase) - c * w * np.sin(w * times) + s * w * np.cos(w * times)
    for k, axis in enumerate("xyz"):
        place, speed = ALONG[k] * x[1] + (k == 1) * y, ALONG[k] * v + (k == 1) * dy
        start = ALONG[k] * amplitude * np.sin(phase)
        # second order of the scheme
        for name, exact in (("place", place), ("moved", place - start), ("v", speed)):
            np.testing.assert_allclose(found[f"{name}_{axis}"], exact, rtol=0, atol=3e-4 * max(np.ptp(exact), 1e-6))
        assert abs(found[f"place_{axis}"][0] - start) < 1e-12


@pytest.mark.parametrize("of", GIVEN)
def test_what_is_given_is_integrated(of: str) -> None:
    """The same base for a wave of any kind; tables as scipy integrates them, from rest in the origin at time zero."""
    entry = {"type": "base_motion", "direction": (1.0, 0.0), "of": of}
    times, rate, order = np.linspace(0.0, 1.4, 29), 2.0 * np.pi * 2.0, GIVEN[of][0]
    wave = {"amplitude": 0.1 * rate ** (2 - order), "frequency_hz": 2.0, "phase": 0.3 + 0.5 * np.pi * (2 - order)}
    mean = {2: 0.7, 1: 0.7 * times, 0: 0.35 * times**2}[order]
    found = BaseMotion(**entry, harmonic={**wave, "mean": 0.7}).course().jet(times, 0)[0]
    np.testing.assert_allclose(found, 0.1 * np.sin(rate * times + 0.3) + mean, rtol=0, atol=1e-14)

    rows = [(-0.3, 1.0), (0.2, -2.0), (0.25, 3.0), (0.7, 0.5), (1.0, 2.0)]
    table = BaseMotion(**entry, table=rows)
    x, v, a = table.course().jet(times, 2)
    np.testing.assert_allclose(a, acceleration_of(table)(times), rtol=0, atol=1e-12 * np.abs(a).max())
    if order == 0:  # linear between its rows, constant beyond

        def rates(t: float, y: np.ndarray) -> list[float]:
            return [y[1], np.interp(t, *np.transpose(rows))]

        wanted, spans = np.zeros((2, times.size)), [0.0, 0.2, 0.25, 0.7, 1.0, 1.4]
        y = np.zeros(2)
        for begin, end in pairwise(spans):
            inside = (times >= begin) & (times <= end)
            done = solve_ivp(rates, (begin, end), y, "DOP853", dense_output=True, rtol=1e-12, atol=1e-14)
            wanted[:, inside], y = done.sol(times[inside]), done.y[:, -1]
    else:
        spline = CubicSpline(*np.transpose(rows), bc_type="clamped")
        inside, after = np.minimum(times, 1.0), np.maximum(times - 1.0, 0.0)
        wanted = (spline(inside), spline(inside, 1)) if order == 2 else None
        if order == 1:
            whole = spline.antiderivative()
            wanted = whole(inside) - whole(0.0) + after * rows[-1][1], spline(inside)
    # relative 1e-12 of the integrator
    np.testing.assert_allclose([x, v], wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())


@pytest.mark.parametrize("of", GIVEN)
def test_what_is_given_is_differentiated(of: str) -> None:
    """A wave of displacements, of its velocities and of its accelerations; splines of many rows come near to it."""
    times, rate = np.linspace(0.05, 0.45, 60), 2.0 * np.pi * 2.0
    exact = -0.1 * rate**2 * np.sin(rate * times + 0.3)
    order = 2 - GIVEN[of][0]
    amplitude, phase = 0.1 * rate**order, 0.3 + 0.5 * np.pi * order
    entry = {"type": "base_motion", "direction": (1.0, 0.0), "of": of}
    wave = BaseMotion(**entry, harmonic={"amplitude": amplitude, "frequency_hz": 2.0, "phase": phase})
    np.testing.assert_allclose(acceleration_of(wave)(times), exact, rtol=0, atol=1e-12 * np.abs(exact).max())
    at = np.linspace(-1.0, 1.0, 801)
    table = BaseMotion(**entry, table=tuple(zip(at, amplitude * np.sin(rate * at + phase))))
    np.testing.assert_allclose(acceleration_of(table)(times), exact, rtol=0, atol=1e-3 * np.abs(exact).max())


@needs_compiler
@pytest.mark.usefixtures("short_tables")
def test_a_shaken_model_in_c(tmp_path: Path) -> None:
    """Velocities in a table, which are differentiated for the motion and integrated for places; a base that begins
    elsewhere; and formulas."""
    table = BASE.format(ROWS).replace("displacement", "velocity")
    away = BASE.format(AWAY).replace("effects.base", "effects.away").replace("[1.0,0.0]", "[0.0,1.0]")
    scene = cart(table, away, "reduction.angles=6", *(one.format("true") for one in TIP), *START, *LAWS)
    assert_same_in_c(reduced_model(scene), tmp_path)


REFUSED = """
effects.e={type="base_motion",table=[[0,1]]} -> effects.e.direction: missing; needed: direction (x, y)
effects.e={type="base_motion",direction=[1,0,0],table=[[0,1]]} -> \
    effects.e.direction = [1.0, 0.0, 0.0]: two numbers (x, y) are needed in the plane
effects.e={type="base_motion",direction=[0,0],table=[[0,1]]} -> effects.e.direction = [0, 0]: a direction other than
effects.e={type="base_motion",direction=[1,0]} -> effects.e.table: exactly one of table, harmonic is needed
effects.e={type="base_motion",direction=[1,0],of="jerk",table=[[0,1]]} -> effects.e.of = "jerk": unknown
effects.e={type="base_motion",direction=[1,0],of="velocity",table=[[0,1]]} -> \
    effects.e.table = [[0, 1]]: a motion needs at least two rows
effects.e={type="base_motion",direction=[1,0],of="velocity",harmonic={amplitude=1,frequency_hz=500}} -> \
    effects.e.harmonic.frequency_hz = 500.0: needs a simulation.step of at most
outputs.o={type="position",point="pole:tip",axis="x",absolute=1} -> outputs.o.absolute = 1: true or false
outputs.o={type="speed",joint="rail",absolute=true} -> outputs.o.absolute = true: a joint's speed is that of one body
outputs.o={type="deformation",point="pole:tip",axis="x",absolute=true} -> outputs.o.absolute = true: unknown key
effects.e={type="base_motion",direction=[1,0],table=[[0.1001,0],[0.1002,9],[0.1003,0]]} -> \
    effects.e.table: has an impulse of 0.0009 m/s2 s, but 0 with a base_motion read every 0.001 s
"""


@pytest.mark.parametrize(("override", "said"), cases(REFUSED))
def test_what_no_base_does_is_explained(override: str, said: str) -> None:
    check_said(refusal(cart, override), said, override)
