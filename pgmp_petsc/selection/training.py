"""What tolerances are tried on: parameter values and loads that span those of later runs.

Parameters take their nominal value, their quantiles at three standard deviations of a normal distribution (bounds
applied as an ensemble does), and the values half-way: alone, the others nominal (a star), and the outermost ones
together (corners). Torques and forces over time take the scene's own tables, a half-sine pulse over the whole run,
`PULSE` times as large as the largest value, and the own tables `HASTE` times as fast; harmonics are as much larger, and
as much faster. The quicker a load sets in, the more it makes the bodies vibrate, and the smaller a step has to be: the
step is found with the own tables alone, and with the pulse where it does not rise more than `HASTE` times as fast.
Loads that set in at once are tried where they are the scene's own, and not otherwise: no step and no small basis
follows what they set off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import Driving, OverTime
from pgmp_petsc.scene.fields import LoadHarmonic
from pgmp_petsc.scene.spanning_values import spanning_values, uncertain_names

PULSE = 1.6
HASTE = 2.0
OF_REDUCTION = ", for basis and interpolation"
N_ROWS = 129  # of the pulse: its corners are then small beside that of its beginning

Table = tuple[tuple[float, float], ...]
Function = Table | LoadHarmonic


@dataclass(frozen=True)
class Load:
    """The torques and forces over time of one variant.

    Attributes
    ----------
    name, description
        For messages.
    functions
        Table or harmonic of every torque and force, by the effect's name.
    for_step
        Whether the step is found with them; basis and interpolation are with all.
    """

    name: str
    description: str
    functions: Mapping[str, Function]
    for_step: bool

    def of(self, scene: Scene, factor: float = 1.0) -> Scene:
        """Return the scene under these loads, times a factor."""
        effects = scene.plain_effects
        for name, function in self.functions.items():
            scaled = _scaled(function, factor)
            table, harmonic = (None, scaled) if isinstance(scaled, LoadHarmonic) else (scaled, None)
            effects[name] = effects[name].model_copy(update={"table": table, "harmonic": harmonic})
        return scene.model_copy(update={"effects": effects})


@dataclass(frozen=True)
class Training:
    """Training cases: every sample under every load.

    Attributes
    ----------
    values
        Value of every parameter, shape (n_samples,); the first sample is the nominal one.
    n_samples
        One without parameters.
    loads
        The scene's own first.
    remarks
        What is not varied, and why.
    """

    values: dict[str, np.ndarray]
    n_samples: int
    loads: tuple[Load, ...]
    remarks: tuple[str, ...]

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
        if any(isinstance(effect, Driving) for effect in scene.effects.values()):
            remarks.append("prescribed motions are not varied")
        return cls(values, n_samples, loads, tuple(remarks))

    @property
    def n_cases(self) -> int:
        """Runs of a candidate: samples under loads."""
        return self.n_samples * len(self.loads)

    def sample_text(self, sample: int) -> str:
        """Return the parameter values of a sample, ``r1 = 0.0056``."""
        return ", ".join(f"{name} = {column[sample]:.4g}" for name, column in self.values.items())


def training_loads(scene: Scene) -> tuple[Load, ...]:
    """Return the variants of the loads, the scene's own first; of torques and forces over time alone."""
    acting = {name: effect for name, effect in scene.plain_effects.items() if isinstance(effect, OverTime)}
    own = {name: effect.table or effect.harmonic for name, effect in acting.items()}
    peaks = {name: _peak(function) for name, function in own.items()}
    loads = [Load("own", "the scene's own loads", own, True)]
    if not any(peaks.values()):
        return tuple(loads)
    pulse = {name: _pulse(function, scene.simulation.duration) for name, function in own.items()}
    gentle = all(_steepness(pulse[name]) <= HASTE * _steepness(own[name]) for name in own)
    harmonic = [isinstance(function, LoadHarmonic) for function in own.values()]
    sine = f"a half sine over the run, {PULSE:g} times the largest {_kinds(acting.values())}"
    about = [] if all(harmonic) else [sine]
    about += [f"harmonics {PULSE:g} times as large"] if any(harmonic) else []
    loads.append(Load("pulse", ", ".join(about) + ("" if gentle else OF_REDUCTION), pulse, gentle))
    quick = {name: _hastened(function) for name, function in own.items()}
    if any(isinstance(f, LoadHarmonic) or len({value for _, value in f}) > 1 for f in quick.values()):
        about = f"the scene's {_kinds(acting.values(), 's')} {HASTE:g} times as fast"
        loads.append(Load("quick", about + OF_REDUCTION, quick, False))
    return tuple(loads)


def stops_of(scene: Scene) -> list[str]:
    """Return the end stops whose stiffness is a number."""
    stops = {name: effect for name, effect in scene.plain_effects.items() if effect.sets_in}
    return [name for name, effect in stops.items() if not isinstance(getattr(effect, effect.stiff_by), str)]


def with_softer_stops(scene: Scene, factor: float) -> Scene:
    """Return the scene with its end stops a factor as stiff."""
    effects = scene.plain_effects
    for name in stops_of(scene):
        stop = effects[name]
        effects[name] = stop.model_copy(update={stop.stiff_by: factor * getattr(stop, stop.stiff_by)})
    return scene.model_copy(update={"effects": effects})


def sets_in_at_once(function: Function) -> bool:
    """Return whether a torque or force is not zero at the start."""
    if isinstance(function, LoadHarmonic):
        return function.mean + function.amplitude * np.sin(function.phase) != 0.0
    time, value = np.array(function, dtype=float).T
    return bool(np.interp(0.0, time, value) != 0.0)


def _kinds(effects: Iterable[OverTime], plural: str = "") -> str:
    """Return what acts: ``torque``, ``force`` or ``torque and force``."""
    return " and ".join(word + plural for word in sorted({effect.type for effect in effects}, reverse=True))


def _scaled(function: Function, factor: float) -> Function:
    if isinstance(function, LoadHarmonic):
        larger = {"amplitude": factor * function.amplitude, "mean": factor * function.mean}
        return function.model_copy(update=larger)
    return tuple((time, factor * value) for time, value in function)


def _peak(function: Function) -> float:
    """Return the value of largest size, with its sign."""
    if isinstance(function, LoadHarmonic):
        return abs(function.amplitude) + abs(function.mean)
    return max((value for _, value in function), key=abs)


def _pulse(function: Function, duration: float) -> Function:
    """Return a half sine over the run in place of a table, and a harmonic that is as much larger."""
    if isinstance(function, LoadHarmonic):
        return _scaled(function, PULSE)
    largest = PULSE * _peak(function)
    return tuple((float(duration * x), float(largest * np.sin(np.pi * x))) for x in np.linspace(0.0, 1.0, N_ROWS))


def _hastened(function: Function) -> Function:
    if isinstance(function, LoadHarmonic):
        return function.model_copy(update={"frequency_hz": HASTE * function.frequency_hz})
    return tuple((time / HASTE, value) for time, value in function)


def _steepness(function: Function) -> float:
    """Return the largest slope over time, N m/s or N/s; infinite where it does not begin at zero."""
    if sets_in_at_once(function):
        return np.inf
    if isinstance(function, LoadHarmonic):
        return float(2.0 * np.pi * function.frequency_hz * abs(function.amplitude))
    time, value = np.array(function, dtype=float).T
    slopes = np.abs(np.diff(value) / np.diff(time)) if time.size > 1 else np.zeros(1)
    return float(slopes.max())
