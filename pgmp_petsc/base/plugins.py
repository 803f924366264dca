"""Which ideas come from outside the package, and whether those that a file was made with are at hand.

A file that was made from a scene with such ideas names the plugins and the SHA-256 of each (root attribute
``plugins``); other files have no such attribute.
"""

from __future__ import annotations

import tomllib
import traceback
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import entry_points
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

from pgmp_petsc.base.errors import InputError, shortened

SHOWN = 12  # characters of a checksum in messages


@dataclass(frozen=True)
class Plugin:
    """A file outside the package that declares ideas."""

    name: str  # what files call it: ``damper.py``, or the module of an installed package
    path: str  # where it is
    sha256: str  # of its bytes, as a hexadecimal number


#: Plugins by the table of the scene and the type of each of their ideas.
IN_USE: dict[tuple[str, str], Plugin] = {}


def to_blame(error: BaseException, paths: Collection[str]) -> InputError | None:
    """Return the message of an error that came up below a line of one of some plugins; None if it did not."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename in paths]
    if not frames:
        return None
    reason = f"{type(error).__name__}: {shortened(str(error))}"
    return InputError(f"plugin '{frames[-1].filename}', line {frames[-1].lineno}: {reason}; repair the file")


def in_use() -> dict[str, str]:
    """Return the checksums of all plugins under the key ``plugins``, as a part of what a run is; empty without any."""
    found = ", ".join(sorted({plugin.sha256 for plugin in IN_USE.values()}))
    return {"plugins": found} if found else {}


def plugins_of(scene_toml: str) -> dict[str, str]:
    """Return the SHA-256 of every plugin that a scene's entries need, by its name."""
    if not IN_USE:
        return {}
    tables = tomllib.loads(scene_toml)
    needed = [
        IN_USE.get((table, entry.get("type", "")))
        for table in sorted({table for table, _ in IN_USE})
        for entry in tables.get(table, {}).values()
    ]
    sections = (body.get("section", {}) for body in tables.get("bodies", {}).values())
    needed += [IN_USE.get(("sections", section.get("shape", ""))) for section in sections]
    return {plugin.name: plugin.sha256 for plugin in needed if plugin is not None}


def _is_installed(name: str, checksum: str) -> bool:
    """Whether a module of an installed package that has ideas, by its name or an entry point's, has a SHA-256: it is
    imported with the first scene."""
    points = entry_points()
    found = (points.select(group=group) for group in points.groups if group.startswith("pgmp."))
    modules = {point.module for point in chain.from_iterable(found)}
    if name.partition(".")[0] in {module.partition(".")[0] for module in modules}:
        modules.add(name)
    with suppress(ModuleNotFoundError):  # of an entry point that is broken: said where it is loaded
        paths = [Path(spec.origin) for spec in map(find_spec, sorted(modules)) if spec is not None and spec.origin]
        return any(path.is_file() and sha256(path.read_bytes()).hexdigest() == checksum for path in paths)
    return False


def check_plugins(needed: Mapping[str, str], file: object) -> None:
    """Refuse a file that was made with plugins that are not in use, or were others; raises `InputError`, naming all of
    them, with the cure."""
    lines = []
    for name, checksum in needed.items():
        if any(plugin.sha256 == checksum for plugin in IN_USE.values()) or _is_installed(name, checksum):
            continue
        made = f"'{file}' was made with the plugin {name} (SHA-256 {checksum[:SHOWN]}...)"
        other = next((plugin for plugin in IN_USE.values() if plugin.name == name), None)
        if other is not None:
            why = f"{made}, and {other.path} is another one (SHA-256 {other.sha256[:SHOWN]}...)"
            lines.append(f"{why}; give the plugin that it was made with, or make the file again")
            continue
        of_file = f'--plugin {name}, or pgmp.use("{name}") in Python'
        cure = of_file if name.endswith(".py") else "install its package, or give the plugin that imports it"
        lines.append(f"{made}, which is not in use; {cure}")
    if lines:
        raise InputError("\n".join(lines))
