"""The build of a reduced model: effects chosen by size, tolerances met, and what is kept beside the tables.

Which effects matter is estimated for every available effect, before any reduction. The scene's mechanism runs once with
rigid bodies (`run_rigid`). A named effect is as large as its work is beside all energy that is moved around. Of terms
that only a flexible reduced model has, sizes follow from a few configurations of that run:

- forces by velocities: ``rho_k.M rho_lm theta_l' theta_m'`` beside all inertia forces on the coordinates,
- geometric stiffening: the change of the lowest mode's stiffness by loads and inertia forces, beside its eigenvalue
  (`reduction.tables.StiffnessChanges`); forces of springs, dampers and stops are no part of it,
- where joints are elastic, what is of second order too: the rotation of bodies by what they give way under loads and
  inertia forces at rest, `(R^T K_s R) delta = R^T f` with their springs K_s and the motions R that they release,
- inertia of changing mode shapes: the fastest body's spin beside the lowest frequency, as in Coriolis forces on
  vibrations.

For an effect that the scene does not have and that has numbers of its own, the estimate says from which number on it
would matter. With ``effects = "auto"`` a scene has the effects that matter; what comes and goes by its size is in
docs/effects.md, which effects matter. No load is ever added that the scene does not name: the report warns of those.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, Remark, RunError, note, warning
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm, alone
from pgmp_petsc.bench.choice import choose_over_lengths, leaves_open
from pgmp_petsc.bench.prices import prospects, quicker
from pgmp_petsc.bench.reference import Said, condensed_bodies
from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.bodies.shape import Shapes, has_long_axis
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.declare.ideas import EFFECTS
from pgmp_petsc.effects import actions_of, effects_of, loads_of, start_of
from pgmp_petsc.effects.reduction_terms import GeometricStiffening, Gyroscopic, ModeInertia
from pgmp_petsc.effects.springs import Block, linear_springs
from pgmp_petsc.estimates.own_error import condensed_alone
from pgmp_petsc.files.hdf5 import BUILD_AGAIN, RunRecord, open_file, shapes_of
from pgmp_petsc.full.distributed import FullDistributed
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mechanism.closure import size_of
from pgmp_petsc.mechanism.continuation import PoseBranch
from pgmp_petsc.mechanism.joints import Attachment
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism, Unknowns, linear_motion
from pgmp_petsc.models import FullModel
from pgmp_petsc.models.component_file import ComponentsFile, model_of
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.modes.static_modes import SpringStiffness
from pgmp_petsc.outputs.outputs import OutputSet, measured_in, with_outputs
from pgmp_petsc.outputs.readings import Reading, Seen
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.checkpoint import BuildCheckpoint, Finished, SceneCheckpoint
from pgmp_petsc.reduction.length_family import why_no_family
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sampler import BuiltInStress, InfluenceProbe, TurnedLoads
from pgmp_petsc.results import Selection
from pgmp_petsc.results.estimates import Balance
from pgmp_petsc.results.selection import EffectSize, EffectSizes
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.effects import AddedMass
from pgmp_petsc.scene.fields import Table, quantities_of
from pgmp_petsc.scene.parameters import OUTERMOST, outermost_values
from pgmp_petsc.scene.references import parts_of
from pgmp_petsc.scene.units import own_values, values_text
from pgmp_petsc.scene.uses import count_builds, extremes, held, length_names, uses_of
from pgmp_petsc.stepping.generalised_alpha import StateRecord, integrate
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.static_equilibrium import require_balance
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.single_run import balance_of

FEW_STEPS = 150
MAX_STEPS = 600  # more do not change an order of magnitude
RESOLVED = 0.15  # largest turn (rad) and share of the largest speed in a step: errors of second order are below 1 %


@dataclass(frozen=True, eq=False)
class RigidRun:
    """Motion of the rigid mechanism."""

    time: np.ndarray  # shape (n_t,), s
    coordinates: tuple[Coordinate, ...]  # what these are
    #: theta, speed, acceleration: coordinates and their derivatives, shape (n_t, n_theta), rad or m
    theta: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    #: rate of each joint's rotation (``"turning"``) and displacement (``"sliding"``), by its name and motion, shape
    #: (n_t,), rad/s or m/s; of joints that turn about several axes (``"spin"``) the size of the angular velocity
    joints: dict[tuple[str, str], np.ndarray]
    #: first moment of all masses, shape (n_t, d), kg m: its change times an acceleration is the work of a weight
    heights: np.ndarray
    balance: Balance  # balance of energy
    mass: float  # all masses together, kg


def run_rigid(scene: Scene, meshes: Shapes, kinematics: RigidKinematics) -> RigidRun:
    """Integrate the scene's mechanism with all bodies rigid, on one rank, from meshes that are not condensed.

    With few steps first, and once more with as many as the motion needs. Kinematics are of the mechanism, whichever of
    its bodies deform there. Raises `InputError` or `RunError` if there is no static equilibrium to start from, or the
    run fails.
    """
    model = FullModel(_with_rigid_bodies(scene), meshes, kinematics)
    given = scene.simulation.n_steps
    n_steps, turns = min(FEW_STEPS, given), np.array([1.0 / c.scale(kinematics.size) for c in kinematics.coordinates])
    status, found = _run(model, n_steps)
    needed = min(MAX_STEPS, given, _needed(found, n_steps, turns) if status is None else MAX_STEPS)
    if needed > n_steps:
        status, found = _run(model, needed)
    if status is not None:
        raise RunError(f"the rigid mechanism's run stopped at {found.time[-1]:.6g} s: {status.meaning}")
    return found


def _run(model: FullModel, n_steps: int) -> tuple[Status | None, RigidRun]:
    """Return why a run with so many steps failed, None where it did not, and the run."""
    simulation, record = model.scene.simulation.in_steps(n_steps), StateRecord(lambda n_steps: None)
    system = model.single(model.scene.values, alone())
    system.require_settled()
    with system:
        status = Status(integrate(system, simulation, observer=record).status[0])
        return (None if status == Status.FINE else status), _collect(model, system, *record.of_batch())


def _needed(run: RigidRun, n_steps: int, turns: np.ndarray) -> int:
    """Return how many steps, `n_steps` doubled, resolve turns and changes of speed of a run that had
    `n_steps`; one unit of each coordinate counts `turns`, rad."""
    turned = np.max(np.abs(np.diff(run.theta, axis=0)) * turns)
    fastest = np.max(np.abs(run.speed), axis=0)
    changed = np.max(np.abs(np.diff(run.speed, axis=0)) / np.where(fastest > 0.0, fastest, 1.0))
    return n_steps * 2 ** int(min(np.ceil(np.log2(max(turned, changed, RESOLVED) / RESOLVED)), 10))


def _with_rigid_bodies(scene: Scene) -> Scene:
    """Return the scene with rigid bodies, whose sections and materials have the values of the parameters: not every
    rigid body's inertia is affine in them. Densities that are fields have their mean."""

    def valued(table: Table, names: Iterable[str]) -> Table:
        used = [name for name in names if isinstance(getattr(table, name, None), str)]
        return table.model_copy(update={name: scene.number(getattr(table, name)) for name in used})

    bodies = {}
    for name, body in scene.bodies.items():
        section = None if body.section is None else valued(body.section, quantities_of(type(body.section)))
        bodies[name] = valued(body, quantities_of(type(body))).model_copy(
            update={"flexible": False, "section": section}
        )
    materials = {name: valued(material, quantities_of(type(material))) for name, material in scene.materials.items()}
    effects = {k: effect for k, effect in scene.effects.items() if not effect.on_vibrations}
    # rigid bodies do not give way to joints that are off; the mechanism is that of elastic joints that are locked
    joints = {
        k: joint.model_copy(update=dict.fromkeys({"offset", "elastic"} & {*type(joint).model_fields}))
        for k, joint in scene.joints.items()
    }
    # sampled ones whenever they may; stresses are those of flexible bodies alone, and are no measures
    controllers = {k: one.model_copy(update={"sample_time": 0.0}) for k, one in scene.controllers.items()}
    return with_outputs(scene, measured_in(scene)).with_entries(
        bodies=bodies, joints=joints, materials=materials, effects=effects, controllers=controllers, fields={}
    )


