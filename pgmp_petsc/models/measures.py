"""Measures of controllers, read of a model's state as outputs are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from pgmp_petsc.controllers.acting import has_motion, measured_by
from pgmp_petsc.controllers.running import Controls, rows_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.outputs.readings import Rate, Reading
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State

#: Frames of nodes and their rates, each (n_nodes, n_frame, n_samples), for a state.
FramesOf = Callable[[State], list[np.ndarray]]


class Measures:
    """The motions that a scene's controllers measure, with their rates.

    Attributes
    ----------
    nodes
        Whose frames are read.
    known
        Whether actions of the mechanics measure all of them (`controllers.acting.motion_of`).
    rows
        Of each, its number among the parts of all forces (`controllers.running.rows_of`).
    origins
        What counts as zero of each, where actions measure it, a number for each of these parts.
    """

    def __init__(self, scene: Scene, kinematics: RigidKinematics, start: np.ndarray) -> None:
        motions = [name for one in scene.controllers.values() for name in measured_by(scene, one).motions]
        of_these = OutputSet.of(
            scene.model_copy(update={"outputs": {name: scene.outputs[name] for name in motions}}), kinematics, start
        )
        self._scene, rows = scene, rows_of(scene)
        firsts = np.cumsum([0, *rows]).tolist()
        each = (len(measured_by(scene, one).motions) for one in scene.controllers.values())
        self.rows = [first + k for first, n in zip(firsts, each) for k in range(n)]
        found = (of_these.functions[name] for name in motions)
        self._read = [(one.of if isinstance(one, Rate) else one, True) for one in found]
        self._set = replace(of_these, order=1)
        self.nodes = of_these.nodes
        self.known = all(has_motion(scene, name) for name in motions)
        self.origins = np.zeros(sum(rows))
        self.origins[self.rows] = [one.origin if isinstance(one, Reading) else 0.0 for one, _ in self._read]

    def controls(
        self, frames: FramesOf, values: Mapping[str, np.ndarray], n_samples: int, put: Callable[[np.ndarray], object],
        motions: Callable[[State], np.ndarray] | None = None,
    ) -> Controls:  # fmt: skip
        """Return the controllers of samples; see `Controls`. Where all are `known`, `motions` gives these and their
        rates, in a row for each part of a force, (n_rows, n_samples, 2), in a fraction of the time."""

        def moved(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
            found = motions(state)[self.rows]
            return found[:, :, 0] - self.origins[self.rows, None], found[:, :, 1]

        def measure(time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
            found = self._set.observed(frames(state), np.empty((0, n_samples)), time, {**self._scene.values, **values})
            with np.errstate(all="ignore"):  # samples that fail
                jets = self._set.jets(found, self._read)
            return tuple(np.array([jet[k] for jet in jets]).reshape(-1, n_samples) for k in range(2))

        return Controls(self._scene, values, n_samples, moved if motions and self.known else measure, put)
