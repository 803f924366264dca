"""A functional mock-up unit, FMI 2.0 or 3.0: a model in C with its description in a zip archive.

It is for co-simulation and for model exchange. The archive holds the sources, and a shared library for this machine
where it has a C compiler.
"""

from __future__ import annotations

import hashlib
import platform
import re
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import RunError
from pgmp_petsc.c_export.constants import Constants
from pgmp_petsc.c_export.description import build_description, description
from pgmp_petsc.c_export.source import HEAD, compiled_of, read_common, sources_of
from pgmp_petsc.files.claims import check_output, replacing
from pgmp_petsc.ranks.ending import TIME_IS_OVER, run_child

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
    compiler, target = compiler or shutil.which("cc") or shutil.which("gcc"), _platform(version)
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


def _platform(version: int) -> str:
    return PLATFORMS.get((platform.system(), platform.machine()), {}).get(version, "")


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
