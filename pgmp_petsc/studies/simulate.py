"""One run of a model over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.generalised_alpha import Run, count_steps, integrate
from pgmp_petsc.dynamics.reduced_energy import least_stiffness
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.settled_start import require_settled, start_remarks
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.indicator.coverage import CURE, absence_of_estimates, is_indicated
from pgmp_petsc.indicator.error_indicator import ErrorIndicator, Estimate
from pgmp_petsc.indicator.validity import Validity, remarks_of
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.results.errors import EstimatedErrors
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.groups import first_ranks
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.remarks import Remark, note, warning
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.studies.balance import balance_of, with_weights
from pgmp_petsc.studies.shape_frames import shape_frames

UNKNOWNS_PER_RANK = 3000
LOOK_BACK = 400  # steps before a failure in which its cause is looked for


def simulate_reduced(model: ReducedModel, comm: MPI.Comm) -> Trajectory | None:
    """Run the reduced model; one sample needs one rank, the others wait. Collective on `comm`.

    Returns
    -------
    Trajectory or None
        On the first rank, None elsewhere.

    Raises
    ------
    RunError
        Where the computation itself breaks. A run that stops before its end is a trajectory with its status.
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
    timings = timings.maximum(comm)
    if comm.rank > 0:
        return None
    mechanism = model.kinematics.mechanism
    kept = _computed(times, run, simulation)
    time, shown = np.array(times[:kept]), [step for step in sorted(wanted) if step < kept]
    stored = np.array(frames[: len(shown)])
    stored = stored.reshape(len(shown), mechanism.n_nodes, -1 if shown else mechanism.space.n_pose)
    return Trajectory(
        coordinates=np.array(measured[:kept]),
        balance=balance_of(time, energies[:kept]),
        **_described(
            model, run, time, np.concatenate(histories[:kept], axis=-1), stored, time[shown], n_ranks, timings,
            (*_why_stopped(model, run, ""), *start_remarks(system)),
        ),
    )


def _reduced_on_one_rank(model: ReducedModel, comm: MPI.Comm) -> Trajectory:
    timings = Timings()
    simulation = model.scene.simulation
    times, etas, energies = [], [], []
    values = {name: np.array([value]) for name, value in model.scene.values.items()}
    system = model.batch(values, 1)
    require_settled(system)
    watched = ErrorIndicator(model).watch(values, np.array([0])) if is_indicated(model.scene) else None
    validity = Validity(model, system, values, simulation)
    with timings.phase("integration"), progress(count_steps(*_span(simulation)), "reduced", comm) as bar:

        def record(step: int, time: float, state: State) -> None:
            times.append(time)
            etas.append(state.q[0].copy())
            energies.append(system.energies(time, state))
            validity.observe(step, time, state)
            if watched is not None:
                watched.observe(step, time, state)
            bar.update(step > 0)

        run = integrate(system, simulation, observer=record)
    kept = _computed(times, run, simulation)
    time, eta = np.array(times[:kept]), np.array(etas[:kept])
    wanted = [step for step in sorted(frame_steps(simulation)) if step < kept]
    with timings.phase("projection"):
        frames = np.moveaxis(model.frames_of(eta[wanted]), 2, 0)
        outputs = model.output_frames_of(eta)
    remarks, estimate, n_theta = [], None, model.kinematics.n_coordinates
    if run.status[0] != Status.FINE:
        remarks += _why_stopped(model, run, lost_definiteness(model, values, time, eta))
        remarks.append(note("errors were not estimated: the run stopped before its end"))
    elif watched is not None:
        with timings.phase("errors"):
            estimate = watched.estimate(run.status)
        remarks += _not_estimated(estimate)
    else:
        remarks += absence_of_estimates(model.scene)
    found = {name: float(value[0]) for name, value in validity.extremes.items()}
    described = _described(
        model, run, time, outputs, frames, time[wanted], comm.size, timings,
        (*remarks, *start_remarks(system), *remarks_of(model.scene, found)),
    )
    return Trajectory(
        coordinates=eta[:, :n_theta],
        modal=eta[:, n_theta:],
        balance=with_weights(balance_of(time, energies[:kept]), model, eta[0]),
        errors=None if estimate is None else _errors(estimate, described["outputs"]),
        validity=found,
        **described,
    )


