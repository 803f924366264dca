"""The times of runs of a trade-off: those too long to be timed are timed by their first steps."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pgmp_petsc.bench import bench
from pgmp_petsc.bench.bench import FEWEST_STEPS, Bench
from pgmp_petsc.dynamics.first_accelerations import LENGTHS
from pgmp_petsc.models import FullModel
from scenes import meshes_of, slider_crank


def test_steps_to_begin_with_count_once_and_not_as_often_as_those_that_are_timed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
