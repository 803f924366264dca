"""The bench: models that stay or are built again, histories of runs, and errors between two."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from runs import full_model, reduced_model, rom_of, samples
from tradeoffs import OUTPUTS, small_scene

from pgmp_petsc.base.errors import RunError, note, warning
from pgmp_petsc.bench import bench
from pgmp_petsc.bench.bench import FEWEST_STEPS, Bench, Shelf, bytes_of
from pgmp_petsc.bench.history import (
    MOST_INSTANTS,
    History,
    Training,
    errors_between,
    floors_of,
    held_out,
    largest_errors,
    run_history,
    spacing,
)
from pgmp_petsc.bench.prices import Price
from pgmp_petsc.bench.reference import Reference
from pgmp_petsc.reduction.build import FEW_VECTORS
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.stepping.alpha_step import LENGTHS
from pgmp_petsc.stepping.status import Status
from scenes import SLIDER_CRANK, slider_crank

FLOORS = np.array([1e-10])


def history(values: np.ndarray, n_steps: int | None = None, status: tuple[int, ...] | None = None) -> History:
    """Return a history of one output; values have shape (n_kept, n_samples)."""
    n_samples = values.shape[1]
    n_steps = len(values) - 1 if n_steps is None else n_steps
    states = np.array(status or (Status.FINE,) * n_samples)
    outputs = values[None].copy()
    outputs[..., states != Status.FINE] = np.nan
    inside, never = np.ones(n_samples, dtype=bool), np.full(n_samples, np.nan)
    return History(n_steps, spacing(n_steps), outputs, states, inside, never)


@pytest.mark.parametrize(
    ("exact", "off", "expected"),
    [
        # shares of a sample's own largest value, or of the floor; instants without a number do not count
        ([[0.0, 0.0], [2.0, -200.0], [1.0, 100.0]], [[0.0, 0.0], [0.1, 1.0], [-0.2, 0.0]], [[0.1, 0.005]]),
        ([[0.0]] * 3, [[1e-13]] * 3, [[1e-3]]),
        ([[1.0], [np.nan], [2.0]], [[0.0], [7.0], [0.2]], [[0.1]]),
    ],
)
def test_errors_between_histories(exact: list, off: list, expected: list) -> None:
    exact = np.array(exact)
    found = np.nan_to_num(exact) + off
    np.testing.assert_allclose(errors_between(history(found), history(exact), FLOORS), expected)


@pytest.mark.parametrize(
    ("of_found", "of_exact", "expected"), [(2, 0, np.inf), (0, 2, np.nan), (2, 2, np.nan), (0, 0, 0.0)]
)
def test_failures(of_found: int, of_exact: int, expected: float) -> None:
    """A failure of the candidate alone is an infinite error; a case without a reference does not count."""
    values = np.ones((3, 1))
    errors = errors_between(history(values, status=(of_found,)), history(values, status=(of_exact,)), FLOORS)
    np.testing.assert_array_equal(errors, [[expected]])


@pytest.mark.parametrize(("coarse", "fine"), [(64, 128), (257, 2056), (1000, 2000), (1500, 12000), (1595, 6380)])
def test_runs_with_other_steps_are_compared_at_the_instants_of_both(coarse: int, fine: int) -> None:
    def ramp(n_steps: int) -> History:
        return history((np.arange(0, n_steps + 1, spacing(n_steps)) / n_steps)[:, None], n_steps)

    assert errors_between(ramp(coarse), ramp(fine), FLOORS)[0, 0] < 1e-14
    assert errors_between(ramp(fine), ramp(coarse), FLOORS)[0, 0] < 1e-14
    assert len(ramp(fine).outputs[0]) <= MOST_INSTANTS + 1


def scene(*overrides: str) -> Scene:
    return scene_from_toml(SLIDER_CRANK + OUTPUTS, ".", ("simulation.duration=0.02", *overrides))


@pytest.mark.parametrize("make", [full_model, reduced_model])
def test_histories_have_their_instants_in_common(make) -> None:
    model = make(scene())
    values, floors = samples(model.scene, 3, r1=np.array([5e-3, 5.6e-3, 6e-3])), floors_of(model)
    coarse, own, fine = (run_history(model, values, 3, n) for n in (10, 20, 80))
    assert coarse.outputs.shape == (2, 11, 3) and fine.outputs.shape == (2, 81, 3)
    (own_angle, _), (coarse_angle, _) = (largest_errors(run, fine, floors) for run in (own, coarse))
    assert 0.0 < own_angle < coarse_angle < 0.05
    one = run_history(model, {name: column[:1] for name, column in values.items()}, 1, 20)
    # samples do not feel each other
    np.testing.assert_allclose(one.outputs[..., 0], own.outputs[..., 0], rtol=1e-9, atol=1e-15)


def test_samples_beyond_a_batch_are_run_one_batch_after_the_other() -> None:
    values = samples(scene(), 3, r1=np.array([5e-3, 5.6e-3, 6e-3]))
    together, one_by_one = (
        run_history(full_model(scene(*more)), values, 3, 20) for more in ((), ("ensemble.batch=1",))
    )
    np.testing.assert_allclose(one_by_one.outputs, together.outputs, rtol=1e-9, atol=1e-15)
    assert one_by_one.status.shape == one_by_one.inside.shape == (3,)


def test_a_sample_that_fails_is_named() -> None:
    limited = scene(
        "coordinates.theta.range=[0.0, 2.0]",
        "coordinates.theta.periodic=false",
        "simulation.initial.theta.velocity=200.0",
    )
    values = samples(limited, 2, r1=np.array([5e-3, 6e-3]))
    found = run_history(reduced_model(limited), values, 2, 20)
    with pytest.raises(
        RunError, match=r"2 of 2 samples failed, the first \(r1 = 0.005 m\) at 0.01.* a coordinate left"
    ):
        found.require_fine(limited, values)
    full = run_history(full_model(limited), values, 2, 200)
    assert not full.inside.any() and full.require_fine(limited, values) is full, "the full-order model goes on"


def test_a_given_motion_that_begins_at_the_end_of_a_range_stays_in_it() -> None:
    """No load takes it out of it; a free one within 2 % of the end, beyond its start, counts as gone."""
    slow = "{type='prescribed_motion',coordinate='theta',constant_speed={speed=0.1}}"
    limited = "coordinates.theta.range=[0.0,2.0]", "coordinates.theta.periodic=false"
    given = scene(*limited, f"effects={{drive={slow}}}")
    free = scene(*limited, "effects={}", "simulation.initial.theta.velocity=0.1")
    inside = [run_history(full_model(one), samples(one, 1), 1, 20).inside for one in (given, free)]
    assert inside[0].all() and not inside[1].any()


def test_the_largest_error_is_none_where_numbers_are_missing() -> None:
    nan = np.nan
    exact = history(np.array([[1.0], [2.0], [nan]]))
    assert largest_errors(history(np.array([[1.0], [1.0], [nan]])), exact, FLOORS) == [0.5]
    assert largest_errors(history(np.array([[1.0], [1.0], [7.0]])), exact, FLOORS) == [0.5]
    assert np.isnan(largest_errors(history(np.array([[1.0], [nan], [7.0]])), exact, FLOORS))
    assert np.isnan(largest_errors(exact, history(np.full((3, 1), nan)), FLOORS))
    long = history(np.ones((21, 1)))
    one_of_many = history(np.append(np.full((20, 1), 1.5), [[nan]], axis=0))
    assert largest_errors(one_of_many, long, FLOORS) == [0.5]
    assert errors_between(history(np.array([[1.0], [nan], [7.0]])), exact, FLOORS) == [[np.inf]]


def test_what_is_zero_to_round_off_in_both_has_no_error() -> None:
    """Of two samples one is zero: it counts from the floor on, as a share of that."""
    exact = history(np.array([[1.0, 0.0], [1.0, 0.4 * FLOORS[0]]]))
    for least, expected in ((0.9, 0.0), (3.0, 2.6)):
        found = history(np.array([[1.0, 0.0], [1.0, least * FLOORS[0]]]))
        assert largest_errors(found, exact, FLOORS) == pytest.approx([expected], abs=1e-12)
    assert errors_between(found, exact, FLOORS)[0, 1] == pytest.approx(2.6)


@dataclass
class Model:
    modes: int
    table: np.ndarray


def reduction(modes: int) -> Reduction:
    return Reduction(modes=modes)


class Builder:
    def __init__(self, n_bytes: int) -> None:
        self.n_bytes, self.built = n_bytes, []

    def __call__(self, asked: Reduction) -> Model:
        self.built.append(asked.modes)
        return Model(asked.modes, np.zeros(self.n_bytes // 8))


def filled(n_bytes: int, most: int, n: int) -> tuple[Builder, Shelf]:
    builder = Builder(n_bytes)
    shelf = Shelf(builder, most)
    for modes in range(1, n + 1):
        shelf.take(reduction(modes))
    return builder, shelf


def test_the_oldest_goes_and_is_built_again() -> None:
    builder, shelf = filled(400, 1000, 3)
    assert shelf.take(reduction(3)).modes == 3 and shelf.take(reduction(2)).modes == 2
    assert builder.built == [1, 2, 3], "the last two fit"
    assert shelf.take(reduction(1)).modes == 1 and builder.built == [1, 2, 3, 1]
    shelf.take(reduction(2))
    assert builder.built == [1, 2, 3, 1], "what was wanted last stayed"
    shelf.take(reduction(3))
    assert builder.built == [1, 2, 3, 1, 3]


@pytest.mark.parametrize("most", [0, 100])
def test_the_latest_stays_however_large(most: int) -> None:
    builder, shelf = filled(400, most, 2)
    assert shelf.take(reduction(2)).modes == 2 and builder.built == [1, 2]


def test_a_model_with_fewer_vectors_than_asked_for_is_that_which_asks_for_these(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is built once, and does not say that vectors are missing."""
    scene, built = slider_crank("reduction.modes=2", "reduction.angles=12"), []
    found = rom_of(scene)
    found = replace(
        found, record=replace(found.record, remarks=(warning(f"{FEW_VECTORS}: 0 in place of 2"), note("n")))
    )
    own = object.__new__(Bench)
    own.scene, own._bar, own.comm = slider_crank(), SimpleNamespace(update=lambda: None), MPI.COMM_SELF
    own._shelf = Shelf(lambda asked: built.append(asked) or found)
    monkeypatch.setattr(Bench, "_endless", lambda *_: None)
    monkeypatch.setattr(Bench, "go_on", lambda _, trial, loads: trial)
    trial = own.try_out(scene.reduction.model_copy(update={"parameter_modes": 2}), 100)
    assert trial.built and trial.reduction.parameter_modes == 0 and not trial.reason
    (remark,) = own.rom_of(trial).record.remarks
    assert remark.text == "n" and len(built) == 1