def _collect(model: FullModel, system: FullBatch | FullDistributed, time: np.ndarray, states: State) -> RigidRun:
    """Return the run of states at instants (n_t,), s."""
    mechanism, values = model.kinematics.mechanism, model.scene.values
    changes = map(Unknowns(mechanism).frames, system.unknowns_over(states)[1:])
    frames = (system.frames_over(states), *changes)  # with their rates and accelerations
    seen = Seen(tuple(dict(enumerate(part)) for part in frames))
    coordinates = mechanism.coordinates
    motion = np.array([Reading.of_coordinate(c, model.kinematics).jet(seen, 2) for c in coordinates])
    joints = {}
    for connection in mechanism.connections:
        name, entry = connection.name, model.scene.joints.get(connection.name)  # welded masses have none
        for kind in () if entry is None else entry.motions:
            if kind == "spin":
                spins = [_spin(side, frames) for side in connection.sides]
                joints[name, kind] = np.linalg.norm(spins[1] - spins[0], axis=0)
            else:
                measure = Reading("MEASURE", connection.sides, connection.measure(kind), mechanism.space)
                joints[name, kind] = measure.jet(seen, 1)[1]
    heights, total = np.zeros((time.size, mechanism.space.dimension)), 0.0
    for body in mechanism.bodies:
        mass = body.mass_at(values)
        heights += mass * frames[0][body.first_node, : mechanism.space.dimension].T
        total += mass
    balance = balance_of(time, system.energies_over(time, states))
    return RigidRun(time, tuple(coordinates), *motion.transpose(1, 2, 0), joints, heights, balance, total)


