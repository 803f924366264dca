"""The cache of compiled functions: its loss costs time, never a run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, TIMEOUT_SECONDS

SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
from kernel import double
from pgmp_petsc.runtime.compiled import cache_problem
print(double(int(sys.argv[2])), double(0.5), cache_problem())
"""
KERNEL = """
from pgmp_petsc.runtime.compiled import njit

@njit(cache=True, error_model="numpy")
def double(x):
    return 2 * x
"""


@pytest.fixture
def module(tmp_path: Path) -> Path:
    """Return a folder with a compiled function, and an empty one for its cache."""
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "kernel.py").write_text(KERNEL)
    (tmp_path / "cache").mkdir()
    return tmp_path


def run(module: Path, *arguments: object, **environment: str) -> subprocess.Popen[str]:
    """Start a process that calls the function with an integer and a real number."""
    command = [sys.executable, "-c", SCRIPT, str(module / "source"), *map(str, arguments)]
    given = os.environ | {"NUMBA_CACHE_DIR": str(module / "cache"), "PYTHONPATH": str(ROOT)} | environment
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=given)


def printed(module: Path, **environment: str) -> str:
    """Return what one process printed; it must end well."""
    process = run(module, 3, **environment)
    out, err = process.communicate(timeout=TIMEOUT_SECONDS)
    assert process.returncode == 0 and err == "", err
    return out.strip()


def files(module: Path, ending: str) -> list[Path]:
    """Return the files of the cache."""
    return sorted((module / "cache").rglob(f"*.{ending}"))


def test_what_is_compiled_is_kept(module: Path) -> None:
    assert printed(module) == "6 1.0 None"
    before = [path.stat().st_mtime_ns for path in files(module, "nbc")]
    assert len(before) == 2
    assert printed(module) == "6 1.0 None"
    assert [path.stat().st_mtime_ns for path in files(module, "nbc")] == before


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [b"", b"\x80\x05garbage", b"\x00" * 400])
def test_damaged_files_are_written_anew(module: Path, ending: str, damage: bytes) -> None:
    printed(module)
    for path in files(module, ending):
        path.write_bytes(damage)
    assert printed(module).startswith("6 1.0 damaged files in ")
    assert printed(module) == "6 1.0 None"


def test_without_a_folder_that_can_be_written(module: Path) -> None:
    """Root may write everywhere, so a file stands where the folders would be."""
    (module / "file").write_text("")
    blocked = str(module / "file" / "cache")
    nowhere = {"NUMBA_CACHE_DIR": blocked, "NUMBA_CACHE_LOCATOR_CLASSES": "_UserProvidedCacheLocator"}
    found = printed(module, **nowhere)
    assert found.startswith("6 1.0 compiled code is not kept, and every run compiles")
    assert found.endswith("set NUMBA_CACHE_DIR to a folder with space that can be written")


def test_on_a_full_disk(module: Path) -> None:
    """A folder in the place of the index lets the same call fail as a full disk does."""
    printed(module)
    for path in files(module, "nbi"):
        path.unlink()
        path.mkdir()
    assert printed(module).startswith("6 1.0 ")


def test_processes_that_compile_at_once(module: Path) -> None:
    started = [run(module, k) for k in range(4)]
    for k, process in enumerate(started):
        out, err = process.communicate(timeout=TIMEOUT_SECONDS)
        assert (process.returncode, out.split()[:2]) == (0, [str(2 * k), "1.0"]), err
    assert printed(module).startswith("6 1.0 ")


def test_another_signatures_code_is_not_called(module: Path) -> None:
    """What two processes that lose a race leave: the name of one signature's file, the content of the other's."""
    printed(module)
    first, second = files(module, "nbc")
    first.write_bytes(second.read_bytes())
    assert printed(module).startswith("6 1.0 ")
