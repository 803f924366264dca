"""Raw tables of a scene before they are validated: what no entry may hold, wherever it stands.

Deep tables end in recursion, null bytes and lone surrogates in system calls and HDF5: they are refused here for all.
"""

from __future__ import annotations

import stat
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgmp_petsc.runtime.errors import InputError, nearest_name, shortened
from pgmp_petsc.scene.messages import DEEPEST, dotted_name, problem, toml_text

MOST_BYTES = 16_000_000  # of a scene's file
LONGEST_TEXT = 10_000  # characters
SHOWN_KEYS = 4  # of a path that is too deep


def read_text(path: Path) -> str:
    """Return the text of a scene's file.

    Raises
    ------
    InputError
        If there is none, it is a directory, pipe or device, too large, or no text in UTF-8.
    """
    try:
        kind = path.stat()
        if stat.S_ISDIR(kind.st_mode):
            raise InputError(f"{path}: this is a directory; a scene is a TOML file")
        if not stat.S_ISREG(kind.st_mode):
            raise InputError(f"{path}: this is a device or a pipe; a scene is a TOML file")
        if kind.st_size > MOST_BYTES:
            raise InputError(
                f"{path}: has {kind.st_size:,} bytes; a scene is a TOML file of at most {MOST_BYTES:,} bytes"
            )
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such scene file{_beside(path)}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8 (byte {error.start}); a scene is a TOML file") from error
    except (OSError, ValueError) as error:  # no permission, a loop of links, a name too long or with a null byte
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{shortened(str(path))}: the scene file cannot be read ({reason})") from error
    return text.removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}")  # some editors' mark of UTF-8


def parse(text: str, source: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `source` begins the message.

    Raises
    ------
    InputError
        If it is no TOML.
    """
    try:
        return tomllib.loads(text)
    except ValueError as error:  # tomllib's own, or Python's for an integer of thousands of digits
        raise InputError(f"{source}: not valid TOML: {shortened(' '.join(str(error).split()))}") from error
    except RecursionError as error:
        raise InputError(f"{source}: tables or lists within each other, deeper than {DEEPEST}") from error


def check_tables(data: Mapping[str, Any]) -> None:
    """Refuse tables that are too deep, and texts too long or with characters that are none.

    Raises
    ------
    InputError
        Naming the entry.
    """
    waiting: list[tuple[tuple[str | int, ...], object]] = [((), data)]
    while waiting:
        keys, value = waiting.pop()
        if len(keys) > DEEPEST:
            raise InputError(
                problem(dotted_name(keys[:SHOWN_KEYS]), f"tables or lists within each other, deeper than {DEEPEST}")
            )
        if isinstance(value, Mapping):
            for key, item in value.items():
                _check_text(key, dotted_name(keys) or "the scene", "a key")
                waiting.append(((*keys, key), item))
        elif isinstance(value, list):
            waiting += [((*keys, k), item) for k, item in enumerate(value)]
        elif isinstance(value, str):
            _check_text(value, dotted_name(keys), "a text")


def _check_text(text: str, entry: str, what: str) -> None:
    if len(text) > LONGEST_TEXT:
        raise InputError(f"{shortened(entry)}: {what} of {len(text):,} characters; at most {LONGEST_TEXT:,} are taken")
    if "\0" in text or not _encodable(text):
        raise InputError(
            f"{shortened(entry)}: {what} with characters that no file takes (null, or bytes that are no UTF-8): "
            f"{toml_text(text)}"
        )


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _beside(path: Path) -> str:
    try:
        beside = [candidate.name for candidate in path.parent.glob("*.toml")]
    except OSError:
        beside = []
    return f"{nearest_name(path.name, beside)} in {path.parent}" if beside else ""


def read_values(data: Mapping[str, Any], directory: Path) -> None:
    """Put the numbers of a file in the place of its name, in ``values`` of distributions: a scene carries all it is of.

    Raises
    ------
    InputError
        If a file cannot be read, or something in it is no number.
    """
    parameters = data.get("parameters")
    for name, parameter in (parameters if isinstance(parameters, dict) else {}).items():
        law = parameter.get("distribution") if isinstance(parameter, dict) else None
        _read_law(law, f"parameters.{name}.distribution", directory)


def _read_law(law: object, entry: str, directory: Path) -> None:
    if not isinstance(law, dict):
        return
    if isinstance(law.get("values"), str):
        law["values"] = _numbers_of(law["values"], f"{entry}.values", directory)
    parts = law.get("of")
    for number, part in enumerate(parts if isinstance(parts, list) else ()):
        _read_law(part, f"{entry}.of[{number}]", directory)


def _numbers_of(name: str, entry: str, directory: Path) -> list[float]:
    """Return the numbers of a file, one a line, behind a name in the first line or none."""
    try:
        path = directory / name
        if path.is_file() and path.stat().st_size > MOST_BYTES:
            raise InputError(problem(entry, f"the file has more than {MOST_BYTES:,} bytes; take fewer values", name))
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(problem(entry, "no text file in UTF-8", name)) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        sought = f"it is sought in {directory}"
        raise InputError(problem(entry, f"the file cannot be read ({reason}); {sought}", name)) from error
    numbers: list[float] = []
    for line, row in enumerate(text.splitlines(), 1):
        cell = row.strip().strip('"')
        if not cell:
            continue
        try:
            numbers.append(float(cell))
        except ValueError as error:
            if line == 1 and "," not in cell and ";" not in cell:
                continue  # the name of the column
            raise InputError(
                problem(entry, f"line {line} is '{shortened(cell, 40)}'; one number is needed in each line", name)
            ) from error
    return numbers
