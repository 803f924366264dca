"""The search for edges of laws within a step, and samples that are tried again with smaller steps."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.optimize import brentq

from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.stepping import edge_search
from pgmp_petsc.stepping.edge_search import (
    BEGUN,
    DONE,
    HOPELESS,
    MAX_EVENTS,
    MAX_TRIALS,
    REACHED,
    SHORTEST,
    TIME_TOLERANCE,
    TRIED,
    EdgeSearch,
    look,
)
from pgmp_petsc.stepping.generalised_alpha import DIVISORS, Attempt, Run, integrate_with_smaller_steps
from pgmp_petsc.stepping.status import Status

LANE, STEP = 3, 0.5
Depth = Callable[[float], float]


@pytest.fixture(autouse=True)
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run what is compiled into larger functions as Python."""
    for name in ("begin_step", "_note", "_next_edge", "_narrow"):
        monkeypatch.setattr(edge_search, name, getattr(edge_search, name).py_func)


def through(
    depths: Sequence[Depth], beyond: Sequence[bool], reached: list[float] | None = None
) -> tuple[list[float], list[tuple[int, float]], np.ndarray]:
    """Take a lane through a step; return what it reached, all trials as (what came of it, end), and what is beyond."""
    search, now = EdgeSearch.of(len(depths)), np.array(beyond)
    edge_search.begin_step(search, LANE, STEP)
    begin, reached, tried = 0.0, [] if reached is None else reached, []
    while True:
        end = begin + search.duration[LANE]
        found = look.py_func(search, LANE, STEP, np.array([depth(end) for depth in depths]), now)
        tried.append((found, end))
        if found == REACHED:
            begin = end
            reached.append(end)
        if found in (DONE, HOPELESS):
            return reached, tried, now


DEPTHS: dict[str, Depth] = {
    "straight": lambda t: t - 0.2, "bent": lambda t: np.exp(3.0 * t) - 2.0, "flat": lambda t: (t - 0.31) ** 3,
    "kinked": lambda t: 5.0 * (t - 0.1) if t < 0.1 else 0.01 * (t - 0.1),
    "steep": lambda t: np.tanh(400.0 * (t - 0.43)), "at once": lambda t: t - 1e-4,
    "at the end": lambda t: t - (STEP - 1e-4),
}  # fmt: skip


@pytest.mark.parametrize("name", DEPTHS)
@pytest.mark.parametrize("leaves", [False, True])
def test_an_edge_is_found_where_scipy_finds_it(name: str, leaves: bool) -> None:
    """The same method, which ends as soon as it would move the root by less than the tolerance, in fewer trials."""
    asked = []

    def depth(time: float) -> float:
        asked.append(time)
        return DEPTHS[name](time)

    root = brentq(depth, SHORTEST * STEP, STEP, xtol=TIME_TOLERANCE * STEP)
    reached, tried, beyond = through([lambda t: -DEPTHS[name](t) if leaves else DEPTHS[name](t)], [leaves])
    # two roots that are within the tolerance each; what is flat moves by less than it is off
    assert reached == pytest.approx([root], rel=0, abs=3.0 * TIME_TOLERANCE * STEP) and beyond[0] != leaves
    assert tried[0] == (BEGUN, STEP) and tried[-1] == (DONE, pytest.approx(STEP))
    # beyond scipy's trials: the rest
    assert len(tried) <= len(asked) + 1


def test_a_step_without_an_edge_is_one_trial() -> None:
    assert through([lambda t: t - 1.0, lambda t: 1.0 - t], [False, True])[:2] == ([], [(DONE, STEP)])
    reached, tried, beyond = through([lambda t: 1.0 + t], [False])  # one that is there already
    assert reached == [] and beyond[0] and [found for found, _ in tried] == [BEGUN, TRIED, DONE]
    # what is left behind the last edge may be nothing
    reached, tried, beyond = through([lambda t: t - STEP * (1.0 - 1e-8)], [False])
    assert reached == [] and beyond[0] and tried[-1] == (DONE, pytest.approx(STEP, rel=2e-8))


def test_the_nearest_edge_comes_first() -> None:
    """And the others are looked for again from there."""
    reached, _, beyond = through([lambda t: t - 0.4, lambda t: 0.1 - t, lambda t: t - 0.3], [False, True, False])
    np.testing.assert_allclose(reached, [0.1, 0.3, 0.4], rtol=0, atol=2 * TIME_TOLERANCE * STEP)
    np.testing.assert_array_equal(beyond, [True, False, True])


def test_a_step_with_too_many_edges_ends_as_it_is() -> None:
    reached: list[float] = []

    def thrown_back(time: float) -> float:
        """Return a depth that has another sign behind each edge than before."""
        return (time - 0.02 * (len(reached) + 1)) * (-1.0) ** len(reached)

    tried = through([thrown_back], [False], reached)[1]
    np.testing.assert_allclose(reached, 0.02 * (1.0 + np.arange(MAX_EVENTS)), rtol=0, atol=2 * TIME_TOLERANCE * STEP)
    assert len(reached) == MAX_EVENTS and tried[-1] == (DONE, pytest.approx(STEP))


def test_a_search_that_does_not_end_is_given_up() -> None:
    search, beyond = EdgeSearch.of(1), np.array([False])
    edge_search.begin_step(search, LANE, STEP)
    assert look.py_func(search, LANE, STEP, np.array([1.0]), beyond) == BEGUN
    assert look.py_func(search, LANE, STEP, np.array([-1.0]), beyond) == TRIED
    search.n_trials[LANE] = MAX_TRIALS
    assert look.py_func(search, LANE, STEP, np.array([-1.0]), beyond) == HOPELESS


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
