"""Interface of a model for simulations and ensembles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.effects import motions_of
from pgmp_petsc.mechanism.closure import size_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.uses import length_names, velocity_names
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State
from pgmp_petsc.stepping.static_equilibrium import Search

AT_REST = 1e-12  # rad over a run: less is round-off of sines
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
    identity: str  # checksum of what the model is made of besides the scene's text: meshes, or a reduced model's tables

    def batch(self, values: Mapping[str, np.ndarray], n_samples: int) -> SecondOrderSystem:
        """Return a system of n_samples samples on this rank; values have shape (n_samples,)."""

    def observed(self, system: SecondOrderSystem, state: State) -> np.ndarray:
        """Return what ``outputs.evaluate`` takes, shape (n_observed, n_samples)."""


def floors_of(model: Model) -> np.ndarray:
    """Return below which every output is taken for zero, in its unit, shape (n_outputs,)."""
    sizes = {stress.name: stress.size for stress in model.outputs.stresses}
    units = model.outputs.units.items()
    return np.array(
        [ROUND_OFF * sizes.get(name, 1.0 if unit == "rad" else model.kinematics.size) for name, unit in units]
    )


def require_lengths(scene: Scene, values: Mapping[str, np.ndarray | float]) -> None:
    """Raise `ValueError` where lengths are not those of the scene's run, which a model's mechanism is made with."""
    for name in length_names(scene):
        if name in values and np.any(values[name] != scene.values[name]):
            raise ValueError(f"{name} = {values[name]}: the model is that of {scene.values[name]}; see models.lengths")


def start_of(scene: Scene, mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (rad) and velocities (rad/s) of the coordinates at the start, each of shape (n_theta,).

    Raises `InputError` if the run is to start at rest, and a prescribed motion does not.
    """
    motions = motions_of(scene, mechanism)
    start = []
    for number, coordinate in enumerate(mechanism.coordinates):
        if number in motions:
            start.append(motions[number].at(0.0)[:2])
        else:
            state = scene.initial_state(coordinate.name)
            start.append((state.position, scene.number(state.velocity)))
    positions, velocities = np.array(start).T
    for number, motion in motions.items():
        if scene.initial.equilibrium and abs(velocities[number]) * scene.simulation.duration > AT_REST:
            raise InputError(
                f"effects.{motion.name}: it moves {motion.coordinate} at {velocities[number]:.6g} "
                f"{mechanism.coordinates[number].unit}/s at time zero, "
                "but with initial.equilibrium = true the run starts at rest; take a motion that begins at rest "
                "(spin_up, a table, or a harmonic with phase = 1.5707963267948966), or leave initial.equilibrium out"
            )
    return positions, velocities


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
