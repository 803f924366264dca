"""A folder of finished pieces of a run beside its result, ``<output>.partial/``.

Every piece is a file of its own, written under another name and renamed, so that a run may be killed at any moment. The
folder says which run it belongs to and is removed once the result is written.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.signals import keep, keep_no_longer

LABEL = "run.json"


class CheckpointFolder:
    """The folder of one run.

    Parameters
    ----------
    output
        The run's result.
    run
        What the run is, by key; hashes are not shown to the user.
    """

    def __init__(self, output: Path, run: Mapping[str, object]) -> None:
        self.path = output.with_name(f"{output.name}.partial")
        self._run = dict(run)

    def open(self, resume: bool) -> bool:
        """Start anew, or take up what is there if that is asked for; return whether it was taken up. By one process.

        Raises
        ------
        InputError
            If what is there belongs to another run.
        """
        label = self.path / LABEL
        if resume and label.exists():
            self._check(_read_label(label))
            keep(self.path)
            return True
        shutil.rmtree(self.path, ignore_errors=True)
        self.path.mkdir()
        waiting = label.with_suffix(".writing")
        waiting.write_text(json.dumps(self._run))
        os.replace(waiting, label)
        keep(self.path)
        return False

    def put(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store a piece; any process may, each its own names."""
        target = self.path / f"{name}.npz"
        waiting = target.with_suffix(".writing")
        with open(waiting, "wb") as file:
            np.savez(file, **arrays)
        os.replace(waiting, target)

    def pieces(self, pattern: str = "*") -> list[Path]:
        """Return the files of pieces whose names fit a pattern, sorted."""
        return sorted(self.path.glob(f"{pattern}.npz"))

    def remove(self) -> None:
        """Remove the folder; the result holds all of it."""
        keep_no_longer(self.path)
        shutil.rmtree(self.path, ignore_errors=True)

    def _check(self, found: dict) -> None:
        for key, value in self._run.items():
            if found.get(key) != value:
                shown = (
                    "" if isinstance(value, str) and len(value) == 64 else f" ({found.get(key)} there, {value} here)"
                )
                raise InputError(
                    f"--resume: '{self.path}' belongs to another run: its {key} differs{shown}; "
                    "repeat the command as it was, or leave --resume out to start anew"
                )


def _read_label(path: Path) -> dict:
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise InputError(f"--resume: '{path}' is damaged ({error}); leave --resume out to start anew") from error
