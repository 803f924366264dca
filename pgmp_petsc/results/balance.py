"""The balance of energy of a run.

    kinetic + strain = (kinetic + strain at the start) + sum over effects of their work + residual

An effect's work is the loss of its potential energy, if it has one, and the integral over time of its other power,
taken by the trapezoidal rule over the steps: the residual falls with the square of the step, and so does the scheme's
numerical damping, which is part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.declare.records import Record, array, derived

#: What an ensemble keeps of the balance of every sample: name, unit and description.
BALANCE = {
    "residual": ("J", "largest residual of the balance of energy over the run"),
    "exchanged": ("J", "the most energy that was moved around at any time"),
}

BALANCE_WORDS = {name: {"unit": unit, "about": about} for name, (unit, about) in BALANCE.items()}
RESOLVED = 8  # steps that a change of energy takes at least; faster ones are what a balance is to show


def _energy(name: str, about: str) -> np.ndarray:
    return array("time", unit="J", about=about, at=f"energy/{name}", gaps=True, label=f"energy.{name}")


@dataclass(frozen=True)
class Balance(Record):
    """The balance of energy of one run."""

    kinetic: np.ndarray = _energy("kinetic", "kinetic energy")
    strain: np.ndarray = _energy("strain", "strain energy")
    potential: np.ndarray = _energy("potential", "potential energy of weights, springs and stops")
    work: dict[str, np.ndarray] = array(
        "time", unit="J", about="work of effect '{name}' since the start", gaps=True, label="work.{name}"
    )
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: own.residual, "energy/residual", "time", unit="J",
            about="gain of kinetic and strain energy less the effects' work", label="energy.residual", gaps=True,
        ),
        derived(
            float, lambda own, _: own.exchanged, "energy/residual@exchanged", unit="J",
            about="the most energy that was moved around at any time",
        ),
    )  # fmt: skip

    @property
    def residual(self) -> np.ndarray:
        """What the energies gained that no effect brought, shape (n_t,), J."""
        stored = self.kinetic + self.strain
        return stored - stored[0] - sum(self.work.values(), np.zeros_like(stored))

    @property
    def exchanged(self) -> float:
        """The most energy that had been moved around at any time: half of all changes and works by their amounts, J."""
        moved = np.abs(self.kinetic - self.kinetic[0]) + np.abs(self.strain - self.strain[0])
        return 0.5 * float(np.max(moved + sum((np.abs(done) for done in self.work.values()), np.zeros_like(moved))))

    @property
    def swings(self) -> np.ndarray:
        """How often energy had been turned over at each time, shape (n_t,): changes of the kinetic energy between the
        lowest and the highest quarter of its range, `RESOLVED` steps or more after each other."""
        low, high = np.quantile(self.kinetic, (0.0, 1.0)) @ [[0.75, 0.25], [0.25, 0.75]]
        side = np.where(self.kinetic > high, 1, np.where(self.kinetic < low, -1, 0))
        outer = np.flatnonzero(side)
        changes, last = np.zeros(self.kinetic.size, dtype=int), -RESOLVED
        for k in outer[1:][np.diff(side[outer]) != 0]:
            changes[k], last = k - last >= RESOLVED, k
        return np.cumsum(changes)
