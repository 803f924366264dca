"""At which steps of a run its error is evaluated.

About a hundred evaluations do for a motion that turns slowly. The residual changes as the mechanism turns, though, and
bends the bodies the more dynamically the faster; a sample is therefore evaluated so often that it turns by no more than
`TURN` between two evaluations. Where vibrations make up a good part of the bending, the residual vibrates too, and
evaluations follow at the pace of the slowest one. While a stop is entered the residual is another one, which sets in
and ends between two evaluations: its impulse is known to about the share of one of them in the whole contact, and so a
contact takes `IN_CONTACT` of them.

Vibrations that are faster than the evaluations cannot be foreseen so. Seen at the rate 1/T, a residual of frequency f
looks like one of frequency ``|f - k / T|``, and what ought to average out drives the mechanism for a long time
(aliasing). Each estimate is therefore compared with one on other instants, and made anew on denser ones until two of
them agree. Strides are Fibonacci numbers: neighbours have no common factor, so that a frequency which the one schedule
takes for constant is not constant for the next. Every interval is a whole number of steps, the same throughout; one
that is not would move the motion by up to half a step in time from one evaluation to the next.

Each sample goes by its own motion, so that none has a part in another's estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

N_EVALUATIONS = 100
MOST = 1600
TURN = 0.15  # rad
SHAKEN = 0.1
IN_CONTACT = 15
AGREED = 1.5  # ratio of two estimates, of which the second is then kept


@dataclass(frozen=True)
class Schedule:
    """Even evaluations of a run.

    Attributes
    ----------
    steps
        Numbers of the steps, the first 0 and the last that of the end, shape (n_e,). All intervals have the same number
        of steps, but the first may have less: what is evaluated at its end then stands for a whole interval.
    places
        Where these stand among the steps that are kept while a run goes on, shape (n_e,).
    interval
        Time between two evaluations, s.
    """

    steps: np.ndarray
    places: np.ndarray
    interval: float

    @property
    def complete(self) -> bool:
        """Whether every step is evaluated."""
        return self.steps.size == self.steps[-1] + 1


def schedules(n_steps: int, duration: float) -> list[Schedule]:
    """Return schedules from the coarsest to the finest.

    The finest holds the steps of all; they are those to be kept. The second is the coarsest that has `N_EVALUATIONS`;
    the first is there to be compared with. A run of so few steps that all are evaluated has only one.
    """
    finest = -(-n_steps // MOST)
    strides = [1, 2]
    while n_steps >= N_EVALUATIONS * finest * strides[-1]:
        strides.append(strides[-2] + strides[-1])
    if n_steps <= 2 * N_EVALUATIONS:
        strides = [1]
    steps = [_every(finest * stride, n_steps) for stride in reversed(strides)]
    intervals = [finest * stride * (duration / n_steps) for stride in reversed(strides)]
    return [
        Schedule(chosen, np.searchsorted(steps[-1], chosen), interval) for chosen, interval in zip(steps, intervals)
    ]


def _every(stride: int, n_steps: int) -> np.ndarray:
    """Return 0 and the numbers of steps at every stride back from the end."""
    return np.concatenate([[0], np.arange(n_steps, 0, -stride)[::-1]])


def longest_intervals(speeds: np.ndarray, shaken: np.ndarray, periods: np.ndarray, contacts: np.ndarray) -> np.ndarray:
    """Return the longest time between two evaluations, shape (n,), s.

    Parameters
    ----------
    speeds
        Largest speed of the rigid coordinate over the run, shape (n,), rad/s.
    shaken
        What the time step did to the vibrations as a share of the bending, shape (n,).
    periods
        Time in which the slowest vibration turns by a radian, shape (n,), s.
    contacts
        Shortest contact, infinite where there is none, shape (n,), s.
    """
    turning = np.minimum(TURN / np.maximum(speeds, 1e-300), np.where(shaken > SHAKEN, periods, np.inf))
    return np.minimum(turning, contacts / IN_CONTACT)


def choose(choices: list[Schedule], longest: np.ndarray) -> np.ndarray:
    """Return the number of the schedule that each sample needs for its longest interval (s), shape (n,).

    Never the first of several, which is there to be compared with.
    """
    rates = np.array([1.0 / choice.interval for choice in choices])
    # round-off must not cost more evaluations
    needed = np.searchsorted(rates * (1.0 + 1e-9), 1.0 / longest)
    return np.clip(needed, min(1, len(choices) - 1), len(choices) - 1)


def agree(one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return for which samples all of two estimates (n,) differ by at most a factor `AGREED`; NaN does not agree."""
    pairs = [(one[name], other[name]) for name in one]
    return np.all([(a <= AGREED * b) & (b <= AGREED * a) for a, b in pairs], axis=0)
