"""A candidate that was tried, and errors over all training cases."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.experiments.history import History
from pgmp_petsc.selection.training import Training


@dataclass(frozen=True)
class Errors:
    """Errors of one kind over all training cases.

    Attributes
    ----------
    values
        Shares of the outputs' largest values, shape (n_loads, n_outputs, n_samples); NaN where a case does not count.
    round_off
        What of it is below what counts as zero: errors as small are round-off; the same shape.
    loads, outputs
        Names.
    training
        The cases.
    """

    values: np.ndarray
    round_off: np.ndarray
    loads: tuple[str, ...]
    outputs: tuple[str, ...]
    training: Training

    @property
    def by_output(self) -> np.ndarray:
        """Largest error of every output, shape (n_outputs,); zero where no case counts."""
        return np.max(np.nan_to_num(self.values, nan=0.0, posinf=np.inf), axis=(0, 2))

    @property
    def largest(self) -> float:
        """Largest error of all."""
        return float(self.by_output.max())

    @property
    def place(self) -> tuple[int, int, int]:
        """Load, output and sample of the largest error."""
        filled = np.nan_to_num(self.values, nan=-1.0, posinf=np.inf)
        return tuple(int(k) for k in np.unravel_index(np.argmax(filled), filled.shape))

    @property
    def is_round_off(self) -> bool:
        """Whether the largest error is below what counts as zero."""
        return self.largest <= self.round_off[self.place]

    @property
    def where(self) -> str:
        """Where the largest error is, in words."""
        load, output, sample = self.place
        values = self.training.sample_text(sample)
        return f"{self.outputs[output]}, load '{self.loads[load]}'" + (f", {values}" if values else "")


@dataclass(frozen=True)
class Trial:
    """A candidate that was tried.

    Attributes
    ----------
    reduction, n_steps
        What it is.
    errors
        Against the full-order model with the same step.
    reason
        Why it could not be built or run; empty where it could.
    seconds
        Wall time of build and runs.
    built
        Whether it could be built.
    histories
        By load, on the load's rank.
    """

    reduction: Reduction
    n_steps: int
    errors: Errors
    reason: str
    seconds: float
    built: bool
    histories: Mapping[str, History] = field(repr=False)
