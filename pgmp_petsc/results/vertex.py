"""The largest or smallest value of a smooth history that is known at instants, with its derivatives.

The largest of the values themselves, ``y_k``, is that of one instant, and its derivative that of the history there. But
between instants lies the true extreme, where the history has no slope: only there is the derivative of the extreme that
of the history (the envelope theorem; Danskin 1966). At an instant next to it there is ``(t_k - t*) dy'/dp`` besides,
which is of first order in the step, and may be larger than all else where a parameter shifts a vibration in time. The
vertex of the parabola through the values at three equally distant instants,

    s = (y_{k-1} - y_{k+1}) / (2 (y_{k-1} - 2 y_k + y_{k+1})),    -1/2 <= s <= 1/2,
    y* = y_k + s (y_{k+1} - y_{k-1}) / 2 + s^2 / 2 (y_{k-1} - 2 y_k + y_{k+1}),

does not move with s to first order, so that its derivative is the same expression of the derivatives: exact for y*, and
of second order in the step for the extreme of the history.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Vertex:
    """The vertex of the parabola through a value and those before and after it.

    Attributes
    ----------
    at
        Number of the instant.
    offset
        By how much of a step the vertex is later, from -1/2 to 1/2; 0 at both ends of a history.
    """

    at: int
    offset: float

    def of(self, histories: np.ndarray) -> np.ndarray:
        """Return what the parabolas through histories have there, shape (...) for histories of shape (..., n_t)."""
        here = histories[..., self.at]
        if self.offset == 0.0:
            return here
        before, after = histories[..., self.at - 1], histories[..., self.at + 1]
        return here + 0.5 * self.offset * (after - before) + 0.5 * self.offset**2 * (before - 2.0 * here + after)


def vertex(values: np.ndarray, sign: float) -> Vertex:
    """Return where a history of equally distant instants, shape (n_t,), has its largest value, or its smallest.

    Parameters
    ----------
    sign
        1 for the largest, -1 for the smallest.
    """
    at = int(np.argmax(sign * values))
    if not 0 < at < len(values) - 1:
        return Vertex(at, 0.0)
    before, here, after = values[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    return Vertex(at, float(0.5 * (before - after) / bend) if bend != 0.0 else 0.0)
