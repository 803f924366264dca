"""HDF5 files of results: written whole or not at all, checked when opened.

A file is written by one process (rank 0) beside its target and renamed when it is complete and on the disk, so a file
under its final name is never half written, and one that it replaces stays until then. Its first 512 bytes, which HDF5
skips, are a seal with a checksum of all of it (:mod:`pgmp_petsc.files.seal`), checked before it is read. Every file
has the attributes ``format_version``, an integer (:func:`version_of` the kind), ``program_version``, ``kind``, one of
`KINDS`, and what :class:`RunRecord` writes: ``scene`` as TOML, ``parameters`` and ``remarks`` as JSON, ``seed``, empty
(null) where there is none, and ``ranks``. Every dataset has the attributes ``unit`` and ``description``.

A stream under an HDF5 file that is being written, which keeps HDF5 alive when the disk is full.

The HDF5 library does not survive a failed write: closing the file fails too, and the process ends with a
segmentation fault (seen with HDF5 1.10, h5py 3.7). HDF5 therefore writes through :class:`GuardedStream`,
which remembers the first failure, pretends that all is well until HDF5 has closed its file, and then raises.

Tables of numbers as CSV that users hand over: names in the first line, then a row a line; empty lines have no part.

Commas separate columns. A unit may follow a name, ``time (s)``, as in the tables that this program writes;
another one than that of the column is refused.
"""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, TextIO

import h5py
import numpy as np

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, Remark, from_json, shortened, to_json
from pgmp_petsc.base.plugins import check_plugins, plugins_of
from pgmp_petsc.base.units import SAID, SI, UnitSystem, system_of
from pgmp_petsc.files.claims import KINDS, check_output, first_line, named, pieces_path, replacing
from pgmp_petsc.files.seal import MAGIC, SIGNATURE, SIZE, BrokenSeal, check_seal, seal


def _through(name: str, instead: Callable[..., int]) -> Callable[..., int]:
    def guarded(stream: GuardedStream, *args: Any) -> int:
        return stream._guarded(getattr(stream._stream, name), *args, instead=instead(*args))

    return guarded


class GuardedStream(AbstractContextManager):
    """A new file under an `h5py.File` (driver ``fileobj``) whose failures come out in :meth:`finish` alone.

    Used in a ``with`` block, which closes it. What HDF5 then makes of what it reads back, and raises, is the failure's.
    """

    def __init__(self, path: Path) -> None:
        self._stream = open(path, "w+b")
        self._failure: OSError | None = None

    def _guarded(self, operation: Callable[..., int], *args: Any, instead: int) -> int:
        """Run an operation unless one has failed; return ``instead`` where it fails or is left out."""
        if self._failure is None:
            try:
                return operation(*args)
            except OSError as error:
                self._failure = error
        return instead

    write, readinto = _through("write", len), _through("readinto", len)
    seek = _through("seek", lambda offset, whence=os.SEEK_SET: offset)
    truncate = _through("truncate", lambda size: size)
    flush, tell = _through("flush", lambda: 0), _through("tell", lambda: 0)

    def finish(self) -> None:
        """Push everything to the disk; raise the first `OSError` of this or any earlier operation."""
        self.flush()
        self._guarded(os.fsync, self._stream.fileno(), instead=0)
        if self._failure is not None:
            raise self._failure

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        # Closing flushes what a failure has left in the buffer and fails again.
        self._guarded(self._stream.close, instead=0)
        if not self._stream.closed:
            try:
                self._stream.close()
            except OSError:
                self._stream.raw.close()
        if isinstance(error, Exception) and self._failure not in (None, error):
            raise self._failure from error


FORMAT_VERSION = 2
VERSIONS = {"rom": 5, "ensemble": 3, "trajectory": 3, "design": 3}  # of kinds that have changed since
WRITE_AGAIN, BUILD_AGAIN = "write it again", "build it again with pgmp build"
MODELS = ("full", "components", "reduced")  # of which runs are, as files name them
#: Models that stand alone, by kind: what to do where the other one is needed.
INSTEAD = {
    "rom": "; pgmp build SCENE --components -o FILE makes one",
    "components": ", with tables over configurations; pgmp build SCENE -o ROM.h5 makes one, of few coordinates",
}
_REQUIRED = ("format_version", "program_version", "kind", "scene", "parameters", "seed", "ranks", "remarks")
# that of HDF5 1.8 (2008): attributes beyond 64 kB, such as the probabilities of 10,000 quantiles
_LIBRARIES = ("v108", "v110")
TEXT = h5py.string_dtype()
COMPACT = 4096  # bytes; what is no larger lies beside its name and unit, which is read and written at once
# what readers raise where a file is whole and yet not what it should be
_MISFITS = (LookupError, ValueError, TypeError, AttributeError, ArithmeticError, OSError, RuntimeError, MemoryError)


