"""``pgmp check --trial``: what a build of continuum bodies will take, on any number of ranks."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import ROOT
from runs import PGMP, pgmp

from pgmp_petsc.components.condensing import FACTORS

SOLID = ROOT / "scenes" / "slider_crank_solid2d.toml"
TRIAL = re.compile(
    r"trial +rod, 1130 unknowns: assembly (\S+) s, factorisation (\S+) s, solve (\S+) s\n"
    r" +build +about (\S+) s for condensing the bodies, (\S+) ([MG])B on all ranks"
)


@pytest.mark.parametrize("n_ranks", [1, 3])
def test_the_largest_body_is_tried(mpirun: Callable, n_ranks: int) -> None:
    found = TRIAL.search(mpirun(n_ranks, *PGMP, "check", SOLID, "--trial").stdout)
    assembly, factorisation, solve, build, memory = map(float, found.groups()[:5])
    assert min(assembly, factorisation, solve) > 0.0
    # more than the steps that it is made of, each taken once
    assert assembly + FACTORS * factorisation + solve < build < 60.0
    assert memory > (50.0 if found[6] == "M" else 0.05) * n_ranks


def test_a_scene_of_beams_has_nothing_to_try() -> None:
    said = pgmp("check", ROOT / "scenes" / "slider_crank.toml", "--trial").stdout
    assert "no continuum bodies: nothing to try" in said


def test_a_factor_that_has_no_folder_is_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(tmp_path / "none"))
    options = ("--", "-pgmp_body_st_mat_mumps_icntl_22", "1")
    said = pgmp("check", SOLID, "--trial", *options, status=2).stderr
    assert said.startswith("pgmp: error: MUMPS_OOC_TMPDIR = ") and said.count("\n") == 1
    # and nothing is left where there is one
    monkeypatch.setenv("MUMPS_OOC_TMPDIR", str(tmp_path))
    pgmp("check", SOLID, "--trial", *options)
    assert not list(tmp_path.iterdir())
