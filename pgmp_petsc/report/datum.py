"""Figures of a page: what is read, and where it comes from, so that a program can compare the two.

A sentence is a list of texts, figures and intervals; the page writes figures as ``<data value=... data-file=...
data-path=... data-index=...>``, with all digits of the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.results.numbers import end_texts, number_text


@dataclass(frozen=True)
class Datum:
    """A figure.

    Attributes
    ----------
    value
        As it stands in the file, in the file's unit.
    text
        As it is read.
    file, path, index
        Name of the file, its dataset, and the place in it (``3`` or ``3,1``); empty for figures that were worked out of
        several.
    """

    value: float
    text: str
    file: str = ""
    path: str = ""
    index: str = ""


@dataclass(frozen=True)
class Interval:
    """Both ends of a confidence interval, which the page writes in brackets."""

    low: Datum
    high: Datum


Sentence = Sequence[str | Datum | Interval]


@dataclass(frozen=True)
class Place:
    """Where figures come from: a file, and a group in it."""

    file: str
    group: str

    def datum(self, name: str, value: float, text: str, index: str = "") -> Datum:
        """Return a figure of a dataset of the group."""
        return Datum(float(value), text, self.file, f"{self.group}/{name}", index)

    def figure(
        self, name: str, value: float, interval_name: str, ends: np.ndarray, factor: float, index: str = ""
    ) -> list[str | Datum | Interval]:
        """Return a figure and its interval, ``5.8 [4.5, 7.4]``, in a unit of which the file's has `factor`."""
        row = f"{index}," if index else ""
        shown = self.datum(name, value, number_text(factor * float(value), factor * ends, 6), index)
        if np.isnan(ends).any() or np.isinf(ends).all():
            return [shown, " [unknown]"]
        low, high = (
            self.datum(interval_name, end, text, f"{row}{k}")
            for k, (end, text) in enumerate(zip(ends, end_texts(factor * ends, factor * float(value))))
        )
        return [shown, Interval(low, high)]


def in_words(name: str) -> str:
    """Return ``slider deformation, max`` for ``slider_deformation.max``."""
    return name.replace("_", " ").replace(".", ", ")


def sentence_case(text: str) -> str:
    """Return a text with a capital letter first."""
    return text[:1].upper() + text[1:]
