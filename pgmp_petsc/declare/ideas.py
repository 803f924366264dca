"""Families of ideas: classes that are found, not listed.

A family has one base class. Every subclass with an entry ``type: Literal["NAME"]`` (of a section it is ``shape``) is an
idea of that name: it takes part as soon as its module is imported. The modules are those of the family's room in the
package, and those that installed packages name as entry points of the family's group; `take` adds
files of users (``--plugin FILE.py`` on a command line, `pgmp.use` in Python), which run when they are named there: a
scene never names one.

Which names there are is read in the text of the room's modules. One of them is imported when an idea of it is first
asked for: a scene waits for those that it names. The scene, which is below the rooms, holds the place open with
`Found`, and its schema asks for an idea when a table of it comes.
"""

from __future__ import annotations

import hashlib
import inspect
import linecache
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, ForwardRef, get_args

from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
from pydantic.errors import PydanticUndefinedAnnotation
from pydantic_core import CoreSchema, core_schema

from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.base.plugins import IN_USE, Plugin, to_blame
from pgmp_petsc.declare.expressions import Printed

PACKAGE = "pgmp_petsc."
PLUGIN = "pgmp_plugin_"  # modules of files that a user named begin with it


def place_of(cls: type) -> tuple[Path, int]:
    """Return the file and the line in which a class begins."""
    module = sys.modules[cls.__module__]
    try:
        return Path(module.__file__), inspect.getsourcelines(cls)[1]
    except (OSError, TypeError, AttributeError):  # typed into an interpreter
        return Path(cls.__module__), 0


def refuse(cls: type, why: str) -> InputError:
    """Return the error of a class that is no idea, with its file and line."""
    file, line = place_of(cls)
    return InputError(f"{file}, line {line}: class {cls.__name__}: {why}")


@contextmanager
def blaming(cls: type) -> Iterator[None]:
    """Name a class of a plugin where what it hands out cannot be worked with; what fails in its own lines names these.
    Raises `InputError`, with its file and line."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, NotImplementedError, TypeError, ValueError) as error:
        if cls.__module__.startswith(PACKAGE):
            raise
        missing = isinstance(error, NotImplementedError)
        method = f"it needs the method {traceback.extract_tb(error.__traceback__)[-1].name}"
        why = method if missing else f"{type(error).__name__}: {error}"
        raise to_blame(error, [str(place_of(cls)[0])]) or refuse(cls, why) from error


def _check_methods(cls: type) -> None:
    """Refuse a class whose methods cannot be called as those of its base in the package are, which they stand for."""
    bases = [base for base in cls.__mro__ if base.__module__.startswith(PACKAGE)]
    for name, own in vars(cls).items():
        theirs = next((vars(base)[name] for base in bases if name in vars(base)), None)
        is_property, is_method = isinstance(theirs, property), callable(getattr(theirs, "__func__", theirs))
        if not (is_property or is_method) or inspect.isclass(theirs) or name.startswith("__"):
            continue
        if is_property:
            if inspect.isfunction(own):
                raise refuse(cls, f"{name} is a property: write @property above it")
            continue
        takes = inspect.signature(getattr(theirs, "__func__", theirs))
        given = getattr(own, "__func__", own)
        try:
            inspect.signature(given).bind(*takes.parameters)
        except (TypeError, ValueError):
            raise refuse(cls, f"{name} is a method that is called as {name}({', '.join(takes.parameters)})") from None


def _plugin(cls: type) -> Plugin:
    """Return the file outside the package that a class is from."""
    file, _ = place_of(cls)
    text = file.read_bytes() if file.is_file() else b""
    name = file.name if cls.__module__.startswith(PLUGIN) else cls.__module__
    return Plugin(name, str(file), hashlib.sha256(text).hexdigest())


@dataclass(eq=False)
class Family:
    """The ideas of one kind."""

    what: str  # what one of them is, for messages: ``effect``
    base: str  # name of the class that they are subclasses of, for messages
    room: str  # package whose modules have the program's own
    #: entry points of installed packages, by the name of the table of a scene: ``effects`` is ``pgmp.effects``
    group: str
    key: str = "type"  # entry that names one of them
    classes: dict[str, type[BaseModel]] = field(default_factory=dict)  # those that were imported, by their names

    @cached_property
    def modules(self) -> dict[str, str]:
        """Modules of the program's own ideas by their names, which are read in the modules' text."""
        declared = re.compile(rf'^    {self.key}: Literal\["(\w+)"\]', re.MULTILINE)
        (room,) = find_spec(self.room).submodule_search_locations
        texts = {path.stem: path.read_text(encoding="utf-8") for path in Path(room).glob("*.py")}
        return {name: f"{self.room}.{stem}" for stem, text in texts.items() for name in declared.findall(text)}

    def take(self, cls: type[BaseModel]) -> bool:
        """Take a class into the family if it has a ``type`` (or another `key`) of its own; return whether it has.
        Raises `InputError` if the type is no literal text, or another idea has it."""
        if self.key not in cls.model_fields:
            return False
        entry = cls.model_fields[self.key].annotation
        if isinstance(entry, ForwardRef):
            where = f"its {self.key} is {entry.__forward_arg__}, which is not defined"
            raise refuse(cls, f"{where}; import what it names")
        names = get_args(entry)
        if len(names) != 1 or not isinstance(names[0], str):
            raise refuse(cls, f'its {self.key} names the {self.what}, {self.key}: Literal["NAME"]')
        ours = cls.__module__.startswith(PACKAGE)
        if names[0] in self.classes or not ours and names[0] in self.modules:
            other = self.named(names[0])
            file, line = place_of(other)
            cure = "choose another name"
            if cls.__module__ != other.__module__ and place_of(cls) == (file, line):
                cure = "another plugin imports this file: do not give it as one too"
            raise refuse(cls, f"there is the {self.what} '{names[0]}' already, {file}, line {line}; {cure}")
        if not ours:
            _check_methods(cls)
        self.classes[names[0]] = cls
        if not ours:
            IN_USE[self.group, names[0]] = _plugin(cls)
        return True

    def named(self, name: str) -> type[BaseModel]:
        """Return the idea of one of the `names`."""
        if name not in self.classes:
            import_module(self.modules[name])
        return self.classes[name]

    def found(self) -> tuple[type[BaseModel], ...]:
        """Return the ideas in the order of their names."""
        return tuple(self.named(name) for name in self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all ideas, in order."""
        _load_installed()
        return tuple(sorted({*self.modules, *self.classes}))


