"""``modelDescription.xml`` of a functional mock-up unit: FMI 2.0 and 3.0, co-simulation and model exchange."""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from pgmp_petsc import __version__
from pgmp_petsc.code.constants import Constants
from pgmp_petsc.code.variables import BOOLEAN, REAL, TIME, WHOLE, Variable, variables_of
from pgmp_petsc.scene.units import measure

CATEGORIES = ("logStatusWarning", "logStatusError")
KINDS = {
    2: {REAL: "Real", WHOLE: "Integer", BOOLEAN: "Boolean"},
    3: {REAL: "Float64", WHOLE: "Int32", BOOLEAN: "Boolean"},
}


def description(constants: Constants, version: int, identifier: str, token: str, sources: Sequence[str]) -> bytes:
    """Return modelDescription.xml.

    Parameters
    ----------
    version
        Of FMI, 2 or 3.
    identifier
        Name of the library.
    token
        What an importer shows at instantiation.
    sources
        Files to be compiled; of FMI 3.0 they stand in `build_description`.
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
    simulation = SubElement(
        root, "CoSimulation", modelIdentifier=identifier, canHandleVariableCommunicationStepSize="false"
    )
    if version == 2:
        root.set("numberOfEventIndicators", "0")
        for kind in (exchange, simulation):
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
    (_describe_2 if version == 2 else _describe_3)(root, variables)
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
    """Define units by their exponents of kg, m, s and rad, which is a number where scenes calculate."""
    definitions = SubElement(root, "UnitDefinitions")
    for unit in units:
        _, exponents = measure(unit)
        above, _, below = unit.partition("/")
        turns = above.split().count("rad") - below.split().count("rad")
        known = dict(zip(("kg", "m", "s", "rad"), (*exponents, turns)))
        base = {name: str(int(exponent)) for name, exponent in known.items() if exponent != 0}
        SubElement(SubElement(definitions, "Unit", name=unit), "BaseUnit", base)


def _numbers(variable: Variable) -> dict[str, str]:
    """Return unit, range and value at the start of a variable, as far as it has them."""
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


def _describe_2(root: Element, variables: Sequence[Variable]) -> None:
    entries = SubElement(root, "ModelVariables")
    numbers = {variable.reference: k + 1 for k, variable in enumerate(variables)}
    for variable in variables:
        entry = SubElement(entries, "ScalarVariable", _attributes(variable))
        if variable.is_state:
            entry.set("initial", "calculated")
        value = SubElement(entry, KINDS[2][variable.kind], _numbers(variable))
        if variable.derivative_of is not None:
            value.set("derivative", str(numbers[variable.derivative_of]))
    structure = SubElement(root, "ModelStructure")
    for section, listed in _structure(variables).items():
        part = SubElement(structure, section)
        for variable in listed:
            SubElement(part, "Unknown", index=str(numbers[variable.reference]))


def _describe_3(root: Element, variables: Sequence[Variable]) -> None:
    entries = SubElement(root, "ModelVariables")
    time = Variable("time", TIME, REAL, "independent", "continuous", "time", unit="s")
    for variable in (time, *variables):
        entry = SubElement(entries, KINDS[3][variable.kind], _attributes(variable) | _numbers(variable))
        if variable.is_state:
            entry.set("initial", "calculated")
        if variable.derivative_of is not None:
            entry.set("derivative", str(variable.derivative_of))
    structure = SubElement(root, "ModelStructure")
    names = {"Outputs": "Output", "Derivatives": "ContinuousStateDerivative", "InitialUnknowns": "InitialUnknown"}
    for section, listed in _structure(variables).items():
        for variable in listed:
            SubElement(structure, names[section], valueReference=str(variable.reference))


def _structure(variables: Sequence[Variable]) -> dict[str, list[Variable]]:
    outputs = [variable for variable in variables if variable.causality == "output"]
    derivatives = [variable for variable in variables if variable.derivative_of is not None]
    unknown = [v for v in variables if v.causality == "output" or v.is_state or v.derivative_of is not None]
    return {"Outputs": outputs, "Derivatives": derivatives, "InitialUnknowns": unknown}
