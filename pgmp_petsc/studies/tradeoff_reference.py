"""The reference with a step that is halved until it no longer matters.

The reference is fine enough where its last halving moved every output by less than a tenth of the smallest error
that any setting has against it. For an integrator of order two, what remains is then a third of that move.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.experiments.history import History, largest_errors

SHARE = 0.1
ORDER = 2
ROUND_OFF = 1e-12  # a move that small is none
MOST_AT_ONCE = 3  # halvings that are asked for together: a prediction by the order is no more than that


class ReferenceSequence:
    """Runs of a reference on one mesh, with steps that are halved.

    Parameters
    ----------
    first
        Number of steps of the coarsest run.
    most
        Number of steps of the finest run that is allowed.
    floors
        Below which outputs count as zero, in their units, shape (n_outputs,).
    """

    def __init__(self, first: int, most: int, floors: np.ndarray) -> None:
        self._first, self._most, self._floors = first, max(most, 2 * first), floors
        self._runs: dict[int, History] = {}
        self._failure = ""

    def add(self, n_steps: int, run: History) -> None:
        """Take in a run; the one with twice its steps comes next."""
        self._runs[n_steps] = run

    def give_up(self, reason: str) -> None:
        """Refine no further: a finer run failed."""
        self._failure = reason

    @property
    def usable(self) -> bool:
        """Whether there are two runs, so that one can tell how fine the finest is."""
        return len(self._runs) > 1

    @property
    def failure(self) -> str:
        """Why it was given up; empty where it was not."""
        return self._failure

    @property
    def n_steps(self) -> int:
        """Steps of the finest run."""
        return max(self._runs)

    @property
    def history(self) -> History:
        """The finest run."""
        return self._runs[self.n_steps]

    @property
    def moved(self) -> np.ndarray:
        """By how much the last halving moved each output, as `largest_errors`, shape (n_outputs,)."""
        return largest_errors(self._runs[self.n_steps // 2], self.history, self._floors)

    def wanted(self, smallest: np.ndarray) -> list[int]:
        """Return the numbers of steps that are missing until the reference is fine enough, as far as one can tell.

        Parameters
        ----------
        smallest
            Smallest error of any setting in each output, shape (n_outputs,); infinite or NaN where there is none.
        """
        if self._failure:
            return []
        if not self.usable:
            return [self._first, 2 * self._first]
        if self.settled(smallest):
            return []
        halvings = np.ceil(np.log(self._excess(smallest)) / np.log(2**ORDER))
        finer = [self.n_steps * 2**k for k in range(1, int(np.clip(halvings, 1, MOST_AT_ONCE)) + 1)]
        return [n for n in finer if n <= self._most]

    def settled(self, smallest: np.ndarray) -> bool:
        """Whether the last halving moved every output by less than a tenth of its smallest error."""
        return not self._excess(smallest) >= 1.0

    def reason(self, smallest: np.ndarray) -> str:
        """Say why the step is not halved again."""
        if self._failure:
            return f"a finer run failed: {self._failure}"
        if self.settled(smallest):
            return f"the last halving moved no output by {SHARE:g} of its smallest error"
        return "the finest step that is allowed"

    def _excess(self, smallest: np.ndarray) -> float:
        """Return the move over the allowed one, the largest of any output."""
        wanted = SHARE * np.where(np.isnan(smallest), np.inf, smallest)
        known = np.isfinite(self.moved) & (self.moved > ROUND_OFF)
        with np.errstate(divide="ignore"):
            return float(np.max(self.moved[known] / wanted[known], initial=0.0))