@dataclass(frozen=True)
class RunRecord:
    """Where a result came from: enough to repeat the run."""

    scene_toml: str  # the resolved scene
    parameters: dict[str, float]  # values that the run used, in the scene's units (for an ensemble the nominal ones)
    seed: int | None  # seed of the random streams, None where nothing is random
    ranks: int  # number of MPI ranks
    timings: dict[str, float] = field(default_factory=dict)  # wall time a phase, s
    remarks: tuple[Remark, ...] = ()  # what the reader of the result has to know
    plugins: dict[str, str] | None = None  # SHA-256 of those that it needs, by name; of those in use if not given

    def __post_init__(self) -> None:
        if self.plugins is None:
            object.__setattr__(self, "plugins", plugins_of(self.scene_toml))

    @property
    def tables(self) -> dict[str, Any]:
        """The tables of the scene's text, which nobody changes; raises `ValueError` where it is no TOML."""
        return _tables(self.scene_toml)

    @cached_property
    def system(self) -> UnitSystem:
        """The units that the scene says; where it says none those of SI, by names of those that its materials exist
        in."""
        try:
            tables = self.tables
            if said := tables["scene"].get("units"):
                return SAID[said]
            nominal = {name: one["nominal"] for name, one in tables.get("parameters", {}).items()}
            known = [[nominal.get(one[key], one[key]) for key in ("rho", "E")] for one in tables["materials"].values()]
            return replace(system_of(known) or SI, length=1.0, mass=1.0, time=1.0)
        except (ValueError, TypeError, LookupError):
            return SI

    def check_bodies(self, found: Collection[str], group: str) -> None:
        """Raise `LookupError` where a group of a model's file lacks a body of the scene."""
        for name in self.tables.get("bodies", {}):
            if name not in found:
                raise LookupError(f"it has no {group}/{name}, a body of its scene")

    def write(self, file: h5py.File) -> None:
        """Write the record into the root attributes and ``/timings`` of an open file."""
        file.attrs["scene"] = self.scene_toml
        file.attrs["parameters"] = json.dumps({name: float(value) for name, value in self.parameters.items()})
        file.attrs["seed"] = h5py.Empty("i8") if self.seed is None else self.seed
        file.attrs["ranks"] = self.ranks
        file.attrs["remarks"] = to_json(self.remarks)
        if self.plugins:
            file.attrs["plugins"] = json.dumps(self.plugins)
        timings = file.create_group("timings", track_order=True)
        for phase, seconds in self.timings.items():
            put(timings, phase, float(seconds), "s", f"wall time of phase '{phase}', maximum over the ranks")

    @classmethod
    def read(cls, file: h5py.File) -> RunRecord:
        """Read the record of a file opened with :func:`open_file`; raises `InputError` if it was made with a plugin
        that is not in use, or with another one of that name."""
        with shapes_of(file):
            needed = json.loads(file.attrs.get("plugins", "{}"))
            needed = {str(name): str(sha256) for name, sha256 in needed.items()}
        check_plugins(needed, file.filename)
        with shapes_of(file):
            seed, parameters = file.attrs["seed"], json.loads(file.attrs["parameters"])
            scene = file.attrs["scene"]
            if not isinstance(scene, str):
                raise TypeError(f"a text was expected, and {type(scene).__name__} found")
            found = cls(
                scene_toml=scene,
                parameters={str(name): float(value) for name, value in parameters.items()},
                seed=int(seed) if isinstance(seed, (int, np.integer)) else None,
                ranks=int(file.attrs["ranks"]),
                timings={phase: float(data[()]) for phase, data in file["timings"].items()},
                remarks=from_json(file.attrs["remarks"]),
                plugins=needed,
            )
            try:
                _ = found.tables
            except tomllib.TOMLDecodeError as error:
                raise ValueError(f"its scene is no TOML: {error}") from error
            return found


