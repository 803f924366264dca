"""Finished parts of an experiment: results of its tasks in a folder beside its file, for a run that is resumed.

Every rank writes what it has finished; all ranks read what is there when a run is resumed, with any number of them
(`files.checkpoint_folder`). A task is known by its description, so that the order of tasks has no part in it.

Times of a model's runs, predicted from its size alone before anything is run.

Times are processor times of a step of one sample, on a common processor of 2023. They follow from the numbers of
unknowns and from constants that were measured (`python -m benchmarks.prices` measures them again), so that every rank,
and every number of ranks, predicts the same: what is measured in a run is said afterwards, and decides nothing.

=========================== ==========================================================================
body                        grows with
=========================== ==========================================================================
beams                       nodes
cells in the plane, slender unknowns of the mesh
solids, slender             unknowns of the mesh
in a floating frame         pairs of amplitudes, all of which its moments couple
on the tree of joints       frames in space, and the cube of all coordinates and of the constraints that
                            the tree leaves, whose matrix is full
=========================== ==========================================================================

Local effects come on top. Of the scenes of this project predictions were within a factor of two or three, but for
mechanisms of few unknowns that hit a stop, which cost five times as much.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.files.checkpoint_folder import SharedCheckpoint
from pgmp_petsc.files.seal import identity
from pgmp_petsc.full.joint_tree import count_of
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.numerics import count_steps
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.uses import length_names

FORMAT = 2
Arrays = dict[str, np.ndarray]


class Finished(SharedCheckpoint):
    """Results of finished tasks of an experiment: `kind` is what is done with the scene, of the command line; a folder
    of anything else is refused, or of other scenes and meshes."""

    def __init__(
        self,
        output: Path,
        kind: Mapping[str, object],
        scene: Scene,
        meshes: Mapping[str, BodyShape],
        comm: Comm,
        resume: bool,
    ) -> None:
        run = {"format": FORMAT, **kind, "scene": identity(scene_to_toml(scene)), "meshes": identity(meshes)}
        super().__init__(output, run, comm, resume, {"*": lambda name, arrays: {name: dict(arrays)}})

    def get(self, kind: str, task: object) -> Arrays | None:
        """Return what an earlier run left of a task; None where it left nothing."""
        return self._known[0].get(_name(kind, task))

    def put(self, kind: str, task: object, arrays: Arrays) -> None:
        """Keep the result of a task; by the rank that did it."""
        self._folder.put(_name(kind, task), arrays)


def _name(kind: str, task: object) -> str:
    """Return the name of a task's piece: its description is the key, whatever rank or order it has."""
    return f"{kind}-{hashlib.sha256(repr(task).encode()).hexdigest()[:32]}"


LOCAL_EFFECT = 1.5e-6  # s, of a step of a sample, Newton corrections included
# s, of a step of a sample of a component model: a pair of a body's amplitudes, a body in space, and of the matrix
PAIR, BODY, CUBE = 1.1e-8, 1.2e-6, 3.3e-11
# s, of a step of a full-order or component sample: a controller, or friction by the force that a joint carries, which
# are found between corrections; and where lengths are drawn, which part samples: how often what it takes in a batch
BESIDE, APART = 8e-4, 4.0
SETTING_UP = {2: 0.04, 3: 0.4}  # s, of a sample of lengths of its own, by the dimension of space


@dataclass(frozen=True)
class Price:
    """Predicted time of some runs."""

    step: float  # processor time of a step of a sample, s
    steps: float  # steps of all samples together

    @property
    def seconds(self) -> float:
        """Processor time of all, s."""
        return self.step * self.steps

    def __str__(self) -> str:
        return duration_text(self.seconds)


def step_seconds(mechanism: Mechanism) -> float:
    """Return the predicted processor time of a step of one sample of a full-order or component model, s."""
    beside = BESIDE * len(mechanism.scene.beside)
    floating = {body.name: body.n_internal for body in mechanism.bodies if body.blocks("floating")}
    if floating:
        return beside + component_step(mechanism, floating)
    return beside + _local(mechanism) + sum(body.step_seconds for body in mechanism.bodies)


def step_of_samples(scene: Scene, step: float) -> float:
    """Return what a step takes in an ensemble of full-order or component samples, s, that takes `step` in a batch: with
    lengths that are drawn each sample is set up by itself, and taken by itself."""
    if not {*uncertain_names(scene)} & {*length_names(scene)}:
        return step
    n_steps = count_steps(scene.simulation.duration, scene.simulation.step)
    return (1.0 if scene.beside else APART) * step + SETTING_UP[scene.dimension] / n_steps


def component_step(mechanism: Mechanism, fields: Mapping[str, int]) -> float:
    """Return the predicted processor time of a step of a sample of a component model, s, with so many amplitudes a
    body, and without what is found between corrections."""
    pairs, n = sum(m**2 for m in fields.values()), sum(count_of(mechanism)) + sum(fields.values())
    in_space = len(mechanism.bodies) * (mechanism.space.dimension == 3)
    return _local(mechanism) + PAIR * pairs + BODY * in_space + CUBE * n**3


def _local(mechanism: Mechanism) -> float:
    return LOCAL_EFFECT * sum(effect.local for effect in mechanism.scene.effects.values())


def duration_text(seconds: float) -> str:
    """Return a time in words: ``40 s``, ``12 min``, ``3.1 h``."""
    for unit, size in (("s", 60.0), ("min", 60.0), ("h", 48.0)):
        if seconds < 2.0 * size:
            return f"{seconds:.2g} {unit}"
        seconds /= size if unit != "h" else 24.0
    return f"{seconds:.2g} days"
