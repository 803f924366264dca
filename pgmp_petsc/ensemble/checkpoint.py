"""The checkpoint of an ensemble: a folder of finished batches beside the result, ``<output>.partial/``.

Every batch is a file of its own, written under another name and renamed, so that a run may be killed at any moment. The
folder says which run it belongs to and is removed once the result is written.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path

import numpy as np

from pgmp_petsc.ensemble.batch import Batch, Plan
from pgmp_petsc.runtime.errors import InputError

FORMAT = 2
NAMED = ("parameters", "outputs", "errors", "errors_at_end", "validity")  # of a batch: arrays by name


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
        self.folder = plan.output.with_name(f"{plan.output.name}.partial")
        self._resume = plan.resume
        self._run = {
            "format": FORMAT,
            "model": model,
            "samples": plan.n_samples,
            "seed": plan.seed,
            "scene": hashlib.sha256(scene_toml.encode()).hexdigest(),
        }

    def open(self) -> set[int]:
        """Start anew, or take up what is there if the plan says so; return the first samples of finished batches.

        Raises
        ------
        InputError
            If what is there belongs to another run.
        """
        label = self.folder / "run.json"
        if self._resume and label.exists():
            self._check(_read_label(label))
            return {int(path.stem) for path in self.folder.glob("*.npz")}
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        waiting = label.with_suffix(".writing")
        waiting.write_text(json.dumps(self._run))
        os.replace(waiting, label)
        return set()

    def add(self, batch: Batch) -> None:
        """Store a finished batch."""
        target = self.folder / f"{batch.first:09d}.npz"
        waiting = target.with_suffix(".writing")
        arrays = {f"{kind}.{name}": values for kind in NAMED for name, values in getattr(batch, kind).items()}
        with open(waiting, "wb") as file:
            np.savez(file, status=batch.status, failure_time=batch.failure_time, **arrays)
        os.replace(waiting, target)

    def batches(self) -> list[Batch]:
        """Return all batches in the order of their samples."""
        return [_load(path) for path in sorted(self.folder.glob("*.npz"))]

    def remove(self) -> None:
        """Remove the folder; the result holds all of it."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _check(self, found: dict) -> None:
        for key, value in self._run.items():
            if found.get(key) != value:
                shown = "" if key == "scene" else f" ({found.get(key)} there, {value} here)"
                raise InputError(
                    f"--resume: '{self.folder}' belongs to another run: its {key} differs{shown}; "
                    "repeat the command as it was, or leave --resume out to start anew"
                )


def _read_label(path: Path) -> dict:
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise InputError(
            f"--resume: '{path}' is damaged ({error}); leave --resume out to start anew"
        ) from error


def _load(path: Path) -> Batch:
    with np.load(path, allow_pickle=False) as data:
        named: dict[str, dict[str, np.ndarray]] = {kind: {} for kind in NAMED}
        for key in data.files:
            kind, _, name = key.partition(".")
            if name:
                named[kind][name] = data[key]
        return Batch(int(path.stem), status=data["status"], failure_time=data["failure_time"], **named)
