"""Which settings are measured, at which test values and nodes, and how fine the reference has to be."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT
from runs import PAPER_SCENE, paper_scene
from scipy import stats

from pgmp_petsc.bench.history import (
    History,
    ResponseSurface,
    Setting,
    box,
    held_out,
    largest_errors,
    node_values,
    quantiles,
    step_of,
)
from pgmp_petsc.bench.prices import Limits
from pgmp_petsc.bench.reference import ReferenceSequence
from pgmp_petsc.bench.tradeoff import (
    FULL,
    best_settings,
    columns_of,
    first_settings,
    node_counts,
    own_setting,
    settings_around,
    tasks_of,
)
from pgmp_petsc.scene import load_scene, scene_from_toml
from pgmp_petsc.scene.numerics import Reduction, count_steps
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.stepping.status import Status
from scenes import slider_crank as scene

LIMITS = Limits(n_modes=28, n_static=1, n_terms=3)


def varied(settings: list[Setting], around: Setting) -> dict[str, set]:
    """Return the values of every entry of the settings that differ from one in that entry alone."""
    values: dict[str, set] = {}
    for setting in settings:
        if setting.family != "reduced":
            continue
        mine, theirs = setting.reduction.model_dump(), around.reduction.model_dump()
        mine |= {"n_steps": setting.n_steps, "refinement": setting.refinement}
        theirs |= {"n_steps": around.n_steps, "refinement": around.refinement}
        different = [key for key in mine if mine[key] != theirs[key]]
        if len(different) == 1:
            values.setdefault(different[0], set()).add(mine[different[0]])
    return values


def test_meshes_that_are_not_cut_and_terms_that_are_not_there_are_not_asked_for() -> None:
    of_cells = Limits(28, 1, 3, second_order=False, refinable=False)
    own = own_setting(paper_scene())
    settings = [*first_settings(paper_scene(), FULL, of_cells), *settings_around([own], paper_scene(), FULL, of_cells)]
    assert {setting.refinement for setting in settings} == {1}
    assert not any(setting.reduction.second_order for setting in settings if setting.reduction)


def test_without_uncertain_parameters_there_is_no_surface_and_without_loads_no_static_mode() -> None:
    certain = paper_scene("parameters.r1={nominal=5.6e-3}")
    assert not [setting for setting in first_settings(certain, FULL, LIMITS) if setting.family == "surface"]
    settings = first_settings(paper_scene("effects={}"), FULL, Limits(28, 0, 3))
    assert not [setting for setting in settings if setting.reduction and setting.reduction.static_modes]


@pytest.mark.parametrize(("duration", "n"), [(1.0, 1000), (1.0, 3), (0.3, 7), (2.0, 1), (0.123456, 100003)])
def test_a_step_gives_its_number_of_steps(duration: float, n: int) -> None:
    assert count_steps(duration, step_of(duration, n)) == n
    assert step_of(1.0, 2000) == 5e-4 and step_of(1.0, 1) == 1.0
    odd = paper_scene("simulation.duration=0.45", "simulation.step=1e-2")  # a coarser one divides the duration
    steps = {setting.n_steps for setting in first_settings(odd, FULL, LIMITS) if setting.family == "full"}
    assert steps == {45, 90, 180}


def test_steps_that_are_compared_have_samplings_at_their_ends() -> None:
    """Every 2 ms, with steps of 1 ms: of 4 ms some would be missed."""
    settings = first_settings(load_scene(ROOT / "scenes" / "servo_arm.toml", (), ()), FULL, LIMITS)
    assert {setting.n_steps for setting in settings if setting.family == "full"} == {500, 1000, 2000, 4000}


def test_no_more_modes_than_the_mesh_has() -> None:
    settings = first_settings(paper_scene(), FULL, Limits(5, 1, 3))
    lines = settings_around([own_setting(paper_scene())], paper_scene(), FULL, Limits(5, 1, 3))
    asked = {setting.reduction.modes for setting in (*settings, *lines) if setting.reduction}
    assert asked == {2, 3, 4, 5, 8, 15, 22}, "the scene's own number and its line are tried, and fail with a reason"


def test_adaptive_sampling_stays_and_its_tolerance_is_swept() -> None:
    spline = 'reduction.interpolation="spline"'
    adaptive = paper_scene(spline, "reduction.sampling_tolerance=1e-4", "reduction.angles=24")
    own = own_setting(adaptive)
    settings = first_settings(adaptive, FULL, LIMITS)
    assert varied(settings, own)["sampling_tolerance"] == {1e-3, 1e-5}
    reduced = [setting.reduction for setting in settings if setting.reduction]
    assert {each.interpolation for each in reduced} == {"spline"} and {each.angles for each in reduced} == {24}


def test_overrides_turn_the_scene_into_the_setting() -> None:
    scene = paper_scene()
    better = own_setting(scene).with_reduction(modes=7, static_modes=True, interpolation="spline")
    setting = replace(better, n_steps=2000)
    overrides = setting.overrides(scene)
    wanted = ["reduction.modes=7", "reduction.static_modes=true", 'reduction.interpolation="spline"']
    assert overrides == [*wanted, "simulation.step=0.0005"]
    changed = load_scene(PAPER_SCENE, overrides)
    assert own_setting(changed) == setting
    assert own_setting(scene).overrides(scene) == Setting("surface", 1000, nodes=3).overrides(scene) == []
    components = Setting("components", 2000, component_modes=10), Setting("components", 1000, component_modes=15)
    assert components[0].overrides(scene) == ["reduction.modes=10", "simulation.step=0.0005"]
    assert components[1].overrides(scene) == []


def test_what_a_tolerance_leaves_open_is_given() -> None:
    text = PAPER_SCENE.read_text().replace("modes = 15 ", "tolerance = 0.01 #").replace("angles = 629", "# angles")
    open_scene = scene_from_toml(text, PAPER_SCENE.parent, ("simulation.tolerance=0.01",))
    overrides = own_setting(open_scene).with_reduction(modes=3).overrides(open_scene)
    assert "reduction.modes=3" in overrides and "reduction.angles=629" in overrides
    assert not [override for override in overrides if "tolerance" in override or "step" in override]


def test_columns_have_no_gaps() -> None:
    scene = paper_scene()
    settings = [own_setting(scene), Setting("full", 500, 2), Setting("surface", 1000, nodes=5)]
    columns = columns_of(settings, scene)
    assert set(columns) == {"step", "refinement", "nodes", "component_modes", *Reduction.model_fields}
    np.testing.assert_array_equal(columns["step"], [1e-3, 2e-3, 1e-3])
    np.testing.assert_array_equal(columns["modes"], [15, 0, 0])
    np.testing.assert_array_equal(columns["static_modes"], [False, False, False])
    assert columns["interpolation"].tolist() == ["overhauser", "", ""]
    np.testing.assert_array_equal(columns["sampling_tolerance"], [0.0, 0.0, 0.0])


def reduced(n_steps: int, angles: int = 48) -> Setting:
    return Setting("reduced", n_steps, reduction=Reduction(angles=angles))


def test_the_best_is_cheap_among_those_as_good_as_any() -> None:
    slow, fast, poor, wrong = reduced(1000), reduced(500), reduced(250), reduced(100)
    settings = [slow, fast, poor, wrong, Setting("full", 10), replace(slow, refinement=2), reduced(20)]
    errors = [0.0010, 0.0014, 0.008, 0.5, 1e-9, 1e-9, float("nan")]
    assert best_settings(settings, errors, [8] * 7) == [fast, poor]


def test_fewer_coordinates_and_then_fewer_angles_are_cheaper() -> None:
    many, few, fewest = reduced(1000, 96), reduced(1000, 48), reduced(1000, 24)
    assert best_settings([many, few, fewest], [1e-3, 1e-3, 1e-3], [5, 5, 8]) == [few]
    assert best_settings([reduced(10), Setting("full", 10)], [float("nan"), 0.1], [0, 36]) == []


def test_every_setting_is_in_one_task_and_long_ones_come_first() -> None:
    scene = paper_scene()
    settings = first_settings(scene, FULL, LIMITS)
    runs = [Setting("reference", 16000), Setting("reference", 32000)]
    tasks = tasks_of([*settings, *runs])
    assert sorted(map(repr, (one for task in tasks for one in task))) == sorted(map(repr, [*settings, *runs]))
    assert tasks[:2] == [(runs[1],), (runs[0],)], "runs of the reference are apart"
    builds = [task[0].build for task in tasks[2:]]
    assert len(builds) == len(set(builds)) and all(one.build == task[0].build for task in tasks for one in task)


NORMAL = 'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=0.56e-3}'
DENSITY = 'parameters.rho={nominal=7800.0, distribution={name="uniform", loc=7700.0, scale=200.0}}'
LAW = stats.norm(5.6e-3, 0.56e-3)


def test_without_distributions_there_is_the_value_of_the_run() -> None:
    assert held_out(scene())[0] == {"r1": np.array([5.6e-3])}
    assert uncertain_names(scene()) == [] and node_counts(0, 4) == []
    no_parameters = scene("parameters={}", "bodies.crank.section.radius=5e-3")
    assert held_out(no_parameters)[0] == {}
    assert (node_counts(1, 4), node_counts(3, 3)) == ([3, 5, 9, 17], [7, 14, 28])
    wide = scene('parameters.r1.distribution={name="norm", loc=5.6e-3, scale=5.6e-3}')
    assert quantiles(wide, np.array([[0.001], [0.01]])).min() > 0.0


def test_one_parameter_takes_quantiles_at_equal_distances() -> None:
    values = held_out(scene(NORMAL))[0]["r1"]
    np.testing.assert_allclose(LAW.cdf(values), np.linspace(0.01, 0.99, 8), rtol=1e-9)
    nodes = node_values(scene(NORMAL), 5)[:, 0]
    np.testing.assert_allclose(nodes, np.linspace(LAW.ppf(0.001), LAW.ppf(0.999), 5), rtol=1e-9)


@pytest.mark.parametrize("n", node_counts(1, 4))
def test_test_values_are_no_nodes(n: int) -> None:
    nodes, values = node_values(scene(NORMAL), n)[:, 0], held_out(scene(NORMAL))[0]["r1"]
    assert np.min(np.abs(nodes[:, None] - values)) > 1e-3 * np.ptp(nodes) / n


def test_bounds_cut_the_distribution_off() -> None:
    values = held_out(scene(NORMAL, "parameters.r1.bounds=[5.6e-3, 7.0e-3]"))[0]["r1"]
    assert values.min() > 5.6e-3 and values.max() < 7.0e-3
    share = (LAW.cdf(values) - 0.5) / (LAW.cdf(7.0e-3) - 0.5)
    np.testing.assert_allclose(share, np.linspace(0.01, 0.99, 8), rtol=1e-9)


def test_several_parameters_fill_a_latin_hypercube() -> None:
    both = scene(NORMAL, DENSITY, 'materials.steel.rho="rho"')
    values = held_out(both)[0]
    for name, law in (("r1", LAW), ("rho", stats.uniform(7700.0, 200.0))):
        np.testing.assert_allclose(np.sort(law.cdf(values[name])), np.linspace(0.01, 0.99, 8), rtol=1e-6)
    assert not np.array_equal(np.argsort(values["r1"]), np.argsort(values["rho"]))
    nodes, (low, high) = node_values(both, 20), box(both)
    assert nodes.shape == (20, 2) and (nodes >= low).all() and (nodes <= high).all()
    np.testing.assert_array_equal(node_values(both, 20), nodes)


@pytest.mark.parametrize(("n", "degree"), [(3, 2), (5, 3), (9, 3)])
def test_one_parameter_is_exact_on_polynomials(n: int, degree: int) -> None:
    coefficients = np.array([[1.0, -2.0, 0.5, 3.0], [0.0, 1.0, -1.0, 2.0]])[:, : degree + 1]

    def exact(x: np.ndarray) -> dict[str, np.ndarray]:
        powers = np.array([(1e3 * x) ** k for k in range(degree + 1)])
        return {"a": coefficients @ powers, "b": -coefficients @ powers}

    nodes, points = np.linspace(4e-3, 7e-3, n), np.array([4.1e-3, 5.5e-3, 6.999e-3])
    found = ResponseSurface(nodes[:, None], exact(nodes)).evaluate(points[:, None])
    for name, values in exact(points).items():
        # nodes of some 1e2 in a cubic of a few 1e2: round-off only
        np.testing.assert_allclose(found[name], values, rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize(("n", "degree"), [(5, 1), (10, 2), (20, 2)])
def test_several_parameters_are_exact_on_polynomials(n: int, degree: int) -> None:
    random = np.random.default_rng(3)
    nodes, points = random.uniform([1.0, 7700.0], [2.0, 7900.0], (n, 2)), np.array([[1.5, 7800.0], [1.2, 7850.0]])

    def exact(x: np.ndarray) -> dict[str, np.ndarray]:
        u, v = x[:, 0], (x[:, 1] - 7800.0) / 100.0
        linear = 1.0 + 2.0 * u - v
        return {"a": np.array([linear, linear + (u * v + v**2 if degree == 2 else 0.0)])}

    found = ResponseSurface(nodes, exact(nodes)).evaluate(points)
    np.testing.assert_allclose(found["a"], exact(points)["a"], rtol=1e-9)
    with pytest.raises(ValueError, match="at least 4"):
        ResponseSurface(np.eye(3)[:, :2], {"a": np.zeros((1, 3))})


def test_where_a_run_has_no_number_the_surface_has_none() -> None:
    nodes = np.linspace(0.0, 1.0, 5)
    outputs = {"a": np.array([nodes, np.where(nodes > 0.9, np.nan, nodes)]), "b": np.array([nodes**2, nodes**3])}
    found = ResponseSurface(nodes[:, None], outputs).evaluate(np.array([[0.3], [0.6]]))
    np.testing.assert_allclose(found["a"], [[0.3, 0.6], [np.nan, np.nan]], rtol=1e-12)
    np.testing.assert_allclose(found["b"], [[0.09, 0.36], [0.027, 0.216]], rtol=1e-12)


N = 10
FLOORS = np.array([1e-10])


def run(n_steps: int, order: float = 2.0, constant: float = 1.0) -> History:
    """Return a run whose error is ``constant / n^order`` of the largest value."""
    values = np.linspace(0.0, 1.0, N + 1)[None, :, None] * (1.0 + constant / n_steps**order)
    # kept at the same instants, whatever the number of steps
    return History(N, 1, values, np.array([Status.FINE]), np.ones(1, dtype=bool), np.full(1, np.nan))


def errors(found: History, exact: History) -> np.ndarray:
    return largest_errors(found, exact, FLOORS)


def refine(sequence: ReferenceSequence, settings: list[History], **law: float) -> int:
    """Do what the sequence asks for; return the number of rounds."""

    def smallest() -> np.ndarray:
        return np.min([errors(each, sequence.history) for each in settings], axis=0)

    rounds = 0
    while wanted := sequence.wanted(smallest() if sequence.usable else np.array([np.inf])):
        rounds += 1
        for n_steps in wanted:
            sequence.add(n_steps, run(n_steps, **law))
    return rounds


def test_an_eighth_of_the_finest_step_settles_at_once() -> None:
    sequence = ReferenceSequence(4 * 20, 10**6, FLOORS)
    assert refine(sequence, [run(10), run(20)]) == 1
    smallest = errors(run(20), sequence.history)
    assert sequence.n_steps == 8 * 20
    # 3/64 of the error at the eighth of a step: less than a tenth
    np.testing.assert_allclose(sequence.moved / smallest, [3 / 63], rtol=1e-2)
    assert sequence.settled(smallest) and "moved no output by 0.1 of" in sequence.reason(smallest)


def test_a_setting_that_is_better_asks_for_a_finer_reference() -> None:
    sequence = ReferenceSequence(40, 10**6, FLOORS)
    assert refine(sequence, [run(10), run(200)]) == 3, "two to begin with, then three at once, then one"
    assert sequence.n_steps == 16 * 80
    assert sequence.settled(errors(run(200), sequence.history))


def test_it_stops_at_the_finest_step_that_is_allowed() -> None:
    sequence = ReferenceSequence(40, 160, FLOORS)
    refine(sequence, [run(200)])
    assert sequence.n_steps == 160 and ReferenceSequence(40, 10, FLOORS).wanted(np.array([np.inf])) == [40, 80]
    smallest = errors(run(200), sequence.history)
    assert not sequence.settled(smallest)
    assert sequence.reason(smallest) == "the finest step that is allowed"


def begun(most: int, constant: float = 1.0) -> ReferenceSequence:
    sequence = ReferenceSequence(40, most, FLOORS)
    for n_steps in (40, 80):
        sequence.add(n_steps, run(n_steps, constant=constant))
    return sequence


def test_it_stops_where_a_run_fails_and_is_no_reference_without_two() -> None:
    sequence, smallest = begun(10**6), np.array([1e-9])
    assert sequence.wanted(smallest)
    sequence.failure = "no convergence"
    assert sequence.wanted(smallest) == [] and sequence.usable
    assert sequence.reason(smallest) == "a finer run failed: no convergence"
    none = ReferenceSequence(40, 160, FLOORS)
    none.failure = "no convergence"
    assert not none.usable and none.wanted(np.array([np.inf])) == []


@pytest.mark.parametrize(
    ("smallest", "most", "constant", "wanted"),
    [
        (np.inf, 10**6, 1.0, []),  # an output without any error is settled
        (np.nan, 10**6, 1.0, []),
        (0.0, 10**6, 1e-13, []),  # round-off is no move
        (0.0, 640, 1.0, [160, 320, 640]),  # an error of zero goes to the limit
    ],
)
def test_what_is_still_wanted(smallest: float, most: int, constant: float, wanted: list[int]) -> None:
    assert begun(most, constant).wanted(np.array([smallest])) == wanted
