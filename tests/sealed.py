"""Result files that somebody changed, with a seal that fits: their content is checked by their readers alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py

from pgmp_petsc.runtime.seal import seal, seal_of


@contextmanager
def resealed(path: Path, **changed: object) -> Iterator[h5py.File]:
    """Open a result for changes, and seal it again with what is to be changed in the seal."""
    before = seal_of(path)
    with h5py.File(path, "r+") as file:
        yield file
    after = replace(before, **changed)
    seal(path, after.kind, after.format, after.run)
