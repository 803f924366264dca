"""The files of a model in C: what is the same for all models, and sizes and tables of this one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import accumulate
from pathlib import Path

import numpy as np

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.bodies.affine import AffineSum, Monomial
from pgmp_petsc.c_export.constants import Along, Constants
from pgmp_petsc.c_export.statements import (
    ActionInC,
    CountInC,
    ForceInC,
    PartInC,
    ReadingInC,
    Side,
    StatementInC,
    TermInC,
    monomial_in_c,
)
from pgmp_petsc.effects.time_function import Piece
from pgmp_petsc.files.claims import check_output, locked, replacing
from pgmp_petsc.mechanism import statements
from pgmp_petsc.mechanism.statements import KINDS
from pgmp_petsc.reduced import lagrangian

SHARED = ("steps", "statements", "over_time", "actions", "control", "kinematics", "outputs", "counts")
#: Parts of each kind of model beside the shared ones; the first has a header too.
OWN = {"reduced": ("reduced", "interpolation", "lagrangian", "solution", "forces"), "tree": ("tree", "reactions")}
COLUMNS = {"elastic_rotation", "validity"}  # of `main.c` beside outputs
OLDER = "model.c"  # what `steps.c` was called
PRINTED = {"lagrangian": lagrangian, "statements": statements}
HEAD = f"/* written by pgmp_petsc {__version__} */\n\n"
PRINTED_HEAD = f'{HEAD}#include <math.h>\n#include <string.h>\n\n#include "tables.h"\n\n'
PER_LINE = 6


def compiled_of(kind: str) -> tuple[str, ...]:
    """Return the names of the files that are compiled of a kind of models in C."""
    return (*(f"{part}.c" for part in (*SHARED, *OWN[kind])), "tables.c")


def sources_of(constants: Constants) -> dict[str, str]:
    parts = [name for name in compiled_of(constants.kind)[:-1] if name.removesuffix(".c") not in PRINTED]
    sizes = [f"#define {name} {_number(value)}" for name, value in constants.settings.items()]
    lengths = " || ".join(f"(kind) == {kind.name}" for kind in KINDS if kind.unit == "m")
    sizes += [f"enum {{ {', '.join(kind.name for kind in KINDS)} }};", f"#define IS_LENGTH(kind) ({lengths})"]
    return {
        **{name: read_common(name) for name in ("model.h", "tables.h", *parts, "main.c")},
        "equations.h": read_common(f"{OWN[constants.kind][0]}.h"),
        **{
            f"{name}.c": PRINTED_HEAD + module.CODE.C
            for name, module in PRINTED.items()
            if f"{name}.c" in compiled_of(constants.kind)
        },
        "sizes.h": HEAD + "#ifndef PGMP_SIZES_H\n#define PGMP_SIZES_H\n\n" + "\n".join(sizes) + "\n\n#endif\n",
        "tables.c": _tables(constants),
    }


def read_common(name: str) -> str:
    """Return the text of a file that is the same for all models."""
    return files("pgmp_petsc.c_export").joinpath("c", name).read_text(encoding="utf-8")


def write_sources(constants: Constants, folder: str | Path) -> int:
    """Write a model in C into a folder, made if there is none, and return the number of bytes; one process. Raises
    `InputError` if the folder cannot be made, a file in it is not of this program, or an output has a name that it may
    not have; `RunError` if the system fails to write."""
    for name in sorted(COLUMNS & constants.output_units.keys()):
        raise InputError(f"outputs.{name}: main.c prints a column of this name; give the output another, build anew")
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"output folder '{folder}' is a file; give the name of a folder, or of an FMU, NAME.fmu")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"output folder '{folder}' cannot be made: {error.strerror}") from error
    texts = sources_of(constants)
    with locked(folder / "steps.c", f"output folder '{folder}'"):  # files of two models make none
        for name in texts:
            check_output(folder / name, "code")
        for name, text in texts.items():
            with replacing(folder / name) as partial:
                try:
                    partial.write_text(text, encoding="utf-8")
                except UnicodeError as error:
                    raise RunError(f"output file '{folder / name}' could not be written: {error}") from error
        for name in {OLDER, *(name for kind in OWN for name in compiled_of(kind))} - set(texts):
            if (folder / name).exists():  # `cc *.c` would link it too
                check_output(folder / name, "code").unlink()
    return sum(len(text.encode()) for text in texts.values())


def _number(value: float) -> str:
    """Return a number that C reads back to the last bit; infinite ones become the largest there are."""
    if isinstance(value, (int, np.integer)):
        return f"({value})" if value < 0 else str(value)
    text = repr(float(np.clip(value, -1.7e308, 1.7e308)))
    return f"({text})" if value < 0 else text


def _array(values: np.ndarray) -> str:
    if values.ndim == 1:
        numbers = [repr(x) for x in values.tolist()]
        rows = [", ".join(numbers[k : k + PER_LINE]) for k in range(0, len(numbers), PER_LINE)]
        return "{" + ",\n".join(rows) + "}"
    return "{" + ",\n".join(_array(row) for row in values) + "}"


def _tables(constants: Constants) -> str:
    parts = ['#include "tables.h"\n\n#include <math.h>\n#include <stdbool.h>\n']
    for name, (shape, table) in constants.tables.items():
        number = "int" if table.dtype.kind in "ib" else "double"
        parts.append(f"const {number} {name}{shape} = {_array(table) if table.size else '{0}'};\n")
    parts += [_listed(declaration, entries) for declaration, entries in constants.lists.items()]
    names = list(constants.parameters)
    served = [constants.served[name] for name in names]
    parts += [_listed(f"const struct axis {name}[R]", map(_axis, axes)) for name, axes in constants.axes.items()]
    measured = [part for action in constants.actions for part in action.parts]
    of_forces = [term for force in constants.outputs.forces for term in force.terms]
    every = [*constants.closure, *(part.term for part in measured), *of_forces, *(constants.constraints or ())]
    first, last = len(constants.closure), len(constants.closure) + len(measured)
    held = last + len(of_forces)
    terms, lasts = list(_terms(every)), list(accumulate(len(action.parts) for action in constants.actions))
    lasts_of_forces = list(accumulate(len(force.terms) for force in constants.outputs.forces))
    parts += [
        _strings("pgmp_parameter_names", names),
        _strings("pgmp_strength_names", constants.strengths),
        _strings("pgmp_output_names", constants.output_units),
        _listed("const int pgmp_prescribed[N]", map(int, constants.prescribed)),
        _listed("const double parameter_values[]", constants.parameters.values()),
        _listed("const double parameter_lower[]", (one.to_own * one.low for one in served)),
        _listed("const double parameter_upper[]", (one.to_own * one.high for one in served)),
        _listed("const double closure_wanted[]", constants.closure_wanted),
        _listed("const int load_of_term[]", constants.load_of_term),
        _listed("const double strength_sizes[]", constants.strength_sizes),
        _listed("const int strength_of_load[]", constants.strength_of_load),
        _listed("const int action_nodes[]", constants.action_slots),
        _listed("const int carried_actions[]", constants.carried_actions),
        _pieces(
            [*constants.strengths.values(), *constants.motions, *constants.outputs.courses]
            + [one.reference for one in constants.controls]
        ),
        _listed("const struct statement coordinates[R]", map(_statement, constants.coordinates)),
        _listed("const struct term closure[]", terms[:first]),
        _listed("const struct spline_piece spline_pieces[]", _spline_pieces(every)),
        _listed("const struct reading readings[]", map(_reading, constants.outputs.readings)),
        _listed("const struct force forces[]", map(_force, constants.outputs.forces, lasts_of_forces)),
        _listed("const struct term force_terms[]", terms[last:held]),
        *dict.fromkeys(action.law.code.C for action in constants.actions),
        *dict.fromkeys(one.law.code.C for one in constants.controls),
        _listed("const struct control controls[]", _controls(constants)),
        _listed("const int control_actions[]", constants.control_actions),
        _listed("const double control_origins[]", constants.control_origins),
        _listed("const struct action actions[]", map(_action, constants.actions, [0, *lasts])),
        _listed("const struct part action_parts[]", map(_part, measured, terms[first:last])),
        _weigh(constants),
        *([] if constants.gap_weights is None else [_weigh_gaps(constants.gap_weights, constants.parameters_in_c)]),
        _combine(constants),
        _listed("const struct count counts[]", map(_count, constants.outputs.counts)),
        _weigh_counts(constants.outputs.counts),
    ]
    if constants.constraints is not None:
        parts.append(_listed("const struct term constraints[]", terms[held:]))
    return HEAD + "\n".join(parts)


def _listed(declaration: str, entries: Iterable[str | float]) -> str:
    """Return a list of numbers, or of what is in C already; C has no empty ones."""
    listed = ", ".join(entry if isinstance(entry, str) else _number(entry) for entry in entries)
    return f"{declaration} = {{{listed or ('{0}' if ' struct ' in declaration else '0')}}};"


def _function(head: str, arguments: str, lines: Iterable[str]) -> str:
    """Return a function with such arguments, of which it need not use any."""
    unused = ", ".join(f"(void){name}" for name in arguments.split())
    return "\n    ".join([f"void {head} {{", f"{unused};", *lines]) + "\n}\n"


def _strings(name: str, values: Iterable[str]) -> str:
    return _listed(f"const char *const {name}[]", (f'"{value}"' for value in values))


def _numbers(values: Iterable[float]) -> str:
    return f"{{{', '.join(_number(float(value)) for value in values)}}}"


def _axis(axis: Along) -> str:
    whole = f"{axis.n_cells}, {axis.n_rows}, {int(axis.periodic)}, {int(axis.b_spline)}"
    return f"{{{_number(axis.lower)}, {_number(axis.step)}, {whole}}}"


def _pieces(functions: Sequence[Sequence[Piece]]) -> str:
    firsts, rows = [0], []
    for pieces in functions:
        for piece in pieces:
            cubic = _numbers((*piece.cubic, *(0.0,) * 5)[:5])
            begin, origin = (_number(float(time)) for time in (piece.begin, piece.origin))
            rows.append(f"{{{begin}, {origin}, {cubic}, {_numbers(piece.wave)}}}")
        firsts.append(len(rows))
    return _listed("const int function_pieces[]", firsts) + "\n" + _listed("const struct piece pieces[]", rows)


def _side(side: Side) -> str:
    return f"{{{side.slot}, {side.body}, {_numbers(side.point)}, {_numbers(side.arm)}}}"


def _statement(part: StatementInC) -> str:
    directions = ", ".join(_numbers(axis) for axis in part.statement.axes)
    return f"{{{part.statement.kind}, {_numbers(part.turns)}, {{{directions}}}, {_side(part.a)}, {_side(part.b)}}}"


def _terms(terms: Sequence[TermInC]) -> Iterator[str]:
    """Yield terms of the closure and of local effects, each with the first of its spline's pieces among those of all,
    and their number."""
    first = 0
    for term in terms:
        n = len(term.function.coefficients)
        numbers = f"{term.row}, {first}, {n}, {int(term.left)}, {_number(term.function.factor)}"
        yield f"{{{numbers}, {_statement(term.statement)}}}"
        first += n


def _spline_pieces(terms: Sequence[TermInC]) -> Iterator[str]:
    for function in (term.function for term in terms):
        for begin, end, cubic in zip(function.breaks[:-1], function.breaks[1:], function.coefficients):
            yield f"{{{_number(float(begin))}, {_number(float(end))}, {_numbers(map(float, cubic))}}}"


def _reading(reading: ReadingInC) -> str:
    where = f"{reading.kind}, {reading.axis}, {int(reading.in_body)}, {_number(reading.origin)}"
    return f"{{{where}, {_statement(reading.statement)}}}"


def _force(force: ForceInC, last: int) -> str:
    numbers = (last - len(force.terms), last, force.component, int(force.turning), int(force.in_body))
    sides = f"{_side(force.a)}, {_side(force.b)}"
    return f"{{{', '.join(map(str, numbers))}, {_number(force.sign)}, {_numbers(force.axis)}, {sides}}}"


def _combine(constants: Constants) -> str:
    arrays = "double (*bases)[3], double (*readings)[3], double (*acting)[3], double outputs[], double counted[]"
    head, names = f"combine(double time, const double *p, {arrays})", "time p bases readings acting outputs counted"
    return _function(head, names, [constants.outputs.combined])


def _count(count: CountInC) -> str:
    return f"{{{count.output}, {len(count.curve)}, {_number(count.run_out)}}}"


def _weigh_counts(counts: Sequence[CountInC]) -> str:
    lines = []
    for k, count in enumerate(counts):
        for part, numbers in enumerate(count.curve):
            lines += [f"curves[{k}][{part}][{i}] = {number};" for i, number in enumerate(numbers)]
        lines.append(f"ultimates[{k}] = {count.ultimate};")
    head = "weigh_counts(const double *p, double (*curves)[MOST_PARTS][3], double ultimates[])"
    return _function(head, "p curves ultimates", lines)


def _action(action: ActionInC, first: int) -> str:
    last = first + len(action.parts)
    numbers = (
        first, last, action.strength, action.edge, len(action.law.edges), action.role, int(action.controlled),
        int(action.law.bends),
    )  # fmt: skip
    return f"{{{', '.join(map(str, (*numbers, f'law_{action.law.name}')))}}}"


def _part(part: PartInC, term: str) -> str:
    return f"{{{', '.join(map(str, part.nodes))}, {_numbers(part.winding)}, {term}}}"


def _controls(constants: Constants) -> Iterator[str]:
    """Yield the controllers, whose references are functions of time behind all others."""
    before = len(constants.strengths) + len(constants.motions) + len(constants.outputs.courses)
    for k, one in enumerate(constants.controls):
        function = before + k if one.reference else -1
        numbers = (len(one.law.states), one.law.n_motions, one.column, one.row, one.every, function)
        name = one.law.name
        yield f"{{{', '.join(map(str, numbers))}, {len(one.parameters) - 1}, control_{name}, start_{name}}}"


def _weigh(constants: Constants) -> str:
    numbers, lines = constants.parameters_in_c, []
    for k, one in enumerate(constants.controls):
        for i, value in enumerate(one.parameters):
            text = numbers.get(value, "") if isinstance(value, str) else _number(float(value))
            lines.append(f"controls[{k}][{i}] = {text};")
    weights = {"terms": constants.weights, "loads": constants.load_weights, "given": constants.given}
    for into, monomials in weights.items():
        lines += [f"{into}[{k}] = {monomial_in_c(weight, numbers)};" for k, weight in enumerate(monomials)]
    for k, law in enumerate(constants.laws):
        for i, quantity in enumerate(law):
            parts = quantity if isinstance(quantity, AffineSum) else (quantity,)
            terms = [f"{_number(float(one.coefficient))} * {monomial_in_c(one.monomial, numbers)}" for one in parts]
            lines.append(f"laws[{k}][{i}] = {' + '.join(terms)};")
    arrays = "double *terms, double *loads, double (*laws)[N_LAW], double *given"
    head = f"weigh(const double *p, {arrays},\n           double (*controls)[AT_LEAST_ONE(N_CONTROL)])"
    return _function(head, "p terms loads laws given controls", lines)


def _weigh_gaps(weights: Sequence[Monomial], numbers: Mapping[str, str]) -> str:
    lines = (f"weights[{k}] = {monomial_in_c(one, numbers)};" for k, one in enumerate(weights))
    return _function("weigh_gaps(const double *p, double *weights)", "p weights", lines)
