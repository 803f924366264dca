"""What is said of failed samples: how many, why, and which parameters tell them from the others."""

import numpy as np
import pytest
from scipy import stats

from pgmp_petsc.ensemble import intervals
from pgmp_petsc.ensemble.description import failure_remarks, has_steps_left, step_remarks
from pgmp_petsc.ensemble.rare_events import Level, RareSamples, find
from pgmp_petsc.ensemble.rare_run import rare_remarks, with_failed
from pgmp_petsc.stepping.status import Status

N = 400
VALUES = {name: np.random.default_rng(k).normal(0.0, 1.0, N) for k, name in enumerate(("T", "E"))}
UNITS = {"T": "N m", "E": "1"}


def said(failed: np.ndarray, reason: Status = Status.NOT_CONVERGED) -> list[str]:
    remarks = failure_remarks(np.where(failed, reason, Status.FINE), VALUES, UNITS, "reduced")
    assert all(remark.kind == "warning" for remark in remarks)
    return [remark.text for remark in remarks]


@pytest.mark.parametrize(
    ("failed", "words"),
    [
        (VALUES["T"] > 1.0, "at high T"),
        (VALUES["E"] < -1.2, "at low E"),
        (np.abs(VALUES["T"]) > 1.5, "at both ends of T"),
        (np.abs(VALUES["E"]) < 0.2, "in the middle of E"),
    ],
)
def test_the_parameter_and_the_side_are_named(failed: np.ndarray, words: str) -> None:
    reason, bias = said(failed)
    assert reason.startswith(f"{failed.sum()} of {N} samples failed (status 2): {Status.NOT_CONVERGED.meaning}; cure: ")
    assert f"and are biased: failures are mostly {words} (median " in bias
    assert bias.count("failures are mostly") == 1
    assert "intervals of probabilities count these both ways" in bias


def test_failures_at_random_are_not_blamed_on_a_parameter() -> None:
    """Rarely: at most in one of a hundred ensembles; of these 40 in none."""
    random = np.random.default_rng(5)
    for _ in range(40):
        _, bias = said(random.random(N) < 0.1)
        assert "may be biased: no parameter alone tells" in bias


def test_every_reason_has_its_number() -> None:
    status = np.array([0, 0, 2, 6, 6, 1])
    found = [remark.text for remark in failure_remarks(status, {"T": np.arange(6.0)}, {}, "reduced")]
    assert [text.split(" samples")[0] for text in found[:3]] == ["1 of 6", "1 of 6", "2 of 6"]
    assert [text.split("(status ")[1][0] for text in found[:3]] == ["1", "2", "6"]
    assert said(np.zeros(N, dtype=bool)) == []
    assert said(np.ones(N, dtype=bool))[-1] == "no sample is fine, so the outputs have no statistics"


@pytest.mark.parametrize(("tried", "reason", "left"), [(8, 2, True), (64, 2, False), (1, 1, False), (8, 0, False)])
def test_a_further_try_is_a_cure_where_it_takes_other_steps(tried: int, reason: int, left: bool) -> None:
    """Not of samples with unphysical values, which no step helps, nor after the smallest one."""
    status = np.where(np.arange(N) < 300, reason, 0)
    assert has_steps_left(status, np.where(status != 0, tried, 1)) is left
    text = " ".join(r.text for r in failure_remarks(status, VALUES, UNITS, "reduced", 0.5, left))
    assert ("Cure: --retry-failed with this file" in text) is left
    assert ("Cure: that of the reason above; --override ensemble.failed_share" in text) is (reason != 0 and not left)


def test_smaller_steps_are_noted() -> None:
    status, divisors = np.array([0, 0, 0, 2, 0, 3]), np.array([1, 2, 4, 8, 2, 1])
    saved, given_up = (remark.text for remark in step_remarks(status, divisors, 1e-3))
    assert saved.startswith("3 of 6 samples failed with simulation.step = 0.001 s")
    assert "2 with 1/2 of it, 1 with 1/4" in saved
    assert given_up.startswith("1 of the samples that failed were tried with steps down to 1/8")
    assert step_remarks(np.zeros(3), np.ones(3), 1e-3) == ()