EFFECTS = Family("effect", "EffectEntry", "pgmp_petsc.effects", "effects")
OUTPUTS = Family("output", "OutputEntry", "pgmp_petsc.outputs", "outputs")
JOINTS = Family("joint", "JointEntry", "pgmp_petsc.joints", "joints")
CONTROLLERS = Family("controller", "ControllerEntry", "pgmp_petsc.controllers", "controllers")
SECTIONS = Family("section", "ShapedSection", "pgmp_petsc.bodies.sections", "sections", "shape")
FAMILIES = (EFFECTS, OUTPUTS, JOINTS, CONTROLLERS, SECTIONS)


#: What is done when a family has grown after it was looked through.
WHEN_GROWN: list[Callable[[], object]] = []


@cache
def _load_installed() -> None:
    """Import the ideas of installed packages, whichever group names their modules; once, as packages are many."""
    points = entry_points()
    for family in FAMILIES:
        for point in sorted(points.select(group=f"pgmp.{family.group}"), key=lambda point: point.name):
            _load(point, f"pgmp.{family.group}")


def _load(point: EntryPoint, group: str) -> None:
    """Import what an installed package declares."""
    try:
        point.load()
    except InputError:
        raise
    except Exception as error:
        package = point.dist.name if point.dist is not None else point.value
        raise InputError(
            f"{group}: '{point.name}' of the installed package {package} cannot be imported: {type(error).__name__}: "
            f"{error}; repair the package, or uninstall it"
        ) from error


