"""What a build with continuum bodies will take, from one trial factorisation and solve of its largest body.

Condensing a body takes its assembly, two factorisations (one for the shift-invert, one that counts eigenvalues by
inertia) and solves: those of the Krylov space, one column after the other with products with the mass, and of the
frames' answers round by round, all columns at once, which takes a fraction of the time: a solve waits for the factor to
come from memory. Time and memory of bodies of the same kind grow with their unknowns, a little faster for bulky ones;
they are taken as proportional here.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.component_modes import BodyProblem
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.matrices import times
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.points import points_used

if TYPE_CHECKING:
    from mpi4py import MPI

KRYLOV = 3.8  # steps an eigenvector takes, measured with round bars in space
PRODUCTS = 2  # with the mass in a step, the same
ROUNDS = 7  # rounds that the frames' answers take, the same
RIGID_AND_SPARE = 9  # eigenvectors beside those asked for
FACTORS = 2
REPEATS = 3  # of the step that is timed


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
        Times of the trial, s; the solve is that of one step of the Krylov space.
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
    solids = {name: shape for name, shape in shapes.items() if isinstance(shape, SolidMesh)}
    if not solids:
        return None
    name = max(solids, key=lambda key: solids[key].n_nodes * solids[key].dimension)
    mesh = solids[name]
    meshed = FramedSolid.of(name, scene.bodies[name], scene.materials, mesh, points_used(scene, name))
    nodes = range(mesh.n_nodes * comm.rank // comm.size, mesh.n_nodes * (comm.rank + 1) // comm.size)
    start = time.perf_counter()
    mass, stiffness = meshed.solid.mass(nodes), meshed.solid.stiffness(nodes)
    problem = BodyProblem(mass, stiffness, scene.nominal, mesh.nodes[nodes.start : nodes.stop], comm)
    try:
        assembled = time.perf_counter()
        problem.factor()
        factored = time.perf_counter()
        columns = np.ones((mesh.dimension * len(nodes), 6 * len(meshed.frames)))
        problem.answers(columns)
        answered = time.perf_counter()
        for _ in range(REPEATS):
            problem.answers(columns[:, :1])
            for _ in range(PRODUCTS):
                times(problem.mass, columns[:, :1])
        solved = time.perf_counter()
    finally:
        problem.close()
    steps = np.diff([start, assembled, factored, answered, solved])
    assembly, factorisation, round_, solve = (float(step) for step in comm.allreduce(steps) / comm.size)
    solve /= REPEATS
    n_pairs = scene.reduction.modes + scene.n_overconstrained + RIGID_AND_SPARE
    largest = assembly + FACTORS * factorisation + KRYLOV * n_pairs * solve + ROUNDS * round_
    share = sum(solid.n_nodes for solid in solids.values()) / mesh.n_nodes
    # the counting factorisation is held beside the first one
    memory = comm.allreduce(1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * 1.5
    return Trial(name, meshed.solid.n_dofs, assembly, factorisation, solve, memory, share * largest)
