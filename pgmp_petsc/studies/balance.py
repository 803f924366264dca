"""The balance of energy of a run, drawn up from what its model knew at every step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import cumulative_trapezoid

from pgmp_petsc.dynamics.energies import Energies
from pgmp_petsc.results.balance import Balance


def balance_of(time: np.ndarray, instants: Sequence[Energies]) -> Balance:
    """Draw up the balance of the first sample from its energies at all times (n_t,), s."""

    def history(part: str, name: str) -> np.ndarray:
        return np.array([float(np.ravel(getattr(instant, part)[name])[0]) for instant in instants])

    work: dict[str, np.ndarray] = {}
    potential = np.zeros(len(time))
    for name in instants[0].potential:
        stored = history("potential", name)
        potential += stored
        work[name] = stored[0] - stored
    for name in instants[0].powers:
        done = cumulative_trapezoid(history("powers", name), time, initial=0.0)
        work[name] = work.get(name, 0.0) + done
    kinetic, strain = (
        np.array([float(np.ravel(getattr(instant, part))[0]) for instant in instants]) for part in ("kinetic", "strain")
    )
    return Balance(kinetic, strain, potential, work)
