"""Mesh files, read through meshio whatever way it has of failing."""

from __future__ import annotations

import io
import stat
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.runtime.errors import InputError, PgmpError

if TYPE_CHECKING:
    import meshio

#: Formats that are taken, by the end of the file's name: each of their readers came to an end on 300 files with bytes
#: changed, deleted, repeated or cut off. Others of meshio loop for ever on such files (Nastran, OFF, PLY).
SUFFIXES = (".msh", ".vtu", ".vtk", ".xdmf", ".xmf", ".inp", ".med", ".mesh", ".vol", ".ugrid")
#: Lengths below this share of the mesh's extent count as zero (round-off of 12-digit coordinates).
RELATIVE_TOLERANCE = 1e-12
MAX_REASON = 200  # characters of meshio's reason


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
        If there is no such file, it is a directory, pipe or device, of a format that is not taken, or meshio cannot
        read it.
    """
    _check_file(path, received)
    import meshio  # takes a noticeable time, and only runs that read a mesh need it

    printed = io.StringIO()
    try:
        # meshio prints its reasons, and some versions leave the interpreter.
        with redirect_stdout(printed), redirect_stderr(printed):
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        reason = printed.getvalue() if isinstance(error, SystemExit) else str(error)
        reason = " ".join(reason.split())[:MAX_REASON] or type(error).__name__
        cure = "a mesh in a format that meshio knows by the file's suffix is needed"
        if "gmsh:physical" in reason:  # its reader wants the tags of all entities or of none
            cure = "gmsh must save the cells of physical groups only (Mesh.SaveAll = 0)"
        raise InputError(f"{received}: meshio cannot read this file ({reason}); {cure}") from error


@contextmanager
def usable(received: str) -> Iterator[None]:
    """Turn whatever goes wrong with what a damaged file seemed to hold into one message.

    Raises
    ------
    InputError
        Instead of any other exception within the block.
    """
    try:
        yield
    except PgmpError:
        raise
    except Exception as error:  # of numpy and meshio, on arrays of impossible shapes and kinds
        reason = " ".join(str(error).split())[:MAX_REASON]
        raise InputError(
            f"{received}: what this file holds cannot be used as a mesh ({type(error).__name__}: {reason}); it may be "
            "damaged: write it anew"
        ) from error


def _check_file(path: Path, received: str) -> None:
    """Refuse what is no file, before anything is read from it, and formats whose readers may not end."""
    needed = "a mesh file that meshio reads is needed (paths are relative to the scene's directory)"
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise InputError(f"{received}: no such file; {needed}") from error
    except (OSError, ValueError) as error:  # no permission, a name too long, a loop of links
        raise InputError(f"{received}: cannot be read ({getattr(error, 'strerror', None) or error}); {needed}") from error
    if not stat.S_ISREG(mode):
        kind = "a directory" if stat.S_ISDIR(mode) else "a device or a pipe"
        raise InputError(f"{received}: this is {kind}; {needed}")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{received}: no format by this ending is taken (allowed: {', '.join(SUFFIXES)}); meshio convert FILE "
            "FILE.vtu makes one of them from others"
        )
