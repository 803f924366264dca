"""The scaling study on two ranks."""

from collections.abc import Callable
from pathlib import Path

from conftest import ROOT

from benchmarks.scaling.case import FRESH, ScalingCase

SOLIDS = ROOT / "scenes" / "slider_crank_solid2d.toml"
SMALL = ("reduction.modes=4", "reduction.angles=6")


def test_two_ranks_have_a_body_each(tmp_path: Path, mpirun: Callable) -> None:
    options = [word for entry in SMALL for word in ("--override", entry)]
    path = tmp_path / "case.json"
    mpirun(2, "-m", "benchmarks.scaling.build", SOLIDS, "-o", path, *options)
    found = ScalingCase.read(path)
    assert (found.ranks, found.ranks_per_angle, len(found.peak)) == (2, 1, 2)
    assert found.factorisations == 2, "of one body"
    assert FRESH not in found.wall
    assert path.with_suffix(".h5").exists()
