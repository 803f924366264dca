"""Errors, with the exit status with which a command then ends, and remarks for a result's reader besides its figures:
warnings, and notes on what was left out and why.

A remark is printed where the result is made, kept in its file (root attribute ``remarks``) and printed again by ``pgmp
info``: what was not computed, not estimated, not converged or left out is said in all three places in the same words.
"""

from __future__ import annotations

import json
import stat
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from functools import wraps
from typing import Literal, ParamSpec

Arguments = ParamSpec("Arguments")
LONGEST_QUOTE = 300  # characters of what was received, in a message
#: What a terminal obeys instead of showing it, and signs that turn the direction of what follows.
_OBEYED = {*range(0x20), *range(0x7F, 0xA0), *range(0x202A, 0x202F), *range(0x2066, 0x206A)} - {ord("\n"), ord("\t")}
_SHOWN = {code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" for code in _OBEYED}


def visible(text: str) -> str:
    """Return a text with control characters as escapes: names of files, scenes and meshes are written by anyone."""
    return text.translate(_SHOWN)


class PgmpError(Exception):
    """Base of every error that a user is meant to read; never shown with a traceback."""

    exit_status = 1

    def __init__(self, *parts: object) -> None:
        super().__init__(*(visible(part) if isinstance(part, str) else part for part in parts))


class InputError(PgmpError):
    """The scene, a mesh, a file or the command line is wrong; the message names the entry (exit status 2).

    The message says what was received, what is allowed, and where possible the cure.
    """

    exit_status = 2


class RunError(PgmpError):
    """The input was accepted but the computation failed (exit status 1)."""


class NotFollowed(RunError):
    """Modes cannot be followed over the configurations: the message, and a number of modes that can, or 0."""

    def __str__(self) -> str:
        return self.args[0]


def plain_reason(error: BaseException) -> str | None:
    """Return what to say of an error that the system or the machine's size causes, None for a mistake of ours, which
    deserves its traceback."""
    if isinstance(error, MemoryError):
        detail = f": {error}" if str(error) else ""
        return f"not enough memory{detail}; take a smaller problem or more ranks on more nodes"
    if isinstance(error, RecursionError):
        return "something is nested too deeply to be worked on"
    if isinstance(error, UnicodeError):
        return f"a text or a name is not valid in its encoding: {error}"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return None


#: Packages that a wheel comes without, and the extra that brings each.
EXTRAS = {
    "meshio": "mesh", "skfem": "mesh", "matplotlib": "plot", "mpl_toolkits": "plot", "pyvista": "plot",
    "imageio_ffmpeg": "plot", "jinja2": "report",
}  # fmt: skip


def missing_extra(error: ImportError) -> InputError | None:
    """Return the refusal of what needs a package of an extra that is not installed; None of any other one."""
    name = str(error.name or "").partition(".")[0]
    if name not in EXTRAS:
        return None
    return InputError(f"this needs {name}, which is not installed: pip install 'pgmp_petsc[{EXTRAS[name]}]'")


def nearest_name(name: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the known name closest to ``name``, or the list of known names."""
    known = sorted(known)
    close = get_close_matches(name, known, n=1, cutoff=0.6)
    if close:
        return f"; did you mean '{close[0]}'?"
    return f"; known: {shortened(', '.join(known))}" if known else "; none is defined"


def counted(n: int, what: str) -> str:
    """Return a number of things for a message, of which the plural has an s: ``1 file``, ``2 files``."""
    return f"{n} {what}{'' if n == 1 else 's'}"


def shortened(text: str, most: int = LONGEST_QUOTE) -> str:
    """Return a text for a message, cut if it is long, on one line."""
    text = text.encode("utf-8", "backslashreplace").decode().replace("\0", "\\0")
    return text if len(text) <= most else text[: most - 4] + " ..."


def irregular(mode: int) -> str:
    """Return what something with a mode, as `os.stat` has it, is if it is no regular file; empty if it is one."""
    if stat.S_ISREG(mode):
        return ""
    return "a directory" if stat.S_ISDIR(mode) else "a device or a pipe"


@dataclass(frozen=True)
class Remark:
    """One sentence about a result, with its reason and, where there is one, the cure."""

    #: ``warning`` where figures may be wrong or are worth less than they look, ``note`` where something is absent
    kind: Literal["warning", "note"]
    text: str  # the sentence, without a full stop at its end

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}"


def warning(text: str) -> Remark:
    """Return a remark that figures may be wrong or are worth less than they look."""
    return Remark("warning", text)


def note(text: str) -> Remark:
    """Return a remark that something is absent."""
    return Remark("note", text)


def gathered(remarks: Callable[Arguments, Iterable[Remark]]) -> Callable[Arguments, tuple[Remark, ...]]:
    """Let a function that yields remarks one by one return them all together."""

    @wraps(remarks)
    def together(*args: Arguments.args, **kwargs: Arguments.kwargs) -> tuple[Remark, ...]:
        return tuple(remarks(*args, **kwargs))

    return together


def to_json(remarks: Iterable[Remark]) -> str:
    """Return remarks as a JSON array of objects with ``kind`` and ``text``."""
    return json.dumps([asdict(remark) for remark in remarks])


def from_json(text: str) -> tuple[Remark, ...]:
    """Return what `to_json` wrote; raises `ValueError` where it is something else."""
    try:
        return tuple(Remark(str(entry["kind"]), str(entry["text"])) for entry in json.loads(text))
    except (KeyError, TypeError) as error:
        raise ValueError(f"remarks are no list of objects with kind and text: {error}") from error
