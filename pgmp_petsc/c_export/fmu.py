"""A functional mock-up unit, FMI 2.0 or 3.0: a model in C with its description in a zip archive.

It is for co-simulation and for model exchange. The archive holds ``modelDescription.xml`` with its variables, the
sources, and a shared library for this machine where it has a C compiler.
"""

from __future__ import annotations

import hashlib
import math
import platform
import re
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.units import SI, measure, times
from pgmp_petsc.c_export.constants import Constants
from pgmp_petsc.c_export.source import HEAD, compiled_of, read_common, sources_of
from pgmp_petsc.files.claims import check_output, replacing
from pgmp_petsc.ranks.ending import TIME_IS_OVER, run_child

# value references, as in unit.h
BLOCK = 1_000_000
PARAMETERS, STRENGTHS, OUTPUTS, FOLLOWS, STATES, DERIVATIVES = (k * BLOCK for k in (0, 1, 2, 4, 5, 6))
ELASTIC_ROTATION, CORRECTION, VALIDITY, VALID, TIME = range(3 * BLOCK, 3 * BLOCK + 5)
REAL, WHOLE, BOOLEAN = "real", "whole", "Boolean"
TURNED = "largest rotation of a node less that of its rigid body"
LEFT = (
    "what Newton's iteration left in the last step, estimated, in units of the mechanism's size or of 1 rad; 0 in "
    "model exchange"
)
FLAGS = (
    "0 is fine, else a sum: 1 elastic rotation beyond its limit, 2 a coordinate outside the tables, 4 a step that "
    "failed and was not taken, 8 no finite number, 16 a parameter outside what the model was built for, 32 cycles "
    "that waited to be closed beyond the room that there is"
)


@dataclass(frozen=True)
class Variable:
    """A variable: name, value reference, kind (`REAL`, `WHOLE`, `BOOLEAN`), what FMI says of it, and a description."""

    name: str
    reference: int
    kind: str
    causality: str
    variability: str
    about: str
    start: str = ""  # value at the start, of what can be set
    derivative_of: int | None = None  # reference of the state whose derivative it is
    unit: str = ""  # in the scene's units, empty where there is none
    #: low, high: ends of the range that it is in, or that the model was built for; infinite where there are none
    low: float = -math.inf
    high: float = math.inf

    @property
    def is_state(self) -> bool:
        return STATES <= self.reference < DERIVATIVES


def quoted(name: str) -> str:
    """Return a name as structured names of FMI have it: one that is no identifier in quotes."""
    return name if re.fullmatch(r"[A-Za-z_]\w*", name, flags=re.ASCII) else f"'{name}'"


def variables_of(constants: Constants) -> list[Variable]:
    # values are in the units of the scene; what a parameter was given in is of its numbers only
    found, units = [], "SI units" if constants.system == SI else str(constants.system)
    parameter = "parameter", "tunable"
    for k, (name, value) in enumerate(constants.parameters.items()):
        served, unit = constants.served[name], constants.parameter_units[name]
        low, high = min(served.to_own * served.low, value), max(served.to_own * served.high, value)
        about = f"{units}; from min to max, its bounds or what the model was built for"
        about = units if math.isinf(high - low) else about
        setting = REAL, *parameter, about, repr(float(value)), None, unit, low, high
        found.append(Variable(f"parameters.{quoted(name)}", PARAMETERS + k, *setting))
    for k, (name, unit) in enumerate(constants.strength_units.items()):
        about = "strength at the end of a step, where it does not follow the scene"
        setting = REAL, "input", "continuous", about, "0.0"
        found.append(Variable(f"effects.{quoted(name)}", STRENGTHS + k, *setting, unit=unit))
        about = "whether the strength is the scene's over time, and the input is not looked at"
        if (follows := f"{name}_follows_scene") in constants.strength_units:
            cure = "give the effect another name and build anew, or export C99"
            raise InputError(f"effects.{follows}: an FMU has a variable of this name for effects.{name}; {cure}")
        found.append(Variable(f"effects.{quoted(follows)}", FOLLOWS + k, BOOLEAN, *parameter, about, "true"))
    output = REAL, "output", "continuous"
    for k, (name, unit) in enumerate(constants.output_units.items()):
        found.append(Variable(f"outputs.{quoted(name)}", OUTPUTS + k, *output, f"in {unit}", unit=unit))
    found += [
        Variable("elastic_rotation", ELASTIC_ROTATION, *output, TURNED, unit="rad", low=0.0),
        Variable("correction", CORRECTION, *output, LEFT, unit="1", low=0.0),
        Variable("validity", VALIDITY, WHOLE, "output", "discrete", FLAGS, low=0, high=63),
        Variable("valid", VALID, BOOLEAN, "output", "discrete", "whether validity is 0"),
    ]
    return [*found, *_states(constants)] if constants.exchanges else found


