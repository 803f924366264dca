"""Scene and mesh files that are none, and warnings of `pgmp check` and in results."""

import os
import resource
from pathlib import Path

import h5py
import pytest
from runs import overridden

from pgmp_petsc.cli.main import main
from pgmp_petsc.files.seal import SIGNATURE, SIZE

SCENE = Path(__file__).resolve().parents[2] / "scenes" / "slider_crank.toml"
UNUSED = "parameters.q={nominal=1.0}"


def status_of(*arguments: object) -> int:
    """Run a command in this process and return its exit status."""
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code or 0


def message_of(capfd: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Return the one line that a command is refused with."""
    assert status_of(*arguments) == 2
    out, err = capfd.readouterr()
    assert err.startswith("pgmp: error: ") and err.count("\n") == 1 and "Traceback" not in err, err
    return err


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a directory with things that are no scene."""
    os.mkfifo(tmp_path / "pipe.toml")
    os.mkfifo(tmp_path / "pipe.msh")
    (tmp_path / "loop.toml").symlink_to(tmp_path / "loop.toml")
    (tmp_path / "bytes.toml").write_bytes(b"x = '\xff'")
    (tmp_path / "long.toml").write_text("# " + "x" * 16_000_000)
    (tmp_path / "deep.toml").write_text("x = " + "[" * 4000 + "]" * 4000)
    (tmp_path / "tables.toml").write_text("[" + ".".join("a" * 900) + "]\n")
    (tmp_path / "digits.toml").write_text("x = " + "1" * 5000)
    (tmp_path / "plain.h5").write_bytes(SIGNATURE)
    (tmp_path / "sealed.h5").write_bytes(bytes(SIZE) + SIGNATURE)
    (tmp_path / "words.off").write_text("OFF\n1 2 3\n")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("pipe.toml", "a device or a pipe"),
        ("/dev/zero", "a device or a pipe"),
        (".", "this is a directory"),
        ("loop.toml", "cannot be read"),
        ("x" * 300 + ".toml", "cannot be read (File name too long)"),
        ("bytes.toml", "not a text file in UTF-8"),
        ("plain.h5", "an HDF5 file"),
        ("sealed.h5", "an HDF5 file"),
        ("long.toml", "16,000,002 bytes"),
        ("deep.toml", "deeper than 16"),
        ("tables.toml", "deeper than 16"),
        ("digits.toml", "not valid TOML"),
        ("words.toml/x", "no such scene file"),
    ],
)
def test_no_scene(folder: Path, capfd: pytest.CaptureFixture[str], name: str, words: str) -> None:
    assert words in message_of(capfd, "check", folder / name)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("{folder}/pipe.msh", "a device or a pipe"),
        ("/dev/zero", "a device or a pipe"),
        ("{folder}", "a directory"),
        ("{folder}/words.off", "meshio cannot read this file"),
        ("x" * 300 + ".msh", "File name too long"),
        ("{folder}/none.msh", "no such file"),
    ],
)
def test_no_mesh(folder: Path, capfd: pytest.CaptureFixture[str], name: str, words: str) -> None:
    mesh = f'bodies.crank.mesh="{name.format(folder=folder)}"'
    message = message_of(capfd, "check", SCENE, *overridden(mesh))
    assert "bodies.crank.mesh" in message and words in message


def test_without_permission(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    locked = folder / "locked.toml"
    locked.write_text(SCENE.read_text())
    locked.chmod(0)
    if os.access(locked, os.R_OK):
        pytest.skip("this user may read everything")
    assert "cannot be read (Permission denied)" in message_of(capfd, "check", locked)


def test_null_characters(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert "scene.name: a text with characters" in message_of(
        capfd, "check", SCENE, *overridden('scene.name="a\\u0000"')
    )
    message = message_of(capfd, "check", SCENE, *overridden('bodies.crank.mesh="a\\u0000.msh"'))
    assert "bodies.crank.mesh: a text with characters" in message


def test_an_editors_mark_of_utf_8(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    marked = tmp_path / "marked.toml"
    text = SCENE.read_text().replace("../meshes", str(SCENE.parents[1] / "meshes"))
    marked.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert status_of("check", marked) == 0


@pytest.mark.parametrize("entry", ["effects.motor.joint", "a"])
def test_deep_overrides(capfd: pytest.CaptureFixture[str], entry: str) -> None:
    assert "--override" in message_of(capfd, "check", SCENE, *overridden(f"{entry}=" + "[" * 3000 + "]" * 3000))
    assert "16 deep" in message_of(capfd, "check", SCENE, *overridden("a." * 3000 + "b=1"))


def test_many_steps_take_no_memory(capfd: pytest.CaptureFixture[str]) -> None:
    """The check of 9e7 steps takes less than an array of them, which has 0.7 GB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert status_of("check", SCENE, *overridden("simulation.step=1.1e-8")) == 0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB


def test_warnings_and_strict(capfd: pytest.CaptureFixture[str]) -> None:
    assert status_of("check", SCENE, "--strict") == 0
    capfd.readouterr()
    assert status_of("check", SCENE, *overridden(UNUSED)) == 0
    assert "  warning: parameters.q: nothing uses it" in capfd.readouterr().out
    assert status_of("check", SCENE, "--strict", *overridden(UNUSED)) == 2
    out, err = capfd.readouterr()
    assert "  warning: parameters.q: nothing uses it" in out
    assert err.startswith("pgmp: error: ") and "1 warning, see above" in err and "--strict" in err


def test_warnings_are_kept_with_the_result(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run.h5"
    short = overridden("simulation.duration=0.02", "simulation.step=1e-3", UNUSED)
    assert status_of("simulate", SCENE, "--full", "-o", run, *short) == 0
    assert "  warning: parameters.q: nothing uses it" in capfd.readouterr().out
    with h5py.File(run) as file:
        assert "parameters.q: nothing uses it" in file.attrs["remarks"]
    assert status_of("info", run) == 0
    assert "warning: parameters.q: nothing uses it" in capfd.readouterr().out
