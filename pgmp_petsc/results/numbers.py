"""Figures in words: as many digits as an interval leaves them, intervals, percentages."""

from __future__ import annotations

import numpy as np

DIGITS = 2  # of an interval's width that are shown


def number_text(value: float, ends: np.ndarray, most: int) -> str:
    """Return a figure with as many digits as its interval leaves it, `most` at most; 5 where that says nothing."""
    if np.isnan(value):
        return "unknown"
    return f"{value:.{_digits(value, _width(ends, value), most)}g}"


def interval_text(ends: np.ndarray, value: float = np.nan) -> str:
    """Return ``[1.234, 1.256]``, the interval of a value where that is known."""
    if np.isnan(ends).any():
        return "unknown"
    if np.isinf(ends).all():
        return "[too few samples]"
    texts = end_texts(ends, value)
    return f"[{texts[0]}, {texts[1]}]"


def end_texts(ends: np.ndarray, value: float = np.nan) -> list[str]:
    """Return both ends of an interval, which may be infinite, of a value where that is known."""
    width = _width(ends, value)
    return [
        ("-" if end < 0 else "") + "infinite" if np.isinf(end) else f"{end:.{_digits(end, width, 8)}g}" for end in ends
    ]


def percent(level: float) -> str:
    """Return ``95 %``."""
    return f"{100 * level:g} %"


def _width(ends: np.ndarray, value: float) -> float:
    """Return how wide an interval is, from its value to the finite end where the other is infinite; 0 if unknown."""
    known = np.where(np.isfinite(ends), ends, value)
    width = abs(known[1] - known[0])
    return float(width) if np.isfinite(width) else 0.0


def _digits(value: float, width: float, most: int) -> int:
    """Return how many digits of a figure its interval leaves it, and two more for sums; 3 at least."""
    if not width > 0.0 or value == 0.0:
        return min(most, 5)
    return int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(width)) + DIGITS, 3, most))
