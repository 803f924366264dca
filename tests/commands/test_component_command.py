"""``--components`` of simulate and montecarlo, as users type it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from runs import PAPER_SCENE, PGMP, overridden, pgmp

from pgmp_petsc.results import Ensemble, Trajectory

QUICK = overridden("reduction.modes=3", "simulation.duration=0.02")


def test_a_run_and_its_picture(tmp_path: Path) -> None:
    found, full = tmp_path / "components.h5", tmp_path / "full.h5"
    said = pgmp("simulate", PAPER_SCENE, "--components", *QUICK, "-o", found).stdout
    assert "components model" in said
    assert "errors of the component modes (" in said and "left out: what is of second order" in said
    pgmp("simulate", PAPER_SCENE, "--full", *QUICK, "-o", full)
    one, other = Trajectory.read(found), Trajectory.read(full)
    assert one.model == "components"
    assert one.outputs["crank_angle"][-1] == pytest.approx(other.outputs["crank_angle"][-1], rel=1e-4)
    assert "of the components model" in pgmp("info", found).stdout
    pgmp("plot", found, full, "-o", tmp_path / "pictures")
    assert (tmp_path / "pictures" / "trajectories.png").exists()


@pytest.mark.parametrize("ranks", [2, 3])
def test_ensembles_are_the_same_on_any_number_of_ranks(ranks: int, tmp_path: Path, mpirun: Callable) -> None:
    job = ("montecarlo", PAPER_SCENE, "--components", "-n", 6, *QUICK, *overridden("ensemble.batch=2"), "-o")
    pgmp(*job, tmp_path / "one.h5")
    mpirun(ranks, *PGMP, *job, tmp_path / "several.h5")
    one, several = (Ensemble.read(tmp_path / name) for name in ("one.h5", "several.h5"))
    assert one.model == several.model == "components"
    for name, values in one.outputs.items():
        np.testing.assert_array_equal(several.outputs[name], values)


LOOSE = (
    'bodies.loose={line={length=0.1, elements=1}, element="beam2d", material="steel", '
    'section={shape="circle", radius=5e-3}, placement={origin=[2.0, 0.0]}}'
)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("simulate", PAPER_SCENE, "--components", "--full"), "--full and --components: two models; give one of them"),
        (
            ("montecarlo", PAPER_SCENE, "--components", "-n", 2, "--ranks-per-sample", 2),
            "--ranks-per-sample = 2: samples of component modes are small",
        ),
        (("simulate", PAPER_SCENE, "--components", *overridden(LOOSE)), "bodies.loose: no joint connects it with"),
    ],
)
def test_what_is_refused(arguments: tuple, message: str, tmp_path: Path) -> None:
    output = tmp_path / "out.h5"
    done = pgmp(*arguments, "-o", output, status=2)
    assert message in done.stderr and "Traceback" not in done.stderr
    assert not output.exists()
