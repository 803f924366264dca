"""Files that somebody changed, with a seal that fits: their content is checked by their readers alone."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from pgmp_petsc.files.seal import SIZE, seal, seal_of


@contextmanager
def resealed(path: Path, **changed: object) -> Iterator[h5py.File]:
    """Open a result for changes, and seal it again with what is to be changed in the seal."""
    before = seal_of(path)
    with h5py.File(path, "r+") as file:
        yield file
    after = replace(before, **changed)
    seal(path, after.kind, after.format, after.run)


@contextmanager
def resealed_piece(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """Give the arrays of a checkpoint's piece for changes, and seal it again as the same run's."""
    before = seal_of(path)
    with np.load(io.BytesIO(path.read_bytes()[SIZE:])) as data:
        arrays = dict(data)
    yield arrays
    archive = io.BytesIO()
    np.savez(archive, **arrays)
    path.write_bytes(bytes(SIZE) + archive.getvalue())
    seal(path, before.kind, before.format, before.run)
