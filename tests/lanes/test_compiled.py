"""The cache of compiled functions: its loss costs time, never a run."""

import ast
import gc
import importlib.util
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numba
import pytest
import warm_start
from conftest import MPI_ENVIRONMENT, ROOT, TIMEOUT_SECONDS
from llvmlite import binding
from numba.core import event, ssa, types
from numba.core.compiler import run_frontend
from numba.core.postproc import VariableLifetime

from pgmp_petsc.lanes import compiled
from pgmp_petsc.reduced import lagrangian

SCRIPT = """
import os, sys
import numba
numba.config.CACHE_DIR = os.environ.get("KEPT_IN", numba.config.CACHE_DIR)
sys.path.insert(0, sys.argv[1])
from kernel import double
from pgmp_petsc.lanes.compiled import cache_problem
print(double(int(sys.argv[2])), double(0.5), cache_problem())
"""
KERNEL = """
from pgmp_petsc.lanes.compiled import njit

@njit(cache=True, error_model="numpy")
def double(x):
    return 2 * x
"""
# a function that allocates, returns and refuses arrays, and what is loaded of numba to call it
ARRAYS = """
import numpy as np
from pgmp_petsc.lanes.compiled import njit

@njit(cache=True)
def stairs(x):
    if x.size > 4:
        raise ValueError("too long")
    made = np.empty((x.size, 2))
    for i in range(x.size):
        made[i] = x[i] + np.arange(2.0)
    return made.T.copy()
"""
STAIRS = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from stairs import stairs
from pgmp_petsc.lanes.compiled import cache_problem
for x in (np.arange(3.0), np.zeros(5)):
    try:
        print(stairs(x).tolist())
    except ValueError as error:
        print(error)
print("numba.np.arrayobj" in sys.modules, len(stairs.stats.cache_hits))
print(stairs(np.arange(2)).tolist(), "numba.np.arrayobj" in sys.modules, stairs(np.ones(1)).tolist(), cache_problem())
"""

# functions in another file that are made when they are first called
APART = """
from numba import types
from pgmp_petsc.lanes.compiled import njit

@njit(cache=True, apart=True)
def halved(pair, x, by=0.5):
    for i in range(x.size):
        x[i] *= by * pair[0]

@njit(cache=True, apart=lambda x: x.dtype)
def added(x):
    return x.sum()

@njit(cache=True, apart=types.float64)
def wrong(x):
    return x.unknown
"""
CALLER = """
from apart import added, halved, wrong
from pgmp_petsc.lanes.compiled import njit

@njit(cache=True, entry=True)
def quartered(pair, x):
    if pair[1] > 1:
        return wrong(x)
    halved(pair, x)
    halved(pair, x)
    return added(x)
"""
QUARTERS = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from apart import added, halved, wrong
from caller import quartered
from pgmp_petsc.lanes.compiled import NotCompiledError, cache_problem
print(quartered((2.0, 1), np.ones(3)), quartered((1.0, 1), np.ones(3)), cache_problem())
hits = [sum(found.stats.cache_hits.values()) for found in (halved.linked(), added.linked(), quartered)]
print(hits, len(wrong.linked().overloads))
code = quartered.overloads[quartered.signatures[0]].library.get_llvm_str()
print("define" in code and "mul" in code)
try:
    quartered((2.0, 2), np.ones(3))
except NotCompiledError:
    print("not compiled")
"""


