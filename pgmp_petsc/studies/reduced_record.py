"""What a reduced run of one sample keeps while it goes on."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import Observer
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.runtime.progress import Progress


class ReducedRecord(Observer):
    """Keeps all states of a run; one of its observers.

    Parameters
    ----------
    bar
        Counts the steps.
    """

    def __init__(self, bar: Progress) -> None:
        self._bar = bar
        self._times: list[np.ndarray] = []
        self._states: list[np.ndarray] = []

    def __call__(self, number: int, time: float, state: State) -> None:
        """Keep the state after a step."""
        self._keep(np.array([time]), np.array([[state.q, state.v, state.a]]), int(number > 0))

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Keep the states after many steps; see `Observer`."""
        self._keep(times, trail, times.size)

    def _keep(self, times: np.ndarray, trail: np.ndarray, n_steps: int) -> None:
        self._times.append(times.copy())
        self._states.append(trail[:, :, 0].copy())
        self._bar.update(n_steps)

    def history(self) -> tuple[np.ndarray, State]:
        """Return the instants (n_t,) and all states, each of shape (n_t, n_eta)."""
        states = np.moveaxis(np.concatenate(self._states), 1, 0)
        return np.concatenate(self._times), State(*(np.array(part) for part in states), np.zeros(0))
