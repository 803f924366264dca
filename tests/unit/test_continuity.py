"""Continuity of bases: Procrustes, signs, closing a revolution with and without a reflection, crossing, veering."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest
from scipy.linalg import expm

from pgmp_petsc.modes.continuity import Closure, canonical_rotation, procrustes
from pgmp_petsc.reduction.joining import JoinedSamples, join_arcs
from pgmp_petsc.reduction.sampler import ArcSamples
from pgmp_petsc.reduction.tables import Grid
from pgmp_petsc.runtime.groups import RankGroup

SIZES = (1, 2, 3, 6, 15)


def orthogonal(n: int, seed: int = 0, reflected: bool = False) -> np.ndarray:
    """Return a random orthogonal matrix with the determinant 1, or -1 if reflected."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))
    if (np.linalg.det(q) < 0) != reflected:
        q[:, 0] *= -1
    return q


def basis(n_rows: int, n_columns: int, seed: int = 0) -> np.ndarray:
    """Return a random orthonormal basis."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(n_rows, n_columns)))[0]


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("reflected", [False, True])
def test_procrustes_finds_the_rotation_within_a_space(n: int, reflected: bool) -> None:
    old, turn = basis(20, n), orthogonal(n, 1, reflected)
    rotation, cosine = procrustes((old @ turn).T @ old)
    np.testing.assert_allclose(rotation, turn.T, rtol=0, atol=1e-14)
    assert cosine == pytest.approx(1.0, abs=1e-14)


def test_procrustes_is_the_closest_of_all_rotations() -> None:
    old, new = basis(20, 4, 0), basis(20, 4, 1)
    rotation, cosine = procrustes(new.T @ old)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(4), rtol=0, atol=1e-14)
    best = np.linalg.norm(old - new @ rotation)
    for seed in range(20):
        other = rotation @ expm(0.1 * (skew := np.random.default_rng(seed).normal(size=(4, 4))) - 0.1 * skew.T)
        assert np.linalg.norm(old - new @ other) > best
    assert 0.0 <= cosine < 1.0


def test_the_cosine_is_that_of_the_largest_principal_angle() -> None:
    old = np.eye(5)[:, :2]
    angle = 0.3
    new = np.column_stack([old[:, 0], np.cos(angle) * old[:, 1] + np.sin(angle) * np.eye(5)[:, 2]])
    assert procrustes(new.T @ old)[1] == pytest.approx(np.cos(angle), rel=1e-14)


def test_canonical_signs_do_not_depend_on_the_solver() -> None:
    values, vectors, probe = np.array([1.0, 2.0, 3.0, 4.0]), basis(30, 4), basis(30, 4, 7)
    fixed = vectors @ canonical_rotation(values, vectors.T @ probe)
    spoilt = vectors * [1, -1, -1, 1]
    np.testing.assert_allclose(spoilt @ canonical_rotation(values, spoilt.T @ probe), fixed, rtol=0, atol=1e-14)
    assert np.all(np.diagonal(fixed.T @ probe) > 0)
    np.testing.assert_allclose(np.abs(np.sum(fixed * vectors, axis=0)), 1.0, rtol=1e-14)


def test_canonical_rotations_inside_clusters_do_not_depend_on_the_solver() -> None:
    values = np.array([1.0, 2.0, 2.0 + 1e-7, 2.0 + 2e-7, 4.0])
    vectors, probe = basis(30, 5), basis(30, 5, 7)
    spoilt = vectors.copy()
    spoilt[:, 1:4] = vectors[:, 1:4] @ orthogonal(3, 5, reflected=True)
    fixed = [v @ canonical_rotation(values, v.T @ probe) for v in (vectors, spoilt)]
    np.testing.assert_allclose(fixed[0], fixed[1], rtol=0, atol=1e-13)
    rotation = canonical_rotation(values, vectors.T @ probe)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(5), rtol=0, atol=1e-14)
    assert not np.any(rotation[0, 1:]) and not np.any(rotation[4, :4])


def holonomies() -> dict[str, np.ndarray]:
    """Return orthogonal matrices of every kind that a revolution can leave."""
    cases = {"one": np.eye(1), "identity": np.eye(4), "minus_one": -np.eye(1), "two_flips": np.diag([1.0, -1, 1, -1])}
    cases |= {"three_flips": -np.eye(3), "four_flips": -np.eye(4), "exchange": np.eye(3)[[1, 0, 2]]}
    cases["small_angle"] = expm(1e-9 * np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 0]]))
    cases["equal_angles"] = np.kron(np.eye(2), expm(0.7 * np.array([[0, 1.0], [-1, 0]])))
    turn = orthogonal(7, 9)
    cases["turned_flips"] = turn @ np.diag([1.0, -1, -1, -1, 1, 1, 1]) @ turn.T
    for n in SIZES:
        cases[f"rotation_{n}"] = orthogonal(n, n)
        cases[f"reflection_{n}"] = orthogonal(n, n, reflected=True)
    return cases


@pytest.mark.parametrize("name", holonomies())
def test_closing_takes_the_holonomy_back(name: str) -> None:
    holonomy = holonomies()[name]
    closure, n = Closure.of(holonomy), len(holonomy)
    assert (closure.flipped >= 0) == (np.linalg.det(holonomy) < 0)
    signs = np.ones(n)
    if closure.flipped >= 0:
        signs[closure.flipped] = -1.0
    # H R(1) = R(0) D: what follows the last sample is the first one again, but for one sign
    np.testing.assert_allclose(holonomy @ closure.rotation(1.0), closure.rotation(0.0) * signs, rtol=0, atol=1e-13)
    if closure.flipped < 0:
        np.testing.assert_allclose(closure.rotation(0.0), np.eye(n), rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", holonomies())
def test_closing_turns_evenly_and_no_further_than_half_a_turn(name: str) -> None:
    closure = Closure.of(holonomies()[name])
    steps = np.linspace(0.0, 1.0, 11)
    rotations = [closure.rotation(fraction) for fraction in steps]
    for rotation in rotations:
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(len(rotation)), rtol=0, atol=1e-13)
    changes = [before.T @ after for before, after in zip(rotations, rotations[1:])]
    for change in changes[1:]:
        np.testing.assert_allclose(change, changes[0], rtol=0, atol=1e-13)
    assert np.all(np.abs(closure.angles) <= np.pi * (1 + 1e-15))
    assert np.unique(closure.planes).size == closure.planes.size
    assert closure.flipped not in closure.planes


def transport(eigenbasis: Callable[[float], np.ndarray], theta: np.ndarray) -> np.ndarray:
    """Return bases at all theta, each turned to its neighbour as an eigensolver's user would."""
    random = np.random.default_rng(0)
    bases: list[np.ndarray] = []
    for value in theta:
        new = eigenbasis(value)
        new = new[:, random.permutation(new.shape[1])] * random.choice([-1.0, 1.0], new.shape[1])
        if bases:
            new = new @ procrustes(new.T @ bases[-1])[0]
        bases.append(new)
    return np.array(bases)


