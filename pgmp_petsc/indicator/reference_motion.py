"""The motion of all unknowns that a reduced run stands for, with its velocities and accelerations.

A reduced state gives the unknowns ``q(eta)`` by back-transformation (`NodalMotion`). The velocities and accelerations
that belong to it are the derivatives along the path ``eta + tau eta' + 1/2 tau^2 eta''`` at tau = 0, taken as
differences of fourth order. All of the chain rule is in them, also what the reduced equations leave out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Unknowns = Callable[[np.ndarray], np.ndarray]  # reduced coordinates (k, n_eta) to unknowns (n_dofs, k)

# rad that a rigid coordinate turns from point to point: a difference is wrong by TURN^4 / 90 of the acceleration, and
# by the closure of the mechanism, 1e-12, over TURN^2
TURN = 1e-2
FIRST = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
SECOND = {-2: -1 / 12, -1: 16 / 12, 0: -30 / 12, 1: 16 / 12, 2: -1 / 12}
LARGEST = 2**22  # numbers that are kept at once


@dataclass(frozen=True)
class Instant:
    """Motion at one instant; all of shape (n_dofs, n_samples).

    Attributes
    ----------
    q, v, a
        Unknowns, velocities and accelerations that belong together.
    shaken
        Unknowns with what the vibrations lack.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    shaken: np.ndarray


class ReferenceMotion:
    """Motion at the instants of evaluation.

    Parameters
    ----------
    unknowns
        Back-transformation.
    states
        Reduced coordinates, velocities, accelerations and missing vibrations at every instant, shape (n_instants, 4,
        n_samples, n_eta).
    n_theta
        Number of rigid coordinates.
    longest
        Largest step of the differences of every sample, shape (n_samples,), s: the bodies' own vibrations set it where
        the mechanism does not turn.
    """

    def __init__(self, unknowns: Unknowns, states: np.ndarray, n_theta: int, longest: np.ndarray) -> None:
        self._unknowns, self._states = unknowns, states
        self._n_theta, self._longest = n_theta, longest
        self._n_dofs, self._first, self._kept = 0, 0, (np.empty(0),) * 4

    def at(self, number: int) -> Instant:
        """Return an instant by its number; consecutive ones are computed together."""
        if not self._first <= number < self._first + len(self._kept[0]):
            self._compute(number)
        return Instant(*(part[number - self._first] for part in self._kept))

    def _compute(self, number: int) -> None:
        n_samples, r = self._states.shape[2], self._n_theta
        n_dofs = self._n_dofs = self._n_dofs or self._evaluate(self._states[:1, 0]).shape[1]
        n_instants = max(1, LARGEST // (len(SECOND) * n_dofs * n_samples))
        q, v, a, vibration = np.moveaxis(self._states[number : number + n_instants], 1, 0)
        pace = np.max(v[..., :r] ** 2 + TURN * np.abs(a[..., :r]), axis=-1)
        tau = (TURN / np.sqrt(np.maximum(pace, (TURN / self._longest) ** 2)))[..., None]
        along = [q + at * tau * v + 0.5 * (at * tau) ** 2 * a for at in FIRST]
        here, shaken, *there = self._evaluate(np.array([q, q + vibration, *along]))
        first, second = np.zeros_like(here), SECOND[0] * here
        for (at, weight), moved in zip(FIRST.items(), there):
            first += weight * moved
            second += SECOND[at] * moved
        span = np.moveaxis(tau, 2, 1)
        self._first, self._kept = number, (here, first / span, second / span**2, shaken)

    def _evaluate(self, eta: np.ndarray) -> np.ndarray:
        """Return unknowns (..., n_dofs, n_samples) for reduced coordinates (..., n_samples, n_eta)."""
        found = self._unknowns(eta.reshape(-1, eta.shape[-1]))
        return np.moveaxis(found.reshape(-1, *eta.shape[:-1]), 0, -2)
