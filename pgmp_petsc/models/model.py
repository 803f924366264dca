"""What simulations and ensembles ask of a model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import SecondOrderSystem, State
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene import Scene


class Model(Protocol):
    """A model of a scene.

    Attributes
    ----------
    name
        ``full`` or ``reduced``.
    scene, kinematics, outputs
        The scene, its rigid kinematics and its outputs.
    """

    name: str
    scene: Scene
    kinematics: RigidKinematics
    outputs: OutputSet

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> SecondOrderSystem:
        """Return a system of n_samples samples on this rank; values have shape (n_samples,)."""

    def output_frames(self, system: SecondOrderSystem, state: State) -> np.ndarray:
        """Return the frames of ``outputs.nodes``, shape (n_nodes, 3, n_samples)."""


def start_of(scene: Scene, kinematics: RigidKinematics) -> tuple[float, float]:
    """Return position (rad) and velocity (rad/s) at the start."""
    state = scene.initial_state(kinematics.coordinate.name)
    return state.position, state.velocity
