"""Expressions of declarations: checked as they are declared, differentiated, and printed in Python and in C99.

An expression is a line of Python's arithmetic over declared names: ``+ - * / **``, comparisons, ``and``, ``or``,
``not``, ``a if b else c``, and the functions of `FUNCTIONS`. To check one takes Python's parser alone. sympy, whose
import takes half a second, is imported where something is to be printed: what was printed is kept in a file (`kept`).
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import keyword
import os
import re
import sys
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare.forms import in_c, in_python
from pgmp_petsc.declare.formulas import evaluated

FUNCTIONS = {"abs": 1, "atan": 1, "cos": 1, "exp": 1, "log": 1, "max": 2, "min": 2, "sin": 1, "sqrt": 1, "tanh": 1}
_ARITHMETIC = (
    ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Name, ast.Load, ast.Add, ast.Sub, ast.Mult, ast.Div,
    ast.Pow, ast.USub, ast.UAdd, ast.Not, ast.And, ast.Or, ast.Lt, ast.LtE, ast.Gt, ast.GtE,
)  # fmt: skip
HIGHEST_POWER = 4  # that is printed as a product
#: Modules that what is printed of expressions hangs on.
MARKED = ("pgmp_petsc.declare.expressions", "pgmp_petsc.declare.formulas", "pgmp_petsc.declare.forms")
#: What printed code means something else by, in C or in Python.
WORDS_OF_C = frozenset(
    "auto break case char const continue default do double else enum extern fabs float for goto if inline int long pow "
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile".split()
)


class Printed:
    """Declaration by expressions that is printed: it has a `name`, a `place` (file and line) and its `code`.

    What a plugin declares is printed when the plugin is loaded, so that one which cannot be is refused there.
    """

    #: File of every declaration so far, by kind and name.
    declared: ClassVar[dict[tuple[type, str], set[str]]] = {}
    name: str
    place: str
    code: types.ModuleType

    def enter(self) -> None:
        """Say that this is declared."""
        self.declared.setdefault((type(self), self.name), set()).add(self.file)

    @property
    def file(self) -> str:
        return self.place.rpartition(":")[0]

    @property
    def others(self) -> set[str]:
        """The other files that declare one of its kind and name."""
        return self.declared[type(self), self.name] - {self.file}


def called_at() -> str:
    """Return the file and line from which a dataclass is made whose ``__post_init__`` asks."""
    caller = sys._getframe(3)
    return f"{caller.f_code.co_filename}:{caller.f_lineno}"


def check_names(entry: str, names: Iterable[str], taken: Iterable[str], place: str) -> None:
    """Raise `InputError` if declared names are no names, come twice or are `taken`; `place` is a file and a line."""
    used = {*taken, *FUNCTIONS, *WORDS_OF_C}
    for name in names:
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
            raise InputError(f"{place}: {entry}: '{name}' is no name; take letters, digits and _, a letter first")
        if name in used:
            raise InputError(f"{place}: {entry}: the name '{name}' is taken; take another one")
        used.add(name)


def check(entry: str, text: object, names: Iterable[str], place: str) -> None:
    """Raise `InputError` if a text is no expression over some names: what it is and where it is declared, for the
    message."""
    names = list(names)
    listed = ", ".join((*names, *FUNCTIONS))
    allowed = f"an expression has numbers, {listed}, + - * / **, comparisons and 'a if b else c'"
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (AttributeError, SyntaxError, ValueError) as error:
        why = error.msg if isinstance(error, SyntaxError) else "write it as a text"
        raise InputError(f"{place}: {entry}: {text!r} is no expression ({why}); {allowed}") from None
    called = {node.func: node for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            fine = isinstance(node.func, ast.Name) and FUNCTIONS.get(node.func.id) == len(node.args)
            fine = fine and not node.keywords
        elif isinstance(node, ast.Constant):
            fine = type(node.value) in (int, float)
        elif isinstance(node, ast.Name) and node not in called:
            if node.id not in names:
                raise InputError(f"{place}: {entry}: '{text}' names '{node.id}', which is not declared; {allowed}")
            fine = True
        else:
            fine = isinstance(node, _ARITHMETIC)
        if not fine:
            found = ast.unparse(node) or type(node).__name__
            raise InputError(f"{place}: {entry}: '{text}' has '{found}'; {allowed}")


def symbolic(text: str, names: Mapping[str, Any]) -> Any:
    """Return an expression that was checked in sympy's form, with the values of its names."""
    import sympy as sp

    # cases in place of functions with corners, whose derivatives sympy would write with Heaviside's
    cornered = {
        "abs": lambda a: sp.Piecewise((-a, a < 0), (a, True)),
        "max": lambda a, b: sp.Piecewise((a, a > b), (b, True)),
        "min": lambda a, b: sp.Piecewise((a, a < b), (b, True)),
    }
    algebra = types.SimpleNamespace(
        number=sp.sympify,
        compared=lambda ordering, a, b: ordering(a, b),
        joined=lambda word, tests: {"and": sp.And, "or": sp.Or, "not": sp.Not}[word](*tests),
        chosen=lambda test, body, orelse: sp.Piecewise((body, test), (orelse, True)),
        called=lambda name, *given: (cornered.get(name) or getattr(sp, name))(*given),
    )
    return evaluated(text.strip(), names, algebra)


