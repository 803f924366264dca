"""What runs and builds of the models take, predicted from sizes alone before anything is solved, and which to take; and
candidate bases in the order of what they cost online, with the search for the cheapest that is good enough.

Times are processor times of a step of one sample, on a common processor of 2023. They follow from the numbers of
unknowns and from constants that were measured (`python -m benchmarks.prices` measures them again), so that every rank,
and every number of ranks, predicts the same: what is measured in a run is said afterwards, and decides nothing.

=========================== ==========================================================================
body                        grows with
=========================== ==========================================================================
beams                       nodes
cells in the plane, slender unknowns of the mesh
solids, slender             unknowns of the mesh
in a floating frame         pairs of amplitudes, all of which its moments couple
on the tree of joints       frames in space, and the cube of all coordinates and of the constraints that
                            the tree leaves, whose matrix is full
=========================== ==========================================================================

Local effects come on top, and outputs that are found after every step. Of the scenes of this project predictions were
within a factor of two or three. How often samples meet a stop, or cross another edge of a law, nobody knows before they
run; each time costs as much as thousands of their steps, and is said beside the price (`Price.crossing`).

Over n coordinates a step of a reduced model evaluates ``4^n`` coefficients of each entry of its tables. Bodies in
floating frames keep as many fields as modes are asked for, and the static answers of their joints.

Errors are those that were measured of deformations in the scenes of this project (docs/components.md, docs/costs.md): a
prediction is of their size, and `pgmp tradeoff` measures those of a scene. Where no output is of deformations they
decide nothing: of motions and of forces in joints they are a small share.

A family of candidates is a way to make a basis bigger; its rungs differ in the number of modes alone, so that errors
fall and costs rise along it (docs/method.md, order). Static stretching holds for larger deflections, but leaves out the
vibrations that stretch bodies: where the deformation is small beside them, dynamic stretching goes further. Candidates
that are too costly are not tried (docs/method.md, price of the candidates).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import log
from typing import Any

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.bodies.shape import Shapes, has_long_axis
from pgmp_petsc.controllers.acting import are_stated
from pgmp_petsc.effects import actions_of, effects_of, patterns_of, start_of
from pgmp_petsc.estimates.reference_motion import OF_BESIDE, carrying, found_beside
from pgmp_petsc.full.joint_tree import count_of
from pgmp_petsc.lanes.vectors import LANES, N_POWERS
from pgmp_petsc.mechanism.capabilities import SECONDS, SECONDS_PER_UNKNOWN, Purpose, why_no_grid, why_refused
from pgmp_petsc.mechanism.constraint_set import null_space
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, constraint_jacobian
from pgmp_petsc.models.lengths import why_of_one_mesh
from pgmp_petsc.outputs.joint_forces import InJoint, OfDrive
from pgmp_petsc.outputs.stress import points_of
from pgmp_petsc.reduction.length_family import why_no_family
from pgmp_petsc.results.numbers import plain
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.references import points_used, stressed_bodies
from pgmp_petsc.scene.uses import count_builds, length_names

LOCAL_EFFECT = 1.5e-6  # s, of a step of a sample, Newton corrections included
# s, of a step of a sample of a component model: a pair of a body's amplitudes, a body in space, and of the matrix
PAIR, BODY, CUBE = 1.1e-8, 1.2e-6, 3.3e-11
# s, of a step of a full-order or component sample: a controller, or friction by the force carried, which are found
# beside it; and where lengths are drawn, which part samples: how often what it takes in a batch, but for cells of the
# mesh (3 to 7 were measured, and 1 to 1.5 with cells)
BESIDE, APART = OF_BESIDE / 1e6, 4.0
# s, of a step of a sample whose outputs are forces in joints, by the dimension of space: of the mesh and of components,
# and in the lanes of a reduced model
FORCES, FORCES_IN_LANES = {2: 2e-6, 3: 2.5e-5}, {2: 1e-7, 3: 1.5e-6}
# s, of a step of a sample of the mesh or of components whose outputs are found after it (ensemble.extremes), by the
# dimension of space: where they take rates of frames, multipliers and stresses
FOUND_EVERYWHERE = {
    "rates": {2: 3e-6, 3: 8e-6}, "multipliers": {2: 2.5e-6, 3: 1e-6}, "stresses": {2: 1.6e-6, 3: 5e-6},
}  # fmt: skip
# s, of one of a reduced model: each output, each body and derivative of its poses by the dimension of space, each entry
# of tables that a row of a gap or what modes miss of answers is a product of, each local effect on joints that tell
# their forces, each joint that gives way, and each point of a stress
OUTPUT, POSE, ENTRY, EFFECT, PULLED, POINT = 3e-7, {2: 3.5e-7, 3: 1.2e-6}, 1.1e-10, 5e-7, 4e-6, 1.5e-7
FORCES_APART = {2: 1.2e-4, 3: 1.2e-4}  # s, more, where samples are taken one by one: 70, 80 and 185 us were measured
BY_ITSELF = {2: 1.5e-4, 3: 4.5e-4}  # s, more, of a run of one sample: 70 to 250 us were measured in the plane
# s, of each edge of a law that a sample crosses: of the mesh or of components, 3 to 5 ms were measured; in the lanes
CROSSING, CROSSING_IN_LANES = 4e-3, 1.5e-4
SETTING_UP = {2: 0.04, 3: 0.4}  # s, of a sample of lengths of its own, by the dimension of space
# s, of a step of a sample of a reduced model: by itself, a local effect, and a coefficient of its tables, which come
# from the processor's cache, or where those of LANES samples are more than it holds, from memory
REDUCED_SAMPLE, REDUCED_EFFECT, CACHED, FROM_MEMORY, CACHE = 1.0e-7, 3.0e-7, 4.0e-10, 1.6e-9, 16e6
# s, of a step of a sample of a reduced model in a batch: friction by the force that a joint carries; a controller; both
# where a controller measures deformations, for each model of a length
CARRIED_IN_LANES, CONTROLLED_IN_LANES, READ_APART = 4.5e-6, 1e-6, (1e-4, 1e-5)
MODEL = 0.6  # s, of a build besides its configurations
GAPS = 0.2  # of a configuration's time, for each mode where joints tell their forces: 0.13 to 0.24 were measured
CONDENSING, CONDENSING_POWER = 9e-6, 1.3  # s, of a body of cells by its unknowns; measured from 5,850 to 298,134
# of a body of cells whose matrices are a sum over parameters, as with a random field: fields of a mode, how many times
# as many for each further term, and s for the cube of their number at a configuration; 72, 181, 409 and 577 fields, and
# 8, 8, 100 and 230 ms, were measured with 1, 2, 3 and 5 terms and 15 modes, stresses included
FIELDS, OF_TERM, FIELDS_CUBE = 5.0, 1.9, 1e-9
SERVING = 2.2  # power of their number with which condensing grows: 0.7, 3.7, 12 and 22 s were measured
STRAIN = 1.6e-8  # s, of a strain at a point of a body of cells, from some 80 coordinates of the body condensed
GOOD = 0.01  # share of a deformation up to which an error is small
MANY = 10_000  # samples that a choice is said for
MUCH_QUICKER = 3.0  # times; predictions are within as much
#: Models in sentences, by the names of options and files.
MODELS = {"full": "the mesh", "components": "component modes", "reduced": "the reduced model"}


@dataclass(frozen=True)
class Price:
    """Predicted time of some runs."""

    step: float  # processor time of a step of a sample, s
    steps: float  # steps of all samples together
    crossing: float = 0.0  # processor time of each crossing of an edge, s, which are not among them; 0 without edges

    @classmethod
    def of(cls, mechanism: Mechanism, steps: float, by_itself: bool = False) -> Price:
        """Return the price of steps of a full-order or component model; see `step_seconds`."""
        return cls(step_seconds(mechanism, by_itself), steps, CROSSING * has_edges(mechanism))

    @property
    def seconds(self) -> float:
        return self.step * self.steps

    def __str__(self) -> str:
        return duration_text(self.seconds) + besides(self.crossing)


def has_edges(mechanism: Mechanism) -> bool:
    """Return whether forces of the scene bend somewhere, as at end stops: steps are divided there."""
    return any(action.law.edges for action in actions_of(effects_of(mechanism.scene, mechanism)))


def besides(crossing: float) -> str:
    """Say what contacts take besides steps, s for each; empty where there are none."""
    each = f"and {plain(1e3 * crossing)} ms for each contact that begins or ends"
    return f" ({each}; only runs tell how many these are)" if crossing else ""


def step_seconds(mechanism: Mechanism, by_itself: bool = False) -> float:
    """Return the predicted processor time of a step of one sample of a full-order or component model, s: in a batch, or
    of a run by itself."""
    beside, more = _beside(mechanism.scene, by_itself), carrying(mechanism.scene)
    floating = {body.name: body.n_internal for body in mechanism.bodies if body.blocks("floating")}
    if floating:
        return beside + more * component_step(mechanism, floating)
    return beside + more * (
        LOCAL_EFFECT * n_local(mechanism.scene) + sum(body.step_seconds for body in mechanism.bodies)
    )


def step_of_samples(scene: Scene, step: float, bodies: Iterable[Body] = ()) -> float:
    """Return what a step takes in an ensemble of samples on the mesh of bodies, or of a component model, s, that takes
    `step` in a batch: with lengths that are drawn each sample is set up by itself, and taken by itself."""
    if not {*uncertain_names(scene)} & {*length_names(scene)}:
        return step
    by_itself = SETTING_UP[scene.dimension] / scene.simulation.n_steps + _forces(scene, FORCES_APART)
    as_in_a_batch = scene.beside or any(body.blocks("cells") for body in bodies)
    return (1.0 if as_in_a_batch else APART) * step + by_itself


def component_step(mechanism: Mechanism, fields: Mapping[str, int]) -> float:
    """Return the predicted processor time of a step of a sample of a component model, s, with so many amplitudes a
    body, and without what is found between corrections."""
    pairs, n = sum(m**2 for m in fields.values()), sum(count_of(mechanism)) + sum(fields.values())
    in_space = len(mechanism.bodies) * (mechanism.space.dimension == 3)
    return LOCAL_EFFECT * n_local(mechanism.scene) + PAIR * pairs + BODY * in_space + CUBE * n**3


def _beside(scene: Scene, by_itself: bool = False) -> float:
    """Return what a step of a full-order or component sample takes besides its equations; with anything that is found
    beside it samples go one by one."""
    alone = BY_ITSELF[scene.dimension] if by_itself or scene.beside else 0.0
    return alone + BESIDE * found_beside(scene) + _forces(scene, FORCES)


def _forces(scene: Scene, price: Mapping[int, float]) -> float:
    return price[scene.dimension] * any("multipliers" in output.reads for output in scene.outputs.values())


def _read_everywhere(scene: Scene) -> set[str]:
    """Return what outputs read that are found after every step: all of them, where any is described by its extremes or
    counted; nothing otherwise."""
    outputs, read = scene.outputs.values(), set[str]()
    if not scene.ensemble.with_extremes(scene.outputs) and not any(one.is_counted for one in outputs):
        return read
    for output in outputs:
        read |= {*output.reads} | ({"rates"} if output.derivative else set())
        joint = scene.joints.get(getattr(output, "joint", None))
        if "multipliers" in output.reads and joint is not None and joint.gives_way:
            read.add("rates")
    return read


def _found_in_lanes(scene: Scene, mechanism: Mechanism, m: int, read: set[str]) -> float:
    """Return what a step of a sample of a reduced model takes, s, whose outputs are found after it and read this; m are
    its flexible coordinates."""
    if not read:
        return 0.0
    outputs, r, d = scene.outputs.values(), len(scene.coordinates), scene.dimension
    n, masses, stiffnesses = r + m, len(mechanism.mass_weights), len(mechanism.stiffness_weights)
    found, entries = OUTPUT * len(outputs), 0
    if "rates" in read:
        found += POSE[d] * len(mechanism.bodies) * max([1, *(output.derivative for output in outputs)])
    if "multipliers" in read:
        joints = {one.joint for one in outputs if isinstance(one, InJoint)}
        pulled = sum(bool(scene.joints[joint].gives_way) for joint in joints)
        inertia, bent = n + r * (r + 1) // 2, m * scene.second_order
        entries += d * (len(joints) - pulled) * (
            masses * (inertia * (1 + bent) + r * bent) + stiffnesses * (m + bent * (m + 1) // 2)
        )  # fmt: skip
        found += EFFECT * n_local(scene) + PULLED * pulled
        if any(isinstance(one, OfDrive) for one in outputs):  # by the equations of motion, as a step solves them
            found += reduced_step(m, r, scene.second_order, n_local(scene))
    if "stresses" in read:
        stressed = {body.name: body for body in mechanism.bodies if body.name in stressed_bodies(scene)}
        k = sum(body.dofs.size for body in stressed.values() if not body.to_condense)
        entries += masses * n**2 + stiffnesses * m**2 + k * (masses * n + stiffnesses * m)
        of_points = [(name, stressed[one.body]) for name, one in scene.outputs.items() if "stresses" in one.reads]
        found += POINT * sum(points_of(scene, name, body.stresses(scene)).n_points for name, body in of_points)
    return found + ENTRY * entries * N_POWERS**r


def n_local(scene: Scene) -> int:
    return sum(effect.local for effect in scene.effects.values())


def duration_text(seconds: float) -> str:
    """Return a time in words: ``40 s``, ``12 min``, ``3.1 h``."""
    for unit, size in (("s", 60.0), ("min", 60.0), ("h", 48.0)):
        if seconds < 2.0 * size:
            break
        seconds /= size if unit != "h" else 24.0
    else:
        unit = "days"
    return f"{plain(seconds)} {unit}"


@dataclass(frozen=True)
class Prospect:
    """A model of a scene, as far as it can be told before anything is solved."""

    model: str  # mesh, components or reduced
    refused: str = ""  # why the scene has none; the rest is then 0
    unknowns: int = 0  # of a step
    build: float = 0.0  # s, before the first sample
    step: float = 0.0  # s, of a step of a sample in a batch
    crossing: float = 0.0  # s, of each edge that a sample crosses; see `Price`
    search: float = 0.0  # s, that candidates for a tolerance may take before; 0 where nothing is left open
    error: float = 0.0  # of deformations, or of outputs that are not of these, as a share
    why: str = ""  # which error that is

    @property
    def text(self) -> str:
        if self.refused:
            return f"{self.model}: refused, {self.refused}"
        before = f", {duration_text(self.build)} before the first sample" if self.build else ""
        if self.search:
            before += (
                f", and before that a search by its tolerance, whose candidates may take {duration_text(self.search)} "
                "(reference.budget) besides runs of the reference; pgmp build says what it tries"
            )
        return (
            f"{self.model}: {self.unknowns} unknowns, {plain(1e6 * self.step)} us a step and sample{before}; {self.why}"
        )


def prospects(scene: Scene, meshes: Shapes, mechanism: Mechanism, n_flexible: int, n_loads: int) -> list[Prospect]:
    """Return what is predicted of the mesh, of component modes and of a reduced model: of its flexible coordinates, and
    of the load patterns that static modes could answer."""
    read = _read_everywhere(scene)
    everywhere = sum(price[scene.dimension] for kind, price in FOUND_EVERYWHERE.items() if kind in read)
    edges = has_edges(mechanism)
    n_rigid, fields = len(scene.coordinates), amplitudes(scene, mechanism, scene.reduction.modes)
    answered = scene.reduction.static_modes or not n_loads or scene.reduction.tolerance is not None
    besides, n_carried = STRAIN * n_strains(scene, mechanism), len(scene.carried)
    of_components = carrying(scene) * component_step(mechanism, fields) + besides + _beside(scene)
    of_lanes = are_stated(scene)
    beside = np.array((CARRIED_IN_LANES, CONTROLLED_IN_LANES) if of_lanes else READ_APART)
    beside *= 1 if of_lanes else count_builds(scene)
    in_lanes = float(beside @ (n_carried, len(scene.controllers))) + besides
    in_lanes += _forces(scene, FORCES_IN_LANES) + _found_in_lanes(scene, mechanism, n_flexible, read)
    share = "0.1 to 1 % of deformations, with static answers to loads"
    if not answered:
        share = "1 to 6 % of deformations, without static answers to loads (reduction.static_modes)"
    deformed = any(output.deforms_in(scene) for output in scene.outputs.values())
    found = [
        Prospect(
            "mesh", why_refused(scene, Purpose.FULL, meshes), mechanism.n_dofs, 0.0,
            step_of_samples(scene, step_seconds(mechanism), mechanism.bodies) + everywhere, CROSSING * edges, 0.0, 0.0,
            "errors are those of the elements and of the step",
        ),
        Prospect(
            "components",
            why_refused(scene, Purpose.COMPONENTS, meshes) or why_of_one_mesh(scene, uncertain_names(scene)),
            sum(fields.values()) + sum(count_of(mechanism)), condensing(mechanism),
            step_of_samples(scene, of_components) + everywhere, CROSSING * edges, 0.0, 0.002,
            "0.002 to 0.8 % of deformations",
        ),
        Prospect(
            "reduced", why_refused(scene, Purpose.BUILD, meshes) or why_no_family(scene, meshes),
            n_flexible + n_rigid, build_seconds(scene, mechanism),
            reduced_step(n_flexible, n_rigid, scene.second_order, n_local(scene)) + in_lanes,
            CROSSING_IN_LANES * edges, 0.0 if scene.reduction.tolerance is None else scene.reference.budget,
            0.005 if answered or not deformed else 0.03, share,
        ),
    ]  # fmt: skip
    return [Prospect(one.model, one.refused) if one.refused else one for one in found]


def choice(scene: Scene, meshes: Shapes, found: Sequence[Prospect], n_steps: int) -> str:
    """Return which model to take for how many samples of so many steps, in words; among those whose error is small."""
    good = [one for one in found if not one.refused and one.error <= GOOD]
    compared = not why_refused(scene, Purpose.TRADEOFF, meshes)
    if not good:
        return "no model is predicted to be good enough" + ("; pgmp tradeoff measures them" if compared else "")
    offline, online = (np.array([getattr(one, name) for one in good]) for name in ("build", "step"))
    pieces = cheapest_from(offline, n_steps * online)
    names = [good[row].model for _, row in pieces]
    counts = [f"from {n:.2g} samples on" if n >= MANY else f"from {n} samples on" for n, _ in pieces[1:]]
    said = [names[0], *(f"{name} {count}" for name, count in zip(names[1:], counts))]
    row = [row for n, row in pieces if n <= MANY][-1]
    many = duration_text(offline[row] + MANY * n_steps * online[row])
    apart = besides(good[row].crossing)
    left = [one.model for one in found if not one.refused and one.error > GOOD]
    return (
        f"{', '.join(said)}; {MANY} samples of {n_steps} steps are predicted to take {many}{apart} with "
        f"{good[row].model}"
        + (f"; {', '.join(left)} is left out by its error, small with reduction.static_modes = true" if left else "")
        + ("; pgmp tradeoff measures times and errors" if compared else "")
    )


def quicker(found: Sequence[Prospect], model: str) -> tuple[str, str]:
    """Return the name of a model nearer to the mesh than another one whose steps are predicted to be much quicker, and
    by how much in words; empty if none's are."""
    able = {one.model: one for one in found if not one.refused}
    nearer = list(able)[: list(able).index(model)] if model in able else []
    best = min(nearer, key=lambda name: able[name].step, default="")
    if not best or able[model].step < MUCH_QUICKER * able[best].step:
        return "", ""
    other = "full" if best == "mesh" else best
    slow, quick = (plain(1e6 * able[name].step) for name in (model, best))
    return other, f"a step of a sample of {MODELS[model]} is predicted to take {slow} us, of {MODELS[other]} {quick} us"


