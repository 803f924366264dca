"""A build that is killed at any moment and resumed, with another number of ranks too, gives the same file."""

import os
import signal
import subprocess
import time
from functools import reduce
from pathlib import Path

import h5py
import numpy as np
import pytest
import warm_start
from conftest import MPI_ENVIRONMENT, ROOT, TIMEOUT_SECONDS, run_mpi
from runs import overridden, pgmp

TABLES = ("mass", "inertia", "stiffness", "load")
#: Every finished configuration is written at once, and takes a while; after HELD of them a rank waits to be killed.
SLOWLY = """
import itertools, sys, time
from pgmp_petsc.cli.main import main
from pgmp_petsc.reduction import checkpoint
from pgmp_petsc.reduction.sampler import Sampler
checkpoint.INTERVAL = 0.0
sample = Sampler.sample
number = itertools.count()
def slowly(self, *args):
    time.sleep(SECONDS if next(number) < HELD else TIMEOUT)
    return sample(self, *args)
Sampler.sample = slowly
sys.argv[0] = "pgmp"
main()
"""
#: A configuration that is known must not be computed again.
WITHOUT_SAMPLES = """
import sys
from pgmp_petsc.cli.main import main
from pgmp_petsc.components import condensing
from pgmp_petsc.reduction.sampler import Sampler
def refuse(*args, **given):
    raise AssertionError("computed again")
Sampler.sample = condensing.condense = refuse
sys.argv[0] = "pgmp"
main()
"""
SCENES = {
    "beams": (ROOT / "scenes/slider_crank_paper.toml", *overridden("reduction.angles=16")),
    "solids": (ROOT / "scenes/slider_crank_solid2d.toml", *overridden("reduction.angles=12", "reduction.modes=4")),
}
LENGTHS = (
    "ground.points.rail=[0.0, 'h']", "joints.slider.connect=['ground:rail', 'rod:tip']",
    "parameters.h={nominal=0.01, unit='m', bounds=[0.0, 0.02]}", "reduction.length_points=3",
)  # fmt: skip
PART = 'coordinates.theta={joint="crank_hinge", range=[-0.6, 0.7]}', "reduction.angles=5"
SCENES["lengths"] = (*SCENES["solids"], *overridden(*LENGTHS, *PART))
# what takes up nothing of beams', and why
OTHERS = {
    "belongs to another run: its scene differs": (*SCENES["beams"], *overridden("reduction.angles=17")),
    "belongs to another run": (ROOT / "scenes/slider_crank.toml", *overridden("reduction.tolerance=1e-2")),
}


def slowly(seconds: float = 0.0, held: int = 10**6) -> str:
    """Return the script of a build that takes so long for a configuration, and is held after so many on a rank."""
    given = {"SECONDS": seconds, "HELD": held, "TIMEOUT": TIMEOUT_SECONDS}
    return reduce(lambda script, item: script.replace(item[0], str(item[1])), given.items(), SLOWLY)


@pytest.fixture(scope="module")
def whole(folder: Path) -> dict[str, Path]:
    for name, scene in SCENES.items():
        pgmp("build", *scene, "-o", folder / f"{name}.h5")
    return {name: folder / f"{name}.h5" for name in SCENES}


def interrupted(path: Path, scene: tuple[str, ...], n_ranks: int, n_pieces: int) -> None:
    """Start a build and kill it, all of its ranks, as soon as there are so many finished pieces."""
    # together the ranks reach the number of pieces, and are held before all configurations are complete
    script = slowly(seconds=0.15, held=(n_pieces + 3) // n_ranks)
    command = [*warm_start.python(), "-c", script, "build", *map(str, scene), "-o", str(path)]
    if n_ranks > 1:
        command = ["mpirun", "-n", str(n_ranks), *command]
    environment = os.environ | MPI_ENVIRONMENT | {"PYTHONPATH": str(ROOT)}
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, cwd=ROOT, env=environment, start_new_session=True, **silent)
    partial = path.with_name(f"{path.name}.partial")
    try:
        until = time.monotonic() + TIMEOUT_SECONDS
        while len(list(partial.glob("*.npz"))) < n_pieces:
            assert process.poll() is None, "the build ended before it could be killed"
            assert time.monotonic() < until
            time.sleep(0.01)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert not path.exists()


def assert_same(found: Path, expected: Path) -> None:
    # the solver's tolerance is 1e-13
    with h5py.File(found) as one, h5py.File(expected) as other:
        np.testing.assert_array_equal(one["theta"][()], other["theta"][()])
        np.testing.assert_allclose(one["frequencies_hz"][()], other["frequencies_hz"][()], rtol=1e-9)
        for name in TABLES:
            table, like = one[f"tables/{name}"][()], other[f"tables/{name}"][()]
            np.testing.assert_allclose(table, like, rtol=0, atol=1e-8 * np.abs(like).max(initial=0.0), err_msg=name)


@pytest.mark.parametrize(("name", "before", "after", "n_pieces"), [("beams", 1, 3, 4), ("lengths", 2, 1, 9)])
def test_a_killed_build_is_resumed(
    folder: Path, whole: dict[str, Path], name: str, before: int, after: int, n_pieces: int
) -> None:
    path = folder / f"killed_{name}_{before}.h5"
    interrupted(path, SCENES[name], before, n_pieces)
    partial = path.with_name(f"{path.name}.partial")
    stored = {file.name: file.stat().st_mtime_ns for file in partial.glob("*.npz")}
    for said, other in OTHERS.items() if name == "beams" else ():
        refused = pgmp("build", *other, "-o", path, "--resume", status=2).stderr
        assert "--resume:" in refused and said in refused
        assert {file.name: file.stat().st_mtime_ns for file in partial.glob("*.npz")} == stored
    run_mpi(after, "-c", slowly(), "build", *SCENES[name], "-o", path, "--resume")
    assert len(stored) >= n_pieces
    assert_same(path, whole[name])
    assert not partial.exists()


@pytest.mark.parametrize(
    ("name", "last"), [("solids", "continuous_basis.SampleStore.join"), ("lengths", "length_family._joined")]
)
def test_what_is_finished_is_not_computed_again(folder: Path, whole: dict[str, Path], name: str, last: str) -> None:
    path = folder / f"finished_{name}.h5"
    script = slowly().replace(
        "main()\n",
        f"from pgmp_petsc.reduction import {last.split('.')[0]}\ndef stop(*args):\n    raise SystemExit(7)\n"
        f"{last} = stop\nmain()\n",
    )  # fmt: skip
    stopped = run_mpi(1, "-c", script, "build", *SCENES[name], "-o", path, check_status=None)
    assert stopped.returncode != 0 and not path.exists()
    run_mpi(1, "-c", WITHOUT_SAMPLES, "build", *SCENES[name], "-o", path, "--resume")
    assert_same(path, whole[name])


def test_a_build_that_cannot_begin_leaves_nothing(folder: Path) -> None:
    path = folder / "nothing.h5"
    bad = (ROOT / "scenes/slider_crank.toml", "--override", "reduction.modes=500")
    run_mpi(1, "-m", "pgmp_petsc.cli.main", "build", *bad, "-o", path, check_status=2)
    assert not path.with_name(f"{path.name}.partial").exists()
