"""One rotor through the files of every program: the same frequencies in `pgmp modes`, free and on a hinge.

A round shaft with a disc in the middle, on a coarse mesh whose first free frequency is 104.637 Hz: its length is chosen
so. The mesh's own error is 5.3 %, which finer ones show; readers have to hand over the same body.
"""

import io
import re
import runpy
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from assembled import ABAQUS, GAP, labels_of, write_body, write_inp
from conftest import ROOT
from pencils import free_hz
from refusals import refusal
from runs import refused, said
from scipy.linalg import eigh
from scipy.optimize import brentq
from solids import body_of, grouped, matrices_of

from pgmp_petsc.bodies.assembled_reading import read_assembled
from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.mesh.matrix_files import in_order_of_nodes, read_matrix, read_nodes
from pgmp_petsc.mesh.meshes import cell_faces, reference_element
from pgmp_petsc.mesh.reading import made_by
from pgmp_petsc.mesh.solid_mesh_reading import solid_mesh
from pgmp_petsc.results import ModesTable
from pgmp_petsc.scene import load_scene
from scenes import tables

LENGTH, E, RHO = 0.86130775, 210e9, 7800.0  # m, Pa, kg/m3
RADIUS, DISC, WIDTH = 0.01, 0.06, 0.02  # of the shaft and the disc, and how wide this is, m
COARSE, KNOWN = 2, 104.637  # cells on either side of the disc, Hz
SAME = 1e-6
SCENE = tables(f"""
scene: name = "rotor"
materials.steel: E = {E}; nu = 0.3; rho = {RHO}
bodies.rod: element = "solid3d"
BODY
joints.hinge: type = "revolute"; connect = ["ground:origin", "rod:left"]; axis = [0.0, 0.0, 1.0]
ELASTIC
coordinates.angle: joint = "hinge"; range = [-1.0, 1.0]
reduction: modes = 4
""")
#: Stiffness, mass, nodes and further entries, by the program.
FILES = {
    "Abaqus": ("rod_k_abaqus.mtx", "rod_m_abaqus.mtx", "rod.inp", ""),
    "CalculiX": ("rod.sti", "rod.mas", "rod.inp", ', rows="rod.dof"'),
    "Ansys HBMAT": ("rod_k_hbmat.matrix", "rod_m_hbmat.matrix", "rod.cdb", ', faces={left="LEFT"}'),
    "Nastran OP4": ("rod_k.op4", "rod_m.op4", "rod.bdf", ', faces={left="7"}'),
    "Nastran OP2": ("rod.op2", "rod.op2", "rod.bdf", ', faces={left="7"}'),
    "Craig and Bampton": ("reduced.npz", "rod_m_abaqus.mtx", "rod.inp", ', modes="shapes.npz"'),
    "Nastran OP4 of displacements": ("rod_3.op4", "rod_3.op4", "rod.bdf", ', faces={left="7"}'),
}
#: Of a joint that holds nothing.
RELEASED = """elastic.reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
elastic.stiffness = [0.0, 0.0, 0.0]
elastic.damping = [0.0, 0.0, 0.0]
elastic.turning_stiffness = [0.0, 0.0, 0.0]
elastic.turning_damping = [0.0, 0.0, 0.0]"""


def rotor_mesh(n: int) -> SolidMesh:
    """Return hexahedron20 along x, n on either side of the disc: a square core, four cells around it, four of the disc.

    Sections are rings of whole cells, whose places (a, b) between radii and angles are mapped by the node's.
    """
    half = 0.5 * (LENGTH - WIDTH)
    x = np.concatenate([np.linspace(0.0, half, n + 1), np.linspace(half + WIDTH, LENGTH, n + 1)])
    along, a, b = reference_element("hexahedron20").nodes.T
    square, places = 0.55 * RADIUS, []
    for k in range(2 * n + 1):
        at = x[k] + along * (x[k + 1] - x[k])
        places.append(np.column_stack([at, square * np.sqrt(0.5) * np.column_stack([2 * a - 1, 2 * b - 1])]))
        for quarter in range(4):
            angles = np.pi / 4 + (quarter + b) * np.pi / 2
            arc = np.column_stack([np.cos(angles), np.sin(angles)])
            ends = np.pi / 4 + (quarter + np.arange(2)) * np.pi / 2
            corners = np.column_stack([np.cos(ends), np.sin(ends)])
            side = (1 - b)[:, None] * corners[0] + b[:, None] * corners[1]
            places.append(np.column_stack([at, (1 - a)[:, None] * square * side + a[:, None] * RADIUS * arc]))
            if k == n:
                places.append(np.column_stack([at, (RADIUS + a * (DISC - RADIUS))[:, None] * arc]))
    nodes, cells = np.unique(np.concatenate(places).round(12), axis=0, return_inverse=True)
    cells = cells.reshape(-1, 20)
    faces = cell_faces("hexahedron20", cells)
    at = {"left": 0.0, "right": LENGTH}
    sides = {name: faces[(abs(nodes[faces, 0] - x) < 1e-9).all(axis=1)] for name, x in at.items()}
    return solid_mesh(grouped(nodes, "hexahedron20", cells, sides), 3, "rotor")


