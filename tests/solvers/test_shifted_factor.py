"""Factors in memory, in files and for counting: the same answers, and what is said where they cannot be made."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import petsc4py
import pytest

petsc4py.init([])

from conftest import TIMEOUT_SECONDS  # noqa: E402
from petsc4py import PETSc  # noqa: E402
from refusals import full_disk  # noqa: E402

from pgmp_petsc.base import resources as memory_module  # noqa: E402
from pgmp_petsc.base.errors import InputError, RunError  # noqa: E402
from pgmp_petsc.base.resources import free_memory, give_back  # noqa: E402
from pgmp_petsc.ranks.petsc import mumps_factor  # noqa: E402
from pgmp_petsc.solvers.shift_invert import NO_FILES, FactorFiles, ShiftedFactor, _meaning  # noqa: E402

SIDE = 26  # points along each edge of a cube: a factor of some 30 MB
SHIFT, PREFIX = -0.01, "pgmp_body_st_"
LITTLE = 20e6  # bytes: less than a factor in memory takes, more than one in files


@pytest.fixture(scope="module")
def laplacian() -> Iterator[tuple[PETSc.Mat, PETSc.Mat]]:
    """Return the 7-point Laplacian of a cube with free faces, whose eigenvalues are known, and the unit matrix."""
    import scipy.sparse as sp

    ends = np.r_[1.0, np.full(SIDE - 2, 2.0), 1.0]
    line = sp.diags([-np.ones(SIDE - 1), ends, -np.ones(SIDE - 1)], [-1, 0, 1])
    unit = sp.eye(SIDE)
    cube = sum(
        sp.kron(sp.kron(*pair[:2]), pair[2]) for pair in ((line, unit, unit), (unit, line, unit), (unit, unit, line))
    )
    cube = cube.tocsr()
    same = cube.copy()
    same.data[:] = 0.0
    same.setdiag(1.0)
    matrices = []
    for matrix in (cube, same):
        csr = (matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data)
        matrices.append(PETSc.Mat().createAIJ(matrix.shape, csr=csr, comm=PETSc.COMM_SELF))
    yield tuple(matrices)
    for matrix in matrices:
        matrix.destroy()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(tmp_path))
    return tmp_path


@pytest.fixture
def options() -> Iterator[PETSc.Options]:
    """Return PETSc's options, and take the test's own away again."""
    names: list[str] = []

    class Own:
        def __setitem__(self, name: str, value: object) -> None:
            names.append(name)
            PETSc.Options()[name] = value

    yield Own()
    for name in names:
        PETSc.Options().delValue(name)


def eigenvalues() -> np.ndarray:
    line = 2.0 - 2.0 * np.cos(np.pi * np.arange(SIDE) / SIDE)
    return np.sort((line[:, None, None] + line[:, None] + line).ravel())


def answers(matrices: tuple, memory: float | None, folder: Path) -> tuple[np.ndarray, int]:
    """Return answers to three columns, and the size of all files that there were then, bytes."""
    factor = ShiftedFactor(PETSc.COMM_SELF, PREFIX, memory)
    try:
        factor.factor(*matrices, SHIFT, "body bar")
        found = factor.apply_inverse(np.random.default_rng(1).normal(size=(SIDE**3, 3)), "body bar")
        return found, sum(path.stat().st_size for path in folder.rglob("mumps*"))
    finally:
        factor.close()


def test_a_factor_that_may_not_be_in_memory_is_kept_in_files(
    laplacian: tuple, folder: Path, capfd: pytest.CaptureFixture
) -> None:
    inside, written = answers(laplacian, None, folder)
    assert written == 0 and not capfd.readouterr().err
    outside, written = answers(laplacian, LITTLE, folder)
    assert written > 1e7
    said = capfd.readouterr().err
    assert said.startswith(f"pgmp: body bar: the factor of {SIDE**3} unknowns takes 0.0") and said.count("\n") == 1
    assert f"it is kept in files in '{folder}/pgmp_factor_" in said
    # the same operations in other blocks: round-off
    np.testing.assert_allclose(outside, inside, rtol=0, atol=1e-13 * np.abs(inside).max())
    assert not list(folder.iterdir())


def test_matrices_that_change_keep_their_files(laplacian: tuple, folder: Path) -> None:
    factor = ShiftedFactor(PETSc.COMM_SELF, PREFIX, LITTLE)
    for shift in (SHIFT, 2.0 * SHIFT):
        factor.factor(*laplacian, shift, "body bar")
        # a constant is an eigenvector
        np.testing.assert_allclose(factor.apply_inverse(np.ones((SIDE**3, 1)), "body bar"), -1.0 / shift, rtol=1e-9)
    assert len(list(folder.iterdir())) == 1
    factor.close()
    assert not list(folder.iterdir())


def test_a_factor_that_is_not_kept_counts(laplacian: tuple, folder: Path) -> None:
    values = eigenvalues()
    factor = ShiftedFactor(PETSc.COMM_SELF, "pgmp_body_count_", counts=True)
    for n in (0, 1, 20, 300):
        # a value between two different eigenvalues
        upper = n + int(np.argmax(values[n:] > values[n] + 1e-6)) if n else 0
        tau = 0.5 * (values[upper - 1] + values[upper]) if n else SHIFT
        factor.factor(*laplacian, tau, "count")
        assert factor.negative_pivots() == upper
    used = mumps_factor(factor._ksp).getMumpsInfog(22)
    factor.close()
    kept = ShiftedFactor(PETSc.COMM_SELF, PREFIX)
    kept.factor(*laplacian, SHIFT, "body bar")
    assert used < 0.6 * mumps_factor(kept._ksp).getMumpsInfog(22)
    kept.close()


def test_a_user_says_where_a_factor_is(laplacian: tuple, folder: Path, options: PETSc.Options) -> None:
    options[f"{PREFIX}mat_mumps_icntl_22"] = 1
    assert answers(laplacian, None, folder)[1] > 1e7
    assert not list(folder.iterdir())
    options[f"{PREFIX}mat_mumps_icntl_22"] = 0
    with pytest.raises(
        RunError, match=r"MUMPS failed on .* INFOG\(1\) = -(9|19), .*: not enough memory; take more ranks"
    ):
        answers(laplacian, LITTLE, folder)


def test_a_user_limits_the_memory(laplacian: tuple, folder: Path, options: PETSc.Options) -> None:
    options[f"{PREFIX}mat_mumps_icntl_23"] = int(LITTLE / 1e6)
    assert answers(laplacian, None, folder)[1] > 1e7


def test_a_folder_that_is_none_is_bad_input(laplacian: tuple, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(folder / "none"))
    with pytest.raises(InputError, match=r"^MUMPS_OOC_TMPDIR = '.*/none': no file can be made there \(No such file"):
        answers(laplacian, LITTLE, folder)
    long = folder / ("x" * 150) / ("y" * 100)
    long.mkdir(parents=True)
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(long))
    with pytest.raises(InputError, match="is longer than the 200 characters"):
        answers(laplacian, LITTLE, folder)
    assert not list(long.iterdir())


def test_a_disk_that_is_full_is_named(laplacian: tuple, folder: Path) -> None:
    said = r"the 0\.0\d+ GB of its factor cannot be written in '.* GB are free there; let"
    with full_disk(1_000_000), pytest.raises(RunError, match=said):
        answers(laplacian, LITTLE, folder)
    assert not list(folder.iterdir())
    files = FactorFiles()  # what MUMPS finds itself, where it does not wait for ever
    assert "cannot be written or read, " in _meaning(NO_FILES, files)
    files.close()


def test_a_signal_that_ends_a_run_takes_the_files_along(folder: Path) -> None:
    program = """
