"""The Python interface on all ranks, as a user's script has it; every rank prints what it holds, after the first."""

import json
import sys
from pathlib import Path

from mpi4py import MPI

import pgmp_petsc as pgmp

rom_path, folder = Path(sys.argv[1]), Path(sys.argv[2])
rom = pgmp.read(rom_path)
run = pgmp.simulate(rom, {"r1": 5e-3})
ensemble = pgmp.montecarlo(rom, n=12, seed=7)
derivatives = pgmp.sensitivities(rom)
for name, result in {"rom": rom, "run": run, "ensemble": ensemble, "derivatives": derivatives}.items():
    result.write(folder / f"{name}.h5")

failures = []
for wrong in (
    lambda: pgmp.simulate(rom, {"r7": 1.0}),
    lambda: pgmp.load("nowhere.toml"),
    # one rank alone is wrong
    lambda: pgmp.montecarlo(rom, n=12 if MPI.COMM_WORLD.rank == 0 else 0),
    lambda: run.write(folder / "rom.h5"),
):
    try:
        wrong()
    except pgmp.InputError as error:
        failures.append(str(error))
# ranks of their own: each runs for itself
alone = pgmp.simulate(pgmp.read(folder / "rom.h5", comm=MPI.COMM_SELF), {"r1": 5e-3}, comm=MPI.COMM_SELF)
held = {
    "end": run.outputs["slider_deformation"][-1].hex(), "alone": alone.outputs["slider_deformation"][-1].hex(),
    "mean": ensemble.statistics["slider_deformation"].mean.hex(),
    "derivative": derivatives.derivatives["slider_deformation"]["r1"][-1].hex(), "failures": failures,
}  # fmt: skip
shown = MPI.COMM_WORLD.gather(held)
if shown:
    print(json.dumps(shown))
