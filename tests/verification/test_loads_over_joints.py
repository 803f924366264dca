"""Loads over the angle or the way of their joint: against an integration of scipy's, the work over a turn, in C."""

from pathlib import Path

import numpy as np
import pytest
from exported import assert_equal, compiled, needs_compiler, outputs_of, simulated
from machine_scenes import MODELS, RIGID, CartAndPole, cart, rail, run
from mpi4py import MPI
from refusals import cases, check_said
from runs import full_model, reduced_model
from scipy.integrate import cumulative_trapezoid

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.effects.over_joint import table_law
from pgmp_petsc.studies.simulate import simulate_full
from scenes import slider_crank

ROWS = ((-3.0, 0.3), (-2.0, -0.2), (-1.0, 0.4), (0.0, 0.0), (0.1, 0.5))
WAY = ((-0.1, 2.0), (0.0, 0.0), (0.02, -3.0))
LOADS = (
    f'effects.motor={{type="torque",joint="pivot",over="pivot",table={[list(row) for row in ROWS]}}}',
    f'effects.push={{type="force",joint="rail",over="rail",table={[list(row) for row in WAY]},scale="factor"}}',
    "parameters.factor={nominal=2.0}", "simulation.initial.x.velocity=0.3",
)  # fmt: skip


def test_the_law_of_a_table() -> None:
    """Linear between rows, constant beyond; one over a turn goes on for ever."""
    law, h = table_law(ROWS, False), 1e-6
    for s in np.linspace(-4.0, 1.0, 41) + 1e-3:
        found = law.evaluate([2.0], s, 0.3)
        assert found.force == pytest.approx(2.0 * np.interp(s, *zip(*ROWS)), abs=1e-14)
        slope = np.diff(np.interp([s - h, s + h], *zip(*ROWS)))[0] / (2 * h)
        assert found.stiffness == pytest.approx(-2.0 * slope, abs=1e-8) and found.damping == 0.0
    turn = ((0.5, 1.0), (2.0, -1.0), (0.5 + 2.0 * np.pi, 1.0))
    law = table_law(turn, True)
    for s in np.linspace(0.5, 0.5 + 2.0 * np.pi, 31)[:-1] + 1e-3:
        for turns in (-3, 0, 5):
            found = law.evaluate([1.0], s + 2.0 * np.pi * turns)
            assert found.force == pytest.approx(np.interp(s, *zip(*turn)), abs=1e-12)


def test_loads_over_joints_move_a_cart_and_a_pole() -> None:
    times, found = run(cart(*RIGID, *LOADS, "simulation.step=5e-4"), "full")
    exact = CartAndPole().motion(
        times, (0.0, 0.0, 0.3, 0.0), lambda t, x, phi, v, w: 2.0 * float(np.interp(x, *zip(*WAY))),
        lambda t, x, phi, v, w: float(np.interp(phi, *zip(*ROWS))),
    )  # fmt: skip
    for name, values in zip(("x", "swing"), exact):
        np.testing.assert_allclose(found[name], values, rtol=0, atol=2e-5 * np.abs(values).max())


def test_loads_over_joints_in_every_model() -> None:
    (_, full), (_, components), (_, reduced) = (run(cart(*LOADS), model) for model in MODELS)
    for name, share in (("x", 1e-4), ("swing", 1e-4), ("bent", 0.02)):
        largest = np.abs(full[name]).max()
        np.testing.assert_allclose(reduced[name], full[name], rtol=0, atol=share * largest, err_msg=name)
        np.testing.assert_allclose(components[name], full[name], rtol=0, atol=share * largest, err_msg=name)


def test_the_work_of_a_torque_over_turns_of_a_crank() -> None:
    """An engine's torque: the energy after each turn has grown by the area under the table."""
    turn = 2.0 * np.pi
    scene = slider_crank(
        f'effects={{engine={{type="torque",joint="crank_hinge",over="crank_hinge",table=[[0.0,0.0],[1.0,3.0],[2.0,0.0],[{turn!r},0.0]]}}}}',
        "bodies.crank.flexible=false", "bodies.rod.flexible=false", "simulation.initial.theta.velocity=40.0",
        "simulation.duration=0.5", "simulation.step=5e-4", 'outputs.angle={type="angle",joint="crank_hinge"}',
    )  # fmt: skip
    found = simulate_full(full_model(scene), MPI.COMM_SELF)
    angle, kinetic = found.outputs["angle"], found.balance.kinetic
    grid = np.linspace(0.0, angle[-1], 100_001)
    area = cumulative_trapezoid(np.interp(grid % turn, [0.0, 1.0, 2.0], [0.0, 3.0, 0.0]), grid, initial=0.0)
    assert angle[-1] > 2.0 * turn
    # (w h)^2 / 12 of the energy, with accelerations by the crank 20 times as fast as it
    np.testing.assert_allclose(kinetic - kinetic[0], np.interp(angle, grid, area), rtol=0, atol=1e-2)


@needs_compiler
def test_loads_over_joints_in_c(tmp_path: Path) -> None:
    model = reduced_model(cart(*LOADS))
    assert_equal(outputs_of(compiled(model, tmp_path)), simulated(model).outputs)


REFUSED = """
effects.e={type="torque",joint="pivot",over="rail",table=[[0,1],[1,2]]} -> \
    effects.e.over = "rail": a load hangs on the joint that it acts on, which is pivot
effects.e={type="force",point="pole:tip",direction=[1,0],over="rail",table=[[0,1]]} -> \
    effects.e.over = "rail": a load hangs on the joint that it acts on, which is none here
effects.e={type="torque",joint="pivot",over="pivot",harmonic={amplitude=1,frequency_hz=1}} -> \
    effects.e.over = "pivot": needs a table; a harmonic is over time
effects.e={type="torque",joint="pivot",over="pivot",table=[[0,1],[6.283185307179586,2]]} -> \
    effects.e.table: is over a whole turn, and its ends differ; it has to close
effects.e={type="torque",joint="pivot",over="pivot",table=[[1,1],[0,2]]} -> effects.e.table
"""


@pytest.mark.parametrize(("override", "said"), cases(REFUSED))
def test_what_hangs_on_nothing_is_explained(override: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        cart(override)
    check_said(str(caught.value), said, override)


def test_a_parameter_in_a_row_is_a_load_of_its_own() -> None:
    named = 'effects.push={type="force",joint="rail",over="rail",table=[[-0.1,"one"],[0.0,0.0],[0.1,-4.0]]}'
    plain = 'effects.push={type="force",joint="rail",over="rail",table=[[-0.1,3.0],[0.0,0.0],[0.1,-4.0]]}'
    moving = "simulation.initial.x.velocity=-0.4", "simulation.duration=0.1"
    for model in ("full", "reduced"):
        (_, one), (_, other) = (
            run(rail(*own, *moving), model) for own in ((named, "parameters.one={nominal=3.0}"), (plain,))
        )
        np.testing.assert_allclose(one["x"], other["x"], rtol=0, atol=1e-9)
