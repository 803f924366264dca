"""A functional mock-up unit for co-simulation, FMI 2.0: a model in C with its description in a zip archive.

The archive holds the sources, and a shared library for this machine where it has a C compiler.
"""

from __future__ import annotations

import hashlib
import platform
import re
import shutil
import subprocess
import zipfile
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from pgmp_petsc import __version__
from pgmp_petsc.code.constants import Constants
from pgmp_petsc.code.source import HEAD, read_common, sources_of
from pgmp_petsc.runtime.claims import check_output
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.files import replacing

COMPILED = ("fmi2.c", "model.c", "tables.c")
OPTIONS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
PLATFORMS = {("Linux", "x86_64"): "linux64"}  # FMI 2.0 has no name for others that this program runs on
STRENGTHS, OUTPUTS, FURTHER = 1_000_000, 2_000_000, 3_000_000  # value references, as in fmi2.c
VALIDITY = (
    "0 is fine, else a sum: 1 elastic rotation beyond its limit, 2 coordinate outside the tables, 4 steps not "
    "converged, 8 no finite number, 16 a parameter outside what the model was built for"
)


def write_fmu(constants: Constants, path: str | Path, compiler: str | None = None) -> str:
    """Write an FMU, one process, and return the platform of its library, empty where it has sources only.

    Parameters
    ----------
    compiler
        C compiler to call, by default ``cc`` or ``gcc`` in PATH.

    Raises
    ------
    InputError
        If the file cannot be written there.
    RunError
        If the compiler or the system fails.
    """
    path = check_output(path, "fmu")
    identifier = re.sub(r"\W", "_", constants.name, flags=re.ASCII)
    identifier = identifier if re.match(r"[A-Za-z_]", identifier) else f"model_{identifier}"
    texts = {name: text for name, text in sources_of(constants).items() if name != "main.c"}
    texts["fmi2.c"] = read_common("fmi2.c")
    guid = hashlib.sha256("".join(texts.values()).encode()).hexdigest()[:32]
    texts["fmu.h"] = f'{HEAD}#define FMU_GUID "{guid}"\n'
    compiler, target = compiler or shutil.which("cc") or shutil.which("gcc"), _platform()
    with TemporaryDirectory() as folder, replacing(path) as partial:
        library = _compiled(texts, Path(folder), identifier, compiler) if compiler and target else None
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.comment = f"written by pgmp_petsc {__version__}".encode()
            archive.writestr("modelDescription.xml", description(constants, identifier, guid))
            for name, text in texts.items():
                archive.writestr(f"sources/{name}", text)
            if library is not None:
                archive.write(library, f"binaries/{target}/{library.name}")
    return target if library is not None else ""


def _platform() -> str:
    return PLATFORMS.get((platform.system(), platform.machine()), "")


def _compiled(texts: Mapping[str, str], folder: Path, identifier: str, compiler: str) -> Path:
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    library = folder / f"{identifier}.so"
    command = [compiler, *OPTIONS, "-o", library.name, *COMPILED, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        raise RunError(f"C compiler {compiler} ended with status {done.returncode}: {lines[0] if lines else 'no word'}")
    return library


def description(constants: Constants, identifier: str, guid: str) -> bytes:
    """Return modelDescription.xml."""
    step, n_steps = constants.settings["STEP"], constants.settings["N_STEPS"]
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=constants.name,
        guid=guid,
        generationTool=f"pgmp_petsc {__version__}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    simulation = ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identifier,
        canHandleVariableCommunicationStepSize="false",
        canNotUseMemoryManagementFunctions="true",
    )
    sources = ElementTree.SubElement(simulation, "SourceFiles")
    for name in COMPILED:
        ElementTree.SubElement(sources, "File", name=name)
    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusWarning", "logStatusError"):
        ElementTree.SubElement(categories, "Category", name=name)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime=repr(step * n_steps), stepSize=repr(step))
    _add_variables(root, constants)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _add_variables(root: ElementTree.Element, constants: Constants) -> None:
    variables, outputs = ElementTree.SubElement(root, "ModelVariables"), []

    def add(
        name: str, reference: int, kind: str, causality: str, variability: str, about: str, start: str = ""
    ) -> None:
        variable = ElementTree.SubElement(
            variables, "ScalarVariable", name=name, valueReference=str(reference), causality=causality,
            variability=variability, description=about,
        )  # fmt: skip
        value = ElementTree.SubElement(variable, kind)
        if start:
            value.set("start", start)
        if causality == "output":
            outputs.append(len(variables))

    for k, (name, value) in enumerate(constants.parameters.items()):
        # values are in SI units; a scene's own unit is one of its numbers only
        add(f"parameters.{name}", k, "Real", "parameter", "tunable", "SI units", repr(float(value)))
    for k, name in enumerate(constants.loads):
        about = "strength at the end of a step, N or N m, where it does not follow the scene"
        add(f"effects.{name}", STRENGTHS + k, "Real", "input", "continuous", about, "0.0")
        about = "whether the strength is the scene's over time, and the input is not looked at"
        add(f"effects.{name}_follows_scene", STRENGTHS + k, "Boolean", "parameter", "tunable", about, "true")
    for k, name in enumerate(constants.outputs):
        add(f"outputs.{name}", OUTPUTS + k, "Real", "output", "continuous", f"in {constants.output_units[name]}")
    about = "largest rotation of a node less that of its rigid body, rad"
    add("elastic_rotation", FURTHER, "Real", "output", "continuous", about)
    about = "last Newton correction of a step, in units of the mechanism's size or of 1 rad"
    add("correction", FURTHER + 1, "Real", "output", "continuous", about)
    add("validity", 0, "Integer", "output", "discrete", VALIDITY)
    add("valid", 0, "Boolean", "output", "discrete", "whether validity is 0")
    structure = ElementTree.SubElement(root, "ModelStructure")
    for section in ("Outputs", "InitialUnknowns"):
        listed = ElementTree.SubElement(structure, section)
        for index in outputs:
            ElementTree.SubElement(listed, "Unknown", index=str(index))
