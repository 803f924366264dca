"""Bodies from matrices through the commands: a chain of them, and bad input with one message and exit status 2."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from assembled import write_abaqus, write_body, write_npz
from conftest import ROOT
from runs import IN_TURN, PAPER_SCENE, overridden
from scipy.linalg import eigh
from solid_scenes import SOLID, THICKNESS, solid_meshes
from solids import body_of, matrices_of

from pgmp_petsc.cli.main import main
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


def matrices() -> tuple[sp.csr_matrix, sp.csr_matrix]:
    return matrices_of(body_of(MESH, 210e9 * THICKNESS, 7800.0 * THICKNESS))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with the files of a rod, sound and spoilt in many ways."""
    folder = tmp_path_factory.mktemp("matrices")
    stiffness, mass = matrices()
    write_body(folder, "rod", MESH, stiffness, mass)
    first, far = 0, MESH.nodes.size - 2
    bar = sp.csr_matrix(([1.0, -1.0, -1.0, 1.0], ([0, 0, far, far], [0, far, 0, far])), stiffness.shape)
    ground = sp.csr_matrix(([1.0], ([first], [first])), stiffness.shape)
    largest = stiffness.max()
    lopsided = sp.csr_matrix(([0.1 * largest], ([4], [8])), stiffness.shape)
    spoilt = {
        "held": stiffness + 0.1 * largest * ground,
        "prescribed": stiffness + 1e36 * ground,
        "preloaded": stiffness - 1e9 * bar,
        "unstable": without_a_mode(stiffness, mass),
        "not symmetric": stiffness + lopsided,
        "triangle": sp.tril(stiffness, format="csr"),
        "empty node": sp.diags((np.arange(stiffness.shape[0]) != 5).astype(float)) @ stiffness,
        "pieces": cut(stiffness),
        "hinged": hinged(),
        "soft": stiffness / 1e12,
    }
    for name, matrix in spoilt.items():
        write_npz(folder / f"{name}.npz", matrix, MESH)
    coupled = sp.csr_matrix(([0.3 * mass.max()] * 2, ([0, 1], [1, 0])), mass.shape)
    heavy = sp.diags(1.0 + 0.5 * (np.arange(mass.shape[0]) % 2 == 1))
    pair = sp.csr_matrix(([2.0, 2.0], ([0, 1], [1, 0])), (MESH.n_nodes,) * 2) * mass.max()
    masses = {
        "coupled": mass + coupled,
        "direction": heavy @ mass,
        "negative": mass + sp.kron(pair, sp.eye(2)),
        "massless": mass - sp.diags(mass.diagonal() * (np.arange(mass.shape[0]) // 2 == 3)),
    }
    for name, matrix in masses.items():
        write_npz(folder / f"mass_{name}.npz", (matrix + matrix.T) / 2, MESH)
    write_abaqus(folder / "other.mtx", *other_body())
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


def other_body():
    mesh = solid_meshes("quad8", 20)["rod"]
    return matrices_of(body_of(mesh))[0], mesh


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
    } | {key: value.format(folder=folder) for key, value in given.items()}
    table = ", ".join(f"{key}={value}" for key, value in entries.items())
    rod = f'bodies.rod={{element="solid2d", matrices={{{table}}}}}'
    kept = [entry for entry in SOLID if not entry.startswith(("bodies.", "joints.crank", "joints.elbow"))]
    return [str(SLIDER_CRANK), *overridden(*kept, *CRANK, *TINY, rod, *overrides)]


def test_a_scene_with_matrices_goes_through_the_commands(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    words = scene(folder, stated="{{mass=0.5379, within=1e-3}}")
    main_ends(["check", *words], 0)
    out = capfd.readouterr().out
    for said in ("rod: 38 nodes, assembled matrices", "rod: 0.537", "3 rigid-body motions without stiffness",
                 "waves along x at 5439 m/s", "means over areas of faces"):  # fmt: skip
        assert said in out, out
    main_ends(["check", *words, "--json"], 0)
    rod = json.loads(capfd.readouterr().out)["bodies"]["rod"]
    assert rod["nodes"] == 38 and rod["mass"] == pytest.approx(0.53792, rel=1e-4)
    rom, run = folder / "rom.h5", folder / "run.h5"
    main_ends(["build", *words, "-o", str(rom)], 0)
    main_ends(["simulate", str(rom), "-o", str(run)], 0)
    main_ends(["simulate", *words, "--components", "-o", str(folder / "components.h5")], 0)
    out = capfd.readouterr().out
    assert "matrices do not tell" in out and "--full" not in out
    reduced, components = Trajectory.read(run), Trajectory.read(folder / "components.h5")
    known = components.outputs["slider_position"]
    np.testing.assert_allclose(reduced.outputs["slider_position"], known, atol=1e-6 * np.abs(known).max())


def test_the_example_of_the_documentation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    page = (ROOT / "docs" / "matrices.md").read_text().replace("/tmp/", f"{tmp_path}/")
    monkeypatch.chdir(ROOT)
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], {})
    rod = re.search(r"    R='(.*)'\n", page)[1]
    main_ends(["check", "scenes/slider_crank_solid3d.toml", "--override", rod], 0)
    out = capfd.readouterr().out
    for said in ("0.537502 kg", "(0.65, 0, 0) m", "6 rigid-body motions without stiffness", "6020 m/s", "count alike"):
        assert said in out and said.split()[0] in page, said


