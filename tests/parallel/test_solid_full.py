"""Full-order runs of continuum bodies in space on several ranks: the same motion and the same energies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from conftest import ROOT
from runs import PGMP, overridden

from pgmp_petsc.results import Ensemble, Trajectory

SCENE = ROOT / "scenes" / "slider_crank_solid3d.toml"
# few steps, with a torque that sets in at once
FEW = (
    "simulation.duration=0.004",
    "simulation.step=1e-3",
    "effects.motor.table=[[0.0, 0.0], [0.004, 5.0], [1.0, 5.0]]",
)


def test_ranks_share_a_run(mpirun: Callable, tmp_path: Path) -> None:
    """9,000 unknowns on one rank and on three of four; all waves of the sudden torque are in the outputs."""
    runs = []
    for n in (1, 4):
        path = tmp_path / f"full_{n}.h5"
        mpirun(n, *PGMP, "simulate", SCENE, "--full", "-o", path, *overridden(*FEW))
        runs.append(Trajectory.read(path))
    one, several = runs
    for name, values in one.outputs.items():
        np.testing.assert_allclose(several.outputs[name], values, rtol=0, atol=1e-9 * np.abs(values).max())
    np.testing.assert_allclose(several.balance.kinetic, one.balance.kinetic, rtol=1e-8, atol=1e-15)
    np.testing.assert_allclose(several.frames.positions["rod"], one.frames.positions["rod"], atol=1e-12)


def test_samples_in_space_are_dealt_out(mpirun: Callable, tmp_path: Path) -> None:
    paths = []
    for n in (1, 2):
        paths.append(tmp_path / f"many_{n}.h5")
        few = overridden(*FEW[1:], "simulation.duration=0.002")
        mpirun(n, *PGMP, "montecarlo", SCENE, "--full", "-n", 2, "--seed", 3, "-o", paths[-1], *few)
    one, two = (Ensemble.read(path) for path in paths)
    assert not one.status.any() and one.outputs["crank_angle"][0] != one.outputs["crank_angle"][1]
    for name, values in one.outputs.items():
        np.testing.assert_array_equal(two.outputs[name], values)
