"""The reduced model of a scene, from its ROM file."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Self

import numpy as np

from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.reduced_system import ReducedSystem
from pgmp_petsc.dynamics.reduced_terms import ReducedTerms
from pgmp_petsc.effects import effects_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models.model import start_of
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene


class ReducedModel:
    """Rigid coordinate and flexible modes over interpolated tables; see `Model`.

    Parameters
    ----------
    scene, rom
        The scene, which may differ from the reduced model's in what its tables do not depend on.
    kinematics
        The mechanism's, where it is at hand; made from the scene otherwise.

    Raises
    ------
    InputError
        If the start lies outside the sampled range.
    """

    name = "reduced"

    def __init__(self, scene: Scene, rom: ReducedOrderModel, kinematics: RigidKinematics | None = None) -> None:
        self.scene = scene
        self.meshes = rom.meshes
        self.kinematics = kinematics or RigidKinematics(Mechanism.from_scene(scene, rom.meshes))
        mechanism = self.kinematics.mechanism
        self.outputs = OutputSet.of(scene, self.kinematics)
        self.terms = ReducedTerms.of(rom.tables, self.kinematics, rom.projection, scene.reduction.interpolation)
        self._effects = effects_of(scene, mechanism)
        self._start = start_of(scene, self.kinematics.mechanism)
        samples, scheme = rom.tables.samples, scene.reduction.interpolation
        if not samples.contains(self._start[0]):
            name = self.kinematics.coordinate.name
            raise InputError(
                f"simulation.initial.{name}.position = {self._start[0]:g}: outside the sampled range "
                f"[{samples.lower:g}, {samples.upper:g}] rad"
            )
        self._of_outputs = Reconstruction(self.kinematics, rom, scheme, self.outputs.nodes)
        self._of_all = Reconstruction(self.kinematics, rom, scheme, range(mechanism.n_nodes))

    def with_loads(self, scene: Scene) -> Self:
        """Return the model under the loads of a scene that differs in tables of torques and the simulation alone."""
        other = copy(self)
        other.scene, other._effects = scene, effects_of(scene, self.kinematics.mechanism)
        return other

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> ReducedSystem:
        """Return a batch of samples on this rank."""
        return ReducedSystem(self.terms, self._effects, values, self._start, n_samples)

    def output_frames(self, system: ReducedSystem, state: State) -> np.ndarray:
        """Return the frames of ``outputs.nodes``, shape (n_nodes, 3, n_samples)."""
        return self._of_outputs.frames(state.q)

    def frames_of(self, eta: np.ndarray) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, 3, n), for reduced coordinates (n, n_eta)."""
        return self._of_all.frames(eta)

    def output_frames_of(self, eta: np.ndarray) -> np.ndarray:
        """Return the frames of ``outputs.nodes`` for reduced coordinates of shape (n, n_eta)."""
        return self._of_outputs.frames(eta)