@pytest.fixture
def module(tmp_path: Path) -> Path:
    """Return a folder with a compiled function, and an empty one for its cache."""
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "kernel.py").write_text(KERNEL)
    (tmp_path / "cache").mkdir()
    return tmp_path


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the compiled function, and what one process kept of it."""
    folder = tmp_path_factory.mktemp("once")
    (folder / "source").mkdir()
    (folder / "source" / "kernel.py").write_text(KERNEL)
    assert printed(folder) == "6 1.0 None"
    (folder / "cache").rename(folder / "first")
    return folder


@pytest.fixture
def kept(once: Path) -> Path:
    """Return the folder of the compiled function with what one process kept of it, which a test may damage."""
    shutil.rmtree(once / "cache", ignore_errors=True)
    shutil.copytree(once / "first", once / "cache")
    return once


def run(module: Path, *arguments: object, **environment: str) -> subprocess.Popen[str]:
    """Start a process that calls the function with an integer and a real number."""
    given = os.environ | MPI_ENVIRONMENT | {"KEPT_IN": str(module / "cache"), "PYTHONPATH": str(ROOT)} | environment
    command = [*warm_start.python(given), "-c", SCRIPT, str(module / "source"), *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=given)


def printed(module: Path, **environment: str) -> str:
    """Return what one process printed; it must end well."""
    process = run(module, 3, **environment)
    out, err = process.communicate(timeout=TIMEOUT_SECONDS)
    assert process.returncode == 0 and err == "", err
    return out.strip()


def said(module: Path, script: str) -> list[str]:
    """Return the lines that a script prints which finds its modules in the folder's source, and ends well."""
    command = [sys.executable, "-c", script, str(module / "source"), str(module / "cache")]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(module / "cache"), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=TIMEOUT_SECONDS)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def files(module: Path, ending: str) -> list[Path]:
    return sorted((module / "cache").rglob(f"*.{ending}"))


def test_what_is_compiled_is_kept(kept: Path) -> None:
    before = [path.stat().st_mtime_ns for path in files(kept, "nbc")]
    assert len(before) == 2
    assert printed(kept) == "6 1.0 None"
    assert [path.stat().st_mtime_ns for path in files(kept, "nbc")] == before
    # what two processes that lose a race leave: the name of one signature's file, the content of the other's
    first, second = files(kept, "nbc")
    first.write_bytes(second.read_bytes())
    assert printed(kept).startswith("6 1.0 ")
    # a folder in the place of the index lets the same call fail as a full disk does
    for path in files(kept, "nbi"):
        path.unlink()
        path.mkdir()
    assert printed(kept).startswith("6 1.0 ")


def test_what_is_kept_is_loaded_without_what_compiles(module: Path) -> None:
    """Arrays, errors and all; what is compiled after it in the same process is none the worse for it."""
    (module / "source" / "stairs.py").write_text(ARRAYS)
    first = said(module, STAIRS)
    (of_integers,) = (path for path in files(module, "nbc") if path.name.endswith(".2.nbc"))
    of_integers.unlink()  # the second signature is compiled anew
    second = said(module, STAIRS)
    assert first[:2] == second[:2] == ["[[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]]", "too long"]
    assert first[2] == "True 0" and second[2] == "False 1"
    assert first[3] == second[3] == "[[0.0, 1.0], [1.0, 2.0]] True [[1.0], [2.0]] None"


@pytest.mark.parametrize(("ending", "damage"), [("nbi", b""), ("nbi", b"\x80\x05garbage"), ("nbc", b"\x00" * 400)])
def test_damaged_files_are_written_anew(kept: Path, ending: str, damage: bytes) -> None:
    for path in files(kept, ending):
        path.write_bytes(damage)
    assert re.match(r"6 1\.0 files in .* that cannot be read are written anew", printed(kept))
    assert printed(kept) == "6 1.0 None"


def test_damage_beside_the_source_that_cannot_be_mended_is_passed_over(module: Path) -> None:
    """As of an installation that only its owner may write to: what is kept elsewhere is loaded."""
    assert printed(module, KEPT_IN="") == "6 1.0 None"
    for path in (module / "source" / "__pycache__").glob("*.nbi"):
        path.unlink()
        path.mkdir()  # root may write everywhere, but not over a folder
    assert re.match(r"6 1\.0 files in .*/source/__pycache__ cannot be read, nor written anew", printed(module))
    before = [path.stat().st_mtime_ns for path in files(module, "nbc")]
    assert len(before) == 2
    assert printed(module) == "6 1.0 None"
    assert [path.stat().st_mtime_ns for path in files(module, "nbc")] == before


