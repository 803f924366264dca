"""How busy ranks are that an ensemble is dealt out to, simulated with measured times of its pieces.

    python -m benchmarks.dealing ROM.h5 -n 10000

Pieces of several sizes are integrated on one rank, with estimates of errors and without, and their processor times fit
by a straight line in the number of samples. The pieces of `ensemble.plan` are then dealt to more and more ranks as
`ranks.groups` deals them: one each at first, then the next one to whoever is ready. Beside it stands the scheme of
rounds: batches of `ensemble.batch`, all ranks wait for the slowest of each round, and the samples that are checked are
in one of them.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.on_model import main
from benchmarks.programs import reduced_model
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.plan import Piece, checked, pieces
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.ensemble.watchers import Watching
from pgmp_petsc.models import ReducedModel

RANKS = (2, 8, 64)
SIZES, SIZES_CHECKED = (32, 128, 512), (8, 64)
REPEATS = 3


@dataclass(frozen=True)
class Cost:
    """Processor time of a piece: ``fixed + each n``, s."""

    fixed: float
    each: float

    @classmethod
    def measured(cls, model: ReducedModel, watching: Watching, sizes: Sequence[int], is_checked: bool) -> Cost:
        """Fit the least of several times of every size."""
        times = []
        for n in sizes:
            watchers, found = watching.of(Piece(0, n, is_checked)), []
            for _ in range(REPEATS):
                start = process_time()
                run_batch(model, draw(model.scene, 0, 0, n), watchers=watchers)
                found.append(process_time() - start)
            times.append(min(found))
        each, fixed = np.polyfit(sizes, times, 1)
        return cls(float(fixed), float(each))

    def of(self, n: int) -> float:
        """Return the time of a piece of n samples."""
        return self.fixed + self.each * n


def dealt(times: Sequence[float], n_ranks: int) -> float:
    """Return when the last of some pieces is finished, each dealt to the first rank that is ready."""
    ready = [0.0] * n_ranks
    for time in times:
        heapq.heapreplace(ready, ready[0] + time)
    return max(ready)


def in_rounds(times: Sequence[float], n_ranks: int) -> float:
    """Return when the last of some batches is finished, where all ranks wait for the slowest of a round."""
    return sum(max(times[first : first + n_ranks]) for first in range(0, len(times), n_ranks))


def run(path: Path, n_samples: int) -> None:
    """Measure a reduced model and print a line for every number of ranks."""
    model = reduced_model(path)
    watching = Watching(model)
    plain = Cost.measured(model, watching, SIZES, False)
    estimate = Cost.measured(model, watching, SIZES_CHECKED, True) if watching.share > 0.0 else Cost(0.0, 0.0)
    to_check = checked(watching.share, n_samples)
    n_checked, batch = sum(last - first for first, last in to_check), model.largest_batch
    print(f"a piece of n samples: {1e3 * plain.fixed:.1f} + {1e3 * plain.each:.2f} n ms")
    print(f"an estimate of n samples: {1e3 * estimate.fixed:.1f} + {1e3 * estimate.each:.2f} n ms; {n_checked} of them")
    for n_ranks in RANKS:
        found = pieces([(0, n_samples)], to_check, n_ranks, batch)
        times = [(estimate if part.is_checked else plain).of(part.last - part.first) for part in found]
        whole = dealt(times, n_ranks)
        batches = [plain.of(min(batch, n_samples - first)) for first in range(0, n_samples, batch)]
        batches[0] += estimate.of(n_checked) if n_checked else 0.0
        rounds = in_rounds(batches, n_ranks)
        print(
            f"{n_ranks:3d} ranks: {len(found):4d} pieces, {whole:7.3f} s, busy {sum(times) / n_ranks / whole:.0%}; "
            f"in rounds {rounds:7.3f} s, busy {sum(batches) / n_ranks / rounds:.0%}",
            flush=True,
        )


if __name__ == "__main__":
    main(__doc__, run, 10_000)
