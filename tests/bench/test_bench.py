"""The bench: models of candidates that stay or are built again, and times of runs too long to be timed whole."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from tradeoffs import small_scene

from pgmp_petsc.bench import bench
from pgmp_petsc.bench.bench import FEWEST_STEPS, Bench, Shelf, bytes_of
from pgmp_petsc.bench.cases import Training, held_out
from pgmp_petsc.bench.finished import Price
from pgmp_petsc.bench.reference import Reference
from pgmp_petsc.models import FullModel
from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.stepping.alpha_step import LENGTHS
from scenes import meshes_of, slider_crank


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
    seconds = Bench.seconds(timed, FullModel(scene, meshes_of(scene)), 100, 1)
    np.testing.assert_allclose(seconds, len(LENGTHS) + 100.0)
    assert taken == [FEWEST_STEPS]


def test_runs_of_one_model_count_also_beyond_the_range_and_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    limited = 'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}'
    scene = small_scene(limited, "simulation.initial.theta.velocity=100.0")
    reference = Reference(FullModel(scene, meshes_of(scene)), Price(0.0, 0.0), "", {})
    runs = Bench(reference, Training.of_own_loads(scene, *held_out(scene)), MPI.COMM_SELF)
    assert runs.most_steps == np.inf
    moved = runs.moved(20, 40)
    assert moved.by_output[0] > 0.0 and moved.values.shape == (1, 2, 8)
    monkeypatch.setattr(bench, "run_history", None)
    np.testing.assert_array_equal(runs.moved(20, 40).values, moved.values)
