"""What an ensemble is asked for, and what one batch of it gives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Plan:
    """How many samples, from which seed, where the file goes, and whether to take up a checkpoint."""

    n_samples: int
    seed: int
    output: Path
    resume: bool


@dataclass(frozen=True)
class Batch:
    """Samples ``first`` to ``first + n - 1``: parameters, outputs at the end, status and time of failure, each (n,)."""

    first: int
    parameters: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]
    status: np.ndarray
    failure_time: np.ndarray
