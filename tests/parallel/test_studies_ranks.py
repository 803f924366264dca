"""Studies and films on several ranks: the same as on one; bad input ends all of them."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import synthetic
from click.testing import CliRunner
from conftest import ROOT
from mpi4py import MPI
from runs import in_turn, rom_of

from benchmarks.scaling.case import FRESH, ScalingCase
from pgmp_petsc.cli.declared import Session
from pgmp_petsc.cli.main import COMMANDS
from scenes import slider_crank

LIMITED = 'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}'
SHORT = (LIMITED, "simulation.duration=0.01", "reduction.angles=8")


def test_more_ranks_than_tasks(mpirun, parallel_scripts) -> None:
    one, many = (json.loads(mpirun(n, parallel_scripts / "tradeoff.py", *SHORT).stdout) for n in (1, 6))
    assert many["names"] == one["names"] and all(many["timed"])
    # the eigensolver's random start changes the last digits
    np.testing.assert_allclose(many["errors"], one["errors"], rtol=1e-6, atol=1e-12)


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


def test_one_rank_draws(tmp_path: Path) -> None:
    rom_of(slider_crank()).write(tmp_path / "rom.h5")
    synthetic.trajectory(n_frames=3, n_times=11).write(tmp_path / "run.h5")
    commands = [
        ["animate", str(tmp_path / "rom.h5"), "--mode", "2", "--seconds", "0.2", "-o", str(tmp_path / "several.gif")],
        ["animate", str(tmp_path / "rom.h5"), "--mode", "99", "-o", str(tmp_path / "none.gif")],
        ["animate", str(tmp_path / "run.h5"), "-o", str(tmp_path / "none.gif")],
    ]
    statuses, done = in_turn(2, commands)
    assert statuses == [[0, 0], [2, 2], [2, 2]]
    assert done.stderr.count("--mode 99") == 1 and done.stderr.count("nothing of this run is known") == 1
    assert not (tmp_path / "none.gif").exists()
    words = [*commands[0][1:-1], str(tmp_path / "one.gif")]
    one = CliRunner().invoke(COMMANDS["animate"].load(), words, obj=Session(MPI.COMM_SELF))
    assert one.exit_code == 0
    assert (tmp_path / "several.gif").read_bytes() == (tmp_path / "one.gif").read_bytes()
