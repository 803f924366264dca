"""The reduced-order model: its tables are projections, its file comes back, and every damaged file is refused."""

import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from frames import pair_products
from offset_scenes import clamped_beam, offset
from refusals import refusal
from runs import rom_of
from sealed import resealed
from solid_scenes import solid_meshes, solid_slider_crank
from synthetic import assert_same
from two_coordinates import double_pendulum, over

from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects import effects_of, loads_of
from pgmp_petsc.mechanism.mechanism import constraint_jacobian, linear_motion, rigid_velocities, to_body
from pgmp_petsc.reduction.cell_products import pair_rotations, unpacked
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.tables import ReducedTables, SecondOrderTables
from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import four_bar, kinematics_of, slider_crank, trammel

GRAVITY = 'effects.weight={type="gravity"}'
SCENE = slider_crank("reduction.modes=3", "reduction.angles=8", GRAVITY)
PART = (
    "reduction.angles=9", "coordinates.theta.range=[0.2,1.4]", "coordinates.theta.periodic=false",
    "simulation.initial.theta.position=0.2",
)  # fmt: skip
BUILD_AGAIN = "build it again with pgmp build"
TABLES = "mass", "stiffness", "load", "inertia"
CURVED = "curvature", *(f"tables/second_order/{name}" for name in ("cubic", "curved_load", "curved_inertia"))
PARTS = "tables", "theta", "projection", "frequencies_hz", "cosines", "mesh", "mesh/crank/nodes"


