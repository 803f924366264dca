"""What is compared: cases, the scene under some loads with the values of some samples; settings, the models to run them
with; the outputs over time that come of it; and errors between two histories of the same samples, the one definition of
error of tolerances, of the trade-off and of chosen steps.

Tolerances are tried on parameter values and loads that span those of later runs (docs/method.md, tried on): the own
tables, a pulse over the whole run (`PULSE`), and the own tables `HASTE` times as fast. The step is found with the own
tables alone, and with the pulse where it does not rise more than `HASTE` times as fast: the quicker a load sets in, the
smaller a step has to be, and no step and no small basis follows what a load that sets in at once sets off.

A trade-off is measured at quantiles of the distributions, spread over all of them by a Latin hypercube with a fixed
seed, within the bounds; the nodes of response surfaces lie elsewhere. These interpolate histories between full-order
runs: with one uncertain parameter by a cubic spline (not-a-knot; a polynomial where there are fewer than four nodes),
with several by a cubic radial basis function with a polynomial, every instant of every output by itself.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import scipy

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.effects.time_function import amplitude_of
from pgmp_petsc.models import Model, OutputRecord, ReducedModel
from pgmp_petsc.models.model import floors_of as floors_of
from pgmp_petsc.outputs.multipliers import judged
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import OverTime
from pgmp_petsc.scene.fields import with_values
from pgmp_petsc.scene.numerics import Initial, Reduction, Simulation, count_steps
from pgmp_petsc.scene.parameters import spanning_values, uncertain_names
from pgmp_petsc.scene.units import values_text
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State
from pgmp_petsc.stepping.status import Status

OWN = "own"  # name of the scene's own loads
PULSE = 1.6
HASTE = 2.0
OF_REDUCTION = ", for basis and interpolation"
N_ROWS = 129  # of the pulse: its corners are then small beside that of its beginning


@dataclass(frozen=True)
class Setting:
    """One way to compute the outputs of samples: a model with a step."""

    family: str  # ``reduced``, ``components``, ``full``, ``surface`` or, whichever model that is, ``reference``
    n_steps: int  # time steps over the scene's duration
    refinement: int = 1  # parts that every cell of the scene's meshes is cut into
    nodes: int = 0  # runs of the reference that a response surface goes through, 0 for the models
    component_modes: int = 0  # modes that bodies in floating frames serve, 0 for the others
    reduction: Reduction | None = None  # entries of the reduced model, None for the others

    @property
    def build(self) -> tuple[str, int, int, int, int, Reduction | None]:
        """Key of the work before the first sample; settings of a model that differ in the step alone share it."""
        steps = self.n_steps if self.nodes else 0
        return self.family, self.refinement, self.nodes, steps, self.component_modes, self.reduction

    @property
    def title(self) -> str:
        """What runs, for whoever waits for it."""
        kinds = {
            "components": f"component modes, for {self.component_modes} modes",
            "surface": f"response surface, {self.nodes} runs",
            "reduced": f"reduced, {self.reduction.modes if self.reduction else 0} modes",
            "full": "full order",
            "reference": "reference",
        }
        cells = "" if self.refinement == 1 else f", cells cut into {self.refinement}"
        return f"{kinds[self.family]}, {self.n_steps} steps{cells}"

    def with_reduction(self, **entries: Any) -> Setting:
        return replace(self, reduction=self.reduction.model_copy(update=entries))

    def overrides(self, scene: Scene) -> list[str]:
        """Return what to override in a scene, ``dotted.key=VALUE``; a refined mesh is not among it.

        What a scene with a tolerance leaves to `pgmp build` is given too, so that it is not chosen again.
        """
        changes = []
        if self.reduction is not None:
            for key, value in self.reduction.model_dump(exclude_none=True).items():
                if value != getattr(scene.reduction, key) or _left_open(scene.reduction, key):
                    changes.append(f"reduction.{key}={json.dumps(value)}")
        if self.component_modes and self.component_modes != scene.reduction.modes:
            changes.append(f"reduction.modes={self.component_modes}")
        simulation = scene.simulation
        if self.n_steps != simulation.n_steps or _left_open(simulation, "step"):
            changes.append(f"simulation.step={step_of(simulation.duration, self.n_steps)!r}")
        return changes


def _left_open(table: Reduction | Simulation, key: str) -> bool:
    """Whether a table has a tolerance and leaves an entry to the choice that follows from it."""
    return table.tolerance is not None and key not in table.model_fields_set


def step_of(duration: float, n_steps: int) -> float:
    """Return the step with the fewest digits (s) that gives so many steps."""
    for digits in range(17):
        step = float(f"{duration / n_steps:.{digits}e}")
        if step > 0.0 and count_steps(duration, step) == n_steps:
            return step
    return duration / n_steps


@dataclass(frozen=True)
class Case:
    """A scene under some loads, and some of its samples; known by its name."""

    name: str  # of the loads, and of what was changed
    load: str = field(compare=False)  # of the loads
    scene: Scene = field(compare=False, repr=False)  # with these loads
    # values, n_samples: of every parameter, each of shape (n_samples,), and how many samples there are
    values: Mapping[str, np.ndarray] = field(compare=False, repr=False)
    n_samples: int = field(compare=False)

    def softer(self, factor: float) -> Self:
        """Return the case with end stops a factor as stiff."""
        return replace(self, name=f"{self.name}, stops {factor:g}", scene=with_softer_stops(self.scene, factor))

    def from_rest(self, sample: int) -> Self:
        """Return one sample that starts at rest where the loads pull it."""
        scene = self.scene.with_entries(initial=Initial(equilibrium=True, coordinates="free"))
        values = {name: column[sample : sample + 1] for name, column in self.values.items()}
        name = f"{self.name}, sample {sample} from rest"
        return replace(self, name=name, scene=scene, values=values, n_samples=1)


@dataclass(frozen=True)
class Load:
    """The torques and forces over time of one variant."""

    name: str  # name, description: for messages
    description: str
    effects: Mapping[str, OverTime]  # torques and forces over time, by their names
    for_step: bool  # whether the step is found with them; basis and interpolation are with all

    def of(self, scene: Scene, factor: float = 1.0) -> Scene:
        """Return the scene under these loads, times a factor; itself under its own."""
        if self.name == OWN and factor == 1.0:
            return scene
        return scene.with_entries(effects=scene.plain_effects | _scaled(self.effects, factor))


@dataclass(frozen=True)
class Training:
    """Training cases: every sample under every load."""

    scene: Scene = field(repr=False)
    values: dict[str, np.ndarray]  # value of every parameter, shape (n_samples,); the first sample is the nominal one
    n_samples: int  # one without parameters
    loads: tuple[Load, ...]  # the scene's own first
    remarks: tuple[str, ...]  # what is not varied, and why

    @classmethod
    def of(cls, scene: Scene) -> Training:
        """Return the training cases of a scene."""
        values, n_samples = spanning_values(scene)
        loads, remarks = training_loads(scene), []
        if scene.reference.loads == "own" and len(loads) > 1:
            remarks.append('reference.loads = "own": the tolerance holds for the scene\'s own loads alone')
            loads = loads[:1]
        elif len(loads) == 1:
            remarks.append("no torque or force acts over time: loads are not varied")
        if not uncertain_names(scene):
            remarks.append("no parameter has a distribution: none is varied")
        if scene.driven:
            remarks.append("prescribed motions are not varied")
        return cls(scene, values, n_samples, loads, tuple(remarks))

    @classmethod
    def of_own_loads(cls, scene: Scene, values: dict[str, np.ndarray], n_samples: int) -> Training:
        """Return samples under the scene's own loads."""
        return cls(scene, values, n_samples, training_loads(scene)[:1], ())

    def case(self, scene: Scene, load: str, factor: float = 1.0) -> Case:
        loaded = next(one for one in self.loads if one.name == load).of(scene, factor)
        return Case(load if factor == 1.0 else f"{factor:g} {load}", load, loaded, self.values, self.n_samples)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(load.name for load in self.loads)

    @property
    def n_cases(self) -> int:
        """Runs of a candidate: samples under loads."""
        return self.n_samples * len(self.loads)

    def sample_text(self, sample: int) -> str:
        """Return the parameter values of a sample, ``r1 = 0.0056 m``."""
        return values_text(self.scene, {name: float(column[sample]) for name, column in self.values.items()}, ".4g")


