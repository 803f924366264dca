"""Shares of the tolerances, and what was tried on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pgmp_petsc.results.selection import Attempt
from pgmp_petsc.selection.trial import Errors, Trial

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
