"""What an ensemble is asked for, and what one batch of it gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pgmp_petsc.runtime.remarks import Remark

SAMPLERS = ("random", "latin_hypercube", "sobol", "saltelli")
MOST_SAMPLES = 10**9  # the pieces of a checkpoint are in order by nine digits
LARGEST_SEED = 2**63 - 1  # the largest whole number that every reader of the file knows


@dataclass(frozen=True)
class SampleFile:
    """Samples that a file gives: values (N,) by parameter, the identity of its content, and what is said of it."""

    path: Path
    values: dict[str, np.ndarray]
    identity: str
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True)
class Shard:
    """One of `count` parts of an ensemble, numbered from 1, which are runs of their own."""

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


@dataclass(frozen=True)
class Plan:
    """How many samples, from which seed or file, where the result goes, whether to take up a checkpoint, and which part
    of the samples is wanted where it is not all of them. `is_limited` is false where nobody asked for a number of
    samples, and `n_samples` is one that no run comes to."""

    n_samples: int
    seed: int
    output: Path = Path()
    resume: bool = False
    file: SampleFile | None = None
    shard: Shard | None = None
    is_limited: bool = True

    @property
    def samples(self) -> tuple[int, int]:
        """First of the samples that are wanted, and the one behind the last."""
        if self.shard is None:
            return 0, self.n_samples
        return tuple(self.n_samples * k // self.shard.count for k in (self.shard.number - 1, self.shard.number))


@dataclass(frozen=True)
class Batch:
    """Samples ``first`` to ``first + n - 1``: parameters, outputs at the end, status and time of failure, each (n,).

    ``numerics`` says how each was integrated: ``steps_divided`` is by what the scene's step was divided,
    ``unstable_start`` whether it began on an unstable static equilibrium. The reduced
    model adds the largest estimated errors of the outputs, those at the end, and the validity of small deformations,
    each (n,) and NaN where they were not estimated. ``balance`` is that of energy, where it was asked for, as are
    ``extremes`` of the outputs over time and ``first_passages`` of events; ``bands`` are outputs at some instants, each
    (n, n_t).
    """

    first: int
    parameters: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]
    status: np.ndarray
    failure_time: np.ndarray
    numerics: dict[str, np.ndarray] = field(default_factory=dict)
    errors: dict[str, np.ndarray] = field(default_factory=dict)
    errors_at_end: dict[str, np.ndarray] = field(default_factory=dict)
    validity: dict[str, np.ndarray] = field(default_factory=dict)
    balance: dict[str, np.ndarray] = field(default_factory=dict)
    extremes: dict[str, np.ndarray] = field(default_factory=dict)
    first_passages: dict[str, np.ndarray] = field(default_factory=dict)
    bands: dict[str, np.ndarray] = field(default_factory=dict)
