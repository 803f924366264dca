"""Mesh files, read through meshio whatever way it has of failing."""

from __future__ import annotations

import io
import pickle
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, irregular

if TYPE_CHECKING:
    import meshio

#: Formats whose readers came to an end on 300 files each with bytes changed, deleted, repeated or cut off. Others of
#: meshio loop for ever on such files (Nastran, OFF, PLY): they are read by a process of their own, with a time limit.
ENDING = (".msh", ".vtu", ".vtk", ".xdmf", ".xmf", ".inp", ".med", ".mesh", ".vol", ".ugrid")
LONGEST_READING = 60.0  # s of a reader that may not end; those of sound files take seconds
# prints the mesh, or why there is none; what the reader itself prints goes elsewhere
_READER = """
import io, os, pickle, sys
out, sys.stdout = os.fdopen(os.dup(1), "wb"), io.StringIO()
try:
    import meshio
    found = meshio.read(sys.argv[1])
except BaseException as error:
    found = str(error) if isinstance(error, Exception) else sys.stdout.getvalue()
pickle.dump(found, out)
"""
#: Lengths below this share of the mesh's extent count as zero (round-off of 12-digit coordinates).
RELATIVE_TOLERANCE = 1e-12
FARTHEST = 1e15  # of a coordinate, in any unit; third powers and more of it are still finite
MAX_REASON = 200  # characters of meshio's reason


class Counted:
    """A mesh, and how much it has."""

    nodes: np.ndarray
    cells: np.ndarray

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.cells)


def read_mesh(path: Path, received: str) -> meshio.Mesh:
    """Read a file through meshio; messages begin with `received`, such as ``bodies.crank.mesh = "crank.msh"``.

    Raises `InputError` if there is no such file, it is a directory, pipe or device, of a format that meshio does not
    know, meshio cannot read it, or does not come to an end.
    """
    check_file(path, received, "a mesh file that meshio reads is needed (paths are relative to the scene's directory)")
    if path.suffix.lower() not in ENDING:
        return _read_apart(path, received)
    import meshio  # takes a noticeable time, and only runs that read a mesh need it

    printed = io.StringIO()
    try:
        # meshio prints its reasons, and some versions leave the interpreter.
        with redirect_stdout(printed), redirect_stderr(printed):
            return meshio.read(path)
    except (Exception, SystemExit) as error:
        reason = printed.getvalue() if isinstance(error, SystemExit) else str(error)
        raise _unreadable(received, reason or type(error).__name__) from error


def _read_apart(path: Path, received: str) -> meshio.Mesh:
    """Read a file whose reader may not end, in another process."""
    from pgmp_petsc.ranks.ending import TIME_IS_OVER, run_child  # a noticeable time, and few meshes are read so

    done = run_child([sys.executable, "-c", _READER, str(path)], LONGEST_READING)
    if done.returncode == TIME_IS_OVER:
        found = f"its reader had not ended after {LONGEST_READING:g} s"
    else:
        found = pickle.loads(done.stdout) if done.stdout else f"its reader ended with {done.returncode}"
    if isinstance(found, str):
        raise _unreadable(received, found)
    return found


def made_by(program: Path, words: Sequence[object], seconds: float) -> dict[str, np.ndarray] | str:
    """Return the arrays that a program of this room writes to the npz file that is its last word, or why there are
    none; its libraries may print, crash and loop."""
    from pgmp_petsc.ranks.ending import TIME_IS_OVER, run_child  # see above

    with tempfile.TemporaryDirectory(prefix="pgmp_reading_") as folder:
        output = Path(folder) / "found.npz"
        done = run_child([sys.executable, "-P", program, *map(str, words), output], seconds)
        if done.returncode == TIME_IS_OVER:
            return f"its reader had not ended after {seconds:g} s"
        if done.returncode or not output.exists():
            reason = " ".join(done.stderr.decode(errors="replace").split())[-MAX_REASON:]
            return f"its reader ended with {done.returncode} ({reason}); it may be damaged: write it anew"
        with np.load(output, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
    return str(found["refused"]) if "refused" in found else found


def _unreadable(received: str, reason: str) -> InputError:
    """Return the error that meshio cannot read a file, with the cure."""
    reason = " ".join(reason.split())[:MAX_REASON]
    cure = "a mesh in a format that meshio knows by the file's suffix is needed"
    if "gmsh:physical" in reason:  # its reader wants the tags of all entities or of none
        cure = "gmsh must save the cells of physical groups only (Mesh.SaveAll = 0)"
    return InputError(f"{received}: meshio cannot read this file ({reason}); {cure}")


@contextmanager
def usable(received: str) -> Iterator[None]:
    """Turn whatever goes wrong with what a damaged file seemed to hold into one message, an `InputError`, but for a
    package that is not installed."""
    try:
        yield
    except (PgmpError, ModuleNotFoundError):
        raise
    except Exception as error:  # of numpy and meshio, on arrays of impossible shapes and kinds
        reason = " ".join(str(error).split())[:MAX_REASON]
        raise InputError(
            f"{received}: what this file holds cannot be used as a mesh ({type(error).__name__}: {reason}); it may be "
            "damaged: write it anew"
        ) from error


def check_file(path: Path, received: str, needed: str) -> None:
    """Refuse what is no file, before anything is read from it, and say what is needed.

    Raises `InputError` if there is no such file, it cannot be read, or it is a directory, pipe or device.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise InputError(f"{received}: no such file; {needed}") from error
    except (OSError, ValueError) as error:  # no permission, a name too long, a loop of links
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{received}: cannot be read ({reason}); {needed}") from error
    if irregular(mode):
        raise InputError(f"{received}: this is {irregular(mode)}; {needed}")


def coordinates(points: np.ndarray, dimension: int, received: str, numbers: np.ndarray | None = None) -> np.ndarray:
    """Return the coordinates in the plane or in space after checking that they are finite and in the plane z = 0;
    `numbers` are those of the nodes in the file, where they are not in its order."""
    points = np.asarray(points, dtype=float)
    numbers = np.arange(len(points)) if numbers is None else numbers
    strange = np.flatnonzero(~(np.abs(points) < FARTHEST).all(axis=1))
    if strange.size:
        what = f"beyond {FARTHEST:g}" if np.isfinite(points).all() else "not finite"
        raise InputError(
            f"{received}: {strange.size} of {len(points)} nodes have coordinates that are {what}; the first is "
            f"node {numbers[strange[0]]} at {points[strange[0]].tolist()}; finite numbers are needed"
        )
    off_plane = np.abs(points[:, dimension:]).max(axis=1, initial=0.0)
    off = np.flatnonzero(off_plane > RELATIVE_TOLERANCE * np.ptp(points, axis=0).max())
    if off.size:
        raise InputError(
            f"{received}: {off.size} of {len(points)} nodes are off the plane z = 0, where plane bodies lie; the first "
            f"is node {numbers[off[0]]} at {points[off[0]].tolist()}"
        )
    missing = np.zeros((len(points), max(0, dimension - points.shape[1])))  # files of plane points for a solid body
    return np.hstack([points[:, :dimension], missing])


def shown(numbers: np.ndarray, most: int = 8) -> str:
    """Return numbers as text, the first few of many: ``[3, 4, ...]``."""
    return f"[{', '.join(str(number) for number in numbers[:most])}{', ...' if len(numbers) > most else ''}]"
