"""Ensembles that are killed again and again, against one that nothing disturbs.

    python -m benchmarks.kills rom.h5 [--ensembles 8 -- -n 8000 --correct full=400]

Each ensemble is started, killed at a random moment by SIGKILL, SIGTERM and SIGUSR1 in turn, and taken up with another
number of ranks, up to three times; then it is left alone. Its file is compared with that of an undisturbed run on one
rank, all datasets but times, bit by bit.
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
from pathlib import Path

import h5py
import numpy as np

from benchmarks.tables import Table

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGUSR1)
MOST_KILLS = 3  # of an ensemble
PART = (0.35, 0.9)  # of an undisturbed run, at which it is killed
ASKED = ("-n", "8000", "--correct", "full=400", "--correct", "full/2=200")


def start(rom: Path, output: Path, ranks: int, *options: str) -> subprocess.Popen[bytes]:
    """Start an ensemble whose processes are killed together."""
    launch = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [sys.executable, "-m", "pgmp_petsc.cli.main", "montecarlo", str(rom), *options, "-o", str(output)]
    return subprocess.Popen(
        [*launch, *command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    )


def datasets(path: Path) -> dict[str, np.ndarray]:
    """Return all datasets of a file but times."""
    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("timings/"):
            found[name] = item[()]

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def killed(rom: Path, output: Path, options: tuple[str, ...], number: int, seconds: float) -> list[str]:
    """Kill an ensemble and take it up until it is there; return the signals' names."""
    came, ranks, more = [], 1 + number % 2, ()
    while True:
        job = start(rom, output, ranks, *options, *more)
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


def kills(rom: Path, n_ensembles: int, options: tuple[str, ...], folder: Path) -> Table:
    """Return what came of each ensemble."""
    begin = time.monotonic()
    job = start(rom, folder / "undisturbed.h5", 1, *options)
    _, said = job.communicate()
    if job.returncode:
        raise SystemExit(said.decode())
    seconds, expected, rows = time.monotonic() - begin, datasets(folder / "undisturbed.h5"), []
    for number in range(n_ensembles):
        came = killed(rom, folder / f"{number}.h5", options, number, seconds)
        found = datasets(folder / f"{number}.h5")
        differing = [name for name in expected if name not in found or not _same(found[name], expected[name])]
        rows.append([str(number), ", ".join(came) or "none", str(len(expected)), str(len(differing))])
    words = f"pgmp montecarlo {' '.join(options)}, killed and taken up with another number of ranks."
    return Table("Killed ensembles", ["ensemble", "killed by", "datasets", "of these differ"], rows, words)


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    return np.array_equal(one, other, equal_nan=np.asarray(one).dtype.kind == "f")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rom", type=Path, help="reduced model of a scene with uncertain parameters")
    parser.add_argument("--ensembles", type=int, default=8)
    parser.add_argument("options", nargs="*", default=ASKED, help="of pgmp montecarlo, after --")
    arguments = parser.parse_args()
    random.seed(11)
    with tempfile.TemporaryDirectory() as directory:
        table = kills(arguments.rom, arguments.ensembles, tuple(arguments.options), Path(directory))
    print(table.markdown())
