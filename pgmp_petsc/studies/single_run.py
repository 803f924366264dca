"""A single run, whatever its model: what was computed of it, why it stopped before its end, what is said of mechanisms
that rest, and its balance of energy, drawn up from what its model knew at every step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pgmp_petsc.base.errors import Remark, gathered, note, warning
from pgmp_petsc.base.progress import Progress, progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import SI, UnitSystem
from pgmp_petsc.estimates import coarser_run, own_error
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.mechanism.mechanism import Coordinate
from pgmp_petsc.models import Model
from pgmp_petsc.results.estimates import Balance
from pgmp_petsc.results.numbers import ROUND_OFF as SAME
from pgmp_petsc.results.trajectory import RESTS
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.units import own_values
from pgmp_petsc.stepping.generalised_alpha import Attempt, Run, integrate_with_smaller_steps
from pgmp_petsc.stepping.second_order_system import Energies
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.field_frames import shape_frames


@dataclass(frozen=True)
class RunPart:
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
    ) -> RunPart:
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
        return model.outputs.counted_over(time, model.outputs.evaluate(observed), model.scene.values)

    @property
    def reach(self) -> float:
        """Time up to which the run is fine, s; infinite where it is all of it."""
        return np.inf if self.run.status[0] == Status.FINE else float(self.run.failure_time[0])

    @property
    def relied_on(self) -> RunPart:
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


def furthest(once: Callable[[Attempt], RunPart], simulation: Simulation) -> tuple[RunPart, list[Remark]]:
    """Integrate, again with smaller steps where that fails; return what was fine, or went furthest, and what to say."""
    parts: list[RunPart] = []

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


STOPPED = "the run stopped before its end"


@gathered
def up_to(part: RunPart, what: str) -> Iterator[Remark]:
    """Return up to when errors of a run that stopped were estimated; nothing where it came to its end."""
    if part.run.status[0] != Status.FINE:
        yield note(f"{what} were estimated up to {part.relied_on.time[-1]:.4g} s: {STOPPED}")


def progress_of(name: str, attempt: Attempt, comm: Comm) -> Progress:
    again = "" if attempt.divisor == 1 else " again with smaller steps"
    return progress(attempt.simulation.n_steps, name + again, comm)


def frame_steps(simulation) -> set[int]:
    """Return the steps at which the whole mechanism is stored: evenly spread, first and last among them."""
    n_steps = simulation.n_steps
    return set(np.unique(np.linspace(0, n_steps, min(simulation.frames, n_steps + 1)).round().astype(int)).tolist())


def described(
    model: Model, part: RunPart, frames: np.ndarray, n_ranks: int, timings: Timings, remarks: Sequence[Remark]
) -> dict[str, Any]:
    """Return what trajectories of both models have in common, by the names of `Trajectory`."""
    scene, instants = model.scene, part.time[part.shown]
    at_start = own_error.largest_at_start(scene, part.outputs, model.outputs.units)
    said = (*remarks, *at_start, *model.kinematics.remarks, *scene.remarks)
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
    return [warning("; ".join(filter(None, (what, reason or status.cure(model.name, model.scene.beyond_steps)))))]


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
def rest_remarks(model: Model, part: RunPart, coordinates: np.ndarray, frames: np.ndarray) -> Iterator[Remark]:
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
