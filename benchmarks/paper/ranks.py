"""Whether the number of ranks, and of ranks that share an eigenproblem, changes a result."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.tables import Table
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.trajectory import ModesTable

BASE = "1"
OTHERS = {"2": "2 ranks", "3": "3 ranks", "2_shared": "2 ranks, --ranks-per-angle 2"}
LIMIT = 1e-9


def rank_table(directory: Path) -> Table:
    """Compare small runs with one rank's; raises `InputError` where a file is missing."""
    rows = []
    for name, words in OTHERS.items():
        differences = [
            frequency_difference(directory, name),
            sample_difference(directory, "reduced", name),
            sample_difference(directory, "full", name),
        ]
        verdict = "ok" if max(differences) <= LIMIT else f"differs by more than {LIMIT:g}"
        rows.append([words, *(f"{difference:.1e}" for difference in differences), verdict])
    header = ("against 1 rank", "frequencies", "outputs of reduced samples", "outputs of full-order samples", "verdict")
    after = (
        "Largest relative differences: frequencies of `pgmp modes` (12 angles) and of the reduced model's build (48 "
        "angles); every output of 16 samples at 1 s over the largest value of that output. Each reduced ensemble uses "
        "the reduced model built with the same number of ranks."
    )
    return Table("Independence of the number of ranks", header, rows, after=after)


def frequency_difference(directory: Path, name: str) -> float:
    """Return the largest relative difference of the frequencies."""
    pairs = [
        (
            ModesTable.read(directory / f"modes_{which}.h5").full_hz,
            ReducedOrderModel.read(directory / f"rom_{which}.h5"),
        )
        for which in (BASE, name)
    ]
    (modes, rom), (other_modes, other_rom) = pairs
    return max(
        float(np.max(np.abs(other / one - 1.0)))
        for one, other in ((modes, other_modes), (rom.frequencies_hz, other_rom.frequencies_hz))
    )


def sample_difference(directory: Path, model: str, name: str) -> float:
    """Return the largest difference of any output of any sample, over the output's largest value."""
    one, other = (Ensemble.read(directory / f"{model}_{which}.h5") for which in (BASE, name))
    return max(
        float(np.max(np.abs(other.outputs[key] - values)) / np.max(np.abs(values)))
        for key, values in one.outputs.items()
    )
