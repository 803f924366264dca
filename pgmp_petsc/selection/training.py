"""What tolerances are tried on: parameter values and loads that span those of later runs.

Parameters take their nominal value, their quantiles at three standard deviations of a normal distribution (bounds
applied as an ensemble does), and the values half-way: alone, the others nominal (a star), and the outermost ones
together (corners). Torques take the scene's own tables, a half-sine pulse over the whole run, `PULSE` times as large
as the largest torque, and the own tables `HASTE` times as fast. The quicker a load sets in, the more it makes the
bodies vibrate, and the smaller a step has to be: the step is found with the own tables alone, and with the pulse where
it does not rise more than `HASTE` times as fast. Loads that set in at once are tried where they are the scene's own,
and not otherwise: no step and no small basis follows what they set off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import Torque
from pgmp_petsc.scene.spanning_values import spanning_values, uncertain_names

PULSE = 1.6
HASTE = 2.0
OF_REDUCTION = ", for basis and interpolation"
N_ROWS = 129  # of the pulse: its corners are then small beside that of its beginning

Table = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Load:
    """The torques of one variant.

    Attributes
    ----------
    name, description
        For messages.
    tables
        Table of every torque, by the effect's name.
    for_step
        Whether the step is found with them; basis and interpolation are with all.
    """

    name: str
    description: str
    tables: Mapping[str, Table]
    for_step: bool

    def of(self, scene: Scene, factor: float = 1.0) -> Scene:
        """Return the scene under these loads, times a factor."""
        effects = dict(scene.effects)
        for name, table in self.tables.items():
            scaled = tuple((time, factor * value) for time, value in table)
            effects[name] = effects[name].model_copy(update={"table": scaled})
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
        if not uncertain_names(scene):
            remarks.append("no parameter has a distribution: none is varied")
        if len(loads) == 1:
            remarks.append("no torque acts by a table: loads are not varied")
        return cls(values, n_samples, loads, tuple(remarks))

    def sample_text(self, sample: int) -> str:
        """Return the parameter values of a sample, ``r1 = 0.0056``."""
        return ", ".join(f"{name} = {column[sample]:.4g}" for name, column in self.values.items())


def training_loads(scene: Scene) -> tuple[Load, ...]:
    """Return the variants of the loads, the scene's own first; of torques by tables alone."""
    torques = {name: effect for name, effect in scene.effects.items() if isinstance(effect, Torque)}
    own = {name: torque.table for name, torque in torques.items() if torque.table is not None}
    peaks = {name: max((value for _, value in table), key=abs) for name, table in own.items()}
    loads = [Load("own", "the scene's own loads", own, True)]
    if not any(peaks.values()):
        return tuple(loads)
    phase = np.linspace(0.0, 1.0, N_ROWS)
    pulse = {
        name: tuple((float(scene.simulation.duration * x), float(PULSE * peak * np.sin(np.pi * x))) for x in phase)
        for name, peak in peaks.items()
    }
    gentle = all(_steepness(pulse[name]) <= HASTE * _steepness(own[name]) for name in own)
    about = f"a half sine over the run, {PULSE:g} times the largest torque"
    loads.append(Load("pulse", about + ("" if gentle else OF_REDUCTION), pulse, gentle))
    quick = {name: tuple((time / HASTE, value) for time, value in table) for name, table in own.items()}
    if any(len({value for _, value in table}) > 1 for table in quick.values()):
        loads.append(Load("quick", f"the scene's torques {HASTE:g} times as fast" + OF_REDUCTION, quick, False))
    return tuple(loads)


def _steepness(table: Table) -> float:
    """Return the largest slope of a torque over time, N m/s; infinite where it does not begin at zero."""
    time, value = np.array(table, dtype=float).T
    began = float(np.interp(0.0, time, value))
    slopes = np.abs(np.diff(value) / np.diff(time)) if time.size > 1 else np.zeros(1)
    return np.inf if began != 0.0 else float(slopes.max())
