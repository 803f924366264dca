"""Imports run one way, and what needs no PETSc does not import it."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest
from conftest import ROOT

PACKAGE = ROOT / "pgmp_petsc"
FREE = ("base", "lanes", "ranks", "files")  # what every package may import
# A package may import those that stand before it. This is the order that the code really has: `outputs`
# and `results` need less than their place in the flow of data would allow (see `NEEDS`).
ORDER = (
    *FREE, "declare", "scene", "mesh", "bodies", "solvers", "components", "mechanism", "joints", "effects", "modes",
    "outputs", "controllers", "reduction", "stepping", "full", "reduced", "models", "gradients", "results", "estimates",
    "ensemble", "bench", "design", "studies", "figures", "c_export", "report", "texts", "api", "cli",
)  # fmt: skip
# packages that keep to fewer than their place allows
NEEDS = {
    "base": set(),
    "lanes": {"base"},
    "ranks": {"base"},
    "files": {"base", "ranks"},
    "scene": {"declare"},
    "mesh": set(),
    "declare": set(),
    "results": {"declare"},
    "bodies": {"scene", "mesh"},
    "solvers": set(),
    "mechanism": {"declare", "scene", "mesh", "bodies"},
    "joints": {"scene", "mechanism"},
    "effects": {"declare", "scene", "bodies", "mechanism"},
    "outputs": {"declare", "scene", "mesh", "bodies", "mechanism", "effects"},
    "figures": {"mesh", "results", "scene"},
    "report": {"declare", "results", "figures"},
    "texts": {"results", "reduction", "models", "studies"},  # the latter three for types
}
WITHOUT_PETSC = ("scene", "mesh", "figures", "report", "results", "declare", "texts")


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def run_of(path: Path) -> list[ast.stmt]:
    """Return a module's statements but for those for types only."""
    return [
        node for node in tree_of(path).body if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    ]


def statements(body: list[ast.AST]) -> Iterator[ast.AST]:
    """Yield statements and those within them."""
    for node in body:
        yield node
        for name in ("body", "handlers", "orelse", "finalbody", "cases"):
            yield from statements(getattr(node, name, []))


