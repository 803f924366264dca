"""Mesh files, read through meshio whatever way it has of failing, and Abaqus' input files, read here.

meshio forgets the numbers of an input file's nodes, in which matrices are written; it stops at elements that it does
not know; it keeps the last of several cards for one set, and deals out the sets of cards by counting them.
"""

from __future__ import annotations

import io
import pickle
import re
import sys
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, irregular
from pgmp_petsc.ranks.ending import TIME_IS_OVER, run_child

if TYPE_CHECKING:
    import meshio

#: Formats whose readers came to an end on 300 files each with bytes changed, deleted, repeated or cut off. Others of
#: meshio loop for ever on such files (Nastran, OFF, PLY): they are read by a process of their own, with a time limit.
ENDING = (".msh", ".vtu", ".vtk", ".xdmf", ".xmf", ".med", ".mesh", ".vol", ".ugrid")
LONGEST_READING = 60.0  # s of a reader that may not end; those of sound files take seconds
# prints the mesh, or why there is none; what the reader itself prints goes elsewhere
_READER = """
import io, os, pickle, sys
out, sys.stdout = os.fdopen(os.dup(1), "wb"), io.StringIO()
try:
    import meshio
    found = meshio.read(sys.argv[1])
except BaseException as error:
    words = repr(error) if isinstance(error, LookupError) else str(error)  # of a key alone nobody is told anything
    found = words if isinstance(error, Exception) else sys.stdout.getvalue()
pickle.dump(found, out)
"""
#: Lengths below this share of the mesh's extent count as zero (round-off of 12-digit coordinates).
RELATIVE_TOLERANCE = 1e-12
FARTHEST = 1e15  # of a coordinate, in any unit; third powers and more of it are still finite
MAX_REASON = 200  # characters of meshio's reason
ABAQUS = ".inp"
MOST_MEMBERS = 10_000_000  # of a set that a range makes
MAKING = "NGEN NFILL NCOPY NMAP ELGEN ELCOPY SYSTEM".split()  # nodes and elements of others, or in axes of their own
#: meshio's types of cells by family and number of nodes, whose order is meshio's too.
FAMILIES = {
    "plane": {3: "triangle", 6: "triangle6", 4: "quad", 8: "quad8", 9: "quad9"},
    "solid": {4: "tetra", 10: "tetra10", 6: "wedge", 15: "wedge15", 8: "hexahedron", 20: "hexahedron20"},
}
OF_TYPE = re.compile(r"(?:(CPS|CPE|CAX|M3D|R3D|STRI|S)|C3D)(\d+)")
OF_LINE = re.compile(r"(?:T[23]D|B[23])(\d)")
OF_LINES = {"T2": "line", "T3": "line3", "B1": "line", "B2": "line3"}  # trusses count nodes, beams the order
N_NODES = {"line": 2, "line3": 3} | {name: n for family in FAMILIES.values() for n, name in family.items()}


class Counted:
    """A mesh, and how much it has."""

    nodes: np.ndarray
    cells: np.ndarray

    @property
    def n_nodes(self) -> int:
        return len(self.nodes)

    @property
    def n_cells(self) -> int:
        return len(self.cells)


def read_mesh(path: Path, received: str) -> meshio.Mesh:
    """Read a file through meshio; messages begin with `received`, such as ``bodies.crank.mesh = "crank.msh"``. Raises
    `InputError` if there is no such file, it is a directory, pipe or device, of a format that meshio does not know,
    meshio cannot read it, or does not come to an end."""
    check_file(path, received, "a mesh file that meshio reads is needed (paths are relative to the scene's directory)")
    if path.suffix.lower() == ABAQUS:
        with usable(received):
            mesh, _, unknown = read_abaqus(path, received)
        if unknown:
            cure = "leave them out, or write solids, plane elements, trusses or beams"
            raise InputError(f"{received}: it has elements of type {', '.join(unknown)}, which are not known; {cure}")
        return mesh
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
    cure = (
        "a mesh in a format that meshio knows by the file's suffix is needed: best .msh (gmsh) or .inp (Abaqus), whose "
        "sets are points of bodies"
    )
    if "gmsh:physical" in reason:  # its reader wants the tags of all entities or of none
        cure = "gmsh must save the cells of physical groups only (Mesh.SaveAll = 0)"
    return InputError(f"{received}: meshio cannot read this file ({reason}); {cure}")


