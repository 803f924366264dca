"""Designs of samples: the same in any stretch, and as evenly spread as they promise."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.sampling import independent, latin_hypercube, saltelli, sobol

N = 96
DESIGNS = {
    "random": lambda seed: independent(seed, 3),
    "latin_hypercube": lambda seed: latin_hypercube(seed, 3, N),
    "sobol": lambda seed: sobol(seed, 3, 8),
    "saltelli": lambda seed: saltelli(seed, 3, 4),
}


@pytest.mark.filterwarnings("error")  # scipy's about numbers that are no powers of two would reach the terminal
@pytest.mark.parametrize("name", DESIGNS)
def test_a_sample_is_the_same_in_any_stretch(name: str) -> None:
    design = DESIGNS[name](5)
    whole = DESIGNS[name](5)(0, N)
    assert whole.shape == (N, 3) and np.all((whole > 0.0) & (whole < 1.0))
    for first, last in ((90, 96), (0, 1), (17, 42), (50, 50), (3, 77), (8, 16)):
        np.testing.assert_array_equal(design(first, last), whole[first:last])
    assert not np.array_equal(DESIGNS[name](6)(0, N), whole)


def test_each_slice_of_a_latin_hypercube_holds_one_sample() -> None:
    values = latin_hypercube(1, 3, N)(0, N)
    slices = np.floor(N * values).astype(int)
    for column in slices.T:
        np.testing.assert_array_equal(np.sort(column), np.arange(N))
    assert len({tuple(column) for column in slices.T}) == 3
    assert stats.kstest((N * values - slices).ravel(), "uniform").pvalue > 1e-3


def test_replicates_are_scrambled_sobol_sequences_of_their_own() -> None:
    """A (0, m, 2)-net has one point in each of 64 boxes, whatever their shape; replicates differ."""
    values = sobol(2, 2, 8)(0, 8 * 64).reshape(64, 8, 2)
    for k in range(8):
        for rows in (1, 2, 8, 32, 64):
            boxes = np.floor(values[:, k] * [rows, 64 // rows]).astype(int)
            assert len({tuple(box) for box in boxes}) == 64
    assert len({tuple(values[0, k]) for k in range(8)}) == 8


def test_blocks_differ_in_one_parameter_from_their_first_point() -> None:
    blocks = saltelli(3, 3, 2)(0, 5 * 64).reshape(64, 5, 3)
    a, b = blocks[:, 0], blocks[:, 4]
    for k in range(3):
        expected = a.copy()
        expected[:, k] = b[:, k]
        np.testing.assert_array_equal(blocks[:, k + 1], expected)
    # A and B are the halves of points in six dimensions, evenly spread together in either of two replicates
    for points in (np.hstack([a, b])[k::2] for k in range(2)):
        assert qmc.discrepancy(points) < 0.7 * qmc.discrepancy(np.random.default_rng(1).random((32, 6)))


def test_a_latin_hypercube_that_no_rank_could_hold_is_refused() -> None:
    with pytest.raises(InputError, match="-n 200000000 with the sampler latin_hypercube: at most 100,000,000"):
        latin_hypercube(0, 1, 200_000_000)


def test_a_far_stretch_of_a_million_takes_no_time() -> None:
    """It is reached without the samples before it."""
    far = 1_000_000
    np.testing.assert_array_equal(sobol(1, 2, 8)(far, far + 9)[1:], sobol(1, 2, 8)(far + 1, far + 9))
