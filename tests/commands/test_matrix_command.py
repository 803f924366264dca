"""Bodies from matrices through the commands: a chain of them, and bad input with one message and exit status 2."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from assembled import write_abaqus, write_body, write_npz
from conftest import ROOT
from refusals import cases
from runs import PAPER_SCENE, one_message, overridden, pgmp, refused
from scipy.linalg import eigh
from solid_scenes import SOLID, THICKNESS, solid_meshes
from solids import body_of, matrices_of

from pgmp_petsc.results import Trajectory

SLIDER_CRANK = PAPER_SCENE.with_name("slider_crank.toml")
MESH = solid_meshes("quad8", 10)["rod"]
TINY = ("reduction.modes=2", "reduction.angles=8", "simulation.duration=0.01", "simulation.step=1e-3")
CRANK = (
    'bodies.crank={line={length=0.3, elements=3}, element="beam2d", material="steel", '
    'section={shape="circle", radius=5.6e-3}}',
    'joints.crank_hinge.connect=["ground:origin", "crank:hinge"]',
    'joints.elbow.connect=["crank:tip", "rod:left"]',
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with the files of a rod, sound and spoilt in many ways."""
    folder = tmp_path_factory.mktemp("matrices")
    stiffness, mass = matrices_of(body_of(MESH, 210e9 * THICKNESS, 7800.0 * THICKNESS))
    write_body(folder, "rod", MESH, stiffness, mass)
    first, far = 0, MESH.nodes.size - 2
    bar = sp.csr_matrix(([1.0, -1.0, -1.0, 1.0], ([0, 0, far, far], [0, far, 0, far])), stiffness.shape)
    ground = sp.csr_matrix(([1.0], ([first], [first])), stiffness.shape)
    largest = stiffness.max()
    lopsided = sp.csr_matrix(([0.1 * largest], ([4], [8])), stiffness.shape)
    spoilt = {
        "held": stiffness + 0.1 * largest * ground, "prescribed": stiffness + 1e36 * ground,
        "preloaded": stiffness - 1e9 * bar, "unstable": without_a_mode(stiffness, mass),
        "not symmetric": stiffness + lopsided, "triangle": sp.tril(stiffness, format="csr"),
        "empty node": sp.diags((np.arange(stiffness.shape[0]) != 5).astype(float)) @ stiffness,
        "pieces": cut(stiffness), "hinged": hinged(), "soft": stiffness / 1e12,
    }  # fmt: skip
    for name, matrix in spoilt.items():
        write_npz(folder / f"{name}.npz", matrix, MESH)
    coupled = sp.csr_matrix(([0.3 * mass.max()] * 2, ([0, 1], [1, 0])), mass.shape)
    heavy = sp.diags(1.0 + 0.5 * (np.arange(mass.shape[0]) % 2 == 1))
    pair = sp.csr_matrix(([2.0, 2.0], ([0, 1], [1, 0])), (MESH.n_nodes,) * 2) * mass.max()
    masses = {
        "coupled": mass + coupled, "direction": heavy @ mass, "negative": mass + sp.kron(pair, sp.eye(2)),
        "massless": mass - sp.diags(mass.diagonal() * (np.arange(mass.shape[0]) // 2 == 3)),
    }  # fmt: skip
    for name, matrix in masses.items():
        write_npz(folder / f"mass_{name}.npz", (matrix + matrix.T) / 2, MESH)
    finer = solid_meshes("quad8", 20)["rod"]
    write_abaqus(folder / "other.mtx", matrices_of(body_of(finer))[0], finer)
    write_npz(folder / "size.npz", sp.eye(10, format="csr"), MESH)
    write_npz(folder / "shell.npz", sp.eye(6 * MESH.n_nodes, format="csr"), MESH)
    (folder / "punch.pch").write_text("DMIG    KAAX           0       6       1       0\n")
    (folder / "rows.txt").write_text("1 10 UX\n")
    return folder


def without_a_mode(stiffness: sp.csr_matrix, mass: sp.csr_matrix) -> sp.csr_matrix:
    """Return the stiffness with the energy of the sixth elastic mode taken away one and a half times."""
    values, modes = eigh(stiffness.toarray(), mass.toarray())
    momentum = mass @ modes[:, 8]
    return sp.csr_matrix(stiffness - 1.5 * values[8] * np.outer(momentum, momentum))


def cut(stiffness: sp.csr_matrix) -> sp.csr_matrix:
    """Return the stiffness without what joins the nodes beyond the middle to the others."""
    beyond = np.repeat(MESH.nodes[:, 0] > 0.65, 2)
    entries = stiffness.tocoo()
    kept = beyond[entries.row] == beyond[entries.col]
    return sp.csr_matrix((entries.data[kept], (entries.row[kept], entries.col[kept])), stiffness.shape)


def hinged() -> sp.csr_matrix:
    """Return the stiffness of the rod with a hinge: its right part hangs on one node of the left one, and its other
    nodes there, of its own, follow without loads."""
    solid, right = body_of(MESH, 210e9 * THICKNESS), MESH.nodes[MESH.cells].mean(axis=1)[:, 0] > 0.65
    parts = []
    for side in (False, True):
        region = replace(solid.regions[0], cells=np.flatnonzero(right == side))
        parts.append(matrices_of(replace(solid, regions=(region,)))[0])
    pin, *loose = np.intersect1d(MESH.cells[~right], MESH.cells[right])
    kept = np.append(np.setdiff1d(MESH.cells[right], MESH.cells[~right]), pin)
    of_kept, of_loose = ((2 * np.array(nodes)[:, None] + np.arange(2)).ravel() for nodes in (kept, loose))
    whole = parts[1].toarray()
    between = whole[np.ix_(of_kept, of_loose)]
    whole[np.ix_(of_kept, of_kept)] -= between @ np.linalg.solve(whole[np.ix_(of_loose, of_loose)], between.T)
    whole[of_loose], whole[:, of_loose] = 0.0, 0.0
    return sp.csr_matrix(parts[0] + whole)


def scene(folder: Path, *overrides: str, **given: str) -> list[str]:
    """Return the words of a command's scene with the rod from matrices, entries of which are replaced."""
    entries = {
        "stiffness": f'"{folder}/rod_k_abaqus.mtx"',
        "mass": f'"{folder}/rod_m_abaqus.mtx"',
        "nodes": f'"{folder}/rod.inp"',
    } | given
    table = ", ".join(f"{key}={value}" for key, value in entries.items())
    rod = f'bodies.rod={{element="solid2d", matrices={{{table}}}}}'
    kept = [entry for entry in SOLID if not entry.startswith(("bodies.", "joints.crank", "joints.elbow"))]
    return [str(SLIDER_CRANK), *overridden(*kept, *CRANK, *TINY, rod, *overrides)]


def test_a_scene_with_matrices_goes_through_the_commands(folder: Path) -> None:
    words = scene(folder, stated="{mass=0.5379, within=1e-3}")
    out = pgmp("check", *words).stdout
    for said in ("rod: 38 nodes, assembled matrices", "rod: 0.537", "3 rigid-body motions without stiffness",
                 "waves along x at 5439 m/s", "means over areas of faces"):  # fmt: skip
        assert said in out, out
    rod = json.loads(pgmp("check", *words, "--json").stdout)["bodies"]["rod"]
    assert rod["nodes"] == 38 and rod["mass"] == pytest.approx(0.53792, rel=1e-4)
    rom, run = folder / "rom.h5", folder / "run.h5"
    shown = ("simulate", rom, "-o", run), ("simulate", *words, "--components", "-o", folder / "components.h5")
    out = "".join(pgmp(*command).stdout for command in (("build", *words, "-o", rom), *shown))
    assert "matrices do not tell" in out and "--full" not in out
    reduced, components = Trajectory.read(run), Trajectory.read(folder / "components.h5")
    known = components.outputs["slider_position"]
    np.testing.assert_allclose(reduced.outputs["slider_position"], known, atol=1e-6 * np.abs(known).max())


def test_the_example_of_the_documentation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs" / "matrices.md").read_text().replace("/tmp/", f"{tmp_path}/")
    monkeypatch.chdir(ROOT)
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], {})
    rod = re.search(r"    R='(.*)'\n", page)[1]
    out = pgmp("check", "scenes/slider_crank_solid3d.toml", "--override", rod).stdout
    for said in ("0.537502 kg", "(0.65, 0, 0) m", "6 rigid-body motions without stiffness", "6020 m/s", "count alike"):
        assert said in out and said.split()[0] in page, said