def training_loads(scene: Scene) -> tuple[Load, ...]:
    """Return the variants of the loads, the scene's own first; of torques and forces over time alone."""
    own = {name: effect for name, effect in scene.plain_effects.items() if effect.is_over_time}
    loads = [Load(OWN, "the scene's own loads", own, True)]
    if not any(map(_peak, own.values())):
        return tuple(loads)
    pulse = _scaled(own, PULSE) | {
        name: _half_sine(effect, scene.simulation.duration) for name, effect in own.items() if effect.harmonic is None
    }
    gentle = all(_steepness(pulse[name]) <= HASTE * _steepness(own[name]) for name in own)
    harmonic = [effect.harmonic is not None for effect in own.values()]
    sine = f"a half sine over the run, {PULSE:g} times the largest {_kinds(own.values())}"
    about = [] if all(harmonic) else [sine]
    about += [f"harmonics {PULSE:g} times as large"] if any(harmonic) else []
    loads.append(Load("pulse", ", ".join(about) + ("" if gentle else OF_REDUCTION), pulse, gentle))
    if any(harmonic) or any(len({value for _, value in effect.table}) > 1 for effect in own.values()):
        quick = {name: _hastened(effect) for name, effect in own.items()}
        about = f"the scene's {_kinds(own.values(), 's')} {HASTE:g} times as fast"
        loads.append(Load("quick", about + OF_REDUCTION, quick, False))
    return tuple(loads)