def _spin(side: Attachment, frames: Sequence[np.ndarray]) -> np.ndarray:
    """Return the angular velocity ``1/2 sum_j d_j x d_j'`` of a rigid frame in space with directors d, (3, n_t)."""
    if side.on_ground:
        return np.zeros((3, 1))
    directors, rates = (part[side.node, 3:12].reshape(3, 3, -1) for part in frames[:2])
    return 0.5 * np.sum(np.cross(directors, rates, axis=1), axis=0)


N_INSTANTS = 16  # at which modes are computed
DEFAULT_TOLERANCE = 1e-3
SERIOUS = 0.1  # share from which on leaving an effect out is worth a warning
AT_REST = 1e-14  # of the energy that moves the mechanism by its own size within the run: less is round-off
RESTS = "the mechanism rests, so that no energy is moved around"
#: Terms of the reduced model that the estimate can add or leave out.
TERMS = ("gyroscopic", "geometric_stiffening", "mode_inertia")


def estimate_effects(
    scene: Scene, meshes: Shapes, branch: PoseBranch | None = None, shapes: Shapes | None = None
) -> EffectSizes:
    """Estimate the size of every available effect, on one rank, from meshes that are not condensed.

    The assembly branch of the mechanism is given where it is known (`RigidKinematics`), and so are `shapes`, the bodies
    condensed with what is of second order (`condensed`). Raises `InputError` or `RunError` if the mechanism is not
    sound, a body cannot be condensed, or the rigid run fails.
    """
    check_capabilities(scene, Purpose.SIZES)
    if shapes is None:
        with RankGroup.split(alone(), 1) as group:
            shapes = condensed(scene, meshes, group, large=True)
    kinematics = RigidKinematics(Mechanism.from_scene(scene, shapes).straight, branch)
    run = run_rigid(scene, meshes, kinematics)
    tolerance, exchanged = scene.reduction.tolerance or DEFAULT_TOLERANCE, _exchanged(scene, kinematics, run)
    sizes = _at_ends(scene, meshes, kinematics, _named(scene, run, exchanged, tolerance), tolerance)
    sizes += _terms(scene, shapes, kinematics, run, tolerance)
    sizes += _unnamed(scene, run, exchanged, tolerance)
    largest = np.max(np.abs(run.speed), axis=0)
    speeds = {c.name: float(c.shown(speed)) for c, speed in zip(kinematics.coordinates, largest)}
    told = tuple(_warning(size, tolerance) for size in sizes if _is_missing(scene, size))
    system = scene.system
    units = {c.name: system.unit(c.unit) for c in kinematics.coordinates}
    moved = float(system.shown(exchanged, "J"))
    return EffectSizes(tolerance, tuple(sizes), speeds, moved, told, units, system.unit("J"))


