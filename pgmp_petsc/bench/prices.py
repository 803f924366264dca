"""What runs and builds of the models take, predicted from sizes alone before anything is solved, and which to take.

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
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.shape import Shapes
from pgmp_petsc.controllers.acting import are_stated
from pgmp_petsc.effects import actions_of, effects_of
from pgmp_petsc.estimates.reference_motion import OF_BESIDE, carrying, found_beside
from pgmp_petsc.full.joint_tree import count_of
from pgmp_petsc.lanes.vectors import LANES, N_POWERS
from pgmp_petsc.mechanism.capabilities import SECONDS, SECONDS_PER_UNKNOWN, Purpose, why_refused
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models.lengths import why_of_one_mesh
from pgmp_petsc.outputs.joint_forces import InJoint
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
# s, of a step of a sample whose outputs are found after it (ensemble.extremes), by the dimension of space: where they
# take rates of frames, multipliers and stresses; 3 and 8, 2 and 1, 1.6 and 5 us were measured of reduced models
FOUND_EVERYWHERE = {
    "rates": {2: 3e-6, 3: 8e-6}, "multipliers": {2: 2.5e-6, 3: 1e-6}, "stresses": {2: 1.6e-6, 3: 5e-6},
}  # fmt: skip
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


def _found_everywhere(scene: Scene) -> float:
    """Return what a step of a sample takes, s, where outputs are found after it, whatever the model: all of them, where
    any is described by its extremes or counted."""
    outputs, read = scene.outputs.values(), set[str]()
    if not scene.ensemble.with_extremes(scene.outputs) and not any(one.is_counted for one in outputs):
        return 0.0
    for output in outputs:
        read |= {*output.reads} | ({"rates"} if output.derivative else set())
        joint = scene.joints.get(getattr(output, "joint", None))
        if "multipliers" in output.reads and joint is not None and joint.gives_way:
            read.add("rates")
    return sum(price[scene.dimension] for kind, price in FOUND_EVERYWHERE.items() if kind in read)


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
    everywhere = _found_everywhere(scene)
    edges = has_edges(mechanism)
    n_rigid, fields = len(scene.coordinates), amplitudes(scene, mechanism, scene.reduction.modes)
    answered = scene.reduction.static_modes or not n_loads or scene.reduction.tolerance is not None
    besides, n_carried = STRAIN * n_strains(scene, mechanism), len(scene.carried)
    of_components = carrying(scene) * component_step(mechanism, fields) + besides + _beside(scene)
    of_lanes = are_stated(scene)
    beside = np.array((CARRIED_IN_LANES, CONTROLLED_IN_LANES) if of_lanes else READ_APART)
    beside *= 1 if of_lanes else count_builds(scene)
    in_lanes = float(beside @ (n_carried, len(scene.controllers))) + besides
    in_lanes += _forces(scene, FORCES_IN_LANES)
    share = "0.1 to 1 % of deformations, with static answers to loads"
    if not answered:
        share = "1 to 6 % of deformations, without static answers to loads (reduction.static_modes)"
    deformed = any(output.deforms_in(scene) for output in scene.outputs.values())
    found = [
        Prospect(
            "mesh", why_refused(scene, Purpose.FULL, meshes), mechanism.n_dofs, 0.0,
            step_of_samples(scene, step_seconds(mechanism), mechanism.bodies), CROSSING * edges, 0.0, 0.0,
            "errors are those of the elements and of the step",
        ),
        Prospect(
            "components",
            why_refused(scene, Purpose.COMPONENTS, meshes) or why_of_one_mesh(scene, uncertain_names(scene)),
            sum(fields.values()) + sum(count_of(mechanism)), condensing(mechanism),
            step_of_samples(scene, of_components), CROSSING * edges, 0.0, 0.002, "0.002 to 0.8 % of deformations",
        ),
        Prospect(
            "reduced", why_refused(scene, Purpose.BUILD, meshes) or why_no_family(scene, meshes),
            n_flexible + n_rigid, build_seconds(scene, mechanism),
            reduced_step(n_flexible, n_rigid, scene.second_order, n_local(scene)) + in_lanes,
            CROSSING_IN_LANES * edges, 0.0 if scene.reduction.tolerance is None else scene.reference.budget,
            0.005 if answered or not deformed else 0.03, share,
        ),
    ]  # fmt: skip
    return [
        Prospect(one.model, one.refused) if one.refused else replace(one, step=one.step + everywhere) for one in found
    ]


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


def quicker(found: Sequence[Prospect]) -> tuple[str, str]:
    """Return the name of the model whose steps are predicted to be much quicker than the reduced one's, and by how
    much in words; empty if none's are."""
    *others, reduced = (one for one in found if not one.refused)
    best = min(others, key=lambda one: one.step, default=reduced)
    if reduced.model != "reduced" or reduced.step < MUCH_QUICKER * best.step:
        return "", ""
    steps = [f"{plain(1e6 * one.step)} us" for one in (reduced, best)]
    name, of = {"mesh": ("full", "the mesh"), "components": ("components", "component modes")}[best.model]
    return name, f"a step of a sample of the reduced model is predicted to take {steps[0]}, of {of} {steps[1]}"


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


def _dense(scene: Scene, mechanism: Mechanism) -> float:
    """Return the predicted processor time of the fields of condensed bodies at a configuration, s."""
    cells = [body for body in mechanism.bodies if body.to_condense]
    n_fields = [FIELDS * scene.reduction.modes * (1.0 + OF_TERM * (_n_terms(body) - 1)) for body in cells]
    return sum(FIELDS_CUBE * min(n, body.n_internal) ** 3 for n, body in zip(n_fields, cells))


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
    each = configuration_seconds(n_unknowns, scene.reduction.modes, tells_forces(scene)) + _dense(scene, mechanism)
    return count_builds(scene) * (MODEL + condensing(mechanism) + n_configurations * each)
