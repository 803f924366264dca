"""Matrices and nodes as programs write them whose files libraries read: a program of its own, since these print.

    written_decks.py IN.npz FOLDER

IN.npz has ``nodes``, ``labels``, ``cells`` (of hexahedron20, labels), ``k`` and ``m``. Written by pyNastran: rod.pch
(DMIG of both), rod_k.op4, rod_m.op4 (six rows a node), rod_3.op4 (both, three rows a node), rod.bdf; by
ansys-mapdl-reader: rod.cdb; here: rod.op2 (both, six rows a node).
"""

import sys
from pathlib import Path

import numpy as np
import scipy.sparse as sp


def nastran(found, folder: Path) -> None:
    from pyNastran.bdf.bdf import BDF, DMIG
    from pyNastran.op4.op4 import OP4

    labels, punch, deck = found["labels"], [], BDF(debug=None)
    pairs = [(int(label), axis) for label in labels for axis in (1, 2, 3)]
    for name, key in (("KAAX", "k"), ("MAAX", "m")):
        lower = sp.tril(sp.coo_matrix(found[key])).tocoo()
        of_row, of_column = ([pairs[k] for k in places] for places in (lower.row, lower.col))
        # a part at a time, whose text grows by copying all of it; their head of four lines once
        for part in (slice(k, k + 500) for k in range(0, lower.nnz, 500)):
            card = DMIG(name, 6, 2, 0, 0, None, of_column[part], of_row[part], lower.data[part].tolist())
            punch.append(card.write_card(16, True).split("\n", 5 if part.start else 0)[-1])
    (folder / "rod.pch").write_text("".join(punch))
    for label, place in zip(labels, found["nodes"]):
        deck.add_grid(int(label), place)
    order = [*range(12), *range(16, 20), *range(12, 16)]
    deck.add_mat1(1, 210e9, None, 0.3, rho=7800.0)
    deck.add_psolid(1, 1)
    for number, cell in enumerate(found["cells"], 1):
        deck.add_chexa(number, 1, [int(cell[order.index(k)]) for k in range(20)])
    ends = labels[found["nodes"][:, 0] == 0.0]
    deck.add_set1(7, [int(label) for label in ends])
    deck.write_bdf(str(folder / "rod.bdf"), size=16, is_double=True)
    at = (6 * np.arange(len(labels))[:, None] + np.arange(3)).ravel()
    spread = sp.csr_matrix((np.ones(at.size), (at, np.arange(at.size))), shape=(6 * len(labels), at.size))
    op4 = OP4(debug=False)
    for key in "km":
        whole = spread @ found[key] @ spread.T.toarray()
        op4.write_op4(str(folder / f"rod_{key}.op4"), {f"{key.upper()}GG": (6, whole)}, is_binary=False)
    both = {f"{key.upper()}AA": (6, found[key]) for key in "km"}
    op4.write_op4(str(folder / "rod_3.op4"), both, is_binary=False)
    with (folder / "rod.op2").open("wb") as file:
        for key in "km":
            file.writelines(output2(f"{key.upper()}GG", spread @ found[key] @ spread.T.toarray()))
        file.write(marker(0))


def block(content: bytes) -> bytes:
    """Return a record of Fortran."""
    size = np.int32(len(content)).tobytes()
    return size + content + size


def marker(number: int) -> bytes:
    return block(np.int32(number).tobytes())


def output2(name: str, matrix: np.ndarray):
    """Yield the table of a matrix as ``OUTPUT2 KGG//-1/12`` with PARAM,POST,-2 writes it: no program at hand does."""
    n, title = len(matrix), name.ljust(8).encode()
    trailer = np.array([101, n, n, 6, 2, 2 * n, 10000], dtype=np.int32)
    yield from (marker(2), block(title), marker(-1), marker(7), block(trailer.tobytes()))
    yield from (*map(marker, (-2, 1, 0, 4)), block(title + np.array([170, 170], dtype=np.int32).tobytes()))
    for number, column in enumerate(matrix.T, 3):
        yield from map(marker, (-number, 1, 1))
        rows = np.flatnonzero(column)
        for string in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if rows.size else ():
            values = column[string].astype(float)
            yield from (marker(1 + 2 * string.size), block(np.int32(string[0] + 1).tobytes() + values.tobytes()))
    yield from map(marker, (-n - 3, 1, 0, 0))


def ansys(found, folder: Path) -> None:
    import pyvista
    from ansys.mapdl.reader import save_as_archive

    places = np.searchsorted(found["labels"], found["cells"])
    cells = np.column_stack([np.full(len(places), 20), places]).ravel()
    grid = pyvista.UnstructuredGrid(cells, np.full(len(places), 25), found["nodes"])
    grid.point_data["ansys_node_num"] = found["labels"].astype(np.int32)
    save_as_archive(folder / "rod.cdb", grid)


if __name__ == "__main__":
    with np.load(sys.argv[1]) as file:
        arrays = {name: file[name] for name in file.files}
    nastran(arrays, Path(sys.argv[2]))
    ansys(arrays, Path(sys.argv[2]))
