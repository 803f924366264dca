"""Deal out pieces in one case and print what each rank did and saw. Used by test_more_ranks_than_work.py."""

import sys
import time

import numpy as np
from mpi4py import MPI

from pgmp_petsc.base.errors import PgmpError, RunError
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.groups import Pulse, RankGroup, deal_to_groups

RANKS_PER_GROUP = {"groups": 2, "a group fails": 2}
N_PIECES = {"none": 0, "few": 2, "unequal": 41, "large": 12}


def run(case: str, comm: MPI.Comm) -> str:
    """Run a case; return the pieces that this rank computed, and on rank 0 those that came in."""
    computed, taken = [], []

    def work(number: int, pulse: Pulse) -> np.ndarray:
        computed.append(number)
        if case in ("one fails", "a group fails") and number == 7:
            raise RunError("piece 7 failed")
        if case == "unequal":
            for _ in range(1 if number % 10 else 20):
                time.sleep(1e-3)
                pulse()
        return np.full(200_000 if case == "large" else 3, float(number))

    def take(number: int, result: np.ndarray) -> None:
        assert comm.rank == 0 and np.all(result == number)
        if case == "the writing fails" and number == 7:
            raise RunError("the disk is full")
        taken.append(number)

    with RankGroup.split(comm, min(RANKS_PER_GROUP.get(case, 1), comm.size)) as group, agreed(comm, "dealing"):
        deal_to_groups(group, N_PIECES.get(case, 25), work, take)
    return f"computed {sorted(computed)} took {sorted(taken)}"


def main() -> None:
    """Run the cases on the command line one after the other and print a line of each rank."""
    comm = MPI.COMM_WORLD
    for case in sys.argv[1:]:
        try:
            line = run(case, comm)
        except PgmpError as error:
            line = f"{type(error).__name__}: {error}"
        for rank, text in enumerate(comm.gather(line) or []):
            print(f"{case}|{rank}|{text}", flush=True)


main()
