"""The command line of benchmarks of one reduced model."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from benchmarks.programs import end, guarded
from pgmp_petsc.ranks.petsc import start_petsc


def main(about: str, run: Callable[[Path, int], None], n_samples: int) -> None:
    """Run a benchmark on the model and the number of samples that the command line names, and end the process."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("rom", type=Path)
    parser.add_argument("-n", "--samples", type=int, default=n_samples, metavar="N")
    arguments = parser.parse_args()
    start_petsc()
    end(guarded(lambda: run(arguments.rom, arguments.samples)))
