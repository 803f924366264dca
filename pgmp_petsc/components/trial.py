"""What a build with continuum bodies will take, from one trial factorisation and solve of its largest body.

Condensing a body takes its assembly, two factorisations (one for solves, one that counts eigenvalues by inertia and
keeps nothing) and solves in blocks: those of the modes and of the frames' answers, round by round, all columns at once,
which take little longer than one: a solve waits for the factor to come from memory, or from files. Time and memory of
bodies of the same kind grow with their unknowns, a little faster for bulky ones; they are taken as proportional here.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.framed_solid import framed_solid
from pgmp_petsc.bodies.shape import BodyShape, to_condense
from pgmp_petsc.components.body_problem import BodyProblem, petsc_terms
from pgmp_petsc.components.condensing import FACTOR_SHARE
from pgmp_petsc.runtime.memory import free_share
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from mpi4py import MPI

ROUNDS = 14  # blocks of columns that modes and the frames' answers take, measured with round bars in space
RIGID_AND_SPARE = 9  # eigenvectors beside those asked for
FACTORS = 2
BESIDE = 1.4  # of the memory of the trial: what the count and vectors take, measured the same way


@dataclass(frozen=True)
class Trial:
    """What one body took, and what all are expected to take.

    Attributes
    ----------
    body
        The body that was tried.
    n_dofs
        Its unknowns.
    assembly, factorisation, solve
        Times of the trial, s; the solve is that of one block of columns.
    memory
        Largest memory of all ranks together so far, bytes.
    seconds
        Expected time of condensing all bodies on these ranks, s.
    """

    body: str
    n_dofs: int
    assembly: float
    factorisation: float
    solve: float
    memory: float
    seconds: float


def try_largest(scene: Scene, shapes: Mapping[str, BodyShape], comm: MPI.Comm) -> Trial | None:
    """Try the largest continuum body; None where there is none. Collective on `comm`.

    Raises
    ------
    InputError, RunError
        If the body's frames or materials are not sound, or the factorisation fails.
    """
    solids = {name: shape for name, shape in shapes.items() if to_condense(shape)}
    if not solids:
        return None
    name = max(solids, key=lambda key: solids[key].n_nodes * solids[key].dimension)
    mesh = solids[name]
    meshed = framed_solid(scene, name, mesh)
    nodes = range(mesh.n_nodes * comm.rank // comm.size, mesh.n_nodes * (comm.rank + 1) // comm.size)
    start = time.perf_counter()
    mass, stiffness = (petsc_terms(assemble(nodes), comm) for assemble in (meshed.solid.mass, meshed.solid.stiffness))
    places, free = mesh.nodes[nodes.start : nodes.stop], free_share(comm)
    memory = None if free is None else FACTOR_SHARE * free
    problem = BodyProblem(mass, stiffness, scene.nominal, places, comm, memory, name)
    n_pairs = scene.reduction.modes + scene.n_overconstrained + RIGID_AND_SPARE
    try:
        assembled = time.perf_counter()
        problem.factor()
        factored = time.perf_counter()
        problem.answers(np.ones((mesh.dimension * len(nodes), n_pairs)))
        solved = time.perf_counter()
    finally:
        problem.close()
        for matrix in (*mass.values(), *stiffness.values()):
            matrix.destroy()
    steps = np.diff([start, assembled, factored, solved])
    assembly, factorisation, solve = (float(step) for step in comm.allreduce(steps) / comm.size)
    largest = assembly + FACTORS * factorisation + ROUNDS * solve
    share = sum(solid.n_nodes for solid in solids.values()) / mesh.n_nodes
    peak = comm.allreduce(1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return Trial(name, meshed.solid.n_dofs, assembly, factorisation, solve, BESIDE * peak, share * largest)