def cheapest_from(offline: np.ndarray, online: np.ndarray) -> list[tuple[int, int]]:
    """Return from how many samples on which way is the cheapest: pairs of the number of samples and the way, beginning
    with one sample, of what ways take before and for each sample, shape (n,), s; of as cheap ones the first."""
    n, left, pieces = 1, np.arange(online.size), []
    while True:
        now = int(left[np.lexsort((online[left], (offline + n * online)[left]))[0]])
        pieces.append((n, now))
        left = np.flatnonzero(online < online[now])
        if not left.size:
            return pieces
        # where the lines cross: the first whole number of samples at which the cheaper one is
        crossing = (offline[left] - offline[now]) / (online[now] - online[left])
        n = max(n, int(np.floor(crossing.min()))) + 1


def amplitudes(scene: Scene, mechanism: Mechanism, n_modes: int) -> dict[str, int]:
    """Return how many amplitudes flexible bodies in floating frames are predicted to have for so many modes."""
    found, stressed = {}, stressed_bodies(scene)
    for body in mechanism.bodies:
        if body.flexible:
            rigid = body.dimension * (body.dimension + 1) // 2
            free = (body.dofs.size if not body.to_condense else body.n_internal) - rigid
            answers = rigid * len(points_used(scene, body.name))
            if not body.to_condense and body.name in stressed:
                answers *= 1 + len(body.stiffness_ways)
            found[body.name] = max(min(n_modes + answers, free), 0)
    return found


