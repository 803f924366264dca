"""Results: files that come back, numbers in words, extremes between instants."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import synthetic
from every_result import LISTINGS, PARTS, RESULTS, listing
from sealed import resealed
from synthetic import assert_same

from pgmp_petsc import results
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.results import Trajectory
from pgmp_petsc.results.gradients import Vertex, is_sharp, vertex
from pgmp_petsc.results.numbers import (
    axis_unit,
    end_texts,
    interval_text,
    number_text,
    one_unit_each,
    plain,
    share_text,
    with_unit,
)  # fmt: skip


@pytest.mark.parametrize("name", RESULTS)
def test_files_are_as_they_were_and_come_back(name: str, tmp_path: Path) -> None:
    """A listing changes only where a file is to change."""
    result = RESULTS[name]()
    result.write(tmp_path / "f.h5")
    assert listing(tmp_path / "f.h5") == (LISTINGS / f"{name}.txt").read_text()
    with type(result).opened(tmp_path / "f.h5") as again:
        assert_same(again, result)


def test_parts_of_reduced_models_are_as_they_were_and_come_back(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        for part in PARTS:
            assert type(part).found_in(file) is None
            part.put(file)
        file.flush()  # readers look at how large the file is
        for part in PARTS:
            assert_same(type(part).found_in(file), part)
    assert listing(tmp_path / "f.h5") == (LISTINGS / "parts.txt").read_text()


@pytest.mark.parametrize(
    "result",
    [
        synthetic.trajectory("reduced", n_frames=0),
        synthetic.ensemble("reduced", 50, n_failed=0),
        synthetic.rare_event(),
        synthetic.tradeoff(n_outputs=1, surfaces=False, refined=False),
    ],
    ids=["without frames", "without failures", "without design points", "short trade-off"],
)
def test_round_trip(result, tmp_path):
    result.write(tmp_path / "f.h5")
    again = type(result).read(tmp_path / "f.h5")
    assert_same(again, result)
    assert not isinstance(result, Trajectory) or list(again.outputs) == list(result.outputs), "the scene's order"


RUN, MANY = synthetic.trajectory(), synthetic.ensemble(n_samples=10)
FRAMES = synthetic.frames(np.linspace(0.0, 1.0, 4))


@pytest.mark.parametrize(
    ("result", "change", "message"),
    [
        (RUN, {"model": "small"}, "model is 'small'; allowed: full, components, reduced"),
        (RUN, {"time": np.zeros((3, 2))}, r"time has shape \(3, 2\); needed: \(time\)"),
        (RUN, {"outputs": {"a": np.zeros(5)}}, r"outputs 'a' has shape \(5,\); needed: \(time: 1001\)"),
        (RUN, {"coordinates": np.zeros(1001)}, r"coordinates has shape"),
        (RUN, {"modal": np.zeros((5, 2))}, r"modal has shape"),
        (FRAMES, {"cells": {}}, "name different bodies"),
        (FRAMES, {"rigid": frozenset({"flywheel"})}, "rigid bodies of frames are none of theirs: flywheel"),
        (FRAMES, {"time": FRAMES.time[:3]}, "positions of 'crank' has shape"),
        (MANY, {"meanings": {0: "fine"}}, r"status \[2\] has no meaning; known: \[0\]"),
        (MANY, {"parameters": {"r1": np.zeros(4)}}, r"outputs 'crank_angle' has shape \(10,\); needed: \(sample: 4\)"),
        (synthetic.statistics(np.arange(9.0)), {"edges": np.zeros(3)}, "edges has shape"),
        (synthetic.modes_table(), {"theta": np.zeros(7)}, "full_hz has shape"),
    ],
)
def test_what_does_not_fit_together_is_refused(result, change, message):
    with pytest.raises(ValueError, match=message):
        replace(result, **change)


def test_results_are_imported_by_their_names_when_they_are_asked_for() -> None:
    for kind, reader in results.READERS.items():
        assert getattr(results, reader.__name__) is reader
        assert reader.kind == kind
    with pytest.raises(AttributeError, match="no attribute 'Trajectories'"):
        _ = results.Trajectories


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("design", "goal", np.zeros(5), r"goal has shape \(5,\); needed: \(2\)"),
        ("rare_event", "curve/probability", np.zeros(5), r"curve/probability has shape \(5,\); needed: \(2\)"),
        ("rare_event", "parameters/r1", np.zeros(5), r"parameters 'r1' has shape \(5,\); needed: \(sample: 6\)"),
        ("ensemble", "outputs/crank_angle", np.zeros(5), r"'crank_angle' has shape \(5,\); needed: \(sample: 12\)"),
        ("ensemble", "corrected/crank_angle/mean_alone_interval", None, "mean_alone_interval' is missing"),
        ("ensemble", "sobol/crank_angle/ST", None, "total Sobol indices and their intervals go together"),
        ("ensemble", "kept/unstable_start", np.zeros(5), r"'unstable_start' has shape \(5,\); needed: \(sample: 12"),
        ("ensemble", "bands/crank_angle/mean", np.zeros(5), r"mean has shape \(5,\); needed: \(time: 21\)"),
        ("trajectory", "fields/bar/points/00001", None, r"deformation has shape \(3, 13, 2\); needed: \(frame: 2"),
        ("trajectory", "fields/bar/at_cells/von_mises", None, "quantities at nodes, in cells and units of a body"),
        ("tradeoff", "settings/angles", None, "/settings lacks angles"),
        ("shard", "columns/status", None, "columns lack 'status'"),
    ],
)
def test_what_does_not_fit_together_is_told(name: str, place: str, value: object, message: str, tmp_path: Path) -> None:
    result, path = RESULTS[name](), tmp_path / "f.h5"
    result.write(path)
    with resealed(path) as file:
        del file[place]
        if value is not None:
            file[place] = value
            file[place].attrs["unit"] = "1"
    with pytest.raises(InputError, match=f"f.h5'.*{message}"), type(result).opened(path):
        pass


INFINITE = np.inf


@pytest.mark.parametrize(
    "value, ends, figure, interval",
    [
        (5.28262, (5.28260, 5.28264), "5.28262", "[5.2826, 5.28264]"),
        (5.2826123, (-INFINITE, 5.2826256), "5.28261", "[-infinite, 5.282626]"),  # to the end that is known
        (5.2826123, (5.2825991, INFINITE), "5.28261", "[5.282599, infinite]"),
        (5.2826123, (-INFINITE, INFINITE), "5.2826", "[too few samples]"),
        (np.nan, (np.nan, np.nan), "unknown", "unknown"),
    ],
)
def test_digits_follow_from_the_width_of_an_interval(value: float, ends: tuple, figure: str, interval: str) -> None:
    assert number_text(value, np.array(ends), 6) == figure
    assert interval_text(np.array(ends), value) == interval
    assert end_texts(np.array([-INFINITE, 5.2826256])) == ["-infinite", "5.2826"]


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(140.0, 2, "140"), (1.2e6, 2, "1200000"), (0.0, 2, "0"), (1.26, 2, "1.3"), (-136.0, 2, "-140"), (3e9, 2, "3e+09"),
     (2e-17, 2, "2e-17"), (0.00012, 2, "0.00012"), (99.96, 3, "100"), (123456.7, 4, "123500")],
)  # fmt: skip
def test_figures_have_no_power_of_ten_where_a_person_needs_none(value: float, digits: int, text: str) -> None:
    assert plain(value, digits) == text


def test_shares_are_per_cent() -> None:
    assert share_text(1.4) == "140 %" and share_text(0.0012) == "0.12 %" and share_text(np.nan) == "not known"
    assert share_text(12.0) == "1200 %" and share_text(1e13) == "more than 10,000 %"


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(1.2e7, "Pa", "12 MPa"), (0.0042, "m", "4.2 mm"), (0.3, "m", "0.3 m"), (1500.0, "N", "1.5 kN"),
     (3.1, "1", "3.1"), (2.0, "kg", "2 kg"), (0.0, "Pa", "0 Pa"), (-2.5e5, "Pa", "-250 kPa"), (2e-4, "m", "0.2 mm"),
     (2e-5, "m", "20 µm"), (2.1e11, "Pa", "210 GPa"), (1.5e8, "Pa", "150 MPa"), (150.0, "N", "150 N"),
     (5.3, "rad", "5.3 rad"), (7800.0, "kg/m3", "7800 kg/m3")],
)  # fmt: skip
def test_units_have_the_prefix_that_their_size_needs(value: float, unit: str, text: str) -> None:
    assert with_unit(value, unit) == text
    assert axis_unit(unit, np.array([value, np.nan])) == axis_unit(unit, np.array([value]))
    assert axis_unit(unit, np.array([])) == (1.0, unit)


def test_figures_of_a_page_have_one_unit_each() -> None:
    """What is a thousandth of the largest, or less, has its own: it could not be read in that one."""
    with one_unit_each({"Pa": 4.3e6, "m": 0.002}):
        assert with_unit(9e5, "Pa") == "0.9 MPa" and with_unit(2e7, "Pa") == "20 MPa"
        assert with_unit(300.0, "Pa") == "300 Pa" and with_unit(1e-4, "m") == "0.1 mm" and with_unit(7.0, "s") == "7 s"
    assert with_unit(9e5, "Pa") == "900 kPa"


SIZE, DECAY, OMEGA, LATE = 2.0, 0.5, 9.0, 0.3


def history(time: np.ndarray, size: float = SIZE, late: float = LATE) -> np.ndarray:
    """Return a vibration that dies away."""
    return size * np.exp(-DECAY * time) * np.cos(OMEGA * (time - late))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_extremes_of_a_vibration_and_their_derivatives(sign: float) -> None:
    """``tan(omega (t - late)) = - decay / omega`` at both: later they are smaller, and nothing else.

    The closed form is met with order 2, where an instant next to the extreme has order 1.
    """
    turn = (0.0 if sign > 0.0 else np.pi) - np.arctan(DECAY / OMEGA)
    exact = LATE + turn / OMEGA
    largest = history(np.array([exact]))[0]
    expected = np.array([largest / SIZE, -DECAY * largest])  # with the size, and with how late it is
    errors = []
    for step in (0.02, 0.01, 0.005):
        time = np.arange(0.2, 0.9, step) + 0.003
        size = history(time) / SIZE
        late = SIZE * np.exp(-DECAY * time) * OMEGA * np.sin(OMEGA * (time - LATE))
        values, slopes = history(time), np.array([size, late])
        place = vertex(values, sign)
        assert abs(place.offset) <= 0.5 and time[place.at] == pytest.approx(exact, abs=0.5 * step)
        assert place.of(values) == pytest.approx(largest, rel=0.1 * (OMEGA * step) ** 4 + 1e-12)
        errors.append(np.abs(place.of(slopes) - expected).max())
        # an instant has besides its distance from the extreme times the second derivative
        at_instant = slopes[1, place.at] - expected[1]
        assert at_instant == pytest.approx((time[place.at] - exact) * OMEGA**2 * largest, rel=0.1)
    # order 2: a quarter, and measured 8e-3 at the first
    assert errors[0] < 0.02 and errors[1] < 0.35 * errors[0] and errors[2] < 0.35 * errors[1]


def test_the_derivative_is_that_of_the_vertex() -> None:
    """Of values without any smoothness, to round-off of central differences."""
    random = np.random.default_rng(1)
    values, slopes, h = random.normal(size=9), random.normal(size=(3, 9)), 1e-5
    values[4] += 5.0
    for row in slopes:
        ahead, behind = (vertex(v, 1.0).of(v) for v in (values + h * row, values - h * row))
        assert vertex(values, 1.0).of(row) == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-7, abs=1e-8)


@pytest.mark.parametrize("corner", [0.05, 0.12, 0.3, 0.95])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_corner_is_where_straight_lines_meet(sign: float, corner: float) -> None:
    """Speed up to a stop, at a share of a step: a parabola is up to 0.58 above what either side allows."""
    steps = np.arange(-6.0, 7.0)

    def speed(rate: float) -> np.ndarray:
        late = corner / rate
        return sign * np.where(steps < late, 20.0 + rate * (steps - late), 20.0 - 8.0 * (steps - late))

    row, place = (speed(1.0 + 1e-6) - speed(1.0 - 1e-6)) / 2e-6, vertex(speed(1.0), sign)
    assert is_sharp(speed(1.0), place.at)
    assert place.of(speed(1.0)) == pytest.approx(sign * 20.0, rel=1e-12)
    assert place.of(row) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("values", "sign", "expected"),
    [
        ([3.0, 1.0, 0.0], 1.0, Vertex(0, 0.0)), ([3.0, 1.0, 0.0], -1.0, Vertex(2, 0.0)),
        ([1.0, 1.0, 1.0], 1.0, Vertex(0, 0.0)), ([0.0, 1.0, 1.0, 0.0], 1.0, Vertex(1, 0.5)),
        ([2.0], -1.0, Vertex(0, 0.0)), ([0.0, 1.0, 0.0], 1.0, Vertex(1, 0.0)),
    ],
)  # fmt: skip
def test_ends_and_plateaus(values: list[float], sign: float, expected: Vertex) -> None:
    assert vertex(np.array(values), sign) == expected
