"""Beams in space on several ranks: the same full-order runs, models and samples."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from runs import PGMP, overridden

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Trajectory

SCENE = ROOT / "scenes" / "rssr_beams.toml"


@pytest.fixture(scope="module")
def one_rank(mpirun: Callable, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a function that gives what one rank makes of a command's words, made once."""
    directory, made = tmp_path_factory.mktemp("one"), {}

    def make(name: str, *words: object) -> Path:
        if name not in made:
            made[name] = directory / f"{name}.h5"
            mpirun(1, *PGMP, *words, "-o", made[name])
        return made[name]

    return make


def test_ranks_share_a_run(one_rank: Callable, mpirun: Callable, tmp_path: Path) -> None:
    """240 unknowns, the nodes of a beam on different ranks, with damping: measured 1e-12."""
    words = ("simulate", SCENE, "--full", *overridden("simulation.duration=0.02", "simulation.step=1e-3"))
    mpirun(3, *PGMP, *words, "-o", tmp_path / "full.h5")
    one, several = Trajectory.read(one_rank("full", *words)), Trajectory.read(tmp_path / "full.h5")
    for name, values in one.outputs.items():
        np.testing.assert_allclose(several.outputs[name], values, rtol=0, atol=1e-9 * np.abs(values).max())
    np.testing.assert_allclose(several.balance.kinetic, one.balance.kinetic, rtol=1e-8, atol=1e-15)
    np.testing.assert_allclose(several.balance.work["material_damping"], one.balance.work["material_damping"],
                               rtol=1e-6, atol=1e-15)  # fmt: skip


@pytest.mark.parametrize(("n", "per_angle"), [(2, 2), (3, 3)])
def test_models_do_not_depend_on_ranks(one_rank: Callable, mpirun, tmp_path: Path, n: int, per_angle: int) -> None:
    words = ("build", SCENE, *overridden("reduction.angles=8"))
    expected, path = ReducedOrderModel.read(one_rank("rom", *words)), tmp_path / "rom.h5"
    mpirun(n, *PGMP, *words, "--ranks-per-angle", per_angle, "-o", path)
    rom = ReducedOrderModel.read(path)
    for name in ("mass", "stiffness"):
        found, wanted = (getattr(tables, name) for tables in (rom.tables, expected.tables))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-7 * np.abs(wanted).max())
