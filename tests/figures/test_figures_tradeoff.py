"""Pictures of a trade-off study: every setting is where its numbers say, and nothing overlaps the edge."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pictures import assert_inside, keys_of, legend_texts, looks, visible, written

from pgmp_petsc.figures.collection import draw
from pgmp_petsc.figures.tradeoff import mesh_costs, online_costs, total_costs
from pgmp_petsc.results import Tradeoff
from pgmp_petsc.results.tradeoff import MeshErrors

# what numpy and matplotlib warn of is a picture that is not right
pytestmark = pytest.mark.filterwarnings("error:::pgmp_petsc", "error::RuntimeWarning")


NO_MESHES = MeshErrors(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, 2)))


def points(figure: Figure, column: int = 0) -> set[tuple[float, float]]:
    """Return the positions of single points in a panel, rounded."""
    lines = (line for line in visible(figure)[column].lines if line.get_linestyle() == "None")
    return {(round(float(x), 9), round(float(y), 9)) for line in lines for x, y in zip(*line.get_data())}


def expected(study: Tradeoff, cost: np.ndarray, column: int) -> set[tuple[float, float]]:
    refined = (study.columns["refinement"] > 1) & np.array([family == "reduced" for family in study.families])
    shown = np.isfinite(study.errors[:, column]) & ~refined
    return {(round(x, 9), round(y, 9)) for x, y in zip(cost[shown], 100 * study.errors[shown, column])}


@pytest.mark.parametrize("column", [0, 1])
def test_online_costs_are_those_of_a_sample_in_a_batch(column: int) -> None:
    study = synthetic.tradeoff()
    figure = online_costs(study)
    assert points(figure, column) == expected(study, 1e3 * study.times.batch, column)
    assert visible(figure)[column].get_xlabel() == "time of a sample, 128 together (ms)"
    assert_inside(figure)


def test_total_costs_count_the_build() -> None:
    study = replace(synthetic.tradeoff(), samples=250)
    figure = total_costs(study)
    assert points(figure, 1) == expected(study, study.total_seconds(250), 1)
    assert visible(figure)[0].get_xlabel() == "time of 250 samples, build included (s)"
    assert_inside(figure)


def test_keys_name_what_is_there() -> None:
    everything = legend_texts(online_costs(synthetic.tradeoff(components=True)))
    assert everything == [
        "the scene as it is", "reduced", "static modes", "component modes", "full order", "full order, more cells",
        "response surface (runs)", "best for the time, reduced", "best for the time, component modes",
        "best for the time, full order", "error of the mesh itself",
    ]  # fmt: skip
    study = synthetic.tradeoff(surfaces=False, refined=False)
    second = np.arange(len(study.families)) == 1
    keys = legend_texts(online_costs(replace(study, columns=study.columns | {"second_order": second})))
    assert "second order, static modes" in keys and "static modes" in keys
    assert "response surface (runs)" not in keys and "full order, more cells" not in keys


def second_order(study: Tradeoff) -> Tradeoff:
    """Return a study in which the scene itself failed, and every setting with static modes is of second order."""
    errors = study.errors.copy()
    errors[0] = np.nan
    return replace(study, errors=errors, columns=study.columns | {"second_order": study.columns["static_modes"]})


@pytest.mark.parametrize("picture", [online_costs, total_costs])
@pytest.mark.parametrize(
    "study",
    [
        synthetic.tradeoff(),
        synthetic.tradeoff(components=True),
        synthetic.tradeoff(surfaces=False, refined=False),
        second_order(synthetic.tradeoff()),
        replace(synthetic.tradeoff(), errors=np.full((11, 2), np.nan)),
    ],
    ids=["all kinds", "component modes", "few kinds", "second order", "all failed"],
)
def test_every_mark_has_a_key_and_every_key_a_mark(study: Tradeoff, picture: Callable[[Tradeoff], Figure]) -> None:
    figure = picture(study)
    keys = [key for key in keys_of(figure) if isinstance(key, Line2D)]
    drawn = [line for axes in visible(figure) for line in axes.lines]
    # points and the lines between them are two artists in the panels, one in the keys
    marks = {(colour, marker, face) for colour, _, marker, face in looks(drawn) if marker != "None"}
    assert marks == {(colour, marker, face) for colour, _, marker, face in looks(keys) if marker != "None"}
    lines = {(colour, line) for colour, line, *_ in looks(line for line in drawn if len(line.get_xdata()) > 1)}
    assert lines == {(colour, line) for colour, line, *_ in looks(keys) if line != "None"}


def test_what_is_below_the_references_own_error_is_shaded() -> None:
    study = synthetic.tradeoff()
    moved = np.array([[1e-9, 0.01], [1.0, 1.0]])
    figure = online_costs(replace(study, references=replace(study.references, moved=moved)))
    assert "reference not settled" in legend_texts(figure)
    assert [len(axes.patches) for axes in visible(figure)] == [0, 1]
    busy = visible(online_costs(replace(study, waiting=3.0)))[0]
    assert busy.get_xlabel().startswith("processor time of a sample")


def test_meshes_have_errors_and_times() -> None:
    study = synthetic.tradeoff()
    errors, costs = visible(mesh_costs(study))
    np.testing.assert_allclose(errors.lines[0].get_data(), [[10, 20], [2e-3, 5e-4]])
    np.testing.assert_allclose(costs.lines[0].get_data(), [[10, 20], [5.0, 8.0]], err_msg="full order, in a batch")
    np.testing.assert_allclose(costs.lines[2].get_data(), [[10, 20], [2.0, 2.0]], err_msg="the same reduced setting")
    assert_inside(mesh_costs(study))


@pytest.mark.parametrize(
    "study",
    [
        synthetic.tradeoff(n_outputs=1, surfaces=False, refined=False),
        replace(synthetic.tradeoff(refined=False), mesh=NO_MESHES),
        replace(synthetic.tradeoff(), errors=np.full((11, 2), np.nan)),
        replace(synthetic.tradeoff(), errors=np.zeros((11, 2))),
    ],
    ids=["one output", "no meshes", "all failed", "no errors"],
)
def test_little_to_draw_is_drawn(study: Tradeoff) -> None:
    for picture in (online_costs, total_costs, mesh_costs):
        assert_inside(picture(study))


def test_studies_are_drawn_one_by_one(tmp_path: Path, undrawn: None) -> None:
    paths = written(tmp_path, *2 * [synthetic.tradeoff()])
    names = ["tradeoff.png", "tradeoff_total.png", "tradeoff_mesh.png"]
    assert draw(paths[:1], tmp_path / "one") == [str(tmp_path / "one" / name) for name in names]
    assert [Path(line).name for line in draw(paths, tmp_path / "two")][::3] == ["tradeoff_1.png", "tradeoff_2.png"]
