"""HDF5 files of results: written whole or not at all, checked when opened.

A file is written by one process (rank 0) beside its target and renamed when it is complete, so a file under
its final name is never half written, and one that it replaces stays until then. Every file has

===================== ==========================================================================
attribute             meaning
===================== ==========================================================================
``format_version``    integer, :data:`FORMAT_VERSION`
``program_version``   version of pgmp_petsc that wrote it
``kind``              ``rom``, ``trajectory``, ``ensemble``, ``modes`` or ``tradeoff``
``scene``             the resolved scene as TOML
``parameters``        parameter values as a JSON object, SI units
``seed``              seed of the random streams; an empty (null) attribute where there is none
``ranks``             number of MPI ranks of the run
``remarks``           warnings and notes as JSON, see :mod:`pgmp_petsc.runtime.remarks`
===================== ==========================================================================

and scalar datasets ``/timings/<phase>``: wall time in s, maximum over the ranks. Every dataset has the
attributes ``unit`` and ``description``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc import __version__
from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.remarks import Remark, from_json, to_json
from pgmp_petsc.runtime.streams import GuardedStream, first_line, synchronise_directory

if TYPE_CHECKING:
    import h5py

FORMAT_VERSION = 2
KINDS = {
    "rom": "reduced model",
    "trajectory": "trajectory",
    "ensemble": "ensemble",
    "modes": "table of modes",
    "tradeoff": "trade-off study",
}
_REQUIRED = ("format_version", "program_version", "kind", "scene", "parameters", "seed", "ranks", "remarks")


@dataclass(frozen=True)
class RunRecord:
    """Where a result came from: enough to repeat the run.

    Parameters
    ----------
    scene_toml : str
        The resolved scene.
    parameters : dict of str to float
        Values that the run used, SI units (for an ensemble the nominal ones).
    seed : int or None
        Seed of the random streams, None where nothing is random.
    ranks : int
        Number of MPI ranks.
    timings : dict of str to float
        Wall time a phase, s.
    remarks : tuple of Remark
        What the reader of the result has to know.
    """

    scene_toml: str
    parameters: dict[str, float]
    seed: int | None
    ranks: int
    timings: dict[str, float] = field(default_factory=dict)
    remarks: tuple[Remark, ...] = ()

    def write(self, file: h5py.File) -> None:
        """Write the record into the root attributes and ``/timings`` of an open file."""
        import h5py

        file.attrs["scene"] = self.scene_toml
        file.attrs["parameters"] = json.dumps({name: float(value) for name, value in self.parameters.items()})
        file.attrs["seed"] = h5py.Empty("i8") if self.seed is None else self.seed
        file.attrs["ranks"] = self.ranks
        file.attrs["remarks"] = to_json(self.remarks)
        timings = file.create_group("timings", track_order=True)
        for phase, seconds in self.timings.items():
            put(timings, phase, float(seconds), "s", f"wall time of phase '{phase}', maximum over the ranks")

    @classmethod
    def read(cls, file: h5py.File) -> RunRecord:
        """Read the record of a file opened with :func:`open_file`."""
        seed = file.attrs["seed"]
        return cls(
            scene_toml=str(file.attrs["scene"]),
            parameters=json.loads(file.attrs["parameters"]),
            seed=int(seed) if isinstance(seed, (int, np.integer)) else None,
            ranks=int(file.attrs["ranks"]),
            timings={phase: float(data[()]) for phase, data in file.get("timings", {}).items()},
            remarks=from_json(file.attrs["remarks"]),
        )


def check_writable(path: str | os.PathLike[str]) -> Path:
    """Check, before long work, that a file can be written at ``path``, and return it as a `Path`.

    Raises
    ------
    InputError
        If the path is a directory, or its directory does not exist or cannot be written to.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"output file '{path}' is a directory; give the name of a file in it")
    if not path.parent.is_dir():
        raise InputError(f"output file '{path}': directory '{path.parent}' does not exist; create it first")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"output file '{path}': no permission to write in directory '{path.parent}'")
    return path


