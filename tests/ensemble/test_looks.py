"""Looks at ensembles that go on: the schedule, the level of intervals, the budget, and how often stops hold."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from refusals import refusal
from runs import paper_scene
from scipy import stats

from pgmp_petsc.base.units import MM, SI
from pgmp_petsc.ensemble import stopping
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.ensemble.stopping import (
    Rule,
    Seen,
    Stop,
    level_of_each,
    looks,
    read_rule,
    see,
    stages,
    stopping_of,
    stopping_remarks,
)
from pgmp_petsc.results.ensemble import Stopping
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Event

REPETITIONS = 100
LABEL = 'ensemble.probabilities.behind={output="crank_angle", below=0.0, when="ever"}'


class Made(Mapping[str, np.ndarray]):
    """Columns of samples that no run has made; in place of a checkpoint too."""

    def __init__(self, values: np.ndarray) -> None:
        self._columns = {"status": np.zeros(values.size), "outputs.crank_angle": values}

    def columns(self) -> "Made":
        return self

    def of(self, kind: str) -> dict[str, np.ndarray]:
        return {key.partition(".")[2]: values for key, values in self.items() if key.startswith(f"{kind}.")}

    def __getitem__(self, name: str) -> np.ndarray:
        return self._columns[name]

    def __iter__(self):
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return paper_scene('ensemble.probabilities.far={output="crank_angle", above=1.5}', LABEL, "ensemble.extremes=true")


def stop_of(scene: Scene, rules: tuple[str, ...], values: np.ndarray, most: int) -> list[Seen]:
    """Return what is seen of an ensemble with given values, as the command looks at it."""
    stop, sampler = Stop(tuple(read_rule(rule, scene) for rule in rules)), Sampler(scene, Plan(most, 0))
    return stages(
        stop, 1, most, lambda n: n, lambda n: see(stop.rules, scene, sampler, Made(values[:n]), n), MPI.COMM_SELF
    )


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_whatever_interval_of_errors_stops_at_the_first_of_two_looks_the_intervals_hold(confidence: float) -> None:
    z = stats.norm.ppf(0.5 + 0.5 * level_of_each(confidence))
    errors = np.linspace(-8.0, 8.0, 16_001)
    share = stats.norm.pdf(errors) * (errors[1] - errors[0])
    later = stats.norm(errors / np.sqrt(2.0), np.sqrt(0.5))  # Z_2, with Z_1 known
    sums = np.concatenate([[0.0], np.cumsum(share * ((np.abs(errors) > z) - later.sf(z) - later.cdf(-z)))])
    worst = np.max(sums - np.minimum.accumulate(sums))  # of all intervals of Z_1
    assert 2.0 * stats.norm.sf(z) + worst == pytest.approx(1.0 - confidence, abs=2e-4)  # the steps of the grid


def test_one_looks_at_doubled_numbers() -> None:
    assert list(looks(1, 1000)) == [64, 128, 256, 512, 1000]
    assert list(looks(8, 256)) == [64, 128, 256]
    assert list(looks(5, 200)) == [80, 160, 200]
    assert list(looks(1, 10)) == [10]


@pytest.mark.parametrize(
    ("draw", "rule", "true"),
    [
        (lambda random, n: random.normal(2.0, 1.0, n), "mean(crank_angle) +- 0.06", 2.0),
        (lambda random, n: random.normal(2.0, 1.0, n), "std(crank_angle) < 5 %", 1.0),
        (lambda random, n: random.exponential(1.0, n), "mean(crank_angle) < 8 %", 1.0),
        (lambda random, n: random.random(n), "P(crank_angle > 0.8) +- 0.03", 0.2),
        (lambda random, n: random.exponential(1.0, n), "P(far) < 15 %", np.exp(-1.5)),
    ],
)
def test_intervals_at_the_stop_hold(scene: Scene, draw: Callable, rule: str, true: float) -> None:
    """At least as often as they say, less 1 in 10,000 chances, and never by waiting for the last sample."""
    random, held, looked = np.random.default_rng(8), 0, set()
    for _ in range(REPETITIONS):
        last = stop_of(scene, (rule,), draw(random, 16_384), 16_384)[-1]
        held += last.intervals[0, 0] <= true <= last.intervals[0, 1]
        looked.add(last.n)
    assert held >= stats.binom(REPETITIONS, 0.95).ppf(1e-4)
    assert max(looked) < 16_384 and len(looked) <= 3


def test_several_rules_stop_where_all_are_met(scene: Scene) -> None:
    values = np.random.default_rng(9).normal(2.0, 1.0, 50_000)
    coarse, fine = ("mean(crank_angle) +- 0.2", "std(crank_angle) < 4 %")
    ends = [stop_of(scene, rules, values, 50_000)[-1].n for rules in ((coarse,), (fine,), (coarse, fine))]
    assert ends[0] < ends[1] == ends[2]


@pytest.mark.parametrize("rule", ["std(crank_angle) < 5 %", "mean(crank_angle) < 1 %", "mean(crank_angle) +- 1e-9"])
def test_what_is_the_same_in_all_samples_is_known(scene: Scene, rule: str) -> None:
    """No further sample tells more; all of -n were taken, and the figure was said to be unknown."""
    assert [seen.n for seen in stop_of(scene, (rule,), np.zeros(1000), 1000)] == [64]


def test_a_rule_that_is_not_met_says_what_was_reached(scene: Scene) -> None:
    rule = "std(crank_angle) < 1 %"
    history = stop_of(scene, (rule,), np.random.default_rng(10).normal(size=200), 200)
    assert [seen.n for seen in history] == [64, 128, 200]
    found = stopping_of(Stop((read_rule(rule, scene),)), history, Plan(200, 0), {"crank_angle": "rad"})
    assert not found.is_met and found.why == "these are all samples (-n 200)"
    half = 0.5 * np.ptp(found.intervals[0, -1]) / found.estimates[0, -1]
    assert found.reached[0, -1] == pytest.approx(half)
    said = [remark.text for remark in stopping_remarks(found, 0.95, MM)]
    assert said[0].startswith(f'--until "{rule}" is not met: these are all samples (-n 200), and +- {100 * half:.3g} %')
    assert "96.28 %" in said[1]
    lengths = replace(found, units=("m",), relative=np.zeros(1, dtype=bool))
    reached = f"and +- {1e3 * lengths.reached[0, -1]:.3g} mm was reached"
    assert reached in stopping_remarks(lengths, 0.95, MM)[0].text
    assert any("NOT MET" in line for line in found.lines())


def test_a_budget_ends_between_two_looks(scene: Scene, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """By a clock that runs with the samples: 10 ms each, the first eight ten times as long."""
    now = [0.0]
    monkeypatch.setattr(stopping.time, "monotonic", lambda: now[0])
    done = [0]

    def run(n: int) -> int:
        computed, done[0] = n - done[0], n
        now[0] += 0.01 * computed * (10.0 if n <= 8 else 1.0)
        return computed

    stop = Stop((), 10.0, start=0.0)
    history = stages(stop, 1, 10**9, run, lambda n: Seen(n, np.zeros(0), np.zeros((0, 2))), MPI.COMM_SELF)
    assert 8.5 < now[0] <= 10.0 and history[-1].n == done[0] not in list(looks(1, 1024))
    assert [seen.n for seen in history[:-1]] == [64, 128, 256, 512]
    found = stopping_of(stop, history, Plan(10**9, 0, is_limited=False), {})
    assert found.is_met and found.why == "the budget of 10 s is spent"
    assert "another run may have another" in stopping_remarks(found, 0.95, SI)[0].text
    with h5py.File(tmp_path / "stopping.h5", "w") as file:
        found.put(file)
        file.flush()  # readers look at how large the file is
        again = Stopping.take(file)
    assert (again.why, again.budget, again.rules) == (found.why, 10.0, ())
    np.testing.assert_array_equal(again.samples, found.samples)
    # one that is spent before has the fewest samples
    stop = Stop((), 1.0, start=now[0] - 50.0)
    history = stages(stop, 8, 10**9, lambda n: n, lambda n: Seen(n, np.zeros(0), np.zeros((0, 2))), MPI.COMM_SELF)
    assert [seen.n for seen in history] == [8]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("std(crank_angle) < 1 %", ("std", "crank_angle", None, 0.01, True)),
        (" mean ( slider_position )+-1e-4 ", ("mean", "slider_position", None, 1e-4, False)),
        ("mean(slider_position)\u00b11e-4", ("mean", "slider_position", None, 1e-4, False)),
        ("mean(slider_position) +- 2 %", ("mean", "slider_position", None, 0.02, True)),
        ("mean(crank_angle.max) < .5%", ("mean", "crank_angle.max", None, 0.005, True)),
        ("P(behind) < 10%", ("P", "behind", None, 0.1, True)),
        (
            "P(slider_deformation < -1.5e-4) +- 0.002",
            ("P", "", Event(output="slider_deformation", below=-1.5e-4), 0.002, False),
        ),
        ("mean(slider_position) +- 0.1mm", ("mean", "slider_position", None, 1e-4, False)),
        (
            "P(slider_deformation < -0.15 mm) < 5%",
            ("P", "", Event(output="slider_deformation", below=-1.5e-4), 0.05, True),
        ),
        ("P(crank_angle > 180 deg) +- 0.01", ("P", "", Event(output="crank_angle", above=np.pi), 0.01, False)),
        ("P(crank_angle>3) +- 0.01", ("P", "", Event(output="crank_angle", above=3.0), 0.01, False)),
    ],
)
def test_what_rules_mean(scene: Scene, text: str, expected: tuple) -> None:
    assert read_rule(text, scene) == Rule(text, *expected)


@pytest.mark.parametrize(
    ("text", "place", "expected"),
    [
        ("", 1, "mean, std or P"), ("median(crank_angle) < 1 %", 1, "mean, std or P"), ("std crank_angle", 5, "'('"),
        ("std(angle) < 1 %", 5, "the name of an output; did you mean 'crank_angle'?"),
        ("std(1) < 1 %", 5, "the name of an output"), ("P(crank_angle) < 1 %", 14, "'<' or '>'"),
        ("P(crank_angle < high) +- 0.1", 17, "a number"),
        ("P(nothing) +- 0.1", 3, "an output or a label of ensemble.probabilities"), ("std(crank_angle) < 1", 21, "'%'"),
        ("std(crank_angle) < -1 %", 20, "a positive precision"),
        ("P(crank_angle > 1e999) +- 0.1", 17, "0 or a magnitude from 1e-30 to 1e+30"),
        ("P(crank_angle > -1e31) +- 0.1", 17, "0 or a magnitude from 1e-30 to 1e+30"),
        ("std(crank_angle) < 1e999 %", 20, "0 or a magnitude from 1e-30 to 1e+30"),
        ("std(crank_angle) = 1 %", 18, "'<' or '+-'"), ("std(crank_angle", 16, "')'"),
        ("std(crank_angle) < 1 % please", 24, "the end"),
        ("mean(crank_angle) +- 1mm", 23, "a unit of crank_angle, or none ('mm' is the unit of a length; needed"),
        ("P(crank_angle > 3 m/m2) +- 0.1", 19, "a unit of crank_angle, or none ('m/m2' is the unit of"),
        ("P(crank_angle > 3 boxes) +- 0.1", 19, "a unit of crank_angle, or none (no such unit"),
        ("P(crank_angle > 3 rad +- 0.1", 23, "')'"), ("P(crank_angle > 3) +- 0.1 rad", 27, "the end"),
    ],
)  # fmt: skip
def test_what_is_no_rule_is_marked(scene: Scene, text: str, place: int, expected: str) -> None:
    first, shown, marked = refusal(read_rule, text, scene).splitlines()
    assert first.startswith(f'--until "{text}": expected at character {place}: {expected}')
    assert shown == f"  {text}" and marked == " " * (place + 1) + "^"
    assert "expected at character 6: the name of an output" in refusal(
        read_rule, "mean(crank_angle.max) < 1 %", paper_scene()
    )
