"""The impulse of a table over time, and what the integrator sees of it: the trapezoidal rule on its steps.

A table is linear between its rows, so that the rule is exact in every step without a row inside: whatever the number of
steps, only those with rows are looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Impulse:
    """Integrals of a table over a run, in its unit times s.

    Attributes
    ----------
    exact, seen
        Of the table, and of its values at the ends of steps by the trapezoidal rule.
    whole
        Of its magnitude.
    largest
        Largest magnitude at the end of a step, in the table's unit.
    """

    exact: float
    seen: float
    whole: float
    largest: float


def impulse_of(table: Sequence[tuple[float, float]], duration: float, n_steps: int) -> Impulse:
    """Return the impulse of a table of rows (time, value) over a run of `n_steps` equal steps.

    Takes time and memory by the number of rows, not of steps.
    """
    times, values = np.array(table, dtype=float).T
    step = duration / n_steps
    inside = times[(times > 0.0) & (times < duration)]
    first = np.clip(np.floor(inside / step), 0, n_steps - 1)  # the step that a row is in
    ends = np.unique(np.concatenate([[0.0, duration], first * step, np.minimum((first + 1) * step, duration)]))
    knots = np.union1d(ends, inside)

    at_knots, at_ends = np.interp(knots, times, values), np.interp(ends, times, values)
    return Impulse(
        exact=float(_trapezoid(at_knots, knots)),
        seen=float(_trapezoid(at_ends, ends)),
        whole=float(_magnitude(at_knots, knots)),
        largest=float(np.max(np.abs(at_ends))),
    )


def _trapezoid(values: np.ndarray, at: np.ndarray) -> float:
    return 0.5 * np.sum((values[1:] + values[:-1]) * np.diff(at))


def _magnitude(values: np.ndarray, at: np.ndarray) -> float:
    """Integrate the magnitude of what is linear between `at`, changes of sign included."""
    a, b = values[:-1], values[1:]
    turns = a * b < 0.0
    total = np.abs(a) + np.abs(b)
    # two triangles where the sign changes
    share = np.where(turns, (a * a + b * b) / np.where(turns, total, 1.0), total)
    return 0.5 * np.sum(share * np.diff(at))
