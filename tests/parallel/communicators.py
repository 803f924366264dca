"""Split the ranks and run the full-order model many times; print the handle of a new communicator before and after.

Handles are given anew once they are free, so that one that is never freed shows in the next.
"""

from mpi4py import MPI
from runs import full_model, paper_scene

from benchmarks.programs import end
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.ranks.petsc import start_petsc
from pgmp_petsc.studies.simulate import simulate

N_SPLITS, N_RUNS = 50, 4


def next_handle() -> int:
    """Return the number that a new communicator gets."""
    comm = MPI.COMM_WORLD.Dup()
    handle = comm.py2f()
    comm.Free()
    return handle


def main() -> None:
    start_petsc()
    world = MPI.COMM_WORLD
    model = full_model(paper_scene("simulation.duration=0.002", "simulation.step=1e-3"))
    simulate(model, world)  # what PETSc makes once and keeps
    before = next_handle()
    for _ in range(N_SPLITS):
        with RankGroup.split(world, 2):
            pass
    for _ in range(N_RUNS):
        simulate(model, world)
    handles = world.gather((before, next_handle()))
    if handles:
        print(handles)


if __name__ == "__main__":
    main()
    end(0)
