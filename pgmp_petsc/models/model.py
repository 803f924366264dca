"""Interface of a model for simulations and ensembles.

Measures of controllers, read of a model's state as outputs are, and the forces that joints carry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.controllers.acting import are_stated, measured_by
from pgmp_petsc.controllers.running import rows_of
from pgmp_petsc.declare.ideas import refuse
from pgmp_petsc.mechanism.closure import size_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.outputs.multipliers import carried_forces
from pgmp_petsc.outputs.outputs import OutputSet, with_outputs
from pgmp_petsc.outputs.readings import AnyReading, Rate, Reading, Seen
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.outputs import OutputEntry
from pgmp_petsc.scene.uses import length_names, velocity_names
from pgmp_petsc.stepping.second_order_system import PooledObserver, SecondOrderSystem, State
from pgmp_petsc.stepping.static_equilibrium import Search

if TYPE_CHECKING:
    from pgmp_petsc.reduction.rom import Served

# an output below this share of the mechanism's size, of 1 rad, or of the stress of a strain of 1, is taken for zero
ROUND_OFF = 1e-10
#: What messages call the models, by their names.
TITLES = {"full": "full-order", "components": "component", "reduced": "reduced"}


class Model(Protocol):
    """A model of a scene; models have it as their base."""

    #: name, title: ``full``, ``components`` or ``reduced``; what messages call it
    name: str
    title: str
    #: scene, kinematics, outputs: the scene, its rigid kinematics and its outputs
    scene: Scene
    kinematics: RigidKinematics
    outputs: OutputSet
    on_ranks: bool  # whether ranks share the unknowns of a single run
    largest_batch: int  # most samples that a batch has
    served: Mapping[str, Served]  # ranges of parameters that it was built for; empty where it serves any
    identity: str  # checksum of what the model is made of besides the scene's text: meshes, or a reduced model's tables

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> SecondOrderSystem:
        """Return a system of n_samples samples on this rank; values have shape (n_samples,)."""

    def observed_over(self, system: SecondOrderSystem, states: State, times: Sequence[float]) -> np.ndarray:
        """Return what ``outputs.evaluate`` takes in states with a leading axis, with forces beside where there are any,
        at times (n_t,), s, shape (n_observed, n_t n_samples), instant after instant. Collective on the system's
        communicator."""

    def observed(self, system: SecondOrderSystem, state: State, time: float = 0.0) -> np.ndarray:
        """Return the same at the time (s) that the system reached last, shape (n_observed, n_samples)."""
        states = state.alone
        if system.beside is not None:
            states.forces = system.beside.now[None]
        return self.observed_over(system, states, [time])


class OutputRecord(PooledObserver):
    """Keeps what the outputs are made of after one of `every` so many steps of samples; observes a run."""

    def __init__(
        self, model: Model, system: SecondOrderSystem, pulse: Callable[[int], object] = lambda n_steps: None,
        every: int = 1,
    ) -> None:  # fmt: skip
        self._model, self._system, self.every = model, system, every
        self._observed: list[np.ndarray] = []
        super().__init__(system.instants_at_once, pulse)

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        if self.every > 1:
            chosen = numbers % self.every == 0
            numbers, times, states = numbers[chosen], times[chosen], states.at(chosen)
        super().over(numbers, times, states)

    def see(self, first: int, states: State) -> None:
        self._observed.append(self._model.observed_over(self._system, states, self.times[first:]))

    def evaluated(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the instants (n_t,), s, and every output (n_t, n_samples), before anything is counted."""
        self.finish()
        with np.errstate(all="ignore"):
            found = self._model.outputs.evaluate(np.concatenate(self._observed, axis=-1))
        return np.array(self.times), {name: values.reshape(len(self.times), -1) for name, values in found.items()}

    def outputs(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the instants (n_t,), s, and every output (n_t, n_samples)."""
        time, found = self.evaluated()
        return time, self._model.outputs.counted_over(time, found, self._system.values)


def floors_of(model: Model) -> np.ndarray:
    """Return below which every output is taken for zero, in its unit, shape (n_outputs,)."""
    sizes = {stress.name: stress.size for stress in model.outputs.stresses}
    sizes |= dict.fromkeys(model.outputs.counts, np.finfo(float).tiny / ROUND_OFF)  # a damage of any size counts
    units = model.outputs.units.items()
    return np.array(
        [ROUND_OFF * sizes.get(name, 1.0 if unit == "rad" else model.kinematics.size) for name, unit in units]
    )


def require_lengths(scene: Scene, values: Values) -> None:
    """Raise `ValueError` where lengths are not those of the scene's run, which a model's mechanism is made with."""
    for name in length_names(scene):
        if name in values and np.any(values[name] != scene.values[name]):
            raise ValueError(f"{name} = {values[name]}: the model is that of {scene.values[name]}; see models.lengths")


def velocities_of(
    scene: Scene, mechanism: Mechanism, of_run: np.ndarray, values: Mapping[str, np.ndarray], n_samples: int
) -> np.ndarray:
    """Return velocities at the start, rad/s: those of the run (n_theta,), or (n_theta, n_samples) where parameters with
    values (n_samples,) are some of them."""
    named = velocity_names(scene)
    if not named:
        return of_run
    found = np.repeat(of_run[:, None], n_samples, axis=1)
    for row, coordinate in zip(found, mechanism.coordinates):
        if coordinate.name in named:
            row[:] = values[named[coordinate.name]]
    return found


def search_of(scene: Scene, mechanism: Mechanism) -> Search:
    """Return how far a scene's coordinates may go to find their static equilibrium."""
    coordinates = mechanism.coordinates
    free = scene.initial.coordinates == "free"
    lower, upper = np.array([(-np.inf, np.inf) if c.periodic else (c.lower, c.upper) for c in coordinates]).T
    return Search(
        tuple(map(int, mechanism.free)) if free else (),
        coordinates,
        lower,
        upper,
        scene.simulation.duration,
        size_of(mechanism),
    )


def _before(entry: OutputEntry, reading: AnyReading) -> AnyReading:
    """Return what a controller's law takes the value or the rate of, as an output's `derivative` says; raises
    `InputError` if it reads another one."""
    order = reading.order if isinstance(reading, Rate) else 0
    if order != entry.derivative:
        words = f"it reads a derivative of order {order}, and says {entry.derivative}"
        raise refuse(type(entry), f"{words}; controllers that measure it go by its attribute derivative")
    return reading.of if order else reading


class Measures:
    """The motions that a scene's controllers measure, with their rates.

    They are read from the frames of `nodes`, of order 1 with their rates, and forces in joints that effects hang on,
    `carried`. Whether actions of the mechanics measure them all (`OutputEntry.stated`) is `known`. `rows` are
    their numbers among the parts of all forces that are given (`controllers.running.rows_of`), and `origins`, a number
    for each of these parts, what counts as zero where actions measure it.
    """

    def __init__(self, scene: Scene, kinematics: RigidKinematics, start: np.ndarray) -> None:
        motions = [name for one in scene.controllers.values() for name in measured_by(scene, one).motions]
        of_these = OutputSet.of(with_outputs(scene, motions), kinematics, start)
        self._scene, rows = scene, rows_of(scene)
        firsts = np.cumsum([0, *rows])[len(scene.carried) :].tolist()
        each = (len(measured_by(scene, one).motions) for one in scene.controllers.values())
        self.rows = [first + k for first, n in zip(firsts, each) for k in range(n)]
        self._read = [(_before(scene.outputs[name], of_these.functions[name]), True) for name in motions]
        self._set, self.carried = replace(of_these, order=1), carried_forces(scene, kinematics, start)
        self.nodes = tuple(sorted({*of_these.nodes, *(node for one in self.carried for node in one.nodes)}))
        self.order = int(bool(scene.controllers) or any(one.reads_rates for one in self.carried))
        self._own = [self.nodes.index(node) for node in of_these.nodes]
        self.known = are_stated(scene)
        self.origins = np.zeros(sum(rows))
        self.origins[self.rows] = [one.origin if isinstance(one, Reading) else 0.0 for one, _ in self._read]

    def noted(self, found: np.ndarray, origins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what `motions` does of what actions measure, (n_rows, n_samples, 2), with origins of samples as of
        `Measures`, (n_rows, n_samples or 1)."""
        found = found[self.rows]
        return found[:, :, 0] - origins[self.rows], found[:, :, 1]

    def motions(
        self, frames: Sequence[np.ndarray], time: float, values: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the motions and their rates, (n_motions, n_samples) each, of frames of `nodes` with their derivatives
        up to `order`, (n_nodes, n_frame, n_samples) each, at a time (s) and parameter values (n_samples,)."""
        seen, n_samples = [part[self._own] for part in frames], frames[0].shape[-1]
        found = self._set.observed(seen, np.empty((0, n_samples)), time, {**self._scene.values, **values})
        with np.errstate(all="ignore"):  # samples that fail
            jets = self._set.jets(found, self._read)
        return tuple(np.array([jet[k] for jet in jets]).reshape(-1, n_samples) for k in range(2))

    def pulls(
        self, frames: Sequence[np.ndarray], multipliers: np.ndarray, values: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return the vectors whose magnitudes are the forces that joints carry, (n_carried, d, n_samples), of frames as
        of `motions`, and multipliers of joints (n_held + n_driven, n_samples)."""
        at = tuple(dict(zip(self.nodes, part)) for part in frames)
        seen = Seen(at, values={**self._scene.values, **values}, multipliers=multipliers)
        return np.array([one.parts(seen) for one in self.carried])
