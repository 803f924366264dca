"""Ensembles over two coordinates, and with local effects and a stop: the same samples on any number of ranks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from runs import PGMP, overridden

from pgmp_petsc.results import Ensemble

N, SEED = 7, 3
# batches of two samples, so that every rank has some
SMALL = ("ensemble.batch=2", "simulation.step=1e-3")
SCENES = {
    # two rigid coordinates; gravity and structural damping
    "double_pendulum": (
        "reduction.angles=6", "reduction.modes=3", "coordinates.elbow_angle.range=[-0.9,0.9]",
        "simulation.duration=0.02",
    ),
    # every effect at once; the slider goes at 0.9 m/s from 0.83 m to the stop, and is thrown back
    "slider_crank_effects": (
        "reduction.angles=24", "reduction.modes=4", "effects.bumper.upper=0.85", "simulation.duration=0.06",
        "simulation.initial.theta.position=0.95", "simulation.initial.theta.velocity=-3.0",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ensembles")


@pytest.mark.parametrize("name", SCENES)
def test_samples_do_not_depend_on_ranks(mpirun: Callable, folder: Path, name: str) -> None:
    rom = folder / f"{name}.h5"
    changes = overridden(*SCENES[name], *SMALL)
    mpirun(2, *PGMP, "build", ROOT / "scenes" / f"{name}.toml", *changes, "-o", rom)
    found = []
    for n_ranks in (1, 3):
        path = folder / f"{name}_{n_ranks}.h5"
        mpirun(n_ranks, *PGMP, "montecarlo", rom, "-n", N, "--seed", SEED, "-o", path)
        found.append(Ensemble.read(path))
    one, *others = found
    np.testing.assert_array_equal(one.status, 0)
    if name == "slider_crank_effects":
        assert one.outputs["slider_position"].max() < 0.85, "without the stop 0.88 m"
    for other in others:
        np.testing.assert_array_equal(other.status, 0)
        for parameter, values in one.parameters.items():
            np.testing.assert_array_equal(other.parameters[parameter], values, err_msg=parameter)
        for output, values in one.outputs.items():
            np.testing.assert_array_equal(other.outputs[output], values, err_msg=output)
            assert np.ptp(values) > 1e-6 * np.abs(values).max(), f"{output} depends on the parameter"