def printed(expressions: Sequence[Any], for_c: bool = False) -> tuple[list[str], list[str]]:
    """Return the statements that make what expressions share, as of `declare.forms`, and the expressions, in Python or
    in C.

    What they share has names that nothing declared may have (`check_names`).
    """
    import sympy as sp
    from sympy.codegen.rewriting import create_expand_pow_optimization
    from sympy.logic.boolalg import Boolean
    from sympy.printing.pycode import PythonCodePrinter

    class Quotients(PythonCodePrinter):
        """Writes negative powers as quotients: of zero they end a compiled function, in cases not taken too."""

        def _print_Pow(self, expr: Any, rational: bool = False) -> str:
            if expr.exp.is_Integer and expr.exp < 0:
                return f"(1.0/({self._print(expr.base**-expr.exp)}))"
            return super()._print_Pow(expr, rational=rational)

        def _print_NaN(self, expr: Any) -> str:
            return "(1e999 - 1e999)"

    python = Quotients({"fully_qualified_modules": False})
    products = create_expand_pow_optimization(HIGHEST_POWER, base_req=lambda base: True)

    def without_overflow(inside: Any) -> Any:
        """Write ``log(a + b exp(u))`` as ``u + log(a exp(-u) + b)`` where u is positive."""
        grows = next(iter(inside.atoms(sp.exp)), None)
        b = 0 if grows is None else inside.coeff(grows)
        if b == 0 or (inside - b * grows).has(sp.exp):
            return sp.log(inside)
        u = grows.args[0]
        return sp.Piecewise((u + sp.log((inside - b * grows) / grows + b), u > 0), (sp.log(inside), True))

    def text(one: Any) -> str:
        one = products(one)
        return " ".join(sp.ccode(one).split()) if for_c else python.doprint(one)

    # what is divided by 0 in every state is no number: checks of a start then refuse it with its entry
    finite = [sp.sympify(one).xreplace({sp.zoo: sp.nan}).replace(sp.log, without_overflow) for one in expressions]
    shared, left = sp.cse(finite, sp.numbered_symbols("_"))

    def value(one: Any) -> str:
        return text(one) if for_c or isinstance(one, Boolean) else f"float({text(one)})"

    return [f"let {name} = {text(one)}" for name, one in shared], [value(one) for one in left]


class Statements:
    """Statements of one function, as of `declare.forms`, with expressions in Python or in C."""

    def __init__(self, for_c: bool = False) -> None:
        self._for_c, self._n_calls = for_c, 0

    def of(self, targets: Iterable[str], expressions: Sequence[Any]) -> list[str]:
        """Return what gives the values of expressions to targets, such as ``let x`` or ``found[0]``. What they share
        has the names of no other call: in C a name is declared once."""
        if not expressions:
            return []
        self._n_calls += 1
        shared, values = printed(expressions, self._for_c)
        lines = [*shared, *map("{} = {}".format, targets, values)]
        return [re.sub(r"\b_(?=\d)", f"_{self._n_calls}_", line) for line in lines]

    def text(self, lines: Iterable[str]) -> str:
        """Return the body of the function."""
        return "\n".join(f"    {line}" for line in (in_c if self._for_c else in_python)(lines))


def kept(name: str, key: str, beside: Path, text: Callable[[], str]) -> types.ModuleType:
    """Return the module of a name of printed code, of which the text depends on the key alone: from a file, or printed
    and kept in one.

    What is in the folder ``__pycache__`` beside the file that declares it is taken from there. New files lie where
    numba's cache is: in ``NUMBA_CACHE_DIR`` if that is set, otherwise beside, or in the user's cache. Where none can be
    written, the module has no file, and numba says so. Several processes may print the same one at once: each writes a
    file of its own and moves it into place.
    """
    stem = f"pgmp_printed_{name}_{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    if stem in sys.modules:
        return sys.modules[stem]
    source, chosen = beside.parent / "__pycache__", os.environ.get("NUMBA_CACHE_DIR")
    folders = [Path(chosen)] if chosen else [source, Path.home() / ".cache" / "pgmp_petsc"]
    for folder in (source, *folders):
        found = _loaded(stem, folder / f"{stem}.py")
        if found is not None:
            return found
    new = text()
    for folder in folders:
        path = folder / f"{stem}.py"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            own = path.with_name(f".{stem}.{os.getpid()}")
            own.write_text(new, encoding="utf-8")
            os.replace(own, path)
        except OSError:
            continue
        found = _loaded(stem, path)
        if found is not None:
            return found
    found = sys.modules[stem] = types.ModuleType(stem)
    exec(compile(new, f"<{stem}>", "exec"), found.__dict__)
    return found


def _loaded(stem: str, path: Path) -> types.ModuleType | None:
    """Return the module of a file; None where there is none, or it is damaged."""
    if not path.is_file():
        return None
    spec = importlib.util.spec_from_file_location(stem, path)
    found = sys.modules[stem] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(found)
        assert found.COMPLETE
    except Exception:  # whatever a damaged file raises: it is printed again
        del sys.modules[stem]
        return None
    return found