def n_strains(scene: Scene, mechanism: Mechanism) -> int:
    """Return how many strains of bodies of cells the stress outputs of an instant are found from."""
    bodies, found = {body.name: body for body in mechanism.bodies if body.to_condense}, 0
    for name, entry in scene.outputs.items():
        if "stresses" in entry.reads and entry.body in bodies:
            body = bodies[entry.body]
            found += points_of(scene, name, body.stresses(scene)).n_points * body.dimension * (body.dimension + 1) // 2
    return found


def coefficients(n_flexible: int, n_rigid: int, second_order: bool) -> int:
    """Return how many coefficients of polynomials a step of a reduced model with so many coordinates evaluates for a
    sample; see `reduced.arrays.Layout`."""
    m, n, pairs = n_flexible, n_flexible + n_rigid, n_rigid * (n_rigid + 1) // 2
    entries = n * (n + 1) + pairs * m + m * (m + 1) // 2
    if second_order:
        entries += m * (m + 1) * (m + 2) // 6 + pairs * m * (m + 1) // 2 + n_rigid * m * (m - 1) // 2
    return entries * N_POWERS**n_rigid


def reduced_step(n_flexible: int, n_rigid: int, second_order: bool, n_effects: int) -> float:
    """Return the predicted processor time of a step of a sample of a reduced model, s, with so many local effects."""
    n = coefficients(n_flexible, n_rigid, second_order)
    each = CACHED if 8 * LANES * n <= CACHE else FROM_MEMORY
    return REDUCED_SAMPLE + REDUCED_EFFECT * n_effects + each * n


