"""A stream under an HDF5 file that is being written, which keeps HDF5 alive when the disk is full.

The HDF5 library does not survive a failed write: closing the file fails too, and the process ends with a
segmentation fault (seen with HDF5 1.10, h5py 3.7). HDF5 therefore writes through :class:`GuardedStream`,
which remembers the first failure, pretends that all is well until HDF5 has closed its file, and then raises.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any


class GuardedStream:
    """A new file under an `h5py.File` (driver ``fileobj``) whose failures come out in :meth:`finish` alone.

    Used in a ``with`` block, which closes it.
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

    def write(self, data: Any) -> int:
        """Write at the current position."""
        return self._guarded(self._stream.write, data, instead=len(data))

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position, which may push earlier data to the disk."""
        return self._guarded(self._stream.seek, offset, whence, instead=offset)

    def truncate(self, size: int) -> int:
        """Set the length."""
        return self._guarded(self._stream.truncate, size, instead=size)

    def flush(self) -> None:
        """Push data to the system."""
        self._guarded(self._stream.flush, instead=0)

    def tell(self) -> int:
        """Return the position."""
        return self._guarded(self._stream.tell, instead=0)

    def readinto(self, buffer: Any) -> int:
        """Read into a buffer."""
        return self._guarded(self._stream.readinto, buffer, instead=len(buffer))

    def finish(self) -> None:
        """Push everything to the disk; raise the first `OSError` of this or any earlier operation."""
        self.flush()
        self._guarded(os.fsync, self._stream.fileno(), instead=0)
        if self._failure is not None:
            raise self._failure

    def __enter__(self) -> GuardedStream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # Closing flushes what a failure has left in the buffer and fails again.
        self._guarded(self._stream.close, instead=0)
        if not self._stream.closed:
            try:
                self._stream.close()
            except OSError:
                self._stream.raw.close()


def synchronise_file(path: Path) -> None:
    """Push a file to the disk; raises `OSError` if the system fails to write it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def synchronise_directory(directory: Path) -> None:
    """Push the names in a directory to the disk; that some file systems refuse to is no error."""
    with suppress(OSError):
        synchronise_file(directory)


def first_line(error: OSError) -> str:
    """Return what the system says ("No space left on device"), or else the first line of the message."""
    if error.errno:
        return os.strerror(error.errno)
    return (str(error).splitlines() or [type(error).__name__])[0]
