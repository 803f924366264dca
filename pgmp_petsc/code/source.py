"""The files of a model in C: what is the same for all models, and sizes and tables of this one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path

import numpy as np

from pgmp_petsc import __version__
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.code.constants import Constants, Output, Side
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.files import replacing

COMMON = ("model.h", "tables.h", "model.c", "main.c")
HEAD = f"/* written by pgmp_petsc {__version__} */\n\n"
PER_LINE = 6


def sources_of(constants: Constants) -> dict[str, str]:
    """Return the text of every file of a model in C by its name."""
    return {
        **{name: read_common(name) for name in COMMON},
        "sizes.h": _sizes(constants),
        "tables.c": _tables(constants),
    }


def read_common(name: str) -> str:
    """Return the text of a file that is the same for all models."""
    return files("pgmp_petsc.code").joinpath("c", name).read_text(encoding="utf-8")


def write_sources(constants: Constants, folder: str | Path) -> int:
    """Write a model in C into a folder, made if there is none, and return the number of bytes; one process.

    Raises
    ------
    InputError
        If the folder cannot be made, or a file in it is not of this program.
    RunError
        If the system fails to write.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"output folder '{folder}' is a file; give the name of a folder, or of an FMU, NAME.fmu")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"output folder '{folder}' cannot be made: {error.strerror}") from error
    texts = sources_of(constants)
    for name in texts:
        check_output(folder / name, "code")
    for name, text in texts.items():
        with replacing(folder / name) as partial:
            try:
                partial.write_text(text, encoding="utf-8")
            except UnicodeError as error:
                raise RunError(f"output file '{folder / name}' could not be written: {error}") from error
    return sum(len(text.encode()) for text in texts.values())


def _sizes(constants: Constants) -> str:
    lines = [f"#define {name} {_number(value)}" for name, value in constants.settings.items()]
    return HEAD + "#ifndef PGMP_SIZES_H\n#define PGMP_SIZES_H\n\n" + "\n".join(lines) + "\n\n#endif\n"


def _number(value: float) -> str:
    """Return a number that C reads back to the last bit; infinite ones become the largest there are."""
    if isinstance(value, (int, np.integer)):
        return f"({value})" if value < 0 else str(value)
    text = repr(float(np.clip(value, -1.7e308, 1.7e308)))
    return f"({text})" if value < 0 else text


def _array(values: np.ndarray) -> str:
    """Return nested braces around the numbers of an array."""
    if values.ndim == 1:
        numbers = [repr(x) for x in values.tolist()]
        rows = [", ".join(numbers[k : k + PER_LINE]) for k in range(0, len(numbers), PER_LINE)]
        return "{" + ",\n".join(rows) + "}"
    return "{" + ",\n".join(_array(row) for row in values) + "}"


def _tables(constants: Constants) -> str:
    dimensions = {
        "rigid_table": "[N_CELLS][N_TERMS][RIGID_POWERS]",
        "terms_table": "[N_ROWS][N_TERMS][END]",
        "loads_table": "[AT_LEAST_ONE(N_LOAD_TERMS)][N_ROWS][LOAD_END]",
        "shapes_table": "[N_ROWS][N_FACTORS][N_SHAPES]",
        "branch_table": "[3][N_BRANCH][N_BODIES][3]",
        "scale": "[N]",
        "winding": "[N_BODIES]",
        "node_points": "[][2]",
    }
    parts = ['#include "tables.h"\n\n#include <math.h>\n']
    for name, shape in dimensions.items():
        table = constants.tables[name]
        parts.append(f"const double {name}{shape} = {_array(table) if table.size else '{0}'};\n")
    names, served = list(constants.parameters), constants.served
    lower = [served[name].low if name in served else -math.inf for name in names]
    upper = [served[name].high if name in served else math.inf for name in names]
    parts += [
        _strings("pgmp_parameter_names", names),
        _strings("pgmp_load_names", constants.loads),
        _strings("pgmp_output_names", constants.outputs),
        _listed("const double parameter_values[]", map(_number, constants.parameters.values())),
        _listed("const double parameter_lower[]", map(_number, lower)),
        _listed("const double parameter_upper[]", map(_number, upper)),
        _listed("const int load_of_term[]", map(str, constants.load_of_term)),
        _listed("const int node_bodies[]", map(str, constants.node_bodies)),
        _pieces(constants),
        # behind the outputs: the joint that measures the coordinate
        _listed("const struct output outputs[]", map(_output, (*constants.outputs.values(), constants.measured))),
        _listed("const struct damper dampers[]", (f"{{{a}, {b}}}" for a, b in constants.dampers), "{-1, -1}"),
        _weigh(constants),
    ]
    return HEAD + "\n".join(parts)


def _listed(declaration: str, entries: Iterable[str], none: str = "0") -> str:
    """Return a list of entries; C has no empty ones."""
    return f"{declaration} = {{{', '.join(entries) or none}}};"


def _strings(name: str, values: Iterable[str]) -> str:
    return _listed(f"const char *const {name}[]", (f'"{value}"' for value in values))


def _pieces(constants: Constants) -> str:
    firsts, rows = [0], []
    for pieces in constants.loads.values():
        for piece in pieces:
            cubic = ", ".join(_number(float(c)) for c in (*piece.cubic, 0.0, 0.0, 0.0, 0.0)[:4])
            wave = ", ".join(_number(float(c)) for c in piece.wave)
            rows.append(f"{{{_number(piece.begin)}, {_number(float(piece.origin))}, {{{cubic}}}, {{{wave}}}}}")
        firsts.append(len(rows))
    return (
        _listed("const int load_pieces[]", map(str, firsts))
        + "\n"
        + _listed("const struct piece pieces[]", rows, "{0}")
    )


def _output(output: Output) -> str:
    numbers = ", ".join(_number(float(x)) for x in output.numbers)
    return f"{{{output.kind}, {output.axis}, {int(output.in_body)}, {_side(output.a)}, {_side(output.b)}, {numbers}}}"


def _side(side: Side) -> str:
    point, arm = (", ".join(_number(x) for x in place) for place in (side.point, side.arm))
    return f"{{{side.slot}, {side.body}, {{{point}}}, {{{arm}}}}}"


def _weigh(constants: Constants) -> str:
    """Return the function that evaluates the monomials."""
    numbers = {name: k for k, name in enumerate(constants.parameters)}
    lines = ["void weigh(const double *p, double *terms, double *loads, double *dampers) {"]
    lines.append("    (void)p, (void)terms, (void)loads, (void)dampers;")
    for into, monomials in (("terms", constants.weights), ("loads", constants.load_weights)):
        lines += [f"    {into}[{k}] = {_monomial(weight, numbers)};" for k, weight in enumerate(monomials)]
    for k, quantity in enumerate(constants.coefficients):
        lines.append(f"    dampers[{k}] = {_number(quantity.coefficient)} * {_monomial(quantity.monomial, numbers)};")
    return "\n".join([*lines, "}", ""])


def _monomial(monomial: Monomial, numbers: Mapping[str, int]) -> str:
    """Return a product of powers in C."""
    factors = [f"p[{numbers[name]}]" if e == 1 else f"pow(p[{numbers[name]}], {e})" for name, e in monomial.powers]
    return " * ".join(factors) or "1.0"
