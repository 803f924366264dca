"""The seal at the head of a file that this program writes: what it is, how long, and a checksum of all of it.

A file is checked as a whole before a byte of it is interpreted: what was cut off, changed in any bit, or is somebody
else's is known at once, and never reaches the HDF5 library, which crashes or hangs on some damaged files. The seal
takes up the first `SIZE` bytes, as text::

    pgmp_petsc
    {"bytes": 81920, "format": 2, "kind": "trajectory", "run": "", "sha256": "9f86d0..."}

filled up with blanks. For HDF5 they are the file's user block, which every reader of HDF5 skips. The checksum covers
the other entries of the seal and all that follows it, so that no bit of the file is outside. Checking reads the file
once. It tells accidents; against forgery there would have to be a secret.

The identity of data: a checksum that is equal where, and only where, all of it is equal to the bit.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np


def identity(*values: object) -> str:
    """Return a checksum of arrays, numbers, texts, and of mappings, sequences and dataclasses of these, hexadecimal.

    Fields that a dataclass leaves out of comparisons are left out here too; the order of a mapping counts. Raises
    `TypeError` if there is anything else in them.
    """
    digest = hashlib.sha256()
    for part in _parts(values):
        digest.update(part)
    return digest.hexdigest()


def _parts(value: object) -> Iterator[bytes | memoryview]:
    """Yield bytes from which the value could be made again: type and length go before each content."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufcUS":
        yield f"array {value.dtype.str} {value.shape};".encode()
        yield memoryview(np.ascontiguousarray(value).reshape(-1).view(np.uint8))
    elif is_dataclass(value) and not isinstance(value, type):
        compared = [item.name for item in fields(value) if item.compare]
        yield f"{type(value).__name__} {len(compared)};".encode()
        for name in compared:
            yield from _parts((name, getattr(value, name)))
    elif isinstance(value, Mapping):
        yield f"mapping {len(value)};".encode()
        for entry in value.items():
            yield from _parts(entry)
    elif isinstance(value, (tuple, list)):
        yield f"sequence {len(value)};".encode()
        for entry in value:
            yield from _parts(entry)
    elif value is None or isinstance(value, (str, bytes, bool, int, float, np.number, np.bool_)):
        text = repr(value.item() if isinstance(value, np.generic) else value).encode()
        yield f"value {len(text)};".encode()
        yield text
    else:
        raise TypeError(f"no identity of {type(value).__name__}")


SIZE = 512  # the smallest user block of HDF5
SIGNATURE = b"\x89HDF\r\n\x1a\n"  # of an HDF5 file, behind its user block
MAGIC = b"pgmp_petsc\n"
_CHUNK = 1 << 20


class BrokenSeal(Exception):
    """A file is not what its seal says, or has none; the message is a clause with the reason."""


@dataclass(frozen=True)
class Seal:
    """Contents of a seal."""

    kind: str  # what the file holds
    format: int  # version of the layout of that kind
    run: str = ""  # identity of the run that the file belongs to, where it is a piece of one
    bytes: int = 0  # length of the whole file
    sha256: str = ""  # checksum, hexadecimal

    def packed(self) -> bytes:
        """Return the first `SIZE` bytes of the file."""
        text = MAGIC + json.dumps(asdict(self), sort_keys=True).encode()
        if len(text) >= SIZE:
            raise ValueError(f"a seal of {len(text)} bytes; allowed: {SIZE - 1}")
        return text.ljust(SIZE - 1) + b"\n"

    @classmethod
    def unpacked(cls, head: bytes) -> Seal:
        """Return what the head of a file says; raises `BrokenSeal` where it is no seal."""
        if not head.startswith(MAGIC):
            raise BrokenSeal("it has no seal of this program")
        if len(head) < SIZE:
            raise BrokenSeal(f"it is cut off after {len(head)} bytes")
        try:
            seal = cls(**json.loads(head[len(MAGIC) :]))
            if seal.packed() != head:
                raise ValueError
        except (ValueError, TypeError, RecursionError):
            raise BrokenSeal("its first bytes have changed since it was written") from None
        return seal


def seal(path: Path, kind: str, format_version: int, run: str = "") -> None:
    """Seal a finished file whose first `SIZE` bytes are free, and push it to the disk; raises `OSError` if the system
    fails to read or write."""
    with open(path, "r+b") as stream:
        unsigned = Seal(kind, format_version, run, stream.seek(0, os.SEEK_END))
        stream.seek(SIZE)
        signed = replace(unsigned, sha256=_checksum(unsigned, stream))
        stream.seek(0)
        stream.write(signed.packed())
        stream.flush()
        os.fsync(stream.fileno())


def sealed(content: bytes | memoryview, kind: str, format_version: int, run: str) -> bytes:
    """Return content with its seal ahead of it: a whole file."""
    unsigned = Seal(kind, format_version, run, SIZE + len(content))
    digest = hashlib.sha256(unsigned.packed())
    digest.update(content)
    return b"".join((replace(unsigned, sha256=digest.hexdigest()).packed(), content))


def seal_of(path: Path) -> Seal:
    """Return what the seal of a file says, without checking the rest of it. Raises `BrokenSeal` if it has none: a pipe,
    which may never end, is not read."""
    if path.exists() and not path.is_file():
        raise BrokenSeal("it is no regular file")
    with open(path, "rb") as stream:
        return Seal.unpacked(stream.read(SIZE))


def kind_of(path: Path) -> str:
    """Return the kind that a file's seal names; "" of others. What is wrong with a file is said where it is read."""
    try:
        return seal_of(path).kind
    except (OSError, BrokenSeal):
        return ""


def check_seal(path: Path) -> Seal:
    """Check a file as a whole, and return what its seal says. Raises `BrokenSeal` if it has no seal, is cut off or too
    long, or differs from its checksum; `OSError` if the system fails to read."""
    with open(path, "rb") as stream:
        found = Seal.unpacked(stream.read(SIZE))
        n_bytes = os.fstat(stream.fileno()).st_size
        if n_bytes < found.bytes:
            raise BrokenSeal(f"it is cut off after {n_bytes} of {found.bytes} bytes")
        if n_bytes > found.bytes:
            raise BrokenSeal(f"it has {n_bytes} bytes instead of {found.bytes}: it was changed since it was written")
        if _checksum(replace(found, sha256=""), stream) != found.sha256:
            raise BrokenSeal("it differs from its checksum: it was changed since it was written")
    return found


def _checksum(unsigned: Seal, stream: BinaryIO) -> str:
    """Return the checksum of a seal without one, and of what follows in the stream."""
    digest = hashlib.sha256(unsigned.packed())
    while chunk := stream.read(_CHUNK):
        digest.update(chunk)
    return digest.hexdigest()
