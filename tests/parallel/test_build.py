"""The offline build is the same for any number of ranks and groups, and whatever signs and order the solver returns;
and so are the bodies of cells that it condenses."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import SCRIPTS, run_mpi

from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.reduction.cell_products import pair_rotations
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import scene_from_toml

# all cases of one number of ranks in one run: "name:ranks_per_group:seed of the scrambling"
RUNS = {
    "build.py": {
        1: "plain:1:0 plain:1:1 reflected:1:0 reflected:1:1 curved:1:0 curved:1:1 extended:1:0 extended:1:1 two:1:0 "
        "two:1:1 two_static:1:0 two_crossing:1:0",
        2: "plain:2:0 reflected:1:0 curved:2:0 extended:1:0 two:1:0 two_static:2:0 two_crossing:1:2",
        # of what two ranks have tried already, what groups of unequal size change
        5: "plain:2:5 reflected:1:4 curved:3:2 extended:2:3 two:3:0",
    },
    "solid_build.py": {
        1: "plane:1:0 plane:1:1 space:1:0 space:1:1", 2: "plane:2:0 space:2:0",
        3: "plane:1:2 space:2:0 space:3:2",
    },
}  # fmt: skip
SOLIDS = ("plane", "space")
CASES = [(n, case) for runs in RUNS.values() for n, cases in runs.items() for case in cases.split()
         if (n, case.split(":")[1:]) != (1, ["1", "0"])]  # fmt: skip
TABLES = ("mass", "inertia", "stiffness", "load")
COMPONENT_ERROR = 1e-10  # what the component modes promise of squares: stiffness, frequencies, inertia


@pytest.fixture(scope="module")
def model(folder: Path) -> Callable[[int, str], ReducedOrderModel]:
    """Return a function that gives the model of a case; the first one asked for builds all those of its ranks."""
    return cache(lambda n, case: built(folder, n, case))


def built(folder: Path, n: int, case: str) -> ReducedOrderModel:
    name, ranks_per_group, seed = case.split(":")
    script = "solid_build.py" if name in SOLIDS else "build.py"
    printed, path = folder / f"{script}_{n}.txt", folder / f"{name}_{n}_{ranks_per_group}_{seed}.h5"
    if not printed.exists():
        printed.write_text(run_mpi(n, SCRIPTS / script, folder, *RUNS[script][n].split()).stdout)
    assert path.exists(), printed.read_text()
    return ReducedOrderModel.read(path)


def shapes_of(rom: ReducedOrderModel) -> np.ndarray:
    """Return what the flexible vectors do to the bodies' meshes, shape (n_samples, n, n_modes).

    Internal coordinates have no meaning of their own: their products with fixed fields of the mesh have.
    """
    mechanism = Mechanism.from_scene(scene_from_toml(rom.record.scene_toml, "."), rom.meshes)

    return np.concatenate([body.probes.T @ rom.projection[:, body.dofs] for body in mechanism.bodies], axis=1)


@pytest.mark.parametrize(("n", "case"), CASES)
def test_frequencies_do_not_depend_on_ranks_and_signs(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, f"{case.split(':')[0]}:1:0"), model(n, case)
    # the solver's own tolerance is 1e-13 of the largest of the shifted and inverted values; round-off of the meshes'
    # stiffness, 1e-16 of its largest eigenvalue, is 1e-7 of the lowest one
    allowed = 1e-7 if case.startswith(SOLIDS) else 1e-9
    np.testing.assert_allclose(rom.frequencies_hz, expected.frequencies_hz, rtol=allowed)
    np.testing.assert_allclose(rom.cosines, expected.cosines, rtol=0, atol=1e-8)
    one, other = rom.tables.samples, expected.tables.samples
    np.testing.assert_array_equal(one.theta, other.theta)
    for axis, like in zip(one, other, strict=True):
        assert (axis.lower, axis.upper, axis.periodic) == (like.lower, like.upper, like.periodic)
    assert rom.n_redundant == expected.n_redundant
    assert rom.record.ranks == n


@pytest.mark.parametrize(("n", "case"), CASES)
def test_tables_are_the_same_but_for_one_constant_rotation(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, f"{case.split(':')[0]}:1:0"), model(n, case)
    for name in ("mass_weights", "stiffness_weights", "load_weights", "load_effects"):
        assert getattr(rom.tables, name) == getattr(expected.tables, name)
    solid, m = case.startswith(SOLIDS), rom.tables.n_modes
    one, other = ((shapes_of(each) if solid else each.projection) for each in (expected, rom))
    rotation = np.linalg.lstsq(other[0], one[0], rcond=None)[0]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(m), rtol=0, atol=1e-7 if solid else 1e-8)
    np.testing.assert_allclose(other @ rotation, one, rtol=0, atol=1e-7 * np.abs(one).max())
    tables = rom.tables.turned(np.broadcast_to(rotation, (rom.tables.samples.n, m, m)))
    assert_same(tables, expected.tables, TABLES, 1e-8)
    assert rom.points.points == expected.points.points
    np.testing.assert_allclose(rom.points.missed, expected.points.missed, rtol=0, atol=2e-6)
    assert (tables.second_order is not None) == (solid or case.startswith("curved"))
    if tables.second_order is None:
        assert rom.curvature is None
        return
    # linear in each of three shapes, whose error in the energy is the square root of that of a square
    allowed = 3.0 * np.sqrt(COMPONENT_ERROR) if solid else 1e-9
    assert_same(tables.second_order, expected.tables.second_order, ("cubic", "curved_load", "curved_inertia"), allowed)
    if not solid:
        curvature = rom.curvature @ pair_rotations(rotation[None])[0]
        np.testing.assert_allclose(curvature, expected.curvature, rtol=0, atol=1e-9 * np.abs(expected.curvature).max())


def assert_same(found: object, expected: object, names: tuple[str, ...], share: float) -> None:
    """Compare tables, each to a share of its largest entry."""
    for name in names:
        one = getattr(expected, name)
        allowed = share * np.abs(one).max(initial=0.0)
        np.testing.assert_allclose(getattr(found, name), one, rtol=0, atol=allowed, err_msg=name)


@pytest.mark.parametrize(("n", "case"), [(n, case) for n, case in CASES if case.startswith(SOLIDS)])
def test_the_condensed_bodies_do_not_depend_on_ranks(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, f"{case.split(':')[0]}:1:0"), model(n, case)
    for name, like in expected.meshes.items():
        body = rom.meshes[name]
        # how many vectors it takes may differ: on meshes as coarse as these the last ones are nearly combinations of
        # others
        assert (body.n_mesh_dofs, body.frames) == (like.n_mesh_dofs, like.frames)
        np.testing.assert_allclose(body.centres, like.centres, rtol=0, atol=1e-15)
        assert max(body.error, like.error) < COMPONENT_ERROR
        # internal coordinates may differ in their signs; what the frames feel and what the fields weigh may not
        frames = slice(0, like.n_frame_dofs)
        for kind in ("mass", "stiffness"):
            for weight, matrix in getattr(like, kind).items():
                other = getattr(body, kind)[weight]
                size = np.abs(matrix[frames, frames]).max()
                np.testing.assert_allclose(other[frames, frames], matrix[frames, frames], rtol=0, atol=1e-8 * size)
                weighed = like.fields.T @ matrix @ like.fields
                size = np.abs(weighed).max()
                np.testing.assert_allclose(body.fields.T @ other @ body.fields, weighed, rtol=0, atol=1e-8 * size)


@pytest.mark.parametrize(("n", "case"), [(n, case) for n, case in CASES if case.startswith("plain")])
def test_even_the_constant_rotation_is_the_identity_without_a_reflection(model: Callable, n: int, case: str) -> None:
    assert_same(model(n, case).tables, model(1, "plain:1:0").tables, TABLES, 1e-8)


def test_a_scene_with_a_reflection_has_two_turns(model: Callable) -> None:
    rom = model(1, "reflected:1:0")
    half = len(rom.projection) // 2
    assert (rom.tables.samples.n, rom.frequencies_hz.shape[0]) == (24, 12)
    signs = np.sum(rom.projection[:half] * rom.projection[half:], axis=(0, 1))
    assert np.sum(signs < 0) == 1
    np.testing.assert_array_equal(np.abs(rom.projection[:half]), np.abs(rom.projection[half:]))


SAID = {
    "fails": "RunError: eigenproblem at theta = 4.71239 rad: spoilt by the test",
    "refused": "InputError: reduction.modes = 31", "plain": "InputError: --ranks-per-angle = 5",
}  # fmt: skip


def test_bad_input_and_a_failure_of_one_group_are_those_of_all_ranks(folder: Path) -> None:
    cases = "refused:1:0", "fails:1:0", "fails:2:0", "refused:4:0", "plain:5:0"
    lines = run_mpi(4, SCRIPTS / "build.py", folder, *cases).stdout.splitlines()
    assert len(lines) == 4 * len(cases)
    for k, case in enumerate(cases):
        said = f"{case} {SAID[case.split(':')[0]]}"
        assert all(line.startswith(said) for line in lines[4 * k : 4 * k + 4]), lines