def _states(constants: Constants) -> list[Variable]:
    free, found = constants.free, []
    known = [constants.coordinate_units.get(name, "") for name in free]  # modal coordinates have units of their own
    inside = [quoted(name) if unit else name for name, unit in zip(free, known)]
    names = [*(f"states.{name}" for name in inside), *(f"rates.{name}" for name in inside)]
    units = [f"{unit}{per}" if unit else "" for per in ("", "/s", "/s2") for unit in known]
    setting, rates = (REAL, "local", "continuous"), units[len(free) :]
    for k, (name, unit) in enumerate(zip(names, units)):
        about = unit or "a modal coordinate" if k < len(free) else "rate of a state"
        found.append(Variable(name, STATES + k, *setting, about, unit=unit))
    for k, (name, unit) in enumerate(zip(names, rates)):
        found.append(Variable(f"der({name})", DERIVATIVES + k, *setting, "derivative of a state", "", STATES + k, unit))
    return found


CATEGORIES = ("logStatusWarning", "logStatusError")
KINDS = {
    2: {REAL: "Real", WHOLE: "Integer", BOOLEAN: "Boolean"},
    3: {REAL: "Float64", WHOLE: "Int32", BOOLEAN: "Boolean"},
}


def description(constants: Constants, version: int, identifier: str, token: str, sources: Sequence[str]) -> bytes:
    """Return modelDescription.xml of version 2 or 3 of FMI, for the library of that name.

    An importer shows the token at instantiation; sources are files to be compiled, for FMI 3.0 in `build_description`.
    """
    step, n_steps = constants.settings["STEP"], constants.settings["N_STEPS"]
    root = Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{version}.0",
            "modelName": constants.name,
            "guid" if version == 2 else "instantiationToken": token,
        },
        generationTool=f"pgmp_petsc {__version__}",
        variableNamingConvention="structured",
    )
    exchange = SubElement(root, "ModelExchange", modelIdentifier=identifier)
    if not constants.exchanges:
        root.remove(exchange)
    simulation = SubElement(
        root, "CoSimulation", modelIdentifier=identifier, canHandleVariableCommunicationStepSize="false"
    )
    if version == 2:
        root.set("numberOfEventIndicators", "0")
        for kind in root:
            kind.set("canNotUseMemoryManagementFunctions", "true")
            files = SubElement(kind, "SourceFiles")
            for name in sources:
                SubElement(files, "File", name=name)
    else:
        simulation.set("fixedInternalStepSize", repr(step))
    variables = variables_of(constants)
    _define_units(root, sorted({variable.unit for variable in variables} - {""} | {"s"}))
    categories = SubElement(root, "LogCategories")
    for name in CATEGORIES:
        SubElement(categories, "Category", name=name)
    SubElement(root, "DefaultExperiment", startTime="0", stopTime=repr(step * n_steps), stepSize=repr(step))
    _describe(root, variables, version)
    return _text(root)