MESH = rotor_mesh(COARSE)
STIFFNESS, MASS = matrices_of(body_of(MESH, E, RHO))
#: What stands for ansys-mapdl-reader where there is no Ansys to write a .full: rows from 0, one triangle.
READER = """
from types import SimpleNamespace
import numpy as np, scipy.sparse as sp
def read_binary(path):
    with np.load(path) as file:
        k, m, labels = (file[name] for name in ("k", "m", "labels"))
    rows = np.column_stack([np.repeat(labels, 3), np.tile(np.arange(3), len(labels))])
    load = lambda sort: (rows, sp.triu(k), sp.triu(m))
    return SimpleNamespace(const=np.zeros((0, 2)), load_km=load)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    pytest.importorskip("pyNastran")
    pytest.importorskip("ansys.mapdl.reader")
    folder = tmp_path_factory.mktemp("programs")
    for kind in ("abaqus.mtx", "hbmat.matrix"):
        write_body(folder, "rod", MESH, STIFFNESS, MASS, kind)
    labels = labels_of(MESH)
    matrices = {"k": STIFFNESS.toarray(), "m": MASS.toarray()}
    cells = labels[MESH.cells]
    np.savez(folder / "in.npz", nodes=MESH.nodes, labels=labels, cells=cells, **matrices)
    program = ROOT / "tests" / "written_decks.py"
    subprocess.run([sys.executable, program, folder / "in.npz", folder], check=True, capture_output=True)
    for ending, matrix in (("sti", STIFFNESS), ("mas", MASS)):
        upper = sp.triu(matrix).tocoo()
        lines = (f"{i + 1} {j + 1} {v:.15e}" for i, j, v in zip(upper.row, upper.col, upper.data))
        (folder / f"rod.{ending}").write_text("\n".join(lines) + "\n")
    (folder / "rod.dof").write_text("".join(f"{label}.{axis}\n" for label in labels for axis in (1, 2, 3)))
    shapes = craig_bampton(**matrices, n_modes=60)
    sp.save_npz(folder / "shapes.npz", sp.csr_matrix(shapes))
    sp.save_npz(folder / "reduced.npz", sp.csr_matrix(shapes.T @ STIFFNESS @ shapes))
    np.savez(folder / "rod.npz", labels=labels, **matrices)
    (folder / "rod.npz").rename(folder / "rod.full")
    return folder


@pytest.fixture(autouse=True)
def read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read files in this process, each once: a process of its own takes a second to load its library.

    OP2 and what is written for a test alone have one, and all files on several ranks.
    """
    monkeypatch.setattr("pgmp_petsc.mesh.matrix_files.made_by", lambda *asked: read_once(*asked[:2]))


@cache
def read_once(program: Path, words: tuple) -> dict[str, np.ndarray] | str:
    form, kind, path = words
    if form in ("op2", "full") and path.name != "file.full":
        return made_by(program, words, 60.0)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        found = runpy.run_path(str(program))["main"](form, kind, str(path))
    return str(found["refused"]) if "refused" in found else found


def craig_bampton(k: np.ndarray, m: np.ndarray, n_modes: int) -> np.ndarray:
    """Return the displacements of all nodes that unit ones of both ends' nodes make, and modes with these held."""
    ends = np.isin(MESH.nodes[:, 0], (0.0, LENGTH)).repeat(3)
    held, free = np.flatnonzero(ends), np.flatnonzero(~ends)
    inside = k[np.ix_(free, free)]
    shapes = np.zeros((len(k), held.size + n_modes))
    shapes[held, np.arange(held.size)] = 1.0
    shapes[free, : held.size] = -np.linalg.solve(inside, k[np.ix_(free, held)])
    shapes[free, held.size :] = eigh(inside, m[np.ix_(free, free)], subset_by_index=[0, n_modes - 1])[1]
    return shapes


