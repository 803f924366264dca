"""Which samples of an ensemble are checked: chosen by their numbers, so that ranks and batches have no part in it."""

from __future__ import annotations

import numpy as np

PERIOD = 1000


def checked(share: float, first: int, last: int) -> np.ndarray:
    """Return which of the samples first to last - 1 are checked, shape (last - first,).

    The first ``share`` of every thousand: they come in one batch, where many cost little more than one, and already a
    small ensemble has some. As samples are independent, these are as good as any others.
    """
    n_checked = max(1, round(share * PERIOD)) if share > 0.0 else 0
    return np.arange(first, last) % PERIOD < n_checked
