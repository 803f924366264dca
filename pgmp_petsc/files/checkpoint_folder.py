"""A folder of finished pieces of a run beside its result, ``<output>.partial/``.

Every piece is a file of its own, written under another name and renamed, so that a run may be killed at any moment.
Pushing one to the disk takes longer than writing it: that is done when some time has passed since the last, so that
pieces that took long are pushed and a machine that fails costs few others. The folder says which run it belongs to, and
so does the seal of every piece (:mod:`pgmp_petsc.files.seal`), which holds a checksum too: a damaged piece, or one of
another run, is named, set aside and computed again. The folder is removed once the result is written; one without this
program's label never is.

What the same process takes up again is at hand as long as it is not much, and the file is the one that it wrote.

A piece ``<name>.npz`` is an archive of numpy behind the seal: programs for zip archives open it, ``numpy.load`` does
from the open file after ``seek(512)``.

Which files of a job of several steps are finished, and what each was made from: a ledger in the job's folder, which
one job holds at a time.

A step is known by a checksum of everything that its file depends on. Its file counts as finished where the ledger holds
the same checksum, and the file is whole and the one that was written then.
"""

from __future__ import annotations

import io
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, RunError, note
from pgmp_petsc.base.plugins import in_use
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.files.claims import lock_path, locked, pieces_path, replacing
from pgmp_petsc.files.seal import SIZE, BrokenSeal, check_seal, identity, sealed
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.ending import keep, keep_no_longer, what_is_kept

LABEL = "run.json"
PROGRAM = "pgmp_petsc"
KIND = "piece"
PIECES = "*.npz"
# what this program puts into such a folder, and removes again
_OWN = (LABEL, PIECES, f"{PIECES}.damaged", ".*.partial")
PUSHED_EVERY = 1.0  # s
AT_HAND = 2**24  # bytes of pieces that the process which wrote them need not read

Content = TypeVar("Content")


