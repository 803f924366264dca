"""Training cases, and what was chosen on them: in the file, in words, and entries of the scene."""

from types import SimpleNamespace

import numpy as np
import pytest

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.cases import HASTE, PULSE, Training, stops_of, training_loads, with_softer_stops
from pgmp_petsc.bench.choice import cost_text, leaves_open, mesh_remark
from pgmp_petsc.bench.ledger import BASIS, INTERPOLATION, STEP, shares_of
from pgmp_petsc.results import Attempt, Selection
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
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


SELECTION = Selection(
    tolerances={"reduction": 1e-2, "simulation": 2e-2},
    allowed={"basis": 3.5e-3, "step": 1e-2},
    chosen={"reduction.modes": 7, "reduction.static_modes": True, "simulation.step": 2e-3},
    reasons={"reduction.modes": "leave 0.002"},
    kept={"reduction.interpolation": "spline"},
    attempts=(
        Attempt("basis", {"modes": 4}, 100, np.array([1e-4, np.inf]), np.inf, "x", 55.0, 0.1, "no convergence"),
        Attempt("basis", {"modes": 7}, 100, np.array([1e-4, 2e-3]), 2e-3, "x, load 'own', r = 1", 99.0, 0.2),
        Attempt("step", {"step": 2e-3}, 500, np.array([1e-5, 3e-3]), 3e-3, "x, load 'own', r = 1"),
    ),
    outputs=("angle", "x"),
    values={"r": np.array([1.0, 2.0])},
    loads={"own": "the scene's own loads"},
    remarks=("no torque acts",),
)


def test_in_words() -> None:
    lines = SELECTION.lines()
    assert lines[0] == "chosen for reduction.tolerance = 0.01 and simulation.tolerance = 0.02"
    for words in (
        "  reduction.modes = 7: leave 0.002",
        "  reduction.static_modes = true",
        '  kept as given: reduction.interpolation = "spline"',
        "    modes = 4: no convergence",
        "    modes = 7: 0.002 (x, load 'own', r = 1)",
        "  trained on r = 1, 2",
        "  no torque acts",
    ):
        assert words in lines
    assert not any("modes = 4" in line for line in SELECTION.lines(attempts=False))


def test_the_parts_share_the_tolerance() -> None:
    assert BASIS + INTERPOLATION == STEP == 0.5
    assert sum(shares_of(True).values()) == pytest.approx(sum(shares_of(False).values()))


@pytest.mark.parametrize("table", ["reduction", "simulation"])
def test_a_tolerance_leaves_a_scene_open(table: str) -> None:
    scene = slider_crank(f"{table}.tolerance=1e-3")
    assert leaves_open(scene) and not leaves_open(slider_crank())
    again = scene_from_toml(scene_to_toml(scene), ".")
    assert getattr(again, table).tolerance == 1e-3
    for value in ("0.0", "1.0", "-1e-3", '"small"'):
        with pytest.raises(InputError, match=rf"{table}\.tolerance"):
            slider_crank(f"{table}.tolerance={value}")


def test_a_step_that_is_still_to_be_chosen_is_not_too_long() -> None:
    assert slider_crank("simulation={duration=1e-4, tolerance=1e-3}").simulation.duration == 1e-4
    with pytest.raises(InputError, match="must not exceed the duration"):
        slider_crank("simulation={duration=1e-4}")
    with pytest.raises(InputError, match="must not exceed the duration"):
        slider_crank("simulation={duration=1e-4, step=1e-3, tolerance=1e-3}")


@pytest.mark.parametrize(("apart", "words"), [(6e-3, "0.006 away from the mesh in x"), (4e-3, "was not measured")])
def test_a_reference_that_is_off_by_more_than_there_is_to_spare_is_named(apart: float, words: str) -> None:
    bench = SimpleNamespace(
        finer_meshes=lambda n_steps: None, reference=SimpleNamespace(from_mesh={"angle": 1e-5, "x": apart}),
        scene=slider_crank("reduction.tolerance=1e-2"),
    )  # fmt: skip
    (said,) = mesh_remark(bench, 100)
    assert words in said


def test_where_a_reduced_sample_is_no_cheaper_the_reduction_is_said_not_to_pay() -> None:
    cheap, dear = (cost_text(reduced, 100, 1e-3, 400, "full-order") for reduced in (2e-4, 9e-4))
    assert cheap == "processor time of a sample: 0.2 ms with 100 steps; of the full-order model 1 ms with 400 steps"
    assert "0.9 ms with 100 steps" in dear and "the reduction does not pay here" in dear and "--full" in dear
