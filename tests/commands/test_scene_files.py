"""Scene and mesh files that are none, and warnings of `pgmp check` and in results."""

import os
import resource
from pathlib import Path

import h5py
import pytest
from runs import one_message, overridden, pgmp, said

from pgmp_petsc.files.seal import SIGNATURE, SIZE

SCENE = Path(__file__).resolve().parents[2] / "scenes" / "slider_crank.toml"
UNUSED = "parameters.q={nominal=1.0}"


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
        ("pipe.toml", "a device or a pipe"), ("/dev/zero", "a device or a pipe"), (".", "this is a directory"),
        ("loop.toml", "cannot be read"), ("x" * 300 + ".toml", "cannot be read (File name too long)"),
        ("bytes.toml", "not a text file in UTF-8"), ("plain.h5", "an HDF5 file"), ("sealed.h5", "an HDF5 file"),
        ("long.toml", "16,000,002 bytes"), ("deep.toml", "deeper than 16"), ("tables.toml", "deeper than 16"),
        ("digits.toml", "not valid TOML"), ("words.toml/x", "no such scene file"),
    ],
)  # fmt: skip
def test_no_scene(folder: Path, name: str, words: str) -> None:
    assert words in one_message("check", folder / name)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("{folder}/pipe.msh", "a device or a pipe"), ("/dev/zero", "a device or a pipe"), ("{folder}", "a directory"),
        ("{folder}/words.off", "meshio cannot read this file"), ("x" * 300 + ".msh", "File name too long"),
        ("{folder}/none.msh", "no such file"),
    ],
)  # fmt: skip
def test_no_mesh(folder: Path, name: str, words: str) -> None:
    mesh = f'bodies.crank.mesh="{name.format(folder=folder)}"'
    message = one_message("check", SCENE, *overridden(mesh))
    assert "bodies.crank.mesh" in message and words in message


def test_without_permission(folder: Path) -> None:
    locked = folder / "locked.toml"
    locked.write_text(SCENE.read_text())
    locked.chmod(0)
    if os.access(locked, os.R_OK):
        pytest.skip("this user may read everything")
    assert "cannot be read (Permission denied)" in one_message("check", locked)


def test_null_characters(folder: Path) -> None:
    assert "scene.name: a text with characters" in one_message("check", SCENE, *overridden('scene.name="a\\u0000"'))
    message = one_message("check", SCENE, *overridden('bodies.crank.mesh="a\\u0000.msh"'))
    assert "bodies.crank.mesh: a text with characters" in message


def test_an_editors_mark_of_utf_8(tmp_path: Path) -> None:
    marked = tmp_path / "marked.toml"
    text = SCENE.read_text().replace("../meshes", str(SCENE.parents[1] / "meshes"))
    marked.write_bytes(b"\xef\xbb\xbf" + text.encode())
    pgmp("check", marked)


@pytest.mark.parametrize("entry", ["effects.motor.joint", "a"])
def test_deep_overrides(entry: str) -> None:
    assert "--override" in one_message("check", SCENE, *overridden(f"{entry}=" + "[" * 3000 + "]" * 3000))
    assert "16 deep" in one_message("check", SCENE, *overridden("a." * 3000 + "b=1"))


def test_many_steps_take_no_memory() -> None:
    """The check of 9e7 steps takes less than an array of them, which has 0.7 GB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    pgmp("check", SCENE, *overridden("simulation.step=1.1e-8"))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB


def test_warnings_and_strict() -> None:
    pgmp("check", SCENE, "--strict")
    assert "  warning: parameters.q: nothing uses it" in pgmp("check", SCENE, *overridden(UNUSED)).stdout
    out, err = said("check", SCENE, "--strict", *overridden(UNUSED), status=2)
    assert "  warning: parameters.q: nothing uses it" in out
    assert err.startswith("pgmp: error: ") and "1 warning, see above" in err and "--strict" in err


def test_warnings_are_kept_with_the_result(tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    short = overridden("simulation.duration=0.02", "simulation.step=1e-3", UNUSED)
    out, _ = said("simulate", SCENE, "--full", "-o", run, *short)
    assert "  warning: parameters.q: nothing uses it" in out
    with h5py.File(run) as file:
        assert "parameters.q: nothing uses it" in file.attrs["remarks"]
    assert "warning: parameters.q: nothing uses it" in pgmp("info", run).stdout