def test_bytes_of_all_arrays_within() -> None:
    item = {"a": (np.zeros(3), [np.zeros(2, dtype=np.int8)]), "b": Model(1, np.zeros((2, 2))), "c": "text", "d": None}
    assert bytes_of(item) == 24 + 2 + 32


def test_steps_to_begin_with_count_once_and_not_as_often_as_those_that_are_timed(monkeypatch) -> None:
    scene = slider_crank("simulation.duration=0.1", "simulation.step=1e-3")
    clock, taken = [0.0], []

    def a_second_each(system: object, simulation: object) -> SimpleNamespace:
        taken.append(round(simulation.duration / simulation.step))
        clock[0] += len(LENGTHS) + taken[-1]
        return SimpleNamespace(state=system.start())

    monkeypatch.setattr(bench, "TIMED", 0.0)
    monkeypatch.setattr(bench, "_now", lambda: np.full(2, clock[0]))
    monkeypatch.setattr(bench, "integrate", a_second_each)
    timed = SimpleNamespace(training=SimpleNamespace(values={"r1": np.array([5e-3])}))
    seconds = Bench.seconds(timed, full_model(scene), 100, 1)
    np.testing.assert_allclose(seconds, len(LENGTHS) + 100.0)
    assert taken == [FEWEST_STEPS]


def test_runs_of_one_model_count_also_beyond_the_range_and_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    limited = 'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}'
    scene = small_scene(limited, "simulation.initial.theta.velocity=100.0")
    reference = Reference(full_model(scene), Price(0.0, 0.0), "", {})
    runs = Bench(reference, Training.of_own_loads(scene, *held_out(scene)), MPI.COMM_SELF)
    assert runs.most_steps == np.inf
    moved = runs.moved(20, 40)
    assert moved.by_output[0] > 0.0 and moved.values.shape == (1, 2, 8)
    monkeypatch.setattr(bench.histories, "run_history", None)
    np.testing.assert_array_equal(runs.moved(20, 40).values, moved.values)
