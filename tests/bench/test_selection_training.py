"""Training cases: values at three standard deviations, bounds, corners; loads that differ from the scene's own."""

import numpy as np
import pytest

from pgmp_petsc.bench.cases import HASTE, PULSE, Training, stops_of, training_loads, with_softer_stops
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import spanning_values
from scenes import pendulum, slider_crank

NORMAL = 'parameters.r1={nominal=5.6e-3, distribution={name="norm", loc=5.6e-3, scale=0.56e-3}%s}'
SECOND = 'parameters.E={nominal=2.1e11, distribution={name="uniform", loc=2.0e11, scale=0.2e11}}'
USED = 'materials.steel.E="E"'


def test_a_star_to_three_standard_deviations() -> None:
    values, n = spanning_values(slider_crank(NORMAL % ""))
    assert n == 5
    expected = 5.6e-3 + 0.56e-3 * np.array([0.0, -3.0, -1.5, 1.5, 3.0])
    np.testing.assert_allclose(values["r1"], expected, rtol=1e-4)
    wide = 'parameters.r1={nominal=5.6e-3, distribution={name="norm", loc=5.6e-3, scale=5e-3}}'
    assert spanning_values(slider_crank(wide))[0]["r1"].min() > 0.0
    values, n = spanning_values(slider_crank("parameters.r1={nominal=5.6e-3, value=5.0e-3}"))
    np.testing.assert_array_equal(values["r1"], [5.6e-3, 5.0e-3])  # the value of a run is tried too
    assert n == 2


def test_bounds_cut_the_distribution_as_an_ensemble_does() -> None:
    values, _ = spanning_values(slider_crank(NORMAL % ", bounds=[5.0e-3, 6.0e-3]"))
    assert 5.0e-3 < values["r1"].min() < 5.01e-3 and 5.99e-3 < values["r1"].max() < 6.0e-3


def test_two_parameters_have_corners() -> None:
    values, n = spanning_values(slider_crank(NORMAL % "", SECOND, USED))
    assert n == 1 + 2 * 4 + 4
    pairs = set(zip(values["r1"].round(6), values["E"].round(-9)))
    low, high = values["r1"].min().round(6), values["r1"].max().round(6)
    assert {(r, e) for r in (low, high) for e in (2.0e11, 2.2e11)} <= pairs
    assert (values["r1"][0], values["E"][0]) == (5.6e-3, 2.1e11), "the nominal sample is the first"


def test_of_many_parameters_only_two_corners() -> None:
    many = [f'parameters.p{k}={{nominal=1.0, distribution={{name="uniform", loc=0.9, scale=0.2}}}}' for k in range(4)]
    values, n = spanning_values(slider_crank("parameters.r1={nominal=5.6e-3}", *many))
    assert n == 1 + 4 * 4 + 2
    np.testing.assert_array_equal(values["r1"], 5.6e-3)


def test_bounds_span_a_parameter_without_a_distribution_where_asked_for() -> None:
    bounded = slider_crank("parameters.r1={nominal=5e-3, bounds=[4e-3, 7e-3]}")
    np.testing.assert_array_equal(spanning_values(bounded)[0]["r1"], [5e-3])
    np.testing.assert_allclose(spanning_values(bounded, ["r1"])[0]["r1"], [5e-3, 4e-3, 4.5e-3, 6e-3, 7e-3])
    from_nothing = slider_crank("parameters.r1={nominal=5e-3, bounds=[0.0, 7e-3]}")
    assert spanning_values(from_nothing, ["r1"])[0]["r1"].min() == 5e-4


def test_without_parameters_or_torques_nothing_is_varied_and_that_is_said() -> None:
    training = Training.of(pendulum('effects.weight={type="gravity"}'))
    assert training.n_samples == 1 and training.values == {}
    assert [load.name for load in training.loads] == ["own"]
    assert any("no parameter" in remark for remark in training.remarks)
    assert any("no torque" in remark for remark in training.remarks)
    assert training.sample_text(0) == ""
    training = Training.of(slider_crank(NORMAL % "", 'reference.loads="own"'))
    assert [load.name for load in training.loads] == ["own"] and training.n_samples == 5
    assert any("holds for the scene's own loads alone" in remark for remark in training.remarks)
    assert training.sample_text(1) == "r1 = 0.00392"


def table(scene: Scene) -> np.ndarray:
    return np.array(scene.effects["motor"].table)


def test_loads_are_the_own_a_pulse_and_a_quicker_one() -> None:
    scene = slider_crank(
        "effects.motor.table=[[0.0, 0.0], [0.25, -0.5], [1.0, 0.2]]", "effects.weight={type='gravity'}"
    )
    own, pulse, quick = training_loads(scene)
    np.testing.assert_array_equal(table(own.of(scene)), table(scene))
    np.testing.assert_array_equal(table(own.of(scene, 0.5))[:, 1], 0.5 * table(scene)[:, 1])
    rows = table(pulse.of(scene))
    assert rows[0, 1] == 0.0 and rows[-1] == pytest.approx([scene.simulation.duration, 0.0], abs=1e-12)
    assert rows[:, 1].min() == pytest.approx(-0.5 * PULSE) and np.all(rows[:, 1] <= 1e-12)
    np.testing.assert_array_equal(table(quick.of(scene))[:, 0] * HASTE, table(scene)[:, 0])
    for load in (own, pulse, quick):
        assert load.of(scene).effects["weight"] == scene.effects["weight"]
    assert table(scene)[1, 1] == -0.5, "the scene itself is left alone"


def test_the_step_is_found_with_loads_no_quicker_than_the_own() -> None:
    def of_step(duration: float, rows: str) -> list[str]:
        scene = slider_crank(f"simulation.duration={duration}", f"effects.motor.table={rows}")
        return [load.name for load in training_loads(scene) if load.for_step]

    ramp = "[[0.0, 0.0], [0.25, 0.5], [1.0, 0.5]]"
    assert of_step(1.0, ramp) == ["own", "pulse"]
    assert of_step(0.3, ramp) == ["own"], "a pulse over so short a run rises four times as fast"
    assert of_step(0.3, "[[0.0, 0.5], [1.0, 0.0]]") == ["own", "pulse"], "the own one sets in at once"


def test_a_constant_torque_has_no_quicker_one() -> None:
    scene = slider_crank("effects.motor.table=[[0.0, 0.4]]")
    assert [load.name for load in training_loads(scene)] == ["own", "pulse"]
    none = slider_crank("effects.motor.table=[[0.0, 0.0], [1.0, 0.0]]")
    assert [load.name for load in training_loads(none)] == ["own"]


def test_end_stops_are_made_softer_where_their_stiffness_is_a_number() -> None:
    wall = "effects.%s={type='end_stop', joint='slider', upper=0.99, stiffness=%s}"
    k = "parameters.k={nominal=2e4, unit='N/m'}"
    scene = slider_crank(k, wall % ("wall", "2e4"), wall % ("other", "'k'"))
    assert stops_of(scene) == ["wall"]
    softer = with_softer_stops(scene, 0.1).effects
    assert softer["wall"].stiffness == pytest.approx(2e3) and softer["other"].stiffness == "k"
    assert softer["motor"] == scene.effects["motor"]
