"""Figures in words: as many digits as an interval leaves them, intervals, percentages."""

from __future__ import annotations

import numpy as np

DIGITS = 2  # of an interval's width that are shown


def number_text(value: float, ends: np.ndarray, most: int) -> str:
    """Return a figure with as many digits as its interval leaves it, `most` at most; 5 where that says nothing."""
    if np.isnan(value):
        return "unknown"
    return f"{value:.{_digits(value, ends, most)}g}"


def interval_text(ends: np.ndarray) -> str:
    """Return ``[1.234, 1.256]``."""
    if np.isnan(ends).any():
        return "unknown"
    if np.isinf(ends).all():
        return "[too few samples]"
    texts = end_texts(ends)
    return f"[{texts[0]}, {texts[1]}]"


def end_texts(ends: np.ndarray) -> list[str]:
    """Return both ends of an interval, which may be infinite."""
    return [
        ("-" if end < 0 else "") + "infinite" if np.isinf(end) else f"{end:.{_digits(end, ends, 8)}g}" for end in ends
    ]


def percent(level: float) -> str:
    """Return ``95 %``."""
    return f"{100 * level:g} %"


def _digits(value: float, ends: np.ndarray, most: int) -> int:
    """Return how many digits of a figure its interval leaves it, and two more for sums; 3 at least."""
    width = float(ends[1] - ends[0]) if np.isfinite(ends).all() else 0.0
    if not width > 0.0 or value == 0.0:
        return min(most, 5)
    return int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(width)) + DIGITS, 3, most))
