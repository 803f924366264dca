"""Figures in words: digits follow from intervals."""

import numpy as np
import pytest

from pgmp_petsc.results.numbers import (
    end_texts,
    interval_text,
    number_text,
    one_unit_each,
    plain,
    share_text,
    with_unit,
)  # fmt: skip

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
     (3.1, "1", "3.1"), (2.0, "kg", "2 kg"), (0.0, "Pa", "0 Pa"), (-2.5e5, "Pa", "-250 kPa")],
)  # fmt: skip
def test_units_have_the_prefix_that_their_size_needs(value: float, unit: str, text: str) -> None:
    assert with_unit(value, unit) == text


def test_figures_of_a_page_have_one_unit_each() -> None:
    """What is a thousandth of the largest, or less, has its own: it could not be read in that one."""
    with one_unit_each({"Pa": 4.3e6, "m": 0.002}):
        assert with_unit(9e5, "Pa") == "0.9 MPa" and with_unit(2e7, "Pa") == "20 MPa"
        assert with_unit(300.0, "Pa") == "300 Pa" and with_unit(1e-4, "m") == "0.1 mm" and with_unit(7.0, "s") == "7 s"
    assert with_unit(9e5, "Pa") == "900 kPa"
