"""What a step of a reduced model in C takes, on average and at worst (`exported.c`), and what `pgmp simulate` gives.

    python -m benchmarks.engine.exported ROM.h5 -n 1000000

The model is written as `pgmp export` writes it and compiled with -O2. Every step is timed with the outputs after it.
Its work is always the same; what takes longer is the machine's own business: interrupts, other processes, caches.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mpi4py import MPI

from benchmarks.engine.floor import compiler
from benchmarks.on_model import main
from pgmp_petsc.code.constants import constants_of
from pgmp_petsc.code.source import COMPILED, write_sources
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.studies.inputs import read_rom
from pgmp_petsc.studies.simulate import simulate_reduced


def run(path: Path, n_steps: int) -> None:
    """Time the steps of a model, and print what they take."""
    scene, rom = read_rom(path, (), (), MPI.COMM_SELF)
    model = ReducedModel(scene, rom)
    constants, source = constants_of(model, "the model"), Path(__file__).with_suffix(".c")
    with TemporaryDirectory() as folder:
        n_bytes = write_sources(constants, folder)
        command = [compiler(), "-std=c99", "-O2", "-I.", "-o", "time", str(source.resolve()), *COMPILED, "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        done = subprocess.run([f"{folder}/time", str(n_steps)], capture_output=True, text=True, check=True)
        command = [compiler(), "-std=c99", "-O2", "-o", "run", "main.c", *COMPILED, "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        table = subprocess.run([f"{folder}/run"], capture_output=True, text=True, check=True).stdout
    mean, rare, worst, wall, validity = (float(number) for number in done.stdout.split())
    sizes = constants.settings
    size = f"{sizes['R']} rigid and {sizes['M']} flexible coordinates, {n_bytes / 1e6:.1f} MB of source"
    print(f"{size}, validity {validity:.0f}")
    said = f"{mean:.2f} us on average, 99.99 % within {rare:.2f} us, the slowest {worst:.1f} us"
    print(f"{n_steps} steps, processor time: {said}")
    print(f"the slowest by the clock on the wall, with what else the machine does: {wall:.1f} us")
    columns = np.array([line.split(",") for line in table.splitlines()[1:]], dtype=float).T[1:]
    for (name, values), found in zip(simulate_reduced(model, MPI.COMM_SELF).outputs.items(), columns):
        share = np.max(np.abs(found - values)) / np.max(np.abs(values))
        print(f"{name}: differs from pgmp simulate by {share:.1e} of its largest value")


if __name__ == "__main__":
    main(__doc__, run, 1_000_000)