def _not_estimated(estimate: Estimate) -> list[Remark]:
    """Return which outputs have no estimate although the scene's errors can be estimated."""
    unknown = [name for name, largest in estimate.largest.items() if not np.isfinite(largest[0])]
    if not unknown:
        return []
    names = ", ".join(unknown)
    return [
        note(
            f"errors were not estimated for {names}: the full-order equations could not be solved about this motion; "
            f"{CURE}"
        )
    ]


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


def _computed(times: list[float], run: Run, simulation: Simulation) -> int:
    """Return how many of the recorded instants were computed: all, or those before a failure."""
    if run.status[0] == Status.FINE:
        return len(times)
    # a time is a sum of steps: round-off must not keep the failed one
    return max(1, int(np.sum(np.array(times) < run.failure_time[0] - 1e-6 * simulation.step)))


def _why_stopped(model: FullModel | ReducedModel, run: Run, reason: str) -> list[Remark]:
    """Return why a run stopped, and what to do; nothing where it did not.

    Parameters
    ----------
    reason
        What is known beyond the status, with its cure.
    """
    status = Status(run.status[0])
    if status == Status.FINE:
        return []
    simulation = model.scene.simulation
    what = (
        f"{model.name} simulation stopped at {run.failure_time[0]:.6g} s of {simulation.duration:g} s: {status.meaning}"
    )
    return [warning("; ".join(filter(None, (what, reason or status.cure))))]


def lost_definiteness(
    model: ReducedModel, values: Mapping[str, np.ndarray], time: np.ndarray, eta: np.ndarray
) -> str:
    """Return since when the stiffness of a model of second order was indefinite at the end; empty where it was not."""
    looked_at = slice(-LOOK_BACK, None)
    share = least_stiffness(model.terms, values, eta[looked_at])
    lost = share <= 0.0
    if not lost[-1]:
        return ""
    since = time[looked_at][lost.size - int(np.argmin(lost[::-1])) if not lost.all() else 0]
    return (
        f"the stiffness of the deformed mechanism is indefinite from {since:.6g} s on (its least eigenvalue is "
        f"{share[-1]:.2g} of that at rest at the end): the cubic strain energy of geometric_stiffening has no lower "
        "bound and runs away at deformations beyond what second order describes; smaller steps do not help. Take the "
        "full-order model (pgmp simulate SCENE --full), or leave geometric_stiffening out and heed the warnings"
    )


def _described(
    model: FullModel | ReducedModel,
    run: Run,
    time: np.ndarray,
    output_frames: np.ndarray,
    frames: np.ndarray,
    frame_times: np.ndarray,
    n_ranks: int,
    timings: Timings,
    remarks: Sequence[Remark],
) -> dict[str, Any]:
    """Return what trajectories of both models have in common, by the names of `Trajectory`."""
    stored = shape_frames(model.kinematics.mechanism, frames, frame_times)
    scene = model.scene
    return {
        "model": model.name,
        "record": RunRecord(
            scene_to_toml(scene), scene.values, None, n_ranks, timings.as_dict(), (*remarks, *scene.remarks)
        ),
        "time": time,
        "outputs": model.outputs.evaluate(output_frames),
        "units": model.outputs.units,
        "coordinate_units": {coordinate.name: "rad" for coordinate in model.kinematics.coordinates},
        "frames": stored if len(frame_times) else None,
        "status": int(run.status[0]),
    }


def _errors(estimate: Estimate, outputs: dict[str, np.ndarray]) -> EstimatedErrors:
    """Return the estimate of the only sample."""
    time, errors = estimate.histories[0]
    return EstimatedErrors(
        time=time,
        outputs=errors,
        largest={name: float(np.max(np.abs(values))) for name, values in outputs.items()},
    )