def condensing(mechanism: Mechanism) -> float:
    """Return the predicted processor time of condensing all bodies of cells, s."""
    cells = (body for body in mechanism.bodies if body.to_condense)
    return sum(CONDENSING * body.n_internal**CONDENSING_POWER * _n_terms(body) ** SERVING for body in cells)


def _n_terms(body: Body) -> int:
    """Return how many terms the mass or the stiffness of a body of cells is a sum of."""
    return max(len(one.solid.weights(kind)) for one in body.to_condense for kind in ("mass", "stiffness"))


def configuration_seconds(n_unknowns: int, n_modes: int, tells_forces: bool) -> float:
    """Return the predicted processor time of a configuration of a build, s, without what condensed bodies add: of its
    eigenproblem, and of the gaps of joints that tell their forces."""
    gaps = GAPS * n_modes if tells_forces else 0.0
    return (SECONDS + SECONDS_PER_UNKNOWN * n_unknowns) * (1.0 + gaps)


def tells_forces(scene: Scene) -> bool:
    """Return whether a reduced model has gaps, for the forces that joints carry."""
    told = {one.joint for one in scene.outputs.values() if isinstance(one, InJoint)}
    return bool(scene.carried) or any(not scene.joints[joint].gives_way for joint in told)


def build_seconds(scene: Scene, mechanism: Mechanism) -> float:
    """Return the predicted processor time of a reduced model's build, s, of all its lengths; bodies of cells are
    condensed first."""
    n_unknowns = sum(body.dofs.size for body in mechanism.bodies if not body.to_condense)
    n_configurations = scene.reduction.angles ** len(scene.coordinates)
    fields = 0.0  # of condensed bodies
    for body in filter(lambda body: body.to_condense, mechanism.bodies):
        n_fields = FIELDS * scene.reduction.modes * (1.0 + OF_TERM * (_n_terms(body) - 1))
        fields += FIELDS_CUBE * min(n_fields, body.n_internal) ** 3
    each = configuration_seconds(n_unknowns, scene.reduction.modes, tells_forces(scene)) + fields
    return count_builds(scene) * (MODEL + condensing(mechanism) + n_configurations * each)