def table(program: str) -> str:
    stiffness, mass, nodes, more = FILES[program]
    return f'matrices={{stiffness="{stiffness}", mass="{mass}", nodes="{nodes}"{more}}}'


def scene_of(folder: Path, body: str, name: str, elastic: str = "") -> Path:
    path = folder / f"{re.sub('[^a-z]', '_', name.lower())}.toml"
    path.write_text(SCENE.replace("BODY", body.replace("matrices=", "matrices = ", 1)).replace("ELASTIC", elastic))
    return path


def free_frequency(stiffness: sp.spmatrix, mass: sp.spmatrix) -> float:
    return float(free_hz(stiffness, mass, 2)[0])


def test_finer_meshes_lie_between_two_beams() -> None:
    """Euler's and Bernoulli's on both sides of a mass that does not turn: in a rigid disc, and through a soft one."""
    stiffness, line, mass = E * np.pi * RADIUS**4 / 4, RHO * np.pi * RADIUS**2, RHO * np.pi * DISC**2 * WIDTH / 2

    def free(hz: float, half: float) -> float:
        """Rows: no slope and the disc's inertia at its side; neither moment nor shear at the end."""
        eigenvalue = (2.0 * np.pi * hz) ** 2
        wave = (line * eigenvalue / stiffness) ** 0.25
        c, s, ch, sh = (f(wave * half) for f in (np.cos, np.sin, np.cosh, np.sinh))
        m, k = mass * eigenvalue, stiffness * wave**3
        return float(np.linalg.det([[0, 1, 0, 1], [m, k, m, -k], [-c, -s, ch, sh], [s, -c, sh, ch]]))

    soft, rigid = (brentq(free, 80.0, 130.0, args=(half,)) for half in (0.5 * LENGTH, 0.5 * (LENGTH - WIDTH)))
    coarse, fine, finest = (free_frequency(*matrices_of(body_of(rotor_mesh(n), E, RHO))) for n in (COARSE, 8, 16))
    assert coarse == pytest.approx(KNOWN, rel=1e-8)
    assert soft < finest < fine < rigid < 1.05 * soft and coarse == pytest.approx(finest, rel=0.06)


@pytest.mark.parametrize("program", FILES)
def test_every_program_has_the_same_frequencies(program: str, folder: Path) -> None:
    body = table(program).replace(', faces={left="LEFT"}', f", faces={{left={ends()}}}")
    scene = scene_of(folder, body, program)
    read = read_assembled(load_scene(scene), "rod")
    assert free_frequency(read.matrix("stiffness"), read.matrix("mass")) == pytest.approx(KNOWN, rel=SAME)
    np.testing.assert_allclose(modes_hz(folder, scene)[0], of_the_mesh(folder), rtol=SAME)
    if program == "Abaqus":  # on springs of nothing the matrices of all programs are alike
        found = modes_hz(folder, scene_of(folder, body, program, RELEASED))
        np.testing.assert_allclose(found[:, :2], KNOWN, rtol=SAME)


def test_the_free_rotor_from_its_mesh(folder: Path) -> None:
    scene = scene_of(folder, 'mesh = "rod.inp"\nmaterial = "steel"', "mesh", RELEASED)
    np.testing.assert_allclose(modes_hz(folder, scene)[:, :2], KNOWN, rtol=SAME)


@pytest.mark.parametrize("n_modes, same", [(10, 2e-4), (40, 1e-6)])
def test_a_reduced_rotor_comes_near_with_its_modes(n_modes: int, same: float, folder: Path) -> None:
    """What is left is due to modes with the ends held that it does not have: 1e-4, and 3e-7 with round-off."""
    shapes = craig_bampton(STIFFNESS.toarray(), MASS.toarray(), n_modes)
    sp.save_npz(folder / "few.npz", sp.csr_matrix(shapes))
    sp.save_npz(folder / "few_k.npz", sp.csr_matrix(shapes.T @ STIFFNESS @ shapes))
    body = table("Craig and Bampton").replace("shapes", "few").replace("reduced", "few_k")
    for elastic, known in (("", of_the_mesh(folder)), (RELEASED, np.full(2, KNOWN))):
        found = modes_hz(folder, scene_of(folder, body, "few", elastic))
        np.testing.assert_allclose(found[0, : known.size], known, rtol=same)