@lru_cache(maxsize=4)  # the results of a run have one text, and a table of 10,000 rows takes 0.2 s
def _tables(scene_toml: str) -> dict[str, Any]:
    return tomllib.loads(scene_toml)


@contextmanager
def write_file(
    path: str | os.PathLike[str], kind: str, attributes: Mapping[str, Any] | None = None
) -> Iterator[h5py.File]:
    """Open a new HDF5 file of one of :data:`KINDS` with further root attributes for writing; it appears under ``path``
    when the block ends without an error.

    To be called by one process only. The block calls :meth:`RunRecord.write`. Raises `InputError` if `path` cannot be
    written (see :func:`~pgmp_petsc.files.claims.check_output`); `RunError` if the system fails to write (a full disk,
    say); an older file of the same kind is replaced, or left as it was.
    """
    if kind not in KINDS:
        raise ValueError(f"kind of file '{kind}'; allowed: {', '.join(KINDS)}")
    with replacing(check_output(path, kind)) as partial:
        with GuardedStream(partial) as stream:
            with h5py.File(
                partial, "w", driver="fileobj", fileobj=stream, userblock_size=SIZE, libver=_LIBRARIES
            ) as file:
                file.attrs["format_version"] = version_of(kind)
                file.attrs["program_version"] = __version__
                file.attrs["kind"] = kind
                for name, value in (attributes or {}).items():
                    file.attrs[name] = value
                yield file
            stream.finish()
        seal(partial, kind, version_of(kind))


def version_of(kind: str) -> int:
    return VERSIONS.get(kind, FORMAT_VERSION)


def open_file(path: str | os.PathLike[str], kinds: str | Collection[str]) -> h5py.File:
    """Open a result file for reading, after checking that it is whole and of one of ``kinds``; for a ``with`` block,
    with :func:`shapes_of` around what is read. Raises `InputError` if the file is missing, not HDF5, damaged, cut off,
    of another kind or format version, or lacks attributes."""
    kinds = (kinds,) if isinstance(kinds, str) else tuple(kinds)
    path = Path(path)
    _check_sealed(path, kinds)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"file '{path}' is damaged: {first_line(error)}; write it again") from error
    try:
        with shapes_of(file):
            _check_attributes(file, path, kinds)
    except Exception:
        file.close()
        raise
    return file


@contextmanager
def shapes_of(file: h5py.File | Path, cure: str = WRITE_AGAIN) -> Iterator[None]:
    """Turn what does not fit together in a file that is being read, or was, into an `InputError`, which ends with the
    cure."""
    try:
        yield
    except _MISFITS as error:
        reason = error.args[0] if error.args else type(error).__name__
        name = file if isinstance(file, Path) else file.filename
        raise InputError(f"file '{name}' is damaged: {reason}; {cure}") from error


def put(
    group: h5py.Group,
    name: str,
    data: Any,
    unit: str,
    description: str,
    further: Mapping[str, str] = MappingProxyType({}),
    like: str = "",
) -> None:
    """Write numbers, or an array of texts, with their ``unit`` ("1" if they have none), ``description`` and further
    attributes; or with those of the dataset ``like`` of the group, of equal shape, which takes half the time."""
    # files have thousands of small datasets: `create_dataset` and `attrs` take four times as long
    parent, _, own = name.rpartition("/")
    if parent:
        group = group.require_group(parent)  # which keeps the order of what is put there
    data = np.asarray(data, order="C")
    how, links, text, scalar = _of_datasets(own.isascii(), data.nbytes <= COMPACT)
    if like and data.nbytes <= COMPACT:  # a larger one would be copied with its numbers
        h5py.h5o.copy(group.id, like.encode(), group.id, own.encode(), lcpl=links)
        h5py.h5d.open(group.id, own.encode()).write(h5py.h5s.ALL, h5py.h5s.ALL, data)
        return
    kind = h5py.h5t.py_create(data.dtype, logical=True)
    space = h5py.h5s.create_simple(data.shape) if data.ndim else scalar
    dataset = h5py.h5d.create(group.id, own.encode(), kind, space, how, links)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, data)
    for attribute, value in (("unit", unit), ("description", description), *further.items()):
        h5py.h5a.create(dataset, attribute.encode(), text, scalar).write(np.array(value, dtype=TEXT))