class CheckpointFolder:
    """The folder of the run of one result.

    What the run is comes by key; checksums are not shown to the user. Numbers that are `growing` may be larger when a
    run is taken up: what is there is a part of it all the same.
    """

    def __init__(self, output: Path, run: Mapping[str, object], growing: Mapping[str, int] | None = None) -> None:
        self.path = pieces_path(output)
        self._run, self._growing = {**run, **in_use()}, dict(growing or {})
        self._identity = identity(self._run)
        # of pieces that were put: what tells a file from any later one of the same name, and the arrays
        self._at_hand: dict[Path, tuple[tuple[int, ...], Mapping[str, np.ndarray]]] = {}
        self._room = AT_HAND
        self._pushed = time.monotonic()

    def open(self, resume: bool) -> tuple[Remark, ...]:
        """Start anew, or take up what is there if that is asked for. By one process.

        Returns what of an older run was removed, or that there is nothing to take up. Raises `InputError` if what is
        there belongs to another run (and is to be taken up), or is no folder of this program's; `RunError` if the
        folder cannot be made.
        """
        remarks: tuple[Remark, ...] = ()
        found = self._label()
        if resume and not (found and self.pieces()):
            remarks = (note(f"--resume: no finished piece of a stopped run is in '{self.path}'; this run begins anew"),)
        if found is not None and resume:
            self._check(found)
        elif found is not None:
            n_pieces = len(self.pieces())
            self.remove()
            if n_pieces:
                what = f"'{self.path}' held {n_pieces} finished piece(s) of a stopped run"
                remarks = (note(f"{what}, which were removed: --resume was not given"),)
        try:
            self.path.mkdir(exist_ok=True)
        except OSError as error:
            raise RunError(f"checkpoint '{self.path}' could not be made: {error.strerror}") from error
        if not (found and resume) or any(found[key] != value for key, value in self._growing.items()):
            with replacing(self.path / LABEL, "checkpoint") as waiting:
                waiting.write_text(json.dumps({"program": PROGRAM, **self._run, **self._growing}))
        keep(self.path, PIECES)
        return remarks

    def put(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Store a piece; any process may, each its own names. The arrays are not to be changed any more. Raises
        `RunError` if the system fails to write; pieces that are there stay."""
        target, archive = self.path / f"{name}.npz", io.BytesIO()
        np.savez(archive, **arrays)  # not into the file: zipfile complains once more when the disk is full
        content = sealed(archive.getbuffer(), KIND, 1, self._identity)
        is_due = time.monotonic() > self._pushed + PUSHED_EVERY
        try:
            with replacing(target, "checkpoint", pushed=is_due) as waiting:
                waiting.write_bytes(content)
        except RunError as error:
            raise RunError(f"{error}; {what_is_kept()}") from error
        if is_due:
            self._pushed = time.monotonic()
        size = len(content) - SIZE
        if size <= self._room:
            self._room -= size
            with suppress(OSError):  # a file that is gone already is not found later either
                self._at_hand[target] = _stamp(target), {name: _fixed(values) for name, values in arrays.items()}

    def pieces(self, pattern: str = "*") -> list[Path]:
        """Return the files of pieces whose names fit a pattern, sorted."""
        return sorted(self.path.glob(f"{pattern}.npz"))

    def take(self, path: Path, read: Callable[[Mapping[str, np.ndarray]], Content]) -> Content:
        """Return what ``read`` makes of the arrays of a piece; raises `BrokenSeal` if the piece is damaged or belongs
        to another run."""
        try:
            stamp, arrays = self._at_hand.get(path, ((), {}))
            if stamp and stamp == _stamp(path):
                return read(arrays)
            if check_seal(path).run != self._identity:
                raise BrokenSeal("it belongs to another run")
            with np.load(io.BytesIO(path.read_bytes()[SIZE:]), allow_pickle=False) as arrays:
                return read(arrays)
        except (OSError, LookupError, ValueError, TypeError, BadZipFile) as error:
            raise BrokenSeal(f"it cannot be read ({error})") from error

    def sound(self, read: Callable[[Path], object], pattern: str = "*") -> tuple[list[Path], tuple[Remark, ...]]:
        """Return the pieces, of names like the pattern, that ``read`` takes up by `take`, and a note on each other one,
        for which it raises `BrokenSeal`, and which is set aside. By one process."""
        taken, remarks = [], []
        for path in self.pieces(pattern):
            try:
                read(path)
                taken.append(path)
            except BrokenSeal as broken:
                with suppress(OSError):
                    os.replace(path, path.with_name(f"{path.name}.damaged"))
                remarks.append(note(f"piece '{path}' was not taken up, and is computed again: {broken}"))
        return taken, tuple(remarks)

    def remove(self) -> None:
        """Remove the folder where it is this program's; files that are not are left, in it."""
        keep_no_longer(self.path)
        with suppress(InputError, OSError):
            if self._label() is not None:
                for folder in self.path.glob("*.partial"):
                    if folder.is_dir():
                        CheckpointFolder(folder.with_suffix(""), {}).remove()
                for pattern in _OWN[::-1]:  # the label last: without it the folder is nobody's
                    for path in self.path.glob(pattern):
                        path.unlink()
                self.path.rmdir()

    def _label(self) -> dict[str, object] | None:
        """Return what the folder's label says, None where there is no folder or nothing in it; raises `InputError` if
        it has no label of this program, or a damaged one."""
        if not os.path.lexists(self.path):
            return None
        refused = f"'{self.path}' is in the way of this run's checkpoint: "
        if not self.path.is_dir():
            raise InputError(f"{refused}it is no folder; move it away, or give another output")
        try:
            found = json.loads((self.path / LABEL).read_text())
            if found.get("program") != PROGRAM:
                raise ValueError("it does not name this program")
        except FileNotFoundError:
            # a run that ended before it had written the label
            if all(path.match(_OWN[-1]) for path in self.path.iterdir()):
                return None
            why = f"it has no label '{LABEL}' of this program; move it away, or give another output"
            raise InputError(f"{refused}{why}") from None
        except (OSError, ValueError, AttributeError, RecursionError) as error:
            why = f"its label '{LABEL}' is damaged ({error}); a run cannot be taken up from it with --resume"
            raise InputError(f"{refused}{why}; move the folder away to start anew") from error
        return found

    def _check(self, found: Mapping[str, object]) -> None:
        other = f"--resume: '{self.path}' belongs to another run: its"
        for key, value in self._growing.items():
            there = found.get(key)
            if not isinstance(there, int) or there > value:
                cure = "and only a larger number may be given; leave --resume out to start anew"
                raise InputError(f"{other} number of {key} differs ({there} there, {value} here), {cure}")
        for key, value in self._run.items():
            there = found.get(key, "not named")
            if there != value:
                shown = "" if isinstance(value, str) and len(value) == 64 else f" ({there} there, {value} here)"
                cure = "repeat the command as it was, or leave --resume out to start anew"
                raise InputError(f"{other} {key} differs{shown}; {cure}")


class SharedCheckpoint:
    """Finished pieces of a run that all ranks take up, whatever the number of ranks that wrote them; see
    `CheckpointFolder`.

    Collective on `comm` where it is made; ranks may work in different directories. `readers` make a mapping of a
    piece's name and its arrays, by a pattern of the name. Raises as `CheckpointFolder.open`, and `RunError` if a rank
    cannot read what the first one can.
    """

    def __init__(
        self,
        output: Path,
        run: Mapping[str, object],
        comm: Comm,
        resume: bool,
        readers: Mapping[str, Callable[[str, Mapping[str, np.ndarray]], dict[Any, Any]]],
    ) -> None:
        self._world = comm
        self._folder = CheckpointFolder(on_root(comm, output.resolve), run)

        def opening_the_checkpoint() -> tuple[list[list[Path]], tuple[Remark, ...]]:
            remarks, paths = self._folder.open(resume), []
            for pattern, read in readers.items():
                sound, broken = self._folder.sound(partial(self._read, read), pattern)
                paths.append(sound)
                remarks += broken
            return paths, remarks

        # one rank says what is sound: another that reads for itself might see other files
        paths, self.remarks = on_root(comm, opening_the_checkpoint)  # remarks are of what was not taken up
        self._taken_up = any(paths)
        with agreed(comm, "reading the checkpoint"):
            self._known = [{} for _ in paths]
            for known, found, read in zip(self._known, paths, readers.values()):
                for path in found:
                    try:
                        known |= self._read(read, path)
                    except BrokenSeal as broken:
                        raise RunError(f"piece '{path}' cannot be read on every rank: {broken}") from broken

    def _read(self, read: Callable[[str, Mapping[str, np.ndarray]], dict[Any, Any]], path: Path) -> dict[Any, Any]:
        return self._folder.take(path, lambda arrays: read(path.stem, arrays))

    def forget(self) -> None:
        """Remove the folder after bad input, unless another run left something in it. Collective on all ranks."""
        if not self._taken_up:
            self.remove()

    def remove(self) -> None:
        """Remove the folder once the result is written. Collective on all ranks."""
        on_root(self._world, self._folder.remove)


def _stamp(path: Path) -> tuple[int, ...]:
    """Return what differs as soon as a file is written to or replaced."""
    found = os.stat(path)
    return found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _fixed(values: np.ndarray) -> np.ndarray:
    """Return the same array, not to be written to."""
    same = np.asarray(values).view()
    same.flags.writeable = False
    return same


LEDGER = "steps.json"
FORMAT = 1


@dataclass(frozen=True)
class Steps:
    """The ledger of a folder; by one process only."""

    folder: Path  # of the job's files

    @contextmanager
    def held(self) -> Iterator[None]:
        """Make the folder and keep it from other jobs within the block; one in which nothing begins is removed. Raises
        `InputError` if it cannot be made, holds files of somebody else, or another job works in it."""
        self.make()
        try:
            with locked(self.folder / LEDGER, f"folder '{self.folder}'"):
                self.make()  # another job may have ended since
                yield
        finally:
            with suppress(OSError):
                self.folder.rmdir()

    def make(self) -> None:
        """Make the folder. Raises `InputError` if it cannot be made, or holds files of somebody else."""
        own = {LEDGER, lock_path(self.folder / LEDGER).name}
        try:
            self.folder.mkdir(exist_ok=True)
            found = {path.name for path in self.folder.iterdir()}
        except OSError as error:
            raise InputError(
                f"folder '{self.folder}' cannot be made: {error.strerror}; give another with -o"
            ) from error
        if LEDGER not in found and found - own:
            why = f"folder '{self.folder}' holds files and is none of pgmp run ({LEDGER} is missing)"
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
        return (self.folder / f"{name}.partial").is_dir() and entry.get("key") == key and "sha256" not in entry

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
        return str(self._finished(name)["sha256"])

    def check_files(self, names: Iterable[str]) -> None:
        """Check that the files are those that the job took or made; raises `RunError` if another program has written
        one of them since."""
        for name in names:
            if not self.is_finished(name, self._finished(name)["key"]):
                raise self._changed(name)

    def _finished(self, name: str) -> Mapping[str, Any]:
        entry = self._read().get(name, {})
        if "sha256" not in entry or "key" not in entry:
            raise self._changed(LEDGER)
        return entry

    def _changed(self, name: str) -> RunError:
        why = f"'{self.folder / name}' was changed or removed by another program while this job worked"
        return RunError(f"{why}; run it again, and give the other program another folder")

    def _read(self) -> dict[str, dict[str, Any]]:
        """Return what is known of each file; nothing where there is no ledger, or one of another version. Raises
        `InputError` if there is something else in its place."""
        path = self.folder / LEDGER
        try:
            text = path.read_text(encoding="utf-8")
            found = json.loads(text) if text.strip() else {"format": FORMAT, "files": {}}
            files = {str(name): dict(entry) for name, entry in found["files"].items()}
            return files if found["format"] == FORMAT else {}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            why = f"folder '{self.folder}': its {LEDGER} is none of pgmp run"
            raise InputError(f"{why}; give another folder with -o, or move the file away") from error

    def _write(self, files: Mapping[str, Any]) -> None:
        with replacing(self.folder / LEDGER, "ledger") as partial:
            partial.write_text(json.dumps({"format": FORMAT, "files": files}, indent=1), encoding="utf-8")