def test_modes_that_cross_exactly_keep_their_shapes() -> None:
    frame = orthogonal(4, 3)
    theta = np.linspace(-1.0, 1.0, 21)  # the crossing at 0 is a sample

    def lowest_two(value: float) -> np.ndarray:
        return np.linalg.eigh(frame @ np.diag([2 + value, 2 - value, 7.0, 9.0]) @ frame.T)[1][:, :2]

    bases = transport(lowest_two, theta)
    np.testing.assert_allclose(bases, np.broadcast_to(bases[0], bases.shape), rtol=0, atol=1e-13)


@pytest.mark.parametrize("gap", [1e-1, 1e-4, 1e-8])
def test_modes_that_veer_turn_no_faster_than_their_space(gap: float) -> None:
    frame = orthogonal(4, 3)
    theta = np.linspace(-1.0, 1.0, 201)

    def lowest_two(value: float) -> np.ndarray:
        matrix = np.diag([2 + value, 2 - value, 7.0, 9.0])
        matrix[0, 1] = matrix[1, 0] = gap
        slowly = expm(0.2 * value * (np.eye(4, k=2) - np.eye(4, k=-2)))
        return np.linalg.eigh(frame @ slowly @ matrix @ slowly.T @ frame.T)[1][:, :2]

    bases = transport(lowest_two, theta)
    # the space turns by 0.2 rad per unit of theta in two planes; single modes turn by pi/2 within the gap
    assert np.max(np.linalg.norm(np.diff(bases, axis=0), axis=(1, 2))) < 1.01 * 0.2 * 0.01 * np.sqrt(2)


def join(shapes: np.ndarray, n: int) -> JoinedSamples:
    """Join one arc of bases (n, n_rows, n_modes) with the unit mass matrix."""
    from mpi4py import MPI

    n_modes = shapes.shape[2]
    needed = {"shapes": shapes, "mass_first": shapes[0], "cosines": np.ones(n), "frequencies_hz": np.ones((n, n_modes))}
    others = {field.name: np.zeros((n, 1, 1, 1)) for field in fields(ArcSamples) if field.name not in needed}
    grid = Grid.over(0.0, 2 * np.pi, n, periodic=True)
    return join_arcs(RankGroup.split(MPI.COMM_SELF, 1), grid, ArcSamples(**needed, **others))


def moebius(value: float) -> np.ndarray:
    """Return the lowest mode of a family of period 2 pi, whose direction turns by half a turn."""
    direction = np.array([np.cos(value / 2), np.sin(value / 2), 0.0])
    matrix = np.diag([5.0, 5.0, 9.0]) - 3.0 * np.outer(direction, direction)
    return np.linalg.eigh(matrix)[1][:, :1]


def test_a_moebius_family_closes_after_two_turns() -> None:
    n = 48
    bases = transport(moebius, 2 * np.pi / n * np.arange(n))
    joined = join(bases, n)
    assert joined.flipped == 0
    shapes = bases @ joined.rotations
    two_turns = np.concatenate([shapes, -shapes, shapes[:1]])
    jumps = np.linalg.norm(np.diff(two_turns, axis=0), axis=(1, 2))
    # even steps, also across both ends of a turn: the chord of half the step
    np.testing.assert_allclose(jumps, 2 * np.sin(np.pi / n / 2), rtol=1e-12)


@pytest.mark.parametrize("n_moebius", [1, 2, 3])
def test_pairs_of_reflections_close_after_one_turn(n_moebius: int) -> None:
    n, turn = 60, orthogonal(3 * n_moebius, 4)

    def modes(value: float) -> np.ndarray:
        return turn @ np.kron(np.eye(n_moebius), moebius(value))

    bases = transport(modes, 2 * np.pi / n * np.arange(n))
    joined = join(bases, n)
    assert (joined.flipped >= 0) == (n_moebius % 2 == 1)
    shapes = bases @ joined.rotations
    signs = np.ones(n_moebius)
    if joined.flipped >= 0:
        signs[joined.flipped] = -1.0
    jumps = np.linalg.norm(np.diff(np.concatenate([shapes, shapes[:1] * signs]), axis=0), axis=(1, 2))
    # each mode turns by half the step, and the closure turns a pair by as much again
    assert jumps.max() < 1.5 * np.sqrt(n_moebius) * np.pi / n
    # this one arc's own cosines are given; the first compares with the last sample of the turn
    assert joined.samples.cosines[0] == pytest.approx(np.cos(np.pi / n), rel=1e-12)
