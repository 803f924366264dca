"""At which steps of a run its error is evaluated: at all of them, as far as that is not dear.

Errors of what the reduction leaves out are driven for a long time where they meet a vibration of the bodies or of the
mechanism, and set off at once where a stop is entered or friction turns round. Instants that are further apart than the
run's own steps damp the one and miss the other.

A run of many steps, or a dear one, is evaluated at even strides. What is faster than these cannot be foreseen: seen at
the rate 1/T, a residual of frequency f looks like one of frequency ``|f - k / T|``, and what ought to average out
drives the mechanism for a long time (aliasing). So there are two sets of instants then, with strides s and s + 1, which
have no common factor: a frequency that the one takes for constant is not constant for the other. An estimate holds
where both agree. Every interval is a whole number of steps, the same throughout; one that is not would move the motion
by up to half a step in time from one evaluation to the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.mechanism.mechanism import Mechanism

# us of one core: an unknown of a beam with its neighbours, a pair of unknowns of a condensed body
OF_BEAM, OF_PAIR = 0.8, 0.17
DEAR = 4e6  # us that the evaluations of a sample may take
MOST = 4000  # evaluations
LEAST = 100
AGREED = 3.0  # ratio of the estimates of two sets of instants beyond which neither is known


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


def schedules(n_steps: int, duration: float, most: int = MOST) -> list[Schedule]:
    """Return the schedules of a run: one with every step, or two with no more than `most` each, the finer one last."""
    stride = -(-n_steps // min(max(most, LEAST), MOST))
    strides = [stride + 1, stride] if stride > 1 else [1]
    steps = [_every(each, n_steps) for each in strides]
    kept = kept_steps(steps)
    return [
        Schedule(chosen, np.searchsorted(kept, chosen), each * (duration / n_steps))
        for chosen, each in zip(steps, strides)
    ]


def kept_steps(steps: list[np.ndarray]) -> np.ndarray:
    """Return the numbers of the steps that any of some sets of them has, increasing."""
    return np.unique(np.concatenate(steps))


def _every(stride: int, n_steps: int) -> np.ndarray:
    """Return 0 and the numbers of steps at every stride back from the end."""
    return np.concatenate([[0], np.arange(n_steps, 0, -stride)[::-1]])


def agree(one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return for which samples each of two estimates (n,) differ by at most a factor `AGREED`; NaN does not agree."""
    return {name: (one[name] <= AGREED * other[name]) & (other[name] <= AGREED * one[name]) for name in one}


def price_of_evaluation(mechanism: Mechanism) -> float:
    """Return about how long an evaluation of the full-order equations takes, corrections included, us of one core."""
    price = 0.0
    for body in mechanism.bodies:
        n = mechanism.space.n_pose * body.n_nodes + body.n_internal
        price += OF_BEAM * n if body.component is None or body.component.rigid else OF_PAIR * n**2
    return price


def most_evaluations(mechanism: Mechanism) -> int:
    """Return how many evaluations a run's estimate may have."""
    return int(DEAR / price_of_evaluation(mechanism))
