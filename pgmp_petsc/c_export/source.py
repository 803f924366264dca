"""The files of a model in C: what is the same for all models, and sizes and tables of this one."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.c_export.constants import Constants
from pgmp_petsc.c_export.statements import braced, number
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
    sizes = [f"#define {name} {number(value)}" for name, value in constants.settings.items()]
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


def _array(values: np.ndarray) -> str:
    if values.ndim > 1:
        return "{" + ",\n".join(_array(row) for row in values) + "}"
    numbers = [repr(x) for x in values.tolist()]
    rows = [", ".join(numbers[k : k + PER_LINE]) for k in range(0, len(numbers), PER_LINE)]
    return "{" + ",\n".join(rows) + "}"


def _tables(constants: Constants) -> str:
    parts = ['#include "tables.h"\n\n#include <math.h>\n#include <stdbool.h>\n']
    for name, (shape, table) in constants.tables.items():
        kind = "int" if table.dtype.kind in "ib" else "double"
        parts.append(f"const {kind} {name}{shape} = {_array(table) if table.size else '{0}'};\n")
    served = [constants.served[name] for name in constants.parameters]
    names = {
        "parameter": constants.parameters, "strength": constants.strength_units, "output": constants.output_units
    }  # fmt: skip
    lists = {
        **{f"const char *const pgmp_{what}_names[]": [f'"{one}"' for one in own] for what, own in names.items()},
        "const int pgmp_prescribed[N]": map(int, constants.prescribed),
        "const double parameter_values[]": constants.parameters.values(),
        "const double parameter_lower[]": [one.to_own * one.low for one in served],
        "const double parameter_upper[]": [one.to_own * one.high for one in served],
        **constants.lists,
    }
    parts += constants.code  # lists of laws name their functions
    for declaration, entries in lists.items():
        listed = list(entries) or ["{0}" if " struct " in declaration else 0]  # C has no empty ones
        parts.append(f"{declaration} = {braced(*listed)};")
    return HEAD + "\n".join(parts) + "\n"
