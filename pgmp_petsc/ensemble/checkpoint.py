"""Finished samples of an ensemble: batches in a checkpoint, a folder beside the result, or the files of shards; and the
columns put together of them: one number a sample in a file, so that memory holds one column at a time, however many
samples."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from tempfile import TemporaryFile
from typing import Self
from weakref import finalize

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, RunError
from pgmp_petsc.declare.values import Lazy
from pgmp_petsc.ensemble.plan import IN_ALL, IN_CHECKED, NAMED, Batch, Piece, Plan
from pgmp_petsc.files.checkpoint_folder import CheckpointFolder
from pgmp_petsc.files.seal import BrokenSeal, identity
from pgmp_petsc.ranks.ending import taken_up
from pgmp_petsc.results.ensemble import Place, ShardSamples

FORMAT = 7
OF_LATIN_HYPERCUBE = "number of samples, on which every sample of a Latin hypercube depends,"
SAMPLES, CHECKED = "samples_", "checked_"  # with the number of the first sample, the names of pieces
COUNTS = "counts"  # the piece that says how many samples were allotted


@dataclass(frozen=True)
class Finished:
    """Contents of a checkpoint: ranges (first, last) of samples, and of those whose errors were estimated; sorted."""

    samples: tuple[tuple[int, int], ...]
    checked: tuple[tuple[int, int], ...]


class Checkpoint:
    """Finished batches of the ensemble of a plan; used by rank 0.

    It is refused where it is of another resolved scene (TOML), model, or `tables`, the identity of what the model is
    made of besides (see `Model`): two reduced models of the same scene may differ, and so may meshes of the same name.
    So it is of another `design`, where samples come from in words and the identity of the numbers (`Sampler.named`). A
    run that `extends` a shorter one has its samples, and may take up what that left. `remarks` say what was found and
    not taken up; `run` is what the whole ensemble is, by key, the same for all its shards.
    """

    def __init__(
        self, plan: Plan, scene_toml: str, model: str, tables: str, design: tuple[str, str], extends: bool = True
    ) -> None:
        self._plan = plan
        fixed, grows = {}, extends and plan.shard is None
        if not extends:
            fixed[OF_LATIN_HYPERCUBE] = plan.n_samples
        elif plan.shard is not None:
            fixed["number of samples"] = plan.n_samples
        run = {
            "format": FORMAT,
            "model": model,
            "sampler": design[0],
            **fixed,
            "seed": plan.seed,
            "file of samples": identity("") if plan.file is None else plan.file.identity,
            "scene": identity(scene_toml),
            "reduced model" if model == "reduced" else "meshes": tables,
            "design of samples": design[1],
        }
        self.run = dict(run)
        if plan.shard is not None:
            run["shard"] = str(plan.shard)
        self._folder = CheckpointFolder(plan.output, run, {"samples": plan.n_samples} if grows else {})
        self.folder = self._folder.path  # where the batches are
        self._end = plan.samples[1]
        self.remarks: tuple[Remark, ...] = ()

    def open(self) -> Finished:
        """Start anew, or take up what is there if the plan says so.

        A piece that is damaged, of another run or in no place of this one is set aside, with a remark. Raises
        `InputError` if what is there belongs to another run.
        """
        started = self._folder.open(self._plan.resume)
        samples, of_samples = self._taken_up(SAMPLES)
        checked, of_checked = self._taken_up(CHECKED)
        self.remarks = started + of_samples + of_checked
        return Finished(samples, checked)

    def _taken_up(self, kind: str) -> tuple[tuple[tuple[int, int], ...], tuple[Remark, ...]]:
        """Return the ranges of samples that sound pieces of a kind hold, and a remark on each other piece."""
        found: list[tuple[int, int]] = []

        def read(path: Path) -> None:
            batch = self._read(path)
            last = batch.first + len(batch.status)
            if found and batch.first < found[-1][1]:
                raise BrokenSeal(f"it holds samples {batch.first} to {last - 1}, of which others are there already")
            found.append((batch.first, last))

        _, remarks = self._folder.sound(read, f"{kind}*")
        return tuple(found), remarks

    def add(self, piece: Piece, batch: Batch) -> None:
        self._folder.put(f"{CHECKED if piece.is_checked else SAMPLES}{batch.first:09d}", _named(batch, NAMED))

    def up_to(self, n: int) -> Self:
        """Return the checkpoint of the first n samples of the plan, whatever else is there."""
        part = copy(self)
        part._end = n
        return part

    @property
    def counts(self) -> np.ndarray | None:
        """How many samples models were allotted, as `keep_counts` was given it; None where nothing sound is there."""
        with suppress(BrokenSeal):
            for path in self._folder.pieces(COUNTS):
                return self._folder.take(path, lambda arrays: np.array(arrays[COUNTS]))
        return None

    def keep_counts(self, counts: np.ndarray) -> None:
        """Store how many samples models are allotted: times decided on it, which will not come again."""
        self._folder.put(COUNTS, {COUNTS: counts})

    def columns(self) -> Columns:
        """Return what all pieces hold as columns ``<kind>.<name>``, with ``status`` and ``failure_time``; raises
        `RunError`, as `batches`, or if the system fails to write."""
        begin = self._plan.samples[0]
        columns = Columns(self.folder, self._end - begin)
        for batch in self.batches(IN_ALL):
            columns.put(batch.first - begin, _named(batch, IN_ALL))
        for batch in self.estimates():
            columns.put(batch.first - begin, _named(batch, IN_CHECKED, with_ends=False))
        return columns

    def bands(self, n: int) -> dict[str, np.ndarray]:
        """Return the outputs of the first n samples at the instants of the bands, each (n, n_t); NaN where one failed.
        Raises `RunError`, as `batches`."""
        within = takewhile(lambda batch: batch.first < n, self.batches(("bands",)))
        return joined({name: values[: n - batch.first] for name, values in batch.bands.items()} for batch in within)

    def estimates(self) -> Iterator[Batch]:
        return self._all(CHECKED, NAMED)

    def batches(self, parts: Sequence[str] = NAMED) -> Iterator[Batch]:
        """Yield parts of the pieces in the order of their samples, which are those of the plan, each once; raises
        `RunError` if samples are missing, there twice, or damaged."""
        (begin, _), end = self._plan.samples, self._end
        place = begin
        for batch in self._all(SAMPLES, parts):
            if batch.first != place:
                missing = f"samples {place} to {batch.first - 1} are missing"
                what = missing if batch.first > place else "samples are there twice"
                raise RunError(f"in '{self.folder}' {what}; nothing was written; {taken_up()}")
            place += len(batch.status)
            yield batch
        if place != end:
            what = f"'{self.folder}' holds {place - begin} of {end - begin} samples"
            raise RunError(f"{what}; nothing was written; {taken_up()}")

    def _all(self, kind: str, parts: Sequence[str]) -> Iterator[Batch]:
        for path in self._folder.pieces(f"{kind}*"):
            try:
                batch = self._read(path, parts)
                if batch.first < self._end:
                    yield batch.part(0, self._end - batch.first)
            except BrokenSeal as broken:
                what = f"a finished piece in '{self.folder}' was damaged during the run: {broken}"
                raise RunError(f"{what}; nothing was written; {taken_up()}") from broken

    def _read(self, path: Path, parts: Sequence[str] = NAMED) -> Batch:
        """Return parts of what a piece holds; raises `BrokenSeal` unless these are samples of this run."""
        first = int(path.stem.rpartition("_")[2])
        batch = self._folder.take(path, lambda arrays: _batch(first, arrays, parts))
        last = batch.first + len(batch.status)
        begin, end = self._plan.samples
        if not begin <= batch.first < last <= end:
            raise BrokenSeal(f"it holds samples {batch.first} to {last - 1}, which are none of this run")
        return batch


def joined(parts: Iterable[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return arrays of the same names put together along their first axis."""
    found: dict[str, list[np.ndarray]] = {}
    for part in parts:
        for name, values in part.items():
            found.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in found.items()}


