"""Continuity of bases: Procrustes, signs, closing a revolution with and without a reflection, crossing, veering."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from pgmp_petsc.modes.continuity import (
    CLOSE_TOLERANCE,
    EXCHANGE,
    VEERING,
    Closure,
    by_groups,
    canonical_rotation,
    close_revolution,
    group_modes,
    procrustes,
    transport,
)

SIZES = (1, 2, 3, 6, 15)


def orthogonal(n: int, seed: int = 0, reflected: bool = False) -> np.ndarray:
    """Return a random orthogonal matrix with the determinant 1, or -1 if reflected."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))
    if (np.linalg.det(q) < 0) != reflected:
        q[:, 0] *= -1
    return q


def basis(n_rows: int, n_columns: int, seed: int = 0) -> np.ndarray:
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
    # that of the largest principal angle
    turned = np.column_stack([np.eye(5)[:, 0], np.cos(0.3) * np.eye(5)[:, 1] + np.sin(0.3) * np.eye(5)[:, 2]])
    assert procrustes(turned.T @ np.eye(5)[:, :2])[1] == pytest.approx(np.cos(0.3), rel=1e-14)


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
    # those of single modes make the products with the probe positive
    signs = np.array([-1.0, 1.0, 1.0, 1.0, -1.0])
    other = (vectors * signs) @ canonical_rotation(values, (vectors * signs).T @ probe)
    np.testing.assert_allclose(other, fixed[0], rtol=0, atol=1e-13)
    assert np.all(np.diagonal(fixed[0].T @ probe)[[0, 4]] > 0)


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
    first, last = closure.rotations(np.array([0.0, 1.0]))
    np.testing.assert_allclose(holonomy @ last, first * signs, rtol=0, atol=1e-13)
    if closure.flipped < 0:
        np.testing.assert_allclose(first, np.eye(n), rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", holonomies())
def test_closing_turns_evenly_and_no_further_than_half_a_turn(name: str) -> None:
    closure = Closure.of(holonomies()[name])
    steps = np.linspace(0.0, 1.0, 11)
    rotations = closure.rotations(steps)
    for rotation in rotations:
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(len(rotation)), rtol=0, atol=1e-13)
    changes = [before.T @ after for before, after in zip(rotations, rotations[1:])]
    for change in changes[1:]:
        np.testing.assert_allclose(change, changes[0], rtol=0, atol=1e-13)
    assert np.all(np.abs(closure.angles) <= np.pi * (1 + 1e-15))
    assert np.unique(closure.planes).size == closure.planes.size
    assert closure.flipped not in closure.planes


@dataclass(frozen=True)
class Family:
    """What a solver returns for symmetric matrices over theta, with random signs; unit mass matrix."""

    values: np.ndarray  # (n, m)
    vectors: np.ndarray  # (n, n_rows, m)

    @classmethod
    def of(cls, matrix: Callable[[float], np.ndarray], theta: np.ndarray, m: int) -> "Family":
        random = np.random.default_rng(0)
        pairs = [np.linalg.eigh(matrix(value)) for value in theta]
        vectors = np.array([vector[:, :m] * random.choice([-1.0, 1.0], m) for _, vector in pairs])
        return cls(np.array([value[:m] for value, _ in pairs]), vectors)

    @property
    def overlaps(self) -> np.ndarray:
        """From each sample to the one before; the first from the first to the last."""
        return np.array([new.T @ old for new, old in zip(self.vectors, np.roll(self.vectors, 1, axis=0))])

    def carried(self) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """Return the groups, the transported basis and its cosines, over a range that is not periodic."""
        groups = group_modes(self.values, self.overlaps[1:])
        rotations = transport(self.overlaps[1:], groups, np.eye(self.values.shape[1]))
        return groups, self.vectors @ rotations, by_groups(self.overlaps[1:], groups)[1]

    def closed(self) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """Return the groups, the basis over a revolution, and the flipped coordinates."""
        groups = group_modes(self.values, self.overlaps)
        rotations = transport(self.overlaps[1:], groups, np.eye(self.values.shape[1]))
        closed = close_revolution(rotations, self.overlaps[0], groups)
        cosines = by_groups(self.overlaps, groups)[1]
        assert np.all((cosines > 0.0) & (cosines <= 1.0 + 1e-14))
        return groups, self.vectors @ closed.rotations, closed.flipped


