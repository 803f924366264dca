"""Full-order runs of continuum bodies in space on several ranks: the same motion and the same energies."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from conftest import ROOT
from runs import PGMP, overridden

from pgmp_petsc.results import Trajectory

SCENE = ROOT / "scenes" / "slider_crank_solid3d.toml"
# few steps, with a torque that sets in at once
FEW = (
    "simulation.duration=0.002", "simulation.step=1e-3", "effects.motor.table=[[0.0, 0.0], [0.004, 5.0], [1.0, 5.0]]",
    'outputs.worst={type="stress", body="crank", quantity="von_mises"}',
)  # fmt: skip


def test_ranks_share_a_run(mpirun: Callable, tmp_path: Path) -> None:
    """9,000 unknowns on one rank and on three of four; all waves of the sudden torque are in the outputs."""
    runs = []
    for n in (1, 4):
        path = tmp_path / f"full_{n}.h5"
        mpirun(n, *PGMP, "simulate", SCENE, "--full", "-o", path, *overridden(*FEW))
        runs.append(Trajectory.read(path))
    one, several = runs
    for name, values in one.outputs.items():
        # a deformation of 0.4 um is a difference of places at 1 m, which have 2.2e-16 m in their last digit
        allowed = 1e-9 * np.abs(values).max() + (1e-15 if one.units[name] == "m" else 0.0)
        np.testing.assert_allclose(several.outputs[name], values, rtol=0, atol=allowed)
    np.testing.assert_allclose(several.balance.kinetic, one.balance.kinetic, rtol=1e-8, atol=1e-15)
    np.testing.assert_allclose(several.frames.positions["rod"], one.frames.positions["rod"], atol=1e-12)
    # stresses are derivatives: round-off of the displacements is ten times as large in them
    for name, values in one.fields["crank"].at_nodes.items():
        found = several.fields["crank"].at_nodes[name]
        np.testing.assert_allclose(found, values, rtol=0, atol=1e-8 * np.abs(values).max())


def test_ranks_that_share_a_body_build_its_stresses(mpirun: Callable, tmp_path: Path) -> None:
    """The mesh's displacements are spread over the ranks while the body is condensed."""
    scene, runs = ROOT / "scenes" / "slider_crank_solid2d.toml", []
    small = ("reduction.modes=3", "reduction.angles=8", "simulation.duration=0.02", "simulation.step=1e-3")
    asked = 'outputs.worst={type="stress", body="rod", quantity="von_mises"}'
    for n in (1, 2):
        rom, path = tmp_path / f"rom_{n}.h5", tmp_path / f"run_{n}.h5"
        mpirun(n, *PGMP, "build", scene, "--ranks-per-angle", n, "-o", rom, *overridden(*small, asked))
        mpirun(1, *PGMP, "simulate", rom, "-o", path)
        runs.append(Trajectory.read(path))
    values = runs[0].outputs["worst"]
    # modes of the condensed body are found to 1e-9, and strains are derivatives
    np.testing.assert_allclose(runs[1].outputs["worst"], values, rtol=0, atol=1e-6 * np.abs(values).max())
