"""Estimated errors in words: shares of an output's largest value, and outputs that are smaller than their errors."""

import numpy as np
import pytest

from pgmp_petsc.cli.estimates import of_trajectory
from pgmp_petsc.indicator.coverage import large_errors
from pgmp_petsc.results import EstimatedErrors


@pytest.mark.parametrize(
    "largest, line, warned",
    [
        (0.5, "0.001 m (0.2 % of its largest value)", ""),
        (0.00125, "0.001 m (80 % of its largest value)", "tip 80 %"),
        (4e-17, "0.001 m (its largest value is 4e-17 m)", "tip more than all of it (4e-17)"),
        (0.0, "0.001 m", ""),
    ],
)
def test_a_share_is_told_where_it_says_something(largest: float, line: str, warned: str) -> None:
    errors = EstimatedErrors(np.array([0.0, 1.0]), {"tip": np.array([0.0, -1e-3])}, {"tip": largest})
    assert of_trajectory(errors, {"tip": "m"}, 1.0)[1].endswith(line)
    remarks = large_errors(errors)
    assert bool(remarks) == bool(warned)
    assert all(warned in remark.text for remark in remarks)
