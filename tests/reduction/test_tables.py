"""Reduced tables: other bases, two revolutions, frequencies."""

import numpy as np
import pytest
import scipy.linalg
from mpi4py import MPI

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.tables import ReducedTables
from scenes import meshes_of, slider_crank


@pytest.fixture(scope="module")
def tables() -> ReducedTables:
    """Return the tables of a small build: all of them, whatever tables there are."""
    scene = slider_crank("reduction.modes=4", "reduction.angles=12")
    return build_rom(scene, meshes_of(scene), RankGroup.split(MPI.COMM_SELF, 1)).tables


def rotations(n: int, m: int, seed: int = 0) -> np.ndarray:
    """Return n random orthogonal matrices."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(n, m, m)))[0]


def test_another_basis_is_a_congruence(tables: ReducedTables) -> None:
    turn = rotations(12, 4)
    turned = tables.turned(turn)
    for k in range(12):
        whole = scipy.linalg.block_diag(np.eye(1), turn[k])
        for i in range(3):
            np.testing.assert_allclose(turned.mass[k, i], whole.T @ tables.mass[k, i] @ whole, rtol=1e-12, atol=1e-14)
            largest = np.abs(tables.stiffness[k, i]).max()
            expected = turn[k].T @ tables.stiffness[k, i] @ turn[k]
            np.testing.assert_allclose(turned.stiffness[k, i], expected, rtol=0, atol=1e-13 * largest)
        np.testing.assert_allclose(turned.load[k], tables.load[k] @ whole, rtol=0, atol=1e-12)
    expected, size = np.einsum("ntabi,nij->ntabj", tables.inertia, turn), np.abs(tables.inertia).max()
    np.testing.assert_allclose(turned.inertia, expected, rtol=0, atol=1e-14 * size)
    for table in (turned.mass, turned.stiffness):
        np.testing.assert_array_equal(table, np.swapaxes(table, -1, -2))
    assert turned.samples is tables.samples and turned.mass_weights == tables.mass_weights


def test_frequencies_are_those_of_the_dense_pencil(tables: ReducedTables) -> None:
    values = {"r1": np.array([7.0e-3])}  # away from the nominal radius, where the modes are coupled
    mass_weights, stiffness_weights = (
        evaluate_weights(w, values)[:, 0] for w in (tables.mass_weights, tables.stiffness_weights)
    )
    frequencies = tables.frequencies_hz(mass_weights, stiffness_weights)
    for k in range(12):
        mass = np.tensordot(mass_weights, tables.mass[k], axes=1)
        flexible = np.tensordot(stiffness_weights, tables.stiffness[k], axes=1)
        stiffness = scipy.linalg.block_diag(np.zeros((1, 1)), flexible)
        squares = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
        # the zero of the rigid motion, up to round-off of the largest
        assert abs(squares[0]) < 1e-12 * squares[-1]
        np.testing.assert_allclose(frequencies[k], np.sqrt(squares[1:]) / (2 * np.pi), rtol=1e-9)


def test_the_second_turn_has_one_sign_changed(tables: ReducedTables) -> None:
    twice = tables.over_two_turns(np.array([2]))
    (turns,) = twice.samples
    assert (twice.samples.n, turns.lower, turns.periodic) == (24, tables.samples.axes[0].lower, True)
    assert turns.upper == pytest.approx(4 * np.pi, rel=1e-15)
    np.testing.assert_allclose(twice.samples.axes[0].theta, np.arange(24) * np.pi / 6, rtol=0, atol=1e-14)
    signs = np.array([1, 1, -1, 1])
    eta_signs = np.array([1, 1, 1, -1, 1])
    both = {"mass": np.outer(eta_signs, eta_signs), "stiffness": np.outer(signs, signs)}
    for name, factor in (both | {"load": eta_signs, "inertia": signs}).items():
        found, once = getattr(twice, name), getattr(tables, name)
        np.testing.assert_array_equal(found[:12], once)
        np.testing.assert_allclose(found[12:], once * factor, rtol=1e-15)
