"""Bodies from matrices through the commands: a chain of them, and bad input with one message and exit status 2."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from assembled import labels_of, write_abaqus, write_body, write_inp, write_npz
from runs import IN_TURN, PAPER_SCENE, overridden
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
        "preloaded": stiffness - 1e6 * bar,
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
    """Return the stiffness of the rod with a hinge: its right part is held by one node of the left one."""
    solid = body_of(MESH, 210e9 * THICKNESS)
    middles = MESH.nodes[MESH.cells].mean(axis=1)[:, 0]
    left = MESH.cells[middles < 0.65]
    shared = np.intersect1d(left, MESH.cells[middles > 0.65])
    from dataclasses import replace

    from pgmp_petsc.bodies.solid import Region, Solid

    near, far = (np.flatnonzero((middles > 0.65) == side) for side in (False, True))
    # the far part on nodes of its own but for one of those that it shares: these are then of the near part alone
    parts = [
        Solid("body", MESH, (replace(solid.regions[0], cells=cells),)).stiffness(range(MESH.n_nodes)).popitem()[1]
        for cells in (near, far)
    ]
    assert Region is not None
    loose = shared[1:]
    far_part = parts[1].tolil()
    rows = np.concatenate([2 * loose, 2 * loose + 1])
    inner = np.setdiff1d(np.unique(MESH.cells[far]), shared)
    kept = np.concatenate([2 * np.append(inner, shared[0]), 2 * np.append(inner, shared[0]) + 1])
    block = far_part[kept][:, kept].toarray() - far_part[kept][:, rows].toarray() @ np.linalg.solve(
        far_part[rows][:, rows].toarray(), far_part[rows][:, kept].toarray()
    )  # the loose nodes of the far part follow
    place = sp.csr_matrix((np.ones(kept.size), (kept, np.arange(kept.size))), (MESH.nodes.size, kept.size))
    return parts[0] + place @ sp.csr_matrix(block) @ place.T


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
    for said in ("rod: 53 nodes, assembled matrices", "rod: 0.537", "3 rigid-body motions without stiffness",
                 "waves along x at 5439 m/s", "means over areas of faces"):  # fmt: skip
        assert said in out, out
    rom, run = folder / "rom.h5", folder / "run.h5"
    main_ends(["build", *words, "-o", str(rom)], 0)
    main_ends(["simulate", str(rom), "-o", str(run)], 0)
    main_ends(["simulate", *words, "--components", "-o", str(folder / "components.h5")], 0)
    out = capfd.readouterr().out
    assert "matrices do not tell" in out and "--full" not in out
    reduced, components = Trajectory.read(run), Trajectory.read(folder / "components.h5")
    known = components.outputs["slider_position"]
    np.testing.assert_allclose(reduced.outputs["slider_position"], known, atol=1e-6 * np.abs(known).max())


def main_ends(arguments: list[str], status: int) -> None:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == status


def case(command: str, *words: str, overrides: tuple[str, ...] = (), **given: str) -> tuple:
    return command, given, overrides, words


CASES = {
    # files
    "no file": case("check", "matrices.stiffness", "no such file", stiffness='"{folder}/none.mtx"'),
    "no nodes": case("check", "matrices.nodes", "no such file", nodes='"{folder}/none.inp"'),
    "no rows": case("check", "matrices.rows", "no such file", rows='"{folder}/none.txt"'),
    "directory": case("check", "matrices.mass", "this is a directory", mass='"{folder}"'),
    "nastran": case("check", "Nastran", "pyNastran", "Matrix Market", stiffness='"{folder}/punch.pch"'),
    "words": case("check", "no format that is known", stiffness='"{folder}/rod.inp"'),
    "size": case("check", "10 by 10 entries", "53 nodes", "106 displacements", stiffness='"{folder}/size.npz"'),
    "shells": case("check", "6 unknowns a node", "mesh the body here", mass='"{folder}/shell.npz"'),
    "other body": case("check", "rows of", "does not hold", stiffness='"{folder}/other.mtx"'),
    "few rows": case(
        "check", "106 rows, and the list of rows has 1", stiffness='"{folder}/held.npz"', rows='"{folder}/rows.txt"'
    ),
    # matrices
    "not symmetric": case("check", "not symmetric", "the other way round", stiffness='"{folder}/not symmetric.npz"'),
    "one triangle": case("check", "holds one triangle", "declare it symmetric", stiffness='"{folder}/triangle.npz"'),
    "boundary conditions": case("check", "are boundary conditions (1e+36)", stiffness='"{folder}/prescribed.npz"'),
    "grounded": case("check", "2 of 3 rigid-body motions are free", "supports", stiffness='"{folder}/held.npz"'),
    "pieces": case("check", "2 pieces that no stiffness joins", stiffness='"{folder}/pieces.npz"'),
    "a node without stiffness": case("check", "not positive: 1 of 106", "node 30, y", stiffness='"{folder}/empty node.npz"'),
    "preloaded": case("check", "not positive", "preload", stiffness='"{folder}/preloaded.npz"'),
    "a hinge inside": case("build", "bodies.rod: 4 motions are free of stiffness, and 3", "hinges", stiffness='"{folder}/hinged.npz"'),
    "mass that couples": case("check", "it ties x to y", "rotary inertia", mass='"{folder}/mass_coupled.npz"'),
    "mass along y": case("check", "along y it is another one", mass='"{folder}/mass_direction.npz"'),
    "negative mass": case("check", "not positive definite", mass='"{folder}/mass_negative.npz"'),
    "massless node": case("check", "not positive: 2 of 106", "lumped to all nodes", mass='"{folder}/mass_massless.npz"'),
    "stated mass": case("check", "matrices.stated.mass = 1.0: the matrices have 0.53", stated="{{mass=1.0}}"),
    "stated centre": case("check", "matrices.stated.centre", "differs by more", stated="{{centre=[0.0, 0.0]}}"),
    "stated inertia": case("check", "matrices.stated.inertia", "1 numbers are needed", stated="{{inertia=[1.0, 1.0, 1.0]}}"),
    # entries
    "no unit": case("check", "matrices.units.length", "no such unit", units='{{length="mmm"}}'),
    "unit of another kind": case("check", "matrices.units.mass", "a unit of a mass", units='{{mass="mm"}}'),
    "empty set": case("check", "matrices.faces.left", "name of a set", faces="{{left=[]}}"),
    "no set": case("check", 'matrices.faces.left = "lft"', "did you mean 'left'", faces='{{left="lft"}}'),
    "no point": case("check", "joints.slider.connect", "no set of this name", overrides=('joints.slider.connect=["ground:origin","rod:tip"]',)),
    "no node": case("check", "matrices.faces.left", "has no node 7", faces="{{left=[7, 10]}}"),
    "one node": case("check", "matrices.faces.left = [10]", "too small to carry a rotation", faces="{{left=[10]}}"),
    "scale": case("check", "matrices.stiffness_scale", "a positive number", stiffness_scale="-1.0"),
    "beam": case("check", "bodies.rod.matrices", "solid2d and solid3d", overrides=('bodies.rod.element="beam2d"',)),
    "material": case("check", "bodies.rod.material", "in the matrices already", overrides=('bodies.rod.material="steel"',)),
    "mesh too": case("check", "exactly one of mesh, line, matrices", overrides=('bodies.rod.mesh="rod.msh"',)),
    # what matrices do not tell
    "full order": case("simulate --full", "bodies.rod.matrices", "--components"),
    "trade-off": case("tradeoff", "bodies.rod.matrices", "--components"),
    "sizes of effects": case("check --effects", "third derivative", "bodies.rod.matrices"),
    "second order": case("build", "reduction.second_order = true", "bodies.rod.matrices", overrides=("reduction.second_order=true",)),
    "stiffening": case("build", "effects.s", "bodies.rod.matrices", overrides=('effects.s={type="geometric_stiffening"}',)),
    "stress": case("check", "outputs.s.body", "do not tell stresses", overrides=('outputs.s={type="stress",body="rod",quantity="von_mises"}',)),
    "field": case("check", "fields.f.body", "place by place", overrides=('fields.f={body="rod",quantity="E",variation=0.1,length=1.0,terms=1}',)),
    "named reference": case("build", 'reference.model = "mesh"', 'take "components"', overrides=("reduction.tolerance=0.01", 'reference.model="mesh"')),
}  # fmt: skip
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


def test_the_labels_of_the_files_are_no_places() -> None:
    assert labels_of(MESH)[0] != 1 and write_inp is not None
