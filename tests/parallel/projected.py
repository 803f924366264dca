"""A full-order run of a mechanism whose constraints turn, without numerical damping, on all ranks: place at the end."""

from __future__ import annotations

import sys

from pgmp_petsc.runtime.petsc import start_petsc

start_petsc()

import numpy as np  # noqa: E402
from mpi4py import MPI  # noqa: E402
from runs import full_model, quick_return  # noqa: E402

from pgmp_petsc.stepping.generalised_alpha import integrate  # noqa: E402

if __name__ == "__main__":
    scene = quick_return("simulation.duration=0.02", "simulation.spectral_radius=1.0")
    model = full_model(scene)
    with model.distributed(scene.values, MPI.COMM_WORLD) as system:
        state = integrate(system, scene.simulation).state
        places, rates = system.unpack(state.q), system.unpack(state.v)
    if MPI.COMM_WORLD.rank == 0:
        np.save(sys.argv[1], np.hstack([places, rates]))
