"""The file of a shard: samples of a part of an ensemble, for ``pgmp merge`` to join with the others.

===================== =============== ==========================================================================
dataset               shape           meaning
===================== =============== ==========================================================================
``/columns/<name>``   (n)             what is known of each sample: ``<kind>.<name>``, with colons for slashes
``/bands/<name>``     (n_known, n_t)  outputs over time of those samples that bands are of
===================== =============== ==========================================================================

The root attribute ``shard`` says, as JSON, which part this is of which ensemble.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_model, take_known
from pgmp_petsc.runtime.errors import Remark, from_json, to_json
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file

KIND = "shard"


@dataclass(frozen=True)
class Place:
    """Which part of which ensemble a shard is.

    Attributes
    ----------
    number, count
        Of the shard, from 1, and of shards.
    n_samples
        Of the whole ensemble.
    first
        Number of the first sample.
    run
        What the ensemble is, by key; the same for all shards.
    file
        Of the samples where they are from a file: its path, the identity of its content and the parameters it gives.
    """

    number: int
    count: int
    n_samples: int
    first: int
    run: dict[str, object]
    file: dict[str, object] | None = None


@dataclass(frozen=True)
class ShardSamples:
    """The samples of a shard.

    Attributes
    ----------
    model
        ``full``, ``components`` or ``reduced``.
    record
        Where they came from; its remarks are those on the scene.
    place
        Which they are.
    units
        Of the outputs, by name.
    not_estimated, file_remarks
        What is to be said of errors that are not estimated, and of a file of samples.
    checked_share
        Of the samples whose errors are estimated.
    found
        What the checkpoint said of pieces that it did not take up.
    columns
        By ``<kind>.<name>``, and ``status`` and ``failure_time``, each (n,).
    bands
        By output, each (n_known, n_t).
    """

    model: str
    record: RunRecord
    place: Place
    units: dict[str, str]
    not_estimated: tuple[Remark, ...]
    file_remarks: tuple[Remark, ...]
    checked_share: float
    found: tuple[Remark, ...]
    columns: Mapping[str, np.ndarray]
    bands: Mapping[str, np.ndarray]

    @property
    def status(self) -> np.ndarray:
        """How each sample ended, 0 = fine, shape (n,)."""
        return self.columns["status"]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        with write_file(path, KIND, {"model": self.model}) as file:
            self.record.write(file)
            file.attrs["shard"] = json.dumps(vars(self.place))
            file.attrs["units"] = json.dumps(self.units)
            file.attrs["checked_share"] = self.checked_share
            for name in REMARKS:
                file.attrs[name] = to_json(getattr(self, name))
            _put_all(file, "columns", self.columns, "of each sample")
            _put_all(file, "bands", self.bands, "over time, one sample a row")


PARAMETERS = "parameters."  # before the names of columns that are parameters
REMARKS = ("not_estimated", "file_remarks", "found")


@contextmanager
def read_shard(path: str | os.PathLike[str]) -> Iterator[ShardSamples]:
    """Read a shard; its arrays are read one by one, within the block.

    Raises
    ------
    InputError
        If the file is none of a shard, or not whole.
    """
    with open_file(path, KIND) as file:
        with shapes_of(file):
            place = Place(**json.loads(file.attrs["shard"]))
            model, units = str(file.attrs["model"]), json.loads(file.attrs["units"])
            check_model(model)
            remarks = {name: from_json(file.attrs[name]) for name in REMARKS}
            columns, bands = _Stored(file, "columns", 1), _Stored(file, "bands", 2)
            _check(columns, bands, units)
            shard = ShardSamples(
                model, RunRecord.read(file), place, units, checked_share=float(file.attrs["checked_share"]),
                columns=columns, bands=bands, **remarks,
            )  # fmt: skip
        yield shard


def _put_all(file: h5py.File, group: str, arrays: Mapping[str, np.ndarray], about: str) -> None:
    """Write arrays; a slash in a name would make a group."""
    target = file.create_group(group, track_order=True)
    for name, values in arrays.items():
        put(target, name.replace("/", ":"), values, "SI", f"{name} {about}")


def _check(columns: _Stored, bands: _Stored, units: object) -> None:
    """Raise `ValueError` unless columns are of the same samples, and bands of the first of them at equal instants."""
    if not isinstance(units, dict):
        raise ValueError(f"units are {units!r}; needed: one of every output")
    n, lengths = columns.shape_of("status"), {columns.shape_of(name) for name in columns}
    if len(n) != 1 or lengths != {n}:
        raise ValueError(f"columns of samples have shapes {sorted(lengths)}; needed: one length")
    shapes = {bands.shape_of(name) for name in bands}
    if len(shapes) > 1 or any(len(shape) != 2 or shape[0] > n[0] for shape in shapes):
        raise ValueError(f"bands have shapes {sorted(shapes)}; needed: one, of at most {n[0]} rows")


class _Stored(Mapping[str, np.ndarray]):
    """Arrays of a group, read when they are asked for."""

    def __init__(self, file: h5py.File, group: str, n_dimensions: int) -> None:
        self._file, self._group, self._n_dimensions = file, file[group], n_dimensions
        if not isinstance(self._group, h5py.Group):
            raise TypeError(f"'/{group}' is no group")

    def __getitem__(self, name: str) -> np.ndarray:
        with shapes_of(self._file):
            read = take_known if name.startswith(PARAMETERS) else take
            return read(self._group, name.replace("/", ":"), self._n_dimensions)

    def shape_of(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array without reading it."""
        return self._group[name.replace("/", ":")].shape

    def __iter__(self) -> Iterator[str]:
        return (name.replace(":", "/") for name in self._group)

    def __len__(self) -> int:
        return len(self._group)