@cache
def imports_of(path: Path, for_types: bool = True) -> set[str]:
    """Return the modules that a file imports anywhere, also within functions and (unless told) for types only."""
    found = set()
    for node in statements(tree_of(path).body if for_types else run_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {_module(node.module, alias.name) for alias in node.names}
    return found


def _module(package: str, name: str) -> str:
    """Return the module that a name is imported from: the name itself, where it is a module of ours."""
    here = ROOT.joinpath(*package.split("."), name)
    return f"{package}.{name}" if here.with_suffix(".py").exists() or (here / "__init__.py").exists() else package


def packages_of(path: Path) -> set[str]:
    ours = [name.split(".") for name in imports_of(path) if name.split(".")[0] == "pgmp_petsc"]
    return {parts[1] if len(parts) > 1 else "" for parts in ours}


def files(package: str) -> list[Path]:
    """Return the modules of a package, without what an older version of it printed."""
    return sorted(path for path in (PACKAGE / package).rglob("*.py") if "__pycache__" not in path.parts)


def test_the_page_of_architecture_has_the_rooms_in_the_order_of_imports() -> None:
    rooms = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs/architecture.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert rooms == [*ORDER]


def test_every_package_has_its_place() -> None:
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == {*ORDER}


@pytest.mark.parametrize("package", ORDER)
def test_imports_run_one_way(package: str) -> None:
    allowed = {package, *NEEDS.get(package, ORDER[: ORDER.index(package)])}
    allowed |= set() if package in FREE else set(FREE)
    for path in files(package):
        assert packages_of(path) <= allowed, f"{path.relative_to(ROOT)} imports {packages_of(path) - allowed}"


#: What only the room of bodies asks: of what kind a body is. Elsewhere it is asked at most so often, of shapes.
KINDS = {"Assembled", "AssembledBody", "BeamStrains", "Body", "Component", "ContinuumShape", "FloatingBody", "LineMesh"}
KINDS |= {"Solid", "SolidMesh", "SolidStrains"}
MOST_ASKED = 12


def test_nobody_asks_bodies_for_their_kind() -> None:
    """Kinds are found: no module outside their room imports one, and few ask for those of shapes."""
    asked = []
    for path in PACKAGE.rglob("*.py"):
        if path.parent.name == "kinds" or path.parent.parent.name == "bodies" or path.parent.name == "bodies":
            continue
        assert not any("bodies.kinds" in name for name in imports_of(path)), path
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance":
                named = {one.id for one in ast.walk(node.args[1]) if isinstance(one, ast.Name)}
                asked += [f"{path}:{node.lineno}"] if named & KINDS else []
    assert len(asked) <= MOST_ASKED, asked


@pytest.mark.parametrize("level", ["modules", "rooms"])
def test_no_circles(level: str) -> None:
    """Neither modules nor rooms, those within rooms too, import each other in a circle: for types and in functions."""
    graph: dict[str, set[str]] = {}
    for path in files("."):
        parts = path.relative_to(ROOT).with_suffix("").parts
        own = _place(".".join(parts[:-1] if parts[-1] == "__init__" else parts), level)
        found = {_place(found, level) for found in imports_of(path) if found.startswith("pgmp_petsc")}
        graph[own] = graph.get(own, set()) | found - {own}
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " -> ".join([*above[above.index(name) :], name])
        if name not in done:
            for other in graph.get(name, ()):
                visit(other, (*above, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def _place(module: str, level: str) -> str:
    is_room = level == "modules" or ROOT.joinpath(*module.split(".")).is_dir()
    return module if is_room else module.rpartition(".")[0]


@pytest.mark.parametrize("package", WITHOUT_PETSC)
def test_no_petsc_in_the_source(package: str) -> None:
    for path in files(package):
        roots = {name.split(".")[0] for name in imports_of(path)}
        assert not roots & {"petsc4py", "slepc4py"}, path


def modules_of(packages: Iterable[str]) -> list[str]:
    paths = (path.relative_to(ROOT).with_suffix("").parts for package in packages for path in files(package))
    return [".".join(parts[:-1] if parts[-1] == "__init__" else parts) for parts in paths]


SCENE = str(ROOT / "pgmp_petsc" / "scene" / "templates" / "rotor.toml")
#: What a program does, and what it has not imported then.
UNLOADED = {
    "the package": ("import pgmp_petsc", {"numpy", "mpi4py", "petsc4py"}),
    "what needs no PETSc": (
        f"import importlib\nfor name in {modules_of(WITHOUT_PETSC)}: importlib.import_module(name)",
        {"petsc4py", "slepc4py", "mpi4py"},
    ),
    "scenes and meshes": (
        "import pgmp_petsc.scene, pgmp_petsc.mesh",
        {"petsc4py", "mpi4py", "scipy", "meshio", "gmsh", "matplotlib"},
    ),
    "a scene with numbers in mm and GPa": (f"from pgmp_petsc.scene import load_scene\nload_scene({SCENE!r})", {"pint"}),
}


@pytest.mark.parametrize("what", UNLOADED)
def test_what_importing_does_not_load(what: str) -> None:
    script, absent = UNLOADED[what]
    script += "\nimport sys\nprint(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, check=True)
    loaded = set(done.stdout.split())
    assert "pgmp_petsc" in loaded and not loaded & absent


@pytest.mark.parametrize("package", ORDER)
def test_petsc_and_mpi_are_imported_where_they_are_used(package: str) -> None:
    """Within functions alone, so that every module can be imported in a Python without them."""
    for path in files(package):
        for statement in run_of(path):
            names = {alias.name for alias in getattr(statement, "names", ())} | {getattr(statement, "module", "")}
            roots = {(name or "").split(".")[0] for name in names}
            assert not roots & {"petsc4py", "slepc4py", "mpi4py"}, path


@pytest.mark.parametrize("path", files("cli"), ids=lambda path: path.stem)
def test_the_command_line_calls_the_interface_and_nothing_else(path: Path) -> None:
    modules = imports_of(path, for_types=False)
    ours = {name.split(".")[1] for name in modules if name.startswith("pgmp_petsc.")}
    assert ours <= {"api", "cli", "results", *FREE}


@pytest.mark.parametrize("module", ["runs", "ensembles"])
def test_runs_of_a_reduced_model_import_nothing_that_builds_one(module: str) -> None:
    """A reduced model stands alone: no eigensolver, no reader of meshes."""
    script = f"import sys, pgmp_petsc.api.{module}, pgmp_petsc.api.sources\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, check=True)
    loaded = {name if name.startswith("pgmp_petsc") else name.split(".")[0] for name in done.stdout.split()}
    offline = [
        f"pgmp_petsc.{name}"
        for name in ("modes", "components", "solvers", "bench", "figures", "report", "c_export", "reduction.build")
    ]
    assert "pgmp_petsc.reduction.rom" in loaded and not loaded & {*offline, "slepc4py", "meshio"}
    if module == "ensembles":  # what single runs and few scenes have
        others = ["models.body_fields", "reduction.length_family"]
        others += ["results.tradeoff", "results.trajectory", "ensemble.joined"]
        others += ["ensemble.rare_run", "ensemble.importance"]
        assert not loaded & {f"pgmp_petsc.{name}" for name in others}


def test_no_module_gives_a_constant_twice() -> None:
    """The second one would be that of both."""
    for path in PACKAGE.rglob("*.py"):
        given = [node.targets[0].id for node in tree_of(path).body
                 if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)]  # fmt: skip
        assert not [name for name in given if given.count(name) > 1], path


def test_no_communicator_and_no_petsc_start_at_import() -> None:
    """Importing everything but the commands starts neither MPI's world nor PETSc with somebody's arguments."""
    for path in PACKAGE.rglob("*.py"):
        for statement in tree_of(path).body:
            if isinstance(statement, (ast.FunctionDef, ast.ClassDef)):
                continue
            names = {node.attr for node in ast.walk(statement) if isinstance(node, ast.Attribute)}
            assert "COMM_WORLD" not in names, path