@pytest.mark.parametrize("gone", [b"cpgmp_petsc.gone\nVector\n.", b"cpgmp_petsc.lanes.vectors\nGone\n."])
def test_files_of_an_older_version_are_written_anew_without_a_word(kept: Path, gone: bytes) -> None:
    """Their types may be of modules and classes that are elsewhere now."""
    for path in files(kept, "nbi"):
        with path.open("rb") as file:
            version = pickle.load(file)
        path.write_bytes(pickle.dumps(version) + gone)
    assert printed(kept) == "6 1.0 None"


# a wheel with compiled code in it, for a family of processors
CARRYING = """
from pathlib import Path
from pgmp_petsc.lanes import compiled
compiled.CARRIED = Path(sys.argv[1]) / "carried.json"
"""
FAMILY = "x86-64", "+cx16,+sse3"


def test_a_wheel_carries_code_for_a_family_of_processors(module: Path) -> None:
    source, machine = module / "source", binding.get_process_triple()
    script = SCRIPT.replace("from kernel", CARRYING + "from kernel") + "print(len(double.stats.cache_hits))"
    command = [sys.executable, "-c", script, str(source), "3"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA")}
    environment["PYTHONPATH"] = str(ROOT)

    def lines(**more: str) -> list[str]:
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment | more, timeout=TIMEOUT_SECONDS, check=True
        )
        return done.stdout.splitlines()

    def carries(version: str, *families: tuple[str, str]) -> None:
        about = {"numba": version, "processors": [[machine, *family] for family in families]}
        (source / "carried.json").write_text(json.dumps(about))

    assert lines(NUMBA_CPU_NAME=FAMILY[0], NUMBA_CPU_FEATURES=FAMILY[1]) == ["6 1.0 None", "0"]
    made = {path: path.read_bytes() for path in (source / "__pycache__").glob("*.nb?")}
    assert len(made) == 3
    carries(numba.__version__, ("new", "+cx16,+fly"), FAMILY)
    assert lines() == ["6 1.0 None", "2"], "loaded here"
    assert lines(NUMBA_CACHE_DIR=str(module / "cache")) == ["6 1.0 None", "2"], "and where another folder is written to"
    assert lines(NUMBA_CPU_NAME="x86-64", NUMBA_CPU_FEATURES="+cx16") == ["6 1.0 None", "0"], "another one is asked for"
    for path, content in made.items():
        path.write_bytes(content)
    carries(numba.__version__, ("new", "+cx16,+fly"))
    line, hits = lines()
    assert hits == "0" and f"is of numba {numba.__version__} for processors new, and this is numba" in line
    assert "compiled once, and takes minutes" in line
    assert lines() == ["6 1.0 None", "2"], "that is kept as in a checkout"
    carries("0.1", FAMILY)
    assert lines(NUMBA_CACHE_DIR=str(module / "others")) == ["6 1.0 None", "2"]


def test_without_a_folder_that_can_be_written(module: Path) -> None:
    """Root may write everywhere, so a file stands where the folders would be."""
    (module / "file").write_text("")
    blocked = str(module / "file" / "cache")
    nowhere = {"KEPT_IN": blocked, "NUMBA_CACHE_LOCATOR_CLASSES": "_UserProvidedCacheLocator"}
    found = printed(module, **nowhere)
    assert found.startswith("6 1.0 compiled code is not kept, and every run compiles")
    assert found.endswith("set NUMBA_CACHE_DIR to a folder with space that can be written")


def test_a_folder_is_looked_for_when_it_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not for functions that others bring along, of which a run has a hundred."""
    looked_for, problems = [], []

    def nowhere(_: object, function: Callable) -> None:
        looked_for.append(function)
        raise RuntimeError("no locator")

    monkeypatch.setattr(compiled.FunctionCache, "__init__", nowhere)
    monkeypatch.setattr(compiled, "_problems", problems)
    double = compiled.njit(cache=True, error_model="numpy")(lambda x: 2 * x)
    assert not looked_for and not problems
    assert double(3) == 6 and double(0.5) == 1.0
    assert len(looked_for) == 1 and "no locator" in compiled.cache_problem()


ONCE = """
import atexit
from pgmp_petsc.lanes.compiled import njit