def takes_second_order(scene: Scene) -> bool:
    """Return whether a reduced model of the scene may have terms of second order."""
    return not why_refused(scene.with_entries(reduction={"second_order": True, "tolerance": None}), Purpose.BUILD)


# s, of a configuration and an unknown: each pair of terms of second order, for which an eigenproblem is taken as often
# again, as for modes at other parameter values
PAIR_OF_UNKNOWN = 1.0e-6
SHARE = 0.2  # of the budget, that one candidate may take
MOST_BYTES = 2**30  # that its tables may have


@dataclass(frozen=True)
class CandidatePrices:
    """Figures common to all candidates."""

    limits: Limits
    n_steps: int  # steps of all samples and loads together
    angles: int  # most along each coordinate that the first candidates are built at

    def seconds(self, rung: Rung, angles: int | None = None) -> float:
        """Return the processor time to build a candidate and to run it under all loads, s; at the most angles, or at
        others."""
        m, n = rung.n_flexible, (angles or self.angles) ** self.limits.n_coordinates
        second, others = (bool(rung.entries[key]) for key in ("second_order", "parameter_modes"))
        pairs = m * (m + 1) / 2 if second else 0
        n_unknowns = self.limits.n_unknowns
        each = configuration_seconds(n_unknowns, rung.entries["modes"], self.limits.tells_forces)
        build = MODEL + n * (each * (1 + second + others) + n_unknowns * PAIR_OF_UNKNOWN * pairs)
        return build + self.n_steps * reduced_step(m, self.limits.n_coordinates, second, self.limits.n_local)

    def bytes(self, rung: Rung) -> float:
        """Return the size of its tables; over two turns of a coordinate they are twice as many."""
        m, n, n_terms = rung.n_flexible, self.angles**self.limits.n_coordinates, self.limits.n_terms
        entries = 2.0 * n_terms * m**2
        if rung.entries["second_order"]:
            entries += 2.0 * n_terms * m**3 + self.limits.n_unknowns * m**2
        return 8.0 * n * entries

    def within(self, rung: Rung, budget: float) -> bool:
        """Return whether a candidate is within the budget; see `affordable`."""
        return self.seconds(rung) <= SHARE * budget and self.bytes(rung) <= MOST_BYTES

    def affordable(self, families: Sequence[list[Rung]], budget: float) -> tuple[list[list[Rung]], str]:
        """Return the rungs of every family within a budget, s, the cheapest in any case, and a text on the others."""
        kept, dear = [], []
        for family in families:
            kept.append([rung for rung in family if self.within(rung, budget)] or family[:1])
            dear += [rung for rung in family if rung not in kept[-1]]
        if not dear:
            return kept, ""
        least = min(dear, key=self.seconds)
        curved = " with terms of second order" if least.entries["second_order"] else ""
        what = f"bases of {least.n_flexible} flexible coordinates{curved} and what is dearer were not tried"
        return kept, f"{what}: {self.dear(least, budget)}, or give reduction.modes"

    def dear(self, rung: Rung, budget: float) -> str:
        """Return the predicted time and memory of a candidate beyond the budget, and the cure, in words."""
        seconds = duration_text(self.seconds(rung))
        return (
            f"to build and run such a basis is predicted to take {seconds} of processor time "
            f"and {self.bytes(rung) / 1e6:.0f} MB; allowed are {SHARE:g} of reference.budget = {budget:g} s and "
            f"{MOST_BYTES / 1e6:.0f} MB; raise the budget or shorten simulation.duration"
        )

    def text(self, families: Sequence[Sequence[Rung]]) -> str:
        rungs = [rung for family in families for rung in family]
        dearest = duration_text(max(map(self.seconds, rungs)))
        return (
            f"candidates: {len(rungs)} bases, of which a search tries some; predicted to take "
            f"{duration_text(min(map(self.seconds, rungs)))} to {dearest} of processor time each, built and run"
        )