@pytest.fixture(scope="module")
def rom() -> ReducedOrderModel:
    return rom_of(SCENE)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return the file of a model that has all tables."""
    rom_of(KEPT["second order"][0]).write(tmp_path / "rom.h5")
    return tmp_path / "rom.h5"


STATIC = ("reduction.static_modes=true", "reduction.inertia_modes=true")
TWO = over(double_pendulum(*STATIC, GRAVITY, 'reduction.interpolation="spline"'), (6, 10))


@pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")  # of a number of angles for each coordinate
@pytest.mark.parametrize(("scene", "every"), [(SCENE, 1), (TWO, 7)], ids=["one coordinate", "two coordinates"])
def test_every_table_is_the_projection_of_its_term(scene: Scene, every: int) -> None:
    """Weights of the bodies turn in their frames; inertia is that of the accelerations at constant rates."""
    rom, kinematics = rom_of(scene), kinematics_of(scene)
    mechanism, tables = kinematics.mechanism, rom.tables
    matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
    loads = loads_of(effects_of(scene, mechanism), matrices)
    assert tables.load_weights == tuple(load.weight for load in loads)
    assert tables.load_effects == tuple(load.effect for load in loads) == ("motor", "weight", "weight")[: len(loads)]
    assert tables.mass_weights == mechanism.mass_weights
    for k in range(0, tables.samples.n, every):
        theta = tables.samples.theta[k]
        poses = kinematics.poses(theta)
        rigid = rigid_velocities(mechanism, poses[..., 0], kinematics.rates(poses)[..., 0])
        bent = linear_motion(mechanism, kinematics.motion(theta).accelerations)
        flexible = rom.projection[k]
        basis = np.hstack([rigid, flexible])
        for i, weight in enumerate(tables.mass_weights):
            for found, expected in (
                (tables.mass[k, i], basis.T @ (matrices.mass[weight] @ basis)),
                (tables.inertia[k, i], np.einsum("dkl,de->kle", bent, matrices.mass[weight] @ flexible)),
            ):
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
        for i, weight in enumerate(tables.stiffness_weights):
            size = np.abs(matrices.stiffness[weight].data).max() * np.abs(flexible).max() ** 2
            expected = flexible.T @ matrices.stiffness[weight] @ flexible
            np.testing.assert_allclose(tables.stiffness[k, i], expected, rtol=0, atol=1e-12 * size)
        for j, load in enumerate(loads):
            expected = to_body(mechanism, poses[..., 0], load.vector) @ basis
            np.testing.assert_allclose(tables.load[k, j], expected, rtol=0, atol=1e-13 * np.abs(load.vector).max() * 10)


def test_the_basis_obeys_the_constraints_and_is_orthonormal(rom: ReducedOrderModel) -> None:
    kinematics = kinematics_of(SCENE)
    values = {"r1": 5.6e-3}
    for k, theta in enumerate(rom.tables.samples.axes[0].theta):
        constraints = constraint_jacobian(kinematics.mechanism, kinematics.poses(np.array([theta]))[..., 0])
        np.testing.assert_allclose(constraints @ rom.projection[k], 0.0, rtol=0, atol=1e-12)
        mass = sum(m.evaluate(values) * table for m, table in zip(rom.tables.mass_weights, rom.tables.mass[k]))
        stiffness = sum(
            m.evaluate(values) * table for m, table in zip(rom.tables.stiffness_weights, rom.tables.stiffness[k])
        )
        np.testing.assert_allclose(mass[1:, 1:], np.eye(3), rtol=0, atol=1e-9)
        np.testing.assert_allclose(mass[0, 1:], 0.0, rtol=0, atol=1e-9)
        frequencies = np.sqrt(np.linalg.eigvalsh(stiffness)) / (2 * np.pi)
        np.testing.assert_allclose(frequencies, rom.frequencies_hz[k], rtol=1e-8)


@pytest.mark.parametrize(("scene", "n_turns"), [(slider_crank, 1), (four_bar, 2)], ids=["slider-crank", "four-bar"])
def test_where_a_revolution_begins_does_not_matter(scene: Callable[..., Scene], n_turns: int) -> None:
    """The basis closes as smoothly as it goes on elsewhere: another first angle gives the same, but for a rotation."""
    n, shift = 24, 7
    lower = 2 * np.pi * shift / n
    first = rom_of(scene())
    second = rom_of(scene(f"coordinates.theta.range=[{lower},{lower + 2 * np.pi}]"))
    assert first.tables.samples.n == second.tables.samples.n == n_turns * n
    np.testing.assert_allclose(second.frequencies_hz, np.roll(first.frequencies_hz, -shift, axis=0), rtol=1e-9)
    rolled = np.roll(first.projection, -shift, axis=0)
    rotation = np.linalg.lstsq(second.projection[0], rolled[0], rcond=None)[0]
    m = len(rotation)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(m), rtol=0, atol=1e-8)
    np.testing.assert_allclose(second.projection @ rotation, rolled, rtol=0, atol=1e-7 * np.abs(rolled).max())
    tables = second.tables.turned(np.broadcast_to(rotation, (n_turns * n, m, m)))
    for name in ("mass", "inertia", "stiffness", "load"):
        expected = np.roll(getattr(first.tables, name), -shift, axis=0)
        size = np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(getattr(tables, name), expected, rtol=0, atol=1e-8 * size, err_msg=name)


UNCERTAIN = 'parameters.r1={nominal=5.6e-3, distribution={name="norm", loc=5.6e-3, scale=5.6e-4}}'
CARRIED = (
    'outputs.pin={type="joint_force", joint="elbow", component="x"}',
    'outputs.worst={type="stress", body="rod", quantity="stress_max"}',
)
CELLS = 'outputs.worst={type="stress", body="rod", quantity="von_mises"}'
#: Models whose files come back, with what they have: a reflection and thus two turns, of second order; no effects, and
#: bodies in another order; Chebyshev points and static modes; joints that are off; bodies of cells, with their meshes.
KEPT = {
    "plain": (SCENE, None),
    "second order": (four_bar(GRAVITY, "reduction.second_order=true"), None),
    "no effects": (trammel("reduction.angles=4", "reduction.modes=2"), None),
    "part of a turn": (
        slider_crank(*PART, GRAVITY, "reduction.static_modes=true", 'reduction.interpolation="spectral"'),
        None,
    ),
    "forces and stresses": (slider_crank("reduction.modes=3", "reduction.angles=8", UNCERTAIN, *CARRIED), None),
    "offsets": (clamped_beam(offset("right", place=[1e-5, "d"], turn=[1e-4]), "parameters.d={nominal=1e-5}"), None),
    "cells": (
        solid_slider_crank("reduction={modes=3, angles=6, parameter_modes=0, second_order=true}", CELLS),
        solid_meshes(n_per_metre=10),
    ),
}


@pytest.mark.parametrize("name", KEPT)
def test_a_file_comes_back(name: str, tmp_path: Path) -> None:
    scene, meshes = KEPT[name]
    rom = rom_of(scene, meshes=meshes)
    rom.write(tmp_path / "rom.h5")
    back = ReducedOrderModel.read(tmp_path / "rom.h5")
    assert_same(back, rom)
    assert back.identity == rom.identity and scene_from_toml(back.record.scene_toml, scene.directory) == scene
    tables, axis = back.tables, back.tables.samples.axes[0]
    assert (back.curvature is None) == (tables.second_order is None) == (name not in ("second order", "cells"))
    assert (back.missed is None, back.gaps is None) == (name != "forces and stresses",) * 2
    assert tables.n_given == 2 * (name == "offsets")
    if name == "plain":
        with h5py.File(tmp_path / "rom.h5") as file:
            assert "curvature" not in file and set(file["tables"]) == {*TABLES, "rigid"}
    elif name == "second order":
        n, n_dofs, m = back.projection.shape
        assert back.curvature.shape == (n, n_dofs, m * (m + 1) // 2)
    elif name == "no effects":
        # what is redundant between rigid bodies is not between flexible ones: the crank holds the rod's middle
        assert back.n_redundant == 0 and list(back.meshes) == ["rod", "crank"]
        assert tables.load.shape == (tables.samples.n, 0, 3) and tables.load_effects == tables.load_weights == ()
    elif name == "part of a turn":
        # five load patterns: the motor, and the weight of each body along both axes of its frame
        assert (tables.n_modes, back.frequencies_hz.shape) == (5 + 5, (9, 5))
        assert axis.theta[[0, -1]].tolist() == [0.2, 1.4] and not axis.is_uniform


def remove(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]

    return change


def shorten(name: str) -> Callable[[h5py.File], None]:
    """Return a change that drops the last configuration of a table."""

    def change(file: h5py.File) -> None:
        data, attributes = file[name][:-1], dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, data=data).attrs.update(attributes)

    return change


DAMAGE = {
    "no mesh of a body": (remove("mesh/crank"), "has no mesh/crank, a body of its scene; build it again"),
    "fewer weights than terms": (lambda file: file["tables/mass"].attrs.__setitem__("weights", ["1", "r1^2"]), ""),
    **{f"shorter {name}": (shorten(name), "has shape") for name in (*(f"tables/{one}" for one in TABLES), *CURVED)},
    **{
        f"no {name}": (remove(name), f"missing|{BUILD_AGAIN}")
        for name in (*(f"tables/{name}" for name in TABLES), *PARTS, *CURVED)
    },
    **{
        f"samples without {name}": (lambda file, name=name: file["theta"].attrs.__delitem__(name), BUILD_AGAIN)
        for name in ("lower", "upper", "periodic")
    },
}
#: Of other models, what is shortened and what is said.
BESIDE = {
    "forces and stresses": ("missed/answers", "'/missed': answers has shape .*; build it again"),
    "cells": ("mesh/rod/recovery/shapes", "'/mesh/rod/recovery': recovery has shapes .*; build"),
}


@pytest.mark.parametrize("name", [*DAMAGE, *BESIDE])
def test_a_damaged_file_is_refused(path: Path, name: str) -> None:
    if name in BESIDE:
        place, said = BESIDE[name]
        rom_of(KEPT[name][0], meshes=KEPT[name][1]).write(path)
    with resealed(path) as file:
        damage, said = (shorten(place), said) if name in BESIDE else DAMAGE[name]
        damage(file)
    message = refusal(ReducedOrderModel.read, path)
    assert re.search(said, message) and str(path) in message


@pytest.fixture(scope="module")
def curved() -> ReducedOrderModel:
    """Return a model with tables of second order, a reflection and thus two turns."""
    return rom_of(KEPT["second order"][0])


def test_on_the_second_turn_the_curvature_is_that_of_the_flipped_modes(curved: ReducedOrderModel) -> None:
    n, m = curved.tables.samples.n // 2, curved.tables.n_modes
    assert curved.tables.samples.axes[0].upper == pytest.approx(4 * np.pi)
    signs = np.sign(np.sum(curved.projection[:n] * curved.projection[n:], axis=(0, 1)))
    assert np.sum(signs < 0) == 1
    i, j = np.tril_indices(m)
    np.testing.assert_array_equal(curved.curvature[n:], curved.curvature[:n] * (signs[i] * signs[j]))


N, M = 6, 4


@pytest.fixture(scope="module")
def tables() -> ReducedTables:
    moved = 'effects.motor={type="prescribed_motion",coordinate="theta",constant_speed={speed=1.0}}'
    more = ("reduction.second_order=true", 'effects.weight={type="gravity"}', moved)
    scene = slider_crank(f"reduction.modes={M}", f"reduction.angles={N}", *more)
    return rom_of(scene).tables


@pytest.fixture(scope="module")
def turn() -> np.ndarray:
    """Return random orthogonal matrices, shape (N, M, M)."""
    return np.linalg.qr(np.random.default_rng(0).normal(size=(N, M, M)))[0]


def forms(tables: SecondOrderTables, delta: np.ndarray) -> list[np.ndarray]:
    """Return the values of the forms for delta of shape (N, M)."""
    return [
        np.einsum("ntijk,ni,nj,nk->nt", tables.cubic, delta, delta, delta),
        np.einsum("ntij,ni,nj->nt", tables.curved_load, delta, delta),
        *(np.einsum("ntpij,ni,nj->ntp", part, delta, delta) for part in (tables.curved_inertia, tables.curved_mass)),
    ]


def arrays(tables: SecondOrderTables) -> tuple[np.ndarray, ...]:
    return tables.cubic, tables.curved_load, tables.curved_inertia, tables.curved_mass


def test_shapes_and_exact_symmetry(tables: ReducedTables) -> None:
    cubic, load, inertia, mass = arrays(tables.second_order)
    assert (cubic.shape, load.shape) == ((N, 3, M, M, M), (N, 2, M, M))
    assert inertia.shape == mass.shape == (N, 3, 1, M, M)
    for order in ((0, 1, 3, 2, 4), (0, 1, 4, 3, 2), (0, 1, 3, 4, 2)):
        np.testing.assert_array_equal(cubic, cubic.transpose(order))
    for table in (load, inertia, mass):
        np.testing.assert_array_equal(table, np.swapaxes(table, -1, -2))
    rows = np.array([4, 1])
    for found, expected in zip(arrays(tables.at(rows).second_order), arrays(tables.second_order)):
        np.testing.assert_array_equal(found, expected[rows])


def test_what_the_forms_say_does_not_depend_on_the_basis(tables: ReducedTables, turn: np.ndarray) -> None:
    turned = tables.turned(turn).second_order
    delta = np.random.default_rng(1).normal(size=(N, M))
    in_new = np.einsum("nij,ni->nj", turn, delta)
    for found, expected in zip(forms(turned, in_new), forms(tables.second_order, delta)):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    cubic = turned.cubic
    np.testing.assert_array_equal(cubic, cubic.transpose(0, 1, 4, 2, 3))
    back = tables.turned(turn).turned(np.swapaxes(turn, 1, 2)).second_order
    for found, expected in zip(arrays(back), arrays(tables.second_order)):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_the_second_turn_has_the_signs_of_its_coordinates(tables: ReducedTables) -> None:
    signs = np.array([1, 1, -1, 1])
    twice = tables.samples.doubled(0, tables.second_order, signs)
    for found, expected in zip(arrays(twice), arrays(tables.second_order)):
        factor = signs[:, None] * signs
        if found is twice.cubic:
            factor = factor[:, :, None] * signs
        np.testing.assert_array_equal(found[:N], expected)
        np.testing.assert_allclose(found[N:], expected * factor, rtol=1e-14)


def test_packed_pairs(turn: np.ndarray) -> None:
    random = np.random.default_rng(2)
    chi = random.normal(size=(N, 5, M, M))
    chi = chi + np.swapaxes(chi, 2, 3)
    i, j = np.tril_indices(M)
    packed, delta = chi[..., i, j], random.normal(size=(N, M))
    np.testing.assert_array_equal(unpacked(packed), chi)
    expected = 0.5 * np.einsum("ndij,ni,nj->nd", chi, delta, delta)
    np.testing.assert_allclose(np.einsum("ndp,np->nd", packed, pair_products(delta)), expected, rtol=0, atol=1e-13)
    turned = np.einsum("ndij,nia,njb->ndab", chi, turn, turn)
    np.testing.assert_allclose(packed @ pair_rotations(turn), turned[..., i, j], rtol=0, atol=1e-13)
