"""Cases, the scene under some loads with the values of some samples, and settings, the models to run them with.

Tolerances are tried on parameter values and loads that span those of later runs (docs/method.md, tried on): the own
tables, a pulse over the whole run (`PULSE`), and the own tables `HASTE` times as fast. The step is found with the own
tables alone, and with the pulse where it does not rise more than `HASTE` times as fast: the quicker a load sets in, the
smaller a step has to be, and no step and no small basis follows what a load that sets in at once sets off.

A trade-off is measured at quantiles of the distributions, spread over all of them by a Latin hypercube with a fixed
seed, within the bounds; the nodes of response surfaces lie elsewhere.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import scipy

from pgmp_petsc.effects.time_function import amplitude_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import OverTime
from pgmp_petsc.scene.fields import with_values
from pgmp_petsc.scene.numerics import Initial, Reduction, Simulation, count_steps
from pgmp_petsc.scene.parameters import spanning_values, uncertain_names
from pgmp_petsc.scene.units import values_text

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
        """Return the setting with other entries of the reduction."""
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
        """Return a case of the scene under one of the loads, times a factor."""
        loaded = next(one for one in self.loads if one.name == load).of(scene, factor)
        return Case(load if factor == 1.0 else f"{factor:g} {load}", load, loaded, self.values, self.n_samples)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the loads."""
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
