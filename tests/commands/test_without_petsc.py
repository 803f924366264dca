"""A Python without PETSc, SLEPc and MPI: the same numbers bit for bit, and one message where they are needed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import warm_start
from conftest import MPI_ENVIRONMENT, ROOT, TIMEOUT_SECONDS, run_mpi
from mpi4py import MPI
from result_files import KINDS, ONE_BY_ONE, assert_same, in_turn, statuses, written_by_commands
from runs import besides_progress

from pgmp_petsc.cli.declared import Session
from pgmp_petsc.cli.main import pgmp

LAUNCHER = ROOT / "tests" / "without_petsc.py"
SOLIDS = str(ROOT / "scenes" / "slider_crank_solid2d.toml")


def pages(results: Path, folder: Path) -> list[list[str]]:
    files = [str(results / f"{kind}.h5") for kind in ("rom", "run", "ensemble")]
    return [["plot", *files[1:], "-o", str(folder)], ["report", *files, "-o", str(folder / "report.html")]]


@pytest.fixture(scope="module")
def without(commands: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what the commands write there, and how they show what others have written."""
    folder = tmp_path_factory.mktemp("without_petsc")
    return written_by_commands(folder, LAUNCHER, further=pages(commands, folder / "shown"))


@pytest.mark.parametrize("kind", [*KINDS, "full"])
def test_files_are_the_same(kind: str, commands: Path, without: Path) -> None:
    assert_same(commands / f"{kind}.h5", without / f"{kind}.h5")


def test_pages_and_pictures_are_the_same(commands: Path, without: Path, tmp_path: Path) -> None:
    for call in pages(commands, tmp_path):
        pgmp.main(call, standalone_mode=False, obj=Session(MPI.COMM_SELF))
    places = (tmp_path, without / "shown")
    ours, theirs = ({path.name: path.read_bytes() for path in place.iterdir()} for place in places)
    assert ours == theirs and {"report.html", "trajectories.png", "densities.png"} <= ours.keys()


def test_what_needs_petsc_says_so(commands: Path, tmp_path: Path) -> None:
    """One message with what needs it, what is missing and the cure; nothing is written."""
    out, rom = str(tmp_path / "F.h5"), str(commands / "rom.h5")
    bodies = "eigenproblems of many unknowns or on several ranks, and bodies of continuum elements"
    refused = {
        bodies: ["build", SOLIDS, "-o", out],
        f"{bodies} ": ["check", SOLIDS, "--trial"],
        "full-order runs of large meshes, from equilibrium or on several ranks": [
            "simulate", str(ROOT / "scenes" / "slider_crank_solid3d.toml"), "--full", "-o", out,
        ],
        "options after '--' (-pgmp_ts_ts_monitor)": ["simulate", rom, "-o", out, "--", "-pgmp_ts_ts_monitor"],
    }  # fmt: skip
    done = in_turn(list(refused.values()), LAUNCHER)
    assert statuses(done) == [2] * len(refused), done.stdout + done.stderr
    messages = besides_progress(done.stderr).splitlines()
    for what, message in zip(refused, messages, strict=True):
        absent = "this Python has no petsc4py, slepc4py, mpi4py; "
        assert message.startswith(f"pgmp: error: {what.strip()} need PETSc and SLEPc, and {absent}")
        assert "docs/without_petsc.md" in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rank", ["0", "1"])
def test_several_processes_that_do_not_know_of_each_other_are_refused(rank: str) -> None:
    """Each would do the whole work and write the same file; the first one alone speaks."""
    done = in_turn([["info", "F.h5"]], LAUNCHER, OMPI_COMM_WORLD_SIZE="3", OMPI_COMM_WORLD_RANK=rank)
    assert statuses(done) == [2]
    said = "pgmp: error: 3 processes were started together, and this Python has no mpi4py, so that none knows of the "
    assert done.stderr == ("" if rank == "1" else f"{said}others; start one, or install mpi4py\n")


def test_with_mpi_alone_several_ranks_share_an_ensemble(
    commands: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REFUSED", "petsc4py,slepc4py")
    words = ("montecarlo", commands / "rom.h5", "-n", 12, "--seed", 7, "-o", tmp_path / "ensemble.h5")
    run_mpi(2, LAUNCHER, "-m", "pgmp_petsc.cli.main", *words)
    assert_same(tmp_path / "ensemble.h5", commands / "ensemble.h5")


CODE = """
import sys, pgmp_petsc as pgmp
rom = pgmp.read(sys.argv[1])
pgmp.simulate(rom, {'r1': 5e-3}).write(sys.argv[2])
for wrong in (lambda: pgmp.simulate(rom, comm=3), lambda: pgmp.build(pgmp.load(sys.argv[3]))):
    try:
        wrong()
    except pgmp.InputError as error:
        print(error)
print('mpi4py' in sys.modules)
"""


def test_the_python_interface(commands: Path, without: Path, tmp_path: Path) -> None:
    words = [*warm_start.python(), LAUNCHER, "-c", CODE, commands / "rom.h5", tmp_path / "run.h5", SOLIDS]
    environment = os.environ | MPI_ENVIRONMENT | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, capture_output=True, text=True, env=environment, timeout=TIMEOUT_SECONDS, check=True)
    of_ranks, of_bodies, loaded = done.stdout.splitlines()
    assert of_ranks.startswith("comm = 3: allowed is ") and "need PETSc and SLEPc" in of_bodies and loaded == "False"
    assert_same(tmp_path / "run.h5", commands / "run.h5")


def test_without_extras_what_was_built_runs(commands: Path, tmp_path: Path) -> None:
    """A wheel without extras; what needs one says which, with exit status 2 and without a traceback."""
    rom, run, out = commands / "rom.h5", commands / "run.h5", tmp_path / "out"
    calls = {
        f"simulate {rom} -o {out}.h5": "", f"montecarlo {rom} -n 8 -o {out}s.h5": "", f"info {rom}": "",
        f"plot {run} -o {out}": "matplotlib, which is not installed: pip install 'pgmp_petsc[plot]'",
        f"report {run} -o {out}.html": "matplotlib, which is not installed: pip install 'pgmp_petsc[plot]'",
        f"check {SOLIDS}": "meshio, which is not installed: pip install 'pgmp_petsc[mesh]'",
    }  # fmt: skip
    refused = "matplotlib,mpl_toolkits,pyvista,vtk,jinja2,meshio,skfem,imageio_ffmpeg,pandas,SALib,xarray"
    words = json.dumps([call.split() for call in calls])
    # a warm start has some of them loaded
    done = subprocess.run(
        [sys.executable, str(LAUNCHER), "-c", ONE_BY_ONE, words], capture_output=True, text=True,
        env=os.environ | {"REFUSED": refused, "PYTHONPATH": str(ROOT)}, timeout=TIMEOUT_SECONDS,
    )  # fmt: skip
    assert statuses(done) == [2 if lacks else 0 for lacks in calls.values()], done.stderr
    messages = besides_progress(done.stderr).splitlines()
    assert messages == [f"pgmp: error: this needs {lacks}" for lacks in calls.values() if lacks]