def stops_of(scene: Scene) -> list[str]:
    """Return the end stops whose stiffness is a number."""
    stops = {name: effect for name, effect in scene.plain_effects.items() if effect.sets_in}
    return [name for name, effect in stops.items() if not isinstance(getattr(effect, effect.stiff_by), str)]


def with_softer_stops(scene: Scene, factor: float) -> Scene:
    effects = scene.plain_effects
    for name in stops_of(scene):
        stop = effects[name]
        effects[name] = stop.model_copy(update={stop.stiff_by: factor * getattr(stop, stop.stiff_by)})
    return scene.with_entries(effects=effects)


def _kinds(effects: Iterable[OverTime], plural: str = "") -> str:
    """Return what acts: ``torque``, ``force`` or ``torque and force``."""
    return " and ".join(word + plural for word in sorted({effect.type for effect in effects}, reverse=True))


def _scaled(effects: Mapping[str, OverTime], factor: float) -> dict[str, OverTime]:
    return {name: with_values(effect, lambda value: factor * value) for name, effect in effects.items()}


def _peak(effect: OverTime) -> float:
    """Return the value of largest size, with its sign."""
    if effect.harmonic is not None:
        return abs(effect.harmonic.amplitude) + abs(effect.harmonic.mean)
    return max((value for _, value in effect.table), key=abs)


def _half_sine(effect: OverTime, duration: float) -> OverTime:
    """Return a half sine over the run in place of a table."""
    largest, places = PULSE * _peak(effect), np.linspace(0.0, 1.0, N_ROWS)
    rows = tuple((float(duration * x), float(largest * np.sin(np.pi * x))) for x in places)
    return effect.model_copy(update={"table": rows})


def _hastened(effect: OverTime) -> OverTime:
    if effect.harmonic is None:
        return effect.model_copy(update={"table": tuple((time / HASTE, value) for time, value in effect.table)})
    quicker = effect.harmonic.model_copy(update={"frequency_hz": HASTE * effect.harmonic.frequency_hz})
    return effect.model_copy(update={"harmonic": quicker})


def _steepness(effect: OverTime) -> float:
    """Return the largest slope over time, N m/s or N/s; infinite where it does not begin at zero."""
    if amplitude_of(effect).at_start != 0.0:
        return np.inf
    if effect.harmonic is not None:
        return float(2.0 * np.pi * effect.harmonic.frequency_hz * abs(effect.harmonic.amplitude))
    time, value = np.array(effect.table, dtype=float).T
    slopes = np.abs(np.diff(value) / np.diff(time)) if time.size > 1 else np.zeros(1)
    return float(slopes.max())


N_TEST = 8  # both models take so few in one batch at little more than the price of one
TEST_RANGE = (0.01, 0.99)  # probabilities of the outermost test values
NODE_RANGE = (0.001, 0.999)
SEED = 1


def held_out(scene: Scene) -> tuple[dict[str, np.ndarray], int]:
    """Return n test values of every parameter, shape (n,), and n; that of the scene alone where nothing is uncertain.

    Every uncertain parameter takes `N_TEST` quantiles with probabilities at equal distances over `TEST_RANGE`, one: in
    order, several: in the random order of a Latin hypercube.
    """
    names, n = uncertain_names(scene), N_TEST
    if not names:
        return at_values(scene, np.empty((1, 0))), 1
    centred = scipy.stats.qmc.LatinHypercube(len(names), scramble=False, seed=SEED).random(n)
    if len(names) == 1:
        centred = np.sort(centred, axis=0)
    low, high = TEST_RANGE
    # the centres of n strata reach from 1/(2n) to 1 - 1/(2n)
    probabilities = 0.5 * (low + high) + (centred - 0.5) * (high - low) * n / (n - 1)
    return at_values(scene, quantiles(scene, probabilities)), n


