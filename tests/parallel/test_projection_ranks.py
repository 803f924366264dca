"""Velocities are projected onto constraints that turn on several ranks as on one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np


def test_ranks_that_share_a_sample_project_as_one(mpirun: Callable, parallel_scripts: Path, tmp_path: Path) -> None:
    found = []
    for n in (1, 2):
        mpirun(n, parallel_scripts / "projected.py", tmp_path / f"{n}.npy")
        found.append(np.load(tmp_path / f"{n}.npy"))
    # Newton's iteration stops at 1e-12, and other factors round otherwise
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9 * np.abs(found[0]).max())
