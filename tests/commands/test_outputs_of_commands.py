"""What commands write, and what they leave alone: inputs, foreign files, the output of another job, a full disk."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import synthetic
import warm_start
from conftest import MPI_ENVIRONMENT, ROOT, run_mpi
from runs import PGMP, besides_progress, one_message, overridden, pgmp
from sealed import resealed

from pgmp_petsc.c_export import fmu
from pgmp_petsc.files import claims
from pgmp_petsc.files.claims import locked
from pgmp_petsc.results import Ensemble

SCENE = ROOT / "scenes" / "slider_crank_paper.toml"
SHORT = overridden("simulation.duration=0.005")
# dies after two pieces of samples, or its disk is full when the third piece is stored
PIECES = """
import os, resource, signal, sys
from pgmp_petsc.ensemble.checkpoint import Checkpoint
add, done, disk = Checkpoint.add, [], resource.RLIMIT_FSIZE
def die(self, piece, batch):
    add(self, piece, batch)
    done.append(piece)
    if len([piece for piece in done if not piece.is_checked]) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
def fill(self, piece, batch):
    done.append(piece)
    limits = resource.getrlimit(disk)
    resource.setrlimit(disk, (600 if len(done) >= 3 else limits[0], limits[1]))
    try:
        add(self, piece, batch)
    finally:
        resource.setrlimit(disk, limits)
