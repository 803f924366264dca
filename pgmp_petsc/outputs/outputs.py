"""Outputs: what a user sees of a motion.

All outputs but stresses and forces in joints are read of the frames of some nodes and of their rates and accelerations,
whichever model moved them, of the time and of parameters (`readings`). Stresses depend on what else a model knows of a
body, and on parameters; each model evaluates them in its own way (`models.body_fields`). So do forces in joints, which
depend on the model's multipliers (`multipliers`). What a model observes has all this in rows, as far as outputs read
it: frames, rates, accelerations, stresses, forces, the time, parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import UnknownUnit, measure
from pgmp_petsc.bodies.affine import Quantity, Values
from pgmp_petsc.declare.ideas import blaming, refuse
from pgmp_petsc.effects import bases_of, start_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.outputs.multipliers import ForceOutput, force_outputs
from pgmp_petsc.outputs.readings import AnyReading, Base, Frames, Jet, ModelReading, Needs, RigidReference, Seen, jet_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.outputs import OutputEntry

if TYPE_CHECKING:
    from pgmp_petsc.outputs.rainflow import Counted
    from pgmp_petsc.outputs.stress import StressOutput


class OverRuns:
    """Outputs of which some are counted over a run, those of `counts`."""

    counts: Mapping[str, Counted]

    def counted_over(self, times: np.ndarray, found: Mapping[str, np.ndarray], values: Values) -> dict[str, np.ndarray]:
        """Return outputs of whole runs, (n_t, n) or (n_t,), with those that are counted in place of what they count."""
        if not self.counts:
            return dict(found)
        from pgmp_petsc.outputs.rainflow import counted_after  # most runs count nothing

        return counted_after(self.counts, times, found, values)


@dataclass(frozen=True)
class OutputSet(OverRuns):
    """The outputs of a scene."""

    nodes: tuple[int, ...]  # global node numbers whose frames are needed, increasing
    units: dict[str, str]  # unit of every output
    n_frame: int  # numbers of a frame: 3 in the plane, in space 12 and the coordinates
    n_pose: int  # how many of them have rates: 3 in the plane, in space 12
    functions: dict[str, AnyReading]  # what every output reads
    stresses: tuple[StressOutput, ...] = ()  # stress outputs, in the order in which models observe them
    forces: tuple[ForceOutput, ...] = ()  # outputs of multipliers, which follow them in this order
    #: from frames to where the coordinates are within their ranges, shape (n,); None where all outputs are known
    #: everywhere: none is a deformation, or every coordinate is periodic
    reached: Callable[[Frames], np.ndarray] | None = None
    #: the rigid mechanism that deformations are taken from; None where there are none
    rigid: RigidReference | None = None
    order: int = 0  # derivatives of frames that outputs read: 0 none, 1 rates, 2 accelerations too
    reads_time: bool = False
    parameters: tuple[str, ...] = ()  # that outputs read
    bases: tuple[Base, ...] = ()  # motions of the base, where outputs read them
    counted: tuple[str, ...] = ()  # outputs that are counted over a run
    #: outputs of forces of controllers, and their numbers among all that is beside, which follow forces in this order
    beside: Mapping[str, int] = field(default_factory=dict)
    takes_beside: bool = False  # whether reduced models need what is beside: for these, or multipliers under control

    @property
    def n_forces(self) -> int:
        """Number of what outputs of forces are made of, which is behind stresses."""
        return sum(one.n_parts for one in self.forces) + len(self.beside)

    def observed(
        self,
        frames: Sequence[np.ndarray],
        stresses: np.ndarray,
        time: np.ndarray | float = 0.0,
        values: Mapping[str, np.ndarray | float] | None = None,
    ) -> np.ndarray:
        """Return what `evaluate` takes, shape (n_observed, n), at times, s, and values of parameters, numbers or of
        shape (n,).

        Frames are of `nodes`, shape (n_nodes, n_frame, n), and their derivatives up to `order`, each (n_nodes, n_pose,
        n); stresses have forces behind them, shape (n_stresses + n_forces, n).
        """
        n = stresses.shape[1]
        parts = [*(part.reshape(-1, n) for part in frames[: 1 + self.order]), stresses]
        rows = [time] if self.reads_time else []
        parts += [np.broadcast_to(row, (1, n)) for row in (*rows, *(values[name] for name in self.parameters))]
        return np.concatenate(parts)

    def evaluate(self, observed: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs, each of shape (n,), for what a model observes, shape (n_observed, n).

        Of those that are counted over a run it is what they count: see `rainflow.Counting`.
        """
        return self._evaluated(observed, self.rigid and self.rigid.poses)

    @property
    def counts(self) -> dict[str, Counted]:
        """Readings that are counted over a run, by the outputs' names."""
        return {name: self.functions[name] for name in self.counted}

    def near(self, observed: np.ndarray) -> Callable[[np.ndarray], dict[str, np.ndarray]]:
        """Return `evaluate` for what is observed there and next to it, for central differences; see
        `RigidKinematics.near`."""
        poses = self.rigid and self.rigid.near(self._seen(observed).frames[0])
        return lambda beside: self._evaluated(beside, poses)

    def _evaluated(self, observed: np.ndarray, poses: Callable[[Frames], np.ndarray] | None) -> dict[str, np.ndarray]:
        seen = self._seen(observed, poses)
        return {name: jet_of(reading, seen, 0)[0] for name, reading in self.functions.items()}

    def jets(self, observed: np.ndarray, readings: Sequence[tuple[AnyReading, bool]]) -> list[Jet]:
        """Return the values and rates of readings of these outputs, each (n,), for what a model observes; rates are
        zero of those that none is asked for of."""
        seen = self._seen(observed, self.rigid and self.rigid.poses)
        found = [jet_of(reading, seen, int(with_rate)) for reading, with_rate in readings]
        return [[*jet, np.zeros_like(jet[0])][:2] for jet in found]

    def forces_of(
        self, frames: Sequence[np.ndarray], multipliers: np.ndarray, values: Mapping[str, np.ndarray | float]
    ) -> np.ndarray:
        """Return what forces in joints are made of, a row each, for frames of `nodes` with their derivatives, as of
        `observed`, multipliers of joints and prescribed coordinates (n_held + n_driven, n), and parameter values,
        numbers or of shape (n,)."""
        seen = Seen(tuple(dict(zip(self.nodes, part)) for part in frames), values=values, multipliers=multipliers)
        return np.concatenate([force.parts(seen) for force in self.forces])

    def smooth(self, apart: Container[str]) -> OutputSet:
        """Return the outputs without stresses and those in `apart`; forces as what they are made of."""
        functions = {
            name: replace(reading, made=None) if isinstance(reading, ModelReading) else reading
            for name, reading in self.functions.items() if name not in apart and not reading.needs.stresses
        }  # fmt: skip
        return replace(self, functions=functions, stresses=())

    def left_range(self, observed: np.ndarray) -> np.ndarray:
        """Return where a coordinate is outside the range that a deformation is known in, shape (n,), for what a model
        observes, shape (n_observed, n)."""
        if self.reached is None:
            return np.zeros(observed.shape[1], dtype=bool)
        return ~self.reached(self._seen(observed).frames[0])

    def under(self, scene: Scene) -> OutputSet:
        """Return the outputs under the loads of another scene."""
        return replace(self, bases=_bases(scene)) if self.bases else self

    def _seen(self, observed: np.ndarray, poses: Callable[[Frames], np.ndarray] | None = None) -> Seen:
        n, n_nodes = observed.shape[1], len(self.nodes)
        sizes = [self.n_frame, *(self.n_pose for _ in range(self.order))]
        counts = (*(n_nodes * size for size in sizes), len(self.stresses) + self.n_forces, self.reads_time)
        ends = pairwise((*accumulate(counts, initial=0), len(observed)))  # a tenth of the time of numpy's split
        *moving, stresses, time, values = (observed[first:end] for first, end in ends)
        frames = tuple(dict(zip(self.nodes, part.reshape(n_nodes, size, n))) for part, size in zip(moving, sizes))
        return Seen(
            frames,
            self.rigid,
            poses and poses(frames[0]),
            of_model=self._of_model(stresses),
            time=time[0] if self.reads_time else None,
            values=dict(zip(self.parameters, values)),
            bases=self.bases,
            n=n,
        )

    def _of_model(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        found = {one.name: row for one, row in zip(self.stresses, rows)}
        ends = pairwise(accumulate((one.n_parts for one in self.forces), initial=len(found)))
        found |= {one.name: rows[first:end] for one, (first, end) in zip(self.forces, ends)}
        return found | dict(zip(self.beside, rows[len(rows) - len(self.beside) :]))

    @classmethod
    def of(cls, scene: Scene, kinematics: RigidKinematics, start: np.ndarray | None = None) -> OutputSet:
        """Prepare the outputs of a scene, with coordinates at the start, shape (n_theta,), rad; by default the scene's.

        Raises `InputError` if an output names a point that the mesh does not have, or a stress that is not known there.
        """
        if start is None:
            start = start_of(scene, kinematics.mechanism)[0]
        functions, stresses, needs, order, beside = {}, [], Needs(), 0, []
        numbers = {name: k for k, name in enumerate((*scene.carried, *scene.controllers))}
        forces = force_outputs(scene, kinematics, start)
        for name in in_order(scene):
            entry, where = scene.outputs[name], f"outputs.{name}"
            with blaming(type(entry)):
                if "stresses" in entry.reads:
                    from pgmp_petsc.outputs.stress import StressOutput  # no other output waits for it

                    bodies = enumerate(kinematics.mechanism.bodies)
                    number, body = next(one for one in bodies if one[1].name == entry.body)
                    stresses.append(StressOutput.of(name, scene, number, body))
                    reading = ModelReading(name, Needs(stresses=frozenset([name])))
                elif "multipliers" in entry.reads:
                    force = next(one for one in forces if one.name == name)
                    own = Needs(frozenset(force.nodes), multipliers=frozenset([name]))
                    reading = ModelReading(name, own, int(force.reads_rates), force.made)
                elif "beside" in entry.reads:
                    reading = ModelReading(name, Needs())
                    beside.append((name, entry.controller))
                elif "outputs" in entry.reads:
                    reading = entry.combined(where, {one: functions[one] for one in entry.made_in(scene)}, scene)
                else:
                    reading = entry.reading(where, start, kinematics)
                _check(entry, reading, scene)
                functions[name], needs = reading, needs | reading.needs
            try:
                order = max(order, reading.depth(0))
            except InputError as error:
                raise InputError(f"{where}: {error}") from None
        functions = {name: functions[name] for name in scene.outputs}
        mechanism, rigid, reached = kinematics.mechanism, None, None
        n_frame = mechanism.space.n_pose + (len(mechanism.coordinates) if mechanism.space is SPATIAL else 0)
        if needs.of_coordinates:
            rigid = RigidReference(kinematics)
            if not all(coordinate.periodic for coordinate in mechanism.coordinates):
                reached = rigid.reached
        bases = _bases(scene) if needs.base else ()
        of_bases = {name for base in bases for name, _ in base.factor.monomial.powers}
        # SI units, and where a scene does not say its own, what these are called
        label = scene.system.unit if scene.system.is_si else str
        units = {name: label(entry.unit_in(scene)) for name, entry in scene.outputs.items()}
        return cls(
            tuple(sorted(needs.nodes)), units, n_frame, mechanism.space.n_pose, functions, tuple(stresses), forces,
            reached, rigid, order, needs.time, tuple(sorted(needs.parameters | of_bases)), bases,
            scene.counted,
            {name: numbers[controller] for name, controller in beside},
            bool(beside) or bool(forces and scene.controllers),
        )  # fmt: skip


def _check(entry: OutputEntry, reading: AnyReading, scene: Scene) -> None:
    """Refuse what an entry reads if it is no reading, has no unit, or needs what the scene has not."""
    if not hasattr(reading, "jet"):
        raise refuse(type(entry), f"an output is made of outputs.readings, and this is a {type(reading).__name__}")
    try:
        measure(entry.unit_in(scene))
    except UnknownUnit as error:
        raise refuse(type(entry), f"unit_in: '{entry.unit_in(scene)}': {error}") from error
    if unknown := sorted(reading.needs.parameters - set(scene.parameters)):
        raise refuse(type(entry), f"it reads the parameter '{unknown[0]}', which the scene has not")


def in_order(scene: Scene, names: Iterable[str] | None = None) -> list[str]:
    """Return the names of outputs, by default of all, each behind those that it is made of."""
    found: dict[str, None] = {}

    def add(name: str) -> None:
        for other in scene.outputs[name].made_in(scene):
            add(other)
        found[name] = None

    for name in scene.outputs if names is None else names:
        add(name)
    return list(found)


def measured_in(scene: Scene) -> list[str]:
    """Return the names of the outputs that controllers measure."""
    return [name for one in scene.controllers.values() for name in one.measured.values()]


def with_outputs(scene: Scene, names: Iterable[str]) -> Scene:
    """Return a scene with these outputs, and what they are made of, alone."""
    return scene.with_entries(outputs={name: scene.outputs[name] for name in in_order(scene, names)})


def _bases(scene: Scene) -> tuple[Base, ...]:
    """Return the motions of a scene's base."""
    return tuple(
        Base(np.array(entry.direction) / np.linalg.norm(entry.direction), Quantity.of(entry.scale), course)
        for entry, course in bases_of(scene)
    )
