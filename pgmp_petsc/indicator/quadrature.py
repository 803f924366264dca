"""Integrals over time of what is known at the time steps alone.

Over a step from t_n to t_{n+1}, the integral of the polynomial through the values at its two ends and, as soon as there
are any, the two before (Adams-Moulton, fourth order; Hairer, Norsett and Wanner 1993, section III.1).
"""

from __future__ import annotations

import numpy as np

N_VALUES = 4
# of the values at t_{n+1}, t_n, t_{n-1}, t_{n-2}; a row for each number of values before t_n
WEIGHTS = np.array(
    [
        [1 / 2, 1 / 2, 0.0, 0.0],
        [5 / 12, 8 / 12, -1 / 12, 0.0],
        [9 / 24, 19 / 24, -5 / 24, 1 / 24],
    ]
)


def integrals(values: np.ndarray, step: float) -> np.ndarray:
    """Return the integrals from the first instant to each, shape (n_t,), for values of shape (n_t,)."""
    over_steps = np.zeros(len(values))
    over_steps[1:] = np.convolve(values, WEIGHTS[-1])[1 : len(values)]
    for number in range(1, min(len(WEIGHTS), len(values))):
        past = values[number::-1]
        over_steps[number] = WEIGHTS[number - 1, : past.size] @ past
    return step * np.cumsum(over_steps)