def build_description(identifier: str, sources: Sequence[str]) -> bytes:
    """Return sources/buildDescription.xml of FMI 3.0."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    files = SubElement(
        SubElement(root, "BuildConfiguration", modelIdentifier=identifier), "SourceFileSet", language="C99"
    )
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    return _text(root)


def _text(root: Element) -> bytes:
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _define_units(root: Element, units: Sequence[str]) -> None:
    """Define units by their factors and exponents of kg, m, s and rad, which is a number where scenes calculate."""
    definitions = SubElement(root, "UnitDefinitions")
    for unit in units:
        factor, exponents = measure(unit)
        above, below = (sum(int(n or 1) for n in re.findall(r"rad(\d*)", part)) for part in unit.partition("/")[::2])
        known, entry = (*exponents, above - below), SubElement(definitions, "Unit", name=unit)
        base = {name: str(int(n)) for name, n in zip(("kg", "m", "s", "rad"), known) if n != 0}
        base |= {} if factor == 1.0 else {"factor": repr(times(1.0, factor))}
        if all(n == int(n) for n in known):  # FMI has no other powers
            SubElement(entry, "BaseUnit", base)


def _numbers(variable: Variable) -> dict[str, str]:
    found = {"unit": variable.unit} if variable.unit else {}
    found |= {key: str(end) for key, end in (("min", variable.low), ("max", variable.high)) if math.isfinite(end)}
    return found | ({"start": variable.start} if variable.start else {})


def _attributes(variable: Variable) -> dict[str, str]:
    return {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "causality": variable.causality,
        "variability": variable.variability,
        "description": variable.about,
    }


def _describe(root: Element, variables: Sequence[Variable], version: int) -> None:
    first, entries = version == 2, SubElement(root, "ModelVariables")
    if not first:
        variables = (Variable("time", TIME, REAL, "independent", "continuous", "time", unit="s"), *variables)
    # what others call a variable: FMI 2.0 by its place, later ones by its reference
    called = {variable.reference: str(k if first else variable.reference) for k, variable in enumerate(variables, 1)}
    for variable in variables:
        kind = KINDS[version][variable.kind]
        entry = SubElement(entries, "ScalarVariable" if first else kind, _attributes(variable))
        value = SubElement(entry, kind) if first else entry
        value.attrib |= _numbers(variable)
        if variable.is_state:
            entry.set("initial", "calculated")
        if variable.derivative_of is not None:
            value.set("derivative", called[variable.derivative_of])
    structure = SubElement(root, "ModelStructure")
    names = {"Outputs": "Output", "Derivatives": "ContinuousStateDerivative", "InitialUnknowns": "InitialUnknown"}
    for section, listed in _structure(variables).items():
        part = SubElement(structure, section) if first and listed else structure
        for variable in listed:
            name, key = ("Unknown", "index") if first else (names[section], "valueReference")
            SubElement(part, name, {key: called[variable.reference]})


def _structure(variables: Sequence[Variable]) -> dict[str, list[Variable]]:
    outputs = [variable for variable in variables if variable.causality == "output"]
    derivatives = [variable for variable in variables if variable.derivative_of is not None]
    unknown = [v for v in variables if v.causality == "output" or v.is_state or v.derivative_of is not None]
    return {"Outputs": outputs, "Derivatives": derivatives, "InitialUnknowns": unknown}


VERSIONS = (2, 3)
LONGEST_COMPILING = 1800.0  # s; the largest tables that are written take some minutes
OPTIONS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
# what the versions call this machine; FMI 2.0 has no name for others that this program runs on
PLATFORMS = {("Linux", "x86_64"): {2: "linux64", 3: "x86_64-linux"}}


def write_fmu(constants: Constants, path: str | Path, version: int = 2, compiler: str | None = None) -> str:
    """Write an FMU of version 2 or 3 of FMI, one process, and return the platform of its library, empty where it has
    sources only.

    The C compiler is by default ``cc`` or ``gcc`` in PATH. Raises `InputError` if the file cannot be written there;
    `RunError` if the compiler or the system fails.
    """
    path = check_output(path, "fmu")
    identifier = re.sub(r"\W", "_", constants.name, flags=re.ASCII)
    identifier = identifier if re.match(r"[A-Za-z_]", identifier) else f"model_{identifier}"
    own = f"fmi{version}.c"
    texts = {name: text for name, text in sources_of(constants).items() if name != "main.c"}
    texts |= {name: read_common(name) for name in ("unit.h", "unit.c", "fmi.h", own)}
    token = hashlib.sha256("".join(texts.values()).encode()).hexdigest()[:32]
    texts["fmu.h"] = f'{HEAD}#define FMU_GUID "{token}"\n'
    files = (own, "unit.c", *compiled_of(constants.kind))
    compiler = compiler or shutil.which("cc") or shutil.which("gcc")
    target = PLATFORMS.get((platform.system(), platform.machine()), {}).get(version, "")
    with TemporaryDirectory() as folder, replacing(path) as partial:
        library = _compiled(texts, files, Path(folder), identifier, compiler) if compiler and target else None
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.comment = f"written by pgmp_petsc {__version__}".encode()
            archive.writestr("modelDescription.xml", description(constants, version, identifier, token, files))
            for name, text in texts.items():
                archive.writestr(f"sources/{name}", text)
            if version == 3:
                archive.writestr("sources/buildDescription.xml", build_description(identifier, files))
            if library is not None:
                archive.write(library, f"binaries/{target}/{library.name}")
    return target if library is not None else ""


def _compiled(texts: Mapping[str, str], files: Sequence[str], folder: Path, identifier: str, compiler: str) -> Path:
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    library = folder / f"{identifier}.so"
    command = [compiler, *OPTIONS, "-o", library.name, *files, "-lm"]
    done = run_child(command, LONGEST_COMPILING, cwd=folder)
    if done.returncode == TIME_IS_OVER:
        raise RunError(f"C compiler {compiler} had not ended after {LONGEST_COMPILING:g} s")
    if done.returncode != 0:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        raise RunError(f"C compiler {compiler} ended with status {done.returncode}: {lines[0] if lines else 'no word'}")
    return library
