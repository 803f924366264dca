"""Cycles of a history by rainflow, counted as it comes.

Turning points are kept on a stack whose first one is the start S of the count (ASTM E1049-85, section 5.4.4). With X
the range between the last two and Y the one before it, as long as X >= Y: if Y begins at S, it is half a cycle and S
moves on to its end, otherwise it is a cycle and both of its ends are dropped. What is left over are half cycles.
The last turning point is the present value as long as it goes on in the same direction: X only grows until it turns, so
that what is closed by then is closed at the turning point too, and the damage so far is that of the history up to now.
It is continuous and never falls.
"""

from __future__ import annotations

import math

import numpy as np

from pgmp_petsc.lanes.compiled import njit


def cycles(history: np.ndarray) -> np.ndarray:
    """Return the cycles of a history (n_t,), shape (n, 3): their ends, and 1 or, of half cycles, 1/2."""
    n_t = history.size
    points, halves, depths, kept = (
        np.zeros((1, n_t)),
        np.zeros((1, n_t)),
        np.zeros(1, dtype=np.int64),
        np.zeros((n_t, 3)),
    )
    values, damages = np.ascontiguousarray(history[:, None]), np.empty((n_t, 1))
    count(values, np.ones((1, 1, 3)), np.full(1, np.inf), points, halves, depths, np.zeros(1), damages, kept)
    left = points[0, : depths[0]]
    halves = np.column_stack([left[:-1], left[1:], np.full(max(left.size - 1, 0), 0.5)])
    return np.concatenate([kept[kept[:, 2] > 0.0], halves])


@njit(error_model="numpy", counted=False)
def _damage(first, second, curve, ultimate):
    """Return the damage of a cycle between two turning points; curve of shape (n_parts, 3)."""
    amplitude, mean = 0.5 * abs(first - second), 0.5 * (first + second)
    if mean > 0.0:
        if not mean < ultimate:
            return 1.0
        amplitude /= 1.0 - mean / ultimate
    part = 0
    while part + 1 < curve.shape[0] and amplitude >= curve[part + 1, 0]:
        part += 1
    return min((amplitude / curve[part, 0]) ** curve[part, 2] / curve[part, 1], 1.0)


@njit(cache=True, entry=True, error_model="numpy")
def count(values, curve, ultimate, points, halves, depths, closed, damages, kept):
    """Count the cycles of some samples further.

    Parameters
    ----------
    values
        At the next instants, shape (n_t, n). From the first that is no number on a sample has no damage.
    curve, ultimate
        Of every sample, shapes (n, n_parts, 3) and (n,).
    points, halves
        Stacks of turning points, and the damage of the half cycles up to each, shape (n, most); advanced in place, as
        are their depths and the damage of cycles that are closed, shape (n,).
    damages
        Takes the damages so far, shape (n_t, n).
    kept
        Takes the ends of cycles that are closed, and how much each counts, shape (n_t, 3); without rows it does not.
    """
    n_t, n = values.shape
    for k in range(n):
        point, half, n_kept = points[k], halves[k], 0
        depth, total = depths[k], closed[k]
        for t in range(n_t):
            value = values[t, k]
            if value != value:
                total = math.nan
            elif depth < 2:
                if depth == 0 or value != point[0]:
                    point[depth] = value
                    depth += 1
            elif (value - point[depth - 1]) * (point[depth - 1] - point[depth - 2]) >= 0.0:
                point[depth - 1] = value
            else:
                point[depth] = value
                depth += 1
            while depth > 2 and abs(point[depth - 1] - point[depth - 2]) >= abs(point[depth - 2] - point[depth - 3]):
                share = 0.5 if depth == 3 else 1.0
                total += share * _damage(point[depth - 3], point[depth - 2], curve[k], ultimate[k])
                if kept.shape[0]:
                    kept[n_kept, 0], kept[n_kept, 1], kept[n_kept, 2] = point[depth - 3], point[depth - 2], share
                    n_kept += 1
                if depth == 3:
                    point[0], point[1] = point[1], point[2]
                    depth = 2
                else:
                    point[depth - 3] = point[depth - 1]
                    depth -= 2
            if depth > 1:
                last = 0.5 * _damage(point[depth - 2], point[depth - 1], curve[k], ultimate[k])
                half[depth - 1] = half[depth - 2] + last
            else:
                half[0] = 0.0
            damages[t, k] = total + half[max(depth, 1) - 1]
        depths[k], closed[k] = depth, total
