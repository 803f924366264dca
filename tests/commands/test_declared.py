"""Commands as declarations: what is found without importing, what follows for Python, click and docs, and refusals."""

import inspect
import re
import sys
from pathlib import Path
from time import monotonic

import click
import pytest
from click.testing import CliRunner
from commands_page import commands_page
from conftest import ROOT
from mpi4py import MPI

import pgmp_petsc as pgmp
from pgmp_petsc.api import found
from pgmp_petsc.api.arguments import Range, began, by_command_line
from pgmp_petsc.api.declared import Argument, Command, command, found_command, interface
from pgmp_petsc.api.ranks import tell
from pgmp_petsc.cli.declared import Declared, Session
from pgmp_petsc.cli.main import COMMANDS, load

HEADS = {one.name: one for one in found() if one.name}
FUNCTIONS = [name for name in pgmp.__all__ if inspect.isfunction(getattr(pgmp, name))]


@pytest.mark.parametrize("name", HEADS)
def test_heads_are_what_the_declarations_say(name: str) -> None:
    head, made = HEADS[name], found_command(HEADS[name])
    assert (made.name, made.help, made.place, made.petsc) == (head.name, head.help, head.place, head.petsc)
    assert made.function is getattr(pgmp, head.function)
    assert len({one.place for one in HEADS.values()}) == len(HEADS), "two commands at one place"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_shows_all_arguments_with_their_meaning(name: str) -> None:
    function = getattr(pgmp, name)
    text = inspect.getdoc(function)
    for argument in inspect.signature(function).parameters:
        meaning = re.search(rf"^{argument} : .+\n    (.+)$", text, re.MULTILINE)
        assert meaning is not None and len(meaning[1]) > 10, (name, argument)


@pytest.mark.parametrize("name", HEADS)
def test_every_option_says_what_it_does(name: str) -> None:
    """In words of the command line: no name of an argument in backticks is left."""
    made = load(COMMANDS[name])
    for option in made.params:
        said = "A word." if isinstance(option, click.Argument) else option.help
        assert said[0].isupper() and "`" not in said
    assert made.help and "`" not in made.help
    assert {"--quiet"} <= {word for option in made.params for word in option.opts}


def test_the_page_of_commands_is_what_they_declare() -> None:
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert text == commands_page(), "write it again: python tests/commands_page.py > docs/commands.md"


NAMED = """
build press.toml -> press_rom.h5
build d/press.toml --components -> press_components.h5
modes press.toml -> press_modes.h5
simulate d/press_rom.h5 -> press_run.h5
simulate press.toml --full -> press_run_full.h5
montecarlo press_rom.h5 -n 9 -> press_samples.h5
montecarlo press.toml -n 9 --components -> press_samples_components.h5
montecarlo press_rom.h5 --rare over -n 9 -> press_rare.h5
montecarlo press_rom.h5 -n 9 --shard 1/2 -> -o
montecarlo press_rom.h5 --retry-failed press_samples.h5 -> -o
merge part1.h5 part2.h5 -> part1_samples.h5
tradeoff press.toml -> press_tradeoff.h5
simulate press_rom.h5 -o f.h5 -> f.h5
"""


@pytest.mark.parametrize("line", NAMED.strip().splitlines())
def test_files_are_named_by_the_scene(line, monkeypatch) -> None:
    words, _, name = line.partition(" -> ")
    called, *words = words.split()
    given = {}
    monkeypatch.setattr("pgmp_petsc.cli.declared.run_command", lambda context, command, found: given.update(found))
    done = CliRunner().invoke(load(COMMANDS[called]), words, standalone_mode=False, obj=Session(MPI.COMM_SELF))
    if name.startswith("-"):
        assert str(done.exception) == "--output: missing; the name of the file to write is needed here"
    else:
        assert done.exception is None and given["output"] == Path(name), done.exception


def halved(n: int = 1, *, names: tuple[str, ...] = (), comm: object = None) -> int:
    """Say the half of `n`."""
    tell(comm, f"{n / 2:g} {names}")
    return n


