"""Condense bodies on several ranks and write what came out. Used by test_components.py.

Arguments: the directory of the results, then the kinds of cells.
"""

import sys
from pathlib import Path

import numpy as np

from pgmp_petsc.ranks.petsc import start_petsc

start_petsc()

from mpi4py import MPI  # noqa: E402
from solids import rod  # noqa: E402

from pgmp_petsc.components.component_modes import condense  # noqa: E402


def run(directory: Path, kind: str) -> None:
    """Condense one body and write it from the first rank."""
    comm = MPI.COMM_WORLD
    solid, frames, points = rod(kind, two_materials=True)
    component, recovery = condense(solid, frames, points, 6, comm)
    everywhere = np.concatenate(comm.allgather(recovery))
    same = comm.allreduce(float(np.ptp(comm.allgather(component.probes), axis=0).max()), op=MPI.MAX)
    if comm.rank == 0:
        terms = {
            f"{name}_{weight}": matrix
            for name in ("mass", "stiffness")
            for weight, matrix in getattr(component, name).items()
        }
        np.savez(
            directory / f"{kind}_{comm.size}.npz", fields=component.fields, probes=component.probes,
            recovery=everywhere, difference=same, **terms,
        )  # fmt: skip


if __name__ == "__main__":
    for name in sys.argv[2:]:
        run(Path(sys.argv[1]), name)
