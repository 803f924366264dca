"""A candidate that was tried, and errors over all training cases.

Shares of the tolerances, and what was tried on the way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pgmp_petsc.bench.cases import Setting, Training
from pgmp_petsc.results.selection import Attempt
from pgmp_petsc.scene.numerics import Reduction


@dataclass(frozen=True)
class Errors:
    """Errors of one kind over all training cases."""

    # shares of the outputs' largest values, shape (n_loads, n_outputs, n_samples); NaN where a case does not count
    values: np.ndarray
    round_off: np.ndarray  # what of it is below what counts as zero: errors as small are round-off; the same shape
    # loads, outputs: names
    loads: tuple[str, ...]
    outputs: tuple[str, ...]
    training: Training  # the cases

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
    """A candidate that was tried."""

    # reduction, n_steps: what it is
    reduction: Reduction
    n_steps: int
    errors: Errors  # against the full-order model with the same step
    reason: str  # why it could not be built or run; empty where it could
    seconds: float  # wall time of build and runs
    built: bool  # whether it could be built

    def at(self, n_steps: int) -> Setting:
        """Return it as a setting, with so many steps."""
        return Setting("reduced", n_steps, reduction=self.reduction)

    @property
    def setting(self) -> Setting:
        """It as a setting."""
        return self.at(self.n_steps)


# Of the tolerance. Those of the reduction, and the step's, are half of it each: a factor of two to spare for what took
# no part in the training; with equal tolerances the parts together are within it even where all are largest at once.
BASIS, INTERPOLATION, STEP = 0.35, 0.15, 0.5
REDUCTION = BASIS + INTERPOLATION
BASIS_ALONE = 0.45  # of the tolerance, where no basis does with its share: nearly all that both have together


def shares_of(fixed_grid: bool) -> dict[str, float]:
    """Return the shares of the reduction's tolerance; with fixed angles, interpolation is part of the basis's error."""
    return {"basis": REDUCTION} if fixed_grid else {"basis": BASIS, "interpolation": INTERPOLATION}


def shares_shifted() -> dict[str, float]:
    """Return the shares of the reduction's tolerance where the basis needs what more angles can spare."""
    return {"basis": BASIS_ALONE, "interpolation": REDUCTION - BASIS_ALONE}


@dataclass
class Ledger:
    """Attempts in their order, and reasons of what was chosen, by dotted name."""

    attempts: list[Attempt] = field(default_factory=list)
    reasons: dict[str, str] = field(default_factory=dict)

    def add_trial(self, part: str, keys: tuple[str, ...], trial: Trial, errors: Errors, cost: float = 0.0) -> None:
        """Note a candidate; `errors` are those that count for the part."""
        entries = {key: getattr(trial.reduction, key) for key in keys}
        self._add(part, entries, trial.n_steps, errors, cost, trial.seconds, trial.reason)

    def add_step(self, entries: Mapping[str, Any], n_steps: int, errors: Errors) -> None:
        """Note a step."""
        self._add("step", entries, n_steps, errors, 0.0, 0.0, "")

    def best(self, part: str) -> Attempt | None:
        """Return the attempt with the smallest error; of candidates, among those with the step of the last one."""
        of_part = [attempt for attempt in self.attempts if attempt.part == part]
        tried = [attempt for attempt in of_part if np.isfinite(attempt.largest)]
        if part != "step":
            tried = [attempt for attempt in tried if attempt.n_steps == of_part[-1].n_steps]
        return min(tried, key=lambda attempt: attempt.largest) if tried else None

    def _add(self, part, entries, n_steps, errors: Errors, cost, seconds, reason) -> None:
        # what is looked at again, under more loads, takes the place of the first look
        self.attempts = [a for a in self.attempts if (a.part, a.entries, a.n_steps) != (part, entries, n_steps)]
        self.attempts.append(
            Attempt(part, entries, n_steps, errors.by_output, errors.largest, errors.where, cost, seconds, reason)
        )
