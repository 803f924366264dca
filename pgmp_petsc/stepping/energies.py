"""Energies and powers of a model at an instant, or at those of a run, from which its balance is drawn up.

The balance of energy of many samples, summed up while they run; `results.estimates` has that of one run's history.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Energies:
    """Energies of a system, of n samples at one instant or of one sample at n instants."""

    #: kinetic, strain: shape (n,), J
    kinetic: np.ndarray
    strain: np.ndarray
    #: potential energy of each effect that has one, by its name, shape (n,), J
    potential: dict[str, np.ndarray] = field(default_factory=dict)
    #: power of each effect but for what is in its potential energy, by its name, shape (n,), W
    powers: dict[str, np.ndarray] = field(default_factory=dict)

    def add_potential(self, effect: str, energy: np.ndarray) -> None:
        """Add to the potential energy of an effect."""
        self.potential[effect] = self.potential.get(effect, 0.0) + energy

    def add_power(self, effect: str, power: np.ndarray) -> None:
        """Add to the power of an effect."""
        self.powers[effect] = self.powers.get(effect, 0.0) + power

    def __getitem__(self, chosen: slice) -> Energies:
        """Return those of some samples or instants."""
        return Energies(
            self.kinetic[chosen],
            self.strain[chosen],
            {name: values[chosen] for name, values in self.potential.items()},
            {name: values[chosen] for name, values in self.powers.items()},
        )


def joined(parts: Sequence[Energies]) -> Energies:
    """Return the energies of one sample over the instants of all parts, one after the other."""
    first = parts[0]
    return Energies(
        np.concatenate([part.kinetic for part in parts]),
        np.concatenate([part.strain for part in parts]),
        {name: np.concatenate([part.potential[name] for part in parts]) for name in first.potential},
        {name: np.concatenate([part.powers[name] for part in parts]) for name in first.powers},
    )


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