def remarks_on_sizes(scene: Scene, meshes: Shapes, branch: PoseBranch | None = None) -> tuple[Remark, ...]:
    """Return which effects a scene leaves out although they matter, or why their sizes are not known; on one rank."""
    continuum = ", ".join(f"bodies.{name}" for name, body in scene.bodies.items() if body.continuum)
    if continuum:
        why = f"with bodies of continuum elements ({continuum}) that takes them condensed with terms of second order"
        return (note(f"sizes of effects were not estimated: {why}; pgmp check --effects does it"),)
    try:
        sizes = estimate_effects(scene, meshes, branch)
    except PgmpError as error:
        return (note(f"sizes of effects were not estimated: {error}"),)
    missing = [size for size in sizes.sizes if _is_missing(scene, size)]
    small = [size for size in missing if size.share <= SERIOUS or size.kind == "gravity"]
    remarks = []
    for size in (one for one in missing if one not in small):
        share = f"({size.measure}), whose share in the motion of the rigid mechanism is {size.share:.2g}"
        cure = "name it in [effects]; compare with pgmp simulate SCENE --full"
        remarks.append(warning(f"the scene leaves out {size.kind} {share}: {cure}"))
    beyond = ", ".join(f"{size.kind} {size.share:.2g}" for size in small if size.share > sizes.tolerance)
    if beyond:
        text = f"the scene leaves out effects with shares beyond {sizes.tolerance:g}: {beyond}"
        remarks.append(note(f"{text}; see pgmp check --effects"))
    remarks += [note(_beside_another(size)) for size in small if size.share <= sizes.tolerance]
    return tuple(remarks)


def _exchanged(scene: Scene, kinematics: RigidKinematics, run: RigidRun) -> float:
    """Return the energy that a run moves around, J; 0 where the mechanism rests."""
    # what moves a mechanism by its own size within the run
    scale = run.mass * (size_of(kinematics.mechanism) / scene.simulation.duration) ** 2
    return run.balance.exchanged if run.balance.exchanged > AT_REST * scale else 0.0


def _at_ends(
    scene: Scene, meshes: Shapes, kinematics: RigidKinematics, sizes: Iterable[EffectSize], tolerance: float
) -> list[EffectSize]:
    """Return sizes of the scene's effects; of those that are small with nominal parameters, and hold some that vary,
    the largest at either end of what these are in samples."""
    found, ends = {size.name: size for size in sizes}, outermost_values(scene, OUTERMOST)
    lengths, holding = length_names(scene), dict[str, set[str]]()
    for use in uses_of(scene):
        table, name, *_ = use.entry.split(".")
        small = use.parameter and table == "effects" and name in found and not found[name].keeps
        if small and use.parameter not in lengths and scene.parameters[use.parameter].varies:
            holding.setdefault(use.parameter, set()).add(name)
    for parameter, value in ((name, end) for name in sorted(holding) for end in ends[name]):
        there, at = held(scene, {parameter: value}), f"at {values_text(scene, {parameter: value})}"
        try:
            run = run_rigid(there, meshes, kinematics)
            again = _named(there, run, _exchanged(there, kinematics, run), tolerance)
        except PgmpError as error:
            again = [replace(found[name], keeps=True, measure=f"not known: {error}") for name in holding[parameter]]
        for size in again:
            before = found[size.name]
            larger = size.share > before.share or (size.keeps and not before.keeps)
            if size.name in holding[parameter] and larger:
                found[size.name] = replace(size, measure=f"{size.measure}, {at}")
    return list(found.values())


def _named(scene: Scene, run: RigidRun, exchanged: float, tolerance: float) -> list[EffectSize]:
    """Return the sizes of what acts by forces in the scene, by its work; not known where the mechanism rests."""
    sizes = []
    for name, effect in scene.effects.items():
        if effect.acts == "reduction":
            continue
        if effect.on_vibrations:
            about = "acts on vibrations, which a rigid mechanism has not"
            sizes.append(EffectSize(name, effect.type, np.nan, True, about))
        elif isinstance(effect, AddedMass):
            share = scene.number(effect.mass) / run.mass
            sizes.append(EffectSize(name, effect.type, share, True, "of all masses"))
        else:
            work = sum((run.balance.work.get(part, np.zeros(1)) for part in parts_of(name, effect)), np.zeros(1))
            share = float(np.max(np.abs(work))) / exchanged if exchanged else np.nan
            keeps = not share <= tolerance or effect.cause
            about = "its work, of the energy moved around" if exchanged else f"not known: {RESTS}"
            if any(joint.gives_way for joint in scene.joints.values()):
                about += ", elastic joints locked"
            sizes.append(EffectSize(name, effect.type, share, keeps, about))
    return sizes


