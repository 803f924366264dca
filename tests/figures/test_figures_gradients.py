"""Pictures of sensitivities, fits and designs: what is drawn is what the data say, and nothing overlaps the edge."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from pictures import assert_inside, legend_texts, visible
from sealed import resealed

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures.collection import draw_result
from pgmp_petsc.figures.trajectories import design, fit, sensitivities
from pgmp_petsc.results import Derivatives
from pgmp_petsc.results.gradients import DEVIATION
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