import time
from pgmp_petsc.ranks.ending import ending_on_signals
from pgmp_petsc.solvers.shift_invert import FactorFiles
with ending_on_signals(0):
    (FactorFiles().path / "part").write_text("of a factor")
    print("ready", flush=True)
    time.sleep(60)
"""
    run = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert run.stdout.readline() == b"ready\n"
    assert list(folder.iterdir())
    os.kill(run.pid, signal.SIGTERM)
    run.communicate(timeout=TIMEOUT_SECONDS)
    assert run.returncode == 143
    assert not list(folder.iterdir())


def test_free_memory_is_the_machine_s_or_the_job_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory_module, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory_module, "GROUP", tmp_path)
    assert free_memory() is None
    (tmp_path / "meminfo").write_text("MemTotal:  9 kB\nMemAvailable:    5000 kB\n")
    assert free_memory() == 5_120_000.0
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("3000000\n")
    (tmp_path / "memory.stat").write_text("anon 2000000\nactive_file 600000\ninactive_file 300000\n")
    assert free_memory() == 5_120_000.0
    (tmp_path / "memory.max").write_text("4000000\n")
    assert free_memory() == 1_900_000.0


def test_what_is_freed_is_given_back() -> None:
    def resident() -> int:
        return os.sysconf("SC_PAGESIZE") * int(Path("/proc/self/statm").read_text().split()[1])

    blocks = [np.ones(1_000_000) for _ in range(10)]
    full = resident()
    del blocks
    give_back()
    assert resident() < full - 70e6
