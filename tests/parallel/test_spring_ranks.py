"""Springs between nodes that different ranks hold: the same frequencies, remarks and runs on any ranks."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from runs import PGMP, overridden

from pgmp_petsc.results import ModesTable, Trajectory

# from the ground to the rod's tip, from the crank to the rod, about the elbow, and a toggle of negative stiffness
PLANE = (
    ROOT / "scenes" / "slider_crank_effects.toml",
    "effects.buffer.stiffness=2e4",
    'effects.mount={type="bushing",points=["crank:middle","rod:middle"],reference=[[1.0,0.3]],stiffness=[1e4,3e3],'
    "turning_stiffness=[20.0]}",
    'effects.turn={type="spring_damper",joint="elbow",stiffness=-3.0}',
)
SPACE = (
    ROOT / "scenes" / "rssr_beams.toml",
    'effects.mount={type="bushing",points=["crank:tip","rocker:tip"],reference=[[1.0,0.0,0.0],[0.0,1.0,0.0]],'
    "stiffness=[1e3,2e3,3e3],turning_stiffness=[2.0,3.0,4.0]}",
)
GEARED = (ROOT / "scenes" / "geared_five_bar.toml", "joints.mesh.elastic={stiffness=3e3,damping=1.0}")
CASES = {"plane": PLANE, "loaded": (*PLANE, "reduction.preload=true"), "space": SPACE, "geared": GEARED}


@pytest.fixture(scope="module")
def table(mpirun: Callable, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int, int], ModesTable]:
    """Return a function that gives the table of a case on some ranks, made once."""
    directory = tmp_path_factory.mktemp("tables")

    def make(name: str, n: int, per_angle: int) -> ModesTable:
        path, (scene, *entries) = directory / f"{name}_{n}_{per_angle}.h5", CASES[name]
        if not path.exists():
            words = (scene, *overridden(*entries), "--angles", 5, "--ranks-per-angle", per_angle)
            mpirun(n, *PGMP, "modes", *words, "-o", path)
        return ModesTable.read(path)

    return make


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(("n", "per_angle"), [(2, 2), (3, 3)])
def test_ranks_have_no_part_in_the_frequencies(table: Callable, name: str, n: int, per_angle: int) -> None:
    one, several = table(name, 1, 1), table(name, n, per_angle)
    assert (one.full_hz[:, 0] < 0.0).any() == (name == "loaded")
    np.testing.assert_allclose(several.full_hz, one.full_hz, rtol=1e-9, atol=1e-9)
    assert several.record.remarks == one.record.remarks


def test_ranks_have_no_part_in_a_run_on_an_elastic_mesh(mpirun: Callable, tmp_path: Path) -> None:
    """Of four bodies, each on a rank, and a spring between two joints of them."""
    scene, *entries = GEARED
    runs = []
    for n in (1, 3):
        path = tmp_path / f"{n}.h5"
        words = (scene, "--full", *overridden(*entries, "simulation.duration=0.05"))
        mpirun(n, *PGMP, "simulate", *words, "-o", path)
        runs.append(Trajectory.read(path).outputs)
    for name, values in runs[0].items():
        # what Newton's method leaves
        np.testing.assert_allclose(runs[1][name], values, rtol=0, atol=1e-8 * np.abs(values).max(), err_msg=name)
