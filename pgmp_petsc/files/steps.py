"""Which files of a job of several steps are finished, and what each was made from: a ledger in the job's folder, which
one job holds at a time.

A step is known by a checksum of everything that its file depends on. Its file counts as finished where the ledger holds
the same checksum, and the file is whole and the one that was written then.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.files.claims import lock_path, locked, replacing
from pgmp_petsc.files.seal import BrokenSeal, check_seal

LABEL = "steps.json"
FORMAT = 1


@dataclass(frozen=True)
class Steps:
    """The ledger of a folder; by one process only."""

    folder: Path  # of the job's files

    @contextmanager
    def held(self) -> Iterator[None]:
        """Make the folder and keep it from other jobs within the block; one in which nothing begins is removed.

        Raises `InputError` if it cannot be made, holds files of somebody else, or another job works in it.
        """
        self.make()
        try:
            with locked(self.folder / LABEL, f"folder '{self.folder}'"):
                self.make()  # another job may have ended since
                yield
        finally:
            with suppress(OSError):
                self.folder.rmdir()

    def make(self) -> None:
        """Make the folder. Raises `InputError` if it cannot be made, or holds files of somebody else."""
        own = {LABEL, lock_path(self.folder / LABEL).name}
        try:
            self.folder.mkdir(exist_ok=True)
            found = {path.name for path in self.folder.iterdir()}
        except OSError as error:
            raise InputError(
                f"folder '{self.folder}' cannot be made: {error.strerror}; give another with -o"
            ) from error
        if LABEL not in found and found - own:
            why = f"folder '{self.folder}' holds files and is none of pgmp run ({LABEL} is missing)"
            raise InputError(f"{why}; give another with -o, or move it away")
        self._read()

    def is_finished(self, name: str, key: str) -> bool:
        """Return whether a file is there, whole, and made from what the key describes."""
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

    def replaced(self, name: str) -> str | None:
        """Return the changes of the scene that a file is of which a step would replace, empty where there are none;
        None where there is no such file."""
        entry = self._read().get(name, {})
        return str(entry.get("changes", "")) if "sha256" in entry and (self.folder / name).exists() else None

    def begin(self, name: str, key: str, changes: str = "") -> None:
        """Note what a step begins with: its key, and the changes of the scene for people."""
        self._write({**self._read(), name: {"key": key, "changes": changes}})

    def finish(self, name: str, key: str, failure: str) -> None:
        """Note that a step's file is written, and what failed although it is; empty where nothing did."""
        known = self._read()
        sha = check_seal(self.folder / name).sha256
        entry = {"changes": "", **known.get(name, {}), "key": key, "sha256": sha, "failure": failure}
        self._write({**known, name: entry})

    def failure(self, name: str) -> str:
        """Return what failed in a step that is finished; empty where nothing did."""
        return str(self._finished(name).get("failure", ""))

    def checksum(self, name: str) -> str:
        """Return the checksum of a file that is finished."""
        return str(self._finished(name)["sha256"])

    def check_files(self, names: Iterable[str]) -> None:
        """Check that the files are those that the job took or made.

        Raises `RunError` if another program has written one of them since.
        """
        for name in names:
            if not self.is_finished(name, self._finished(name)["key"]):
                raise self._changed(name)

    def _finished(self, name: str) -> Mapping[str, Any]:
        entry = self._read().get(name, {})
        if "sha256" not in entry or "key" not in entry:
            raise self._changed(LABEL)
        return entry

    def _changed(self, name: str) -> RunError:
        why = f"'{self.folder / name}' was changed or removed by another program while this job worked"
        return RunError(f"{why}; run it again, and give the other program another folder")

    def _read(self) -> dict[str, dict[str, Any]]:
        """Return what is known of each file; nothing where there is no ledger, or one of another version.

        Raises `InputError` if there is something else in its place.
        """
        path = self.folder / LABEL
        try:
            text = path.read_text(encoding="utf-8")
            found = json.loads(text) if text.strip() else {"format": FORMAT, "files": {}}
            files = {str(name): dict(entry) for name, entry in found["files"].items()}
            return files if found["format"] == FORMAT else {}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            why = f"folder '{self.folder}': its {LABEL} is none of pgmp run"
            raise InputError(f"{why}; give another folder with -o, or move the file away") from error

    def _write(self, files: Mapping[str, Any]) -> None:
        with replacing(self.folder / LABEL, "ledger") as partial:
            partial.write_text(json.dumps({"format": FORMAT, "files": files}, indent=1), encoding="utf-8")
