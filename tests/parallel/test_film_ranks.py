"""Films on several ranks: one of them draws, and the film is the same; bad input ends all of them."""

from pathlib import Path

import synthetic
from click.testing import CliRunner
from mpi4py import MPI
from runs import in_turn, rom_of

from pgmp_petsc.cli.declared import Session
from pgmp_petsc.cli.main import COMMANDS
from scenes import slider_crank


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
