"""The checkpoint of a build: condensed bodies and finished configurations in a folder beside the result.

The first rank of a group writes what its group has finished, so that nobody waits for another; all ranks read what is
there when a build is resumed, whatever the number of ranks that wrote it. Configurations are kept in batches, at most
one every `INTERVAL`, so that quick builds do not spend their time with files.
"""

from __future__ import annotations

import io
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TypeVar

import h5py
import numpy as np

from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.rom_file import BodyFile
from pgmp_petsc.reduction.sampler import Sample
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.checkpoint_folder import CheckpointFolder
from pgmp_petsc.runtime.errors import Remark, RunError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.seal import BrokenSeal, identity
from pgmp_petsc.scene import Scene, scene_to_toml

FORMAT = 7
INTERVAL = 10.0  # s
Key, Content = TypeVar("Key"), TypeVar("Content")
LOCAL = ("shape", "mass_kept")  # arrays of a sample of which every rank of a group has its own rows


class BuildCheckpoint:
    """The finished part of a build. Collective on ``group.world`` where it is made.

    Parameters
    ----------
    output
        The file to be built.
    scene, meshes
        What it is built from; a checkpoint of others is refused.
    group
        Groups of ranks of this run.
    resume
        Whether to take up what is there.

    Attributes
    ----------
    remarks
        What was found and not taken up.

    Raises
    ------
    InputError
        If what is there belongs to another build.
    RunError
        If a rank cannot read what the first one can.
    """

    def __init__(
        self, output: Path, scene: Scene, meshes: Mapping[str, BodyShape], group: RankGroup, resume: bool
    ) -> None:
        self._group = group
        run = {"format": FORMAT, "scene": identity(scene_to_toml(scene)), "meshes": identity(meshes)}
        # ranks may work in different directories
        self._folder = CheckpointFolder(on_root(group.world, _full_path, output), run)
        # One rank says what is sound: another that reads for itself might see other files.
        samples, components, self.remarks = on_root(group.world, self._open, resume)
        self._taken_up = bool(samples or components)
        with agreed(group.world, "reading the checkpoint"):
            self._known = self._all(samples, _samples)
            self._components = self._all(components, _component)
        self._waiting: list[dict[str, np.ndarray]] = []
        self._written, self._n_files = time.monotonic(), 0

    @property
    def components(self) -> dict[str, Component]:
        """Bodies that are condensed already."""
        return self._components

    def add_component(self, name: str, component: Component) -> None:
        """Keep a condensed body; by the first rank of its group."""
        if self._group.comm.rank > 0:
            return
        stream = io.BytesIO()
        with h5py.File(stream, "w") as file:
            BodyFile.unfinished(component).put(file)
        content = np.frombuffer(stream.getvalue(), np.uint8)
        self._folder.put(f"component-{name}", {"body": np.array(name), "content": content})

    def sample(self, theta: np.ndarray, problem: ModalProblem) -> Sample | None:
        """Return the finished sample at a configuration (n_theta,), the problem's rows of it, or None."""
        found = self._known.get(theta.tobytes())
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
            self._folder.put(f"samples-{stamp}-{self._group.index}", joined)
        self._waiting, self._written = [], time.monotonic()

    def forget(self) -> None:
        """Remove the folder after bad input, unless another run left something in it. Collective on all ranks."""
        if not self._taken_up:
            on_root(self._group.world, self._folder.remove)

    def remove(self) -> None:
        """Remove the folder once the result is written. Collective on all ranks."""
        on_root(self._group.world, self._folder.remove)

    def _open(self, resume: bool) -> tuple[list[Path], list[Path], tuple[Remark, ...]]:
        """Open the folder; return the sound pieces of both kinds, and what was not taken up."""
        started = self._folder.open(resume)
        samples, broken = self._folder.sound(lambda path: self._folder.take(path, _samples), "samples-*")
        components, broken_too = self._folder.sound(lambda path: self._folder.take(path, _component), "component-*")
        return samples, components, started + broken + broken_too

    def _all(
        self, paths: list[Path], read: Callable[[Mapping[str, np.ndarray]], dict[Key, Content]]
    ) -> dict[Key, Content]:
        """Return what is in all the pieces."""
        found: dict[Key, Content] = {}
        for path in paths:
            try:
                found |= self._folder.take(path, read)
            except BrokenSeal as broken:
                raise RunError(f"piece '{path}' cannot be read on every rank: {broken}") from broken
        return found


def _full_path(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _samples(arrays: Mapping[str, np.ndarray]) -> dict[bytes, dict[str, np.ndarray]]:
    """Return finished samples by the bytes of their configuration."""
    joined = dict(arrays)
    if joined.keys() != (wanted := {item.name for item in fields(Sample)} | {"theta"}):
        raise ValueError(f"samples have the arrays {', '.join(sorted(joined))}, not {', '.join(sorted(wanted))}")
    if len({len(part) for part in joined.values()}) > 1:
        raise ValueError("its arrays are not of one number of samples")
    configurations = joined.pop("theta")
    return {theta.tobytes(): {key: part[k] for key, part in joined.items()} for k, theta in enumerate(configurations)}


def _component(arrays: Mapping[str, np.ndarray]) -> dict[str, Component]:
    """Return a condensed body by its name."""
    with h5py.File(io.BytesIO(arrays["content"].tobytes()), "r") as file:
        return {str(arrays["body"]): BodyFile.take(file).shape}