def node_values(scene: Scene, n: int) -> np.ndarray:
    """Return n nodes of a response surface, shape (n, n_uncertain): equal distances, or Halton points in a box."""
    low, high = box(scene)
    if len(low) == 1:
        return np.linspace(low, high, n)
    return low + (high - low) * scipy.stats.qmc.Halton(len(low), scramble=True, seed=SEED).random(n)


def box(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the box that nodes span, each of shape (n_uncertain,)."""
    n = len(uncertain_names(scene))
    low, high = (quantiles(scene, np.full((1, n), probability))[0] for probability in NODE_RANGE)
    return low, high


def at_values(scene: Scene, uncertain: np.ndarray) -> dict[str, np.ndarray]:
    """Return values of all parameters from those of the uncertain ones, shape (n, n_uncertain)."""
    values = {name: np.full(len(uncertain), value) for name, value in scene.values.items()}
    return values | dict(zip(uncertain_names(scene), uncertain.T))


def quantiles(scene: Scene, probabilities: np.ndarray) -> np.ndarray:
    """Return quantiles of the distributions, bounds applied, for probabilities of shape (n, n_uncertain)."""
    columns = []
    for name, column in zip(uncertain_names(scene), probabilities.T):
        parameter = scene.parameters[name]
        columns.append(parameter.quantiles(column, 0.0 if name in scene.parameters_not_negative else -np.inf))
    return np.column_stack(columns) if columns else np.empty((len(probabilities), 0))


MOST_INSTANTS = 1024  # kept of a run: enough for the largest value over time
MARGIN = 0.02  # of a limited range: what the flexible bodies may add to the coordinate
MOST_MISSING = 0.1  # share of the exact run's instants at which an output may be no number without being a failure
Pulse = Callable[[int], object]  # what is called with numbers of steps while they are taken
OF_SAMPLES = ("outputs", "status", "inside", "failure_time")


@dataclass(frozen=True)
class History:
    """Outputs of a run of n samples, with the status of each."""

    n_steps: int  # steps of the run
    every: int  # steps between two kept instants
    outputs: np.ndarray  # shape (n_outputs, n_kept, n_samples); NaN where a sample failed
    status: np.ndarray  # of every sample, shape (n_samples,)
    inside: np.ndarray  # samples that stayed in the range of their coordinate, shape (n_samples,)
    failure_time: np.ndarray  # when samples failed, shape (n_samples,), s; NaN where they did not

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        return {name: np.array(value) for name, value in vars(self).items()}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Self:
        return cls(**{name: int(value) if name in ("n_steps", "every") else value for name, value in arrays.items()})

    def require_fine(self, scene: Scene, values: Mapping[str, np.ndarray]) -> Self:
        """Return the history, of samples of a scene with some parameter values; raises `RunError` if a sample failed,
        with the first one's values, time and reason."""
        failed = np.flatnonzero(self.status != Status.FINE)
        if not failed.size:
            return self
        first = failed[0]
        where = values_text(scene, {name: float(column[first]) for name, column in values.items()}, ".4g")
        raise RunError(
            f"{failed.size} of {self.status.size} samples failed, the first{f' ({where})' if where else ''} at "
            f"{self.failure_time[first]:.4g} s: {Status(self.status[first]).meaning}"
        )


def spacing(n_steps: int) -> int:
    """Return the steps between kept instants: a power of two, so that runs with doubled steps share instants."""
    every = 1
    while n_steps > MOST_INSTANTS * every:
        every *= 2
    return every


def run_history(
    model: Model, values: Mapping[str, np.ndarray], n_samples: int, n_steps: int, pulse: Pulse = lambda n: None
) -> History:
    """Integrate samples with some parameter values, each of shape (n_samples,), in equal steps over the scene's
    duration; on this rank, in batches as large as the model takes."""
    parts = []
    for first in range(0, n_samples, model.largest_batch):
        chosen = slice(first, min(first + model.largest_batch, n_samples))
        some = {name: column[chosen] for name, column in values.items()}
        with closing(model.batch(some, chosen.stop - chosen.start)) as made:
            parts.append(integrated(model, made, n_steps, pulse))
    if len(parts) == 1:
        return parts[0]
    joined = {name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in OF_SAMPLES}
    return History(n_steps, parts[0].every, **joined)


def integrated(model: Model, system: SecondOrderSystem, n_steps: int, pulse: Pulse = lambda n: None) -> History:
    """Integrate a system, on the ranks that share it, and evaluate the outputs at the kept instants."""
    kinematics, n_samples = model.kinematics, system.n_samples
    # what measures free coordinates with a limited range; a reduced model watches its own itself
    free = [c for c in kinematics.coordinates if not (c.periodic or c.prescribed or isinstance(model, ReducedModel))]
    measures = [(c, Reading.of_coordinate(c, kinematics)) for c in free]
    nodes = sorted(set().union(*(angle.nodes for _, angle in measures)))
    record = _Record(model, system, nodes, pulse, spacing(n_steps))
    run = integrate(system, model.scene.simulation.in_steps(n_steps), observer=record)
    outputs = np.array(list(judged(model.scene, record.outputs()[1]).values()))
    by_node, inside = record.by_node(), np.ones(n_samples, dtype=bool)
    for c, angle in measures:
        angles, margin = angle.value(by_node).reshape(-1, n_samples), MARGIN * (c.upper - c.lower)
        kept = (angles > c.lower + margin) & (angles < c.upper - margin)
        # a start near the end of the range is none of the run's doing
        inside &= np.all(kept | (angles == angles[0]), axis=0)
    outputs[..., run.status != Status.FINE] = np.nan
    return History(n_steps, record.every, outputs, run.status, inside, run.failure_time)


class _Record(OutputRecord):
    """Keeps outputs, and frames of some nodes, after one of `every` so many steps."""

    def __init__(self, model: Model, system: SecondOrderSystem, nodes: list[int], *how: Any) -> None:
        super().__init__(model, system, *how)
        self._nodes, self._frames = nodes, []

    def see(self, first: int, states: State) -> None:
        super().see(first, states)
        if self._nodes:
            self._frames.append(self._system.frames_over(states)[self._nodes])

    def by_node(self) -> dict[int, np.ndarray]:
        """Return the frames of the nodes, (n_frame, n) each."""
        return dict(zip(self._nodes, np.concatenate(self._frames, axis=-1))) if self._nodes else {}


def errors_between(found: History, exact: History, floors: np.ndarray) -> np.ndarray:
    """Return the largest error over time of every output and sample, shape (n_outputs, n_samples).

    The error is a share of the largest value of the exact output over time, or of `floors`, (n_outputs,) in its unit,
    where that is larger. It is infinite where only `found` failed, or has no number at a tenth of the instants and more
    at which the exact run has one (a deformation is none outside a limited range); NaN where the exact run failed or
    has no number at any instant. The number of steps of one history divides that of the other.
    """
    finest = max(found.n_steps, exact.n_steps)
    strides = [item.every * (finest // item.n_steps) for item in (found, exact)]
    shared = int(np.lcm(*strides))  # of the instants that both kept
    one, other = (item.outputs[:, :: shared // stride] for item, stride in zip((found, exact), strides))
    known = np.isfinite(other)
    both = known & np.isfinite(one)
    difference = np.where(both, np.abs(np.where(both, one, 0.0) - np.where(both, other, 0.0)), 0.0)
    errors = difference.max(axis=1) / np.maximum(sizes_of(exact), floors[:, None])
    # one of them may be at the end of the range a little before the other
    errors[both.sum(axis=1) < (1.0 - MOST_MISSING) * known.sum(axis=1)] = np.inf
    errors[:, found.status != Status.FINE] = np.inf
    errors[~known.any(axis=1)] = np.nan
    return errors


def largest_errors(found: History, exact: History, floors: np.ndarray) -> np.ndarray:
    """Return the largest error of every output over time and samples, shape (n_outputs,); see `errors_between`.

    Where both are below `floors` they differ by round-off, which is no error. NaN where a sample's output has no number
    where the exact one has, or no sample has any to compare with.
    """
    errors = errors_of_samples(found, exact, floors)
    largest = np.max(errors, axis=1, initial=-1.0, where=np.isfinite(errors) | np.isposinf(errors))
    return np.where(np.isinf(largest) | (largest < 0.0), np.nan, largest)


def errors_of_samples(found: History, exact: History, floors: np.ndarray) -> np.ndarray:
    """Return `errors_between`, with 0 for what is zero to round-off and differs by no more."""
    errors = errors_between(found, exact, floors)
    return np.where((round_off_of(exact, floors) == 1.0) & (errors <= 1.0), 0.0, errors)


def round_off_of(exact: History, floors: np.ndarray) -> np.ndarray:
    """Return below which share of its largest value an output's error is round-off, shape (n_outputs, n_samples)."""
    return floors[:, None] / np.maximum(sizes_of(exact), floors[:, None])


def sizes_of(history: History) -> np.ndarray:
    """Return the largest value over time of every output and sample, shape (n_outputs, n_samples), in its unit."""
    return np.max(np.abs(history.outputs), axis=1, initial=0.0, where=np.isfinite(history.outputs))


@dataclass(frozen=True)
class Errors:
    """Errors of one kind over all training cases."""

    # shares of the outputs' largest values, shape (n_loads, n_outputs, n_samples); NaN where a case does not count
    values: np.ndarray
    round_off: np.ndarray  # what of it is below what counts as zero: errors as small are round-off; the same shape
    loads: tuple[str, ...]  # loads, outputs: names
    outputs: tuple[str, ...]
    training: Training  # the cases

    @property
    def by_output(self) -> np.ndarray:
        """Largest error of every output, shape (n_outputs,); zero where no case counts."""
        return np.max(np.nan_to_num(self.values, nan=0.0, posinf=np.inf), axis=(0, 2))

    @property
    def largest(self) -> float:
        return float(self.by_output.max())

    @property
    def place(self) -> tuple[int, int, int]:
        """Load, output and sample of the largest error."""
        filled = np.nan_to_num(self.values, nan=-1.0, posinf=np.inf)
        return tuple(int(k) for k in np.unravel_index(np.argmax(filled), filled.shape))

    @property
    def is_round_off(self) -> bool:
        return self.largest <= self.round_off[self.place]

    @property
    def where(self) -> str:
        load, output, sample = self.place
        values = self.training.sample_text(sample)
        return f"{self.outputs[output]}, load '{self.loads[load]}'" + (f", {values}" if values else "")


@dataclass(frozen=True)
class Trial:
    """A candidate that was tried."""

    reduction: Reduction  # reduction, n_steps: what it is
    n_steps: int
    errors: Errors  # against the full-order model with the same step
    reason: str  # why it could not be built or run; empty where it could
    seconds: float  # wall time of build and runs
    built: bool  # whether it could be built

    def at(self, n_steps: int) -> Setting:
        return Setting("reduced", n_steps, reduction=self.reduction)

    @property
    def setting(self) -> Setting:
        return self.at(self.n_steps)

    @property
    def exact(self) -> Setting:
        return Setting("reference", self.n_steps)


class ResponseSurface:
    """Interpolates outputs over time, each of shape (n_t, n_nodes), between nodes in the space of the parameters, shape
    (n_nodes, n_parameters). Raises `ValueError` if there are too few nodes for any interpolation."""

    def __init__(self, nodes: np.ndarray, outputs: Mapping[str, np.ndarray]) -> None:
        self._names = list(outputs)
        every = np.concatenate(list(outputs.values())).T  # (n_nodes, n_outputs * n_t)
        # a deformation may be no number at some instants of a run that leaves a limited range
        self._known = np.isfinite(every).all(axis=0)
        data = every[:, self._known]
        from scipy.interpolate import CubicSpline, RBFInterpolator  # a noticeable time, and few commands have surfaces

        self._low, self._width = nodes.min(axis=0), np.ptp(nodes, axis=0)
        scaled = self._scaled(nodes)
        if nodes.shape[1] == 1:
            self._interpolate = CubicSpline(scaled[:, 0], data)
        else:
            (n, n_parameters), linear = nodes.shape, nodes.shape[1] + 1
            if n <= linear:
                raise ValueError(f"{n} nodes for {n_parameters} parameters; at least {linear + 1} are needed")
            # the largest that the nodes determine, with one node to spare
            degree = 2 if n > linear * (n_parameters + 2) // 2 else 1
            self._interpolate = RBFInterpolator(scaled, data, kernel="cubic", degree=degree)

    def evaluate(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs over time, each of shape (n_t, n), at parameter values of shape (n, n_parameters); no
        number where a run of the surface has none."""
        scaled = self._scaled(points)
        rows = np.full((len(points), self._known.size), np.nan)
        rows[:, self._known] = self._interpolate(scaled[:, 0] if scaled.shape[1] == 1 else scaled)
        return dict(zip(self._names, np.split(rows.T, len(self._names))))

    def _scaled(self, points: np.ndarray) -> np.ndarray:
        return (points - self._low) / self._width
