"""The checkpoint of an ensemble: its finished batches in a folder beside the result."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from pgmp_petsc.ensemble.batch import Batch, Plan
from pgmp_petsc.runtime.checkpoint_folder import CheckpointFolder

FORMAT = 2
NAMED = ("parameters", "outputs", "numerics", "errors", "errors_at_end", "validity")  # of a batch: arrays by name


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
    """

    def __init__(self, plan: Plan, scene_toml: str, model: str) -> None:
        self._resume = plan.resume
        run = {
            "format": FORMAT,
            "model": model,
            "samples": plan.n_samples,
            "seed": plan.seed,
            "scene": hashlib.sha256(scene_toml.encode()).hexdigest(),
        }
        self._folder = CheckpointFolder(plan.output, run)

    @property
    def folder(self) -> Path:
        """Where the batches are."""
        return self._folder.path

    def open(self) -> set[int]:
        """Start anew, or take up what is there if the plan says so; return the first samples of finished batches.

        Raises
        ------
        InputError
            If what is there belongs to another run.
        """
        taken_up = self._folder.open(self._resume)
        return {int(path.stem) for path in self._folder.pieces()} if taken_up else set()

    def add(self, batch: Batch) -> None:
        """Store a finished batch."""
        arrays = {f"{kind}.{name}": values for kind in NAMED for name, values in getattr(batch, kind).items()}
        self._folder.put(
            f"{batch.first:09d}", {"status": batch.status, "failure_time": batch.failure_time, **arrays}
        )

    def batches(self) -> list[Batch]:
        """Return all batches in the order of their samples."""
        return [_load(path) for path in self._folder.pieces()]

    def remove(self) -> None:
        """Remove the folder; the result holds all of it."""
        self._folder.remove()


def _load(path: Path) -> Batch:
    with np.load(path, allow_pickle=False) as data:
        named: dict[str, dict[str, np.ndarray]] = {kind: {} for kind in NAMED}
        for key in data.files:
            kind, _, name = key.partition(".")
            if name:
                named[kind][name] = data[key]
        return Batch(int(path.stem), status=data["status"], failure_time=data["failure_time"], **named)
