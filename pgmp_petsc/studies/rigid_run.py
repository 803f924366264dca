"""The motion that is to be expected of a scene: that of its mechanism with rigid bodies, under all that acts on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.energies import Energies, joined
from pgmp_petsc.dynamics.generalised_alpha import count_steps, integrate
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.settled_start import require_settled
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.statements import along
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.models import FullModel
from pgmp_petsc.results.balance import Balance
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import StructuralDamping
from pgmp_petsc.studies.balance import balance_of

FEW_STEPS = 150
MAX_STEPS = 600  # more do not change an order of magnitude
RESOLVED = 0.15  # largest turn (rad) and share of the largest speed in a step: errors of second order are below 1 %


@dataclass(frozen=True, eq=False)
class RigidRun:
    """Motion of the rigid mechanism.

    Attributes
    ----------
    time
        Shape (n_t,), s.
    theta, speed, acceleration
        Coordinates and their derivatives, shape (n_t, n_theta), rad, rad/s, rad/s2.
    joints
        Rate of each joint's rotation or displacement, by its name, shape (n_t,), rad/s or m/s.
    heights
        First moment of all masses, shape (n_t, 2), kg m: its change times an acceleration is the work of a weight.
    balance
        Balance of energy.
    mass
        All masses together, kg.
    """

    time: np.ndarray
    theta: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    joints: dict[str, np.ndarray]
    heights: np.ndarray
    balance: Balance
    mass: float


def run_rigid(scene: Scene, meshes: Mapping[str, LineMesh], kinematics: RigidKinematics) -> RigidRun:
    """Integrate the scene's mechanism with all bodies rigid, on one rank.

    With few steps first, and once more with as many as the motion needs.

    Parameters
    ----------
    scene, meshes
        The scene and the mesh of every body.
    kinematics
        Of the mechanism, whichever of its bodies deform there.

    Raises
    ------
    InputError, RunError
        If there is no static equilibrium to start from, or the run fails.
    """
    stiff = _with_rigid_bodies(scene)
    model = FullModel(stiff, meshes, kinematics)
    given = count_steps(scene.simulation.duration, scene.simulation.step)
    n_steps = min(FEW_STEPS, given)
    status, found = _run(model, n_steps)
    needed = min(MAX_STEPS, given, _needed(found, n_steps) if status is None else MAX_STEPS)
    if needed > n_steps:
        status, found = _run(model, needed)
    if status is not None:
        raise RunError(f"the rigid mechanism's run stopped at {found.time[-1]:.6g} s: {status.meaning}")
    return found


def _run(model: FullModel, n_steps: int) -> tuple[Status | None, RigidRun]:
    """Return why a run with so many steps failed, None where it did not, and the run."""
    times, states, energies = [], [], []
    simulation = model.scene.simulation
    simulation = simulation.model_copy(update={"step": simulation.duration / n_steps})
    system = model.single(model.scene.values, MPI.COMM_SELF)
    require_settled(system)
    with system:

        def record(step: int, time: float, state: State) -> None:
            times.append(time)
            states.append([system.unpack(part)[:, 0] for part in (state.q, state.v, state.a)])
            energies.append(system.energies(time, state))

        run = integrate(system, simulation, observer=record)
    status = Status(run.status[0])
    found = _collect(model.kinematics.mechanism, np.array(times), np.array(states), energies, model.scene.values)
    return (None if status == Status.FINE else status), found


def _needed(run: RigidRun, n_steps: int) -> int:
    """Return how many steps, `n_steps` doubled, resolve turns and changes of speed of a run that had `n_steps`."""
    turned = np.max(np.abs(np.diff(run.theta, axis=0)))
    fastest = np.max(np.abs(run.speed), axis=0)
    changed = np.max(np.abs(np.diff(run.speed, axis=0)) / np.where(fastest > 0.0, fastest, 1.0))
    doublings = np.ceil(np.log2(max(turned, changed, RESOLVED) / RESOLVED))
    return n_steps * 2 ** int(min(doublings, 10))


def _with_rigid_bodies(scene: Scene) -> Scene:
    """Return the scene with rigid bodies, without what is of flexible ones alone, stresses for one, and any output."""
    return scene.model_copy(
        update={
            "bodies": {name: body.model_copy(update={"flexible": False}) for name, body in scene.bodies.items()},
            "effects": {k: effect for k, effect in scene.effects.items() if not isinstance(effect, StructuralDamping)},
            "outputs": {},
        }
    )


def _collect(
    mechanism: Mechanism, time: np.ndarray, states: np.ndarray, energies: list[Energies], values: Mapping[str, float]
) -> RigidRun:
    parts = np.moveaxis(states, 0, -1)  # (3, n_dofs, n_t)

    def turning(connection, part: int) -> np.ndarray:
        angles = [0.0 if side.on_ground else parts[part][side.dofs[2]] for side in (connection.a, connection.b)]
        return angles[1] - angles[0]

    motion = np.array([[turning(c.connection, part) for c in mechanism.coordinates] for part in range(3)])
    joints = {}
    for connection in mechanism.connections:
        if connection.joint.slides:
            rows = StatementRows([along(connection.axes[0][:, 0])], [connection.sides], mechanism.node_dofs, 2)
            joints[connection.name] = np.gradient(rows.values(parts[0])[0], time)
        elif connection.joint.kind == "revolute":
            joints[connection.name] = turning(connection, 1) * np.ones(time.size)
    heights, total = np.zeros((time.size, 2)), 0.0
    for body in mechanism.bodies:
        mass = sum(float(w.evaluate(values)) * lump.mass for w, lump in body.lumps[0].items())
        heights += mass * parts[0][3 * body.first_node : 3 * body.first_node + 2].T
        total += mass
    theta, speed, acceleration = np.swapaxes(motion, 1, 2)
    return RigidRun(time, theta, speed, acceleration, joints, heights, balance_of(time, joined(energies)), total)
