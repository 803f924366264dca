"""Measure the least trade-off study on all ranks and print what it found. Used by test_more_ranks_than_work.py.

tradeoff.py [OVERRIDE ...]
"""

import json
import sys

from mpi4py import MPI
from tradeoffs import LEAST, small_scene, study

from pgmp_petsc.ranks.petsc import start_petsc

if __name__ == "__main__":
    start_petsc()
    comm = MPI.COMM_WORLD
    result = study(small_scene(*sys.argv[1:]), LEAST, comm=comm)
    assert (result is None) == (comm.rank > 0)
    if result is not None:
        names = [result.name(row) for row in range(len(result.families))]
        told = names, result.flags, result.reasons, result.references.step.tolist()
        timed = [all(t > 0 for t in times) for times in zip(result.wall.offline, result.wall.batch)]
        numbers = [of.tolist() for of in (result.errors, result.references.moved, result.mesh.errors)]
        print(json.dumps({"told": told, "numbers": numbers, "timed": timed}))