@dataclass(frozen=True)
class Found:
    """A note on a type: one of the ideas of a family, told apart by ``type``."""

    family: Family

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a table that its idea's class validates: only the schemas that are used are built."""
        take = core_schema.with_info_plain_validator_function
        return self._union(take(self._validator(name)) for name in self.family.names)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        for cls in self.family.found():
            cls.model_rebuild()
        return handler(self._union(cls.__pydantic_core_schema__ for cls in self.family.found()))

    def _union(self, schemas: Iterable[CoreSchema]) -> CoreSchema:
        return core_schema.tagged_union_schema(dict(zip(self.family.names, schemas)), self.family.key)

    def _validator(self, name: str) -> Callable[[Any, ValidationInfo], BaseModel]:
        return lambda table, info: self.family.named(name).model_validate(table, context=info.context)


def take(file: Path) -> None:
    """Take the ideas of a file into their families; see `api.scenes.use`. Raises `InputError` if it cannot be read, is
    not Python, fails, has no idea in it, or has one that is not whole or whose name is taken; with the file and line.
    """
    for family in FAMILIES:
        family.found()  # their names, and those of their laws, are taken
    try:
        text = file.read_bytes()
    except OSError as error:
        raise InputError(f"plugin '{shortened(str(file))}': {error.strerror}; a Python file is needed") from error
    path, sha256 = str(file.resolve()), hashlib.sha256(text).hexdigest()
    if any(plugin.sha256 == sha256 for plugin in IN_USE.values()):  # wherever else it is
        return
    linecache.checkcache(path)  # messages name lines of the file as it is now
    before = [dict(family.classes) for family in FAMILIES], dict(IN_USE)
    for (table, name), plugin in before[1].items():
        if plugin.path == path:  # what it declared before it was changed
            next(family for family in FAMILIES if family.group == table).classes.pop(name)
            del IN_USE[table, name]
    module = ModuleType(f"{PLUGIN}{file.stem}_{sha256[:8]}")
    module.__file__ = path
    sys.modules[module.__name__] = module
    n_before = len(IN_USE)
    try:
        _run(text, file, module)
        printed = [one for one in vars(module).values() if isinstance(one, Printed) and one.file == path]
        for one in printed:
            _check_printed(one, printed)
        for family in FAMILIES:
            for cls in family.classes.values():
                if cls.__module__ == module.__name__:
                    try:
                        cls.model_rebuild()
                    except PydanticUndefinedAnnotation as error:
                        what = f"an entry has the type {error.name}, which is not defined"
                        raise refuse(cls, what) from error
        if len(IN_USE) == n_before:
            declared = ", ".join(f"{family.base} ({family.what})" for family in FAMILIES)
            raise InputError(
                f"plugin '{file}': no idea is declared in it; needed: a subclass of {declared} with "
                'type: Literal["NAME"] (of a section shape: Literal["NAME"]); see docs/extending.md'
            )
    except InputError:
        del sys.modules[module.__name__]
        for family, classes in zip(FAMILIES, before[0]):
            # modules that it imported stay so, and do not run again
            imported = {name: cls for name, cls in family.classes.items() if cls.__module__ in sys.modules}
            family.classes = imported | classes
        left = {(family.group, name) for family in FAMILIES for name in family.classes}
        used = {key: plugin for key, plugin in (IN_USE | before[1]).items() if key in left}
        IN_USE.clear()
        IN_USE.update(used)
        raise
    finally:
        for told in WHEN_GROWN:
            told()


def _check_printed(one: Printed, printed: Iterable[Printed]) -> None:
    """Print what a plugin declares by expressions, `printed`; refuse names that come twice, in the package too."""
    known, own = {plugin.path for plugin in IN_USE.values()}, (type(one), one.name)
    places = [other for other in one.others if other in known or Path(__file__).parents[1] in Path(other).parents]
    places += [other.place for other in printed if other is not one and (type(other), other.name) == own]
    if places:
        raise InputError(f"{one.place}: the name '{one.name}' is taken by {places[0]}; take another one")
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
        blamed = to_blame(error, [path])
        cure = ""
        if isinstance(error, ModuleNotFoundError) and file.with_name(f"{error.name}.py").is_file():
            cure = "files beside a plugin are no modules: write both into one, or set PYTHONPATH to their folder"
        elif isinstance(error, ImportError) and "relative import" in str(error):
            cure = "a file of a package is no plugin by itself: install the package, or import it by name in a plugin"
        blamed = InputError(str(blamed).replace("repair the file", cure)) if cure else blamed
        raise blamed from error
