"""One run of a model over time. Those of full-order and component models are here; what reduced ones need is
imported where one is run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from pgmp_petsc.base.errors import Remark, note
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.estimates import coarser_run, own_error
from pgmp_petsc.full.distributed import FullDistributed
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models import FullModel, Model
from pgmp_petsc.models.body_fields import Fields, FullFields
from pgmp_petsc.models.body_fields import joined as joined_fields
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.groups import UNKNOWNS_PER_RANK, first_ranks
from pgmp_petsc.results.estimates import OF_STEP, EstimatedErrors
from pgmp_petsc.results.trajectory import Trajectory
from pgmp_petsc.stepping.generalised_alpha import Attempt, integrate
from pgmp_petsc.stepping.second_order_system import Energies, PooledObserver, SecondOrderSystem, State, joined
from pgmp_petsc.stepping.static_equilibrium import start_remarks
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies import single_run
from pgmp_petsc.studies.field_frames import field_frames, left_out_of_fields
from pgmp_petsc.studies.single_run import RunPart


def simulate(model: Model, comm: Comm) -> Trajectory | None:
    """Run a model; the first rank gets the result, others None. Collective on `comm`.

    The full-order and the component model are distributed over ranks, which take `UNKNOWNS_PER_RANK` unknowns each at
    least: factorising a small matrix on several takes longer than on one. A reduced model needs one. The others wait.

    Raises `RunError` where the computation itself breaks. A run that stops before its end is a trajectory with its
    status.
    """
    n_shares = model.kinematics.mechanism.n_dofs // UNKNOWNS_PER_RANK if model.on_ranks else 1
    n_workers = min(comm.size, max(1, n_shares))
    with first_ranks(comm, n_workers) as workers, agreed(comm, f"{model.title} simulation"):
        if comm.rank >= n_workers:
            return None
        if model.on_ranks:
            return _full(model, workers, comm.size)
        from pgmp_petsc.studies.reduced_run import run_reduced  # a noticeable time, which others need not wait

        return run_reduced(model, workers, comm.size)


def _full(model: FullModel, comm: Comm, n_ranks: int) -> Trajectory | None:
    timings, fields = Timings(), model.fields()
    started: list[Remark] = []

    def once(attempt: Attempt) -> RunPart:
        simulation = attempt.simulation
        with timings.phase("assembly"):
            system = model.single(model.scene.values, comm)
            system.require_settled()
        with system:
            with timings.phase("integration"), single_run.progress_of(model.title, attempt, comm) as bar:
                started[:] = start_remarks(model.scene, system)
                record = FullRecord(model, system, fields, single_run.frame_steps(simulation), bar.update)
                done = integrate(system, simulation, observer=record)
                outputs, recorded, seen = record.outputs(), record.recorded(), record.fields()
            part = RunPart.of(model, done, attempt, record.times, outputs, **recorded)
            is_whole = part.run.status[0] == Status.FINE
            other = _coarser(model, system, part, timings, comm) if is_whole else None
        return replace(part, recorded={**part.recorded, "fields": seen, "coarser": other})

    part, steps = single_run.furthest(once, model.scene.simulation)
    other = part.recorded["coarser"]
    if part.run.status[0] != Status.FINE:
        with model.single(model.scene.values, comm) as system:
            other = _coarser(model, system, part.relied_on, timings, comm)
    timings = timings.maximum(comm)
    if comm.rank > 0:
        return None
    space, recorded = model.kinematics.mechanism.space, part.recorded
    frames = np.array(recorded["frames"][: len(part.shown)])
    frames = frames.reshape(len(frames), model.kinematics.mechanism.n_nodes, -1 if len(frames) else space.n_pose)
    balance = single_run.balance_of(part.time, recorded["energies"])
    rests = single_run.rest_remarks(model, part, recorded["coordinates"], frames)
    errors, estimated = _step_errors(model, part, other, rests)
    remarks = (
        *single_run.why_stopped(model, part.run, "", np.array(recorded["coordinates"])),
        *steps,
        *(rests or single_run.balance_remarks(balance, part.attempt.simulation.step, model.scene.system)),
        *estimated,
        *own_error.why_not_of_full_order(model),
        *started,
        *left_out_of_fields(fields.seen),
    )
    return Trajectory(
        coordinates=recorded["coordinates"],
        errors=errors,
        balance=balance,
        fields=field_frames(fields.seen, model.kinematics, frames, recorded["fields"]),
        **single_run.described(model, part, frames, n_ranks, timings, remarks),
    )


def _coarser(
    model: FullModel, system: SecondOrderSystem, part: RunPart, timings: Timings, comm: Comm
) -> coarser_run.CoarserRun | None:
    """Run the system of a part again, for the errors of its step; None where there are none. Collective on `comm`."""
    simulation = part.attempt.simulation
    is_short = part.run.n_steps < coarser_run.fewest_steps(coarser_run.times_of(model.scene, simulation))
    if is_short or not own_error.is_estimated(model.scene, of_step=True):
        return None
    title = f"{model.title} with a coarser step, for the error of the step"
    with timings.phase("errors"), progress(coarser_run.coarser(model.scene, simulation).n_steps, title, comm) as bar:
        return coarser_run.run_coarser(model, system, simulation, np.ones(1, dtype=bool), part.run, bar.update)


def _step_errors(
    model: FullModel, part: RunPart, other: coarser_run.CoarserRun | None, rests: Sequence[Remark]
) -> tuple[EstimatedErrors | None, list[Remark]]:
    """Return the estimated errors of the step of a full-order or component run, and what is to be said of them: of a
    mechanism that `rests`, nothing."""
    known = part.relied_on
    if other is None:
        absent = own_error.absence_of_estimates(model.scene, of_step=True)
        few = own_error.too_few_steps(part.run.n_steps, model.scene) if part.run.status[0] == Status.FINE else ()
        return None, [*(absent or few)] or [note(f"errors of the time step were not estimated: {single_run.STOPPED}")]
    largest = coarser_run.largest_felt(model, known.outputs)
    found = coarser_run.step_errors(model.scene, known.time, known.outputs, largest, other)
    some = {name: values for name, values in known.outputs.items() if largest[name]}
    said = list(own_error.step_remarks(model, known.time, some, other, found))
    if found is None:
        return None, said
    errors = EstimatedErrors(found.time, found.outputs, largest, OF_STEP)
    if rests:
        return errors, []
    large = own_error.large_errors(
        *errors.of_one_run(), model.outputs.units, model.name, model.scene, coarser_run.vanishing_length(model)
    )
    return errors, [*large, *single_run.up_to(part, "errors of the time step"), *said]


class FullRecord(PooledObserver):
    """Record of a run of one sample.

    It is of a model and the system that is integrated, collective on its communicator. The frames of all nodes, and
    fields of bodies, are kept at the steps that are `wanted`.
    """

    def __init__(
        self,
        model: FullModel,
        system: FullBatch | FullDistributed,
        fields: FullFields,
        wanted: Collection[int],
        pulse: Callable[[int], object],
    ) -> None:
        super().__init__(system.instants_at_once, pulse)
        self._model, self._system, self._of_fields, self._wanted = model, system, fields, wanted
        self._outputs: list[np.ndarray] = []
        self._coordinates: list[np.ndarray] = []
        self._energies: list[Energies] = []
        self._frames: list[np.ndarray] = []
        self._unknowns: list[np.ndarray] = []  # at frames whose fields are to come
        self._fields: list[Fields] = []

    def outputs(self) -> np.ndarray:
        """Return what the outputs are made of at all instants, shape (n_observed, n_t)."""
        self.finish()
        return np.concatenate(self._outputs, axis=-1)

    def recorded(self) -> dict[str, np.ndarray | Energies | list[np.ndarray]]:
        """Return coordinates (n_t, n_theta), energies, and where they are wanted frames, (n_nodes, n_frame) each."""
        self.finish()
        return {
            "coordinates": np.concatenate(self._coordinates, axis=-1).T,
            "energies": joined(self._energies),
            "frames": self._frames,
        }

    def fields(self) -> Fields:
        """Return the fields of bodies where they are wanted."""
        self.finish()
        self._evaluate_fields()
        return joined_fields(self._fields)

    def see(self, first: int, states: State) -> None:
        times = self.times[first:]
        every = self._system.frames_over(states)
        self._energies.append(self._system.energies_over(times, states))
        self._outputs.append(self._model.observed_over(self._system, states, times, every))
        self._coordinates.append(self._measured(every))
        wanted = [k for k in range(len(times)) if first + k in self._wanted]
        self._frames += [every[..., k] for k in wanted]
        if self._of_fields.seen.points and wanted:
            unknowns = self._system.unknowns_over(states)[0]
            for k in wanted:
                self._unknowns.append(unknowns[:, k : k + 1])
                if len(self._unknowns) == self._of_fields.seen.at_once:
                    self._evaluate_fields()

    def _evaluate_fields(self) -> None:
        waiting, self._unknowns = self._unknowns, []
        if waiting:
            values = {name: float(np.ravel(value)[0]) for name, value in self._system.values.items()}
            with np.errstate(all="ignore"):
                self._fields.append(self._of_fields.of(np.concatenate(waiting, axis=1), values))

    def _measured(self, every: np.ndarray) -> np.ndarray:
        """Return the measured coordinates, shape (n_theta, n), from the frames of all nodes (n_nodes, n_frame, n)."""
        kinematics = self._model.kinematics
        if kinematics.mechanism.space is SPATIAL:
            return every[0, SPATIAL.n_pose :]
        readings = [Reading.of_coordinate(coordinate, kinematics) for coordinate in kinematics.coordinates]
        return np.array([one.value({node: every[node] for node in one.nodes}) for one in readings])
