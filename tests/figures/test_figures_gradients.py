"""Pictures of sensitivities, fits, designs and trade-offs: drawn is what the data say, and nothing overlaps the edge."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pictures import assert_inside, keys_of, legend_texts, looks, visible, written
from sealed import resealed

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures.collection import draw, draw_result
from pgmp_petsc.figures.tradeoff import mesh_costs, online_costs, total_costs
from pgmp_petsc.figures.trajectories import design, fit, sensitivities
from pgmp_petsc.results import Derivatives, Tradeoff
from pgmp_petsc.results.gradients import DEVIATION
from pgmp_petsc.results.tradeoff import MeshErrors
from pgmp_petsc.texts.studies import design_lines, lines_of

pytestmark = pytest.mark.filterwarnings("error:::pgmp_petsc", "error::RuntimeWarning")


def test_sensitivities_show_outputs_and_changes() -> None:
    figure = sensitivities(synthetic.derivatives())
    assert len(visible(figure)) == 4
    assert legend_texts(figure) == ["r1 + 0.56 mm, one standard deviation", "c + 0.0002, 1 % of its value"]
    np.testing.assert_allclose(visible(figure)[1].lines[0].get_ydata(), -300.0 * synthetic.INSTANTS * 0.56e-3)
    assert_inside(figure)


def test_a_fit_shows_what_was_measured_and_what_is_left() -> None:
    figure = fit(synthetic.fitted())
    assert len(visible(figure)) == 4
    assert "fitted, r1 = 6.001 ± 0.005 mm, c = 0.03, not identifiable" in legend_texts(figure)
    np.testing.assert_allclose(visible(figure)[1].lines[0].get_ydata(), 1.0, rtol=1e-9)  # mrad
    assert_inside(figure)


def test_a_design_shows_its_search_and_both_ends() -> None:
    figure = design(synthetic.designed())
    assert len(visible(figure)) == 3
    assert legend_texts(figure) == ["at the start, r1 = 5.6 mm", "design, r1 = 6.2 mm"]
    np.testing.assert_array_equal(visible(figure)[0].lines[0].get_ydata(), [1e-4, 4e-5, 5e-5])
    assert_inside(figure)


def test_a_result_is_drawn_into_a_folder(tmp_path: Path) -> None:
    result = synthetic.designed()
    path = Path(draw_result(result, tmp_path / "pictures"))
    assert path.is_file() and path.parent == tmp_path / "pictures"
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="output directory .* cannot be made"):
        draw_result(result, tmp_path / "file" / "pictures")


def test_derivatives_come_back_from_a_file(tmp_path: Path) -> None:
    one = synthetic.derivatives()
    one.write(tmp_path / "s.h5")
    again = Derivatives.read(tmp_path / "s.h5")
    assert (again.parameters, again.changes, again.units) == (one.parameters, one.changes, one.units)
    np.testing.assert_array_equal(again.derivatives["crank_angle"]["r1"], one.derivatives["crank_angle"]["r1"])
    largest = list(again.figures("slider_deformation"))[1]
    assert largest.time == synthetic.INSTANTS[np.argmax(synthetic.BEND)]
    # a sine's, with itself for derivative, of which the instants miss 8e-4
    assert largest.derivatives[0] == pytest.approx(1e-4, rel=1e-5)


def test_units_of_derivatives_are_written_as_fractions() -> None:
    one = synthetic.derivatives()
    units = one.units | {"r1": "N m/rad"}
    other = Derivatives(one.record, one.time, one.outputs, one.derivatives, units, one.changes, one.correlation)
    assert (one.unit("crank_angle", "r1"), one.unit("crank_angle", "c")) == ("rad/m", "rad")
    assert other.unit("crank_angle", "r1") == "rad/(N m/rad)"


def test_the_deviation_of_a_figure_is_that_of_all_distributions_together() -> None:
    one = synthetic.derivatives()
    both = {"r1": (0.56e-3, DEVIATION), "c": (0.1, DEVIATION)}
    effects = np.array([-300.0 * 0.56e-3, 2.0 * 0.1])
    for coefficient in (0.0, 0.5, -0.9):
        correlation = np.array([[1.0, coefficient], [coefficient, 1.0]])
        found = Derivatives(one.record, one.time, one.outputs, one.derivatives, one.units, both, correlation)
        figure = next(found.figures("crank_angle"))
        expected = np.sqrt(np.sum(effects**2) + 2.0 * coefficient * effects.prod())
        assert found.deviation(figure) == pytest.approx(expected, rel=1e-12)
        assert sum("together" in line for line in lines_of(found)) == 6
    assert not any("together" in line for line in lines_of(one))


def test_derivatives_of_nothing_and_of_no_scene_are_damaged(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    synthetic.derivatives().write(path)
    with resealed(path) as file:
        del file["outputs"]
    with pytest.raises(InputError, match="is damaged: '/outputs' is missing; write it again"):
        Derivatives.read(path)
    synthetic.derivatives().write(path)
    with resealed(path) as file:
        file.attrs["scene"] = "[scene"
    with pytest.raises(InputError, match="is damaged: its scene is no TOML: "):
        Derivatives.read(path)


def test_what_is_just_met_is_missed_by_nothing() -> None:
    """Round-off of a constraint at its limit is no figure; a miss is one, and so is room to spare."""
    found = synthetic.designed()
    for value, active, said in (
        (2.082e-17, True, " 0  just met"), (0.1, False, "+0.1  missed"), (-0.05, False, "-0.05  met"),
    ):  # fmt: skip
        constraint = replace(found.constraints[0], value=value, active=active)
        lines = design_lines(replace(found, constraints=(constraint,)))
        (line,) = (line for line in lines if "crank_angle) >=" in line)
        assert said in line


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
