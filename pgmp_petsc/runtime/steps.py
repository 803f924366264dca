"""Which files of a job of several steps are finished, and what each was made from: a ledger in the job's folder.

A step is known by a checksum of everything that its file depends on. Its file counts as finished where the ledger holds
the same checksum, and the file is whole and the one that was written then.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.files import replacing
from pgmp_petsc.runtime.seal import BrokenSeal, check_seal

LABEL = "steps.json"
FORMAT = 1


@dataclass(frozen=True)
class Steps:
    """The ledger of a folder; by one process only.

    Attributes
    ----------
    folder
        Of the job's files.
    """

    folder: Path

    def make(self) -> None:
        """Make the folder.

        Raises
        ------
        InputError
            If it cannot be made, or holds files of somebody else.
        """
        try:
            self.folder.mkdir(exist_ok=True)
            strangers = not (self.folder / LABEL).exists() and any(self.folder.iterdir())
        except OSError as error:
            raise InputError(
                f"folder '{self.folder}' cannot be made: {error.strerror}; give another with -o"
            ) from error
        if strangers:
            raise InputError(
                f"folder '{self.folder}' holds files and is none of pgmp run ({LABEL} is missing); give another with "
                "-o, or move it away"
            )
        self._write(self._read())

    def is_finished(self, name: str, key: str) -> bool:
        """Return whether a file is there, whole, and made from what the key stands for."""
        entry = self._read().get(name, {})
        try:
            return entry.get("key") == key and check_seal(self.folder / name).sha256 == entry.get("sha256")
        except (BrokenSeal, OSError):
            return False

    def was_begun(self, name: str, key: str) -> bool:
        """Return whether the step was begun with the same key and not finished: its pieces may be taken up."""
        entry = self._read().get(name, {})
        pieces = (self.folder / f"{name}.partial").is_dir()
        return pieces and entry.get("key") == key and "sha256" not in entry

    def begin(self, name: str, key: str) -> None:
        """Note what a step begins with."""
        self._write({**self._read(), name: {"key": key}})

    def finish(self, name: str, key: str, failure: str) -> None:
        """Note that a step's file is written, and what failed although it is; empty where nothing did."""
        sha = check_seal(self.folder / name).sha256
        self._write({**self._read(), name: {"key": key, "sha256": sha, "failure": failure}})

    def failure(self, name: str) -> str:
        """Return what failed in a step that is finished; empty where nothing did."""
        return str(self._read()[name].get("failure", ""))

    def checksum(self, name: str) -> str:
        """Return the checksum of a file that is finished."""
        return str(self._read()[name]["sha256"])

    def _read(self) -> Mapping[str, Any]:
        """Return what is known of each file; nothing where the ledger is damaged or of another version."""
        try:
            found = json.loads((self.folder / LABEL).read_text(encoding="utf-8"))
            files = found["files"] if found["format"] == FORMAT else {}
            return {str(name): dict(entry) for name, entry in files.items()}
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            return {}

    def _write(self, files: Mapping[str, Any]) -> None:
        with replacing(self.folder / LABEL, "ledger") as partial:
            partial.write_text(json.dumps({"format": FORMAT, "files": files}, indent=1), encoding="utf-8")
