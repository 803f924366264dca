"""A program whose first rank calls the Python interface by itself; the other does so later, or never."""

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI
from runs import PAPER_SCENE

import pgmp_petsc as pgmp

rom_path, others = Path(sys.argv[1]), sys.argv[2]
world = MPI.COMM_WORLD
short = {"simulation.duration": 2e-3}
alone = pgmp.simulate(rom_path, overrides=short, comm=MPI.COMM_SELF) if world.rank == 0 else None
if others == "never":
    if world.rank == 0:
        print("alone")
else:
    # PETSc runs on one of these ranks, and not on the other
    together = pgmp.simulate(PAPER_SCENE, overrides=short, model="full", comm=world)
    again = pgmp.simulate(rom_path, overrides=short)
    assert np.isfinite(together.outputs["crank_angle"]).all()
    if world.rank == 0:
        print("same" if np.array_equal(alone.outputs["crank_angle"], again.outputs["crank_angle"]) else "others")
