"""Files of other formats than HDF5, made in memory: written beside their target and renamed when they are complete."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.streams import first_line, synchronise_directory


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is whole, or as it was before; by one process only.

    Raises
    ------
    RunError
        If the system fails to write: a full disk, say.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with open(partial, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, path)
        synchronise_directory(path.parent)
    except OSError as error:
        raise RunError(f"output file '{path}' could not be written: {first_line(error)}") from error
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
