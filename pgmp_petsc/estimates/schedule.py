"""At which steps of a run its error is evaluated, until two sets of instants agree.

Errors of what the reduction leaves out are driven for a long time where they meet a vibration of the bodies or of the
mechanism, and set off at once where a stop is entered or friction turns round. Instants that are further apart than the
run's own steps damp the one and miss the other. So every step is evaluated, and every half of one to compare with;
where these disagree, every step of the run with smaller steps that is followed (`FINER` in one). Vibrations that the
run's steps do not resolve look slow at these, and even slower at every second one: the two would agree on what is
wrong.

A run of many steps, or a costly one, is evaluated at longer strides. What is faster than these cannot be foreseen: seen
at the rate 1/T, a residual of frequency f looks like one of frequency ``|f - k / T|``, and what ought to average out
drives the mechanism for a long time (aliasing). The strides s and 2 s - 1 have no common factor: a frequency that the
one takes for constant is not constant for the other. Every interval is a whole number of steps, the same throughout;
one that is not would move the motion by up to half a step in time from one evaluation to the next.

Each sample goes by its own motion, so that none has a part in another's estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.mechanism.mechanism import Mechanism

# us of one core: an unknown of a beam with its neighbours, a pair of unknowns of a condensed body
OF_BEAM, OF_PAIR = 0.8, 0.17
DEAR = 4e6  # us that the evaluations of a sample may take
FINER = 4  # steps of the run that is followed in one of the run itself
MOST, LEAST = 8000, 100  # evaluations
DAMPED = 0.5  # spectral radius of the steps of the error: less than of runs, as these instants are all that is seen
AGREED = 1.25  # ratio of two estimates, of which the second is then kept
UNSURE_WITH_OTHERS = 1.5  # where another output of the same run is unsure
UNSURE = 2.5  # beyond which the last two do not tell the error, as their own errors are of second order in the interval


@dataclass(frozen=True)
class Schedule:
    """Even evaluations of a run."""

    #: numbers of the smaller steps, the first 0 and the last that of the end, shape (n_e,). All intervals have the same
    #: number of steps, but the first may have less: the value at its end then represents a whole interval.
    steps: np.ndarray
    places: np.ndarray  # places of these among the steps that are kept while a run goes on, shape (n_e,)
    told: np.ndarray  # which of these are ends of the run's own steps, shape (n_e,)
    interval: float  # time between two evaluations, s
    #: of the integration over these: 0, without a memory of what is faster, where they are longer than the run's steps
    spectral_radius: float


def schedules(n_steps: int, duration: float, most: int = MOST) -> list[Schedule]:
    """Return the schedules of a run from the coarsest, which is there to be compared with, to the densest with no more
    than `most` evaluations."""
    most = min(max(most, LEAST), MOST)
    stride = -(-n_steps // most)
    strides = [FINER * max(2, 2 * stride - 1), FINER * stride]
    while stride == 1 and strides[-1] > 1 and 2 * FINER * n_steps <= most * strides[-1]:
        strides.append(strides[-1] // 2)
    strides = strides[1:] if len(strides) > 2 else strides
    steps = [np.concatenate([[0], np.arange(FINER * n_steps, 0, -each)[::-1]]) for each in strides]
    kept, radius = kept_steps(steps), DAMPED if stride == 1 else 0.0
    return [
        Schedule(some, np.searchsorted(kept, some), some % FINER == 0, each * duration / (FINER * n_steps), radius)
        for some, each in zip(steps, strides)
    ]


def kept_steps(steps: list[np.ndarray]) -> np.ndarray:
    """Return the numbers of the steps that any of some sets of them has, increasing."""
    return np.unique(np.concatenate(steps))


def places_of(kept: np.ndarray) -> np.ndarray:
    """Return where each step is among those that are kept, -1 where it is not, by the numbers of steps."""
    places = np.full(kept[-1] + 1, -1)
    places[kept] = np.arange(kept.size)
    return places


def differences(
    one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray], floors: Mapping[str, float]
) -> dict[str, np.ndarray]:
    """Return the factors by which two estimates (n,) of every output differ, 1 and more; NaN where one is not known.

    What is below its floor is taken for that.
    """
    found = {}
    for name, floor in floors.items():
        ratio = np.maximum(one[name], floor) / np.maximum(other[name], floor)
        found[name] = np.maximum(ratio, 1.0 / ratio)
    return found


def price_of_evaluation(mechanism: Mechanism) -> float:
    """Return about how long an evaluation of the full-order equations takes, corrections included, us of one core."""
    price = 0.0
    for body in mechanism.bodies:
        n = mechanism.space.n_pose * body.n_nodes + body.n_internal
        price += OF_PAIR * n**2 if body.dense else OF_BEAM * n
    return price


def most_evaluations(mechanism: Mechanism) -> int:
    """Return how many evaluations a run's estimate may have."""
    return int(DEAR / price_of_evaluation(mechanism))
