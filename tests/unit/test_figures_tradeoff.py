"""Pictures of a trade-off study: every setting is where its numbers say, and nothing overlaps the edge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from matplotlib.figure import Figure
from test_figures import assert_inside, legend_texts, visible

from pgmp_petsc.figures.collection import draw
from pgmp_petsc.figures.tradeoff import mesh_costs, online_costs, total_costs
from pgmp_petsc.results import Tradeoff


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
    everything = legend_texts(online_costs(synthetic.tradeoff()))
    assert everything == [
        "the scene as it is", "reduced", "static modes", "full order", "more cells", "response surface (runs)",
        "best for the time",
    ]
    study = synthetic.tradeoff(surfaces=False, refined=False)
    second = np.arange(len(study.families)) == 1
    keys = legend_texts(online_costs(replace(study, columns=study.columns | {"second_order": second})))
    assert "second order" in keys and "response surface (runs)" not in keys and "more cells" not in keys


def test_what_is_below_the_references_own_error_is_shaded() -> None:
    study = synthetic.tradeoff()
    moved = np.array([[1e-9, 0.01], [1.0, 1.0]])
    figure = online_costs(replace(study, references=replace(study.references, moved=moved)))
    assert "reference not settled" in legend_texts(figure)
    assert [len(axes.patches) for axes in visible(figure)] == [0, 1]


def test_processor_times_are_called_so() -> None:
    busy = replace(synthetic.tradeoff(), waiting=3.0)
    assert visible(online_costs(busy))[0].get_xlabel().startswith("processor time of a sample")


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
        replace(synthetic.tradeoff(), errors=np.full((11, 2), np.nan)),
        replace(synthetic.tradeoff(), errors=np.zeros((11, 2))),
    ],
    ids=["one output", "all failed", "no errors"],
)
def test_little_to_draw_is_drawn(study: Tradeoff) -> None:
    for picture in (online_costs, total_costs, mesh_costs):
        assert_inside(picture(study))


def test_studies_are_drawn_one_by_one(tmp_path: Path) -> None:
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for path in paths:
        synthetic.tradeoff().write(path)
    assert draw(paths[:1], tmp_path / "one") == [
        str(tmp_path / "one" / f"tradeoff{suffix}.png") for suffix in ("", "_total", "_mesh")
    ]
    assert [Path(line).name for line in draw(paths, tmp_path / "two")][::3] == ["tradeoff_1.png", "tradeoff_2.png"]