#: Commands, and what they are asked with: entries of the matrices, or overrides, which have a dot; * on two ranks too.
REFUSED = cases("""
check & stiffness="FOLDER/none.mtx" -> matrices.stiffness | no such file
check & nodes="FOLDER/none.inp" -> matrices.nodes | no such file
check & rows="FOLDER/none.txt" -> matrices.rows | no such file
check & mass="FOLDER/" -> matrices.mass | this is a directory
check & stiffness="FOLDER/punch.pch" -> matrices.stiffness
check & stiffness="FOLDER/rod.inp" -> A deck of nodes and elements has none
check & stiffness="FOLDER/size.npz" -> 10 by 10 entries | 38 nodes | 76 displacements
check & mass="FOLDER/shell.npz" -> 6 unknowns a node | mesh the body here
check & stiffness="FOLDER/other.mtx" -> rows of | does not hold
check & stiffness="FOLDER/held.npz" & rows="FOLDER/rows.txt" -> 76 rows, and the list of rows has 1
* check & stiffness="FOLDER/not symmetric.npz" -> not symmetric | the other way round
check & stiffness="FOLDER/triangle.npz" -> holds one triangle | declare it symmetric
check & stiffness="FOLDER/prescribed.npz" -> are boundary conditions (1e+36)
* check & stiffness="FOLDER/held.npz" -> 2 of 3 rigid-body motions are free | supports
check & stiffness="FOLDER/pieces.npz" -> 2 pieces that no stiffness joins
check & stiffness="FOLDER/empty node.npz" -> not positive: 1 of 76 | node 30, y
check & stiffness="FOLDER/preloaded.npz" -> not positive | preload
build & stiffness="FOLDER/unstable.npz" -> bodies.rod: its stiffness is not positive: 1 of
* build & stiffness="FOLDER/hinged.npz" -> bodies.rod: 4 motions are free of stiffness, and 3
check & mass="FOLDER/mass_coupled.npz" -> it ties x to y | rotary inertia
check & mass="FOLDER/mass_direction.npz" -> along y it is another one
check & mass="FOLDER/mass_negative.npz" -> not positive definite
check & mass="FOLDER/mass_massless.npz" -> not positive: 2 of 76 | lumped to all nodes
check & stated={mass=1.0} -> matrices.stated.mass = 1.0: the matrices have 0.53
check & stated={centre=[0.0, 0.0]} -> matrices.stated.centre | differs by more
check & stated={inertia=[1.0, 1.0]} -> matrices.stated.inertia | 1 numbers are needed
* check & units={length="mmm"} -> matrices.units.length | no such unit
check & units={mass="mm"} -> matrices.units.mass | a unit of a mass
check & faces={left=[]} -> matrices.faces.left | name of a set
check & faces={left="lft"} -> matrices.faces.left = "lft" | did you mean 'left'
check & joints.slider.connect=["ground:origin","rod:tip"] -> joints.slider.connect | no set of this name
check & faces={left=[7, 10]} -> matrices.faces.left | has no node 7
check & faces={left=[10]} -> matrices.faces.left = [10] | too small to carry a rotation
check & stiffness_scale=-1.0 -> matrices.stiffness_scale | a positive number
check & stated={centre="here"} -> matrices.stated.centre | finite numbers in brackets
check & bodies.rod.element="beam2d" -> bodies.rod.matrices | solid2d and solid3d
check & bodies.rod.material="steel" -> bodies.rod.material | in the matrices already
check & bodies.rod.mesh="rod.msh" -> exactly one of mesh, line, matrices, rigid
* simulate --full -> bodies.rod.matrices | --components
tradeoff -> bodies.rod.matrices | --components
check --effects -> third derivative | bodies.rod.matrices
build & reduction.second_order=true -> reduction.second_order = true | bodies.rod.matrices
build & effects.s={type="geometric_stiffening"} & effects.i={type="mode_inertia"} -> effects.s | bodies.rod.matrices
check & outputs.s={type="stress",body="rod",quantity="von_mises"} -> outputs.s.body | do not tell stresses
check & fields.f={body="rod",quantity="E",variation=0.1,length=1.0,terms=1} -> fields.f.body | place by place
build & reduction.tolerance=0.01 & reference.model="mesh" -> reference.model = "mesh" | take "components"
""")


