"""Reduced tables: other bases, two revolutions, frequencies."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.tables import ReducedTables
from scenes import meshes_of, slider_crank

RADIUS = {"r1": np.array([5.6e-3])}


@pytest.fixture(scope="module")
def tables() -> ReducedTables:
    """Return the tables of a small build: all of them, whatever tables there are."""
    from mpi4py import MPI

    scene = slider_crank("reduction.modes=4", "reduction.angles=12")
    return build_rom(scene, meshes_of(scene), RankGroup.split(MPI.COMM_SELF, 1)).tables


def rotations(n: int, m: int, seed: int = 0) -> np.ndarray:
    """Return n random orthogonal matrices."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(n, m, m)))[0]


def test_numbers_of_coordinates(tables: ReducedTables) -> None:
    assert (tables.n_coordinates, tables.n_modes, tables.samples.n) == (1, 4, 12)
    assert tables.mass.shape == (12, 3, 5, 5) and tables.stiffness.shape == (12, 3, 4, 4)
    assert tables.load.shape == (12, 1, 5)


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
    for table in (turned.mass, turned.stiffness):
        np.testing.assert_array_equal(table, np.swapaxes(table, -1, -2))
    assert turned.samples is tables.samples and turned.mass_weights == tables.mass_weights


def test_frequencies_do_not_depend_on_the_basis(tables: ReducedTables) -> None:
    weights = [evaluate_weights(w, RADIUS)[:, 0] for w in (tables.mass_weights, tables.stiffness_weights)]
    frequencies = tables.frequencies_hz(*weights)
    np.testing.assert_allclose(tables.turned(rotations(12, 4)).frequencies_hz(*weights), frequencies, rtol=1e-10)


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
    np.testing.assert_array_equal(twice.mass[:12], tables.mass)
    np.testing.assert_array_equal(twice.stiffness[:12], tables.stiffness)
    np.testing.assert_array_equal(twice.load[:12], tables.load)
    np.testing.assert_array_equal(twice.inertia[:12], tables.inertia)
    np.testing.assert_allclose(twice.mass[12:], tables.mass * np.outer(eta_signs, eta_signs), rtol=1e-15)
    np.testing.assert_allclose(twice.stiffness[12:], tables.stiffness * np.outer(signs, signs), rtol=1e-15)
    np.testing.assert_allclose(twice.load[12:], tables.load * eta_signs, rtol=1e-15)
    np.testing.assert_allclose(twice.inertia[12:], tables.inertia * signs, rtol=1e-15)
    for value in (getattr(twice, name) for name in ("mass", "inertia", "stiffness", "load")):
        assert len(value) == twice.samples.n


def test_a_table_that_changes_its_sign_is_continuous_over_two_turns(tables: ReducedTables) -> None:
    # the last flexible coordinate is a half wave over a turn: what couples to it changes its sign, the rest does not
    theta = tables.samples.axes[0].theta
    mass, load = np.zeros_like(tables.mass), np.zeros_like(tables.load)
    mass[:, 0] = np.eye(5)
    mass[:, 0, 1, 4] = mass[:, 0, 4, 1] = 0.3 * np.cos(theta / 2)
    load[:, 0, 0], load[:, 0, 4] = np.cos(theta), np.sin(theta / 2)
    twice = replace(tables, mass=mass, load=load).over_two_turns(np.array([3]))
    long = np.linspace(0.0, 8 * np.pi, 200)
    # the error of Overhauser's interpolant, of third order in the step, 0.52: 1/60 of a wave's cube for the half wave
    half_wave = interpolant(twice.samples.axes[0], twice.load, "overhauser")(long)[:, 0]
    np.testing.assert_allclose(half_wave[:, 4], np.sin(long / 2), rtol=0, atol=1e-3)
    np.testing.assert_allclose(half_wave[:, 0], np.cos(long), rtol=0, atol=6e-3)
    coupling = interpolant(twice.samples.axes[0], twice.mass, "overhauser")(long)[:, 0, 1, 4]
    np.testing.assert_allclose(coupling, 0.3 * np.cos(long / 2), rtol=0, atol=1e-3)


def test_turning_the_inertia_table(tables: ReducedTables) -> None:
    turn = rotations(12, 4)
    expected = np.einsum("ntabi,nij->ntabj", tables.inertia, turn)
    size = np.abs(tables.inertia).max()
    np.testing.assert_allclose(tables.turned(turn).inertia, expected, rtol=0, atol=1e-14 * size)
