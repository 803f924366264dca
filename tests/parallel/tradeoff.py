"""Measure a small trade-off study on all ranks and print its errors. Used by test_tradeoff.py.

tradeoff.py tiny|least [OVERRIDE ...]
"""

import json
import sys

from mpi4py import MPI
from tradeoffs import LEAST, TINY, small_scene, study

from pgmp_petsc.ranks.petsc import start_petsc

if __name__ == "__main__":
    start_petsc()
    comm = MPI.COMM_WORLD
    result = study(small_scene(*sys.argv[2:]), {"tiny": TINY, "least": LEAST}[sys.argv[1]], comm=comm)
    assert (result is None) == (comm.rank > 0)
    if result is not None:
        print(
            json.dumps(
                {
                    "names": [result.name(row) for row in range(len(result.families))],
                    "errors": result.errors.tolist(),
                    "moved": result.references.moved.tolist(),
                    "steps": result.references.step.tolist(),
                    "mesh": result.mesh.errors.tolist(),
                    "reasons": result.reasons,
                    "timed": [all(t > 0 for t in times) for times in zip(result.wall.offline, result.wall.batch)],
                    "ranks": result.record.ranks,
                }
            )
        )