def declared(**more: object) -> Command:
    arguments = {"n": Argument("A number.", "-n", "N", Range(0, 9)), "names": Argument("Names.", "--name")}
    halved.__annotations__ |= {"names": "Sequence[str]", "n": "int"}
    return command("halve", "Halve a number.", 1, petsc=False, **arguments, **more)(halved).command


def run(made: Command, *words: str) -> tuple[int, str]:
    done = CliRunner().invoke(Declared(made), words, obj=Session(MPI.COMM_SELF))
    return done.exit_code, done.output if done.exception is None else f"{done.output}{done.exception}"


def test_a_declaration_makes_a_command() -> None:
    assert run(declared(), "-n", "3", "--name", "a", "--name", "b") == (0, "1.5 ('a', 'b')\n")
    assert run(declared(), "-n", "12")[0] == 2 and "0<=x<=9" in run(declared(), "-n", "12")[1]
    assert run(declared(), "--quiet") == (0, "")


def test_a_report_its_figures_and_its_status() -> None:
    made = declared(
        report=lambda n, path, said, twice: f"{n} is it{' twice' * twice}", figures=lambda n, twice: {"n": n},
        status=lambda n, twice: n % 2, shell={"twice": Argument("Say it twice.")},
    )  # fmt: skip
    assert run(made, "-n", "2", "--twice") == (0, "1 ()\n2 is it twice\n")
    assert run(made, "-n", "3")[0] == 1
    assert run(made, "-n", "2", "--json") == (0, '{\n "n": 2\n}\n')


def test_another_function_is_chosen_by_what_is_given() -> None:
    """What it does not have is refused, what it needs is asked for."""

    def other(word: str, *, comm: object = None) -> int:
        """Say a word."""
        tell(comm, word)
        return 0

    other.__annotations__["word"] = "str"
    spoken = interface(word=Argument("A word.", "--word"))(other)
    made = declared(others=(spoken,), choose=lambda given, comm: spoken)
    assert run(made, "--word", "yes") == (0, "yes\n")
    assert "-n: it has no part here; leave it out" in run(made, "--word", "yes", "-n", "2")[1]
    assert "--word: missing; A word." in run(declared(others=(spoken,), choose=lambda given, comm: spoken))[1]


@pytest.mark.parametrize(("name", "given"), [("n", ()), ("m", ("n", "m"))])
def test_an_argument_of_which_nothing_is_said_cannot_be_loaded(name: str, given: tuple) -> None:
    def counted(n: int) -> int:
        """Count."""
        return n

    with pytest.raises(TypeError, match=f"{name}: no argument, or one of which nothing is said"):
        interface(**{one: Argument("A number.") for one in given})(counted)


def test_a_command_is_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module in a room is found by its head; nothing is imported until it is called."""
    (tmp_path / "greeting.py").write_text(
        "from __future__ import annotations\n"
        "from pgmp_petsc.api.declared import Argument, command\n"
        "from pgmp_petsc.api.ranks import tell\n\n"
        '@command("greet", "Say hello.", 5, petsc=False, name=Argument("Whom."))\n'
        "def greet(name: str, *, comm: MPI.Comm | None = None) -> None:\n"
        '    """Say hello to `name`."""\n'
        '    tell(comm, f"hello {name}")\n'
    )
    (head,) = found(tmp_path)
    assert (head.name, head.help, head.place, head.petsc) == ("greet", "Say hello.", 5, False)
    assert "greeting" not in sys.modules
    monkeypatch.syspath_prepend(tmp_path)
    greet = __import__("greeting").greet
    assert run(greet.command, "you") == (0, "hello you\n")
    assert greet.command.description == "Say hello to NAME."


def test_a_call_begins_with_its_command_line() -> None:
    """A budget of a command counts what comes before the call, such as imports; a program's own begins with it."""
    with by_command_line(5.0):
        assert began() == 5.0
    before = monotonic()
    assert before <= began() <= monotonic()