@contextmanager
def usable(received: str, words: str = "what this file holds cannot be used as a mesh") -> Iterator[None]:
    """Turn whatever goes wrong with what a damaged file seemed to hold into one message, an `InputError`, but for a
    package that is not installed."""
    try:
        yield
    except (PgmpError, ModuleNotFoundError):
        raise
    except Exception as error:  # of numpy and meshio, on arrays of impossible shapes and kinds
        reason = " ".join(str(error).split())[:MAX_REASON]
        why = f"{words} ({type(error).__name__}: {reason})"
        raise InputError(f"{received}: {why}; it may be damaged: write it anew") from error


def check_file(path: Path, received: str, needed: str) -> None:
    """Refuse what is no file, before anything is read from it, and say what is needed; raises `InputError` if there is
    no such file, it cannot be read, or it is a directory, pipe or device."""
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


def read_abaqus(path: Path, received: str) -> tuple[meshio.Mesh, np.ndarray, list[str]]:
    """Return what an input file holds, with a block of cells for each type; the numbers of its nodes, shape (n_nodes,);
    and the types of elements that are not known, which are left out. Raises `InputError` if it has no nodes, or two of
    one number; or if an element or a set names what is not there. `received` begins messages."""
    places: dict[int, list[float]] = {}
    elements: dict[int, tuple[str, list[int]]] = {}
    sets: dict[str, dict[str, list[int]]] = {"NSET": {}, "ELSET": {}}
    unknown: set[str] = set()
    for keyword, options, lines in _cards(path, received):
        placed = keyword == "NODE" and options.get("SYSTEM", "R").upper() != "R"
        if lines and (placed or keyword in MAKING):  # a card SYSTEM without any ends what one did
            cure = "write all nodes, at places along x, y and z, and all elements"
            raise InputError(f"{received}: what a card {keyword} makes is not read; {cure}")
        if keyword == "NODE":
            what, of, into, made = "node", "NSET", places, _nodes_of(lines)
        elif keyword == "ELEMENT" and (kind := kind_of(options.get("TYPE", ""))):
            what, of, into, made = "element", "ELSET", elements, _elements_of(lines, kind, options["TYPE"], received)
        elif keyword == "ELEMENT":
            unknown.add(options.get("TYPE") or "none")
            continue
        else:
            if keyword in sets:
                members = list(_members_of_set(lines, options, sets[keyword], received))
                _set(sets[keyword], options.get(keyword, "")).extend(members)
            continue  # cards of other keywords have no part
        for label, one in made:
            if label in into:
                raise InputError(f"{received}: {what} {label} is there twice; the {what}s of one body are needed")
            into[label] = one
        if of in options:
            _set(sets[of], options[of]).extend(label for label, _ in made)
    if not places:
        raise InputError(f"{received}: it has no nodes; a NODE card with all nodes of the body is needed")
    return _mesh_of(places, elements, sets, received), np.array(list(places)), sorted(unknown)


def _nodes_of(lines: list[str]) -> list[tuple[int, list[float]]]:
    rows = [line.split(",") for line in lines]
    return [(int(label), [float(x) if x.strip() else 0.0 for x in (*place, "", "", "")[:3]]) for label, *place in rows]


def _elements_of(lines: list[str], kind: str, name: str, received: str) -> list[tuple[int, tuple[str, list[int]]]]:
    numbers, n = [int(word) for line in lines for word in line.split(",") if word.strip()], N_NODES[kind]
    if len(numbers) % (n + 1):
        raise InputError(f"{received}: elements of type {name} have {n} nodes each, not all here do")
    rows = np.array(numbers, dtype=int).reshape(-1, n + 1).tolist()
    return [(label, (kind, nodes)) for label, *nodes in rows]


