"""A base that moves: against a cart that is driven, closed forms, and an integration of scipy's."""

from pathlib import Path

import numpy as np
import pytest
from exported import assert_same_in_c, needs_compiler
from machine_scenes import MODELS, RAIL_MASS, cart, rail, run
from refusals import cases, check_said
from runs import reduced_model

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.effects.base_motion import GIVEN, BaseMotion, acceleration_of

WAVE = "harmonic={amplitude=0.05,frequency_hz=3.0}"
BASE = 'effects.base={{type="base_motion",direction=[1.0,0.0],of="displacement",{}}}'
DRIVEN = 'effects.base={{type="prescribed_motion",coordinate="x",{}}}'
HELD = 'effects.held={type="prescribed_motion",coordinate="x",table=[[0.0,0.0],[1.0,0.0]]}'
ROWS = "table=[[0.0,0.0],[0.1,0.02],[0.2,-0.03],[0.3,0.0],[0.5,0.05]]"


@pytest.mark.parametrize("motion", [WAVE, ROWS], ids=["harmonic", "table"])
@pytest.mark.parametrize("model", MODELS)
def test_a_shaken_base_is_a_driven_cart(model: str, motion: str) -> None:
    """A pole that hangs from a cart which is moved, and the same seen from the cart, which stays: the start of both is
    at rest against the cart."""
    _, driven = run(cart(DRIVEN.format(motion)), model)
    _, shaken = run(cart(HELD, BASE.format(motion)), model)
    # inertia forces between the instants of a step are those of the motion, or its second derivative: h^2 of both
    for name, share in (("swing", 1e-4), ("bent", 5e-3)):
        largest = np.abs(driven[name]).max()
        np.testing.assert_allclose(shaken[name], driven[name], rtol=0, atol=share * largest, err_msg=name)
    assert np.ptp(driven["swing"]) > 0.1


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
def test_a_shaken_model_in_c(tmp_path: Path) -> None:
    model = reduced_model(cart(BASE.format(ROWS)))
    assert_same_in_c(model, tmp_path)


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
effects.e={type="base_motion",direction=[1,0],table=[[0.1001,0],[0.1002,9],[0.1003,0]]} -> \
    effects.e.table: has an impulse of 0.0009 m/s2 s, but 0 with a base_motion read every 0.001 s
"""


@pytest.mark.parametrize(("override", "said"), cases(REFUSED))
def test_what_no_base_does_is_explained(override: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        cart(override)
    check_said(str(caught.value), said, override)
