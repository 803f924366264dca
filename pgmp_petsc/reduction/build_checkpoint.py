"""The checkpoint of a build: condensed bodies and finished configurations in a folder beside the result.

The first rank of a group writes what its group has finished, so that nobody waits for another; all ranks read what is
there when a build is resumed, whatever the number of ranks that wrote it. Configurations are kept in batches, at most
one every `INTERVAL`, so that quick builds do not spend their time with files.
"""

from __future__ import annotations

import io
import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np

from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.rom_file import BodyFile
from pgmp_petsc.reduction.sampler import Sample
from pgmp_petsc.runtime.checkpoint_folder import SharedCheckpoint
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.seal import identity
from pgmp_petsc.scene import Scene, scene_to_toml

FORMAT = 7
INTERVAL = 10.0  # s
LOCAL = ("shape", "mass_kept")  # arrays of a sample of which every rank of a group has its own rows


class BuildCheckpoint(SharedCheckpoint):
    """The finished part of a build from a scene and meshes; a checkpoint of others is refused.

    `components` are bodies that are condensed already, by name.
    """

    def __init__(
        self, output: Path, scene: Scene, meshes: Mapping[str, BodyShape], group: RankGroup, resume: bool
    ) -> None:
        self._group = group
        run = {"format": FORMAT, "scene": identity(scene_to_toml(scene)), "meshes": identity(meshes)}
        super().__init__(output, run, group.world, resume, {"samples-*": _samples, "component-*": _component})
        self._samples, self.components = self._known
        self._waiting: list[dict[str, np.ndarray]] = []
        self._written = time.monotonic()

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
        found = self._samples.get(theta.tobytes())
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


def _samples(name: str, arrays: Mapping[str, np.ndarray]) -> dict[bytes, dict[str, np.ndarray]]:
    """Return finished samples by the bytes of their configuration."""
    joined = dict(arrays)
    if joined.keys() != (wanted := {item.name for item in fields(Sample)} | {"theta"}):
        raise ValueError(f"samples have the arrays {', '.join(sorted(joined))}, not {', '.join(sorted(wanted))}")
    if len({len(part) for part in joined.values()}) > 1:
        raise ValueError("its arrays are not of one number of samples")
    configurations = joined.pop("theta")
    return {theta.tobytes(): {key: part[k] for key, part in joined.items()} for k, theta in enumerate(configurations)}


def _component(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, Component]:
    """Return a condensed body by its name."""
    with h5py.File(io.BytesIO(arrays["content"].tobytes()), "r") as file:
        return {str(arrays["body"]): BodyFile.take(file).shape}