MODES = (1, 2, 3, 4, 5, 7, 10, 14, 18, 22, 28, 36)
PATIENCE = 3  # rungs that did not help
MIDDLE = 7  # flexible coordinates to begin with
PARAMETER_MODES = 2  # of an extended basis
MOST_CONDENSED = 22  # modes that continuum bodies are condensed for: their fields grow with it, and every eigenproblem
# along each coordinate, and where the search begins, by the number of coordinates: of two it is their square that costs
ANGLES = {
    1: (16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768),
    2: (6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96),
    3: (5, 6, 8, 10, 12, 14, 16, 20, 24),
}
FIRST_ANGLES = {1: 48, 2: 12, 3: 6}
# the spectral scheme of several coordinates keeps a fine grid of tables, however few samples it has
SCHEMES = {1: ("spectral", "spline"), 2: ("spline",), 3: ("spline",)}


@dataclass(frozen=True)
class Limits:
    """Largest sizes that a scene allows."""

    n_modes: int  # flexible modes that the mechanism has, bodies of cells condensed
    n_static: int  # load patterns that static modes can answer
    n_terms: int  # affine terms of mass and stiffness together
    uncertain: bool = False  # whether a parameter has a distribution
    n_coordinates: int = 1  # n_coordinates, n_inertia: rigid coordinates, and the inertia forces of their motion
    n_inertia: int = 1
    second_order: bool = True  # whether a reduced model of the scene may have terms of second order, or be without them
    # modes that bodies of cells are condensed for; other vectors come on top of them. None where it is the meshes that
    # end the modes
    n_condensed: int | None = None
    # whether all flexible bodies have a long axis: terms of second order are then tried with static stretching too
    slender: bool = True
    n_unknowns: int = 0  # n_unknowns, n_local: of the mechanism, bodies of cells condensed, and local effects
    n_local: int = 0
    tells_forces: bool = False  # whether joints tell their forces
    gridded: bool = True  # whether reduced models go over the coordinates on a grid
    refinable: bool = True  # whether meshes can be cut into finer ones and run as the reference: those of lines

    def most_modes(self, beside: int) -> int:
        """Return the most modes that a basis may have beside other vectors."""
        most = self.n_modes - beside
        return most if self.n_condensed is None else min(most, self.n_condensed)

    @property
    def last_mode(self) -> str:
        if self.n_condensed is not None:
            return f"bodies of cells are condensed for {self.n_condensed} modes; give reduction.modes to have more"
        return "these are all flexible modes that the meshes have; finer ones have more"

    @classmethod
    def of(cls, scene: Scene, kinematics: RigidKinematics, n_condensed: int = MODES[-1]) -> Limits:
        """Count, with the kinematics of beams and of bodies that are condensed for so many modes."""
        mechanism, coordinates = kinematics.mechanism, kinematics.coordinates
        start = start_of(scene, mechanism)[0]
        pose, n_released = kinematics.poses(start[None])[..., 0], kinematics.motion(start).released.shape[-1]
        clamped = [coordinate for coordinate in coordinates if coordinate.prescribed]
        n_free = null_space(constraint_jacobian(mechanism, pose, clamped)).independent.size
        n_modes = n_free - (len(coordinates) - len(clamped)) - n_released
        served = n_condensed if any(body.dense for body in mechanism.bodies) and n_modes > n_condensed else None
        matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
        n_static = patterns_of(effects_of(scene, mechanism), matrices).n
        n_terms = len({*mechanism.mass_weights, *mechanism.stiffness_weights})
        n = len(coordinates)
        # where effects add terms of second order, there is nothing to choose
        n_inertia, curved = n * (n + 1) // 2 + len(clamped), not scene.second_order and takes_second_order(scene)
        slender = all(map(has_long_axis, mechanism.shapes.values()))
        uncertain, gridded = bool(uncertain_names(scene)), not why_no_grid(scene, mechanism)
        sizes = mechanism.n_dofs, n_local(scene), tells_forces(scene)
        return cls(n_modes, n_static, n_terms, uncertain, n, n_inertia, curved, served, slender, *sizes, gridded)


