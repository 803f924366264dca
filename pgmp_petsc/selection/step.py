"""The time step that a tolerance allows, from runs with steps that are halved.

A run with n steps is compared with one of `AHEAD` n steps, and of `SEEN` times the first number at least. That is
enough, wherever the step stands: where it is coarse for a vibration, the scheme damps it and the finer run has it;
where it resolves it, the finer run has a sixty-fourth of the error. A comparison with half the step would not do: both
runs may lack a vibration that the loads set off, or have it in a wrong phase, and differ by less than their error.
Nothing damps vibrations in a scene, so that their phase errors add up over the run, and only steps far below a
hundredth of their period bring them down with its square.

What is chosen may be coarser than any run that is halved: where a load sets off little, the rigid motion alone wants
steps, and errors against a run that sees the vibrations tell so. Longer steps are tried after the first ones were good
enough, never instead: at few instants a vibration is seen smaller than it is.

Where runs of `RESOLVED` times the first number of steps are at hand and the differences of halvings fall by `FALLS` at
least, the error of the finest run follows from the last two as the rest of a geometric series (for an error of order
two, Richardson's third of the last difference), and no runs `AHEAD` times as fine are needed. With fewer steps they may
fall so before a vibration is seen at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

AHEAD = 8
SEEN = 16  # 64 steps a period of the first flexible mode: ten times its frequency is not damped within some periods
RESOLVED = 32
FALLS = (1.5, 2.0)
ORDER = 2
FIRST_PER_PERIOD = 4  # steps of the first run that is halved, a period of the first flexible mode
COARSEST_PER_PERIOD = 1  # steps of the coarsest run that may be chosen
MOST_PER_PERIOD = 1024
MOST_ANYWAY = 65536  # steps that are tried however few periods a run has
FEWEST = 64  # steps of a run: its largest values over time are known at so many instants


@dataclass
class StepSearch:
    """Search for the fewest steps that keep an error.

    Parameters
    ----------
    compare
        Returns how far runs with two numbers of steps are apart, shape (n_outputs,).
    first
        Steps of the coarsest run that is halved.
    allowed
        Largest error that is allowed.
    coarsest
        Steps of the coarsest run that may be chosen; `first` is a power of two times it.
    """

    compare: Callable[[int, int], np.ndarray]
    first: int
    allowed: float
    coarsest: int
    chosen: int | None = None
    error: float = np.inf
    finest: int = 0
    _next: int = 0
    _moved: list[np.ndarray] = field(default_factory=list)

    def advance(self, most: int) -> None:
        """Halve the step until it is found or the next run would have more than `most` steps."""
        if self.finest == 0:
            self.finest = self._next = self.first
        while self.chosen is None and 2 * self.finest <= most:
            self.finest *= 2
            self._moved.append(self.compare(self.finest // 2, self.finest))
            while self.chosen is None and self.finest >= fine_enough(self._next, self.first):
                self._look_ahead()
            if self.chosen is None and self.finest >= RESOLVED * self.first:
                self._extrapolate()

    def settle_for_finest(self) -> None:
        """Take the finest run, at the end, where its halving moved little and less than half of the one before.

        What further halvings would move is then no more than that, in all.
        """
        if self.chosen is None and self.finest >= RESOLVED * self.first:
            before, last = self._moved[-2:]
            if np.isfinite(before).all() and np.all((last <= 0.01 * self.allowed) | (before >= FALLS[1] * last)):
                error = float(last.max())
                if error <= self.allowed:
                    self.chosen, self.error = self.finest, error

    def _look_ahead(self) -> None:
        error = float(self.compare(self._next, self.finest).max())
        if error <= self.allowed:
            self.chosen, self.error = self._next, error
            if self._next == self.first:
                self._lengthen()
        self._next *= 2

    def _lengthen(self) -> None:
        """Take longer steps than the first ones, as long as they are good enough."""
        while self.chosen > self.coarsest:
            error = float(self.compare(self.chosen // 2, self.finest).max())
            if not error <= self.allowed:
                break
            self.chosen, self.error = self.chosen // 2, error

    def _extrapolate(self) -> None:
        first, before, last = self._moved[-3:]
        # what is far below the tolerance need not fall any more
        small = last <= 0.01 * self.allowed
        fall = (first >= FALLS[0] * before) & (before >= FALLS[1] * last)
        if not np.isfinite(first).all() or not np.all(small | fall):
            return
        falls = np.divide(before, last, out=np.full(last.shape, 2.0**ORDER), where=last > 0.0)
        error = float(np.max(last / (np.clip(falls, FALLS[1], 2.0**ORDER) - 1.0)))
        wanted = int(np.ceil(self.finest * np.sqrt(error / self.allowed)))
        # not beyond what was seen to be of this order
        if wanted <= 2 * self.finest:
            self.chosen = max(wanted, self.finest // 4)
            self.error = error * (self.finest / self.chosen) ** ORDER


def fine_enough(n_steps: int, first: int) -> int:
    """Return the steps of a run that shows the error of one with `n_steps` steps."""
    return max(AHEAD * n_steps, SEEN * first)


def first_steps(duration: float, period: float) -> tuple[int, int]:
    """Return the steps of the coarsest run that may be chosen, and of the first one that is halved.

    Parameters
    ----------
    duration, period
        Of the run, and of the first flexible mode, s.
    """
    periods = duration / period
    coarsest = max(int(np.ceil(COARSEST_PER_PERIOD * periods)), FEWEST)
    first = coarsest
    while first < FIRST_PER_PERIOD * periods:
        first *= 2
    return coarsest, first


def step_of(duration: float, n_steps: int) -> float:
    """Return a step of three digits (s) that makes n_steps steps or a little more."""
    step = duration / n_steps
    digits = 10.0 ** (np.floor(np.log10(step)) - 2)
    return float(f"{np.floor(step / digits * (1 + 1e-9)) * digits:.3g}")