def arguments_of(asked: str, folder: Path) -> list[str]:
    command, *parts = asked.removeprefix("* ").replace("FOLDER", str(folder)).split(" & ")
    entries = dict(part.split("=", 1) for part in parts if "." not in part.partition("=")[0])
    overrides = [part for part in parts if "." in part.partition("=")[0]]
    verb, *options = command.split()
    output = [] if verb == "check" else ["-o", str(folder / "out.h5")]
    return [verb, *scene(folder, *overrides, **entries), *options, *output]


@pytest.mark.parametrize(("asked", "said"), REFUSED)
def test_one_clear_message(asked: str, said: str, folder: Path) -> None:
    before = sorted(folder.iterdir())
    err = one_message(*arguments_of(asked, folder))
    assert all(words in err for words in said.split(" | ")), err
    assert sorted(folder.iterdir()) == before, "nothing is left behind"


def test_one_clear_message_on_two_ranks(folder: Path) -> None:
    assert refused(2, [arguments_of(asked, folder) for asked, _ in REFUSED if asked.startswith("* ")])


def test_units_that_make_strange_bodies_are_doubted(folder: Path) -> None:
    done = pgmp("check", *scene(folder, stiffness=f'"{folder}/soft.npz"'), "--strict", status=2)
    told = done.stdout + done.stderr
    assert "bodies.rod.matrices.units" in told and "mass in t" in told
