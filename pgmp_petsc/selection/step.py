"""The time step that a tolerance allows, from runs with steps that are halved.

A run with n steps is compared with one of `AHEAD` n steps. That is enough, wherever the step stands: where it is coarse for
a vibration, the scheme damps it and the finer run has it; where it resolves it, the finer run has a sixty-fourth of the
error. A comparison with half the step would not do: both runs may lack a vibration that the loads set off, or have it in
a wrong phase, and differ by less than their error. Nothing damps vibrations in a scene, so that their phase errors add up
over the run, and only steps far below a hundredth of their period bring them down with the square of the step.

Where the differences of three halvings in a row fall as an error of order two or nearly so (each by `FALL` at least),
the error of the finest run follows from the last two (Richardson), and no runs `AHEAD` times as fine are needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

AHEAD = 8
FALL = 3.0
ORDER = 2
FIRST_PER_PERIOD = 4  # steps of the coarsest run a period of the first flexible mode
MOST_PER_PERIOD = 1024
FEWEST = 64


@dataclass
class StepSearch:
    """Search for the fewest steps that keep an error.

    Parameters
    ----------
    compare
        Returns how far runs with two numbers of steps are apart, shape (n_outputs,).
    first
        Steps of the coarsest run.
    allowed
        Largest error that is allowed.
    """

    compare: Callable[[int, int], np.ndarray]
    first: int
    allowed: float
    chosen: int | None = None
    error: float = np.inf
    finest: int = 0
    tried: list[tuple[int, np.ndarray]] = field(default_factory=list)
    _moved: list[np.ndarray] = field(default_factory=list)

    def advance(self, most: int) -> None:
        """Halve the step until it is found or the next run would have more than `most` steps."""
        if self.finest == 0:
            self.finest = self.first
        while self.chosen is None and 2 * self.finest <= most:
            self.finest *= 2
            self._moved.append(self.compare(self.finest // 2, self.finest))
            if self.finest >= AHEAD * self.first:
                self._look_ahead()
            if self.chosen is None:
                self._extrapolate()

    @property
    def last_move(self) -> np.ndarray:
        """By how much the last halving moved every output, shape (n_outputs,)."""
        return self._moved[-1]

    def _look_ahead(self) -> None:
        n_steps = self.finest // AHEAD
        errors = self.compare(n_steps, self.finest)
        self.tried.append((n_steps, errors))
        if errors.max() <= self.allowed:
            self.chosen, self.error = n_steps, float(errors.max())

    def _extrapolate(self) -> None:
        if len(self._moved) < 3 or not all(np.isfinite(move).all() for move in self._moved[-3:]):
            return
        before, last = self._moved[-2], self._moved[-1]
        # what is far below the tolerance need not fall any more
        small = last <= 0.01 * self.allowed
        falls = (self._moved[-3] >= FALL * before) & (before >= FALL * last)
        if not np.all(small | falls):
            return
        errors = last / (2**ORDER - 1)
        error = float(errors.max())
        wanted = max(1, int(np.ceil(self.finest * np.sqrt(error / self.allowed))))
        # not beyond what was seen to be of this order
        if wanted <= 2 * self.finest:
            self.chosen = max(wanted, self.finest // 4)
            self.error = error * (self.finest / self.chosen) ** ORDER
            self.tried.append((self.finest, errors))


def step_of(duration: float, n_steps: int) -> float:
    """Return a step of three digits (s) that makes n_steps steps or a little more."""
    step = duration / n_steps
    digits = 10.0 ** (np.floor(np.log10(step)) - 2)
    return float(f"{np.floor(step / digits * (1 + 1e-9)) * digits:.3g}")