@dataclass(frozen=True)
class Rung:
    """A candidate basis."""

    entries: dict[str, Any]  # entries of the table ``reduction``
    n_flexible: int  # flexible coordinates
    cost: float  # multiplications a sample and Newton correction, roughly; see `operations`


def operations(n_flexible: int, n_rigid: int, second_order: bool) -> float:
    """Return the multiplications of one correction of one sample: cubic polynomials of the tables, and factorising."""
    return coefficients(n_flexible, n_rigid, second_order) + n_flexible**3 / 6


def families_of(given: dict[str, Any], limits: Limits) -> list[list[Rung]]:
    """Return the families, the cheapest first, rungs in the order of their cost; entries of the table ``reduction``
    that are `given` are kept."""
    static = given.get("static_modes", limits.n_static > 0)
    orders = (False, True) if limits.second_order else (False,)
    orders = (given["second_order"],) if "second_order" in given else orders
    extensions: list[dict[str, Any]] = []
    for inertia, n_parameter in ((False, 0), (True, PARAMETER_MODES if limits.uncertain else 0)):
        proposed = {"inertia_modes": inertia, "parameter_modes": n_parameter}
        extension = {key: given.get(key, value) for key, value in proposed.items()}
        if extension not in extensions:
            extensions.append(extension)
    families = []
    for second in orders:  # without terms of second order nothing is followed, and there is one kind of stretching
        kinds = ("static", "dynamic") if second and limits.slender else ("dynamic",)
        for kind, extension in product((given["stretching"],) if "stretching" in given else kinds, extensions):
            entries = {"static_modes": static, **extension, "second_order": second, "stretching": kind}
            families.append(_family(entries, given, limits))
    # with given modes there may be no room for an extension
    fitting = [[rung for rung in family if rung.n_flexible <= limits.n_modes] for family in families]
    return [family for family in fitting if family] or families[:1]


