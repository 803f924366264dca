"""Outputs of samples over time: extremes, first passages, and the instants of bands, against motions that are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from pgmp_petsc.base.units import MM, SI
from pgmp_petsc.ensemble.description import over_time_remarks
from pgmp_petsc.ensemble.statistics import in_words
from pgmp_petsc.ensemble.watchers import Begun, band_steps, watch_over_time
from pgmp_petsc.scene.numerics import Ensemble, Event, Simulation
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.status import Status

STEP, N_STEPS, N = 0.01, 100, 5
SIZES = np.array([0.5, 1.0, 2.0, 3.0, 4.0])
EVENTS = {
    "high": {"output": "y", "above": 0.9, "when": "ever"},
    "low": {"output": "y", "below": -2.5, "when": "ever"},
    "begun": {"output": "y", "above": -1.0, "when": "ever"},
}


class Model:
    """A model whose only output is what its state holds."""

    def __init__(self, **asked: object) -> None:
        self.scene = SimpleNamespace(
            ensemble=Ensemble.model_validate(asked), simulation=Simulation(duration=STEP * N_STEPS, step=STEP),
            initial=SimpleNamespace(equilibrium=False), bodies={},
        )  # fmt: skip
        read = {"functions": {"y": None}, "counts": {}, "takes_beside": False}
        self.outputs = SimpleNamespace(**read, evaluate=lambda observed: {"y": observed[0]})

    def observed_over(self, system: SimpleNamespace, states: State, times: np.ndarray) -> np.ndarray:
        assert len(states.q) == len(times) <= system.instants_at_once
        return states.q.reshape(1, -1)


def watched(model: Model, divisor: int = 1, status: np.ndarray | None = None, shown: int = 1, at_once: int = 3) -> dict:
    """Return what is found of sizes * sin(2 pi t), in steps of STEP / divisor, some `shown` and looked at together."""
    watcher = watch_over_time(model, with_bands=True)
    simulation = model.scene.simulation.model_copy(update={"step": STEP / divisor})
    system = SimpleNamespace(n_samples=N, values={}, instants_at_once=at_once)
    watch = watcher.watch(Begun(system, {}, np.arange(N), simulation))
    numbers = np.arange(N_STEPS * divisor + 1)
    numbers = numbers[(numbers % watch.observer.every == 0) | (numbers == numbers[-1])]
    times = numbers * STEP / divisor
    trail = np.repeat((SIZES * np.sin(2.0 * np.pi * times)[:, None])[:, None, :, None], 3, axis=1)
    states = State(*np.moveaxis(trail, 1, 0), *np.zeros((2, len(trail), 0)))
    bounds = [0, *range(1, times.size, shown), times.size]
    for some in (slice(first, last) for first, last in zip(bounds, bounds[1:])):
        watch.observer.over(numbers[some], times[some], states.at(some))
    found = watch.found(np.zeros(N, dtype=int) if status is None else status)
    empty = watcher.empty(N)
    assert {kind: arrays.keys() for kind, arrays in found.items()} == {k: arrays.keys() for k, arrays in empty.items()}
    assert all(values.shape == empty[kind][name].shape for kind, a in found.items() for name, values in a.items())
    return found


def test_extremes_and_first_passages_are_those_of_the_motion() -> None:
    kept = watched(Model(probabilities=EVENTS))
    found, kept = kept["first_passages"], kept["extremes"]
    high = np.arcsin(np.minimum(0.9 / SIZES, 1.0)) / (2.0 * np.pi)
    np.testing.assert_array_equal(np.isnan(found["high"]), SIZES < 0.9)
    # linear within a step: an eighth of the square of the step times curvature over slope, 2 pi tan(2 pi t)
    reach = 2.0 * np.pi * np.tan(2.0 * np.pi * high[1:]) * STEP**2 / 8.0
    assert np.all(np.abs(found["high"][1:] - high[1:]) <= 1.5 * reach)
    np.testing.assert_array_equal(np.isnan(found["low"]), SIZES <= 2.5)
    np.testing.assert_array_equal(found["begun"], 0.0)
    # by how much an event at any time came true, or did not, is told by its output's extremes, of all steps
    extremes = watched(Model(extremes=True))["extremes"]
    np.testing.assert_array_equal(kept["y/max"], extremes["y/max"])
    for name, exact in {"max": SIZES, "min": -SIZES, "time_of_max": 0.25, "time_of_min": 0.75}.items():
        np.testing.assert_allclose(extremes[f"y/{name}"], exact, rtol=1e-12)
    np.testing.assert_array_equal(kept["y/max"] > 0.9, np.isfinite(found["high"]))


def test_bands_take_start_end_and_instants_between() -> None:
    known = {2: [0, 100], 5: [0, 25, 50, 75, 100], 4: [0, 34, 68, 100], 101: range(101), 500: range(101)}
    for most, steps in known.items():
        np.testing.assert_array_equal(band_steps(Model().scene.simulation, most), steps)
    assert band_steps(Model().scene.simulation, 0).size == 0
    found = watched(Model(bands=5))
    assert found["extremes"] == found["first_passages"] == {}
    times = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    np.testing.assert_allclose(found["bands"]["y"], SIZES[:, None] * np.sin(2.0 * np.pi * times), atol=1e-14)
    for asked, with_bands, looks in (
        ({"bands": 0}, True, False),
        ({}, False, False),
        ({"extremes": True}, False, True),
    ):
        assert (watch_over_time(Model(**asked), with_bands) is not None) is looks
    begun = Begun(SimpleNamespace(n_samples=N, instants_at_once=1), {}, np.arange(N), Model().scene.simulation)
    assert watch_over_time(Model(bands=5), with_bands=True).watch(begun).observer.every == 25


@pytest.mark.parametrize("divisor", [1, 4])
@pytest.mark.parametrize("shown", [1, 7, 50])
@pytest.mark.parametrize("at_once", [1, 7, 12, 50, 1 << 16])
@pytest.mark.parametrize("always", [False, True])
def test_what_is_looked_at_together_and_smaller_steps_change_nothing(
    divisor: int, shown: int, at_once: int, always: bool
) -> None:
    """Steps that are shown together, and states that wait for others: none, some, or all until the end."""
    asked = {"bands": 5} | ({"extremes": True, "probabilities": EVENTS} if always else {})
    alone = watched(Model(**asked), divisor)
    for kind, arrays in watched(Model(**asked), divisor, shown=shown, at_once=at_once).items():
        np.testing.assert_equal(arrays, alone[kind])
    np.testing.assert_allclose(alone["bands"]["y"], watched(Model(bands=5))["bands"]["y"], atol=1e-12)


def test_a_sample_that_failed_has_none() -> None:
    status = np.where(np.arange(N) == 2, Status.NOT_CONVERGED, Status.FINE)
    for arrays in watched(Model(extremes=True, probabilities=EVENTS, bands=5), status=status).values():
        for values in arrays.values():
            assert np.isnan(values[2]).all()
            np.testing.assert_array_equal(np.isfinite(values[3]).all(), True)


def test_an_output_that_was_no_number_has_no_extremes() -> None:
    model = Model(extremes=True)

    def evaluate(observed: np.ndarray) -> dict[str, np.ndarray]:
        values = observed.reshape(-1, N)
        return {"y": np.where(np.arange(N) == 1, np.sqrt(values), values)}

    model.outputs.evaluate = evaluate
    with np.errstate(invalid="ignore"):
        found = watched(model)["extremes"]
    assert np.isnan(found["y/max"][1]) and np.isnan(found["y/time_of_min"][1]) and np.isfinite(found["y/max"][0])


def test_a_passage_out_of_no_number_is_where_the_number_is() -> None:
    model = Model(probabilities=EVENTS)
    model.outputs.evaluate = lambda observed: {"y": np.where(observed[0] < 1.5, np.nan, observed[0])}
    found = watched(model)["first_passages"]["high"]
    assert np.isnan(found[:2]).all()
    # the first step whose end lies above 1.5
    times = np.arange(N_STEPS + 1) * STEP
    expected = [times[np.argmax(size * np.sin(2.0 * np.pi * times) >= 1.5)] for size in SIZES[2:]]
    np.testing.assert_allclose(found[2:], expected, rtol=1e-12)


def test_figures_of_a_part_of_the_samples_are_said_to_be() -> None:
    known = {"extremes": ["y/max", "y/min", "z/max", "z/min"], "first_passages": ["late", "soon"]}
    passages, extremes = over_time_remarks({"y.max": 9, "z.max": 10, "late": 4, "soon": 10}, known, 10)
    assert "first passages of late are described over the 4 of 10 samples that have one" in passages.text
    assert "extremes of y are not known of 1 of 10 samples that are fine" in extremes.text
    (none,) = over_time_remarks({"soon": 0}, {"extremes": [], "first_passages": ["soon"]}, 10)
    assert none.text == "none of 10 samples has a first passage of soon within the run"


def test_events_are_said_in_words() -> None:
    assert in_words(Event(output="y", above=0.5), "m", SI) == "y above 0.5 m at the end"
    assert in_words(Event(output="y", below=-2.0, when="ever"), "1", SI) == "y below -2 at any time"
    assert in_words(Event(output="y", above=0.5), "m", MM) == "y above 500 mm at the end"
