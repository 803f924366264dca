"""Designs: which uniform numbers samples have before distributions make values of them.

================== =============================================================================================
random             sample k has a random stream of its own, keyed by the seed and k
latin_hypercube    McKay, Beckman and Conover, Technometrics 21 (1979) 239-245: for each parameter a random permutation
                   of N slices of equal probability; within its slice sample k lies where its own stream says
sobol              Sobol sequences with scrambles of their own (Matousek, Journal of Complexity 14 (1998) 527-556;
                   `scipy.stats.qmc.Sobol`): sample k is point k // R of replicate k % R
saltelli           Saltelli et al., Computer Physics Communications 181 (2010) 259-270: blocks of d + 2 samples, point A
                   of a scrambled Sobol sequence in 2 d dimensions, A with parameter 1 .. d of B, and B; block k is of
                   replicate k % R
================== =============================================================================================

Sample k is the same in every batch, on every rank and in a longer run; of a Latin hypercube it is another one where N
is.
"""

from __future__ import annotations

import warnings
from typing import Protocol

import numpy as np

from pgmp_petsc.ensemble.sample_streams import first_numbers
from pgmp_petsc.runtime.errors import InputError

BITS = 30  # of the numbers of a Sobol sequence
MOST_OF_LATIN_HYPERCUBE = 100_000_000  # samples: every rank holds 4 bytes a parameter of each
OF_ORDER, OF_SCRAMBLE, OF_BLOCKS, OF_RARE = 0, 1, 2, 3  # first keys of streams that are no sample's


class Design(Protocol):
    """Uniform numbers between 0 and 1 of numbered samples.

    Attributes
    ----------
    extends
        Whether a longer run has the samples of a shorter one.
    """

    extends: bool

    def uniform(self, first: int, last: int) -> np.ndarray:
        """Return those of samples first to last - 1, shape (last - first, d)."""


class Independent:
    """Independent random samples.

    Parameters
    ----------
    seed
        Of all streams.
    d
        Number of parameters.
    """

    extends = True

    def __init__(self, seed: int, d: int) -> None:
        self._seed, self._d = seed, d

    def uniform(self, first: int, last: int) -> np.ndarray:
        """Return the uniform numbers; see `Design`."""
        return first_numbers(self._seed, np.arange(first, last), self._d)


class LatinHypercube:
    """A Latin hypercube of n samples; see `Independent`.

    Raises
    ------
    InputError
        If its permutations would not fit in memory.
    """

    extends = False

    def __init__(self, seed: int, d: int, n: int) -> None:
        if n > MOST_OF_LATIN_HYPERCUBE:
            raise InputError(
                f"-n {n} with the sampler latin_hypercube: at most {MOST_OF_LATIN_HYPERCUBE:,} samples, since every "
                "rank holds the order of all; take sobol"
            )
        self._n, self._within = n, Independent(seed, d)
        self._slices = [stream(seed, OF_ORDER, k).permutation(np.arange(n, dtype=np.uint32)) for k in range(d)]

    def uniform(self, first: int, last: int) -> np.ndarray:
        """Return the uniform numbers; see `Design`."""
        slices = np.array([order[first:last] for order in self._slices], dtype=float).T
        return (slices + self._within.uniform(first, last)) / self._n


class Replicates:
    """Scrambled Sobol sequences that take turns; see `Independent`.

    Parameters
    ----------
    n_replicates
        Number of sequences.
    purpose
        First key of the streams that scramble them.
    """

    extends = True

    def __init__(self, seed: int, d: int, n_replicates: int, purpose: int = OF_SCRAMBLE) -> None:
        self._n, self._d = n_replicates, d
        self._sequences = [Scrambled(d, stream(seed, purpose, number)) for number in range(n_replicates)]

    def uniform(self, first: int, last: int) -> np.ndarray:
        """Return the uniform numbers; see `Design`."""
        found = np.empty((last - first, self._d))
        for number, sequence in enumerate(self._sequences):
            begin = first + (number - first) % self._n  # its first sample from `first` on
            here = np.arange(begin, last, self._n)
            if here.size:
                found[here - first] = sequence.points(begin // self._n, here.size)
        return found


class Blocks:
    """Saltelli's blocks, of scrambled Sobol sequences that take turns; see `Replicates`."""

    extends = True

    def __init__(self, seed: int, d: int, n_replicates: int) -> None:
        self._d, self._base = d, Replicates(seed, 2 * d, n_replicates, OF_BLOCKS)

    def uniform(self, first: int, last: int) -> np.ndarray:
        """Return the uniform numbers; see `Design`."""
        d, size = self._d, self._d + 2
        if first == last:
            return np.empty((0, d))
        begin, end = first // size, -(-last // size)
        base = self._base.uniform(begin, end)
        blocks = np.repeat(base[:, None, :d], size, axis=1)
        for k in range(d):
            blocks[:, k + 1, k] = base[:, d + k]
        blocks[:, d + 1] = base[:, d:]
        return blocks.reshape(-1, d)[first - begin * size : last - begin * size]


class Scrambled:
    """One scrambled Sobol sequence, any stretch of it.

    Its numbers are multiples of 2^-30, of which half is added: 0 has no finite quantile.

    Parameters
    ----------
    d
        Dimensions.
    random
        What scrambles it.
    """

    def __init__(self, d: int, random: np.random.Generator) -> None:
        from scipy.stats import qmc  # half a second, which other designs need not wait for

        self._sequence = qmc.Sobol(d, scramble=True, bits=BITS, seed=random)

    def points(self, first: int, n: int) -> np.ndarray:
        """Return points first to first + n - 1, shape (n, d)."""
        if first < self._sequence.num_generated:
            self._sequence.reset()
        if first > self._sequence.num_generated:
            self._sequence.fast_forward(first - self._sequence.num_generated)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a stretch that is no power of two
            return self._sequence.random(n) + 0.5 ** (BITS + 1)


def stream(seed: int, *key: int) -> np.random.Generator:
    """Return the random stream of a sample, or with two keys of something else, that the seed leads to."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
