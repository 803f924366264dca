"""The checkpoint of an ensemble: its finished batches in a folder beside the result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pgmp_petsc.ensemble.batch import Batch, Plan
from pgmp_petsc.runtime.checkpoint_folder import CheckpointFolder
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.identity import identity
from pgmp_petsc.runtime.remarks import Remark
from pgmp_petsc.runtime.seal import BrokenSeal

FORMAT = 4
# of a batch: arrays by name
NAMED = ("parameters", "outputs", "numerics", "errors", "errors_at_end", "validity", "balance")


class Checkpoint:
    """Finished batches of one ensemble; used by rank 0.

    Parameters
    ----------
    plan
        The ensemble.
    scene_toml
        The resolved scene: a checkpoint of another one is refused.
    model
        ``full`` or ``reduced``.
    tables
        Identity of what the model is made of besides the scene (see `Model`): two reduced models of the same scene may
        differ, and so may meshes of the same name.
    size
        Samples of a batch.

    Attributes
    ----------
    remarks
        What was found and not taken up.
    """

    def __init__(self, plan: Plan, scene_toml: str, model: str, tables: str, size: int) -> None:
        self._plan, self._size = plan, size
        run = {
            "format": FORMAT,
            "model": model,
            "samples": plan.n_samples,
            "seed": plan.seed,
            "batch": size,
            "scene": identity(scene_toml),
            "reduced model" if model == "reduced" else "meshes": tables,
        }
        self._folder = CheckpointFolder(plan.output, run)
        self.remarks: tuple[Remark, ...] = ()

    @property
    def folder(self) -> Path:
        """Where the batches are."""
        return self._folder.path

    def open(self) -> set[int]:
        """Start anew, or take up what is there if the plan says so; return the first samples of finished batches.

        A batch that is damaged, of another run or in no place of this one is set aside, with a remark.

        Raises
        ------
        InputError
            If what is there belongs to another run.
        """
        started = self._folder.open(self._plan.resume)
        taken, broken = self._folder.sound(self._read)
        self.remarks = started + broken
        return {int(path.stem) for path in taken}

    def add(self, batch: Batch) -> None:
        """Store a finished batch."""
        arrays = {f"{kind}.{name}": values for kind in NAMED for name, values in getattr(batch, kind).items()}
        self._folder.put(f"{batch.first:09d}", {"status": batch.status, "failure_time": batch.failure_time, **arrays})

    def batches(self) -> list[Batch]:
        """Return all batches in the order of their samples, which are those of the plan, each once.

        Raises
        ------
        RunError
            If samples are missing, there twice, or damaged.
        """
        cure = "nothing was written; repeat the command with --resume, which computes what is missing"
        try:
            found = [self._read(path) for path in self._folder.pieces()]
        except BrokenSeal as broken:
            what = f"a finished piece in '{self.folder}' was damaged during the run: {broken}"
            raise RunError(f"{what}; {cure}") from broken
        place = 0
        for batch in found:
            if batch.first != place:
                missing = f"samples {place} to {batch.first - 1} are missing"
                what = missing if batch.first > place else "samples are there twice"
                raise RunError(f"in '{self.folder}' {what}; {cure}")
            place += len(batch.status)
        if place != self._plan.n_samples:
            raise RunError(f"'{self.folder}' holds {place} of {self._plan.n_samples} samples; {cure}")
        return found

    def _read(self, path: Path) -> Batch:
        """Return the batch of a piece; raises `BrokenSeal` unless it is one of this run."""
        batch = self._folder.take(path, lambda arrays: _batch(int(path.stem), arrays))
        expected = min(self._size, self._plan.n_samples - batch.first)
        if batch.first % self._size or len(batch.status) != expected:
            last = batch.first + len(batch.status) - 1
            raise BrokenSeal(f"it holds samples {batch.first} to {last}, which are no batch of this run")
        return batch


def remove_checkpoint(plan: Plan) -> None:
    """Remove what a plan's ensemble has kept; the result holds all of it."""
    CheckpointFolder(plan.output, {}).remove()


def _batch(first: int, arrays: Mapping[str, np.ndarray]) -> Batch:
    named: dict[str, dict[str, np.ndarray]] = {kind: {} for kind in NAMED}
    for key in arrays:
        kind, _, name = key.partition(".")
        if name:
            named[kind][name] = arrays[key]
    return Batch(first, status=arrays["status"], failure_time=arrays["failure_time"], **named)
