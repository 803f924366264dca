"""Figures in words: digits follow from intervals."""

import numpy as np
import pytest

from pgmp_petsc.results.numbers import end_texts, interval_text, number_text

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


def test_of_an_end_alone_five_digits_are_shown() -> None:
    assert end_texts(np.array([-INFINITE, 5.2826256])) == ["-infinite", "5.2826"]
