"""Errors between two histories: shares of the largest value, what failed, instants in common."""

from __future__ import annotations

import numpy as np
import pytest

from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.experiments.history import MOST_INSTANTS, History, errors_between, spacing

FLOORS = np.array([1e-10])


def history(values: np.ndarray, n_steps: int | None = None, status: tuple[int, ...] | None = None) -> History:
    """Return a history of one output; values have shape (n_kept, n_samples)."""
    n_samples = values.shape[1]
    n_steps = len(values) - 1 if n_steps is None else n_steps
    states = np.array(status or (Status.FINE,) * n_samples)
    outputs = values[None].copy()
    outputs[..., states != Status.FINE] = np.nan
    return History(n_steps, spacing(n_steps), outputs, states, np.ones(n_samples, dtype=bool))


def test_errors_are_shares_of_a_samples_own_largest_value() -> None:
    exact = np.array([[0.0, 0.0], [2.0, -200.0], [1.0, 100.0]])
    found = exact + np.array([[0.0, 0.0], [0.1, 1.0], [-0.2, 0.0]])
    np.testing.assert_allclose(errors_between(history(found), history(exact), FLOORS), [[0.1, 0.005]])


def test_what_is_zero_is_measured_by_its_floor() -> None:
    exact, found = np.zeros((3, 1)), np.full((3, 1), 1e-13)
    np.testing.assert_allclose(errors_between(history(found), history(exact), FLOORS), [[1e-3]])


@pytest.mark.parametrize(
    ("of_found", "of_exact", "expected"),
    [(2, 0, np.inf), (0, 2, np.nan), (2, 2, np.nan), (0, 0, 0.0)],
)
def test_failures(of_found: int, of_exact: int, expected: float) -> None:
    """A failure of the candidate alone is an infinite error; a case without a reference does not count."""
    values = np.ones((3, 1))
    errors = errors_between(history(values, status=(of_found,)), history(values, status=(of_exact,)), FLOORS)
    np.testing.assert_array_equal(errors, [[expected]])


def test_instants_without_a_number_do_not_count() -> None:
    exact, found = np.array([[1.0], [np.nan], [2.0]]), np.array([[1.0], [7.0], [2.2]])
    np.testing.assert_allclose(errors_between(history(found), history(exact), FLOORS), [[0.1]])


@pytest.mark.parametrize(("coarse", "fine"), [(64, 128), (257, 2056), (1000, 2000), (1500, 12000), (1595, 6380)])
def test_runs_with_other_steps_are_compared_at_the_instants_of_both(coarse: int, fine: int) -> None:
    def ramp(n_steps: int) -> History:
        kept = np.arange(0, n_steps + 1, spacing(n_steps)) / n_steps
        return history(kept[:, None], n_steps)

    assert errors_between(ramp(coarse), ramp(fine), FLOORS)[0, 0] < 1e-14
    assert errors_between(ramp(fine), ramp(coarse), FLOORS)[0, 0] < 1e-14
    assert len(ramp(fine).outputs[0]) <= MOST_INSTANTS + 1
