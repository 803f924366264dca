"""One run of a model over time."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.generalised_alpha import Run, count_steps, integrate
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.indicator.coverage import is_indicated
from pgmp_petsc.indicator.error_indicator import ErrorIndicator, Estimate
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.results.errors import EstimatedErrors
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.groups import first_ranks
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.studies.balance import balance_of, with_weights
from pgmp_petsc.studies.settled_start import require_settled, start_remarks
from pgmp_petsc.studies.shape_frames import shape_frames

UNKNOWNS_PER_RANK = 3000


def simulate_reduced(model: ReducedModel, comm: MPI.Comm) -> Trajectory | None:
    """Run the reduced model; one sample needs one rank, the others wait. Collective on `comm`.

    Returns
    -------
    Trajectory or None
        On the first rank, None elsewhere.

    Raises
    ------
    RunError
        If the integration fails or leaves the sampled range.
    """
    trajectory = None
    with agreed(comm, "simulation"):
        if comm.rank == 0:
            trajectory = _reduced_on_one_rank(model, comm)
    return trajectory


def simulate_full(model: FullModel, comm: MPI.Comm) -> Trajectory | None:
    """Run the full-order model, distributed over ranks. Collective on `comm`; see `simulate_reduced`.

    A model with fewer than `UNKNOWNS_PER_RANK` unknowns a rank runs on fewer ranks: factorising a small matrix on
    several takes longer than on one. The others wait.
    """
    n_workers = min(comm.size, max(1, model.kinematics.mechanism.n_dofs // UNKNOWNS_PER_RANK))
    trajectory = None
    with first_ranks(comm, n_workers) as workers, agreed(comm, "full-order simulation"):
        if comm.rank < n_workers:
            trajectory = _full_on_all_ranks(model, workers, comm.size)
    return trajectory


def _full_on_all_ranks(model: FullModel, comm: MPI.Comm, n_ranks: int) -> Trajectory | None:
    timings = Timings()
    simulation, values = model.scene.simulation, model.scene.values
    wanted = frame_steps(simulation)
    times, histories, measured, frames, energies = [], [], [], [], []
    with timings.phase("assembly"):
        system = model.distributed(values, comm)
        require_settled(system)
    with system, timings.phase("integration"), progress(count_steps(*_span(simulation)), "full-order", comm) as bar:

        def record(step: int, time: float, state: State) -> None:
            every = model.frames(system, state)
            times.append(time)
            energies.append(system.energies(time, state))
            histories.append(every[list(model.outputs.nodes)])
            measured.append(_coordinates(model, every))
            if step in wanted:
                frames.append(every[..., 0])
            bar.update(step > 0)

        run = integrate(system, simulation, observer=record)
    _check(run, model)
    timings = timings.maximum(comm)
    if comm.rank > 0:
        return None
    mechanism = model.kinematics.mechanism
    stored = np.array(frames).reshape(len(frames), mechanism.n_nodes, -1 if frames else mechanism.space.n_pose)
    return _trajectory(
        model, np.array(times), np.concatenate(histories, axis=-1), np.array(measured), None,
        stored, np.array(times)[sorted(wanted)], n_ranks, timings, balance_of(np.array(times), energies),
        remarks=start_remarks(system),
    )


def _reduced_on_one_rank(model: ReducedModel, comm: MPI.Comm) -> Trajectory:
    timings = Timings()
    simulation = model.scene.simulation
    times, etas, energies = [], [], []
    values = {name: np.array([value]) for name, value in model.scene.values.items()}
    system = model.batch(values, 1)
    require_settled(system)
    watched = ErrorIndicator(model).watch(values, np.array([0])) if is_indicated(model.scene) else None
    with timings.phase("integration"), progress(count_steps(*_span(simulation)), "reduced", comm) as bar:

        def record(step: int, time: float, state: State) -> None:
            times.append(time)
            etas.append(state.q[0].copy())
            energies.append(system.energies(time, state))
            if watched is not None:
                watched.observe(step, time, state)
            bar.update(step > 0)

        run = integrate(system, simulation, observer=record)
    _check(run, model)
    time, eta = np.array(times), np.array(etas)
    wanted = sorted(frame_steps(simulation))
    with timings.phase("projection"):
        frames = np.moveaxis(model.frames_of(eta[wanted]), 2, 0)
        outputs = model.output_frames_of(eta)
    estimate = None
    if watched is not None:
        with timings.phase("errors"):
            estimate = watched.estimate(run.status)
    n_theta = model.kinematics.n_coordinates
    balance = with_weights(balance_of(time, energies), model, eta[0])
    return _trajectory(
        model,
        time,
        outputs,
        eta[:, :n_theta],
        eta[:, n_theta:],
        frames,
        time[wanted],
        comm.size,
        timings,
        balance,
        estimate,
        remarks=start_remarks(system),
    )


def frame_steps(simulation) -> set[int]:
    """Return the steps at which the whole mechanism is stored: evenly spread, first and last among them."""
    n_steps = count_steps(*_span(simulation))
    return set(np.unique(np.linspace(0, n_steps, min(simulation.frames, n_steps + 1)).round().astype(int)).tolist())


def _span(simulation) -> tuple[float, float]:
    return simulation.duration, simulation.step


def _coordinates(model: FullModel, every: np.ndarray) -> np.ndarray:
    """Return the measured coordinates, shape (n_theta,), from the frames of all nodes (n_nodes, n_frame, 1)."""
    space, coordinates = model.kinematics.mechanism.space, model.kinematics.coordinates
    if space is SPATIAL:
        return every[0, space.n_pose :, 0]
    angles = [[0.0 if s.on_ground else every[s.node, 2, 0] for s in c.connection.sides] for c in coordinates]
    return np.array([b - a for a, b in angles])


def _check(run: Run, model: FullModel | ReducedModel) -> None:
    status = Status(run.status[0])
    if status != Status.FINE:
        raise RunError(
            f"{model.name} simulation stopped at {run.failure_time[0]:.6g} s of "
            f"{model.scene.simulation.duration:g} s: {status.meaning}"
        )


def _trajectory(
    model, time, output_frames, coordinates, modal, frames, frame_times, n_ranks, timings, balance=None, estimate=None,
    remarks=(),
) -> Trajectory:
    outputs = model.outputs.evaluate(output_frames)
    stored = shape_frames(model.kinematics.mechanism, frames, frame_times)
    return Trajectory(
        model=model.name,
        record=RunRecord(
            scene_to_toml(model.scene), model.scene.values, None, n_ranks, timings.as_dict(), (*model.scene.remarks, *remarks)
        ),
        time=time,
        outputs=outputs,
        units=model.outputs.units,
        coordinates=coordinates,
        coordinate_units={coordinate.name: "rad" for coordinate in model.kinematics.coordinates},
        modal=modal,
        frames=stored if len(frame_times) else None,
        errors=None if estimate is None else _errors(estimate, outputs),
        balance=balance,
    )


def _errors(estimate: Estimate, outputs: dict[str, np.ndarray]) -> EstimatedErrors:
    """Return the estimate of the only sample."""
    time, errors = estimate.histories[0]
    return EstimatedErrors(
        time=time,
        outputs=errors,
        largest={name: float(np.max(np.abs(values))) for name, values in outputs.items()},
        validity={name: float(value[0]) for name, value in estimate.validity.items()},
    )
