"""Tables of second order: packed pairs, other bases, two revolutions."""

import numpy as np
import pytest
from frames import pair_products
from mpi4py import MPI

from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.cell_products import pair_rotations, unpacked
from pgmp_petsc.reduction.tables import ReducedTables, SecondOrderTables
from scenes import meshes_of, slider_crank

N, M = 6, 4


@pytest.fixture(scope="module")
def tables() -> ReducedTables:
    moved = 'effects.motor={type="prescribed_motion",coordinate="theta",constant_speed={speed=1.0}}'
    more = ("reduction.second_order=true", 'effects.weight={type="gravity"}', moved)
    scene = slider_crank(f"reduction.modes={M}", f"reduction.angles={N}", *more)
    return build_rom(scene, meshes_of(scene), RankGroup.split(MPI.COMM_SELF, 1)).tables


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
    """Return all tables."""
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
    twice = tables.over_two_turns(np.array([2])).second_order
    signs = np.array([1, 1, -1, 1])
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
