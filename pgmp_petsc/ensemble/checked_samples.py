"""Which samples of an ensemble are checked: chosen by their numbers, so that ranks and batches have no part in it."""

from __future__ import annotations

PERIOD = 10_000
FEWEST = 1_000  # samples of which a share is taken, where there are less: already a small ensemble has some


def checked(share: float, n_samples: int) -> list[tuple[int, int]]:
    """Return the ranges (first, last) of the samples 0 to n_samples - 1 that are checked, last - 1 the last of each.

    The first ``share`` of every ten thousand. As samples are independent, these are as good as any others.
    """
    found = []
    for first in range(0, n_samples if share > 0.0 else 0, PERIOD):
        together = min(max(n_samples - first, FEWEST), PERIOD)
        found.append((first, min(first + max(1, round(share * together)), n_samples)))
    return found
