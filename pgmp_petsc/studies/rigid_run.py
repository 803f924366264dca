"""The motion that is to be expected of a scene: that of its mechanism with rigid bodies and locked elastic joints,
under all that acts on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.base.surroundings import alone
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.statements import Statement
from pgmp_petsc.mechanism.unknowns import Unknowns
from pgmp_petsc.models import FullModel
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.results.estimates import Balance
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import Table, quantities_of
from pgmp_petsc.stepping.energies import Energies, joined
from pgmp_petsc.stepping.generalised_alpha import count_steps, integrate
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.static_equilibrium import require_settled
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.records import balance_of

FEW_STEPS = 150
MAX_STEPS = 600  # more do not change an order of magnitude
RESOLVED = 0.15  # largest turn (rad) and share of the largest speed in a step: errors of second order are below 1 %


@dataclass(frozen=True, eq=False)
class RigidRun:
    """Motion of the rigid mechanism."""

    time: np.ndarray  # shape (n_t,), s
    units: dict[str, str]  # of the coordinates, by their names
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


def run_rigid(scene: Scene, meshes: Mapping[str, BodyShape], kinematics: RigidKinematics) -> RigidRun:
    """Integrate the scene's mechanism with all bodies rigid, on one rank.

    With few steps first, and once more with as many as the motion needs. Raises `InputError` or `RunError` if there is
    no static equilibrium to start from, or the run fails.

    Parameters
    ----------
    scene, meshes
        The scene and the mesh of every body, not condensed.
    kinematics
        Of the mechanism, whichever of its bodies deform there.
    """
    stiff = _with_rigid_bodies(scene)
    model = FullModel(stiff, meshes, kinematics)
    given = count_steps(scene.simulation.duration, scene.simulation.step)
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
    times, states, frames, energies = [], [], [], []
    simulation = model.scene.simulation
    simulation = simulation.model_copy(update={"step": simulation.duration / n_steps})
    system = model.single(model.scene.values, alone())
    require_settled(system)
    with system:

        def record(step: int, time: float, state: State) -> None:
            times.append(time)
            states.append([system.unpack(part)[:, 0] for part in (state.q, state.v, state.a)])
            frames.append(system.frames(state)[..., 0])
            energies.append(system.energies(time, state))

        run = integrate(system, simulation, observer=record)
    status = Status(run.status[0])
    parts = np.moveaxis(np.array(states), 0, -1)  # (3, n_dofs, n_t)
    found = _collect(model, np.array(times), parts, np.moveaxis(np.array(frames), 0, -1), energies)
    return (None if status == Status.FINE else status), found


def _needed(run: RigidRun, n_steps: int, turns: np.ndarray) -> int:
    """Return how many steps, `n_steps` doubled, resolve turns and changes of speed of a run that had
    `n_steps`; one unit of each coordinate counts `turns`, rad."""
    turned = np.max(np.abs(np.diff(run.theta, axis=0)) * turns)
    fastest = np.max(np.abs(run.speed), axis=0)
    changed = np.max(np.abs(np.diff(run.speed, axis=0)) / np.where(fastest > 0.0, fastest, 1.0))
    doublings = np.ceil(np.log2(max(turned, changed, RESOLVED) / RESOLVED))
    return n_steps * 2 ** int(min(doublings, 10))


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
    # stresses are those of flexible bodies alone
    changed = {"bodies": bodies, "joints": joints, "materials": materials, "effects": effects}
    return scene.model_copy(update={**changed, "outputs": {}, "fields": {}})


def _collect(
    model: FullModel, time: np.ndarray, parts: np.ndarray, frames: np.ndarray, energies: list[Energies]
) -> RigidRun:
    """Return the run of states (3, n_dofs, n_t) and frames of all nodes (n_nodes, n_frame, n_t)."""
    mechanism, values = model.kinematics.mechanism, model.scene.values
    unknowns, d = Unknowns(mechanism), mechanism.space.dimension

    def rates(statement: Statement, sides: tuple[Attachment, Attachment]) -> tuple[np.ndarray, np.ndarray]:
        """Return s' and s'' of a statement."""
        rows = StatementRows([statement], [sides], unknowns.frame, d)
        slopes, (q, v, a) = rows.gradients(parts[0])[0], parts
        felt, dofs = rows.dofs[0] >= 0, rows.dofs[0][rows.dofs[0] >= 0]
        along_v, along_a = (np.einsum("it,it->t", slopes[felt], part[dofs]) for part in (v, a))
        return along_v, along_a + rows.drift(q, v)[0]

    coordinates = mechanism.coordinates
    theta = np.array([Reading.of_coordinate(c, model.kinematics).value(frames) for c in coordinates])
    moving = np.array([rates(c.statement, c.sides) for c in coordinates])
    joints = {}
    for connection in mechanism.connections:
        name, entry = connection.name, model.scene.joints.get(connection.name)  # welded masses have none
        for motion in () if entry is None else entry.motions:
            if motion == "spin":
                spins = [_spin(unknowns, side, parts) for side in connection.sides]
                joints[name, motion] = np.linalg.norm(spins[1] - spins[0], axis=0)
            else:
                joints[name, motion] = rates(connection.measure(motion), connection.sides)[0]
    heights, total = np.zeros((time.size, d)), 0.0
    for body in mechanism.bodies:
        mass = body.mass_at(values)
        heights += mass * parts[0][unknowns.frame(body.first_node)[:d]].T
        total += mass
    balance = balance_of(time, joined(energies))
    units = {c.name: c.unit for c in coordinates}
    return RigidRun(time, units, theta.T, moving[:, 0].T, moving[:, 1].T, joints, heights, balance, total)


def _spin(unknowns: Unknowns, side: Attachment, parts: np.ndarray) -> np.ndarray:
    """Return the angular velocity ``1/2 sum_j d_j x d_j'`` of a rigid frame in space with directors d, (3, n_t)."""
    if side.on_ground:
        return np.zeros((3, 1))
    directors, rates = (part[unknowns.frame(side.node)[3:]].reshape(3, 3, -1) for part in parts[:2])
    return 0.5 * np.sum(np.cross(directors, rates, axis=1), axis=0)
