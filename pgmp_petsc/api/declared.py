"""A command is a function and one declaration, which describes each of its arguments once.

From it follow the function's checks and docstring, click's command, ``--json`` and docs/commands.md. Commands are found
by the heads of the modules in this room (`api`), which are read and not imported: a command is one more file, or
one more function in a file of its kin::

    @command("merge", "Join the shards of an ensemble.", 80, report=report, files=Argument("Shards, in any order."))
    def merge(files: Sequence[str | PathLike[str]], *, output: ... = None, on_all_ranks: ..., comm: ...) -> Result:

In meanings and in the function's description an argument is in backticks: help of the command line has its option
there."""

from __future__ import annotations

import inspect
import math
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from pgmp_petsc.api import Found
from pgmp_petsc.api.arguments import Function, Range, checked, kinds_of, taken, wrong
from pgmp_petsc.base.errors import InputError


@dataclass(frozen=True)
class Argument:
    """Declaration of an argument of a function; `parts` declare its fields in the same way."""

    meaning: str = ""  # for people
    #: words of a command line that give it, such as ``-o --output``: by default two dashes and its name, or none where
    #: the function must have it, which is then given by its place
    option: str | None = None
    word: str = ""  # placeholder of the value in help; by default its name in capitals
    #: range of a number, names to choose from, or how a message says what may be given
    allowed: Range | tuple[str, ...] | str | None = None
    required: bool = False  # whether a command line has to give it although a program need not
    #: makes the value of a text, or of all texts of an option that may be repeated
    read: Callable[[Any], object] | None = None
    #: options without a value in place of one with a value: meanings by the values that they give
    flags: Mapping[str, str] = field(default_factory=dict)
    #: made, parts: the class of which it is an object, and the declarations of its fields, each of which is an option
    made: type | None = None
    parts: Mapping[str, Argument] = field(default_factory=dict)
    listed: Callable[[], Mapping[str, str]] | None = None  # returns names that it may be, with a line about each
    empty: str | None = None  # value of the option where it is given without one
    by_last_place: bool = False  # whether it is given by its place although it may be left out
    #: needs, why: another argument without which this one has no part, and the reason
    needs: str = ""
    why: str = ""
    #: name, kinds, default: what follows from the function's signature
    name: str = ""
    kinds: tuple[str, ...] = ()
    default: object = None

    @property
    def options(self) -> list[str]:
        """Words of a command line that give it; none where it is given by its place."""
        return self.option.split() if self.option else []

    @property
    def limits(self) -> Range | None:
        """The range of a number, where it has one."""
        return self.allowed if isinstance(self.allowed, Range) else None

    @property
    def by_place(self) -> bool:
        """Whether it is a word that is given by its place."""
        return not (self.options or self.flags or self.parts)

    @property
    def called(self) -> str:
        """How a command line calls it."""
        if self.flags or self.parts:
            return " or ".join([*(f"--{name}" for name in self.flags), *(part.called for part in self.parts.values())])
        return self.options[-1] if self.options else self.word.split("|")[0]

    @property
    def repeated(self) -> bool:
        """Whether it is given by several words."""
        kind = next((kind for kind in self.kinds if kind != "None"), "")
        return kind.startswith(("Sequence", "Mapping")) or kind in ("Overrides", "Parameters", "Points")

    def filled(self, name: str, annotation: str, default: object, by_place: bool) -> Argument:
        """Return the same with what follows from the function's signature."""
        option = self.option
        if option is None:
            option = "" if by_place else f"--{name.rpartition('.')[2].replace('_', '-')}"
        plain = {item: str(kind) for item, kind in getattr(self.made, "__annotations__", {}).items()}
        parts = {
            item: part.filled(f"{name}.{item}", plain[item], getattr(self.made, item, None), False)
            for item, part in self.parts.items()
        }
        word = self.word or name.rpartition(".")[2].upper()
        return replace(
            self, name=name, option=option, kinds=kinds_of(annotation), default=default, parts=parts, word=word,
            required=self.required or by_place and not self.by_last_place,
        )  # fmt: skip

    def check(self, value: object, others: Mapping[str, object]) -> None:
        """Refuse what does not fit with other arguments, or inside; raises `InputError`."""
        if self.needs and value and others[self.needs] is None:
            raise InputError(f"{self.name}: without {self.needs} {self.why}")
        if self.by_place and self.repeated and isinstance(value, Sequence) and not value:
            raise wrong(self.name, value, f"{self.allowed}, and not an empty one")
        for item, part in self.parts.items() if value is not None else ():
            taken(part.name, getattr(value, item), part.kinds, part.allowed)


#: What names of files end in that commands have chosen.
ENDINGS = r"_(rom|components|modes|run|samples|rare|tradeoff)(_full|_components)?$"


