"""Streams side by side are numpy's own, one after the other."""

import numpy as np
import pytest

from pgmp_petsc.ensemble.plan import LARGEST_SEED, MOST_SAMPLES
from pgmp_petsc.ensemble.sampling import first_numbers, stream


@pytest.mark.parametrize("seed", [0, 1, 42, 2**32 - 1, 2**32, 123456789012345678, LARGEST_SEED])
def test_the_first_numbers_are_those_of_every_stream(seed: int) -> None:
    """Bit for bit, for seeds of one word and of two, and the samples that there may be."""
    numbers = np.append(np.arange(40), np.random.default_rng(seed).integers(40, MOST_SAMPLES, 40))
    numbers = np.append(numbers, MOST_SAMPLES - 1)
    for d in (1, 5):
        expected = [stream(seed, int(number)).random(d) for number in numbers]
        np.testing.assert_array_equal(first_numbers(seed, numbers, d), expected)


def test_there_may_be_no_sample_and_no_number() -> None:
    assert first_numbers(3, np.arange(0), 2).shape == (0, 2)
    assert first_numbers(3, np.arange(4), 0).shape == (4, 0)