def main_ends(arguments: list[str], status: int) -> None:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == status


def case(command: str, *words: str, overrides: tuple[str, ...] = (), **given: str) -> tuple:
    """Return a command, entries of the matrices, overrides, and words of the message."""
    return command, given, overrides, words


def check(*words: str, overrides: tuple[str, ...] = (), **given: str) -> tuple:
    return case("check", *words, overrides=overrides, **given)


def stiff(name: str, *words: str, command: str = "check") -> tuple:
    return case(command, *words, stiffness=f'"{{folder}}/{name}"')


def heavy(name: str, *words: str) -> tuple:
    return check(*words, mass=f'"{{folder}}/{name}"')


def changed(command: str, entry: str, *words: str) -> tuple:
    return case(command, *words, overrides=(entry,))


CASES = {
    # files
    "no file": stiff("none.mtx", "matrices.stiffness", "no such file"),
    "no nodes": check("matrices.nodes", "no such file", nodes='"{folder}/none.inp"'),
    "no rows": check("matrices.rows", "no such file", rows='"{folder}/none.txt"'),
    "directory": heavy("", "matrices.mass", "this is a directory"),
    "nastran": stiff("punch.pch", "Nastran", "pyNastran", "Matrix Market"),
    "words": stiff("rod.inp", "no format that is known"),
    "size": stiff("size.npz", "10 by 10 entries", "38 nodes", "76 displacements"),
    "shells": heavy("shell.npz", "6 unknowns a node", "mesh the body here"),
    "other body": stiff("other.mtx", "rows of", "does not hold"),
    "few rows": check(
        "76 rows, and the list of rows has 1", stiffness='"{folder}/held.npz"', rows='"{folder}/rows.txt"'
    ),
    # matrices
    "not symmetric": stiff("not symmetric.npz", "not symmetric", "the other way round"),
    "one triangle": stiff("triangle.npz", "holds one triangle", "declare it symmetric"),
    "boundary conditions": stiff("prescribed.npz", "are boundary conditions (1e+36)"),
    "grounded": stiff("held.npz", "2 of 3 rigid-body motions are free", "supports"),
    "pieces": stiff("pieces.npz", "2 pieces that no stiffness joins"),
    "a node without stiffness": stiff("empty node.npz", "not positive: 1 of 76", "node 30, y"),
    "preloaded": stiff("preloaded.npz", "not positive", "preload"),
    "unstable": stiff("unstable.npz", "bodies.rod: its stiffness is not positive: 1 of", command="build"),
    "a hinge inside": stiff("hinged.npz", "bodies.rod: 4 motions are free of stiffness, and 3", command="build"),
    "mass that couples": heavy("mass_coupled.npz", "it ties x to y", "rotary inertia"),
    "mass along y": heavy("mass_direction.npz", "along y it is another one"),
    "negative mass": heavy("mass_negative.npz", "not positive definite"),
    "massless node": heavy("mass_massless.npz", "not positive: 2 of 76", "lumped to all nodes"),
    "stated mass": check("matrices.stated.mass = 1.0: the matrices have 0.53", stated="{{mass=1.0}}"),
    "stated centre": check("matrices.stated.centre", "differs by more", stated="{{centre=[0.0, 0.0]}}"),
    "stated inertia": check("matrices.stated.inertia", "1 numbers are needed", stated="{{inertia=[1.0, 1.0]}}"),
    # entries
    "no unit": check("matrices.units.length", "no such unit", units='{{length="mmm"}}'),
    "unit of another kind": check("matrices.units.mass", "a unit of a mass", units='{{mass="mm"}}'),
    "empty set": check("matrices.faces.left", "name of a set", faces="{{left=[]}}"),
    "no set": check('matrices.faces.left = "lft"', "did you mean 'left'", faces='{{left="lft"}}'),
    "no point": changed(
        "check", 'joints.slider.connect=["ground:origin","rod:tip"]', "joints.slider.connect", "no set of this name"
    ),
    "no node": check("matrices.faces.left", "has no node 7", faces="{{left=[7, 10]}}"),
    "one node": check("matrices.faces.left = [10]", "too small to carry a rotation", faces="{{left=[10]}}"),
    "scale": check("matrices.stiffness_scale", "a positive number", stiffness_scale="-1.0"),
    "numbers": check("matrices.stated.centre", "finite numbers in brackets", stated='{{centre="here"}}'),
    "beam": changed("check", 'bodies.rod.element="beam2d"', "bodies.rod.matrices", "solid2d and solid3d"),
    "material": changed("check", 'bodies.rod.material="steel"', "bodies.rod.material", "in the matrices already"),
    "mesh too": changed("check", 'bodies.rod.mesh="rod.msh"', "exactly one of mesh, line, matrices"),
    # what matrices do not tell
    "full order": case("simulate --full", "bodies.rod.matrices", "--components"),
    "trade-off": case("tradeoff", "bodies.rod.matrices", "--components"),
    "sizes of effects": case("check --effects", "third derivative", "bodies.rod.matrices"),
    "second order": changed(
        "build", "reduction.second_order=true", "reduction.second_order = true", "bodies.rod.matrices"
    ),
    "stiffening": case(
        "build",
        "effects.s",
        "bodies.rod.matrices",
        overrides=('effects.s={type="geometric_stiffening"}', 'effects.i={type="mode_inertia"}'),
    ),
    "stress": changed(
        "check", 'outputs.s={type="stress",body="rod",quantity="von_mises"}', "outputs.s.body", "do not tell stresses"
    ),
    "field": changed(
        "check",
        'fields.f={body="rod",quantity="E",variation=0.1,length=1.0,terms=1}',
        "fields.f.body",
        "place by place",
    ),
    "named reference": case(
        "build",
        'reference.model = "mesh"',
        'take "components"',
        overrides=("reduction.tolerance=0.01", 'reference.model="mesh"'),
    ),
}
ON_TWO_RANKS = ("not symmetric", "grounded", "a hinge inside", "full order", "no unit")