def numbers(groups: list[np.ndarray]) -> list[list[int]]:
    return [group.tolist() for group in groups]


def spectrum(frame: np.ndarray, *values: float) -> np.ndarray:
    """Return the matrix with these eigenvalues and the columns of a frame as its modes."""
    return frame @ np.diag(values) @ frame.T


def test_modes_that_cross_exactly_keep_their_shapes() -> None:
    frame = orthogonal(4, 3)
    # the crossing at 0 is a sample of the first grid, where the solver may return any two vectors; not of the second
    for theta in (np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 20)):
        family = Family.of(lambda value: spectrum(frame, 2 + value, 2 - value, 7.0, 9.0), theta, 3)
        groups, bases, cosines = family.carried()
        assert numbers(groups) == [[0, 1], [2]]
        np.testing.assert_allclose(bases, np.broadcast_to(bases[0], bases.shape), rtol=0, atol=1e-13)
        np.testing.assert_allclose(cosines, 1.0, rtol=0, atol=1e-14)


@pytest.mark.parametrize("gap", [1e-1, 1e-4, 1e-8])
def test_modes_that_veer_turn_no_faster_than_their_space(gap: float) -> None:
    frame = orthogonal(4, 3)

    def veering(value: float) -> np.ndarray:
        matrix = np.diag([2 + value, 2 - value, 7.0, 9.0])
        matrix[0, 1] = matrix[1, 0] = gap
        slowly = expm(0.2 * value * (np.eye(4, k=2) - np.eye(4, k=-2)))
        return frame @ slowly @ matrix @ slowly.T @ frame.T

    groups, bases, _ = Family.of(veering, np.linspace(-1.0, 1.0, 200), 2).carried()
    if gap < 0.1:
        assert numbers(groups) == [[0, 1]]
        # the space turns by 0.2 rad per unit of theta in two planes; single modes turn by pi/2 within the gap
        assert np.max(np.linalg.norm(np.diff(bases, axis=0), axis=(1, 2))) < 1.01 * 0.2 * (2 / 199) * np.sqrt(2)
    else:
        # a gap that the grid resolves: the modes stay apart, and turn by no more than the mixing that is allowed
        assert numbers(groups) == [[0], [1]]
        assert np.max(np.abs(np.diff(bases, axis=0))) < 0.2


def test_modes_that_stay_apart_are_not_mixed() -> None:
    def slowly(value: float) -> np.ndarray:
        return spectrum(expm(0.3 * np.sin(value) * (np.eye(4, k=1) - np.eye(4, k=-1))), 1.0, 2.0, 4.0, 8.0)

    family = Family.of(slowly, np.linspace(0.0, 2 * np.pi, 60, endpoint=False), 3)
    groups, bases, flipped = family.closed()
    assert numbers(groups) == [[0], [1], [2]] and flipped.size == 0
    np.testing.assert_allclose(np.abs(bases), np.abs(family.vectors), rtol=0, atol=1e-15)
    assert np.all(np.sum(bases * np.roll(bases, 1, axis=0), axis=1) > 0.99)


