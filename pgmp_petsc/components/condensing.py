"""Condensing all continuum bodies of a scene, body by body, dealt to groups of ranks.

What a build with continuum bodies will take follows from one trial factorisation and solve of its largest body.
Condensing a body takes its assembly, two factorisations (one for solves, one that counts eigenvalues by inertia and
keeps nothing) and solves in blocks: those of the modes and of the frames' answers, round by round, all columns at once,
which take little longer than one: a solve waits for the factor to come from memory, or from files. Time and memory of
bodies of the same kind grow with their unknowns, a little faster for bulky ones; they are taken as proportional here.

Of a flexible body in a floating frame what is left of its mesh is moments, a stiffness and the shapes at its frames. A
body's fields are its lowest free modes and what its frames' forces do beyond them statically; a continuum body's are
taken of those that it is condensed to (`component_modes`), which answer its frames whatever these are joined to. They
are turned to free modes, which are orthogonal to the rigid motions in the mass at nominal parameters, and these are
left out: the frame makes them (`bodies.floating`). Of cells that follow their foreshortening there are all fields that
they are condensed to; beams are shortened by fields of the whole mesh, which follow those that are kept.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import eigh

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings, free_share
from pgmp_petsc.base.surroundings import Comm, alone
from pgmp_petsc.bodies.affine import Monomial, total_at
from pgmp_petsc.bodies.beam2d import CONSISTENT
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.component import SLENDER, Component, linear_fields, rigid_component
from pgmp_petsc.bodies.floating import FloatingBody, Recovery, without_noise
from pgmp_petsc.bodies.framed_solid import FramedSolid, framed_solid
from pgmp_petsc.bodies.matrices import AffineMatrices, ThirdDerivative, weighted_sum
from pgmp_petsc.bodies.shape import BodyShape, is_condensed, to_condense
from pgmp_petsc.components.body_problem import BodyProblem, petsc_terms
from pgmp_petsc.components.component_modes import condense, foreshortened, free_modes, in_floating_frame, own_nodes
from pgmp_petsc.components.large_deformation import LongAxis, foreshortening, with_second_order
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.parameters import spanning_values
from pgmp_petsc.scene.references import points_used, stressed_bodies
from pgmp_petsc.solvers.shift_invert import EQUAL_TOLERANCE

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
    """Return the shapes of a scene's bodies, by body, with every mesh of continuum elements, and matrices, condensed;
    what is no continuum mesh stays as it is. Collective on ``group.world``; ranks of a group share a body.

    `finished` has bodies that are condensed already, and where to keep others; timings get this rank's wall time of the
    phases of `condense`. `large` tells whether what is of second order in the deformation is wanted; None where the
    scene says so. Raises `InputError` and `RunError` on all ranks, whichever rank met it.
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
                body, recovery = condense(
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
    for name in [name for name, shape in done.items() if is_condensed(shape, flexible=True)]:
        done[name] = replace(done[name], floating=in_floating_frame(done[name], scene.nominal))
    return done


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
    known = ((name, scene.parameters[name]) for name in sorted(used))  # how far from their nominal values they may be
    varied = [name for name, one in known if one.varies]
    spanning, n = spanning_values(scene, varied)
    # values that the body does not feel are left at the nominal ones
    points = [scene.nominal | {name: float(spanning[name][k]) for name in used} for k in range(n)]
    return [scene.nominal, *(point for k, point in enumerate(points) if point not in [scene.nominal, *points[:k]])]


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


def try_largest(scene: Scene, shapes: Mapping[str, BodyShape], comm: Comm) -> Trial | None:
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


NOT_SLENDER = "leave geometric_stiffening out, or take pgmp simulate --full"
OTHER = 1e-6  # of a field of norm 1 at other parameter values, the square of what is new
SAME = 1e-12  # of fields of norm 1, the square of what round-off leaves beside the others
DEPENDENT = 1e-9  # of a load, the part that deforms; of answers of norm 1, the square of what is new


def floating_shapes(
    scene: Scene, shapes: Mapping[str, BodyShape], bodies: Sequence[Body], comm: Comm
) -> dict[str, BodyShape]:
    """Return the shapes of a scene's bodies by their names, the flexible ones in floating frames. Collective on `comm`.

    Raises `RunError` if an eigenproblem fails; on all ranks, whichever rank met it.
    """
    flexible = [body for body in bodies if body.flexible]
    own, found = flexible[comm.rank :: comm.size], {}
    with agreed(comm, "component modes"), progress(len(own), "bodies in floating frames", comm) as bar:
        for body in own:
            if body.to_condense:
                # not the mechanism's own, whose mesh has the cross-section of one sample already
                found[body.name] = _of_solid(scene, framed_solid(scene, body.name, shapes[body.name]))
            else:
                found[body.name] = _of_beams(scene, replace(body.alone(), lumps={}), points_used(scene, body.name))
            bar.update()
    done = dict(shapes)
    for part in comm.allgather(found):
        done.update(part)
    return done


def _of_solid(scene: Scene, meshed: FramedSolid) -> FloatingBody:
    """Condense a body on its mesh, and put it into a floating frame."""
    if scene.static_stiffening:
        check_slender(scene, meshed, NOT_SLENDER)
    n_modes, stressed = scene.reduction.modes + scene.n_overconstrained, meshed.solid.name in stressed_bodies(scene)
    points = serving_points(scene, meshed)
    component, recovery = condense(
        meshed.solid, meshed.frames, points, n_modes, alone(), stressed=stressed, large=scene.static_stiffening
    )
    if scene.static_stiffening:
        component = with_second_order(component, meshed.solid, recovery, alone(), scene.nominal)
        return in_floating_frame(component, scene.nominal)  # what foreshortens it is of many fields
    return in_floating_frame(component, scene.nominal, _fewest(component, points, n_modes, stressed))


def _fewest(component: Component, points: Sequence[Mapping[str, float]], n_modes: int, stressed: bool) -> np.ndarray:
    """Return the fewest fields that serve a mechanism's n_modes modes: the rigid motions, as many of the body's lowest
    at each of the parameter values, and what these miss of static answers there, shape (n, k)."""
    d, nominal = component.centres.shape[1], points[0]
    inertia = total_at(component.mass, nominal)
    basis = np.empty((len(inertia), 0))
    for values in points:
        mass, stiffness = (total_at(terms, values) for terms in (component.mass, component.stiffness))
        loads = np.eye(len(mass))[:, : component.n_frame_dofs]
        if stressed:  # inertia forces of rigid motion
            loads = np.hstack([loads, mass @ component.fields])
        here = _answering(*eigh(stiffness, mass), loads, d * (d + 1) // 2, n_modes, by_energy=stressed)
        # what hardly moves makes stresses: the first of the values keep all of their fields
        here = here / np.sqrt(np.einsum("ij,ik,kj->j", here, inertia, here))
        here = here - basis @ (basis.T @ (inertia @ here))
        squares, directions = eigh(here.T @ inertia @ here)
        new = squares > (OTHER if basis.size else SAME)
        basis = np.hstack([basis, here @ directions[:, new] / np.sqrt(squares[new])])
    return basis


def _of_beams(scene: Scene, body: Body, points: Mapping[str, str]) -> FloatingBody:
    """Put a body of beams into a floating frame."""
    matrices, per_node = AffineMatrices([body], range(body.dofs.size)), body.node_dofs
    mass, stiffness = (
        {weight: matrix.toarray() for weight, matrix in terms.items()} for terms in (matrices.mass, matrices.stiffness)
    )
    held = np.array([body.mesh.point(point, blame) for point, blame in points.items()])
    loads = np.zeros((body.dofs.size, per_node * held.size))
    loads[(per_node * held[:, None] + np.arange(per_node)).ravel(), np.arange(per_node * held.size)] = 1.0
    frames = {point: number for number, point in enumerate(points)}
    run, d = _ridden(scene, body), body.mesh.nodes.shape[1]
    if run.size:  # its frames stand in its order
        nodes, held = held, np.concatenate([run, np.setdiff1d(held, run)])
        frames = {point: int(np.flatnonzero(held == node)[0]) for point, node in zip(points, nodes)}
        frames = {str(node): number for number, node in enumerate(held)} | frames
    total_mass, total = (total_at(terms, scene.nominal) for terms in (mass, stiffness))
    stressed = body.name in stressed_bodies(scene)
    (values, vectors), n_rigid = eigh(total, total_mass), d * (d + 1) // 2
    if stressed:  # inertia forces of rigid motion
        fields = linear_fields(body.mesh.nodes).reshape(body.n_nodes, d, -1)
        without_turns = np.pad(fields, ((0, 0), (0, per_node - d), (0, 0))).reshape(len(total_mass), -1)
        loads = np.hstack([loads, total_mass @ without_turns])
        if ways := body.stiffness_ways:  # what these change, to first order
            answers = vectors[:, n_rigid:] @ (vectors[:, n_rigid:].T @ loads / values[n_rigid:, None])
            loads = np.hstack([loads, *(matrix @ answers for weight, matrix in stiffness.items() if weight in ways)])
    n_modes = scene.reduction.modes + scene.n_overconstrained
    # ties of frames need as many fields as they have rows, and what rides on all nodes finds an answer at each
    basis = vectors if run.size else _answering(values, vectors, loads, per_node, n_modes, by_energy=stressed)
    # torsion moves no node: of rotations what they move at the body's extent
    moved = basis * np.where(np.arange(len(basis)) % per_node < d, 1.0, body.extent)[:, None]
    elastic = free_modes(basis.T @ total_mass @ basis, basis.T @ total @ basis, d)
    modes = basis @ (elastic / np.max(np.abs(moved @ elastic), axis=0))
    shapes = modes.reshape(body.n_nodes, per_node, -1)[held]
    reduced = {weight: modes.T @ matrix @ modes for weight, matrix in stiffness.items()}
    moments, reduced = without_noise(_moments_of_beams(body, modes), reduced, scene.nominal, d)
    n = modes.shape[1]
    bent, curved = np.zeros((held.size, d, n, n)), {}
    if scene.static_stiffening:
        # what shortens is of all the mesh's fields, not of these alone, so that none is needed for it
        every, stiff = vectors[:, n_rigid:], np.diag(values[n_rigid:])
        curvature = _curvature_of_beams(body, every, stiff, every.T @ total_mass @ modes, scene.nominal)
        shapes_of_all = every.reshape(body.n_nodes, per_node, -1)[held]
        turned = _turned_sections(body, modes)
        bent, curved = foreshortened(curvature, shapes_of_all, _moments_of_beams(body, every), turned)
    kept = Recovery(body, modes, stressed)
    return FloatingBody(frames, body.mesh.nodes[held], shapes, moments, reduced, bent, curved, kept)


def _ridden(scene: Scene, body: Body) -> np.ndarray:
    """Return the nodes of the runs that joints ride on, run after run.

    Raises `InputError` if different runs share nodes: frames of a body in a floating frame have one order.
    """
    found: list[np.ndarray] = []
    for name, joint in scene.joints.items():
        if not joint.rides or joint.connect[0].partition(":")[0] != body.name:
            continue
        point = body.mesh.point(joint.connect[0].partition(":")[2], f"joints.{name}.connect")
        run = np.array(body.mesh.run(point, joint.axes[0])[0])
        if any(set(run) == set(other) for other in found):
            continue
        if any(set(run) & set(other) for other in found):
            words = f"a component model has {body.name} with one run through a node; full-order runs have several"
            raise InputError(problem(f"joints.{name}.direction", words, list(joint.axes[0])))
        found.append(run)
    return np.concatenate([np.zeros(0, dtype=int), *found])


def _curvature_of_beams(
    body: Body, every: np.ndarray, stiffness: np.ndarray, modes: np.ndarray, values: Mapping[str, float]
) -> np.ndarray:
    """Return by what of all elastic fields (n_dofs, n) of a body of beams, with their stiffness, some combinations of
    them (n, m) shorten it, shape (n, m, m)."""
    everywhere, (n, m) = range(body.dofs.size), modes.shape
    rows, columns = np.tril_indices(m)

    def third(vectors: np.ndarray) -> np.ndarray:
        forces = np.empty((n, m, m))
        of_pairs = every.T @ ThirdDerivative([body], everywhere).weighted(every @ vectors, (rows, columns), values)
        forces[:, rows, columns] = forces[:, columns, rows] = of_pairs
        return forces

    stretching = weighted_sum(AffineMatrices([body], everywhere).stretching, values)
    return foreshortening(third, stiffness, every.T @ (stretching @ every), modes)


def _answering(
    values: np.ndarray, vectors: np.ndarray, loads: np.ndarray, n_rigid: int, n_modes: int, *, by_energy: bool
) -> np.ndarray:
    """Return the rigid motions, the lowest elastic modes and what they miss of the static answers to loads that are
    balanced by inertia forces, from all eigenvalues and modes. Modes of one eigenvalue, as those of a round bar across,
    come together: solvers turn them as they like.

    What is missed is measured in the mass, or by its strain energy: forces in sections are made of what hardly moves.
    """
    kept = min(n_rigid + n_modes, values.size)
    kept += int(np.cumprod(values[kept:] - values[kept - 1] < EQUAL_TOLERANCE * values[kept:]).sum())
    amplitudes = vectors.T @ loads
    elastic = amplitudes[n_rigid:]
    # forces that balance inertia forces of rigid motion alone deform nothing
    deforming = np.linalg.norm(elastic, axis=0) > DEPENDENT * np.linalg.norm(amplitudes, axis=0)
    answers = elastic[:, deforming] / values[n_rigid:, None]
    measured = np.sqrt(values[n_rigid:, None]) if by_energy else np.ones((values.size - n_rigid, 1))
    # a beam is far stiffer along than across: each answer counts by itself
    missed = answers[kept - n_rigid :] / np.linalg.norm(measured * answers, axis=0)
    sizes = measured[kept - n_rigid :] * missed
    squares, directions = eigh(sizes.T @ sizes)
    added = missed @ directions[:, squares > DEPENDENT]
    return np.hstack([vectors[:, :kept], vectors[:, kept:] @ (added / np.linalg.norm(added, axis=0))])


def _moments_of_beams(body: Body, modes: np.ndarray) -> dict[Monomial, np.ndarray]:
    """Return the moments of fields of a body of beams, of unit displacements and rotations (n_dofs, n).

    A point at the place ``sum_s eta_s t_s`` of a section moves with ``u + sum_s eta_s phi x t_s``: scalar fields are
    ``a + sum_s eta_s b_s`` with a linear between the nodes, and b from the rotations there; the section's moments are
    those of 1 and of eta_s.
    """
    mesh, n, d = body.mesh, modes.shape[1], body.mesh.nodes.shape[1]
    by_node, spins = modes.reshape(mesh.n_nodes, body.node_dofs, n), _spins(body, modes)
    shared = np.hstack([np.ones((mesh.n_nodes, 1)), mesh.nodes, *by_node[:, :d].swapaxes(0, 1)])
    found: dict[Monomial, np.ndarray] = {}
    terms = body.sections("mass")
    for number, (nodes, length, across) in enumerate(zip(mesh.cells, mesh.lengths, _across(body))):
        fields = [shared[nodes]]
        for t in across:
            turned = np.cross(spins[nodes], t, axisa=1, axisb=0)
            at_rest = np.hstack([np.zeros((2, 1)), np.tile(t[:d], (2, 1))])
            fields.append(np.hstack([at_rest, *(turned[..., k] for k in range(d))]))
        for weight, coefficients in terms.items():
            for coefficient, field in zip(coefficients[number], fields):
                if coefficient:
                    part = coefficient * length * (field.T @ CONSISTENT @ field)
                    found[weight] = found.get(weight, 0.0) + part
    return found


def _turned_sections(body: Body, modes: np.ndarray) -> dict[Monomial, np.ndarray]:
    """Return ``int rho X_k chi_l`` of sections that turn to second order, by weight, shape (d, d, n, n).

    A rotation vector takes t to ``t + phi x t + 1/2 phi x (phi x t)``; directors are linear between the nodes.
    """
    d, n = body.mesh.nodes.shape[1], modes.shape[1]
    spins = _spins(body, modes).swapaxes(1, 2)
    products = np.einsum("aic,ajc->aij", spins, spins)
    found: dict[Monomial, np.ndarray] = {}
    terms = body.sections("mass")
    for number, (nodes, length, across) in enumerate(zip(body.mesh.cells, body.mesh.lengths, _across(body))):
        for weight, coefficients in terms.items():
            for coefficient, t in zip(coefficients[number, 1:], across):
                if not coefficient:
                    continue
                mixed = np.einsum("ai,ajl->lij", spins[nodes] @ t, spins[nodes])
                # 1/2 (a x (b x t) + b x (a x t)) = 1/2 ((a.t) b + (b.t) a) - (a.b) t
                turned = 0.5 * (mixed + mixed.swapaxes(1, 2)) - np.multiply.outer(t, products[nodes].sum(axis=0))
                part = 0.5 * coefficient * length * np.multiply.outer(t[:d], turned[:d])
                found[weight] = found.get(weight, np.zeros((d, d, n, n))) + part
    return found


def _spins(body: Body, modes: np.ndarray) -> np.ndarray:
    """Return the rotation vectors of all nodes of fields of a body of beams, shape (n_nodes, 3, n)."""
    d, n = body.mesh.nodes.shape[1], modes.shape[1]
    turns = modes.reshape(body.n_nodes, body.node_dofs, n)[:, d:]
    return turns if d == 3 else np.insert(turns, 0, np.zeros((2, 1, n)), axis=1)


def _across(body: Body) -> np.ndarray:
    """Return the directions across the elements of a body, in the order of their moments, (n_elements, 2 or 1, 3)."""
    if body.mesh.nodes.shape[1] == 3:
        # rho I_2 is the moment of what lies along t_3, and rho I_3 of what lies along t_2
        return body.axes.swapaxes(1, 2)[:, [2, 1]]
    along = np.diff(body.mesh.nodes[body.mesh.cells], axis=1)[:, 0] / body.mesh.lengths[:, None]
    return np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])[:, None]