@pytest.mark.parametrize("case", ["one side", "beyond", "all"])
def test_failed_samples_are_in_the_interval_of_a_rare_event_both_ways(case: str) -> None:
    """Half of the event fails, on one side of it or beyond it, or all of it: without them no interval holds."""
    true, held, held_of_others, n_seeds = stats.norm.sf(3.3), 0, 0, 12

    def limit_state(u: np.ndarray) -> np.ndarray:
        failed = {"one side": (u[:, 0] > 3.3) & (u[:, 1] > 0.0), "beyond": u[:, 0] > 3.5, "all": u[:, 0] > 3.3}[case]
        return np.where(failed, np.nan, 3.3 - u[:, 0])

    for seed in range(n_seeds):
        found = find(limit_state, 2, 1500, seed)
        (low, high), others = with_failed(found, 0.95), found.interval(0.95)
        held += low <= true <= high
        held_of_others += found.reached and others[0] <= true <= others[1]
        assert case == "all" or low == others[0] and high >= others[1]
    assert held >= stats.binom(n_seeds, 0.95).ppf(1e-3) and held_of_others <= 1


def test_plain_samples_that_failed_may_all_be_in_the_event() -> None:
    """Weights say nothing of them where weighted samples do not come."""
    rounds = [np.full(100, 1e-4), np.full(200, 1e-4)]
    ends = intervals.of_weighted(rounds, 0.95)

    def found(n_failed: int, n_in: int, n_of_chains: int) -> np.ndarray:
        before = np.repeat([np.inf, -1.0, 1.0], [n_failed, n_in, 250 - n_failed - n_in])
        values = np.concatenate(
            [np.where(np.isinf(before), np.nan, before), np.full(n_of_chains, np.nan), np.zeros(300)]
        )
        levels = (Level(0.0, 0.1, 1.0, before),)
        samples = RareSamples(levels, np.full((values.size, 1), 3.5), values, np.concatenate(rounds), (100, 200))
        return with_failed(samples, 0.95)

    np.testing.assert_allclose(found(0, 0, 1), ends)
    upper = stats.binomtest(3, 250).proportion_ci(0.95, "exact").high
    np.testing.assert_allclose(found(3, 0, 0), [ends[0], upper])
    upper = stats.binomtest(7, 250).proportion_ci(0.95, "exact").high  # four that came true among the first samples
    np.testing.assert_allclose(found(3, 4, 0), [ends[0], upper])
    values = np.where(np.arange(250) < 1, np.nan, 1.0)
    not_reached = with_failed(RareSamples((), np.zeros((250, 1)), values, np.zeros(0), ()), 0.95)
    np.testing.assert_allclose(not_reached, [0.0, stats.binomtest(1, 250).proportion_ci(0.95, "exact").high])
    assert np.isnan(intervals.of_weighted([np.zeros(4)], 0.95)).all()


def test_an_event_behind_failed_samples_is_bounded_with_them_and_said_so() -> None:
    """A line of one bound had another one in its warning; and chains among failures stand at one point."""
    for seed in range(6):
        found = find(lambda u: np.where(u[:, 0] > 1.4, np.nan, 1.6 - u[:, 0]), 4, 500, seed)
        assert not found.reached
        low, high = with_failed(found, 0.95)
        assert low == 0.0 and stats.norm.sf(1.6) < high < 0.25  # of 8 % that fail, by 100 plain samples
        assert f"at most {high:.3g} (95 %)" in rare_remarks(found, np.isnan(found.limit_state), True)[0].text


@pytest.mark.parametrize("status", list(Status))
def test_a_full_order_run_is_not_cured_by_a_full_order_run(status: Status) -> None:
    for model in ("full", "components"):
        assert "--full" not in status.cure(model) and "full-order" not in status.cure(model)
    assert ("--full" in status.cure("reduced")) == (status == Status.BROKE_DOWN)
    # iterations that run away end in numbers that are not finite: of stiff beams with steps of an eighth of a radian
    of_steps = (Status.NOT_CONVERGED, Status.NOT_FINITE, Status.UNSTABLE)
    assert status.cure("full").startswith("take a smaller simulation.step") == (status in of_steps)
