"""Outputs: what may be replaced, what never is, and one job at a time."""

import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import pytest
import synthetic
from conftest import TIMEOUT_SECONDS
from mpi4py import MPI
from refusals import assert_refused, refusal

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.files import claims
from pgmp_petsc.files.claims import check_output, claimed, lock_path, locked, partial_path
from pgmp_petsc.files.hdf5 import RunRecord, write_file

HOLD = """
import sys, time
from pathlib import Path
from pgmp_petsc.files.claims import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""
# takes the lock as often as it can and counts how many have it at the same time
COMPETE = """
import sys, time
from pathlib import Path
from pgmp_petsc.files import claims
from pgmp_petsc.files.claims import locked
claims.PATIENCE = 600.0
output, inside = Path(sys.argv[1]), Path(sys.argv[1] + ".inside")
for _ in range(40):
    with locked(output):
        inside.open("x").close()
        time.sleep(0.001)
        inside.unlink()
"""


@pytest.fixture
def result(tmp_path: Path) -> Path:
    synthetic.modes_table(n_theta=4).write(tmp_path / "modes.h5")
    return tmp_path / "modes.h5"


def test_a_new_file_and_a_result_of_the_same_kind_may_be_written(result: Path) -> None:
    assert check_output(result, "modes") == result.resolve()
    assert check_output(result.with_name("new.h5"), "rom") == result.resolve().with_name("new.h5")
    result.with_name("empty.h5").touch()
    check_output(result.with_name("empty.h5"), "rom")


@pytest.mark.parametrize("name", ["f", "f.h5", "f.HDF5", "f.hdf", "f.17", "f.first", "f 2.h5"])
def test_endings_that_say_nothing_else(tmp_path: Path, name: str) -> None:
    check_output(tmp_path / name, "rom")


@pytest.mark.parametrize("ending", ["csv", "toml", "msh", "xdmf", "png", "CSV", "npz", "partial"])
def test_endings_of_other_formats(tmp_path: Path, ending: str) -> None:
    cure = r"a trajectory is written as HDF5: name it '.*/f\.h5'"
    with pytest.raises(InputError, match=rf"the ending \.{ending} is that of another format; {cure}"):
        check_output(tmp_path / f"f.{ending}", "trajectory")


def test_endings_of_other_outputs(tmp_path: Path) -> None:
    check_output(tmp_path / "f.xdmf", "xdmf")
    with pytest.raises(InputError, match=r"an XDMF description is written as XDMF: name it '.*f\.xdmf'"):
        check_output(tmp_path / "f.h5", "xdmf")


@pytest.mark.parametrize("other", ["same", "symlink", "hard link", "relative"])
def test_what_is_read_is_not_written(result: Path, other: str, monkeypatch: pytest.MonkeyPatch) -> None:
    link = result.with_name("link.h5")
    if other == "symlink":
        link.symlink_to(result)
    elif other == "hard link":
        os.link(result, link)
    elif other == "relative":
        monkeypatch.chdir(result.parent)
        link = Path("..", result.parent.name, result.name)
    else:
        link = result
    assert_refused("is what the command reads", check_output, link, "modes", (None, "nowhere", result))


@pytest.mark.parametrize("content", [b"[scene]\n", b"\x89HDF\r\n\x1a\n and so on", b"$MeshFormat", b"pgmp"])
def test_what_is_no_result_is_not_replaced(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "f.h5").write_bytes(content)
    with pytest.raises(InputError, match="exists and is not a reduced model of this program; give another name"):
        check_output(tmp_path / "f.h5", "rom")
    with pytest.raises(InputError, match="exists and is not"), write_file(tmp_path / "f.h5", "rom"):
        pass
    assert (tmp_path / "f.h5").read_bytes() == content


def test_hdf5_of_another_program_is_not_replaced(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["measured"] = [1.0]
    assert_refused("exists and is not a table of modes of this program", check_output, tmp_path / "f.h5", "modes")


def test_a_result_of_another_kind_is_not_replaced(result: Path) -> None:
    before = result.read_bytes()
    assert_refused("exists and holds a table of modes, not an ensemble", check_output, result, "ensemble")
    with pytest.raises(InputError, match="exists and holds a table of modes"), write_file(result, "rom"):
        pass
    assert result.read_bytes() == before


def test_results_that_have_to_be_written_again_are_replaced(result: Path) -> None:
    """A damaged one, one that was cut off, and one of a version without seals."""
    whole = result.read_bytes()
    for content in (b"x" + whole[1:], whole[:300], whole[512:], whole[:-1]):
        result.write_bytes(content)
        check_output(result, "modes")


def test_other_outputs_are_replaced_where_they_are_ours(tmp_path: Path) -> None:
    for kind, name, ours in (
        ("xdmf", "f.xdmf", b"<Xdmf><!-- written by pgmp_petsc 1 --></Xdmf>"),
        ("picture", "f.png", b"\x89PNG... Software\0pgmp_petsc 1"),
        ("scaling", "f.json", b'{"factorisations": 3}'),
        ("beams", "f.json", b'{"differences": []}'),
    ):
        (tmp_path / name).write_bytes(ours)
        check_output(tmp_path / name, kind)
        (tmp_path / name).write_bytes(b"<Xdmf/> of somebody else")
        assert_refused("exists and is not an? .* of this program", check_output, tmp_path / name, kind)


def test_directories_that_cannot_be_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # root may write anywhere, so the system's answer is replaced
    monkeypatch.setattr(claims.os, "access", lambda path, mode: False)
    assert_refused("no permission to write in directory", check_output, tmp_path / "f.h5", "rom")


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("nowhere/f.h5", "nowhere' does not exist; create it"), ("file/f.h5", "cannot be written: Not a directory"),
        (".", "is a directory; give the name of a file in it"), ("ä" * 125, "its name has 250 bytes; allowed: 239"),
        ("x" * 300, "File name too long"), ("/".join(["x" * 200] * 30), "File name too long"),
        ("a", "Too many levels of symbolic links"), ("pipe", "is a device, a pipe or a socket"),
        ("socket", "is a device, a pipe or a socket"), ("/dev/null", "is a device, a pipe or a socket"),
    ],
    ids=lambda text: text[:30],
)  # fmt: skip
def test_places_where_no_result_can_be(path: str, said: str, tmp_path: Path) -> None:
    check_output(tmp_path / ("x" * 230), "rom")
    (tmp_path / "file").touch()
    for one, other in ("ab", "ba"):
        (tmp_path / one).symlink_to(tmp_path / other)
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        assert said in refusal(check_output, tmp_path / path, "rom")


def test_a_working_directory_that_was_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert_refused("the working directory, or that of the output, was removed", check_output, "f.h5", "rom")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="takes Linux's folder in which no file can be made")
def test_a_folder_in_which_no_file_can_be_made() -> None:
    assert_refused("no file can be made in the folder '/proc'", lambda: locked(Path("/proc/f.h5")).__enter__())


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claims, "PATIENCE", 0.1)


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Return a process that has the lock on f.h5."""
    command = [sys.executable, "-c", HOLD, tmp_path / "f.h5"]
    environment = os.environ | {"SLURM_JOB_ID": "4711"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_a_claim_is_released_at_the_end_and_after_an_error(tmp_path: Path) -> None:
    for error in (KeyError, RuntimeError):
        with pytest.raises(error), claimed(MPI.COMM_SELF, tmp_path / "f.h5", "rom") as target:
            assert target == tmp_path.resolve() / "f.h5" and lock_path(target).exists()
            raise error
        assert not any(tmp_path.iterdir())


def test_a_second_job_is_refused(tmp_path: Path, holder: subprocess.Popen[str], impatient: None) -> None:
    owner = rf"another job \(job 4711, process {holder.pid} on {socket.gethostname()}, since 20"
    with pytest.raises(InputError, match=f"is being written by {owner}"):
        with claimed(MPI.COMM_SELF, tmp_path / "f.h5", "rom"):
            pass
    (tmp_path / "link.h5").symlink_to(tmp_path / "f.h5")
    with pytest.raises(InputError, match=owner), claimed(MPI.COMM_SELF, tmp_path / "link.h5", "rom"):
        pass


def test_an_owner_that_does_not_say_its_name(tmp_path: Path, holder: subprocess.Popen[str], impatient: None) -> None:
    lock_path(tmp_path / "f.h5").write_text("[1")
    with pytest.raises(InputError, match=r"is being written by another job \(see '.*\.f\.h5\.lock'\)"):
        with locked(tmp_path / "f.h5"):
            pass


def test_a_dead_owner_s_lock_is_taken_over(tmp_path: Path, holder: subprocess.Popen[str], impatient: None) -> None:
    holder.kill()
    holder.wait()
    assert json.loads(lock_path(tmp_path / "f.h5").read_text())["pid"] == holder.pid
    begun, other = (partial_path(tmp_path / "f.h5", process) for process in (holder.pid, os.getpid()))
    for partial in (begun, other):  # what it was writing, and what somebody else is
        partial.write_text("")
    with locked(tmp_path / "f.h5"):
        assert json.loads(lock_path(tmp_path / "f.h5").read_text())["pid"] == os.getpid()
    assert list(tmp_path.iterdir()) == [other]


def test_a_job_that_is_about_to_end_is_waited_for(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    ending = threading.Timer(0.2, holder.kill)
    ending.start()
    with locked(tmp_path / "f.h5"):
        ending.join()


def test_of_many_successors_one_at_a_time_has_the_lock(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    """Four processes take over a dead owner's lock at once, and then 40 times from each other."""
    others = [subprocess.Popen([sys.executable, "-c", COMPETE, tmp_path / "f.h5"]) for _ in range(4)]
    time.sleep(1.0)
    holder.kill()
    assert [process.wait(timeout=TIMEOUT_SECONDS) for process in others] == [0, 0, 0, 0]
    assert not any(tmp_path.iterdir())


def test_a_lock_that_cannot_be_made(tmp_path: Path) -> None:
    lock_path(tmp_path / "f.h5").mkdir()
    with pytest.raises(InputError, match="cannot be locked: Is a directory"):
        with claimed(MPI.COMM_SELF, tmp_path / "f.h5", "rom"):
            pass


def test_a_file_system_without_locks_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(claims.errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(claims.fcntl, "flock", refuse)
    with claimed(MPI.COMM_SELF, tmp_path / "f.h5", "rom"):
        assert "f.h5' has no locks: no other job may write the same output" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_a_result_is_written_under_its_own_claim(tmp_path: Path) -> None:
    with claimed(MPI.COMM_SELF, tmp_path / "f.h5", "modes") as target, write_file(target, "modes") as file:
        RunRecord("", {}, None, 1).write(file)
    assert [path.name for path in tmp_path.iterdir()] == ["f.h5"]