@cache
def _of_datasets(ascii_names: bool, compact: bool) -> tuple[Any, Any, Any, Any]:
    """Return how datasets and their links are made, the type of texts, and the space of one."""
    how, links = h5py.h5p.create(h5py.h5p.DATASET_CREATE), h5py.h5p.create(h5py.h5p.LINK_CREATE)
    how.set_obj_track_times(False)
    how.set_layout(h5py.h5d.COMPACT if compact else h5py.h5d.CONTIGUOUS)
    links.set_char_encoding(h5py.h5t.CSET_ASCII if ascii_names else h5py.h5t.CSET_UTF8)
    return how, links, h5py.h5t.py_create(TEXT, logical=True), h5py.h5s.create(h5py.h5s.SCALAR)


def take(group: h5py.Group, name: str, n_dimensions: int, texts: bool = False) -> np.ndarray:
    """Read a dataset of numbers, or of texts, and check its number of dimensions. Raises `ValueError` if it is missing,
    has another number of dimensions, or holds something else; see `shapes_of`."""
    why = None
    if not isinstance(group, h5py.Group):  # a dataset would be searched for the name, number by number
        why = f"is missing: '{group.name}' is no group"
    elif (dataset := group.get(name)) is None:
        why = "is missing"
    elif not isinstance(dataset, h5py.Dataset):
        why = "is a group"
    elif (shape := dataset.shape) is None or len(shape) != n_dimensions:
        why = f"has shape {shape}; needed: {n_dimensions} dimension(s)"
    elif (h5py.check_string_dtype(kind := dataset.dtype) is not None) != texts or not texts and kind.kind not in "biuf":
        why = f"holds {kind}; needed: {'texts' if texts else 'numbers'}"
    # nothing is compressed: what is larger than the file was never written
    elif dataset.nbytes > h5py.h5i.get_file_id(group.id).get_filesize():
        why = f"has shape {shape}, more than the file holds"
    if why is not None:
        raise ValueError(f"dataset '{group.name.rstrip('/')}/{name}' {why}")
    return np.asarray(dataset[()])


def take_each(group: h5py.Group, n_dimensions: int, most: int | None = None) -> np.ndarray:
    """Read all datasets of a group, or the first `most`, which are alike, in the order of their names and with a
    leading axis of these; raises as `take`."""
    names = sorted(group)
    if not names:
        raise ValueError(f"group '{group.name}' is empty")
    first, names = take(group, names[0], n_dimensions), names[:most]
    found, kind = np.empty((len(names), *first.shape), first.dtype), h5py.h5t.py_create(first.dtype)
    for number, name in enumerate(names):  # a sixth of the time of `take`
        dataset = h5py.h5d.open(group.id, name.encode())
        if dataset.shape != first.shape:
            raise ValueError(f"dataset '{group.name}/{name}' has shape {dataset.shape}; needed: {first.shape}")
        dataset.read(h5py.h5s.ALL, h5py.h5s.ALL, found[number, ...], kind)
    return found


def _check_sealed(path: Path, kinds: tuple[str, ...]) -> None:
    """Raise `InputError` unless a file is whole and of one of ``kinds``, without reading it as HDF5."""
    try:
        if not path.exists():
            begun = f"; '{pieces}' has what a run has finished of it" if (pieces := pieces_path(path)).is_dir() else ""
            raise InputError(f"file '{path}' does not exist{begun}; needed: {_names(kinds)}")
        if not path.is_file():
            what = "a directory" if path.is_dir() else "a device, a pipe or a socket"
            raise InputError(f"'{path}' is {what}; needed: a file that holds {_names(kinds)}")
        if not os.access(path, os.R_OK):
            raise InputError(f"file '{path}': no permission to read it")
        found = check_seal(path)
    except BrokenSeal as broken:
        raise InputError(_unsealed(path, broken, kinds)) from broken
    except OSError as error:
        raise InputError(f"file '{path}' cannot be read: {first_line(error)}; needed: {_names(kinds)}") from error
    if found.kind not in kinds:
        cure = INSTEAD.get(found.kind, "") if kinds in (("rom",), ("components",)) else ""
        raise InputError(f"file '{path}' holds {named(found.kind)}; needed: {_names(kinds)}{cure}")
    if found.format != (own := version_of(found.kind)):
        reads = f"this pgmp {__version__} reads version {own}"
        cure = BUILD_AGAIN if found.kind in INSTEAD else WRITE_AGAIN
        raise InputError(f"file '{path}' has format version {found.format}; {reads}; {cure}")


