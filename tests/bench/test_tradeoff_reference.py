"""The reference is halved until it moves by a tenth of the smallest error, or may go no further."""

import numpy as np
import pytest

from pgmp_petsc.bench.history import History, largest_errors
from pgmp_petsc.bench.reference import ReferenceSequence
from pgmp_petsc.stepping.status import Status

N = 10
FLOORS = np.array([1e-10])


def run(n_steps: int, order: float = 2.0, constant: float = 1.0) -> History:
    """Return a run whose error is ``constant / n^order`` of the largest value."""
    values = np.linspace(0.0, 1.0, N + 1)[None, :, None] * (1.0 + constant / n_steps**order)
    # kept at the same instants, whatever the number of steps
    return History(N, 1, values, np.array([Status.FINE]), np.ones(1, dtype=bool), np.full(1, np.nan))


def errors(found: History, exact: History) -> np.ndarray:
    return largest_errors(found, exact, FLOORS)


def refine(sequence: ReferenceSequence, settings: list[History], **law: float) -> int:
    """Do what the sequence asks for; return the number of rounds."""

    def smallest() -> np.ndarray:
        return np.min([errors(each, sequence.history) for each in settings], axis=0)

    rounds = 0
    while wanted := sequence.wanted(smallest() if sequence.usable else np.array([np.inf])):
        rounds += 1
        for n_steps in wanted:
            sequence.add(n_steps, run(n_steps, **law))
    return rounds


def test_an_eighth_of_the_finest_step_settles_at_once() -> None:
    sequence = ReferenceSequence(4 * 20, 10**6, FLOORS)
    assert refine(sequence, [run(10), run(20)]) == 1
    smallest = errors(run(20), sequence.history)
    assert sequence.n_steps == 8 * 20
    # 3/64 of the error at the eighth of a step: less than a tenth
    np.testing.assert_allclose(sequence.moved / smallest, [3 / 63], rtol=1e-2)
    assert sequence.settled(smallest) and "moved no output by 0.1 of" in sequence.reason(smallest)


def test_a_setting_that_is_better_asks_for_a_finer_reference() -> None:
    sequence = ReferenceSequence(40, 10**6, FLOORS)
    assert refine(sequence, [run(10), run(200)]) == 3, "two to begin with, then three at once, then one"
    assert sequence.n_steps == 16 * 80
    assert sequence.settled(errors(run(200), sequence.history))


def test_it_stops_at_the_finest_step_that_is_allowed() -> None:
    sequence = ReferenceSequence(40, 160, FLOORS)
    refine(sequence, [run(200)])
    assert sequence.n_steps == 160 and ReferenceSequence(40, 10, FLOORS).wanted(np.array([np.inf])) == [40, 80]
    smallest = errors(run(200), sequence.history)
    assert not sequence.settled(smallest)
    assert sequence.reason(smallest) == "the finest step that is allowed"


def begun(most: int, constant: float = 1.0) -> ReferenceSequence:
    """Return a sequence with its first two runs."""
    sequence = ReferenceSequence(40, most, FLOORS)
    for n_steps in (40, 80):
        sequence.add(n_steps, run(n_steps, constant=constant))
    return sequence


def test_it_stops_where_a_run_fails_and_is_no_reference_without_two() -> None:
    sequence, smallest = begun(10**6), np.array([1e-9])
    assert sequence.wanted(smallest)
    sequence.failure = "no convergence"
    assert sequence.wanted(smallest) == [] and sequence.usable
    assert sequence.reason(smallest) == "a finer run failed: no convergence"
    none = ReferenceSequence(40, 160, FLOORS)
    none.failure = "no convergence"
    assert not none.usable and none.wanted(np.array([np.inf])) == []


@pytest.mark.parametrize(
    ("smallest", "most", "constant", "wanted"),
    [
        (np.inf, 10**6, 1.0, []),  # an output without any error is settled
        (np.nan, 10**6, 1.0, []),
        (0.0, 10**6, 1e-13, []),  # round-off is no move
        (0.0, 640, 1.0, [160, 320, 640]),  # an error of zero goes to the limit
    ],
)
def test_what_is_still_wanted(smallest: float, most: int, constant: float, wanted: list[int]) -> None:
    assert begun(most, constant).wanted(np.array([smallest])) == wanted