def _terms(
    scene: Scene, shapes: Shapes, kinematics: RigidKinematics, run: RigidRun, tolerance: float
) -> list[EffectSize]:
    if not any(body.flexible for body in scene.bodies.values()):
        return []
    names = {effect.type: name for name, effect in scene.effects.items()}
    shares, rotation = _shares_of_terms(scene, shapes, kinematics, run)
    local = sorted({action.effect for action in actions_of(effects_of(scene, kinematics.mechanism))})
    without = f"; forces of {', '.join(local)} are no part of it" if local else ""
    about = {
        "gyroscopic": "forces by velocities, of all inertia forces on the coordinates",
        "geometric_stiffening": f"change of the lowest mode's stiffness by the forces in the bodies{without}",
        "mode_inertia": "spin of the fastest body, of the lowest frequency",
    }
    if rotation > shares["geometric_stiffening"]:
        shares["geometric_stiffening"] = rotation
        about["geometric_stiffening"] = "rotation of bodies by what elastic joints give way, rad"
    # both halves of what is of second order are needed together
    second_order = max(shares["geometric_stiffening"], shares["mode_inertia"]) > tolerance
    keeps = dict.fromkeys(TERMS, second_order) | {"gyroscopic": shares["gyroscopic"] > tolerance or second_order}
    return [EffectSize(names.get(kind, ""), kind, shares[kind], keeps[kind], about[kind]) for kind in TERMS]


def _shares_of_terms(
    scene: Scene, shapes: Shapes, kinematics: RigidKinematics, run: RigidRun
) -> tuple[dict[str, float], float]:
    """Return the shares of the reduced model's terms, and the largest rotation by what elastic joints give way, rad."""
    mechanism = kinematics.mechanism
    matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
    effects = effects_of(scene, mechanism)
    loads = loads_of(effects, matrices)
    by_name = {effect.name: effect for effect in effects}
    load_weights = evaluate_weights([load.weight for load in loads], scene.values)
    mass_weights = evaluate_weights(mechanism.mass_weights, scene.values)
    instants = _instants(run, kinematics)
    scales = np.array([coordinate.scale(kinematics.size) for coordinate in kinematics.coordinates])
    by_speed, by_acceleration, stiffening, spins, rotations = [], [], [0.0], [0.0], [0.0]
    springs = SpringStiffness(kinematics, linear_springs(actions_of(effects)), scene.values)
    with ModalProblem(kinematics, scene.values, 1, alone(), matrices) as problem:
        turned, probe = TurnedLoads(problem, loads), InfluenceProbe(problem, ())
        stress = BuiltInStress(problem, scene, shapes)
        kinematics.follow(run.theta[instants])
        for k in instants:
            theta, speed, acceleration = run.theta[k], run.speed[k], run.acceleration[k]
            modes = problem.solve(theta)
            rigid = modes.rigid
            centripetal = np.einsum("ikl,k,l->i", modes.rigid_curvature, speed, speed)
            m_rigid = problem.times_mass(rigid)
            by_speed.append(scales * (m_rigid.T @ centripetal))
            by_acceleration.append(scales * (m_rigid.T @ rigid @ acceleration))
            amplitudes = np.array([float(by_name[load.effect].amplitude(run.time[k])) for load in loads])
            i, j = np.tril_indices(speed.size)
            moving = np.concatenate([acceleration, np.where(i == j, 1.0, 2.0) * speed[i] * speed[j]])
            forces = np.concatenate([load_weights * amplitudes, np.outer(mass_weights, moving).ravel()])
            change = probe.at(modes, turned.at(theta))[0] @ forces + stress.at(modes)[0, 0]
            stiffening.append(abs(float(change)) / modes.eigenvalues[0])
            pushed = turned.at(theta) @ (load_weights * amplitudes)
            pushed = pushed - problem.times_mass((rigid @ acceleration + centripetal)[:, None])[:, 0]
            released = linear_motion(mechanism, kinematics.motion(theta).released)
            rotations.append(_given_way(released, springs.at(theta, matrices, alone()), pushed, mechanism))
            spins.append(_fastest_spin(kinematics, theta, speed) / np.sqrt(modes.eigenvalues[0]))
    by_speed, by_acceleration = np.abs(by_speed).max(initial=0.0), np.abs(by_acceleration).max(initial=0.0)
    largest = max(by_speed, by_acceleration)
    shares = (by_speed / largest if largest > 0.0 else 0.0, max(stiffening), max(spins))
    # plain numbers: what is chosen by them becomes an entry of a scene, and is written as one
    return dict(zip(TERMS, map(float, shares))), float(max(rotations))