def by_distance_from_middle(family: Sequence[Rung]) -> list[Rung]:
    """Return the rungs, those of medium size first, by how many times larger or smaller they are."""
    return sorted(reversed(family), key=lambda rung: abs(log(rung.n_flexible / MIDDLE)))


def _family(entries: dict[str, Any], given: dict[str, Any], limits: Limits) -> list[Rung]:
    """Return the rungs with these entries and more and more modes."""
    beside = limits.n_static * entries["static_modes"] + limits.n_inertia * entries["inertia_modes"]
    beside += entries["parameter_modes"]
    most = limits.most_modes(beside)
    modes = tuple(n for n in MODES if n < most) + ((most,) if 1 <= most <= MODES[-1] else ())
    if "modes" in given:
        modes = (given["modes"],)
    return [
        Rung({"modes": n} | entries, n + beside, operations(n + beside, limits.n_coordinates, entries["second_order"]))
        for n in modes
    ]


def first_passing(
    n: int, passes: Callable[[int], bool], start: int, hopeless: Callable[[int, int], bool] = lambda before, now: False
) -> int | None:
    """Return the first of n candidates that passes, if all after a passing one pass too; None if none was found.

    The search begins at `start`, gallops in the direction that the answer tells and then halves the interval.
    `hopeless` tells of a failing candidate and a later one that fails whether all between were no use; as many as
    `PATIENCE` in a row end the search.
    """
    if n == 0:
        return None
    start = min(start, n - 1)
    if passes(start):
        low, high, taken = -1, start, 0
        while high - low > 1:
            stride = min(2 ** (taken // 2), high - low - 1)  # 1, 1, 2, 2, 4: the answer is often near
            if not passes(high - stride):
                low = high - stride
                break
            high, taken = high - stride, taken + 1
    else:
        low, high, stride, stalled = start, n, 1, 0
        while low < n - 1 and stalled < PATIENCE:
            probe = min(low + stride, n - 1)
            if passes(probe):
                high = probe
                break
            stalled = stalled + probe - low if hopeless(low, probe) else 0
            low, stride = probe, 2 * stride
        if high == n:
            return None
    return bisect_left(range(high), True, low + 1, key=passes)
