"""Solid bodies: condensing them and building from them is the same for any number of ranks and groups."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from test_build import built

from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import scene_from_toml

# all cases of one number of ranks in one run: "name:ranks_per_group:seed of the scrambling"
RUNS = {
    1: ("plane:1:0", "plane:1:1", "space:1:0", "space:1:1"),
    2: ("plane:1:0", "plane:2:0", "space:2:0"),
    3: ("plane:1:2", "space:2:0", "space:3:2"),
}
COMPONENT_ERROR = 1e-10  # what the component modes promise of squares: stiffness, frequencies, inertia
CASES = [(n, case) for n, cases in RUNS.items() for case in cases if (n, case.split(":")[1:]) != (1, ["1", "0"])]


@pytest.fixture(scope="module")
def model(mpirun: Callable, parallel_scripts: Path, folder: Path) -> Callable[[int, str], ReducedOrderModel]:
    """Return a function that gives the model of a case; the first one asked for builds all those of its ranks."""
    return cache(lambda n, case: built(mpirun, parallel_scripts / "solid_build.py", folder, RUNS, n, case))


def shapes_of(rom: ReducedOrderModel) -> np.ndarray:
    """Return what the flexible vectors do to the bodies' meshes, shape (n_samples, n, n_modes).

    Internal coordinates have no meaning of their own: their products with fixed fields of the mesh have.
    """
    mechanism = Mechanism.from_scene(scene_from_toml(rom.record.scene_toml, "."), rom.meshes)
    return np.concatenate([body.probes.T @ rom.projection[:, body.dofs] for body in mechanism.bodies], axis=1)


@pytest.mark.parametrize(("n", "case"), CASES)
def test_the_condensed_bodies_do_not_depend_on_ranks(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, f"{case.split(':')[0]}:1:0"), model(n, case)
    assert rom.record.ranks == n
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


@pytest.mark.parametrize(("n", "case"), CASES)
def test_frequencies_do_not_depend_on_ranks(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, f"{case.split(':')[0]}:1:0"), model(n, case)
    # round-off of the meshes' stiffness: 1e-16 of its largest eigenvalue is 1e-7 of the lowest one
    np.testing.assert_allclose(rom.frequencies_hz, expected.frequencies_hz, rtol=1e-7)
    np.testing.assert_allclose(rom.cosines, expected.cosines, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(rom.tables.samples.theta, expected.tables.samples.theta)
    assert rom.n_redundant == expected.n_redundant


@pytest.mark.parametrize(("n", "case"), CASES)
def test_tables_are_the_same_but_for_one_constant_rotation(model: Callable, n: int, case: str) -> None:
    expected, rom = model(1, f"{case.split(':')[0]}:1:0"), model(n, case)
    for name in ("mass_weights", "stiffness_weights", "load_weights", "load_effects"):
        assert getattr(rom.tables, name) == getattr(expected.tables, name)
    one, other = (shapes_of(model) for model in (expected, rom))
    rotation = np.linalg.lstsq(other[0], one[0], rcond=None)[0]
    m = rom.tables.n_modes
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(m), rtol=0, atol=1e-7)
    tables = rom.tables.turned(np.broadcast_to(rotation, (rom.tables.samples.n, m, m)))
    for name in ("mass", "inertia", "stiffness", "load"):
        table = getattr(expected.tables, name)
        size = np.abs(table).max(initial=0.0)
        np.testing.assert_allclose(getattr(tables, name), table, rtol=0, atol=1e-8 * size, err_msg=name)
    for name in ("cubic", "curved_load", "curved_inertia"):
        table = getattr(expected.tables.second_order, name)
        found = getattr(tables.second_order, name)
        # linear in each of three shapes, whose error in the energy is the square root of that of a square
        atol = 3.0 * np.sqrt(COMPONENT_ERROR) * np.abs(table).max()
        np.testing.assert_allclose(found, table, rtol=0, atol=atol, err_msg=name)
    np.testing.assert_allclose(other @ rotation, one, rtol=0, atol=1e-7 * np.abs(one).max())
