"""Estimated errors in words: shares of an output's largest value, and outputs that are smaller than their errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic

from pgmp_petsc.estimates.own_error import large_errors, not_estimated
from pgmp_petsc.results import EstimatedErrors, Trajectory
from pgmp_petsc.texts.models import of_trajectory
from scenes import slider_crank


@pytest.mark.parametrize(
    "largest, line, warned",
    [
        (0.5, "0.001 m (0.2 % of its largest value)", ""),
        (0.0201, "1 mm (5 % of its largest value)", ""),
        (0.0199, "1 mm (5 % of its largest value)", "tip 5 %"),
        (0.00125, "1 mm (80 % of its largest value)", "tip 80 %"),
        (4e-5, "1 mm (its largest value is 0.04 mm)", "tip more than all of it (40 µm)"),
        (0.0, "1 mm", ""),
    ],
)
def test_a_share_is_told_where_it_says_something(largest: float, line: str, warned: str) -> None:
    errors = EstimatedErrors(np.array([0.0, 1.0]), {"tip": np.array([0.0, -1e-3])}, {"tip": largest})
    assert of_trajectory(errors, {"tip": "m"}, 1.0)[1].endswith(line)
    remarks = large_errors(*errors.of_one_run(), {"tip": "m"})
    assert bool(remarks) == bool(warned)
    assert all(warned in remark.text for remark in remarks)
    assert any("has not converged" in remark.text for remark in remarks) == ("more than all" in warned)


def test_an_ensemble_tells_the_worst_of_its_samples_and_how_many_are_so() -> None:
    """Samples that are not checked, and outputs that are known to 5 %, are not told."""
    errors = {"tip": np.array([0.06, 0.01, np.nan, 0.4]), "angle": np.array([0.05, 0.01, np.nan, 0.02])}
    sizes = {name: np.array([1.0, 1.0, 1.0, 2.0]) for name in errors}
    (remark,) = large_errors(errors, sizes, dict.fromkeys(errors, "1"))
    assert remark.kind == "warning" and "errors of the samples that are checked, as shares" in remark.text
    assert "over the run: tip 20 % at most, beyond 5 % in 2 of 3; a smaller simulation.step" in remark.text
    assert not large_errors({"tip": np.full(4, np.nan)}, sizes, {})


def test_an_output_without_an_estimate_says_why(tmp_path: Path) -> None:
    """In the terminal, among the remarks and in the file."""
    reason, time = "two estimates disagree", np.array([0.0, 1.0])
    outputs = {"tip": np.full(2, np.nan), "angle": np.zeros(2)}
    errors = EstimatedErrors(time, outputs, {"tip": 1.0, "angle": 1.0}, absent={"tip": reason})
    line, other = of_trajectory(errors, {"tip": "m", "angle": "rad"}, 1.0)[1:]
    assert line.endswith(f"not estimated: {reason}") and reason not in other
    (remark,) = not_estimated(errors, slider_crank())
    assert "errors were not estimated for tip: two estimates disagree; " in remark.text
    run, absent = synthetic.trajectory("reduced", n_frames=0), {"slider_position": reason}
    replace(run, errors=replace(run.errors, absent=absent)).write(tmp_path / "run.h5")
    assert Trajectory.read(tmp_path / "run.h5").errors.absent == absent
