"""What a step of a reduced model in C takes, on average and at worst (`exported.c`), and what `pgmp simulate` gives.

    python -m benchmarks.engine.exported ROM.h5 -n 1000000

The model is written as `pgmp export` writes it and compiled with -O2. Every step is timed with the outputs after it.
Its work is the same but for steps that need more corrections or attempts; what takes longer is mostly the machine's
own business: interrupts, other processes, caches. The most that a step can do is timed too: steps with tolerances that
none can meet, which do all corrections of all attempts and are not taken.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mpi4py import MPI

from benchmarks.engine.floor import compiler
from benchmarks.on_model import main
from benchmarks.programs import reduced_model
from pgmp_petsc.c_export.constants import MOST_CORRECTIONS, Constants, constants_of
from pgmp_petsc.c_export.source import compiled_of, write_sources
from pgmp_petsc.studies.simulate import simulate

NEVER_MET = {name: -1.0 for name in ("NEWTON_TOLERANCE", "TOLERANCE_OF_TRIALS", "ROUND_OFF")}
SHARE_OF_MOST = 100  # of the steps, those that are timed with all corrections


def run(path: Path, n_steps: int) -> None:
    """Time the steps of a model, and print what they take."""
    model = reduced_model(path)
    constants = constants_of(model, "the model")
    with TemporaryDirectory() as folder:
        endless = replace(constants, settings={**constants.settings, **NEVER_MET})
        most, *_ = _time_steps(endless, n_steps // SHARE_OF_MOST + 1, folder)
        mean, rare, worst, wall, validity = _time_steps(constants, n_steps, folder)
        n_bytes = write_sources(constants, folder)
        command = [compiler(), "-std=c99", "-O2", "-o", "run", "main.c", *compiled_of(constants.kind), "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        table = subprocess.run([f"{folder}/run"], capture_output=True, text=True, check=True).stdout
    sizes = constants.settings
    size = f"{sizes['R']} rigid and {sizes['M']} flexible coordinates, {n_bytes / 1e6:.1f} MB of source"
    print(f"{size}, validity {validity:.0f}")
    said = f"{mean:.2f} us on average, 99.99 % within {rare:.2f} us, the slowest {worst:.1f} us"
    print(f"{n_steps} steps, processor time: {said}")
    print(f"with all {MOST_CORRECTIONS} corrections that a step may do: {most:.2f} us on average")
    print(f"the slowest by the clock on the wall, with what else the machine does: {wall:.1f} us")
    columns = np.array([line.split(",") for line in table.splitlines()[1:]], dtype=float).T[1:]
    for (name, values), found in zip(simulate(model, MPI.COMM_SELF).outputs.items(), columns):
        share = np.max(np.abs(found - values)) / np.max(np.abs(values))
        print(f"{name}: differs from pgmp simulate by {share:.1e} of its largest value")


def _time_steps(constants: Constants, n_steps: int, folder: str) -> Sequence[float]:
    """Return what ``exported.c`` prints of so many steps of a model, written and compiled in a folder."""
    write_sources(constants, folder)
    source = str(Path(__file__).with_suffix(".c").resolve())
    command = [compiler(), "-std=c99", "-O2", "-I.", "-o", "time", source, *compiled_of(constants.kind), "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run([f"{folder}/time", str(n_steps)], capture_output=True, text=True, check=True)
    return [float(number) for number in done.stdout.split()]


if __name__ == "__main__":
    main(__doc__, run, 1_000_000)
