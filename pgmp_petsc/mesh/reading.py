"""Mesh files, read through meshio whatever way it has of failing."""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    import meshio

#: Lengths below this share of the mesh's extent count as zero (round-off of 12-digit coordinates).
RELATIVE_TOLERANCE = 1e-12


def read_mesh(path: Path, received: str) -> meshio.Mesh:
    """Read `path` through meshio.

    Parameters
    ----------
    path : Path
        The mesh file.
    received : str
        The scene's entry and its value, with which messages begin, such as ``bodies.crank.mesh = "crank.msh"``.

    Raises
    ------
    InputError
        If the file is missing or meshio cannot read it.
    """
    import meshio  # takes a noticeable time, and only runs that read a mesh need it

    if not path.is_file():
        raise InputError(
            f"{received}: {'this is a directory' if path.is_dir() else 'no such file'}; a mesh file that "
            "meshio reads is needed (paths are relative to the scene's directory)"
        )
    printed = io.StringIO()
    try:
        # meshio prints its reasons, and some versions leave the interpreter.
        with redirect_stdout(printed), redirect_stderr(printed):
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        reason = printed.getvalue() if isinstance(error, SystemExit) else str(error) or type(error).__name__
        cure = "a mesh in a format that meshio knows by the file's suffix is needed"
        if "gmsh:physical" in reason:  # its reader wants the tags of all entities or of none
            cure = "gmsh must save the cells of physical groups only (Mesh.SaveAll = 0)"
        raise InputError(f"{received}: meshio cannot read this file ({' '.join(reason.split())}); {cure}") from error
