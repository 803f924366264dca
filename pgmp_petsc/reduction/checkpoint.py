"""Finished work on a scene and its meshes, in a folder beside the result, for a run that is resumed.

Of a build, condensed bodies and configurations. The first rank of a group writes what its group has finished, so that
nobody waits for another; all ranks read what is there, whatever the number of ranks that wrote it. Configurations are
kept in batches, at most one every `INTERVAL`, so that quick builds do not spend their time with files.

Of an experiment, results of its tasks. Every rank writes what it has finished; a task is known by its description.
"""

from __future__ import annotations

import hashlib
import io
import time
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar, Self

import h5py
import numpy as np

from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.files.checkpoint_folder import SharedCheckpoint
from pgmp_petsc.files.seal import identity
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.rom_file import BodyFile
from pgmp_petsc.reduction.sampler import Sample
from pgmp_petsc.scene import Scene, scene_to_toml

INTERVAL = 10.0  # s
LOCAL = ("shape", "mass_kept", "built_in")  # arrays of a sample of which every rank of a group has its own rows
Arrays = dict[str, np.ndarray]


class SceneCheckpoint(SharedCheckpoint):
    """A checkpoint that is known by what `kind` says, a scene and its meshes; one of others is refused."""

    format: ClassVar[int]
    readers: ClassVar[Mapping[str, Callable[[str, Mapping[str, np.ndarray]], dict[Any, Any]]]]  # of `SharedCheckpoint`

    def __init__(
        self, output: Path, kind: Mapping[str, object], scene: Scene, meshes: Mapping[str, BodyShape], comm: Comm,
        resume: bool,
    ) -> None:  # fmt: skip
        known = {"scene": identity(scene_to_toml(scene)), "meshes": identity(meshes)}
        super().__init__(output, {"format": self.format, **kind, **known}, comm, resume, self.readers)


def _samples_of(name: str, arrays: Mapping[str, np.ndarray]) -> dict[tuple[str, bytes], dict[str, np.ndarray]]:
    """Return finished samples by what tells their scene, and the bytes of their configuration."""
    joined = dict(arrays)
    scene = str(joined.pop("scene"))
    if joined.keys() != (wanted := {item.name for item in fields(Sample)} | {"theta"}):
        raise ValueError(f"samples have the arrays {', '.join(sorted(joined))}, not {', '.join(sorted(wanted))}")
    if len({len(part) for part in joined.values()}) > 1:
        raise ValueError("its arrays are not of one number of samples")
    configurations = joined.pop("theta")
    found = ({key: part[k] for key, part in joined.items()} for k in range(len(configurations)))
    return {(scene, theta.tobytes()): sample for theta, sample in zip(configurations, found)}


def _component(name: str, arrays: Mapping[str, np.ndarray]) -> dict[tuple[str, str], Component]:
    """Return a condensed body by what tells its scene, and its name."""
    with h5py.File(io.BytesIO(arrays["content"].tobytes()), "r") as file:
        return {(str(arrays["scene"]), str(arrays["body"])): BodyFile.take(file).shape}


class BuildCheckpoint(SceneCheckpoint):
    """The finished part of a build from a scene and meshes; a checkpoint of others is refused.

    Lengths as parameters take a build at each of several, modes that cannot be followed another one with fewer: each
    has its own part (`of`). `components` are bodies that are condensed already, by name.
    """

    format, readers = 11, {"samples-*": _samples_of, "component-*": _component}

    def __init__(
        self, output: Path, scene: Scene, meshes: Mapping[str, BodyShape], group: RankGroup, resume: bool
    ) -> None:
        self._group = group
        super().__init__(output, {}, scene, meshes, group.world, resume)
        self._begin(scene)

    def _begin(self, scene: Scene) -> None:
        self._scene = identity(scene_to_toml(scene))
        self._samples_of, components = self._known
        self.components = {name: one for (own, name), one in components.items() if own == self._scene}
        self._waiting: list[dict[str, np.ndarray]] = []
        self._written = time.monotonic()

    def of(self, scene: Scene) -> Self:
        """Return the part of the build of a scene."""
        part = copy(self)
        part._begin(scene)
        return part

    def add_component(self, name: str, component: Component) -> None:
        """Keep a condensed body; by the first rank of its group."""
        if self._group.comm.rank > 0:
            return
        stream = io.BytesIO()
        with h5py.File(stream, "w") as file:
            BodyFile.unfinished(component).put(file)
        content = np.frombuffer(stream.getvalue(), np.uint8)
        known = {"scene": np.array(self._scene), "body": np.array(name)}
        self._folder.put(f"component-{self._scene}-{name}", {**known, "content": content})

    def sample(self, theta: np.ndarray, problem: ModalProblem) -> Sample | None:
        """Return the finished sample at a configuration (n_theta,), the problem's rows of it, or None."""
        found = self._samples_of.get((self._scene, theta.tobytes()))
        if found is None:
            return None
        rows = slice(problem.rows.start, problem.rows.stop)
        return Sample(**{key: value[rows] if key in LOCAL else value for key, value in found.items()})

    def add_sample(self, theta: np.ndarray, sample: Sample, problem: ModalProblem) -> None:
        """Keep a finished sample. Collective on the problem's ranks."""
        arrays = {item.name: getattr(sample, item.name) for item in fields(Sample)}
        arrays |= {key: problem.all_rows(arrays[key]) for key in LOCAL}
        self._waiting.append({**arrays, "theta": theta})
        if time.monotonic() - self._written > INTERVAL:
            self.flush()

    def flush(self) -> None:
        """Write what is waiting; by the first rank of a group."""
        if self._waiting and self._group.comm.rank == 0:
            # the name is new: a resumed build adds to the files that are there
            stamp = time.time_ns()
            joined = {key: np.array([arrays[key] for arrays in self._waiting]) for key in self._waiting[0]}
            self._folder.put(f"samples-{stamp}-{self._group.index}", {**joined, "scene": np.array(self._scene)})
        self._waiting, self._written = [], time.monotonic()


class Finished(SceneCheckpoint):
    """Results of finished tasks of an experiment: `kind` is what is done with the scene, of the command line; a folder
    of anything else is refused, or of other scenes and meshes."""

    format, readers = 2, {"*": lambda name, arrays: {name: dict(arrays)}}

    def get(self, kind: str, task: object) -> Arrays | None:
        """Return what an earlier run left of a task; None where it left nothing."""
        return self._known[0].get(_name(kind, task))

    def put(self, kind: str, task: object, arrays: Arrays) -> None:
        """Keep the result of a task; by the rank that did it."""
        self._folder.put(_name(kind, task), arrays)


def _name(kind: str, task: object) -> str:
    """Return the name of a task's piece: its description is the key, whatever rank or order it has."""
    return f"{kind}-{hashlib.sha256(repr(task).encode()).hexdigest()[:32]}"