def _given_way(released: np.ndarray, springs: Sequence[Block], forces: np.ndarray, mechanism: Mechanism) -> float:
    """Return the largest rotation of a node by what elastic joints give way at rest under forces (n_dofs,), rad.

    `released` are the motions that they allow with the coordinates held, shape (n_dofs, n_released), against which
    their own springs act, and others.
    """
    if not released.shape[1]:
        return 0.0
    stiffness = np.zeros(2 * released.shape[1:])
    for one in springs:
        stiffness += released[one.dofs].T @ one.matrix @ released[one.dofs]
    moved = released @ np.linalg.lstsq(stiffness, released.T @ forces, rcond=None)[0]
    return float(np.max(np.linalg.norm(mechanism.by_node(moved)[:, mechanism.space.dimension :], axis=1)))


def _fastest_spin(kinematics: RigidKinematics, theta: np.ndarray, speed: np.ndarray) -> float:
    """Return the largest spin of a flexible body, rad/s."""
    d = kinematics.mechanism.space.dimension
    gradients = (kinematics.motion(theta).velocities[:, d:] @ speed).reshape(-1, d, d)
    flexible = [body.flexible for body in kinematics.mechanism.bodies]
    # a skew matrix has every component of the spin twice
    return float(np.max(np.linalg.norm(gradients[flexible], axis=(1, 2)) / np.sqrt(2.0), initial=0.0))


def _instants(run: RigidRun, kinematics: RigidKinematics) -> list[int]:
    """Return steps evenly over the run and those of extreme speeds, where the coordinates are within their range.

    Raises `RunError` if there is none.
    """
    inside = np.flatnonzero(kinematics.within_reach(run.theta))
    if not inside.size:
        names = ", ".join(f"coordinates.{coordinate.name}.range" for coordinate in kinematics.coordinates)
        raise RunError(f"the rigid mechanism is nowhere within {names} while it moves; widen the range")
    even = inside[np.linspace(0, inside.size - 1, min(N_INSTANTS, inside.size)).astype(int)]
    columns = [column for part in (run.speed, run.acceleration) for column in part.T]
    fastest = [inside[np.argmax(np.abs(column[inside]))] for column in columns]
    return sorted({int(k) for k in (*even, *fastest)})


def _unnamed(scene: Scene, run: RigidRun, exchanged: float, tolerance: float) -> list[EffectSize]:
    """Return the sizes of effects that the scene does not have, or the numbers from which on they would matter."""
    here, sizes = {effect.type for effect in scene.effects.values()}, []
    for name, kind in zip(EFFECTS.names, EFFECTS.found()):
        found = None if name in here else kind.if_added(scene, run, exchanged, tolerance)
        if found is not None:
            share, about = found
            sizes.append(EffectSize("", name, share, share > tolerance, about))
    return sizes


def _warning(size: EffectSize, tolerance: float) -> str:
    if size.share > tolerance:
        return f"the scene leaves out {size.kind}, whose share of {size.share:.2g} exceeds the tolerance"
    return _beside_another(size)


def _beside_another(size: EffectSize) -> str:
    """Return what is said of a term that is too small to matter by itself."""
    text = f"the scene leaves out {size.kind} (share {size.share:.2g})"
    return f"{text}, without which another term that it leaves out is not taken"


def _is_missing(scene: Scene, size: EffectSize) -> bool:
    """Return whether an effect of known size matters and is not in the scene."""
    terms = dict.fromkeys(TERMS, scene.second_order) | {"gyroscopic": scene.gyroscopic}
    return bool(not terms.get(size.kind, size.name) and size.keeps and not np.isnan(size.share))


