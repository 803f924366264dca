"""A program of its own: files of Nastran and Ansys are read by pyNastran and ansys-mapdl-reader.

    python -P read_by_library.py FORMAT KIND FILE OUT.npz

It imports nothing of the package. FORMAT is a function below, KIND is ``stiffness`` or ``mass``, of files that may hold
both, or ``nodes``. OUT.npz has the entries of a matrix (``row``, ``column``, ``value``, ``size``) with the node and
direction of each row (``rows``) where the file says them, or ``nodes`` and ``labels``, sets ``set:NAME`` of labels and
cells ``cells:TYPE`` of labels in meshio's order; or, of a file that is refused, the array ``refused`` alone. These
libraries are large, print, and some end their process on a damaged file.
"""

from __future__ import annotations

import re
import sys

import numpy as np
import scipy.sparse as sp

#: Module, what is installed, and what it reads, by format.
LIBRARIES = {
    "dmig": ("pyNastran", "pyNastran", "Nastran's DMIG"),
    "op4": ("pyNastran", "pyNastran", "Nastran's OP4"),
    "deck": ("pyNastran", "pyNastran", "a Nastran deck"),
    "full": ("ansys.mapdl.reader", "ansys-mapdl-reader", "an Ansys .full"),
    "cdb": ("ansys.mapdl.reader", "ansys-mapdl-reader", "an Ansys .cdb"),
}
LETTERS = {"stiffness": "K", "mass": "M"}
#: meshio's type of Nastran's and Ansys' elements by their number of nodes.
NASTRAN = {
    "CTETRA": {4: "tetra", 10: "tetra10"},
    "CHEXA": {8: "hexahedron", 20: "hexahedron20"},
    "CTRIA3": {3: "triangle"},
    "CTRIA6": {6: "triangle6"},
    "CQUAD4": {4: "quad"},
    "CQUAD8": {8: "quad8"},
}
OF_HEXAHEDRON20 = [*range(12), *range(16, 20), *range(12, 16)]  # Nastran has those along z before those on top
ANSYS = {185: {8: "hexahedron"}, 186: {20: "hexahedron20"}, 187: {10: "tetra10"}, 285: {4: "tetra"}}
FIRST_NODE = 10  # of an element of Ansys: before it are its material, type, section and others
OTHER = "other"  # cells that nobody asks for


class Refused(Exception):
    """Why a file is not taken."""


def chosen(names: list[str], kind: str) -> str:
    """Return which of the matrices of a file is the stiffness or the mass, by the first letter of its name."""
    fitting = [name for name in names if name.upper().startswith(LETTERS[kind])]
    if len(names) == 1 or len(fitting) == 1:
        return (fitting or names)[0]
    if not names:
        raise Refused("it has no matrices; write K and M of the body")
    raise Refused(
        f"it has the matrices {', '.join(sorted(names))}, of which {len(fitting)} begin with {LETTERS[kind]}; one "
        f"{kind} is needed: write it to a file of its own"
    )


