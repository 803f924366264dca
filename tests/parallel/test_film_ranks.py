"""Films on several ranks: one of them draws, and the film is the same; bad input ends all of them."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import synthetic
from click.testing import CliRunner
from mpi4py import MPI
from runs import IN_TURN, rom_of

from pgmp_petsc.cli.main import COMMANDS
from pgmp_petsc.cli.session import Session
from scenes import slider_crank


@pytest.mark.parametrize("n", [2])
def test_one_rank_draws(n: int, mpirun: Callable, tmp_path: Path) -> None:
    rom_of(slider_crank()).write(tmp_path / "rom.h5")
    synthetic.trajectory(n_frames=3, n_times=11).write(tmp_path / "run.h5")
    commands = [
        ["animate", str(tmp_path / "rom.h5"), "--mode", "2", "--seconds", "0.2", "-o", str(tmp_path / "several.gif")],
        ["animate", str(tmp_path / "rom.h5"), "--mode", "99", "-o", str(tmp_path / "none.gif")],
        ["animate", str(tmp_path / "run.h5"), "-o", str(tmp_path / "none.gif")],
    ]
    done = mpirun(n, "-c", IN_TURN, json.dumps(commands))
    statuses = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]
    assert statuses == [[0] * n, [2] * n, [2] * n]
    assert done.stderr.count("--mode 99") == 1 and done.stderr.count("nothing of this run is known") == 1
    assert "Traceback" not in done.stderr and not (tmp_path / "none.gif").exists()
    words = [*commands[0][1:-1], str(tmp_path / "one.gif")]
    one = CliRunner().invoke(COMMANDS["animate"].load(), words, obj=Session(MPI.COMM_SELF))
    assert one.exit_code == 0
    assert (tmp_path / "several.gif").read_bytes() == (tmp_path / "one.gif").read_bytes()
