"""Ties of second order in the deformation: their value, and derivatives against differences."""

import numpy as np
import pytest

from pgmp_petsc.mechanism.frame_ties import FrameTies, bent_terms

N, ROW, N_ROWS = 3, 1, 6  # amplitudes, first row of the tie, rows of all ties


def ties_of(d: int) -> tuple[FrameTies, np.ndarray, int]:
    """Return the tie of a frame whose unknowns come before three amplitudes, a, and the number of unknowns."""
    n_pose = 3 if d == 2 else 12
    bent = np.random.default_rng(0).normal(size=(d, N, N))
    bent += bent.swapaxes(1, 2)
    terms = bent_terms(d, ROW, 0, n_pose + np.arange(N), bent)
    return FrameTies(terms, d, N_ROWS, n_pose + N), bent, n_pose + N


def dense(pattern: tuple[np.ndarray, np.ndarray], values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a matrix from entries that may repeat."""
    full = np.zeros(shape)
    np.add.at(full, pattern, values)
    return full


@pytest.mark.parametrize("d", [2, 3])
def test_they_are_what_they_stand_for(d: int) -> None:
    ties, bent, n = ties_of(d)
    q = np.random.default_rng(1).normal(size=n)
    xi = q[-N:]
    directors = np.array([[np.cos(q[2]), np.sin(q[2])], [-np.sin(q[2]), np.cos(q[2])]])
    if d == 3:
        directors = q[3:12].reshape(3, 3)
    expected = np.zeros(N_ROWS)
    expected[ROW : ROW + d] = -0.5 * np.einsum("kij,i,j,kc->c", bent, xi, xi, directors)
    np.testing.assert_allclose(ties.values(q[:, None])[:, 0], expected, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_are_those_of_differences(d: int) -> None:
    ties, _, n = ties_of(d)
    rng, h = np.random.default_rng(2), 1e-6
    q, v, forces = rng.normal(size=n), rng.normal(size=n), rng.normal(size=(N_ROWS, 1))

    def jacobian(q: np.ndarray) -> np.ndarray:
        return dense(ties.jacobian_pattern, ties.jacobian_values(q[:, None])[:, 0], (N_ROWS, n))

    # central differences with h = 1e-6: round-off of numbers of order 10 over h, and h^2
    steps = h * np.eye(n)
    slopes = [(ties.values((q + s)[:, None]) - ties.values((q - s)[:, None]))[:, 0] / (2 * h) for s in steps]
    np.testing.assert_allclose(jacobian(q), np.array(slopes).T, rtol=0, atol=1e-7)
    bent = dense(ties.curvature_pattern, ties.curvature_values(q[:, None], forces)[:, 0], (n, n))
    bent += np.tril(bent, -1).T
    slopes = [forces[:, 0] @ (jacobian(q + s) - jacobian(q - s)) / (2 * h) for s in steps]
    np.testing.assert_allclose(bent, np.array(slopes), rtol=0, atol=1e-7)
    drift = (jacobian(q + h * v) - jacobian(q - h * v)) @ v / (2 * h)
    np.testing.assert_allclose(ties.drift(q[:, None], v[:, None])[:, 0], drift, rtol=0, atol=1e-7)


def test_there_are_none_without_curvature() -> None:
    assert bent_terms(2, 0, 0, np.arange(3, 6), np.zeros((2, 3, 3))).rows.size == 0