def choose_effects(scene: Scene, meshes: Shapes, shapes: Shapes) -> tuple[Scene, EffectSizes]:
    """Return the scene with the effects that matter, and the estimate that chose them; raises as `estimate_effects`."""
    sizes = estimate_effects(scene, meshes, shapes=shapes)
    keeps = dict.fromkeys(TERMS, False) | {size.kind: size.keeps for size in sizes.sizes if size.kind in TERMS}
    kept = {size.name for size in sizes.sizes if size.name and size.keeps and size.kind not in TERMS}
    of_plugins = {name for name, one in scene.effects.items() if one.acts == "reduction" and one.type not in TERMS}
    effects = {name: effect for name, effect in scene.effects.items() if name in kept | of_plugins}
    given = {effect.type: (name, effect) for name, effect in scene.effects.items() if effect.type in TERMS}
    wanted, is_given = [], any(effects[name].second_order for name in of_plugins)
    if not (keeps["gyroscopic"] or is_given):
        wanted.append(Gyroscopic(type="gyroscopic", keep=False))
    second_order = scene.reduction.second_order
    if not (second_order or is_given) and keeps["geometric_stiffening"]:
        stretching = "static" if all(has_long_axis(shape) for shape in shapes.values()) else "dynamic"
        stiffening = GeometricStiffening(type="geometric_stiffening", stretching=stretching)
        wanted += [stiffening, ModeInertia(type="mode_inertia")]
    for term in wanted:
        name, effect = given.get(term.type, (_free_name(term.type, effects), term))
        effects[name] = term if term.type == "gyroscopic" else effect
    changed = {"effects": "named", "second_order": second_order and keeps["geometric_stiffening"]}
    left = [size for size in sizes.sizes if size.name in scene.effects and size.name not in effects]
    chosen = scene.with_entries(effects=effects, reduction=changed)
    if left:
        small = ", ".join(f"{size.name} (share {size.share:.2g})" for size in left)
        said = f'reduction.effects = "auto" leaves out {small}; pgmp info says of what these are shares'
        chosen = chosen.with_remarks((*chosen.remarks, note(said)))
    return chosen, sizes


def _free_name(wanted: str, taken: Mapping[str, object]) -> str:
    while wanted in taken:
        wanted += "_"
    return wanted