def test_ten_digits_of_dmig_are_too_few_for_a_slender_body(folder: Path) -> None:
    nodes = read_nodes(folder / "rod.bdf", 3, "nodes")
    for kind, known in (("stiffness", STIFFNESS), ("mass", MASS)):
        found = in_order_of_nodes(read_matrix(folder / "rod.pch", kind, kind), None, nodes, kind, "nodes")
        np.testing.assert_allclose(found.toarray(), known.toarray(), atol=1e-10 * np.abs(known.toarray()).max())
    dmig = 'matrices={stiffness="rod.pch", mass="rod.pch", nodes="rod.bdf", faces={left="7"}}'
    (message,) = refused(1, [("check", scene_of(folder, dmig, "dmig"))])
    assert "a smooth displacement of the body has negative energy" in message and "with all its digits" in message


def test_bulk_data_alone_are_read_with_and_without_their_first_line(folder: Path) -> None:
    whole = (folder / "rod.bdf").read_text()
    bulk = re.sub(r"(?is).*BEGIN\s+BULK", "", whole)
    for name, head in (("begun", "$ of a pre-processor\nBEGIN BULK\n"), ("bare", "")):
        (folder / f"{name}.bdf").write_text(head + bulk)
        found, known = (read_nodes(folder / f"{one}.bdf", 3, "nodes") for one in (name, "rod"))
        np.testing.assert_array_equal(found.labels, known.labels)
        np.testing.assert_array_equal(found.nodes, known.nodes)


def ends() -> list[int]:
    return labels_of(MESH)[MESH.nodes[:, 0] == 0.0].tolist()


def modes_hz(folder: Path, scene: Path) -> np.ndarray:
    """Return the frequencies that `pgmp modes` finds at two angles, Hz."""
    said("modes", scene, "--angles", "2", "-o", folder / "modes.h5")
    return ModesTable.read(folder / "modes.h5").full_hz


@cache
def of_the_mesh(folder: Path) -> np.ndarray:
    return modes_hz(folder, scene_of(folder, 'mesh = "rod.inp"\nmaterial = "steel"', "mesh"))[0]


def test_ansys_full_by_what_stands_for_its_reader(folder: Path, monkeypatch) -> None:
    package = folder / "reader" / "ansys" / "mapdl" / "reader"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(READER)
    for above in (package.parent, package.parent.parent):
        (above / "__init__.py").write_text("")
    monkeypatch.setenv("PYTHONPATH", str(folder / "reader"))
    FILES["full"] = ("rod.full", "rod.full", "rod.inp", "")
    body = read_assembled(load_scene(scene_of(folder, table("full"), "full")), "rod")
    np.testing.assert_allclose(body.matrix("stiffness").toarray(), STIFFNESS.toarray(), rtol=1e-13, atol=1e-3)
    np.testing.assert_allclose(body.matrix("mass").toarray(), MASS.toarray(), rtol=1e-13, atol=1e-15)


def ansys_examples() -> Path:
    return Path(__import__("ansys.mapdl.reader").mapdl.reader.__file__).parent / "examples"


def test_files_that_ansys_wrote() -> None:
    """The beam of ansys-mapdl-reader's own examples: 321 nodes, 21 of them held."""
    nodes = read_nodes(ansys_examples() / "HexBeam.cdb", 3, "nodes")
    assert nodes.nodes.shape == (321, 3) and nodes.mesh.kind == "hexahedron20" and len(nodes.mesh.cells) == 40


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed (Debian: calculix-ccx)")
def test_files_that_calculix_wrote(folder: Path) -> None:
    """Its own matrices of C3D20 from the same nodes, with 14 digits."""
    own = folder / "ccx"
    own.mkdir()
    write_inp(own / "rod.inp", MESH)
    deck = (own / "rod.inp").read_text() + (
        f"*MATERIAL, NAME=S\n*ELASTIC\n{E}, 0.3\n*DENSITY\n{RHO}\n*SOLID SECTION, ELSET=ALL, MATERIAL=S\n"
        "*STEP\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n2\n*END STEP\n"
    )
    (own / "run.inp").write_text(deck)
    subprocess.run(["ccx", "run"], cwd=own, check=True, capture_output=True)
    written = 'matrices={stiffness="run.sti", mass="run.mas", nodes="run.inp", rows="run.dof"}'
    body = read_assembled(load_scene(scene_of(own, written, "ccx")), "rod")
    known = free_frequency(STIFFNESS, MASS)
    assert free_frequency(body.matrix("stiffness"), body.matrix("mass")) == pytest.approx(known, rel=SAME)
    assert ABAQUS[MESH.kind] == "C3D20" and GAP * MESH.n_nodes == body.labels.max()


