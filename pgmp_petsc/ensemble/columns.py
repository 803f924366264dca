"""Columns of an ensemble, one number a sample, in a file: memory holds one of them at a time, however many samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from pgmp_petsc.runtime.errors import RunError

_NUMBER = np.dtype(np.float64)
_AT_ONCE = 1 << 16  # numbers


class Columns(Mapping[str, np.ndarray]):
    """Columns (n_samples,) by name, read when they are asked for; NaN where nothing was put.

    Parameters
    ----------
    path
        The file, which is made anew.
    n_samples
        Length of every column.
    """

    def __init__(self, path: Path, n_samples: int) -> None:
        self._path, self._n_samples = path, n_samples
        self._places: dict[str, int] = {}
        with self._written("wb"):
            pass

    def put(self, first: int, columns: Mapping[str, np.ndarray]) -> None:
        """Put in what is known of samples first, first + 1, and so on.

        Raises
        ------
        RunError
            If the system fails to write.
        """
        with self._written("r+b") as file:
            for name, values in columns.items():
                if name not in self._places:
                    self._add(name, file)
                file.seek(self._offset(name) + first * _NUMBER.itemsize)
                file.write(np.ascontiguousarray(values, dtype=_NUMBER))

    def of(self, kind: str) -> Mapping[str, np.ndarray]:
        """Return the columns whose names begin with ``<kind>.``, by what follows."""
        return _Part(self, kind)

    @contextmanager
    def _written(self, mode: str) -> Iterator[BinaryIO]:
        try:
            with open(self._path, mode) as file:
                yield file
        except OSError as error:
            raise RunError(f"'{self._path}' could not be written: {error.strerror}") from error

    def _add(self, name: str, file: BinaryIO) -> None:
        """Add a column of NaN."""
        self._places[name] = len(self._places)
        file.seek(self._offset(name))
        for begin in range(0, self._n_samples, _AT_ONCE):
            file.write(np.full(min(_AT_ONCE, self._n_samples - begin), np.nan))

    def _offset(self, name: str) -> int:
        return self._places[name] * self._n_samples * _NUMBER.itemsize

    def __getitem__(self, name: str) -> np.ndarray:
        return np.fromfile(self._path, _NUMBER, self._n_samples, offset=self._offset(name))

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class _Part(Mapping[str, np.ndarray]):
    """The columns of one kind."""

    def __init__(self, columns: Columns, kind: str) -> None:
        self._columns, self._kind = columns, f"{kind}."

    def __getitem__(self, name: str) -> np.ndarray:
        return self._columns[self._kind + name]

    def __iter__(self) -> Iterator[str]:
        return (name.removeprefix(self._kind) for name in self._columns if name.startswith(self._kind))

    def __len__(self) -> int:
        return sum(1 for _ in self)
