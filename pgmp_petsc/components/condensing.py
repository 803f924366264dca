"""Condensing all continuum bodies of a scene, body by body, dealt to groups of ranks.

What a build with continuum bodies will take, from one trial factorisation and solve of its largest body.

Condensing a body takes its assembly, two factorisations (one for solves, one that counts eigenvalues by inertia and
keeps nothing) and solves in blocks: those of the modes and of the frames' answers, round by round, all columns at once,
which take little longer than one: a solve waits for the factor to come from memory, or from files. Time and memory of
bodies of the same kind grow with their unknowns, a little faster for bulky ones; they are taken as proportional here.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgmp_petsc.bodies.component import Component, rigid_component
from pgmp_petsc.bodies.framed_solid import FramedSolid, framed_solid
from pgmp_petsc.bodies.large_deformation import SLENDER, LongAxis
from pgmp_petsc.bodies.shape import BodyShape, is_condensed, to_condense
from pgmp_petsc.components.body_problem import BodyProblem, petsc_terms
from pgmp_petsc.components.component_modes import condense, in_floating_frame, own_nodes
from pgmp_petsc.components.large_deformation import with_second_order
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.resources import Timings, free_share
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effect_checks import stressed_bodies
from pgmp_petsc.scene.spanning_values import spanning_values

if TYPE_CHECKING:
    from mpi4py import MPI

# of the free memory, for a factor: the matrices that belong to it, the factorisation that counts eigenvalues, and
# vectors take as much again, and what grows while bodies are condensed comes on top
FACTOR_SHARE = 1.0 / 3.0
# free modes whose foreshortening a body of the checking model follows: all of them would take most of its time, and
# bodies bend in their slowest ones
N_FOLLOWED = 12


class Finished(Protocol):
    """Keeps bodies that are condensed, for a run that is resumed."""

    components: Mapping[str, Component]

    def add_component(self, name: str, component: Component) -> None:
        """Keep one."""


def condensed(
    scene: Scene,
    shapes: Mapping[str, BodyShape],
    group: RankGroup,
    finished: Finished | None = None,
    timings: Timings | None = None,
    large: bool | None = None,
) -> dict[str, BodyShape]:
    """Return the shapes of a scene's bodies with every mesh of continuum elements, and matrices, condensed. Collective
    on ``group.world``.

    Parameters
    ----------
    shapes
        By body; what is no continuum mesh stays as it is.
    group
        Ranks that share a body.
    finished
        Bodies that are condensed already, and where to keep others.
    timings
        Gets this rank's wall time of the phases of `condense`.
    large
        Whether what is of second order in the deformation is wanted; None where the scene says so.

    Raises
    ------
    InputError, RunError
        On all ranks, whichever rank met it.
    """
    done = dict(shapes) | dict({} if finished is None else finished.components)
    waiting = [name for name, shape in done.items() if to_condense(shape)]
    found = {}
    wanted = scene.second_order if large is None else large
    own, stressed, timings = waiting[group.index :: group.count], stressed_bodies(scene), timings or Timings()
    free = free_share(group.world)
    memory = None if free is None else FACTOR_SHARE * free
    with agreed(group.world, "components"), progress(len(own), "condensed bodies", group.world) as bar:
        for name in own:
            meshed = framed_solid(scene, name, shapes[name])
            if scene.bodies[name].flexible:
                check_slender(scene, meshed)
                points, n_modes = serving_points(scene, meshed), scene.reduction.modes + scene.n_overconstrained
                # where errors are estimated, a body in its floating frame follows its foreshortening
                known = wanted or scene.simulation.error_indicator
                body, recovery, _ = condense(
                    meshed.solid, meshed.frames, points, n_modes, group.comm, timings, memory, name in stressed, known
                )
                if known:
                    with timings.phase("second order"):
                        body = with_second_order(
                            body, meshed.solid, recovery, group.comm, scene.nominal, N_FOLLOWED, wanted
                        )
                found[name] = body
            else:
                found[name] = rigid_component(meshed)
            if finished is not None:
                finished.add_component(name, found[name])
            bar.update()
    for part in group.world.allgather(found if group.comm.rank == 0 else {}):
        done.update(part)
    return {name: _floating(shape, scene) for name, shape in done.items()}


def _floating(shape: BodyShape, scene: Scene) -> BodyShape:
    """Return a condensed body with what it is in a floating frame."""
    if not is_condensed(shape, flexible=True):
        return shape
    return replace(shape, floating=in_floating_frame(shape, scene.nominal))


def check_slender(scene: Scene, meshed: FramedSolid, cure: str = 'take "dynamic"') -> None:
    """Refuse static stretching of a flexible body that has no long axis to be stretched along, with the cure.

    Nothing is refused of a body whose third derivative is not known, which no command that needs it takes. Raises
    `InputError`, naming the effect that asks for it, and the cure.
    """
    if not (scene.static_stretching and meshed.solid.third_derivative_known):
        return
    axis = LongAxis(meshed.solid)
    if not axis.is_long:
        effects = (name for name, effect in scene.effects.items() if effect.is_stretching)
        entry = next((f"effects.{name}" for name in effects), "reduction")
        raise InputError(
            f'{entry}.stretching = "static": bodies.{meshed.solid.name} is only {axis.slenderness:.3g} times as '
            f"long as wide, and its stretching is not told from its bending below {SLENDER:g}; {cure}"
        )


@contextmanager
def angle_group(shapes: Mapping[str, BodyShape], group: RankGroup) -> Iterator[RankGroup]:
    """Yield the ranks that share an angle's eigenproblem: each rank alone where all bodies are condensed, as it is
    small.

    Collective on ``group.world``.
    """
    if group.world.size > group.count and all(is_condensed(shape) for shape in shapes.values()):
        with RankGroup.split(group.world, 1) as alone:
            yield alone
    else:
        yield group


def serving_points(scene: Scene, meshed: FramedSolid) -> list[dict[str, float]]:
    """Return the parameter values to serve: where one factor is all that changes, those of any point serve
    everywhere."""
    solid = meshed.solid
    if max(len(solid.weights("mass")), len(solid.weights("stiffness"))) == 1:
        return [scene.nominal]
    used = {name for kind in ("mass", "stiffness") for weight in solid.weights(kind) for name, _ in weight.powers}
    varied = [name for name in sorted(used) if _varies(scene, name)]
    spanning, n = spanning_values(scene, varied)
    # values that the body does not feel are left at the nominal ones
    points = [scene.nominal | {name: float(spanning[name][k]) for name in used} for k in range(n)]
    return [scene.nominal, *(point for k, point in enumerate(points) if point not in [scene.nominal, *points[:k]])]


def _varies(scene: Scene, name: str) -> bool:
    """Return whether it is known how far a parameter may be from its nominal value."""
    parameter = scene.parameters[name]
    return parameter.distribution is not None or parameter.bounds is not None


ROUNDS = 14  # blocks of columns that modes and the frames' answers take, measured with round bars in space
RIGID_AND_SPARE = 9  # eigenvectors beside those asked for
FACTORS = 2
BESIDE = 1.4  # of the memory of the trial: what the count and vectors take, measured the same way


@dataclass(frozen=True)
class Trial:
    """Time and memory that one body took, and those that all are expected to take."""

    body: str  # the body that was tried
    n_dofs: int  # its unknowns
    #: assembly, factorisation, solve: times of the trial, s; the solve is that of one block of columns
    assembly: float
    factorisation: float
    solve: float
    memory: float  # largest memory of all ranks together so far, bytes
    seconds: float  # expected time of condensing all bodies on these ranks, s


def try_largest(scene: Scene, shapes: Mapping[str, BodyShape], comm: MPI.Comm) -> Trial | None:
    """Try the largest continuum body; None where there is none. Collective on `comm`.

    Raises `InputError` or `RunError` if the body's frames or materials are not sound, or the factorisation fails.
    """
    solids = {name: shape for name, shape in shapes.items() if to_condense(shape)}
    if not solids:
        return None
    name = max(solids, key=lambda key: solids[key].n_nodes * solids[key].dimension)
    mesh = solids[name]
    meshed = framed_solid(scene, name, mesh)
    nodes = own_nodes(mesh.n_nodes, comm)
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