def arguments_of(name: str, folder: Path) -> list[str]:
    command, given, overrides, _ = CASES[name]
    verb, *options = command.split()
    output = [] if verb == "check" else ["-o", str(folder / "out.h5")]
    return [verb, *scene(folder, *overrides, **given), *options, *output]


@pytest.mark.parametrize("name", CASES)
def test_one_clear_message(name: str, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = sorted(folder.iterdir())
    main_ends(arguments_of(name, folder), 2)
    out, err = capfd.readouterr()
    assert err.startswith("pgmp: error: ") and err.count("\n") == 1 and "Traceback" not in out + err, err
    for words in CASES[name][3]:
        assert words in err, err
    assert sorted(folder.iterdir()) == before, "nothing is left behind"


def test_one_clear_message_on_two_ranks(mpirun: Callable, folder: Path) -> None:
    commands = [arguments_of(name, folder) for name in ON_TWO_RANKS]
    done = mpirun(2, "-c", IN_TURN, json.dumps(commands))
    assert [json.loads(line) for line in done.stdout.splitlines()] == [[2, 2]] * len(commands)
    assert "Traceback" not in done.stderr


def test_units_that_make_strange_bodies_are_doubted(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    main_ends(["check", *scene(folder, stiffness='"{folder}/soft.npz"'), "--strict"], 2)
    out, err = capfd.readouterr()
    assert "bodies.rod.matrices.units" in out + err and "mass in t" in out + err
