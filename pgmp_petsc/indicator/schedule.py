"""At which steps of a run its error is evaluated.

About a hundred evaluations do for a motion that turns slowly. The residual changes as the mechanism turns, though, and
bends the bodies the more dynamically the faster; a sample is therefore evaluated so often that it turns by no more than
`TURN` between two evaluations. Each sample goes by its own speed, so that no sample has a part in another's estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

N_EVALUATIONS = 100
MOST = 1600
TURN = 0.15  # rad


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


def choose(choices: list[Schedule], speeds: np.ndarray) -> np.ndarray:
    """Return the number of the schedule that each sample needs, for its largest speed (rad/s), shape (n,)."""
    allowed = np.array([TURN / choice.interval for choice in choices])
    return np.minimum(np.searchsorted(allowed, speeds), len(choices) - 1)
