"""Measured histories: what is read, and what is refused with its line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from scipy.signal import lfilter

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.design import fitting
from pgmp_petsc.design.fitting import autocorrelation, read_history, remembered
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.texts.studies import report_of_fit

OUTPUTS = OutputSet((), {"angle": "rad", "bend": "m"}, 3, 3, {"angle": None, "bend": None})
DURATION = 1.0


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "measured.csv"
    path.write_bytes(text.encode("utf-8"))
    return path


def test_columns_are_read_by_their_names(tmp_path: Path) -> None:
    path = written(tmp_path, "\ufeffbend, time,  load\n1e-3, 0.0, 7\n\n2e-3, 0.5, x\n3e-3, 1.0, 9\n")
    found = read_history(path, OUTPUTS, DURATION)
    np.testing.assert_array_equal(found.time, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(found.outputs["bend"], [1e-3, 2e-3, 3e-3])
    assert list(found.outputs) == ["bend"]
    assert [remark.text for remark in found.remarks] == [f"columns of '{path}' that are no outputs have no part: load"]


def test_tables_of_this_program_are_read(tmp_path: Path) -> None:
    """They have units behind their names."""
    found = read_history(written(tmp_path, "time (s),angle (rad),bend(m),x (y)\n0,1,2,3\n"), OUTPUTS, DURATION)
    assert (list(found.time), {name: list(own) for name, own in found.outputs.items()}) == (
        [0.0],
        {"angle": [1.0], "bend": [2.0]},
    )
    assert found.remarks[0].text.endswith("have no part: x (y)")


def test_sensors_may_measure_at_instants_of_their_own(tmp_path: Path) -> None:
    found = read_history(written(tmp_path, "time,angle,bend\n0,1,\n0.5,,2e-3\n1.0,3,NaN\n"), OUTPUTS, DURATION)
    np.testing.assert_array_equal(found.time, [0.0, 0.5, 1.0])
    for name, times, values in (("angle", [0.0, 1.0], [1.0, 3.0]), ("bend", [0.5], [2e-3])):
        np.testing.assert_array_equal(found.of(name), [times, values])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "there is no column 'time' (s) in its first line; it has none at all"),
        ("t,angle\n0,1\n", "there is no column 'time' (s) in its first line; known: angle, t"),
        ("time,angel\n0,1\n", "none of its columns is an output of the scene; known: angle, bend"),
        ("time,angle,angle\n0,1,2\n", "2 columns are called 'angle'; one is needed"),
        ("time (ms),angle\n0,1\n", "the column 'time (ms)' has to be in s: convert it, and name it 'time'"),
        ("time,bend (mm)\n0,1\n", "the column 'bend (mm)' has to be in m: convert it, and name it 'bend'"),
        ("time,angle,angle (rad)\n0,1,2\n", "2 columns are called 'angle'; one is needed"),
        ("time;angle\n0,0;1\n", "columns are separated by semicolons ('time;angle'); commas are needed, and points"),
        ("time\tangle\n0\t1\n", "columns are separated by tabs ('time angle'); commas are needed"),
        ("time,angle\n", "there are no measurements in it, only a first line of names"),
        ("time,angle\n0,1\n0.1\n", "line 3 has 1 entries; the first line names 2 columns"),
        ("time,angle\n0,1\n0.1,x\n", "line 3: angle = 'x'; a finite number is needed"),
        ("time,angle\n0,1\n,2\n", "line 3: time = nothing; a finite number is needed, of a magnitude up to 1e+30"),
        ("time,angle\n0,inf\n", "of a magnitude up to 1e+30 (or nothing, for a gap)"),
        ("time,angle,bend\n0,1,\n1,2,nan\n", "the column 'bend' has no measurement at all; leave it out"),
        ("time,angle\n0,1e300\n", "line 2: angle = '1e300'; a finite number is needed, of a magnitude up to 1e+30"),
        ("time,angle\nnan,0\n", "line 2: time = 'nan'; a finite number is needed"),
        ("time,angle\n0,1\n0.2,1\n0.2,1\n", "line 4: time = 0.2 s comes after 0.2 s; times must increase"),
        ("time,angle\n0.5,1\n1.5,1\n", "line 3: time = 1.5 s is not in the run, [0, 1] s; give a longer one"),
        ("time,angle\n-0.5,1\n", "line 2: time = -0.5 s is not in the run"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_history(written(tmp_path, text), OUTPUTS, DURATION)
    assert message in str(caught.value) and "measured.csv" in str(caught.value)


def test_a_large_file_is_read_at_once_and_its_faults_line_by_line(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(fitting, "LARGE", 0)
    slowly: list[str] = []
    one_by_one = fitting._number
    monkeypatch.setattr(fitting, "_number", lambda *a: slowly.append(a[0]) or one_by_one(*a))
    path = written(tmp_path, "\ufeffbend, time (s),  load\n1e-3, 0.0, 7\n\n2e-3, 0.5, 8\n")
    found = read_history(path, OUTPUTS, DURATION)
    np.testing.assert_array_equal(found.time, [0.0, 0.5])
    np.testing.assert_array_equal(found.outputs["bend"], [1e-3, 2e-3])
    assert not slowly
    for rows, message in (
        ("0,1\n0.1,x\n", "line 3: angle = 'x'"),
        ("0,1\n0.1\n", "line 3 has 1 entries"),
        ("0,1,2\n0.1,3,4\n", "line 2 has 3 entries"),
        ("0,inf\n", "line 2: angle = 'inf'"),
        ("0,1\n0.2,1\n0.2,1\n", "line 4: time = 0.2 s comes after"),
        ("0.5,1\n1.5,1\n", "line 3: time = 1.5 s is not in the run"),
        ("", "there are no measurements in it"),
    ):
        with pytest.raises(InputError, match="measured.csv") as caught:
            read_history(written(tmp_path, f"time,angle\n{rows}"), OUTPUTS, DURATION)
        assert message in str(caught.value)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="measured history .* cannot be read: .*No such file"):
        read_history(tmp_path / "none.csv", OUTPUTS, DURATION)
    (tmp_path / "binary.csv").write_bytes(b"time,angle\n\xff\xfe\n")
    with pytest.raises(InputError, match="is no text in UTF-8; take a CSV file"):
        read_history(tmp_path / "binary.csv", OUTPUTS, DURATION)


def test_what_is_left_of_a_vibration_is_no_noise() -> None:
    """Measured seldom, it is little like itself at the next measurement, or its opposite, and more at later ones."""
    turns = np.arange(80)
    assert remembered(np.cos(0.1 * turns))[0] == 1
    lag, correlation = remembered(np.cos(np.pi * turns))
    assert lag == 1 and correlation == pytest.approx(-79 / 80)
    lag, correlation = remembered(np.cos(0.5 * np.pi * turns + 0.3))
    assert lag == 2 and correlation == pytest.approx(-78 / 80)


def test_noise_is_taken_for_noise() -> None:
    random = np.random.default_rng(4)
    for n in (5, 20, 80, 1000):
        # at most 1 in 200 by chance, of the next one alone (deviation 1 / sqrt(n)) 1 in 80 at 20
        found = [remembered(random.normal(size=n))[0] for _ in range(200)]
        assert np.count_nonzero(found) <= (40 if n == 5 else 8 if n == 20 else 3), n
    assert remembered(np.zeros(50)) == (0, 0.0) and remembered(np.ones(3)) == (0, 0.0)


def test_correlated_noise_is_described_by_its_correlations_and_independent_noise_by_none() -> None:
    random, n = np.random.default_rng(6), 20_000
    noise = random.normal(size=n)
    np.testing.assert_array_equal(autocorrelation(noise), [1.0])
    np.testing.assert_array_equal(autocorrelation(np.zeros(50)), [1.0])
    np.testing.assert_array_equal(autocorrelation(np.ones(5)), [1.0])
    found = autocorrelation(lfilter([1.0], [1.0, -0.4], noise))
    # each is known to 1 / sqrt(n) = 0.007
    np.testing.assert_allclose(found[:4], 0.4 ** np.arange(4), atol=0.03)
    assert 10 < found.size < 40
    averaged = autocorrelation(noise[1:] + noise[:-1])  # which is no autoregression
    np.testing.assert_allclose(averaged[:3], [1.0, 0.5, 0.0], atol=0.03)


def test_a_fit_says_how_often_an_output_has_gaps() -> None:
    fit = synthetic.fitted()
    assert report_of_fit(fit, Path("fit.h5")).splitlines()[0].endswith("crank_angle, slider_deformation, 20 runs")
    bend = fit.outputs["slider_deformation"]
    gaps = replace(bend, measured=np.where(np.arange(bend.measured.size) < 2, np.nan, bend.measured))
    fit = replace(fit, outputs=fit.outputs | {"slider_deformation": gaps})
    first = report_of_fit(fit, Path("fit.h5")).splitlines()[0]
    assert first.endswith("20 runs; not measured there: slider_deformation 2")