@dataclass(frozen=True)
class Built:
    """A reduced model and what its file keeps beside it."""

    kind: ClassVar[str] = "rom"
    rom: ReducedOrderModel | None  # on the first rank, None elsewhere
    selection: Selection | None = None  # what was chosen for tolerances; None where nothing was
    sizes: EffectSizes | None = None  # of effects, where they were chosen by size
    # what is to be removed once the file is written; None where nothing was kept on the way
    checkpoint: SceneCheckpoint | None = None

    def write(self, path: Path) -> None:
        parts = [] if self.selection is None else [self.selection.put]
        parts += [] if self.sizes is None else [self.sizes.put]
        self.rom.write(path, *parts)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read ROM.h5; by one process. Raises as `ReducedOrderModel.read`."""
        rom = ReducedOrderModel.read(path)
        with open_file(path, "rom") as file, shapes_of(file, BUILD_AGAIN):
            return cls(rom, Selection.found_in(file), EffectSizes.found_in(file))

    def figures(self) -> dict[str, object]:
        """Return the figures of the model as plain data."""
        rom = self.rom
        tables, frequencies = rom.tables, rom.frequencies_hz
        terms = {name: getattr(tables, name).shape[1] for name in ("mass", "stiffness", "load")}
        return {
            "kind": "rom",
            "configurations": len(frequencies),
            "modes": frequencies.shape[1],
            "parameter_modes": rom.points.n_vectors,
            "other_modes": tables.n_modes - frequencies.shape[1] - rom.points.n_vectors,
            "frequencies_hz": {"min": frequencies.min(axis=0), "max": frequencies.max(axis=0)},
            "terms": terms,
            "least_cosine": rom.cosines.min(),
            "chosen": None if self.selection is None else self.selection.chosen,
        }


def build(
    scene: Scene, meshes: Shapes, group: RankGroup, say: Said, output: Path | None = None, resume: bool = False
) -> Built:
    """Build the reduced model of a scene with the mesh of every body; groups share an eigenproblem. Collective on
    ``group.world``.

    The sizes of effects, and what errors are measured against, go to `say` before it is run. Finished parts are kept
    beside the output until `Built.checkpoint` is removed, none without one; `resume` takes up what is there. Raises
    `InputError` or `RunError` on all ranks, whichever rank met it.
    """
    comm = group.world
    on_root(comm, _check_ahead, scene, meshes)
    sizes, shapes, choice, checkpoint = None, meshes, None, None
    if scene.reduction.effects == "auto":
        shapes = condensed(scene, meshes, group, large=True)
        scene, sizes = on_root(comm, choose_effects, scene, meshes, shapes)
        say("\n".join(sizes.lines()))
    is_open = leaves_open(scene)
    if length_names(scene):
        say(_price(scene))
    if output is not None and is_open:
        checkpoint = Finished(output, {"command": "build"}, scene, meshes, comm, resume)
    elif output is not None:
        checkpoint = BuildCheckpoint(output, scene, meshes, group, resume)
    try:
        if is_open:
            choice = choose_over_lengths(scene, meshes, group, say, checkpoint)
            rom = choice.rom
        else:
            rom = build_rom(scene, shapes, group, checkpoint=checkpoint)
    except InputError:
        if checkpoint is not None:
            checkpoint.forget()
        raise
    with agreed(comm, "estimating the sizes of effects"):
        if rom is not None and sizes is None:
            # with a tolerance for the step it is the chosen scene that runs
            rom = _with_remarks(rom, scene if choice is None else choice.scene, meshes)
    return Built(rom, None if choice is None else choice.selection, sizes, checkpoint)


def build_components(scene: Scene, meshes: Shapes, comm: Comm) -> ComponentsFile | None:
    """Condense the bodies of a scene to its component model: on the first rank, None elsewhere. Collective on `comm`.
    Raises `InputError`, `RunError`; on all ranks, whichever rank met it."""
    timings = Timings()
    with timings.phase("components"):
        bodies = condensed_bodies(scene, meshes, comm)
    with agreed(comm, "preparing the component model"), timings.phase("assembly"):
        model = model_of(scene, bodies, n_ranks=comm.size)  # refuses what no run of it could have
        model.require_taken()
        remarks = (*condensed_alone(model), *model.kinematics.remarks, *scene.remarks)
    timings = timings.maximum(comm)
    record = RunRecord(scene_to_toml(scene), own_values(scene), None, comm.size, timings.as_dict(), remarks)
    return ComponentsFile(bodies=bodies, record=record) if comm.rank == 0 else None


def _check_ahead(scene: Scene, meshes: Shapes) -> None:
    """Refuse outputs and starts that no run of the model could have, before anything long is done for it."""
    check_capabilities(scene, Purpose.BUILD, meshes)
    kinematics = RigidKinematics(Mechanism.from_scene(scene, meshes))
    OutputSet.of(scene, kinematics)
    if why := why_no_family(scene, meshes):
        raise InputError(why)
    if not scene.initial.equilibrium and any(joint.offset is not None for joint in scene.joints.values()):
        require_balance(scene, kinematics, start_of(scene, kinematics.mechanism)[0], scene.values)


def _price(scene: Scene) -> str:
    """Say what lengths as parameters make of the build."""
    names, reduction = length_names(scene), scene.reduction
    n_builds, n = count_builds(scene), reduction.angles ** len(scene.coordinates)
    first = ""
    if reduction.sampling_tolerance is not None:
        count = len(list(extremes(scene))) + 1
        first = f"; reduction.sampling_tolerance takes {count} builds before, to find angles, and may add some to all"
    points = f"models at {n_builds - 1} points, {reduction.length_points} along each, and one more to compare with"
    what = f"lengths, places and ratios ({', '.join(names)}): {points}, times {n} configurations"
    return f"{what} are {n_builds * n} eigenproblems{first}"


def _with_remarks(rom: ReducedOrderModel, scene: Scene, meshes: Shapes) -> ReducedOrderModel:
    """Add to a reduced model's remarks which effects its scene leaves out although they matter, and which model is much
    quicker; on one rank."""
    timings = Timings()
    with timings.phase("effect sizes"):
        found = remarks_on_sizes(scene, meshes, rom.branch)
    models = prospects(scene, meshes, Mechanism.from_scene(scene, meshes), rom.tables.n_modes, 0)
    better, why = quicker(models, "reduced")
    record, more = rom.record, ()
    if better:
        more = (note(f"{why}: runs and ensembles of the scene with --{better} are quicker"),)
    remarks, seconds = (*record.remarks, *found, *more), {**record.timings, **timings.as_dict()}
    return replace(rom, record=replace(record, remarks=remarks, timings=seconds))
