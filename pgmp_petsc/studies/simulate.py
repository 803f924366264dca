"""One run of a model over time: what is recorded of it, its balance of energy, drawn up from what its model knew at
every step, and why it stopped before its end."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pgmp_petsc.base.errors import Remark, gathered, note, warning
from pgmp_petsc.base.progress import Progress, progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import SI, UnitSystem
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects import loads_of
from pgmp_petsc.estimates import coarser_run, own_error
from pgmp_petsc.estimates.error_indicator import ErrorIndicator
from pgmp_petsc.estimates.starts import growth_of, jump_remarks, spread_remarks
from pgmp_petsc.estimates.validity import Validity, remarks_of
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.full.distributed import FullDistributed
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.mechanism.body_frames import rigid_positions, to_body
from pgmp_petsc.mechanism.mechanism import Coordinate, words_of
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.models.body_fields import Fields, FullFields
from pgmp_petsc.models.body_fields import joined as joined_fields
from pgmp_petsc.outputs.joint_forces import joints_of, judged
from pgmp_petsc.outputs.rainflow import counted_after
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.groups import UNKNOWNS_PER_RANK, first_ranks
from pgmp_petsc.reduced.lagrangian import least_stiffness, load_powers
from pgmp_petsc.reduction.tables import smoother
from pgmp_petsc.results.estimates import OF_STEP, Balance, EstimatedErrors
from pgmp_petsc.results.numbers import ROUND_OFF as SAME
from pgmp_petsc.results.numbers import VANISHING, felt
from pgmp_petsc.results.trajectory import RESTS, Trajectory
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.scene.border import own_values
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.stepping.generalised_alpha import (
    Attempt,
    Run,
    StateRecord,
    Together,
    integrate,
    integrate_with_smaller_steps,
)
from pgmp_petsc.stepping.second_order_system import Energies, PooledObserver, SecondOrderSystem, State, joined
from pgmp_petsc.stepping.static_equilibrium import start_remarks
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.field_frames import field_frames, fields_over, left_out_of_fields, shape_frames


def simulate(model: Model, comm: Comm) -> Trajectory | None:
    """Run a model; the first rank gets the result, others None. Collective on `comm`.

    The full-order and the component model are distributed over ranks, which take `UNKNOWNS_PER_RANK` unknowns each at
    least: factorising a small matrix on several takes longer than on one. A reduced model needs one. The others wait.

    Raises `RunError` where the computation itself breaks. A run that stops before its end is a trajectory with its
    status.
    """
    on_one_rank, n_workers = isinstance(model, ReducedModel), 1
    if not on_one_rank:
        n_workers = min(comm.size, max(1, model.kinematics.mechanism.n_dofs // UNKNOWNS_PER_RANK))
    with first_ranks(comm, n_workers) as workers, agreed(comm, f"{model.title} simulation"):
        if comm.rank >= n_workers:
            return None
        return (_reduced if on_one_rank else _full)(model, workers, comm.size)


@dataclass(frozen=True)
class _Part:
    """Results of one attempt at a run, up to its end or its failure: an instant whose state or outputs are no finite
    numbers is one."""

    run: Run
    attempt: Attempt
    time: np.ndarray  # instants that were computed, shape (n_t,), s; the first one always
    outputs: dict[str, np.ndarray]  # by name, each of shape (n_t,)
    recorded: dict[str, Any]  # what else the model keeps of these

    @classmethod
    def of(
        cls, model: Model, done: Run, attempt: Attempt, times: Sequence[float], observed: np.ndarray, **recorded: Any
    ) -> _Part:
        """Take in a run with its records: arrays and lists of one entry an instant, or fewer; what the outputs are made
        of has the shape (n_observed, n_t)."""
        time = np.array(times)
        with np.errstate(all="ignore"):
            outputs = cls._outputs(model, time, observed)
        known = [observed, *outputs.values()]
        known += [values.T for values in recorded.values() if isinstance(values, np.ndarray)]
        finite = np.all([np.isfinite(values.reshape(-1, time.size)).all(axis=0) for values in known], axis=0)
        reached = time.size
        if done.status[0] != Status.FINE:
            reached = int(np.searchsorted(time, done.failure_time[0]))
        kept = int(np.argmin(np.append(finite[:reached], False)))
        if kept < reached:  # that ends the run, whatever came after it
            left = model.outputs.left_range(observed[..., kept : kept + 1])[0]
            status = Status.LEFT_RANGE if left else Status.NOT_FINITE
            done = replace(done, status=np.array([status]), failure_time=time[kept : kept + 1])
        kept = max(1, kept)
        recorded = {name: values[:kept] for name, values in recorded.items()}
        if kept < time.size:
            outputs = cls._outputs(model, time[:kept], observed[..., :kept])
        return cls(done, attempt, time[:kept], outputs, recorded)

    @staticmethod
    def _outputs(model: Model, time: np.ndarray, observed: np.ndarray) -> dict[str, np.ndarray]:
        return counted_after(model.outputs.counts, time, model.outputs.evaluate(observed), model.scene.values)

    @property
    def reach(self) -> float:
        """Time up to which the run is fine, s; infinite where it is all of it."""
        return np.inf if self.run.status[0] == Status.FINE else float(self.run.failure_time[0])

    @property
    def relied_on(self) -> _Part:
        """The part whose errors can be estimated, by a run that takes as long: all of it, or most of one that stopped,
        as it may run away before it does."""
        if self.run.status[0] == Status.FINE:
            return self
        whole, n_steps = self.attempt.simulation, int(coarser_run.RELIED_ON * (self.time.size - 1))
        kept, duration = slice(n_steps + 1), float(self.time[n_steps])
        return replace(
            self,
            run=replace(self.run, n_steps=n_steps),
            attempt=replace(self.attempt, simulation=whole.in_steps(n_steps, duration) if n_steps else whole),
            time=self.time[kept],
            outputs={name: values[kept] for name, values in self.outputs.items()},
        )

    @cached_property
    def shown(self) -> list[int]:
        """Steps at which the whole mechanism is stored."""
        return [step for step in sorted(frame_steps(self.attempt.simulation)) if step < self.time.size]


def _furthest(once: Callable[[Attempt], _Part], simulation: Simulation) -> tuple[_Part, list[Remark]]:
    """Integrate, again with smaller steps where that fails; return what was fine, or went furthest, and what to say."""
    parts: list[_Part] = []

    def run(attempt: Attempt) -> Run:
        parts.append(once(attempt))
        return parts[-1].run

    tried = int(integrate_with_smaller_steps(run, simulation, np.ones(1, dtype=bool)).divisors[0])
    part, step = max(parts, key=lambda one: one.reach), f"simulation.step = {simulation.step:g} s"
    first, divisor = parts[0].run, part.attempt.divisor
    if tried == 1:
        return part, []
    if part.run.status[0] == Status.FINE:
        what = f"with {step} the run stopped at {first.failure_time[0]:.6g} s ({Status(first.status[0]).meaning})"
        again = f"it was integrated again with 1/{divisor} of it (steps_divided), which is fine"
        return part, [note(f"{what}; {again}; the step is large for it")]
    kept = f"what was computed with {'it' if divisor == 1 else f'1/{divisor} of it'} went furthest and is kept"
    return part, [note(f"the run was tried with steps down to 1/{tried} of {step} before it was given up; {kept}")]


def _full(model: FullModel, comm: Comm, n_ranks: int) -> Trajectory | None:
    timings, fields = Timings(), model.fields()
    started: list[Remark] = []

    def once(attempt: Attempt) -> _Part:
        simulation = attempt.simulation
        with timings.phase("assembly"):
            system = model.single(model.scene.values, comm)
            system.require_settled()
        with system:
            with timings.phase("integration"), _progress(model.title, attempt, comm) as bar:
                started[:] = start_remarks(model.scene, system)
                record = FullRecord(model, system, fields, frame_steps(simulation), bar.update)
                done = integrate(system, simulation, observer=record)
                outputs, recorded, seen = record.outputs(), record.recorded(), record.fields()
            part = _Part.of(model, done, attempt, record.times, outputs, **recorded)
            is_whole = part.run.status[0] == Status.FINE
            other = _coarser(model, system, part, timings, comm) if is_whole else None
        return replace(part, recorded={**part.recorded, "fields": seen, "coarser": other})

    part, steps = _furthest(once, model.scene.simulation)
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
    balance = balance_of(part.time, recorded["energies"])
    rests = _rests(model, part, recorded["coordinates"], frames)
    errors, estimated = _step_errors(model, part, other, rests)
    remarks = (
        *why_stopped(model, part.run, "", np.array(recorded["coordinates"])),
        *steps,
        *(rests or balance_remarks(balance, part.attempt.simulation.step, model.scene.system)),
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
        **_described(model, part, frames, n_ranks, timings, remarks),
    )


def _coarser(
    model: FullModel, system: SecondOrderSystem, part: _Part, timings: Timings, comm: Comm
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
    model: FullModel, part: _Part, other: coarser_run.CoarserRun | None, rests: Sequence[Remark]
) -> tuple[EstimatedErrors | None, list[Remark]]:
    """Return the estimated errors of the step of a full-order or component run, and what is to be said of them: of a
    mechanism that `rests`, nothing."""
    known = part.relied_on
    if other is None:
        absent = own_error.absence_of_estimates(model.scene, of_step=True)
        few = own_error.too_few_steps(part.run.n_steps, model.scene) if part.run.status[0] == Status.FINE else ()
        return None, [*(absent or few)] or [note(f"errors of the time step were not estimated: {STOPPED}")]
    found = coarser_run.step_errors(model.scene, known.time, known.outputs, other)
    said = list(own_error.step_remarks(model, known.time, known.outputs, other, found))
    if found is None:
        return None, said
    errors = EstimatedErrors(found.time, found.outputs, _largest(model, known.outputs), OF_STEP)
    if rests:
        return errors, []
    large = own_error.large_errors(*errors.of_one_run(), model.outputs.units, model.name, model.scene, _length(model))
    return errors, [*large, *_up_to(part, "errors of the time step"), *said]


STOPPED = "the run stopped before its end"


@gathered
def _up_to(part: _Part, what: str) -> Iterator[Remark]:
    """Return up to when errors of a run that stopped were estimated; nothing where it came to its end."""
    if part.run.status[0] != Status.FINE:
        yield note(f"{what} were estimated up to {part.relied_on.time[-1]:.4g} s: {STOPPED}")


def _reduced(model: ReducedModel, comm: Comm, n_ranks: int) -> Trajectory:
    timings, indicator = Timings(), ErrorIndicator(model) if own_error.is_estimated(model.scene) else None
    part, steps = _furthest(
        lambda attempt: _reduced_part(model, attempt, indicator, timings, comm), model.scene.simulation
    )
    eta, n_theta = part.recorded["eta"], model.kinematics.n_coordinates
    validity, status = part.recorded["validity"], part.run.status
    with timings.phase("projection"):
        frames = np.moveaxis(model.frames_of(eta[part.shown]), 2, 0) if part.shown else np.empty(0)
        fields = model.fields()
        seen = fields_over(fields, eta[part.shown], model.scene.values)
    known, reason = part, ""
    if status[0] != Status.FINE:
        reason = lost_definiteness(model, _of_sample(model), part.time, eta) if np.isfinite(eta).all() else ""
        known = part.relied_on
        if indicator is not None and known.run.n_steps:
            known = _reduced_part(model, known.attempt, indicator, timings, comm)
    errors, estimated = _errors(model, part, known, timings)
    remarks = [*why_stopped(model, part.run, reason, eta), *steps, *estimated]
    if status[0] == Status.FINE and model.scene.loose:
        with timings.phase("a run from beside its start"):
            grown = growth_of(model, part.attempt.simulation, eta, part.outputs)
        remarks += spread_remarks(part.time, grown)
    found = {name: float(value[0]) for name, value in validity.extremes.items()}
    balance = balance_of(part.time, part.recorded["energies"])
    rests = _rests(model, part, eta[:, :n_theta], frames)
    described = _described(
        model, part, frames, n_ranks, timings,
        (*remarks, *(rests or balance_remarks(balance, part.attempt.simulation.step, model.scene.system)),
         *own_error.truncated_stresses(model.scene), *left_out_of_fields(fields.seen), *part.recorded["started"],
         *jump_remarks(model, part.recorded["system"], part.recorded["start"], balance.strain),
         *remarks_of(model.scene, found)),
    )  # fmt: skip
    return Trajectory(
        coordinates=eta[:, :n_theta],
        modal=eta[:, n_theta:],
        fields=field_frames(fields.seen, model.kinematics, frames, seen),
        balance=with_weights(balance, model, eta[0]),
        errors=errors,
        validity=found,
        **described,
    )


def _errors(
    model: ReducedModel, part: _Part, known: _Part, timings: Timings
) -> tuple[EstimatedErrors | None, list[Remark]]:
    """Return the estimated errors of a reduced run, and what is to be said of them; `known` is all of it, or of one
    that stopped a run of `_Part.relied_on`."""
    watched, scene = known.recorded["watched"], model.scene
    if watched is None or known.run.status[0] != Status.FINE:
        return None, [*own_error.absence_of_estimates(scene)] or [note(f"errors were not estimated: {STOPPED}")]
    with timings.phase("errors"):
        estimate = watched.estimate(known.run.status)
    absent = {name: why for name, (why,) in estimate.absent.items() if why}
    errors = EstimatedErrors(*estimate.histories[0], _largest(model, known.outputs), absent=absent)
    large = own_error.large_errors(*errors.of_one_run(), model.outputs.units, scene=scene, length=_length(model))
    until = _up_to(part, "errors") if len(absent) < len(errors.outputs) else ()
    said = [*large, *until, *own_error.not_estimated(errors, scene), *own_error.few_steps(known.time.size - 1)]
    return errors, [*said, *own_error.left_out_of_estimates(model)]


def _reduced_part(
    model: ReducedModel, attempt: Attempt, indicator: ErrorIndicator | None, timings: Timings, comm: Comm
) -> _Part:
    """Run a reduced model with the steps of an attempt; an indicator watches for errors."""
    simulation, values = attempt.simulation, _of_sample(model)
    system = model.batch(values, 1)
    system.require_settled()
    watched = None if indicator is None else indicator.stepped(simulation).watch(system, np.array([0]))
    validity = Validity(model, system, values, simulation)
    with timings.phase("integration"), _progress("reduced", attempt, comm) as bar:
        record = StateRecord(bar.update)
        watches = [validity] if watched is None else [validity, watched]
        done = integrate(system, simulation, observer=Together([*watches, record]))
    times, history = record.states()
    with timings.phase("projection"), np.errstate(all="ignore"):
        outputs = model.observed_of(times, history, model.scene.values)
        energies = system.energies_over(*record.of_batch(), model.scene.values)
    part = _Part.of(model, done, attempt, times, outputs, eta=history.q, energies=energies)
    start = State(history.q[:1], history.v[:1], history.a[:1], history.multipliers)
    looked = {"watched": watched, "validity": validity, "system": system, "started": start_remarks(model.scene, system)}
    return replace(part, recorded={**part.recorded, **looked, "start": start})


def _of_sample(model: ReducedModel) -> dict[str, np.ndarray]:
    return {name: np.array([value]) for name, value in model.scene.values.items()}


def _progress(name: str, attempt: Attempt, comm: Comm) -> Progress:
    again = "" if attempt.divisor == 1 else " again with smaller steps"
    return progress(attempt.simulation.n_steps, name + again, comm)


def frame_steps(simulation) -> set[int]:
    """Return the steps at which the whole mechanism is stored: evenly spread, first and last among them."""
    n_steps = simulation.n_steps
    return set(np.unique(np.linspace(0, n_steps, min(simulation.frames, n_steps + 1)).round().astype(int)).tolist())


def _described(
    model: Model, part: _Part, frames: np.ndarray, n_ranks: int, timings: Timings, remarks: Sequence[Remark]
) -> dict[str, Any]:
    """Return what trajectories of both models have in common, by the names of `Trajectory`."""
    scene, instants = model.scene, part.time[part.shown]
    said = (*remarks, *model.kinematics.remarks, *scene.remarks)
    return {
        "model": model.name,
        "record": RunRecord(scene_to_toml(scene), own_values(scene), None, n_ranks, timings.as_dict(), said),
        "time": part.time,
        "outputs": part.outputs,
        "units": model.outputs.units,
        "coordinate_units": {c.name: c.unit for c in model.kinematics.coordinates},
        "frames": shape_frames(model.kinematics.mechanism, frames, instants) if part.shown else None,
        "status": int(part.run.status[0]),
        "steps_divided": part.attempt.divisor,
    }


def _largest(model: Model, outputs: Mapping[str, np.ndarray]) -> dict[str, float]:
    sizes = {name: np.max(np.abs(values)) for name, values in judged(model.scene, outputs).items()}
    seen = felt(sizes, model.outputs.units, _length(model), joints_of(model.scene))
    return {name: float(size) for name, size in seen.items()}


def _length(model: Model) -> float:
    """Return beside which a displacement vanishes that is round-off of places, m."""
    return SAME / VANISHING * model.kinematics.size


LOOK_BACK = 400  # steps before a failure in which its cause is looked for


def why_stopped(model: Model, run: Run, reason: str, reached: np.ndarray) -> list[Remark]:
    """Return why a run of one sample stopped, and what to do; nothing where it did not. A `reason` is what is known
    beyond the status, with its cure; the coordinates that were `reached` at every instant come first in its rows."""
    status = Status(run.status[0])
    if status == Status.FINE:
        return []
    when = f"{run.failure_time[0]:.6g} s of {model.scene.simulation.duration:g} s"
    what = f"{model.name} simulation stopped at {when}: {status.meaning}"
    if status == Status.LEFT_RANGE:
        what += f" ({_at_its_end(model.kinematics.coordinates, reached)})"
    return [warning("; ".join(filter(None, (what, reason or status.cure(model.name, model.scene.balance_cure)))))]


def _at_its_end(coordinates: Sequence[Coordinate], reached: np.ndarray) -> str:
    """Name the coordinate that another step like the last one takes furthest out of its range, with where it was."""
    ahead = 2.0 * reached[-1] - reached[-min(2, len(reached))]
    beyond = [
        -np.inf if c.periodic else max(c.lower - value, value - c.upper) / (c.upper - c.lower)
        for c, value in zip(coordinates, ahead)
    ]
    k = int(np.argmax(beyond))
    one = coordinates[k]
    return f"{one.described(reached[-1, k])}, its range is {one.text(one.lower)} to {one.text(one.upper)}"


def lost_definiteness(model: ReducedModel, values: Mapping[str, np.ndarray], time: np.ndarray, eta: np.ndarray) -> str:
    """Return since when the stiffness was indefinite before the end, and why; empty where it was not."""
    looked_at = slice(-LOOK_BACK, None)
    share = least_stiffness(model.terms, values, eta[looked_at])
    unsound = np.isnan(share)
    if unsound.any():
        where = words_of(model.kinematics.coordinates, eta[looked_at][np.argmax(unsound)], 4)
        what = f"the stiffness at rest, interpolated between sampled angles, is not positive definite at {where}"
        return f"{what}; build with {smoother(model.scene.interpolation)}"
    lost = share <= 0.0
    if not lost[-1]:
        return ""
    since = time[looked_at][lost.size - int(np.argmin(lost[::-1])) if not lost.all() else 0]
    return (
        f"the stiffness of the deformed mechanism is indefinite from {since:.6g} s on (at the end its least "
        f"eigenvalue is {share[-1]:.2g} times that at rest): the cubic strain energy of geometric_stiffening has no "
        "lower bound and runs away at deformations beyond what second order describes; "
        f"{Status.BROKE_DOWN.cure(model.name)}"
    )


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


# Of the most energy that was moved around: runs whose steps resolve what goes on stay below a hundredth while it is
# turned over once. What is left over adds up with every time that it is, as errors do; half of it is never right.
LARGEST_RESIDUAL, LARGEST_EVER = 0.05, 0.5
ROUND_OFF = 1e-9  # of the energies themselves: less is no residual of a mechanism that rests


def balance_of(time: np.ndarray, energies: Energies) -> Balance:
    """Draw up the balance of a run from its energies at all times, each of shape (n_t,), s."""
    work: dict[str, np.ndarray] = {}
    potential = np.zeros(len(time))
    for name, stored in energies.potential.items():
        potential += stored
        work[name] = stored[0] - stored
    for name, power in energies.powers.items():
        done = np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(time))
        work[name] = work.get(name, 0.0) + np.concatenate([[0.0], done])
    return Balance(energies.kinetic, energies.strain, potential, work)


@gathered
def _rests(model: Model, part: _Part, coordinates: np.ndarray, frames: np.ndarray) -> Iterator[Remark]:
    """Return that the mechanism rests, where all that changes over a run that reached its end is round-off of places:
    of coordinates (n_t, n_theta), and of frames (n_frames, n_nodes, n_pose) of two instants or more."""
    if part.run.status[0] != Status.FINE or len(frames) < 2:
        return
    space, size = model.kinematics.mechanism.space, model.kinematics.size
    own = [coordinate.scale(size) for coordinate in model.kinematics.coordinates]
    moved = np.ptp(frames, axis=0)
    moved[:, : space.dimension] /= size
    if max(np.max(np.ptp(coordinates, axis=0) / own, initial=0.0), moved.max()) <= SAME:
        yield note(
            f"{RESTS}nothing of it moves by more than round-off over the run, of which are all changes of "
            "outputs and energies"
        )


@gathered
def balance_remarks(balance: Balance, step: float, system: UnitSystem = SI) -> Iterator[Remark]:
    """Return a warning, in units of a system, where the energies of a run with steps of this length, s, are far from
    balance."""
    residual, exchanged = np.abs(balance.residual), balance.exchanged
    largest = float(residual.max())
    stored = max(float(np.abs(part).max()) for part in (balance.kinetic, balance.strain, balance.potential))
    allowed = np.minimum(LARGEST_RESIDUAL * np.sqrt(1.0 + balance.swings), LARGEST_EVER) * exchanged
    if not np.any(residual > np.maximum(allowed, ROUND_OFF * stored)):
        return
    yield warning(
        f"energies are out of balance by up to {system.text(largest, 'J')}, of {system.text(exchanged, 'J')} that were "
        f"moved around: steps of {step:.3g} s do not resolve what goes on, such as the vibration of light nodes in a "
        "joint on which a load sets in at once; stresses and deformations, and the motion too, may be far off; let "
        "such loads rise from zero over ten steps or more, or take a smaller simulation.step"
    )


def with_weights(balance: Balance, model: ReducedModel, start: np.ndarray) -> Balance:
    """Add the potential energy of weights to the balance of a reduced run, which knows their work alone.

    It is that at the start, reduced coordinates of shape (n_eta,), less the work done since: the same integral as in
    the residual, which does not change.
    """
    effects = [effect for effect in model.effects if effect.conservative]
    if not effects:
        return balance
    mechanism = model.kinematics.mechanism
    r, values = model.kinematics.n_coordinates, _of_sample(model)
    poses = model.kinematics.poses(start[:r])[..., 0]
    # from the undeformed bodies to the start, halfway: the work is of second degree in the deformation
    deformed = np.where(np.arange(start.size) < r, 0.0, start)
    bent = load_powers(model.terms, values, (start - 0.5 * deformed)[None], deformed[None])
    places = rigid_positions(mechanism, poses)
    matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
    potential = balance.potential
    for effect in effects:
        lifted = 0.0
        for load in loads_of([effect], matrices):
            weight, field = load.body_force
            force = matrices.mass[weight] @ to_body(mechanism, poses, field)
            lifted += float(load.weight.evaluate(model.scene.values)) * float(force @ places)
        lifted += float(bent[effect.name][0])
        potential = potential - float(effect.amplitude(0.0)) * lifted - balance.work[effect.name]
    return replace(balance, potential=potential)
