"""Measures of controllers, read of a model's state as outputs are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from pgmp_petsc.controllers.running import Controls
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State

#: Frames of nodes and their rates, each (n_nodes, n_frame, n_samples), for a state.
FramesOf = Callable[[State], list[np.ndarray]]


class Measures:
    """The outputs that a scene's controllers measure, with their rates.

    Attributes
    ----------
    nodes
        Whose frames are read.
    of_joints
        Whether all are motions in joints or their rates, which forces of controllers know by themselves.
    """

    def __init__(self, scene: Scene, kinematics: RigidKinematics, start: np.ndarray) -> None:
        measured = {one.measures for one in scene.controllers.values()}
        needed = {name: entry for name, entry in scene.outputs.items() if name in _parts_of(scene, measured)}
        of_these = OutputSet.of(scene.model_copy(update={"outputs": needed}), kinematics, start)
        self._scene = scene
        self._read = [(of_these.functions[one.measures], one.needs_rate) for one in scene.controllers.values()]
        self._set = replace(of_these, order=1)
        self.nodes = of_these.nodes
        self.of_joints = all(getattr(scene.outputs[name], "joint", None) is not None for name in measured)

    def controls(
        self, frames: FramesOf, values: Mapping[str, np.ndarray], n_samples: int, put: Callable[[np.ndarray], object],
        motions: Callable[[State], np.ndarray] | None = None,
    ) -> Controls:  # fmt: skip
        """Return the controllers of samples; see `Controls`. Where all are `of_joints`, `motions` gives these and their
        rates, (n_controllers, n_samples, 2), in a fraction of the time."""
        entries = self._scene.controllers.values()
        of_rate = np.array([self._scene.outputs[one.measures].derivative > 0 for one in entries])

        def moved(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
            found = motions(state)
            measures, rates = found[:, :, 0].copy(), found[:, :, 1].copy()
            measures[of_rate], rates[of_rate] = rates[of_rate], 0.0
            return measures, rates

        def measure(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
            found = self._set.observed(frames(state), np.empty((0, n_samples)), time, {**self._scene.values, **values})
            with np.errstate(all="ignore"):  # samples that fail
                jets = self._set.jets(found, self._read)
            return np.array([jet[0] for jet in jets]), np.array([jet[1] for jet in jets])

        return Controls(self._scene, values, n_samples, moved if motions and self.of_joints else measure, put)


def _parts_of(scene: Scene, names: set[str]) -> set[str]:
    """Return some outputs with all that they are made of."""
    found, waiting = set(), list(names)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += scene.outputs[name].made_in(scene)
    return found