@njit(cache=True)
def half(x):
    return x / 2

@njit(cache=True, entry=True)
def double(x):
    return 4 * half(x)

atexit.register(lambda: print(sum(double.stats.cache_misses.values())))
"""


def test_one_process_compiles_what_python_calls_and_others_wait(module: Path) -> None:
    """Of what is copied into it alone no machine code is made."""
    (module / "source" / "kernel.py").write_text(ONCE)
    started = [run(module, 3) for _ in range(3)]
    out = [process.communicate(timeout=TIMEOUT_SECONDS)[0].split() for process in started]
    assert [each[:2] for each in out] == [["6.0", "1.0"]] * 3
    assert sum(int(each[-1]) for each in out) == 2
    copied = {"half" in path.name: b"bitcode" in path.read_bytes() for path in files(module, "nbc")}
    assert copied == {True: True, False: False}


FAILING = """
from pgmp_petsc.lanes.compiled import njit

@njit(cache=True, entry=True)
def added(x):
    return x + 1

@njit(cache=True, entry=True)
def double(x):
    return x.unknown
"""
FAILED = """
import fcntl, sys
from pathlib import Path
import numba
numba.config.CACHE_DIR = sys.argv[2]
sys.path.insert(0, sys.argv[1])
from kernel import added, double
try:
    double(3)
except numba.TypingError:
    added(3)
locks = list(Path(sys.argv[2]).rglob("*.lock"))
for lock in locks:
    with open(lock) as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
print(len(locks))
"""


def test_nobody_waits_for_a_compilation_that_failed(module: Path) -> None:
    (module / "source" / "kernel.py").write_text(FAILING)
    assert said(module, FAILED) == ["2"]


def decorated(node: ast.FunctionDef) -> dict[str, object] | None:
    """Return the options of a function's ``njit``, or None."""
    for call in node.decorator_list:
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "njit":
            return {word.arg: getattr(word.value, "value", None) for word in call.keywords}
    return None


