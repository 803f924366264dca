"""Columns of an ensemble in a file."""

import resource
from pathlib import Path

import numpy as np
import pytest

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.ensemble.checkpoint import Columns


def test_a_column_is_what_was_put_in_and_nan_elsewhere(tmp_path: Path) -> None:
    columns = Columns(tmp_path, 5)
    columns.put(3, {"outputs.x": np.array([3.0, 4.0]), "status": np.array([0, 2])})
    columns.put(0, {"outputs.x": np.array([0.5]), "outputs.y.z": np.array([True])})
    assert list(columns) == ["outputs.x", "status", "outputs.y.z"] and len(columns) == 3
    np.testing.assert_array_equal(columns["outputs.x"], [0.5, np.nan, np.nan, 3.0, 4.0])
    np.testing.assert_array_equal(columns["status"], [np.nan, np.nan, np.nan, 0.0, 2.0])
    outputs = columns.of("outputs")
    assert list(outputs) == ["x", "y.z"] and len(outputs) == 2 and not columns.of("errors")
    np.testing.assert_array_equal(outputs["y.z"], [1.0, np.nan, np.nan, np.nan, np.nan])
    with pytest.raises(KeyError):
        outputs["z"]


def test_it_leaves_no_file_and_lasts_longer_than_its_folder(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    columns = Columns(tmp_path / "folder", 100_000)
    columns.put(1, {"a": np.arange(99_999.0)})
    (tmp_path / "folder").rmdir()
    np.testing.assert_array_equal(columns["a"], [np.nan, *range(99_999)])


def test_a_full_disk_is_said(tmp_path: Path) -> None:
    columns = Columns(tmp_path, 1000)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(RunError, match="samples could not be put together in .*: File too large; what is"):
            columns.put(0, {"a": np.zeros(1000)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_folder_that_is_gone_is_said(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="samples could not be put together in .*gone': No such file"):
        Columns(tmp_path / "gone", 2)
