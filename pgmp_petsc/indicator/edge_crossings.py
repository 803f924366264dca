"""Where in its steps a run crosses edges of laws, such as the contact with an end stop.

A run goes up to an edge and on from there (`dynamics.event_location`), but is seen at the ends of its steps only. Over
an edge accelerations bend, and a polynomial through values on both sides of it is no better than the run: what it gets
wrong is a kick of the square of the step, as large as what the run does to the motion inside the contact. An edge lies
where the depth, taken for linear over the step, is zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.models import ReducedModel
from pgmp_petsc.models.reduced import unsettled

NONE = 2.0  # share of a step in which no edge is crossed


class EdgeCrossings:
    """Crossings of n samples of a reduced model, from the start of a run on.

    Parameters
    ----------
    model
        The reduced model.
    values
        Parameter values of the samples, each of shape (n,).
    start
        Reduced coordinates, velocities and accelerations at the start, shape (3, n, n_eta).

    Attributes
    ----------
    shortest
        Shortest time that each sample has been beyond an edge, infinite where it has not been and returned, shape (n,).
    """

    def __init__(self, model: ReducedModel, values: Mapping[str, np.ndarray], start: np.ndarray) -> None:
        self._system = unsettled(model, values, start.shape[1]) if model.actions.edges else None
        self.shortest = np.full(start.shape[1], np.inf)
        if self._system is not None:
            self._time, self._before = 0.0, self._system.depths_over(np.zeros(1), start[None])
            self._entered = np.full(self._before.shape[1:], -np.inf)

    def over(self, times: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Take in the next steps.

        Parameters
        ----------
        times, motion
            Ends of the steps (s), and coordinates, velocities and accelerations there, shape (n_steps, 3, n, n_eta).

        Returns
        -------
        ndarray, shape (n_steps, n)
            Share of each step that lies before the first edge crossed in it; `NONE` where there is none.
        """
        if self._system is None:
            return np.full((len(motion), motion.shape[2]), NONE)
        depths = np.concatenate([self._before, self._system.depths_over(times, motion)])
        instants = np.concatenate([[self._time], times])
        self._time, self._before = times[-1], depths[-1:]
        here, there = depths[:-1], depths[1:]
        crossed = (here > 0.0) != (there > 0.0)
        shares = np.divide(here, here - there, out=np.full_like(here, NONE), where=crossed)
        for step, sample, edge in np.argwhere(crossed):
            time = instants[step] + shares[step, sample, edge] * (instants[step + 1] - instants[step])
            if there[step, sample, edge] > 0.0:
                self._entered[sample, edge] = time
            else:
                self.shortest[sample] = min(self.shortest[sample], time - self._entered[sample, edge])
        return np.min(shares, axis=2)
