"""At which steps of a run its error is evaluated.

About a hundred evaluations do for a motion that turns slowly. The residual changes as the mechanism turns, though, and
bends the bodies the more dynamically the faster; a sample is therefore evaluated so often that it turns by no more than
`TURN` between two evaluations. Where vibrations make up a good part of the bending, the residual vibrates too, and
evaluations follow at the pace of the slowest one. Each sample goes by its own motion, so that none has a part in
another's estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

N_EVALUATIONS = 100
MOST = 1600
TURN = 0.15  # rad
SHAKEN = 0.1


@dataclass(frozen=True)
class Schedule:
    """Even evaluations of a run, as even as its steps allow.

    Attributes
    ----------
    steps
        Numbers of the steps, the first 0 and the last that of the end, shape (n_e,).
    places
        Where these stand among the steps that are kept while a run goes on, shape (n_e,).
    interval
        Time between two evaluations, s.
    """

    steps: np.ndarray
    places: np.ndarray
    interval: float


def schedules(n_steps: int, duration: float) -> list[Schedule]:
    """Return schedules from the coarsest to the finest, each about twice as dense as the one before.

    The finest holds the steps of all; they are those to be kept.
    """
    counts = [n_steps if n_steps <= 2 * N_EVALUATIONS else N_EVALUATIONS]
    while counts[-1] < min(n_steps, MOST):
        counts.append(min(2 * counts[-1], n_steps))
    steps = [np.linspace(0, n_steps, count + 1).round().astype(int) for count in counts]
    return [
        Schedule(chosen, np.searchsorted(steps[-1], chosen), duration / count) for chosen, count in zip(steps, counts)
    ]


def longest_intervals(speeds: np.ndarray, shaken: np.ndarray, periods: np.ndarray) -> np.ndarray:
    """Return the longest time between two evaluations, shape (n,), s.

    Parameters
    ----------
    speeds
        Largest speed of the rigid coordinate over the run, shape (n,), rad/s.
    shaken
        What the time step did to the vibrations as a share of the bending, shape (n,).
    periods
        Time in which the slowest vibration turns by a radian, shape (n,), s.
    """
    return np.minimum(TURN / np.maximum(speeds, 1e-300), np.where(shaken > SHAKEN, periods, np.inf))


def choose(choices: list[Schedule], longest: np.ndarray) -> np.ndarray:
    """Return the number of the schedule that each sample needs for its longest interval (s), shape (n,)."""
    rates = np.array([1.0 / choice.interval for choice in choices])
    # round-off must not cost twice the evaluations
    return np.minimum(np.searchsorted(rates * (1.0 + 1e-9), 1.0 / longest), len(choices) - 1)