def _unsealed(path: Path, broken: BrokenSeal, kinds: tuple[str, ...]) -> str:
    """Return what is wrong with a file without a good seal."""
    with open(path, "rb") as stream:
        head = stream.read(SIZE + len(SIGNATURE))
    if head.startswith(SIGNATURE):
        who = f"was not written by this pgmp {__version__}: an older one wrote it, or another program"
        return f"file '{path}' {who}; needed: {_names(kinds)}; write it again"
    if head.startswith(MAGIC) or head[SIZE:] == SIGNATURE:
        return f"file '{path}' is damaged: {broken}; {BUILD_AGAIN if set(kinds) <= INSTEAD.keys() else WRITE_AGAIN}"
    cure = ""
    if path.suffix.lower() == ".toml" and "rom" in kinds:
        cure = f": make it of the scene with 'pgmp build {shlex.quote(str(path))} -o ROM.h5'"
        cure += ", or give --components, or for runs and samples --full" if kinds == ("rom",) else ""
    return f"file '{path}' is not an HDF5 file; needed: {_names(kinds)} written by pgmp{cure}"


def _check_attributes(file: h5py.File, path: Path, kinds: tuple[str, ...]) -> None:
    """Raise `InputError` unless the root attributes are those of a file of one of ``kinds``."""
    missing = [name for name in _REQUIRED if name not in file.attrs]
    if missing:
        raise InputError(f"file '{path}' lacks the attribute(s) {', '.join(missing)}; write it again")
    version, kind = file.attrs["format_version"], file.attrs["kind"]
    if str(kind) not in kinds or str(version) != str(version_of(str(kind))):
        raise InputError(f"file '{path}' is damaged: its attributes say {kind}, version {version}; write it again")


def _names(kinds: tuple[str, ...]) -> str:
    """Return the kinds as words: 'a trajectory, an ensemble or a table of modes'."""
    *others, last = map(named, kinds)
    return f"{', '.join(others)} or {last}" if others else last


WITH_UNIT = re.compile(r"(.*?)\s*\((.*)\)")
#: What other programs put between columns.
OTHERS = {";": "semicolons", "\t": "tabs"}


def csv_table(
    stream: TextIO, where: str, units: Mapping[str, str]
) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """Return the names of the columns of a stream, opened with ``encoding="utf-8-sig", newline=""``, and the rows with
    the numbers of their lines, read one by one.

    Units are by name those of each column that has a part; empty where only the scene's units are known. Raises
    `InputError`, in which `where` names the file, if columns are separated otherwise, one of these is there twice or in
    another unit, or a row has more or fewer entries.
    """
    rows = csv.reader(stream, skipinitialspace=True)
    first = [name.strip() for name in next(rows, [])]
    for sign, plural in OTHERS.items():
        if len(first) == 1 and sign in first[0]:
            what = f"columns are separated by {plural} ('{shortened(' '.join(first[0].split()), 60)}')"
            raise InputError(f"{where}: {what}; commas are needed, and points in numbers")
    names = [without_unit(name, where, units) for name in first]
    for name in units:
        if names.count(name) > 1:
            raise InputError(f"{where}: {names.count(name)} columns are called '{name}'; one is needed")
    return names, _rows(rows, len(names), where)


def without_unit(column: str, where: str, units: Mapping[str, str]) -> str:
    """Return the name of a column without its unit, which has to be the one that is asked for."""
    parts = WITH_UNIT.fullmatch(column)
    if column in units or parts is None or parts[1] not in units:
        return column
    name, unit = parts.groups()
    if unit.strip() != units[name]:
        needed = units[name] or "the scene's units"
        raise InputError(f"{where}: the column '{column}' has to be in {needed}: convert it, and name it '{name}'")
    return name


def _rows(rows: Iterator[list[str]], n_columns: int, where: str) -> Iterator[tuple[int, list[str]]]:
    for row in rows:
        if row and len(row) != n_columns:
            what = f"line {rows.line_num} has {len(row)} entries; the first line names {n_columns} columns"
            raise InputError(f"{where}: {what}")
        if row:
            yield rows.line_num, row