def entries(matrix: object, rows: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Return a matrix as its entries."""
    found = sp.coo_matrix(matrix)
    arrays = {"row": found.row, "column": found.col, "value": found.data, "size": np.array(found.shape)}
    return arrays if rows is None else arrays | {"rows": rows}


def read_deck(path: str) -> object:
    """Return pyNastran's model of a deck, or of a part of one."""
    from pyNastran.bdf.bdf import BDF

    with open(path, encoding="utf-8", errors="replace") as file:
        whole = any(re.match(r"\s*(CEND|BEGIN\s+BULK)", line, re.IGNORECASE) for line in file)
    model = BDF(debug=None)
    model.read_bdf(path, punch=not whole, xref=False, validate=False)
    return model


def dmig(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read a matrix of a file with DMIG cards, such as what ``EXTSEOUT(DMIGPCH)`` punches."""
    model = read_deck(path)
    found = model.dmigs if hasattr(model, "dmigs") else model.dmig
    matrix = found[chosen([name for name in found if name != "UACCEL"], kind)]
    if matrix.is_complex:
        raise Refused("its entries are complex; real ones are needed")
    values, rows, columns = matrix.get_matrix(is_sparse=True, apply_symmetry=True)
    places = {pair: k for k, pair in enumerate(sorted({*rows.values(), *columns.values()}))}
    of_row, of_column = ([places[of[k]] for k in range(len(of))] for of in (rows, columns))
    found = sp.coo_matrix(values)
    size, at = len(places), (np.array(of_row)[found.row], np.array(of_column)[found.col])
    return entries(sp.coo_matrix((found.data, at), shape=(size, size)), np.array(list(places)))


def op4(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read a matrix of a file of OUTPUT4, text or binary."""
    from pyNastran.op4.op4 import read_op4

    matrices = read_op4(path, debug=False)
    found = matrices[chosen(list(matrices), kind)].data
    return entries(found)


def full(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read a matrix of a .full file."""
    from ansys.mapdl.reader import read_binary

    file = read_binary(path)
    rows, stiffness, mass = file.load_km(sort=False)
    empty = (stiffness.diagonal() == 0.0) & (mass.diagonal() == 0.0)
    held = max(len(file.const), int(empty.sum()))
    if held:
        cure = "a body is free: write it without D, CP and CE"
        raise Refused(f"{held} of {len(rows)} rows are held by constraints; {cure}")
    one = sp.coo_matrix({"stiffness": stiffness, "mass": mass}[kind])
    return entries(one, np.asarray(rows) + [0, 1])


def deck(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read nodes, SET1s and solid elements of a bulk data file."""
    model = read_deck(path)
    if not model.nodes:
        raise Refused("it has no GRID; the nodes of the body are needed")
    every = ("elements", "properties", "masses", "materials", "loads", "constraints", "aero", "sets", "optimization")
    model.cross_reference(xref=True, **{f"xref_{name}": False for name in every})
    labels = np.array(sorted(model.nodes))
    found = {"nodes": np.array([model.nodes[label].get_position() for label in labels]), "labels": labels}
    for number, one in model.sets.items():
        found[f"set:{number}"] = np.array(sorted(one.get_ids() if hasattr(one, "get_ids") else one.ids))
    cells: dict[str, list[list[int]]] = {}
    for element in model.elements.values():
        nodes = [node for node in element.node_ids if node]
        kind = NASTRAN.get(element.type, {}).get(len(nodes), OTHER)
        places = OF_HEXAHEDRON20 if kind == "hexahedron20" else range(len(nodes))
        cells.setdefault(kind, []).append([nodes[k] for k in places])
    return found | of_cells(cells)


def cdb(path: str, kind: str) -> dict[str, np.ndarray]:
    """Read nodes, components of nodes and solid elements of an archive."""
    from ansys.mapdl.reader import Archive

    archive = Archive(path, parse_vtk=False)
    if not len(archive.nodes):
        raise Refused("it has no nodes; write the archive with CDWRITE,DB")
    found = {"nodes": np.asarray(archive.nodes)[:, :3], "labels": np.asarray(archive.nnum)}
    found |= {f"set:{name}": np.asarray(own) for name, own in archive.node_components.items()}
    cells: dict[str, list[np.ndarray]] = {}
    for element, number in zip(archive.elem, archive.etype):
        nodes = np.asarray(element)[FIRST_NODE:]
        alone = len(np.unique(nodes)) == len(nodes) and (nodes > 0).all()
        kind = ANSYS.get(int(number), {}).get(len(nodes), OTHER) if alone else OTHER
        cells.setdefault(kind, []).append(nodes)
    return found | of_cells(cells)


def of_cells(cells: dict[str, list]) -> dict[str, np.ndarray]:
    """Return cells by their type; none where some are of no type that bodies have, since all of the body is needed."""
    return {} if OTHER in cells else {f"cells:{kind}": np.array(own) for kind, own in cells.items()}


def main(form: str, kind: str, path: str) -> dict[str, np.ndarray]:
    """Return what a file holds, or why it is refused."""
    module, name, what = LIBRARIES[form]
    try:
        __import__(module)
    except Exception as error:
        cure = f"cannot be imported ({error}): pip install {name}"
        return {"refused": np.array(f"{what} is read by {name}, which {cure}")}
    try:
        return globals()[form](path, kind)
    except Refused as error:
        return {"refused": np.array(str(error))}
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        return {"refused": np.array(f"{name} cannot read this file ({reason}); it may be damaged: write it anew")}


if __name__ == "__main__":
    np.savez(sys.argv[4], **main(*sys.argv[1:4]))
