"""Texts on single runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import synthetic

from pgmp_petsc.texts.models import of_ensemble, report_of_run


def test_what_is_round_off_beside_the_mechanism_is_zero() -> None:
    """Bodies are 0.3 m long; a deformation of 1e-16 m is none, and what is not known is not zero."""
    run = synthetic.trajectory()
    small = run.outputs | {"slider_deformation": np.full(run.time.size, 1e-16)}
    text = report_of_run(replace(run, outputs=small), Path("run.h5"))
    (line,) = [line for line in text.splitlines()[1:] if "slider_deformation" in line]
    assert line.split() == ["slider_deformation", "0", "m", "0", "at", "0", "s"]
    unknown = run.outputs | {"slider_deformation": np.full(run.time.size, np.nan)}
    (line,) = [
        line for line in report_of_run(replace(run, outputs=unknown), Path("run.h5")).splitlines() if "nan" in line
    ]
    assert line.split() == ["slider_deformation", "nan", "m"]


def test_the_largest_value_is_beside_that_at_the_end() -> None:
    run = synthetic.trajectory()
    force = -3.0e4 * np.exp(-(((run.time - 0.4) / 0.01) ** 2))
    run = replace(run, outputs={"bearing": force}, units={"bearing": "N"})
    head, line = report_of_run(run, Path("run.h5")).splitlines()[1:3]
    assert head.split("  ")[-1].strip() == "largest by size" and line.endswith(" -30 at 0.4 s") and " kN " in line


def test_errors_beyond_what_samples_end_with_have_a_unit_of_their_own_size() -> None:
    """A force whose samples all end near zero: its errors over the run are no 400000 uN."""
    many, name = synthetic.ensemble("reduced"), "slider_deformation"
    statistics = {name: replace(many.statistics[name], quantiles=many.statistics[name].quantiles * 0 + 1e-6)}
    errors = {name: np.full(len(many.status), 0.4)}
    many = replace(many, units=many.units | {name: "N"}, statistics=statistics, errors=errors, validity={})
    (line,) = of_ensemble(many)[1:]
    assert line.split() == [name, "400", "400", "mN"]
