"""Files with ideas of users: ``--plugin FILE.py`` on a command line, `pgmp.use` in Python.

A plugin is a Python file that runs when it is named there; a scene never names one. Its classes are taken into their
families as the package's own are.
"""

from __future__ import annotations

import hashlib
import linecache
import sys
import traceback
from pathlib import Path
from types import ModuleType

from pgmp_petsc.base import plugins
from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.declare.expressions import Printed
from pgmp_petsc.declare.ideas import FAMILIES, PLUGIN, WHEN_GROWN


def take(file: Path) -> None:
    """Take the ideas of a file into their families; see `api.scenes.use`.

    Raises `InputError` if it cannot be read, is not Python, fails, has no idea in it, or has one that is not whole or
    whose name is taken; with the file and line.
    """
    for family in FAMILIES:
        family.found()  # the package's own come first: their names are taken
    try:
        text = file.read_bytes()
    except OSError as error:
        raise InputError(f"plugin '{shortened(str(file))}': {error.strerror}; a Python file is needed") from error
    path, sha256 = str(file.resolve()), hashlib.sha256(text).hexdigest()
    if any(plugin.path == path and plugin.sha256 == sha256 for plugin in plugins.IN_USE.values()):
        return
    linecache.checkcache(path)  # messages name lines of the file as it is now
    before = [dict(family.classes) for family in FAMILIES], dict(plugins.IN_USE)
    for (table, name), plugin in before[1].items():
        if plugin.path == path:  # what it declared before it was changed
            next(family for family in FAMILIES if family.group == table).classes.pop(name)
            del plugins.IN_USE[table, name]
    module = ModuleType(f"{PLUGIN}{file.stem}_{sha256[:8]}")
    module.__file__ = path
    sys.modules[module.__name__] = module
    n_before = len(plugins.IN_USE)
    try:
        _run(text, file, module)
        for one in vars(module).values():
            if isinstance(one, Printed) and one.file == path:
                _check_printed(one)
        if len(plugins.IN_USE) == n_before:
            declared = ", ".join(f"{family.base} ({family.what})" for family in FAMILIES)
            raise InputError(
                f"plugin '{file}': no idea is declared in it; needed: a subclass of {declared} with "
                'type: Literal["NAME"] (of a section shape: Literal["NAME"]); see docs/extending.md'
            )
    except InputError:
        for family, classes in zip(FAMILIES, before[0]):
            family.classes = classes
        plugins.IN_USE.clear()
        plugins.IN_USE.update(before[1])
        del sys.modules[module.__name__]
        raise
    for told in WHEN_GROWN:
        told()


def _check_printed(one: Printed) -> None:
    """Print what a plugin declares by expressions, and refuse a name that the package or another plugin has."""
    known = {plugin.path for plugin in plugins.IN_USE.values()}
    for other in one.others:
        if other in known or Path(__file__).parents[1] in Path(other).parents:
            raise InputError(f"{one.place}: the name '{one.name}' is taken by {other}; take another one")
    one.code  # says what cannot be printed


def _run(text: bytes, file: Path, module: ModuleType) -> None:
    """Run a plugin; what is wrong with it becomes one message with its line."""
    path = module.__file__
    try:
        code = compile(text, path, "exec")
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None) or 1
        reason = getattr(error, "msg", None) or error
        raise InputError(f"plugin '{file}', line {line}: this is not Python: {reason}") from error
    try:
        exec(code, module.__dict__)  # its user named it for this
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        frames = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
        reason = f"{type(error).__name__}: {shortened(str(error))}"
        raise InputError(f"plugin '{file}', line {frames[-1]}: {reason}; repair the file") from error
