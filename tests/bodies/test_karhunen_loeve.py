"""Expansions of random fields against closed forms, and the covariance that they are made of."""

import numpy as np
import pytest
from scipy.optimize import brentq

from pgmp_petsc.bodies.random_fields import correlation, expansion


def closed_form(extent: float, length: float, n: int) -> np.ndarray:
    """Return eigenvalues of the exponential kernel on an interval (Ghanem and Spanos 1991, section 2.3.3)."""
    a, c = 0.5 * extent, 1.0 / length
    found = []
    for k in range(n):
        # c - w tan(w a) = 0 of even functions, w + c tan(w a) = 0 of odd ones, each in its own quarter turns
        even = k % 2 == 0
        low, high = k * np.pi / 2, (k + 1) * np.pi / 2
        equation = (
            (lambda x: c * a * np.cos(x) - x * np.sin(x)) if even else (lambda x: x * np.cos(x) + c * a * np.sin(x))
        )
        w = brentq(equation, low + 1e-12, high) / a
        found.append(2.0 * c / (w**2 + c**2))
    return np.array(found)


def on_interval(
    n_cells: int, kernel: str = "exponential", length: float = 0.4, smoothness: float = 0.5, n_terms: int = 6
):
    ends = np.linspace(0.0, 1.0, n_cells + 1)
    return expansion(0.5 * (ends[1:] + ends[:-1])[:, None], np.diff(ends), kernel, length, smoothness, n_terms)


def test_eigenvalues_of_the_exponential_kernel_are_those_of_the_closed_form_to_second_order() -> None:
    exact = closed_form(1.0, 0.4, 6)
    off = [np.abs(on_interval(n).shares / exact - 1.0).max() for n in (40, 80, 160)]
    assert off[2] < 1e-3
    assert np.log2(off[0] / off[1]) == pytest.approx(2.0, abs=0.2)
    assert np.log2(off[1] / off[2]) == pytest.approx(2.0, abs=0.2)


def test_functions_are_orthonormal_and_all_of_them_make_the_covariance() -> None:
    places, volumes = np.random.default_rng(1).random((30, 2)), np.random.default_rng(2).random(30)
    found = expansion(places, volumes, "matern", 0.5, 1.5, 30)
    apart = np.linalg.norm(places[:, None] - places, axis=2) / 0.5
    assert np.allclose(found.functions.T @ found.functions, correlation("matern", apart, 1.5), atol=1e-9)
    gram = (found.functions * volumes) @ found.functions.T
    assert np.allclose(gram, np.diag(found.shares * volumes.sum()), atol=1e-9)
    assert found.kept == pytest.approx(1.0, abs=1e-9)
    assert np.allclose(found.deviations, 1.0, atol=1e-9)


def test_functions_do_not_depend_on_the_order_of_the_cells() -> None:
    ends = np.linspace(0.0, 1.0, 41)
    places, volumes = 0.5 * (ends[1:] + ends[:-1])[:, None], np.diff(ends)
    order = np.random.default_rng(3).permutation(40)
    one, other = (expansion(places[k], volumes[k], "exponential", 0.3, 0.5, 4) for k in (np.arange(40), order))
    signs = np.sign(np.sum(one.functions[:, order] * other.functions, axis=1))
    assert np.allclose(one.functions[:, order], signs[:, None] * other.functions, atol=1e-9)


def test_a_factor_that_ends_early_has_the_eigenvalues_of_the_whole_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    from pgmp_petsc.bodies import random_fields

    whole = on_interval(400, length=0.21, n_terms=5)
    monkeypatch.setattr(random_fields, "NUMBERS", 0)
    monkeypatch.setattr(random_fields, "OVERSAMPLING", 60)
    part = on_interval(400, length=0.2100001, n_terms=5)
    # Between the middles of the pivots' cells the exponential kernel leaves a Brownian bridge of variance h / (3 l) on
    # average and nothing else (it is Markov's): eigenvalues fall by at most the trace of a piece. Pivots halve the
    # largest gap, so that 65 of them leave none beyond a 32nd.
    assert np.all(part.shares < whole.shares)
    assert np.allclose(part.shares, whole.shares, rtol=0.0, atol=(1.0 / 32.0) ** 2 / (3.0 * 0.21))


def test_kernels_meet_in_their_limits() -> None:
    r = np.linspace(0.0, 3.0, 31)
    assert np.allclose(correlation("matern", r, 0.5), correlation("exponential", r))
    z = np.sqrt(3.0) * r
    assert np.allclose(correlation("matern", r, 1.5), (1.0 + z) * np.exp(-z))
    # of s = 20 the next term of the limit is of the order r^4 / (8 s)
    assert np.allclose(correlation("matern", r, 20.0), correlation("squared_exponential", r), atol=0.02)