def test_what_is_no_body_is_refused_in_one_message_on_any_number_of_ranks(folder: Path, monkeypatch) -> None:
    modal = "DMIG    KAAX           0       6       2       0\n"
    modal += "DMIG    KAAX          10       1              10       1  1.0+09\n"
    modal += "DMIG    KAAX         901       0             901       0  1.0+06\n"
    for name, text in {
        "none.bdf": "$ nothing\nMAT1           1   2.1+9              .3\n", "none.cdb": "/PREP7\n", "run.op2": "",
        "none.pch": "DMIG    P              0       6       2       0\n", "reduced.pch": modal,
        "two.pch": modal.replace("KAAX", "MAAX") + modal.replace("KAAX", "MBBX"),
        "cut.op4": (folder / "rod_k.op4").read_text()[:5000],
    }.items():  # fmt: skip
        (folder / name).write_text(text)
    asked = {}
    for name, key, words in (
        ("none.bdf", "nodes", "it has no GRID"), ("none.cdb", "nodes", "none.cdb"),
        ("two.pch", "stiffness", "of which 0 begin with K"), ("cut.op4", "stiffness", "cut.op4"),
        ("reduced.pch", "stiffness", "1 rows are of scalar points, such as 901, as the modal amplitudes of a Craig"),
        ("run.op2", "stiffness", "pyNastran cannot read this file"),
        ("none.pch", "stiffness", "pyNastran cannot read this file"),  # loads alone
        ("rod.inp", "stiffness", "A deck of nodes and elements has none"),
        ("rod.bdf", "stiffness", "A deck of nodes and elements has none"),
    ):  # fmt: skip
        own = {"stiffness": "rod.pch", "mass": "rod.pch", "nodes": "rod.bdf"} | {key: name}
        entries = ", ".join(f'{entry}="{file}"' for entry, file in own.items())
        asked[name] = f'matrices={{{entries}, faces={{left="7"}}}}', (f"matrices.{key}", name, words)
    shapes, examples = sp.load_npz(folder / "shapes.npz"), ansys_examples()
    for name, own, words in (
        ("fewer", shapes[:, 1:], "displacements of the nodes, node after node, by"),
        ("again", sp.hstack([shapes[:, 1:], shapes[:, 1:2]]).tocsr(), "columns depend on each other"),
    ):
        sp.save_npz(folder / f"{name}.npz", own)
        body = table("Craig and Bampton").replace("shapes", name)
        asked[name] = body, (f'matrices.modes = "{name}.npz"', words)
    held = f'matrices={{stiffness="{examples}/file.full", mass="{examples}/file.full", nodes="{examples}/HexBeam.cdb"}}'
    asked["held"] = held, ("matrices.stiffness", "63 of 963 rows are held by constraints")
    commands = [("check", scene_of(folder, body, name)) for name, (body, _) in asked.items()]
    for message, (_, words) in zip(refused(1, commands), asked.values()):
        assert all(word in message for word in words), message
    absent = folder / "absent" / "pyNastran"
    absent.mkdir(parents=True)
    (absent / "__init__.py").write_text("raise ImportError('no such library')")
    with monkeypatch.context() as patch:
        patch.setenv("PYTHONPATH", str(absent.parent))
        empty, message = refused(2, [commands[1], ("check", scene_of(folder, table("Nastran OP4"), "absent"))])
        assert all(word in empty for word in asked["none.cdb"][1])
        assert "matrices.nodes" in message and "pip install pyNastran" in message
    assert "rows of 1 nodes that" in refusal(read_other, folder)
    monkeypatch.setattr("pgmp_petsc.bodies.assembled_reading.MOST_REDUCED", 10)
    large = load_scene(scene_of(folder, table("Craig and Bampton"), "large"))
    assert "a reduced body has at most 10" in refusal(read_assembled, large, "rod")


def read_other(folder: Path) -> None:
    other = 'matrices={stiffness="rod_k_abaqus.mtx", mass="rod_m_abaqus.mtx", nodes="other.csv"}'
    rows = (folder / "rod.inp").read_text().partition("*NODE\n")[2].partition("*ELEMENT")[0]
    (folder / "other.csv").write_text(rows.replace("10, ", "11, ", 1))
    read_assembled(load_scene(scene_of(folder, other, "other")), "rod")
