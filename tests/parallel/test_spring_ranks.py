"""Springs between nodes that different ranks hold: the same frequencies, remarks and runs on any ranks."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from runs import in_turn, overridden

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


RUN = ("simulate", GEARED[0], "--full", *overridden(*GEARED[1:], "simulation.duration=0.05"), "-o")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Return a function that gives the folder with the tables of all cases on some ranks that share an angle, and a
    run; all of them are made in one start."""

    @cache
    def make(n: int) -> Path:
        folder = tmp_path_factory.mktemp(f"tables_{n}")
        more = ("--angles", 5, "--ranks-per-angle", n, "-o")
        asked = [("modes", scene, *overridden(*entries), *more, folder / f"{name}.h5")
                 for name, (scene, *entries) in CASES.items()]  # fmt: skip
        statuses, done = in_turn(n, [*asked, (*RUN, folder / "run.h5")])
        assert statuses == [[0] * n] * (len(asked) + 1), done.stderr
        return folder

    return make


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("n", [2, 3])
def test_ranks_have_no_part_in_the_frequencies(made: Callable, name: str, n: int) -> None:
    one, several = (ModesTable.read(made(ranks) / f"{name}.h5") for ranks in (1, n))
    assert (one.full_hz[:, 0] < 0.0).any() == (name == "loaded")
    np.testing.assert_allclose(several.full_hz, one.full_hz, rtol=1e-9, atol=1e-9)
    assert several.record.remarks == one.record.remarks


@pytest.mark.parametrize("n", [2, 3])
def test_ranks_have_no_part_in_a_run_on_an_elastic_mesh(made: Callable, n: int) -> None:
    """Of four bodies and a spring between two joints of them."""
    one, several = (Trajectory.read(made(ranks) / "run.h5").outputs for ranks in (1, n))
    for name, values in one.items():
        # what Newton's method leaves
        np.testing.assert_allclose(several[name], values, rtol=0, atol=1e-8 * np.abs(values).max(), err_msg=name)
