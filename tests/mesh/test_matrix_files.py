"""Matrices and nodes from the files of other programs: every format holds the same body, and says what it lacks."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from assembled import GAP, WRITERS, labels_of, write_abaqus, write_csv, write_inp, write_node_arrays
from conftest import TIMEOUT_SECONDS
from refusals import assert_refused
from solids import body_of, matrices_of, mesh_of

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mesh.matrix_files import MatrixFile, NodeFile, in_order_of_nodes, read_matrix, read_nodes, read_rows

MESH = mesh_of("quad8", (3, 1), (0.3, 0.05))
STIFFNESS, MASS = matrices_of(body_of(MESH, 2e9, 7800.0))
IN_SPACE = mesh_of("hexahedron", (2, 1, 1), (0.2, 0.05, 0.04))


def found(file: MatrixFile, nodes: NodeFile | None = None, rows=None) -> np.ndarray:
    nodes = nodes or NodeFile(MESH.nodes, labels_of(MESH), {})
    return in_order_of_nodes(file, rows, nodes, "matrix", "nodes").toarray()


@pytest.mark.parametrize("kind", WRITERS)
def test_every_format_has_the_same_matrix(kind: str, tmp_path: Path) -> None:
    WRITERS[kind](tmp_path / kind, STIFFNESS, MESH)
    read = read_matrix(tmp_path / kind, "matrix")
    # 16 digits of the shortest one
    np.testing.assert_allclose(found(read), STIFFNESS.toarray(), rtol=1e-15, atol=1e-15 * STIFFNESS.max())


def test_files_of_one_ending_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "k.mtx"
    for kind, labelled in (("abaqus.mtx", True), ("coordinate.mtx", False), ("market.mtx", False)):
        WRITERS[kind](path, MASS, MESH)
        assert (read_matrix(path, "matrix").rows is not None) == labelled


def test_a_triangle_and_the_whole_matrix_are_the_same(tmp_path: Path) -> None:
    for triangle in (True, False):
        write_abaqus(tmp_path / f"{triangle}.mtx", MASS, MESH, triangle)
    one, other = (found(read_matrix(tmp_path / f"{triangle}.mtx", "matrix")) for triangle in (True, False))
    np.testing.assert_array_equal(one, other)


def test_rows_of_abaqus_find_their_nodes_in_any_order(tmp_path: Path) -> None:
    write_abaqus(tmp_path / "m.mtx", MASS, MESH)
    order = np.random.default_rng(3).permutation(MESH.n_nodes)
    shuffled = NodeFile(MESH.nodes[order], labels_of(MESH)[order], {})
    unknowns = (2 * order[:, None] + np.arange(2)).ravel()
    read = found(read_matrix(tmp_path / "m.mtx", "matrix"), shuffled)
    np.testing.assert_allclose(read, MASS.toarray()[np.ix_(unknowns, unknowns)], rtol=1e-15)


def test_a_list_of_rows_says_where_they_belong(tmp_path: Path) -> None:
    order = np.random.default_rng(4).permutation(MASS.shape[0])
    sp.save_npz(tmp_path / "m.npz", MASS[order][:, order].tocsr())
    lines = ["  Matrix Eqn    Node   DOF"]
    lines += [f"{k + 1:8d} {GAP * (row // 2 + 1):8d}   {('UX', 'UY')[row % 2]}" for k, row in enumerate(order)]
    (tmp_path / "m.mapping").write_text("\n".join(lines))
    rows = read_rows(tmp_path / "m.mapping", "rows")
    np.testing.assert_array_equal(found(read_matrix(tmp_path / "m.npz", "matrix"), rows=rows), MASS.toarray())


@pytest.mark.parametrize("head", ["", "node,x,y\n", ",x,y\n", "# node x y\n"])
@pytest.mark.parametrize("first", ["1", "1.0", "+1", "1.000e+00", "-1"])
def test_a_first_line_of_numbers_is_a_node(head: str, first: str, tmp_path: Path) -> None:
    (tmp_path / "n.csv").write_text(f"{head}{first},0,0\n2,1.0e+00,0\n")
    assert read_nodes(tmp_path / "n.csv", 2, "nodes").labels.tolist() == [int(float(first)), 2]


@pytest.mark.parametrize("mesh", [MESH, IN_SPACE], ids=["plane", "space"])
@pytest.mark.parametrize("suffix", [".inp", ".csv", ".npz"])
def test_every_file_of_nodes_has_the_same_nodes(mesh, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"nodes{suffix}"
    {".inp": write_inp, ".csv": write_csv, ".npz": write_node_arrays}[suffix](path, mesh, 1e-3)
    read = read_nodes(path, mesh.dimension, "nodes")
    np.testing.assert_allclose(1e-3 * read.nodes, mesh.nodes, rtol=1e-15, atol=1e-17)
    np.testing.assert_array_equal(read.labels, labels_of(mesh))
    if suffix != ".csv":
        np.testing.assert_array_equal(np.sort(read.sets["left"]), np.unique(mesh.groups["left"]))
    assert (read.mesh is not None) == (suffix == ".inp")


def test_nodes_without_cells_and_with_mixed_cells_have_sets_alone(tmp_path: Path) -> None:
    write_inp(tmp_path / "bare.inp", MESH, cells=False)
    shell = (tmp_path / "bare.inp").read_text() + "*ELEMENT, TYPE=SC8R\n1, 10, 20, 30, 40, 50, 60, 70, 80\n"
    (tmp_path / "shells.inp").write_text(shell)
    for name in ("bare.inp", "shells.inp"):
        read = read_nodes(tmp_path / name, 2, "nodes")
        assert read.mesh is None and set(read.sets) == {"left", "right", "bottom", "top"}


def test_sets_of_abaqus_by_ranges_by_other_sets_and_in_pieces(tmp_path: Path) -> None:
    write_inp(tmp_path / "nodes.inp", MESH)
    more = "*NSET, NSET=some, GENERATE\n10, 50, 20\n*NSET, NSET=some\n20,\n*NSET, NSET=all of them\nsome, 60\n"
    (tmp_path / "nodes.inp").write_text((tmp_path / "nodes.inp").read_text() + more)
    read = read_nodes(tmp_path / "nodes.inp", 2, "nodes")
    np.testing.assert_array_equal(read.sets["some"], [0, 1, 2, 4])
    np.testing.assert_array_equal(read.sets["all of them"], [0, 1, 2, 4, 5])


FIVE = "10,1, 10,1, 2.0\n"
MATRIX_CASES = {
    "missing": (None, "no such file"),
    "empty": (b"", "no matrix in a format that is known"),
    "prose": (b"a matrix\nof words\n", "no matrix in a format that is known"),
    "ragged": (FIVE + "1 2 3\n", "number of columns changed"),
    "words for numbers": (b"1, 1, x, 1, 2.0\n", "cannot be read as a matrix"),
    "no whole numbers": (b"1.5 1 2.0\n", "no whole numbers"),
    "rows from 0": (b"0 0 2.0\n", "count from 1"),
    "not finite": (b"1 1 nan\n", "not finite"),
    "nastran": (b"$ punch\nDMIG    KAAX           0       6       1       0\n", "pyNastran"),
    "market, damaged": (b"%%MatrixMarket matrix coordinate real general\n2 2 9\n1 1 1.0\n", "cannot be read"),
    "market, complex": (b"%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 1.0 2.0\n", "complex"),
    "market, not square": (b"%%MatrixMarket matrix coordinate real general\n1 2 1\n1 2 1.0\n", "a square matrix"),
    "harwell-boeing, complex": (
        f"{'m':<80}\n{3:14d}{1:14d}{1:14d}{1:14d}{0:14d}\nCSA{1:25d}{1:14d}{1:14d}{0:14d}\n(I8) (I8) (D25.16)\n",
        "CSA",
    ),
    "harwell-boeing, cut off": (
        f"{'m':<80}\n{3:14d}{1:14d}{1:14d}{1:14d}{0:14d}\nRSA{4:25d}{4:14d}{9:14d}{0:14d}\n(I8) (I8) (D25.16)\n",
        "are announced",
    ),
    "market, cut in its head": (b"%%MatrixMarket matrix coordinate real sy", "ends before the line of its sizes"),
    "market, comments alone": (b"%%MatrixMarket matrix array real general\n% of\n\n", "ends before the line of its"),
    "market, other sizes": (
        b"%%MatrixMarket matrix coordinate real general\n900000000 900000000 1\n1 1 1.0\n",
        "sizes",
    ),
    "a row's number damaged": (b"1 1 2.0\n900000000 1 2.0\n", "are its sizes"),
    "zip": (b"PK\x03\x04 and no more", "cannot be read as a matrix"),
}


def test_arrays_with_other_numbers_in_them_are_refused(tmp_path: Path) -> None:
    """SciPy reads where a wrong index or pointer leads, which ends the process: one of its own reads them here."""
    rng, names = np.random.default_rng(5), []
    for format in ("csr", "coo", "bsr", "dia"):
        sp.save_npz(tmp_path / "k.npz", STIFFNESS.asformat(format))
        with np.load(tmp_path / "k.npz") as file:
            arrays = {name: file[name] for name in file.files}
        for name in sorted({"indices", "indptr", "row", "col", "shape"} & set(arrays)):
            for number in (-1, -(2**31), 10**6, 2**31 - 1, 2**62):
                changed = arrays[name].astype(np.int64)
                changed[rng.integers(changed.size)] = number
                names.append(tmp_path / f"{format}_{name}_{number}.npz")
                np.savez(names[-1], **{**arrays, name: changed})
    read = f"import sys; sys.path[:0] = {sys.path}; from test_matrix_files import refused; refused(sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", read, *names], capture_output=True, text=True, timeout=TIMEOUT_SECONDS,
        cwd=Path(__file__).parent,
    )  # fmt: skip
    assert done.returncode == 0 and done.stdout.split() == [path.name for path in names], done.stderr
    np.savez(tmp_path / "k.npz", K=np.eye(2))
    assert_refused("the arrays K; what scipy.sparse.save_npz", read_matrix, tmp_path / "k.npz", "matrix")


def refused(names: list[str]) -> None:
    """Print the names of files that are refused as they should be."""
    for name in names:
        try:
            read_matrix(Path(name), "matrix")
        except InputError as error:
            print(Path(name).name if str(error).startswith("matrix: ") else error)


def labelled(*rows: tuple[int, int]) -> MatrixFile:
    return MatrixFile(sp.eye(len(rows), format="csr"), np.array(rows))


TWO = NodeFile(np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([10, 20]), {})
ROW_CASES = {
    "internal": (labelled((10, 1), (-1, 1)), "internal nodes, such as -1"),
    "rotations": (labelled((10, 1), (10, 6)), "of rotations of nodes; .* mesh the body here"),
    "out of the plane": (labelled((10, 1), (10, 3)), "has the direction 3; those of a solid2d body"),
    "no direction": (labelled((10, 0)), "scalar points, such as 10"),
    "other nodes": (labelled((10, 1), (30, 1)), "rows of 1 nodes that nodes does not hold, the first are 30"),
    "twice": (labelled((10, 1), (10, 1)), "node 10, direction 1 has two rows"),
    "other size": (MatrixFile(sp.eye(5, format="csr")), "5 by 5 entries, but 2 nodes .* have 4 displacements"),
    "those of shells": (MatrixFile(sp.eye(12, format="csr")), "6 unknowns a node look like"),
}


@pytest.mark.parametrize(("file", "words"), ROW_CASES.values(), ids=ROW_CASES)
def test_rows_of_another_body_are_refused_by_name(file: MatrixFile, words: str) -> None:
    assert_refused("^matrix: .*" + words, found, file, TWO)
    with pytest.raises(InputError, match="it has 4 rows, and the list of rows has 2"):
        found(MatrixFile(sp.eye(4, format="csr")), TWO, np.array([[10, 1], [10, 2]]))


LIST_CASES = {
    "missing": ("1 10 UX\n3 20 UX\n", "row 2 is not in it"),
    "twice": ("1 10 UX\n1 20 UX\n", "row 1 is there twice"),
    "no direction": ("1 10 TEMP\n", "line 1 is '1 10 TEMP'"),
    "empty": ("rows\n", "row 1 is not in it"),
}
NODE_CASES = {
    "words": ("nodes.csv", "node,x,y\n1,a,b\n", "cannot be used"),
    "few columns": ("nodes.csv", "1,2\n", "two or three coordinates"),
    "twice": ("nodes.csv", "1,0,0\n1,1,0\n", "node 1 is there twice"),
    "not finite": ("nodes.csv", "1,0,0\n2,nan,0\n", "not finite"),
    "far away": ("nodes.csv", "1,0,0\n2,1e300,0\n", "beyond 1e\\+15"),
    "off the plane": ("nodes.csv", "1,0,0,0\n2,1,0,1\n", "off the plane"),
    "fractions": ("nodes.csv", "1.5,0,0\n", "whole numbers"),
    "no card": ("nodes.inp", "*HEADING\nof nothing\n", "no nodes"),
    "twice, cards": ("nodes.inp", "*NODE\n1, 0, 0, 0\n*NODE\n1, 1, 0, 0\n", "node 1 is there twice"),
    "included": ("nodes.inp", "*INCLUDE, INPUT=more.inp\n", "more.inp.*no such file"),
    "lost": ("nodes.inp", "*NODE\n1, 0, 0, 0\n*NSET, NSET=a\n7\n", "names node 7, which is not there"),
    "short": ("nodes.inp", "*NODE\n1, 0, 0, 0\n*ELEMENT, TYPE=CPS4\n1, 1, 1, 1\n", "have 4 nodes each"),
    "no nodes": ("nodes.npz", {"points": np.eye(2)}, "the array nodes"),
    "labels": ("nodes.npz", {"nodes": np.eye(2), "labels": np.arange(3)}, "the array labels"),
    "set": ("nodes.npz", {"nodes": np.eye(2), "tip": np.array([7])}, 'the set "tip" has node 7'),
    "no numbers": ("nodes.inp", "*NODE\none, 0, 0, 0\n", "cannot be used"),
}
READERS = {"matrix": read_matrix, "rows": read_rows, "nodes": lambda path, entry: read_nodes(path, 2, entry)}
REFUSED = {
    **{f"matrix, {case}": ("matrix", "k.mtx", *of) for case, of in MATRIX_CASES.items()},
    **{f"rows, {case}": ("rows", "rows", *of) for case, of in LIST_CASES.items()},
    **{f"nodes, {case}": ("nodes", *of) for case, of in NODE_CASES.items()},
}


@pytest.mark.parametrize(("entry", "name", "content", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_matrix_and_no_nodes_is_refused_by_name(
    entry: str, name: str, content: str | bytes | dict | None, words: str, tmp_path: Path
) -> None:
    if isinstance(content, dict):
        np.savez(tmp_path / name, **content)
    elif content is not None:
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert_refused(f"^{entry}: .*{words}", READERS[entry], tmp_path / name, entry)
