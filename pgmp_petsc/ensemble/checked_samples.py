"""Which samples of an ensemble are checked: chosen by their numbers, so that ranks and batches have no part in it."""

from __future__ import annotations

import numpy as np

PERIOD = 10_000
FEWEST = 1_000  # samples of which a share is taken, where there are less: already a small ensemble has some


def checked(share: float, first: int, last: int, n_samples: int) -> np.ndarray:
    """Return which of the samples first to last - 1 of an ensemble are checked, shape (last - first,).

    The first ``share`` of every ten thousand: they come in one batch, where many cost little more than one. As samples
    are independent, these are as good as any others.
    """
    numbers = np.arange(first, last)
    if share == 0.0:
        return np.zeros(numbers.size, dtype=bool)
    together = np.clip(n_samples - numbers // PERIOD * PERIOD, FEWEST, PERIOD)
    return numbers % PERIOD < np.maximum(1, np.rint(share * together))
