"""Ensembles and trade-off studies that are killed again and again, against one that nothing disturbs.

    python -m benchmarks.kills rom.h5 [--runs 8 -- -n 8000 --correct full=400]
    python -m benchmarks.kills scenes/slider_crank_solid2d.toml --runs 1 -- --quick

An ensemble of a reduced model, or a study of a scene, is started, killed at a random moment by SIGKILL, SIGTERM and
SIGUSR1 in turn, and taken up with another number of ranks, up to three times; then it is left alone. Its file is
compared with that of an undisturbed run on one rank, bit by bit: all datasets but times and what is decided by them.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from benchmarks.tables import Table

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGUSR1)
MOST_KILLS = 3  # of an ensemble
PART = (0.35, 0.9)  # of an undisturbed run, at which it is killed
ASKED = {
    "montecarlo": ("-n", "8000", "--correct", "full=400", "--correct", "full/2=200"),
    "tradeoff": ("--quick",),
}
TIMES = ("timings", "offline", "online", "processor")
OF_TIMES = ("pareto", "advice")


@dataclass(frozen=True)
class Command:
    """What is started: a command of the program with a file and options."""

    name: str
    source: Path
    options: tuple[str, ...]

    def start(self, output: Path, ranks: int, *more: str) -> subprocess.Popen[bytes]:
        """Start it; its processes are killed together."""
        launch = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        words = [self.name, str(self.source), *self.options, *more, "-o", str(output)]
        return subprocess.Popen(
            [*launch, sys.executable, "-m", "pgmp_petsc.cli.main", *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )


def datasets(path: Path) -> dict[str, np.ndarray]:
    """Return all datasets of a file but times and what follows from them."""
    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and name.split("/")[0] not in (*TIMES, *OF_TIMES):
            found[name] = item[()]

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def killed(command: Command, output: Path, number: int, seconds: float) -> list[str]:
    """Kill a run and take it up until it is there; return the signals' names."""
    came, ranks, more = [], 1 + number % 2, ()
    while True:
        job = command.start(output, ranks, *more)
        if len(came) < MOST_KILLS:
            time.sleep(random.uniform(*PART) * seconds)
            if job.poll() is None:
                which = SIGNALS[(number + len(came)) % len(SIGNALS)]
                os.killpg(job.pid, which)
                came.append(which.name)
        _, said = job.communicate()
        if job.returncode == 0:
            return came
        if not came:
            raise SystemExit(said.decode())
        more, ranks = ("--resume",), 3 - ranks


def kills(command: Command, n_runs: int, folder: Path) -> Table:
    """Return what came of each run."""
    begin = time.monotonic()
    job = command.start(folder / "undisturbed.h5", 1)
    _, said = job.communicate()
    if job.returncode:
        raise SystemExit(said.decode())
    seconds, expected, rows = time.monotonic() - begin, datasets(folder / "undisturbed.h5"), []
    for number in range(n_runs):
        came = killed(command, folder / f"{number}.h5", number, seconds)
        found = datasets(folder / f"{number}.h5")
        differing = [name for name in expected if name not in found or not _same(found[name], expected[name])]
        rows.append([str(number), ", ".join(came) or "none", str(len(expected)), ", ".join(differing) or "none"])
    words = f"pgmp {command.name} {' '.join(command.options)}, killed and taken up with another number of ranks."
    return Table("Killed runs", ["run", "killed by", "datasets", "of these differ"], rows, words)


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    return np.array_equal(one, other, equal_nan=np.asarray(one).dtype.kind == "f")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path, help="reduced model of a scene with uncertain parameters, or a scene")
    parser.add_argument("--runs", type=int, default=8)
    parser.add_argument("options", nargs="*", help="of pgmp montecarlo, or of pgmp tradeoff, after --")
    arguments = parser.parse_args()
    random.seed(11)
    name = "tradeoff" if arguments.source.suffix == ".toml" else "montecarlo"
    asked = Command(name, arguments.source, tuple(arguments.options) or ASKED[name])
    with tempfile.TemporaryDirectory() as directory:
        table = kills(asked, arguments.runs, Path(directory))
    print(table.markdown())
