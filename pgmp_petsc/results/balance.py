"""The balance of energy of a run.

    kinetic + strain = (kinetic + strain at the start) + sum over effects of their work + residual

An effect's work is the loss of its potential energy, if it has one, and the integral over time of its other power,
taken by the trapezoidal rule over the steps: the residual falls with the square of the step, and so does the scheme's
numerical damping, which is part of it.

Layout within a trajectory file:

============================= ========== ===========================================================================
dataset                       shape      content
============================= ========== ===========================================================================
``/energy/kinetic``           (n_t)      J
``/energy/strain``            (n_t)      J
``/energy/potential``         (n_t)      of weights, springs and stops, J
``/energy/residual``          (n_t)      J; attribute ``exchanged``: the most that was moved around at any time, J
``/work/<effect>``            (n_t)      work done by each effect since the start, J
============================= ========== ===========================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.results.layout import check_shape, take_named
from pgmp_petsc.runtime.files import put, take

if TYPE_CHECKING:
    import h5py

#: What an ensemble keeps of the balance of every sample: name, unit and description.
BALANCE = {
    "residual": ("J", "largest residual of the balance of energy over the run"),
    "exchanged": ("J", "the most energy that was moved around at any time"),
}

RESOLVED = 8  # steps that a change of energy takes at least; faster ones are what a balance is to show


@dataclass(frozen=True)
class Balance:
    """The balance of energy of one run.

    Attributes
    ----------
    kinetic, strain, potential
        Shape (n_t,), J.
    work
        Work of each effect since the start, by its name, shape (n_t,), J.
    """

    kinetic: np.ndarray
    strain: np.ndarray
    potential: np.ndarray
    work: dict[str, np.ndarray]

    def __post_init__(self) -> None:
        for name, values in {"strain": self.strain, "potential": self.potential, **self.work}.items():
            check_shape(f"energy '{name}'", values, self.kinetic.shape)

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

    def write(self, file: h5py.File) -> None:
        """Write the groups ``energy`` and ``work``."""
        put(file, "energy/kinetic", self.kinetic, "J", "kinetic energy")
        put(file, "energy/strain", self.strain, "J", "strain energy")
        put(file, "energy/potential", self.potential, "J", "potential energy of weights, springs and stops")
        residual = put(
            file, "energy/residual", self.residual, "J", "gain of kinetic and strain energy less the effects' work"
        )
        residual.attrs["exchanged"] = self.exchanged
        for name, done in self.work.items():
            put(file.require_group("work"), name, done, "J", f"work of effect '{name}' since the start")

    @classmethod
    def read(cls, file: h5py.File) -> Balance | None:
        """Read what `write` wrote; None where there is nothing."""
        if "energy" not in file:
            return None
        parts = (take(file, f"energy/{name}", 1) for name in ("kinetic", "strain", "potential"))
        return cls(*parts, take_named(file, "work", 1) if "work" in file else {})