Checkpoint.add = globals()[sys.argv[1]]
from pgmp_petsc.cli.main import main
main(sys.argv[2:])
"""
FEW = overridden("simulation.duration=0.005", "ensemble.batch=4")
# every rank works in a directory of its own
APART = """
import os, sys
from mpi4py import MPI
os.makedirs(f"{sys.argv[1]}/{MPI.COMM_WORLD.rank}", exist_ok=True)
os.chdir(f"{sys.argv[1]}/{MPI.COMM_WORLD.rank}")
from pgmp_petsc.cli.main import main
main(sys.argv[2:])
"""


@pytest.fixture
def folder(tmp_path: Path, small_rom: Path) -> Path:
    """Return a directory with a reduced model, a result of every other kind, a scene and its meshes."""
    shutil.copy(small_rom, tmp_path / "rom.h5")
    synthetic.trajectory(n_frames=2).write(tmp_path / "trajectory.h5")
    synthetic.modes_table(n_theta=4).write(tmp_path / "modes.h5")
    (tmp_path / "meshes").mkdir()
    for name in ("crank_5.msh", "rod_5.msh"):
        shutil.copy(ROOT / "meshes" / name, tmp_path / "meshes")
    (tmp_path / "scenes").mkdir()
    shutil.copy(SCENE, tmp_path / "scenes" / "scene.toml")
    return tmp_path


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("arguments", "output", "message"),
    [
        (("simulate", "rom.h5"), "rom.h5", "is what the command reads"),
        (("montecarlo", "rom.h5", "-n", "2"), "rom.h5", "is what the command reads"),
        (("montecarlo", "rom.h5", "-n", "2"), "scenes/../rom.h5", "is what the command reads"),
        (("modes", "scenes/scene.toml", "--rom", "rom.h5"), "rom.h5", "is what the command reads"),
        (("build", "scenes/scene.toml"), "scenes/scene.toml", "is what the command reads"),
        (("tradeoff", "scenes/scene.toml"), "scenes/scene.toml", "is what the command reads"),
        (("simulate", "scenes/scene.toml", "--full"), "scenes/scene.toml", "is what the command reads"),
        (("build", "scenes/scene.toml"), "meshes/crank_5.msh", "the ending .msh is that of another format"),
        (("build", "scenes/scene.toml"), "trajectory.h5", "holds a trajectory, not a reduced model"),
        (("simulate", "rom.h5"), "x.xdmf", "the ending .xdmf is that of another format"),
        (("export", "trajectory.h5"), "trajectory.h5", "is what the command reads"),
        (("export", "trajectory.h5"), "meshes/rod_5.msh", "the ending .msh is that of another format"),
        (("export", "trajectory.h5"), "modes.h5", "name it"),
        (("export", "modes.h5"), ".", "has no frames, a trajectory has; a table of it is written as -o NAME.csv"),
        (("simulate", "scenes/scene.toml"), "x.h5", "-o ROM.h5', or give --components, or for runs and samples --full"),
        (
            ("report", "scenes/scene.toml"),
            "x.html",
            "make it of the scene with 'pgmp build scenes/scene.toml -o ROM.h5'\n",
        ),
    ],
)
def test_nothing_else_is_overwritten(
    folder: Path, arguments: tuple[str, ...], output: str, message: str, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(folder)
    before = contents(folder)
    assert message in one_message(*arguments, "-o", output)
    assert contents(folder) == before


def test_pictures_of_somebody_else_are_not_overwritten(folder: Path, undrawn: None) -> None:
    (folder / "frequencies.png").write_bytes(b"a photograph")
    refused = one_message("plot", folder / "modes.h5", "-o", folder)
    assert "frequencies.png' exists and is not a picture of this program" in refused
    assert (folder / "frequencies.png").read_bytes() == b"a photograph"
    (folder / "frequencies.png").unlink()
    for _ in range(2):  # ours may be drawn, run and exported again
        pgmp("plot", folder / "modes.h5", "-o", folder)
        pgmp("simulate", folder / "rom.h5", *SHORT, "-o", folder / "run.h5")
        pgmp("export", folder / "trajectory.h5", "-o", folder / "run.xdmf")


def test_models_for_other_programs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fmu, "PLATFORMS", {})  # none is compiled for
    twice = 2 * [("model/", "--override", "simulation.step=5e-4"), ("model.fmu",)]
    said = "".join(pgmp("export", folder / "rom.h5", "-o", folder / name, *given).stdout for name, *given in twice)
    assert "C99" in said and "FMI 2.0, co-simulation and model exchange, sources" in said and "error estimates" in said
    assert "#define STEP 0.0005" in (folder / "model" / "sizes.h").read_text()


def test_a_second_job_with_the_same_output_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claims, "PATIENCE", 0.0)
    outputs = {
        "build": (SCENE,), "modes": (SCENE,), "tradeoff": (SCENE,), "simulate": (folder / "rom.h5",),
        "montecarlo": (folder / "rom.h5", "-n", 2),
    }  # fmt: skip
    before = contents(folder)
    with locked(folder / "x.h5"):
        for command, arguments in outputs.items():
            refused = one_message(command, *arguments, "-o", folder / "x.h5")
            assert f"x.h5' is being written by another job (process {os.getpid()} on " in refused
    assert contents(folder) == before


def test_a_second_job_is_refused_on_two_ranks(folder: Path) -> None:
    with locked(folder / "x.h5"):
        done = run_mpi(2, *PGMP, "montecarlo", folder / "rom.h5", "-n", 5, "-o", folder / "x.h5", check_status=2)
    assert done.stderr.count("is being written by another job") == 1
    assert not (folder / "x.h5.partial").exists()


def child(*words: object, **options: object) -> subprocess.CompletedProcess:
    command = [*warm_start.python(), *map(str, words)]
    return subprocess.run(command, text=True, env=os.environ | MPI_ENVIRONMENT, **options)


def killed_ensemble(folder: Path) -> list[object]:
    """Kill an ensemble of 20 samples after two of its pieces; return the command that takes it up."""
    command = ["montecarlo", folder / "rom.h5", "-n", 20, *FEW, "-o", folder / "e.h5"]
    assert child("-c", PIECES, "die", *command).returncode == -9 and not (folder / "e.h5").exists()
    return [*command, "--resume"]


def test_samples_of_two_reduced_models_are_not_mixed(folder: Path) -> None:
    """The scenes of both are equal to the letter."""
    again = killed_ensemble(folder)
    with resealed(folder / "rom.h5") as file:
        file["tables/mass"][...] *= 1.0 + 1e-9
    assert "e.h5.partial' belongs to another run: its reduced model differs" in pgmp(*again, status=2).stderr


def test_a_damaged_piece_is_told_and_computed_again(folder: Path) -> None:
    again = killed_ensemble(folder)
    piece = max((folder / "e.h5.partial").glob("samples_*.npz"))
    piece.write_bytes(piece.read_bytes()[:-100])
    out = pgmp(*again).stdout
    note = f"note: piece '{piece}' was not taken up, and is computed again: it is cut off after"
    assert note in out
    found = Ensemble.read(folder / "e.h5")
    assert any(note in str(remark) for remark in found.record.remarks)
    pgmp(*(word for word in again if word != "--resume"))
    np.testing.assert_array_equal(found.outputs["crank_angle"], Ensemble.read(folder / "e.h5").outputs["crank_angle"])
    assert not (folder / "e.h5.partial").exists()


def test_a_folder_of_somebody_else_is_not_removed(folder: Path) -> None:
    (folder / "x.h5.partial").mkdir()
    (folder / "x.h5.partial" / "thesis.tex").write_text("mine")
    for command in (("build", SCENE), ("montecarlo", folder / "rom.h5", "-n", 2)):
        refused = one_message(*command, "-o", folder / "x.h5")
        assert "x.h5.partial' is in the way of this run's checkpoint" in refused
    assert (folder / "x.h5.partial" / "thesis.tex").read_text() == "mine"


def test_ranks_in_different_directories_build_and_resume(tmp_path: Path) -> None:
    """The paths of the first rank count; nobody waits for a rank that sees other files."""
    build = ("build", SCENE, *overridden("reduction.modes=3", "reduction.angles=8"), "-o", "rom.h5", "--resume")
    for _ in range(2):
        run_mpi(2, "-c", APART, tmp_path, *build)
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == ["rom.h5"]
    assert (tmp_path / "0" / "rom.h5").exists()


@pytest.mark.parametrize("command", ["info", "simulate"])
def test_a_full_disk_under_standard_output_is_one_message_and_a_reader_that_has_gone_no_error(
    folder: Path, command: str
) -> None:
    """Neither Python's, nor PETSc's, which has started where something is computed."""
    options = () if command == "info" else (*SHORT, "-o", folder / "run.h5")
    with open("/dev/full", "w") as full:
        done = child(*PGMP, command, folder / "rom.h5", *options, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 1 and "standard output: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr
    assert command == "info" or (folder / "run.h5").exists()
    read, write = os.pipe()
    os.close(read)
    done = child(*PGMP, command, folder / "rom.h5", *options, stdout=write, stderr=subprocess.PIPE)
    os.close(write)
    assert (done.returncode, besides_progress(done.stderr)) == (0, "")


def test_a_run_on_a_full_disk_keeps_its_pieces(folder: Path) -> None:
    """A limit of the size of files stands for the disk."""
    command = ("montecarlo", folder / "rom.h5", "-n", 20, *FEW, "-o", folder / "e.h5")
    done = child("-c", PIECES, "fill", *command, capture_output=True)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "could not be written: File too large" in done.stderr and "with --resume goes on" in done.stderr
    pgmp(*command, "--resume")
    assert len(Ensemble.read(folder / "e.h5").status) == 20
