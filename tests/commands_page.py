"""docs/commands.md: all commands with their options, as they are declared.

python tests/commands_page.py > docs/commands.md
"""

from __future__ import annotations

from collections.abc import Iterator

from pgmp_petsc.api import found
from pgmp_petsc.api.declared import Argument, Command, found_command

ABOUT = """# Commands

Written from the declarations of the commands (`python tests/commands_page.py > docs/commands.md`);
`pgmp COMMAND --help` says the same. Every command has `--quiet`: nothing is written but errors and warnings. A
terminal shows the answer and warnings of build, modes, simulate, montecarlo and merge, and with `--verbose` all
figures; a pipe or a log always has these. Commands with `--json` write their figures as JSON on standard output, and
nothing else there. In Python a function has the same
arguments ([python.md](python.md)); `help(pgmp.simulate)` shows them.
"""


def commands_page() -> str:
    commands = [found_command(one) for one in found() if one.name]
    functions = [", ".join(f"`pgmp.{of.__name__}`" for of in (one.function, *one.others)) for one in commands]
    rows = [f"| [{one.name}](#pgmp-{one.name}) | {one.help} | {of} |" for one, of in zip(commands, functions)]
    lines = [ABOUT, "| command | does | in Python |", "|---|---|---|", *rows]
    for one in commands:
        lines += ["", *_section(one)]
    return "\n".join(lines) + "\n"


def _section(command: Command) -> Iterator[str]:
    arguments = sorted(command.arguments.values(), key=lambda one: not one.by_place)
    words = " ".join(
        (one.word if one.required else f"[{one.word}]") + "..." * one.repeated for one in arguments if one.by_place
    )
    needed = " ".join(f"{one.options[0]} {one.word}" for one in arguments if one.options and one.required)
    yield from (f"## pgmp {command.name}", "")
    yield f"`pgmp {' '.join(filter(None, (command.name, words, needed)))}`"
    yield ""
    yield command.description.split("\n\n")[0].replace("\n", " ")
    rows = [row for one in arguments for row in _rows(command, one)]
    if command.has_figures:
        rows.append(("`--json`", "Write the figures as JSON.", ""))
    yield from ("", "| option | does | allowed (default) |", "|---|---|---|") if rows else ()
    yield from (f"| {' | '.join(row)} |" for row in rows)


def _rows(command: Command, argument: Argument) -> Iterator[tuple[str, str, str]]:
    """Yield the rows of an argument: an option or word, its meaning, what it may be."""
    for value, text in argument.flags.items():
        yield f"`--{value}`", text, ""
    for part in argument.parts.values():
        yield from _rows(command, part)
    if argument.flags or argument.parts:
        return
    names = ", ".join(f"`{option}`" for option in argument.options)
    is_switch = argument.kinds == ("bool",)
    value = "" if is_switch else f" `{argument.word}`" if names else f"`{argument.word}`"
    allowed = ", ".join(argument.allowed) if isinstance(argument.allowed, tuple) else ""
    if argument.limits is not None:
        allowed = str(argument.limits)
    is_number = isinstance(argument.default, (int, float)) and not is_switch and "." not in argument.name
    allowed += f" ({argument.default:g})" if is_number else ""
    meaning = command.spelled(argument.meaning) + " Repeatable." * (argument.repeated and bool(names))
    if argument.listed is not None:
        meaning += f" One of {', '.join(argument.listed())}."
    yield f"{names}{value}".replace("|", "\\|"), meaning.replace("|", "\\|"), allowed.strip()


if __name__ == "__main__":
    print(commands_page(), end="")