@dataclass(frozen=True)
class Command:
    """A declared command."""

    #: name, help, place: its name, one line of help, and its place in lists
    name: str
    help: str
    place: int
    function: Callable[..., Any]  # what it calls
    petsc: bool | str = True  # whether PETSc is started for it, or the argument with which it is
    #: returns the text of a result: of its data, the file's name, remarks that were printed before, and `shell`. None:
    #: the function says on the way what it does.
    report: Callable[..., str] | None = None
    #: returns the figures of ``--json``, of the result and `shell`; None where there are none
    figures: Callable[..., Mapping[str, object]] | None = lambda result: result.summary()
    #: returns the exit status, of the result and `shell`, None of what is fine, or raises why it is another
    status: Callable[..., int | None] | None = None
    #: returns which function is called, of what was given and the ranks; raises what does not fit
    choose: Callable[..., Callable[..., Any]] | None = None
    others: Sequence[Callable[..., Any]] = ()  # what may be called instead of `function`, where `choose` says so
    about: str = ""  # argument that names the result in the report where there is no file
    #: returns what its file is called behind the name of the scene, of what was given; None where it has to be named
    ending: Callable[[Mapping[str, Any]], str | None] | None = None
    shell: Mapping[str, Argument] = field(default_factory=dict)  # options that the command line alone has
    #: what to do next with its file, ``{file}``; a terminal then shows of its report the answer alone
    then: str = ""

    @property
    def arguments(self) -> dict[str, Argument]:
        """Arguments that a command line may give, by name."""
        found = dict(self.function.declared)
        for function in self.others:
            found |= {name: one for name, one in function.declared.items() if name not in found and not one.by_place}
        found |= self.shell
        order = ("output", *(name for name in found if name not in SHARED or name == "model"), *SHARED)
        named = {name: found[name] for name in order if name in found}
        if self.ending is not None:
            meaning = f"{named['output'].meaning} By default it is named by the scene, SCENE_{self.ending({})}.h5."
            named["output"] = replace(named["output"], required=False, meaning=meaning)
        return {name: one for name, one in named.items() if one.meaning or one.flags or one.parts}

    def file_of(self, given: Mapping[str, Any]) -> Path:
        """Return the name of its file where none is given: that of the first word without an ending of a command, and
        its own. Raises `InputError` where it has to be named."""
        ending = self.ending(given)
        if ending is None:
            raise InputError(
                f"{self.arguments['output'].called}: missing; the name of the file to write is needed here"
            )
        first = given[next(name for name, one in self.function.declared.items() if one.by_place and one.meaning)]
        stem = Path(first[0] if isinstance(first, (list, tuple)) else first).stem
        model = f"_{given['model']}" if given.get("model") else ""
        return Path(f"{re.sub(ENDINGS, '', stem)}_{ending}{model}.h5")

    def spelled(self, text: str) -> str:
        """Return a text with arguments as a command line calls them."""
        known = self.arguments
        return re.sub(r"`([\w.]+)`", lambda found: known[found[1]].called if found[1] in known else found[1], text)

    def given_to(self, function: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
        """Return what was given by the names that one of its functions has; words have the same places in all."""
        functions = (self.function, function)
        places = ([name for name, one in of.declared.items() if one.by_place and one.meaning] for of in functions)
        names = dict(zip(*places))
        return {names.get(name, name): value for name, value in given.items()}

    @property
    def has_figures(self) -> bool:
        """Whether it has ``--json``."""
        return self.report is not None and self.figures is not None

    @property
    def description(self) -> str:
        """Description of the command, in paragraphs."""
        return self.spelled(re.split(r"\n\n(?=\w+\n-{3,}\n)", self.function.described)[0])


#: What several functions have. Those without a meaning are a program's alone.
SHARED = {
    "model": Argument(
        flags={
            "full": "Take the full-order model of a SCENE.",
            "components": "Take the component model of a SCENE: flexible bodies in floating frames.",
        }
    ),
    "output": Argument(
        "File to write; it replaces an older one when it is complete.", "-o --output", "FILE", required=True
    ),
    "plot": Argument("Directory for the picture; made if it does not exist.", word="DIR"),
    "resume": Argument(
        "Take up what a stopped run left beside the same FILE.", needs="output",
        why="nothing is kept that could be taken up; give the file's name",
    ),
    "ranks_per_angle": Argument(
        "Ranks that share one eigenproblem; more than one where a rank's memory is too small.", word="N",
        allowed=Range(1),
    ),
    "parameters": Argument(
        "Value of a parameter NAME in single runs, in the scene's units or with one of its own (5mm).", "--set",
        "NAME=VALUE",
    ),
    "overrides": Argument(
        "Entry of the scene with the dotted key KEY, replaced by a TOML value.", "--override", "KEY=VALUE"
    ),
    "on_all_ranks": Argument(),
    "comm": Argument(),
}  # fmt: skip
#: The same of those for people who write programs.
_OF_PROGRAMS = {
    "on_all_ranks": "Whether all ranks get the result; else the first alone has its data, with columns in a file.",
    "comm": "The ranks, all of which make the call; by default COMM_WORLD where it has several, else COMM_SELF.",
    "output": "File to write, as the command does; a table where its name ends in .csv.",
    "resume": "Whether to take up what a stopped run left beside the file; without one nothing is kept on the way.",
    "parameters": 'Values in single runs, in the scene\'s units: a mapping of names to numbers, or texts "name=VALUE".',
    "overrides": 'Entries of the scene: a mapping of dotted keys to values, or texts "dotted.key=VALUE" in TOML.',
    "model": "'full' or 'components' with a scene; 'reduced' or nothing with a reduced model.",
}
#: Of functions that differentiate runs.
DIFFERENTIABLE = replace(SHARED["model"], flags={"components": SHARED["model"].flags["components"]})
OPTIONAL_OUTPUT = replace(SHARED["output"], required=False)


def found_command(head: Found) -> Command:
    """Return the declaration that a head is of; its module is imported."""
    return getattr(import_module(head.module), head.function).command


def interface(gives: str = "", /, **arguments: Argument) -> Callable[[Function], Function]:
    """Declare a function of the Python interface: it is checked and documented by what is said of its arguments, and of
    what it `gives`; raises `TypeError` when the module is imported, if nothing is said of an argument, or something of
    one that it does not have."""

    def declare(function: Function) -> Function:
        signature = inspect.signature(function).parameters
        said = SHARED | arguments
        strange = [name for name in (*signature, *arguments) if name not in said or name not in signature]
        if strange:
            raise TypeError(f"{function.__name__}: {', '.join(strange)}: no argument, or one of which nothing is said")
        declared = {}
        for name, entry in signature.items():
            by_place = (entry.default is entry.empty or said[name].by_last_place) and not said[name].option
            declared[name] = said[name].filled(name, str(entry.annotation), entry.default, by_place)
        call = checked(function, declared, dict(pair for argument in declared.values() for pair in _names_of(argument)))
        call.declared, call.described = declared, inspect.getdoc(function) or ""
        call.__doc__ = _docstring(call.described, declared, inspect.signature(function).return_annotation, gives)
        return call

    return declare


def command(name: str, help: str, place: int, /, *, gives: str = "", **given: Any) -> Callable[[Function], Function]:
    """Declare a command by attributes of `Command`, and its function by its arguments, as `interface` does."""
    own = {one.name: given.pop(one.name) for one in fields(Command)[4:] if one.name in given}
    shell = {key: one.filled(key, "bool", False, False) for key, one in own.get("shell", {}).items()}

    def declare(function: Function) -> Function:
        call = interface(gives, **given)(function)
        call.__doc__ = f"{call.__doc__}\n\nThe command is ``pgmp {name}``."
        call.command = Command(name, help, place, call, **own | {"shell": shell})
        return call

    return declare


def numbers_by_name(option: str, needed: str, above: float = -math.inf) -> Callable[[Sequence[str]], dict[str, float]]:
    """Return what reads texts ``NAME=NUMBER`` of an option, finite numbers above a limit; it raises `InputError`."""

    def read(texts: Sequence[str]) -> dict[str, float]:
        found: dict[str, float] = {}
        for text in texts:
            name, _, value = (word.strip() for word in text.partition("="))
            try:
                number = float(value)
            except ValueError:
                number = math.nan
            if not above < number < math.inf:
                raise InputError(f"{option} {text}: {needed}")
            if name in found:
                raise InputError(f"{option} {text}: '{name}' is there twice; give it once")
            found[name] = number
        return found

    return read


def _names_of(argument: Argument) -> Iterator[tuple[str, str]]:
    """Yield words of a command line with what a program calls them."""
    yield from ((option, argument.name.rpartition(".")[2]) for option in argument.options)
    yield from ((f"--{value}", f"{argument.name} = '{value}'") for value in argument.flags)
    for part in argument.parts.values():
        yield from _names_of(part)


def _docstring(described: str, declared: Mapping[str, Argument], returned: object, gives: str) -> str:
    """Return a docstring with sections of parameters and of what is returned."""
    # a command line keeps the lines of a paragraph that a backspace precedes
    said, *rest = re.split(r"\n\n(?=\w+\n-{3,}\n)", described.replace("\b\n", ""))
    lines = [f"{said} Collective on `comm`." if "\n" not in said else f"{said}\n\nCollective on `comm`."]
    lines += ["", "Parameters", "----------"]
    for name, argument in declared.items():
        lines.append(f"{name} : {' or '.join(argument.kinds)}")
        meaning = _OF_PROGRAMS.get(name, argument.meaning)
        parts = [f"{part.name}: {part.meaning}" for part in argument.parts.values()]
        allowed = ", ".join(argument.allowed) if isinstance(argument.allowed, tuple) else argument.limits
        meaning += f" Allowed: {allowed}." if allowed else ""
        lines += [line for text in (meaning, *parts) for line in _indented(text)]
    lines += ["", "Returns", "-------", str(returned), *_indented(gives)] if gives else []
    return "\n".join([*lines, *(f"\n{section}" for section in rest)])


def _indented(text: str) -> list[str]:
    return textwrap.wrap(text, 112, initial_indent="    ", subsequent_indent="    ")
