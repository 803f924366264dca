"""Which settings are measured: lines and a tensor, each setting once; the best by closed examples; who does what."""

from dataclasses import replace

import numpy as np
import pytest
from runs import PAPER_SCENE, paper_scene

from pgmp_petsc.bench.candidates import (
    FULL,
    Limits,
    best_settings,
    columns_of,
    first_settings,
    own_setting,
    settings_around,
)
from pgmp_petsc.bench.cases import Setting, step_of
from pgmp_petsc.bench.tradeoff import Dealer, Prices, tasks_of
from pgmp_petsc.scene import load_scene, scene_from_toml
from pgmp_petsc.scene.numerics import Reduction, count_steps

LIMITS = Limits(n_modes=28, n_static=1, n_terms=3)
PRICES = Prices(full=4e-6, components=6e-5, reference=4e-6, timed=4.0)


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
    settings = [
        *first_settings(paper_scene(), FULL, of_cells),
        *settings_around([own], paper_scene(), FULL, of_cells),
    ]
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


@pytest.mark.parametrize("n_ranks", [1, 2, 3, 100])
def test_every_task_is_dealt_once(n_ranks: int) -> None:
    scene = paper_scene()
    settings = first_settings(scene, FULL, LIMITS)
    runs = [Setting("reference", 16000), Setting("reference", 32000)]
    dealer = Dealer(n_ranks, PRICES, 128, 3)
    dealt = dealer.deal(tasks_of([*runs, *settings]))
    works = [work for tasks in dealt for task in tasks for work in task]
    assert len(works) == len(set(works)) == len(settings) + 2
    assert set(works) == {*settings, *runs}
    # settings that share a build are together, also in a later round
    home = {task[0].build: rank for rank, tasks in enumerate(dealt) for task in tasks}
    again = dealer.deal(tasks_of([replace(own_setting(scene), n_steps=8000)]))
    assert [len(tasks) for tasks in again].index(1) == home[own_setting(scene).build]


def test_ranks_have_about_as_much_to_do() -> None:
    dealer = Dealer(2, PRICES, 128, 3)
    dealt = dealer.deal(tasks_of(first_settings(paper_scene(), FULL, LIMITS)))
    one, other = (sum(dealer.seconds(task) for task in tasks) for tasks in dealt)
    assert 0.8 < one / other < 1.25