@contextmanager
def write_file(
    path: str | os.PathLike[str], kind: str, attributes: Mapping[str, Any] | None = None
) -> Iterator[h5py.File]:
    """Open a new HDF5 file for writing; it appears under ``path`` when the block ends without an error.

    To be called by one process only. The block calls :meth:`RunRecord.write`.

    Parameters
    ----------
    path : path-like
        Target; an existing file is replaced.
    kind : str
        One of :data:`KINDS`.
    attributes : mapping, optional
        Further root attributes.

    Raises
    ------
    InputError
        If `path` cannot be written (see :func:`check_writable`).
    RunError
        If the system fails to write (a full disk, say); an older file under `path` is left as it was.
    """
    import h5py

    if kind not in KINDS:
        raise ValueError(f"kind of file '{kind}'; allowed: {', '.join(KINDS)}")
    # A symbolic link is written through, not replaced.
    target = Path(os.path.realpath(check_writable(path)))
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
    try:
        with GuardedStream(partial) as stream:
            with h5py.File(partial, "w", driver="fileobj", fileobj=stream) as file:
                file.attrs["format_version"] = FORMAT_VERSION
                file.attrs["program_version"] = __version__
                file.attrs["kind"] = kind
                for name, value in (attributes or {}).items():
                    file.attrs[name] = value
                yield file
            stream.finish()
        os.replace(partial, target)
        synchronise_directory(target.parent)
    except OSError as error:
        raise RunError(f"output file '{path}' could not be written: {first_line(error)}") from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def open_file(path: str | os.PathLike[str], kinds: str | Collection[str]) -> h5py.File:
    """Open a result file for reading, after checking that it is whole and of one of ``kinds``.

    Returns
    -------
    h5py.File
        Use it in a ``with`` block.

    Raises
    ------
    InputError
        If the file is missing, not HDF5, cut off, of another kind or format version, or lacks attributes.
    """
    import h5py

    kinds = (kinds,) if isinstance(kinds, str) else tuple(kinds)
    path = Path(path)
    if not path.exists():
        raise InputError(f"file '{path}' does not exist; needed: {_names(kinds)}")
    if not path.is_file():
        raise InputError(f"'{path}' is a directory; needed: a file that holds {_names(kinds)}")
    if not os.access(path, os.R_OK):
        raise InputError(f"file '{path}': no permission to read it")
    if not h5py.is_hdf5(path):
        raise InputError(f"file '{path}' is not an HDF5 file; needed: {_names(kinds)} written by pgmp")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InputError(
            f"file '{path}' is damaged or cut off and cannot be opened ({first_line(error)}); write it again"
        ) from error
    try:
        _check_attributes(file, path, kinds)
    except Exception:
        file.close()
        raise
    return file


def put(group: h5py.Group, name: str, data: Any, unit: str, description: str) -> h5py.Dataset:
    """Write a dataset with its ``unit`` ("1" if it has none) and ``description``; return it."""
    dataset = group.create_dataset(name, data=data)
    dataset.attrs["unit"] = unit
    dataset.attrs["description"] = description
    return dataset


def take(group: h5py.Group, name: str, n_dimensions: int) -> np.ndarray:
    """Read a dataset and check its number of dimensions.

    Raises
    ------
    InputError
        If it is missing or has another number of dimensions.
    """
    where = f"file '{group.file.filename}': dataset '{group.name.rstrip('/')}/{name}'"
    if name not in group:
        raise InputError(f"{where} is missing; write the file again")
    data = np.asarray(group[name][()])
    if data.ndim != n_dimensions:
        raise InputError(f"{where} has shape {data.shape}; needed: {n_dimensions} dimension(s)")
    return data


def _check_attributes(file: h5py.File, path: Path, kinds: tuple[str, ...]) -> None:
    """Raise `InputError` unless the root attributes are those of a file of one of ``kinds``."""
    attributes = file.attrs
    if "format_version" not in attributes or "kind" not in attributes:
        raise InputError(f"file '{path}' was not written by pgmp; needed: {_names(kinds)}")
    version, kind = attributes["format_version"], attributes["kind"]
    if version != FORMAT_VERSION:
        writer = attributes.get("program_version", "unknown")
        raise InputError(
            f"file '{path}' has format version {version} (pgmp {writer}); this pgmp {__version__} reads "
            f"version {FORMAT_VERSION}; write the file again"
        )
    if kind not in kinds:
        raise InputError(f"file '{path}' holds a {KINDS.get(kind, kind)}; needed: {_names(kinds)}")
    missing = [name for name in _REQUIRED if name not in attributes]
    if missing:
        raise InputError(f"file '{path}' lacks the attribute(s) {', '.join(missing)}; write it again")


def _names(kinds: tuple[str, ...]) -> str:
    """Return the kinds as words: 'a trajectory or a table of modes'."""
    return " or ".join(f"{'an' if kind == 'ensemble' else 'a'} {KINDS[kind]}" for kind in kinds)
