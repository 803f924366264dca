"""Standard output that a run outlives: where it cannot be written, the run goes on and the failure is told at its end.

A full disk under ``pgmp ... > log`` must not cost the results of hours, and a reader that has gone (``pgmp info F |
head``) is no error to be told at all.
"""

from __future__ import annotations

import io
import os
import re
from typing import TextIO

from pgmp_petsc.runtime.progress import clear_beat

_OBEYED = re.compile(rb"[\x00-\x08\x0b-\x1f\x7f]|\xc2[\x80-\x9f]")  # by terminals, in UTF-8


class LastingOutput(io.RawIOBase):
    """Writes to a file descriptor until that fails, and swallows what comes after.

    Parameters
    ----------
    descriptor
        Stays open.

    Attributes
    ----------
    failure
        The first failure, or None.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.failure: OSError | None = None

    def writable(self) -> bool:
        """It is."""
        return True

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Return whether somebody looks at it."""
        return os.isatty(self._descriptor)

    def write(self, data: bytes) -> int:
        """Write what can be written; what terminals obey is shown instead, as of `errors.visible`."""
        rest = _OBEYED.sub(lambda found: b"\\x%02x" % found[0][-1], bytes(data))
        if self.failure is None:
            clear_beat()
        while rest and self.failure is None:
            try:
                rest = rest[os.write(self._descriptor, rest) :]
            except OSError as error:
                self.failure = error
        return len(data)

    def text(self, encoding: str) -> TextIO:
        """Return a text stream on it that is written line by line; what the encoding lacks is escaped."""
        return io.TextIOWrapper(io.BufferedWriter(self), encoding, errors="backslashreplace", line_buffering=True)


def descriptor_of(stream: TextIO | None) -> int | None:
    """Return the descriptor under a text stream, None where there is none."""
    try:
        return None if stream is None else stream.fileno()
    except (OSError, ValueError):
        return None