def test_entries_are_called_from_python_alone() -> None:
    """Another compiled function would find their names in the cache and nothing to take up."""
    entries, called = set(), set()
    for path in (ROOT / "pgmp_petsc").rglob("*.py"):
        if "@njit(" not in (text := path.read_text()):
            continue
        tree, module = ast.parse(text), ".".join(path.relative_to(ROOT).with_suffix("").parts)
        known = {
            alias.asname or alias.name: (node.module, alias.name)
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
        known |= {node.name: (module, node.name) for node in functions}
        for node in functions:
            options = decorated(node)
            if options is None:
                continue
            if options.get("entry"):
                entries.add((module, node.name))
            names = {item.id for item in ast.walk(node) if isinstance(item, ast.Name) and item.id != node.name}
            called |= {known[name] for name in names if name in known}
    assert len(entries) >= 8 and not entries & called


def test_an_entry_is_kept_without_what_others_would_take_up(kept: Path, module: Path) -> None:
    sizes = [path.stat().st_size for path in files(kept, "nbc")]
    (module / "source" / "kernel.py").write_text(KERNEL.replace("cache=True", "cache=True, entry=True"))
    for _ in range(2):  # compiled, then from the cache
        assert printed(module) == "6 1.0 None"
    own = [path.stat().st_size for path in files(module, "nbc")]
    assert len(own) == len(sizes) == 2 and max(own) < min(sizes)


CALLED = """
import numpy as np
from pgmp_petsc.lanes.compiled import njit
FACTOR, TABLE, OTHER = 2.0, np.arange(3.0), 5.0

@njit(cache=True)
def inner(x):
    return FACTOR * x + TABLE[0]

@njit(cache=True, apart=lambda x: x)
def called_by_address(x):
    return 3.0 * x

@njit(cache=True)
def not_called(x):
    return OTHER * x

@njit(cache=True)
def outer(x):
    'Words.'
    return inner(x) + called_by_address(x)
"""


@pytest.mark.parametrize(
    ("old", "new", "differs"),
    [
        ("FACTOR, TABLE, OTHER = 2.0", "FACTOR, TABLE, OTHER = 2.5", True), ("np.arange(3.0)", "np.ones(3)", True),
        ("FACTOR * x + TABLE", "FACTOR * x - TABLE", True),
        ("cache=True)\ndef inner", "cache=True, fastmath=True)\ndef inner", True),
        ("lambda x: x", "lambda x: x if x else x", True), ("inner(x) + called", "inner(x) - called", True),
        ("return 3.0", "return 4.0", False), ("5.0", "6.0", False), ("OTHER * x", "OTHER + x", False),
        ("Words.", "Others.", False),
    ],
)  # fmt: skip
def test_what_is_kept_is_marked_by_all_that_is_compiled_into_it(old: str, new: str, differs: bool) -> None:
    """Numba looks at the function's own file alone: code of a module that it calls would stay what it was."""
    marks = []
    for text in (CALLED, CALLED.replace(old, new)):
        names: dict = {"__name__": "called"}
        exec(text, names)
        marks.append(compiled.compiled_mark(names["outer"].py_func))
    assert CALLED.count(old) == 1 and (marks[0] != marks[1]) == differs


def test_a_value_whose_changes_nothing_tells_is_refused() -> None:
    names: dict = {"__name__": "called"}
    exec(CALLED.replace("FACTOR, TABLE, OTHER = 2.0,", "FACTOR, TABLE, OTHER = object(),"), names)
    with pytest.raises(TypeError, match="object"):
        compiled.compiled_mark(names["outer"].py_func)


def test_functions_apart(module: Path):
    """Their code is not in their callers; what is not called is not compiled, nor loaded from the cache."""
    (module / "source" / "apart.py").write_text(APART)
    (module / "source" / "caller.py").write_text(CALLER)
    for hits in ("[0, 0, 0] 0", "[1, 1, 1] 0", "[0, 1, 1] 0"):
        assert said(module, QUARTERS) == ["3.0 0.75 None", hits, "False", "not compiled"]
        if hits == "[1, 1, 1] 0":
            for kept in (module / "cache").rglob("*halved*"):
                kept.unlink()


def test_variables_are_found_where_numba_finds_them() -> None:
    """Those that live on, and each assigned once, of the longest function: as numba itself has them."""

    def own(name: str) -> ModuleType:
        spec = importlib.util.find_spec(f"numba.core.{name}")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    function = lagrangian.evaluate.py_func
    first, second = (run_frontend(function) for _ in range(2))
    life, analysis = VariableLifetime(first.blocks), own("analysis")
    assert life.livemap == analysis.compute_live_map(life.cfg, first.blocks, life.usedefs.usemap, life.usedefs.defmap)
    found, expected = ssa.reconstruct_ssa(first).blocks, own("ssa").reconstruct_ssa(second).blocks
    texts = [[(label, [str(each) for each in block.body]) for label, block in one.items()] for one in (found, expected)]
    assert texts[0] == texts[1]
    assert sum("phi(" in each for _, body in texts[0] for each in body) > 50


def test_python_collects_as_before_once_a_function_is_compiled_or_cannot_be() -> None:
    usual, seen = gc.get_threshold(), []

    class Watching(event.Listener):
        def on_start(self, _: event.Event) -> None:
            seen.append(gc.get_threshold())

        on_end = on_start

    with event.install_listener("numba:compile", Watching()):
        compiled.njit()(lambda x: x + 1)(1)
        with pytest.raises(numba.TypingError):
            compiled.njit()(lambda x: x.nothing)(1)
    assert compiled.COLLECTIONS in seen and gc.get_threshold() == usual != compiled.COLLECTIONS


def test_a_type_has_the_size_that_llvm_says() -> None:
    context = numba.njit(lambda: 0).targetctx
    for kind in (types.float64, types.boolean, types.Array(types.float64, 3, "C"), types.UniTuple(types.int32, 3)):
        found = context.get_value_type(kind)
        assert [context.get_abi_sizeof(found) for _ in range(2)] == [found.get_abi_size(context.target_data)] * 2
