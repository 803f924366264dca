"""The balance of energy of many samples, summed up while they run; `results.balance` has that of one run's history."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.energies import Energies


class RunningBalance:
    """Works of the effects so far, of n samples side by side."""

    def __init__(self) -> None:
        self._first: Energies | None = None
        self._done: dict[str, np.ndarray] = {}

    def add(self, time: float, now: Energies) -> tuple[np.ndarray, np.ndarray]:
        """Take in the energies at the next instant, s; return the residual and what was moved around, (n,), J."""
        if self._first is None:
            self._first, self._done = now, {name: np.zeros_like(power) for name, power in now.powers.items()}
        else:
            half = 0.5 * (time - self._time)
            for name, power in now.powers.items():
                self._done[name] = self._done[name] + half * (self._last.powers[name] + power)
        self._time, self._last = time, now
        work = dict(self._done)
        for name, stored in now.potential.items():
            work[name] = work.get(name, 0.0) + self._first.potential[name] - stored
        kinetic, strain = now.kinetic - self._first.kinetic, now.strain - self._first.strain
        moved = np.abs(kinetic) + np.abs(strain) + sum(np.abs(done) for done in work.values())
        return kinetic + strain - sum(work.values()), 0.5 * moved
