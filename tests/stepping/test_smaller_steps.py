"""Samples that fail are tried again with smaller steps, and nobody else is."""

import numpy as np
import pytest

from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.stepping.generalised_alpha import DIVISORS, Attempt, Run, integrate_with_smaller_steps
from pgmp_petsc.stepping.status import Status

SIMULATION = Simulation(duration=1.0, step=0.03)  # 34 steps
LOST = Status.NOT_CONVERGED


def tried(*fates: tuple[Status, ...]) -> tuple[list[Attempt], object]:
    """Run samples whose status at every step is given, the last one for good; return the attempts and the outcome."""
    attempts: list[Attempt] = []

    def run(attempt: Attempt) -> Run:
        level = len(attempts)
        attempts.append(attempt)
        status = np.array([fates[sample][min(level, len(fates[sample]) - 1)] for sample in attempt.samples], dtype=int)
        time = np.where(status == Status.FINE, np.nan, 0.1 * (level + 1))
        return Run(None, status, time, 0, 0)

    alive = np.array([fate[0] != Status.UNPHYSICAL for fate in fates])
    return attempts, integrate_with_smaller_steps(run, SIMULATION, alive)


def test_only_those_that_failed_are_tried_again_with_half_the_step() -> None:
    attempts, outcome = tried(
        (Status.FINE,), (LOST, Status.FINE), (LOST, LOST, Status.FINE), (LOST,), (Status.UNPHYSICAL,)
    )
    assert [attempt.samples.tolist() for attempt in attempts] == [[0, 1, 2, 3, 4], [1, 2, 3], [2, 3], [3]]
    assert [attempt.divisor for attempt in attempts] == list(DIVISORS)
    assert attempts[0].simulation.step == SIMULATION.step  # as it is: to the last bit
    np.testing.assert_allclose([a.simulation.step for a in attempts[1:]], [1 / 68, 1 / 136, 1 / 272], rtol=1e-15)
    np.testing.assert_array_equal(attempts[0].alive, [True, True, True, True, False])
    np.testing.assert_array_equal(outcome.status, [0, 0, 0, LOST, Status.UNPHYSICAL])
    np.testing.assert_array_equal(outcome.divisors, [1, 2, 4, 8, 1])
    np.testing.assert_allclose(outcome.failure_time[3], 0.4)


@pytest.mark.parametrize("reason", [Status.LEFT_RANGE, Status.UNPHYSICAL])
def test_what_no_step_can_mend_is_not_tried_again(reason: Status) -> None:
    attempts, outcome = tried((reason,))
    assert len(attempts) == 1 and outcome.status[0] == reason and outcome.divisors[0] == 1


def test_a_model_that_broke_down_with_two_steps_is_not_tried_further() -> None:
    attempts, outcome = tried((Status.BROKE_DOWN,), (LOST, Status.BROKE_DOWN, Status.FINE))
    assert [attempt.samples.tolist() for attempt in attempts] == [[0, 1], [0, 1], [1]]
    np.testing.assert_array_equal(outcome.status, [Status.BROKE_DOWN, Status.FINE])
    np.testing.assert_array_equal(outcome.divisors, [2, 4])