def remove_checkpoint(plan: Plan) -> None:
    """Remove what a plan's ensemble has kept; the result holds all of it."""
    CheckpointFolder(plan.output, {}).remove()


def _named(batch: Batch, kinds: Sequence[str], with_ends: bool = True) -> dict[str, np.ndarray]:
    """Return arrays of a batch by ``<kind>.<name>``, and how its samples ended."""
    ends = {"status": batch.status, "failure_time": batch.failure_time} if with_ends else {}
    return ends | {f"{kind}.{name}": values for kind in kinds for name, values in getattr(batch, kind).items()}


def _batch(first: int, arrays: Mapping[str, np.ndarray], parts: Sequence[str]) -> Batch:
    """Return parts of a piece; opening an array takes longer than reading it."""
    named: dict[str, dict[str, np.ndarray]] = {part: {} for part in parts}
    for key in arrays:
        part, _, name = key.partition(".")
        if name and part in named:
            named[part][name] = arrays[key]
    drawn, found = named.pop("parameters", {}), named.pop("outputs", {})
    return Batch(first, drawn, found, arrays["status"], arrays["failure_time"], **named)


_NUMBER = np.dtype(np.float64)
_AT_ONCE = 1 << 16  # numbers


class Columns(Mapping[str, np.ndarray]):
    """Columns (n_samples,) by name, read when they are asked for; NaN where nothing was put.

    They are in a file without a name in a folder with space for it: it is gone with the last reference to it, however
    the run ends. Raises `RunError` if the system fails to make it.
    """

    def __init__(self, folder: Path, n_samples: int) -> None:
        self._folder, self._n_samples = folder, n_samples
        self._places: dict[str, int] = {}
        with self._written():
            self._file = TemporaryFile(dir=folder, buffering=0)
        finalize(self, self._file.close)

    def put(self, first: int, columns: Mapping[str, np.ndarray]) -> None:
        """Put in what is known of samples first, first + 1, and so on; raises `RunError` if the system cannot write."""
        with self._written():
            for name, values in columns.items():
                if name not in self._places:
                    self._places[name] = len(self._places)
                    for begin in range(0, self._n_samples, _AT_ONCE):
                        self._write(name, begin, np.full(min(_AT_ONCE, self._n_samples - begin), np.nan))
                self._write(name, first, values)

    def of(self, kind: str) -> Mapping[str, np.ndarray]:
        """Return the columns whose names begin with ``<kind>.``, by what follows."""
        names = [name.removeprefix(f"{kind}.") for name in self if name.startswith(f"{kind}.")]
        return Lazy(names, lambda name: self[f"{kind}.{name}"])

    @contextmanager
    def _written(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            what = f"samples could not be put together in '{self._folder}'"
            raise RunError(f"{what}: {error.strerror}; what is finished is kept: {taken_up()}") from error

    def _write(self, name: str, first: int, values: np.ndarray) -> None:
        """Write numbers into a column, from a sample on; the system may take them in parts."""
        left = memoryview(np.ascontiguousarray(values, dtype=_NUMBER)).cast("B")
        self._file.seek(self._offset(name, first))
        while left:
            left = left[self._file.write(left) :]

    def _offset(self, name: str, sample: int = 0) -> int:
        return (self._places[name] * self._n_samples + sample) * _NUMBER.itemsize

    def __getitem__(self, name: str) -> np.ndarray:
        self._file.seek(self._offset(name))
        return np.fromfile(self._file, _NUMBER, self._n_samples)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


CHECKSUM = 64  # characters
OUTPUTS = "outputs."  # before the names of columns that are outputs


class Shards:
    """Shards that are `all` of an ensemble, in their order; in place of a checkpoint. Their columns are put together in
    a folder. Raises `InputError` if they are not all shards of one ensemble, each once."""

    def __init__(self, paths: Sequence[Path], shards: Sequence[ShardSamples], folder: Path) -> None:
        _check(paths, [shard.place for shard in shards])
        ordered = sorted(zip(paths, shards), key=lambda pair: pair[1].place.number)
        self.all, self._folder = [shard for _, shard in ordered], folder
        self._n_samples = shards[0].place.n_samples
        ends = [shard.place.first for shard in self.all[1:]] + [self._n_samples]
        for (path, shard), end in zip(ordered, ends):
            n, fine = len(shard.status), shard.status == 0
            if n != end - shard.place.first:
                raise InputError(
                    f"file '{path}' is damaged: {n} samples, not {end - shard.place.first}; write it again"
                )
            for name in shard.columns:
                if name.startswith(OUTPUTS) and np.isnan(shard.columns[name][fine]).any():
                    raise InputError(f"file '{path}' is damaged: {name} is NaN of fine samples; write it again")
        # of bands, which in a shard are alike
        counts = [(path, shard.bands[next(iter(shard.bands))].shape[1]) for path, shard in ordered if shard.bands]
        for path, n in counts:
            if n != counts[0][1]:
                what = f"bands at {n} instants, not {counts[0][1]}"
                raise InputError(f"file '{path}' is damaged: {what}; write it again")
        self.remarks: tuple[Remark, ...] = tuple(remark for shard in self.all for remark in shard.found)

    def columns(self) -> Columns:
        """Return all samples as columns; raises `RunError` if the system fails to write them."""
        columns = Columns(self._folder, self._n_samples)
        for shard in self.all:
            for name in shard.columns:
                columns.put(shard.place.first, {name: shard.columns[name]})
        return columns

    def bands(self, n: int) -> Mapping[str, np.ndarray]:
        """Return the outputs of the first n samples at the instants of the bands, each (n, n_t)."""
        return joined(shard.bands for shard in self.all if shard.place.first < n)


Kept = Checkpoint | Shards  # samples that are finished


def _check(paths: Sequence[Path], places: Sequence[Place]) -> None:
    """Refuse what is not all shards of one ensemble, each once."""
    path, place = paths[0], places[0]
    for other_path, other in zip(paths[1:], places[1:]):
        for key in {**place.run, **other.run}:
            one, two = place.run.get(key), other.run.get(key)
            if one != two:
                plain = not any(isinstance(value, str) and len(value) == CHECKSUM for value in (one, two))
                shown = f" ({one} in '{path}', {two} in '{other_path}')" if plain else ""
                raise InputError(
                    f"'{other_path}' is a shard of another ensemble than '{path}': its {key} differs{shown}"
                )
        if other.count != place.count:
            raise InputError(
                f"'{other_path}' is one of {other.count} shards and '{path}' one of {place.count}: take those of one "
                "division"
            )
    known: dict[int, Path] = {}
    for one_path, one in zip(paths, places):
        if one.number in known:
            raise InputError(f"shard {one.number}/{one.count} is there twice: '{known[one.number]}' and '{one_path}'")
        known[one.number] = one_path
    absent = [f"{number}/{place.count}" for number in range(1, place.count + 1) if number not in known]
    if absent:
        raise InputError(f"missing: shard {', '.join(absent)}; give the files of all {place.count}")