def _mesh_of(
    places: Mapping[int, list[float]], elements: Mapping[int, tuple[str, list[int]]],
    sets: Mapping[str, Mapping[str, list[int]]], received: str,
) -> meshio.Mesh:  # fmt: skip
    """Return the mesh of nodes, elements and sets that are by their numbers in a file."""
    import meshio

    at = {label: number for number, label in enumerate(places)}
    try:
        cells = [(kind, [at[node] for node in nodes]) for kind, nodes in elements.values()]
        point_sets = {name: np.array([at[n] for n in members], dtype=int) for name, members in sets["NSET"].items()}
    except KeyError as error:
        what = f"an element or a set names node {error.args[0]}, which is not there"
        raise InputError(f"{received}: {what}") from error
    kinds, labels = np.array([kind for kind, _ in cells]), np.array(list(elements))
    of_kinds = [np.flatnonzero(kinds == kind) for kind in dict.fromkeys(kinds.tolist())]
    blocks = [(cells[own[0]][0], np.array([cells[k][1] for k in own])) for own in of_kinds]
    cell_sets = {
        name: [np.flatnonzero(np.isin(labels[own], members)) for own in of_kinds]
        for name, members in sets["ELSET"].items()
    }
    return meshio.Mesh(np.array(list(places.values())), blocks, point_sets=point_sets, cell_sets=cell_sets)


def kind_of(name: str) -> str | None:
    """Return meshio's type of the cells that an Abaqus element such as ``C3D20R`` has; nothing if none is known."""
    found, of_line = OF_TYPE.match(name.upper()), OF_LINE.match(name.upper())
    if of_line:
        return OF_LINES.get(name.upper()[0] + of_line[1])
    return found and FAMILIES["plane" if found[1] else "solid"].get(int(found[2]))


def _set(sets: dict[str, list[int]], name: str) -> list[int]:
    return sets.setdefault(next((own for own in sets if own.upper() == name.upper()), name), [])


def _members_of_set(
    lines: list[str], options: Collection[str], sets: dict[str, list[int]], received: str
) -> Iterator[int]:
    """Yield the members of a set: numbers, ranges, and those of other sets."""
    known = {name.upper(): members for name, members in sets.items()}
    for line in lines:
        words = [word.strip().strip('"') for word in line.split(",") if word.strip()]
        if "GENERATE" in options:
            first, last, *step = map(int, words)
            numbers = range(first, last + 1, *step)
            if len(numbers) > MOST_MEMBERS:
                raise InputError(f"{received}: a set has {len(numbers)} members; at most {MOST_MEMBERS} are read")
            yield from numbers
            continue
        for word in words:
            if not word.isdecimal() and word.upper() not in known:
                raise InputError(f'{received}: a set is made from the set "{word}", which is not there before it')
            yield from known[word.upper()] if word.upper() in known else (int(word),)


def _cards(path: Path, received: str, within: tuple[Path, ...] = ()) -> Iterator[tuple[str, dict[str, str], list[str]]]:
    """Yield keyword, options and lines of data of every card, those of included files in their place; `within` are the
    files that this one is included from."""
    card, within = None, (*within, path.resolve())
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in chain(map(str.strip, file), ["*END"]):
            if not line or line.startswith("**"):
                continue
            if not line.startswith("*"):
                if card is not None:
                    card[2].append(line)
                continue
            if card is not None and card[0] == "INCLUDE":
                other = path.parent / card[1].get("INPUT", "")
                check_file(other, f'{received}: INCLUDE = "{other}"', "a file that it includes is needed")
                if other.resolve() in within:
                    raise InputError(f'{received}: INCLUDE = "{other}": the file includes itself; leave that card out')
                yield from _cards(other, received, within)
            elif card is not None:
                yield card
            keyword, *words = (word.strip() for word in line[1:].split(","))
            options = {
                key.strip().upper(): value.strip().strip('"') for key, _, value in (w.partition("=") for w in words)
            }
            card = keyword.upper(), options, []