def test_groups_are_linked_by_values_and_by_overlaps() -> None:
    values = np.tile([1.0, 2.0, 3.0, 4.0, 5.0], (6, 1))
    nothing = np.tile(np.eye(5), (5, 1, 1))
    assert numbers(group_modes(values, nothing)) == [[0], [1], [2], [3], [4]]
    once_close = values.copy()
    once_close[3, 1] = 3.0 * (1 - 0.9 * CLOSE_TOLERANCE)
    assert numbers(group_modes(once_close, nothing)) == [[0], [1, 2], [3], [4]]
    once_mixed = nothing.copy()
    once_mixed[2, 4, 3] = -1.1 * VEERING
    assert numbers(group_modes(values, once_mixed)) == [[0], [1], [2], [3, 4]]
    # friends of friends
    once_mixed[4, 3, 2] = 0.9
    assert numbers(group_modes(once_close, once_mixed)) == [[0], [1, 2, 3, 4]]
    # modes far apart drift, but do not change places
    far = nothing.copy()
    far[2, 4, 0] = 0.9 * EXCHANGE
    assert numbers(group_modes(values, far)) == [[0], [1], [2], [3], [4]]
    # ... unless they do
    far[2, 4, 0] = 1.1 * EXCHANGE
    assert numbers(group_modes(values, far)) == [[0, 4], [1], [2], [3]]
    # a static mode has no eigenvalue: its overlap alone decides
    static = np.tile(np.eye(6), (5, 1, 1))
    static[1, 5, 0] = 0.9 * EXCHANGE
    assert numbers(group_modes(values, static)) == [[0], [1], [2], [3], [4], [5]]
    static[1, 5, 0] = 1.1 * EXCHANGE
    assert numbers(group_modes(values, static)) == [[0, 5], [1], [2], [3], [4]]
    # what elastic joints allow has no stiffness, and must not get any from a mode between samples
    assert numbers(group_modes(values, static, np.arange(6) < 5)) == [[0], [1], [2], [3], [4], [5]]
    assert numbers(group_modes(values[:1, :1], nothing[:0, :1, :1])) == [[0]]


def test_a_group_of_one_mode_is_only_given_a_sign() -> None:
    overlaps = np.array([[[-0.9]], [[0.8]], [[-1.0]]])
    rotations = transport(overlaps, [np.array([0])], -np.eye(1))
    # the sign that makes each vector's product with the one before positive
    np.testing.assert_array_equal(rotations[:, 0, 0], [-1.0, 1.0, 1.0, -1.0])
    np.testing.assert_allclose(by_groups(overlaps, [np.array([0])])[1], [0.9, 0.8, 1.0], rtol=1e-15)


def moebius(value: float, *lowest: float) -> np.ndarray:
    """Return a matrix of period 2 pi; its modes of the given eigenvalues make half a turn, each in its own plane."""
    m = len(lowest)
    direction = np.array([np.cos(value / 2), np.sin(value / 2)])
    blocks = [50.0 * np.eye(2) - (50.0 - low) * np.outer(direction, direction) for low in lowest]
    turn = orthogonal(2 * m, 4)
    return turn @ block_diag(*blocks) @ turn.T


def circle(n: int) -> np.ndarray:
    return 2 * np.pi / n * np.arange(n)


@pytest.mark.parametrize(
    ("lowest", "groups", "n_flipped"),
    [
        ((1.0,), [[0]], 1), ((1.0, 2.0), [[0], [1]], 2), ((1.0, 1.001), [[0, 1]], 0),
        ((1.0, 1.001, 1.002), [[0, 1, 2]], 1), ((1.0, 1.001, 2.0), [[0, 1], [2]], 1),
    ],
)  # fmt: skip
def test_a_moebius_family_closes_after_one_turn_or_two(
    lowest: tuple[float, ...], groups: list[list[int]], n_flipped: int
) -> None:
    n, m = 48, len(lowest)
    found, bases, flipped = Family.of(lambda value: moebius(value, *lowest), circle(n), m).closed()
    assert numbers(found) == groups and flipped.size == n_flipped
    signs = np.ones(m)
    signs[flipped] = -1.0
    two_turns = np.concatenate([bases, bases * signs, bases[:1]])
    jumps = np.linalg.norm(np.diff(two_turns, axis=0), axis=(1, 2))
    # as even where a turn ends as everywhere else
    np.testing.assert_allclose(jumps, jumps[0], rtol=1e-10)
    # each mode turns by half the step, and the closure turns a pair by as much again
    assert jumps[0] <= np.sqrt(2 * m) * np.pi / n
    if m == 1:
        assert jumps[0] == pytest.approx(2 * np.sin(np.pi / n / 2), rel=1e-12)


def test_closing_leaves_the_other_groups_alone() -> None:
    n = 30
    family = Family.of(lambda value: block_diag(moebius(value, 1.0), np.diag([3.0, 4.0])), circle(n), 3)
    groups, bases, flipped = family.closed()
    assert numbers(groups) == [[0], [1], [2]] and flipped.tolist() == [0]
    np.testing.assert_allclose(bases[:, :, 1:], np.broadcast_to(bases[0, :, 1:], (n, 4, 2)), rtol=0, atol=1e-14)
