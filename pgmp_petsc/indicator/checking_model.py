"""The model in which reduced runs are checked: all unknowns that are left once continuum bodies are condensed.

Bodies of beams are on their meshes. Condensed bodies are in floating frames (`bodies.floating`): exact in the rotation
and in all that is quadratic in velocities, with every amplitude that they are condensed to. Equations, local effects
and drives are those of full-order and component runs, and so are the unknowns.

A reduced state gives these unknowns by (4) of Naets et al. 2015. Of a condensed body with unknowns y in the frame of
its rigid pose, the small motion that is a rigid one moves the floating frame, and the rest are its amplitudes,

    y = [rigid motions, modes] (s, xi).

Where these are not quite the place and the amplitudes that belong to the body's frames, by terms of second order in the
deformation, ties hold between both, and the error that is solved for has the difference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pgmp_petsc.bodies.shape import in_floating_frame
from pgmp_petsc.dynamics.full_systems import FullBatch
from pgmp_petsc.effects import effects_of, motions_of
from pgmp_petsc.indicator.sampled_load import SampledMotion, sampled_effects
from pgmp_petsc.indicator.schedule import Schedule
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ComponentModel, ReducedModel
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel


class CheckingModel:
    """What a reduced model is checked against.

    Parameters
    ----------
    model
        The reduced model.

    Attributes
    ----------
    full
        Its equations.
    rotations
        Largest rotation of a frame in its body per unit of each flexible coordinate, shape (n_delta,), rad.
    """

    def __init__(self, model: ReducedModel) -> None:
        scene, shapes = model.scene, {name: in_floating_frame(shape) for name, shape in model.meshes.items()}
        self.full = ComponentModel(scene, shapes, model.kinematics)
        mechanism = self.full.kinematics.mechanism
        self._effects, self._motions = effects_of(scene, mechanism), motions_of(scene, mechanism)
        rom = model.rom
        if any(body.n_amplitudes for body in mechanism.bodies):
            rom = _in_floating_frames(rom, model.kinematics.mechanism, mechanism)
        self.rotations = _rotations(rom.projection, mechanism)
        scheme, nodes = scene.reduction.interpolation, range(mechanism.n_nodes)
        self._reconstruction = Reconstruction(self.full.kinematics, rom, scheme, nodes, internal=True)

    def unknowns_of(self, eta: np.ndarray) -> np.ndarray:
        """Return the unknowns, shape (n_dofs, n), for reduced coordinates (n, n_eta)."""
        return self._reconstruction.unknowns(eta)

    def batch(self, values: Mapping[str, np.ndarray], n: int) -> FullBatch:
        """Return n samples."""
        start = self.full.start_of_samples(values, n)
        return FullBatch(self.full.kinematics, self._effects, values, start, n, self._motions)

    def scheduled(self, batch: FullBatch, schedule: Schedule, step: float) -> FullBatch:
        """Return a batch under what acts at the instants of a schedule of a run with a step (s)."""
        instants = schedule.steps, step, schedule.interval
        effects = sampled_effects(self._effects, *instants)
        motions = {number: SampledMotion(motion, *instants) for number, motion in self._motions.items()}
        return batch.under(effects, motions)

    def equilibria(self, values: Mapping[str, np.ndarray], samples: np.ndarray) -> np.ndarray | None:
        """Return the static equilibria that samples start from, NaN where there is none or it is not asked for.

        Parameters
        ----------
        values
            Parameter values, each of shape (n,).
        samples
            Mask of the samples that are asked for, shape (n,).

        Returns
        -------
        ndarray or None
            Shape (n_dofs, n); None where runs start undeformed.
        """
        if not self.full.scene.initial.equilibrium:
            return None
        chosen, n = {name: value[samples] for name, value in values.items()}, int(samples.sum())
        if not n:
            return np.full((1, samples.size), np.nan)
        settled = self.full.settled(chosen, n)
        found = np.full((len(settled.unknowns), samples.size), np.nan)
        found[:, samples] = np.where(settled.lost, np.nan, settled.unknowns)
        return found


def _rotations(projection: np.ndarray, mechanism: Mechanism) -> np.ndarray:
    """Return the largest rotations of frames in flexible vectors (n_samples, n_dofs, n_delta), shape (n_delta,)."""
    space, n_samples = mechanism.space, len(projection)
    nodal = projection[:, : space.n_dofs * mechanism.n_nodes].reshape(n_samples, mechanism.n_nodes, space.n_dofs, -1)
    return np.abs(nodal[:, :, space.dimension :]).max(axis=(0, 1, 2))


def _in_floating_frames(rom: ReducedOrderModel, reduced: Mechanism, full: Mechanism) -> ReducedOrderModel:
    """Return a reduced model with its flexible vectors in the unknowns of a mechanism whose condensed bodies have
    floating frames."""

    def moved(vectors: np.ndarray) -> np.ndarray:
        found = np.zeros((len(vectors), full.n_dofs, vectors.shape[2]))
        for body, other in zip(reduced.bodies, full.bodies):
            found[:, other.dofs] = other.in_frame(vectors[:, body.dofs], body.node_dofs * body.n_nodes)
        return found

    curvature = None if rom.curvature is None else moved(rom.curvature)
    return replace(rom, projection=moved(rom.projection), curvature=curvature)
