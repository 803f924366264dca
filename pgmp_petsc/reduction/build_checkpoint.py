"""The checkpoint of a build: condensed bodies and finished configurations in a folder beside the result.

The first rank of a group writes what its group has finished, so that nobody waits for another; all ranks read what is
there when a build is resumed, whatever the number of ranks that wrote it. Configurations are kept in batches, at most
one every `INTERVAL`, so that quick builds do not spend their time with files.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.sampler import Sample
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.checkpoint_folder import CheckpointFolder
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene, scene_to_toml

FORMAT = 2
INTERVAL = 10.0  # s
LOCAL = ("shape", "mass_kept")  # arrays of a sample of which every rank of a group has its own rows


class BuildCheckpoint:
    """What of a build is finished. Collective on ``group.world`` where it is made.

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

    Raises
    ------
    InputError
        If what is there belongs to another build.
    """

    def __init__(
        self, output: Path, scene: Scene, meshes: Mapping[str, BodyShape], group: RankGroup, resume: bool
    ) -> None:
        self._group = group
        run = {"format": FORMAT, "scene": _digest(scene_to_toml(scene).encode()), "meshes": _digest_of(meshes)}
        self._folder = CheckpointFolder(output, run)
        taken_up = on_root(group.world, self._folder.open, resume)
        self._taken_up = taken_up
        self._known = self._read_samples() if taken_up else {}
        self._components = self._read_components() if taken_up else {}
        self._waiting: dict[str, np.ndarray] = {}
        self._written, self._n_files = time.monotonic(), 0

    @property
    def components(self) -> dict[str, Component]:
        """Bodies that are condensed already."""
        return self._components

    def add_component(self, name: str, component: Component) -> None:
        """Keep a condensed body; by the first rank of its group."""
        if self._group.comm.rank > 0:
            return
        arrays = {key: getattr(component, key) for key in ("centres", "fields", "probes")}
        arrays |= {"frames": np.array(list(component.frames)), "numbers": np.array(list(component.frames.values()))}
        arrays |= {"n_mesh_dofs": np.array(component.n_mesh_dofs), "error": np.array(component.error)}
        if component.rigid:
            arrays["centre_of_mass"] = component.centre_of_mass
        for kind in ("mass", "stiffness"):
            terms = getattr(component, kind)
            arrays |= {kind: np.array(list(terms.values())), f"{kind}_weights": np.array([str(w) for w in terms])}
        self._folder.put(f"component-{name}", arrays)

    def sample(self, theta: np.ndarray, problem: ModalProblem) -> Sample | None:
        """Return the finished sample at a configuration (n_theta,), the problem's rows of it, or None."""
        found = self._known.get(theta.tobytes())
        if found is None:
            return None
        rows = slice(problem.rows.start, problem.rows.stop)
        return Sample(**{key: value[rows] if key in LOCAL else value for key, value in found.items()})

    def add_sample(self, theta: np.ndarray, sample: Sample, problem: ModalProblem) -> None:
        """Keep a finished sample. Collective on the problem's ranks."""
        number = len(self._waiting)
        arrays = {item.name: getattr(sample, item.name) for item in fields(Sample)}
        arrays |= {key: problem.all_rows(arrays[key]) for key in LOCAL}
        self._waiting |= {f"{number}.{key}": value for key, value in arrays.items()}
        self._waiting[f"{number}.theta"] = theta
        if time.monotonic() - self._written > INTERVAL:
            self.flush()

    def flush(self) -> None:
        """Write what is waiting; by the first rank of a group."""
        if self._waiting and self._group.comm.rank == 0:
            # the name is new: a resumed build adds to the files that are there
            stamp = time.time_ns()
            self._folder.put(f"samples-{stamp}-{self._group.index}", self._waiting)
        self._waiting, self._written = {}, time.monotonic()

    def forget(self) -> None:
        """Remove the folder after bad input, unless another run left something in it. Collective on all ranks."""
        if not self._taken_up:
            on_root(self._group.world, self._folder.remove)

    def remove(self) -> None:
        """Remove the folder once the result is written. Collective on all ranks."""
        on_root(self._group.world, self._folder.remove)

    def _read_samples(self) -> dict[bytes, dict[str, np.ndarray]]:
        found: dict[bytes, dict[str, np.ndarray]] = {}
        for path in self._folder.pieces("samples-*"):
            with np.load(path, allow_pickle=False) as data:
                parts: dict[str, dict[str, np.ndarray]] = {}
                for key in data.files:
                    number, _, name = key.partition(".")
                    parts.setdefault(number, {})[name] = data[key]
            for part in parts.values():
                found[part.pop("theta").tobytes()] = part
        return found

    def _read_components(self) -> dict[str, Component]:
        found = {}
        for path in self._folder.pieces("component-*"):
            with np.load(path, allow_pickle=False) as data:
                terms = {
                    kind: {Monomial.parse(str(w)): matrix for w, matrix in zip(data[f"{kind}_weights"], data[kind])}
                    for kind in ("mass", "stiffness")
                }
                found[path.stem.partition("-")[2]] = Component(
                    frames={str(name): int(number) for name, number in zip(data["frames"], data["numbers"])},
                    centres=data["centres"],
                    fields=data["fields"],
                    probes=data["probes"],
                    n_mesh_dofs=int(data["n_mesh_dofs"]),
                    error=float(data["error"]),
                    centre_of_mass=data["centre_of_mass"] if "centre_of_mass" in data else None,
                    **terms,
                )
        return found


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _digest_of(meshes: Mapping[str, BodyShape]) -> str:
    digest = hashlib.sha256()
    for name, mesh in meshes.items():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(mesh.nodes).tobytes())
        digest.update(np.ascontiguousarray(mesh.cells).tobytes())
        named = mesh.groups if isinstance(mesh, SolidMesh) else mesh.points
        digest.update(repr([(key, np.asarray(value).tolist()) for key, value in named.items()]).encode())
    return digest.hexdigest()
