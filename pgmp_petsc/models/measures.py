"""Measures of controllers, read of a model's state as outputs are, and the forces that joints carry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from pgmp_petsc.controllers.running import Controls
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.outputs import OutputSet, carried_in
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State

#: Frames of nodes and, of order 1, their rates, each (n_nodes, n_frame, n_samples), for a state.
FramesOf = Callable[[State], list[np.ndarray]]
#: Multipliers of joints, (n_held + n_driven, n_samples), at a time (s), for a state, and forces (n_carried, n_samples)
#: that joints were taken to carry.
MultipliersOf = Callable[[float, State, np.ndarray], np.ndarray]


class Measures:
    """The outputs that a scene's controllers measure, with their rates.

    Attributes
    ----------
    nodes, order
        Whose frames are read, and whether with their rates: 1 where they are.
    carried
        Forces in joints that effects hang on.
    of_joints
        Whether all are motions in joints or their rates, which forces of controllers know by themselves.
    """

    def __init__(self, scene: Scene, kinematics: RigidKinematics, start: np.ndarray) -> None:
        measured = {one.measures for one in scene.controllers.values()}
        needed = {name: entry for name, entry in scene.outputs.items() if name in _parts_of(scene, measured)}
        of_these = OutputSet.of(scene.model_copy(update={"outputs": needed}), kinematics, start)
        self._scene = scene
        self._read = [(of_these.functions[one.measures], one.needs_rate) for one in scene.controllers.values()]
        self._set, self.carried = replace(of_these, order=1), carried_in(scene, kinematics, start)
        self.nodes = tuple(sorted({*of_these.nodes, *(node for one in self.carried for node in one.nodes)}))
        self.order = int(bool(scene.controllers) or any(one.reads_rates for one in self.carried))
        self._own = [self.nodes.index(node) for node in of_these.nodes]
        self.of_joints = all(getattr(scene.outputs[name], "joint", None) is not None for name in measured)

    def controls(
        self, frames: FramesOf, values: Mapping[str, np.ndarray], n_samples: int, put: Callable[[np.ndarray], object],
        multipliers: MultipliersOf, motions: Callable[[State], np.ndarray] | None = None,
    ) -> Controls:  # fmt: skip
        """Return the controllers of samples, and what joints carry; see `Controls`. Where all are `of_joints`,
        `motions` gives these and their rates, (n_controllers, n_samples, 2), in a fraction of the time."""
        entries = self._scene.controllers.values()
        of_rate = np.array([self._scene.outputs[one.measures].derivative > 0 for one in entries])

        def moved(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
            found = motions(state)
            measures, rates = found[:, :, 0].copy(), found[:, :, 1].copy()
            measures[of_rate], rates[of_rate] = rates[of_rate], 0.0
            return measures, rates

        def measure(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
            seen = [part[self._own] for part in frames(state)]
            found = self._set.observed(seen, np.empty((0, n_samples)), time, {**self._scene.values, **values})
            with np.errstate(all="ignore"):  # samples that fail
                jets = self._set.jets(found, self._read)
            return np.array([jet[0] for jet in jets]), np.array([jet[1] for jet in jets])

        def carry(time: float, state: State, before: np.ndarray) -> np.ndarray:
            at, moving, *_ = *(dict(zip(self.nodes, part)) for part in frames(state)), {}
            found, every = multipliers(time, state, before), {**self._scene.values, **values}
            return np.array([one.value(at, moving, found, every) for one in self.carried])

        chosen = moved if motions and self.of_joints else measure
        return Controls(self._scene, values, n_samples, chosen, put, carry if self.carried else None)


def _parts_of(scene: Scene, names: set[str]) -> set[str]:
    """Return some outputs with all that they are made of."""
    found, waiting = set(), list(names)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += scene.outputs[name].made_in(scene)
    return found
