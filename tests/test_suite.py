"""The suite itself: no case is lost, none depends on luck or on a busy machine, and users' defaults are tested."""

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from conftest import ROOT

MODULES = sorted((ROOT / "tests").rglob("*.py"))
# what is given as seconds, and calls whose first argument is
SECONDS, WAITS = ("timeout", "deadline"), ("wait", "communicate")
# where the switch itself is tested
SWITCHES = (
    "tests/combinations.py", "tests/commands/test_commands.py", "tests/hard_cases/test_steps_of_full_order.py",
    "tests/parallel/test_ensemble.py",
    "tests/scene/test_scene_errors.py", "tests/estimates/test_validity.py", "tests/verification/test_starting_jump.py",
    "tests/verification/test_millimetres.py",
)  # fmt: skip


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def nodes_of(tree: ast.AST) -> list[ast.AST]:
    return list(ast.walk(tree))


def repeated(names: list[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]


def words_of(node: ast.AST) -> str:
    """Return the text of a node; of names and values, which most are, without printing a tree."""
    if isinstance(node, ast.Name):
        return node.id
    return repr(node.value) if isinstance(node, ast.Constant) else ast.unparse(node)


def lost_cases(tree: ast.AST) -> Iterator[str]:
    """Yield keys, tests and names of cases of which only the last one counts."""
    for node in nodes_of(tree):
        if isinstance(node, ast.Dict):
            yield from (f"key {name}" for name in repeated([words_of(key) for key in node.keys if key]))
        if isinstance(node, (ast.Module, ast.ClassDef)):
            defined = [item.name for item in node.body if isinstance(item, (ast.FunctionDef, ast.ClassDef))]
            yield from (f"definition of {name}" for name in repeated(defined))


def unseeded(tree: ast.AST) -> Iterator[str]:
    """Yield where random numbers come from, unless it is a generator with a seed."""
    generators = {"np.random": "default_rng", "numpy.random": "default_rng"}
    # elsewhere the name is that of a generator
    if any(isinstance(node, ast.Import) and node.names[0].name == "random" for node in nodes_of(tree)):
        generators["random"] = "Random"
    for node in nodes_of(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            name, given = node.func.attr, [*node.args, *node.keywords]
            source = words_of(node.func.value) if isinstance(node.func.value, (ast.Name, ast.Attribute)) else ""
            of_process = source in generators and not (name == generators[source] and given)
            if of_process or (name == "rvs" and not any(word.arg == "random_state" for word in node.keywords)):
                yield ast.unparse(node)


def short_limits(tree: ast.AST) -> Iterator[str]:
    """Yield limits of time that are numbers of their own; those against hangs are conftest's `TIMEOUT_SECONDS`."""
    for node in nodes_of(tree):
        if isinstance(node, ast.Call):
            limits = [word.value for word in node.keywords if word.arg in SECONDS]
            if isinstance(node.func, ast.Attribute) and node.func.attr in WAITS:
                limits += node.args[:1]
            if any(isinstance(limit, ast.Constant) and isinstance(limit.value, (int, float)) for limit in limits):
                yield ast.unparse(node)
        if isinstance(node, ast.BinOp) and isinstance(node.right, ast.Constant) and isinstance(node.left, ast.Call):
            if ast.unparse(node.left).startswith(("time.monotonic()", "time.time()", "time.perf_counter()")):
                yield ast.unparse(node)


def test_no_constant_of_a_module_is_given_twice() -> None:
    """Only the last one counts, in functions above it too: points were once taken four at a time, not four million."""
    for path in sorted((ROOT / "pgmp_petsc").rglob("*.py")):
        targets = [target for item in tree_of(path).body if isinstance(item, ast.Assign) for target in item.targets]
        nodes = (node for target in targets for node in nodes_of(target) if isinstance(node, ast.Name))
        names = [node.id for node in nodes if isinstance(node.ctx, ast.Store)]
        assert set(repeated(names)) <= {"_"}, path


@pytest.mark.parametrize("find", [lost_cases, unseeded, short_limits])
def test_every_module_of_the_suite(find: Callable[[ast.AST], Iterator[str]]) -> None:
    found = {str(path.relative_to(ROOT)): list(find(tree_of(path))) for path in MODULES}
    assert {name: lines for name, lines in found.items() if lines} == {}


@pytest.mark.parametrize(
    ("find", "text"),
    [
        (lost_cases, "{'a': 1, 'b': 2, 'a': 3}"), (lost_cases, "def f(): pass\ndef f(): pass"),
        (unseeded, "import random\nrandom.randint(3, 9)"), (unseeded, "import random\nrandom.Random()"),
        (unseeded, "np.random.default_rng()"), (unseeded, "np.random.normal(3)"), (unseeded, "stats.norm().rvs(3)"),
        (short_limits, "run(timeout=60)"), (short_limits, "process.wait(60)"),
        (short_limits, "time.monotonic() + 60.0"),
    ],
)  # fmt: skip
def test_what_is_looked_for_is_found(find: Callable[[ast.AST], Iterator[str]], text: str) -> None:
    assert len(list(find(ast.parse(text)))) == 1


def test_the_indicator_is_on_as_it_is_for_users() -> None:
    off = ("error_indicator=false", "error_indicator = false")
    others = [path for path in MODULES if str(path.relative_to(ROOT)) not in SWITCHES and path != Path(__file__)]
    assert [str(path) for path in others if any(text in path.read_text() for text in off)] == []


def test_no_two_test_modules_share_their_name() -> None:
    """One pytest could not take both: scripts/test with arguments runs all folders at once."""
    assert not repeated([path.name for path in MODULES if path.name.startswith("test_")])
