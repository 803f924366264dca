"""Interface of a model for simulations and ensembles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from pgmp_petsc.mechanism.closure import size_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.reduction.rom import Served
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.uses import length_names, velocity_names
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State
from pgmp_petsc.stepping.static_equilibrium import Search

# an output below this share of the mechanism's size, of 1 rad, or of the stress of a strain of 1, is taken for zero
ROUND_OFF = 1e-10


class Model(Protocol):
    """A model of a scene."""

    #: name, title: ``full``, ``components`` or ``reduced``; what messages call it
    name: str
    title: str
    #: scene, kinematics, outputs: the scene, its rigid kinematics and its outputs
    scene: Scene
    kinematics: RigidKinematics
    outputs: OutputSet
    largest_batch: int  # most samples that a batch has
    served: Mapping[str, Served]  # ranges of parameters that it was built for; empty where it serves any
    identity: str  # checksum of what the model is made of besides the scene's text: meshes, or a reduced model's tables

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> SecondOrderSystem:
        """Return a system of n_samples samples on this rank; values have shape (n_samples,)."""

    def observed(self, system: SecondOrderSystem, state: State, time: float) -> np.ndarray:
        """Return what ``outputs.evaluate`` takes at a time (s), shape (n_observed, n_samples)."""


def floors_of(model: Model) -> np.ndarray:
    """Return below which every output is taken for zero, in its unit, shape (n_outputs,)."""
    sizes = {stress.name: stress.size for stress in model.outputs.stresses}
    sizes |= dict.fromkeys(model.outputs.counts, np.finfo(float).tiny / ROUND_OFF)  # a damage of any size counts
    units = model.outputs.units.items()
    return np.array(
        [ROUND_OFF * sizes.get(name, 1.0 if unit == "rad" else model.kinematics.size) for name, unit in units]
    )


def require_lengths(scene: Scene, values: Mapping[str, np.ndarray | float]) -> None:
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
    bounds = [(-np.inf, np.inf) if c.periodic else (c.lower, c.upper) for c in coordinates]
    lower, upper = np.array(bounds).T
    return Search(
        tuple(k for k, coordinate in enumerate(coordinates) if free and not coordinate.prescribed),
        coordinates,
        lower,
        upper,
        scene.simulation.duration,
        size_of(mechanism),
    )
