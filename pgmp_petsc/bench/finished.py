"""Finished parts of an experiment: results of its tasks in a folder beside its file, for a run that is resumed.

Every rank writes what it has finished; all ranks read what is there when a run is resumed, with any number of them
(`files.checkpoint_folder`). A task is known by its description, so that the order of tasks has no part in it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.files.checkpoint_folder import SharedCheckpoint
from pgmp_petsc.files.seal import identity
from pgmp_petsc.scene import Scene, scene_to_toml

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
