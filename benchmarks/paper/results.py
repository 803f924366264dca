"""The result files that `scripts/demo` leaves, read once for the whole summary."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.paper.published import NOMINAL, RADII
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.trajectory import ModesTable, Trajectory

MODELS = ("full", "reduced")


@dataclass(frozen=True)
class PaperResults:
    """Files of a run of `scripts/demo`.

    Attributes
    ----------
    directory
        Where they are.
    modes
        Frequencies by radius, full-order and reduced.
    fine_modes
        Frequencies with 40 elements a body, nominal radius.
    runs
        Trajectories by model and radius.
    ensembles
        Monte Carlo by model; both with the same samples.
    """

    directory: Path
    modes: dict[str, ModesTable]
    fine_modes: ModesTable
    runs: dict[tuple[str, str], Trajectory]
    ensembles: dict[str, Ensemble]

    @classmethod
    def read(cls, directory: Path) -> PaperResults:
        """Read the files; raises `InputError` where one is missing or damaged."""
        return cls(
            directory=directory,
            modes={factor: ModesTable.read(directory / f"modes_{factor}.h5") for factor in RADII},
            fine_modes=ModesTable.read(directory / "modes_40_elements.h5"),
            runs={
                (model, factor): Trajectory.read(directory / f"{model}_{factor}.h5")
                for model in MODELS
                for factor in RADII
            },
            ensembles={model: Ensemble.read(directory / f"montecarlo_{model}.h5") for model in MODELS},
        )

    def largest_error(self, output: str, factor: str) -> float:
        """Return the reduced model's largest error over time, over the largest full-order value."""
        full, reduced = (self.runs[model, factor].outputs[output] for model in MODELS)
        return float(np.max(np.abs(reduced - full)) / np.max(np.abs(full)))

    @property
    def nominal_run(self) -> Trajectory:
        """The full-order run with the nominal radius."""
        return self.runs["full", NOMINAL]
