"""The nodal motion that a reduced run stands for, with its accelerations.

A reduced state gives the positions ``q(eta)`` by back-transformation. The accelerations that belong to it are the
second derivative along the path ``eta + tau eta' + 1/2 tau^2 eta''`` at tau = 0, taken as a difference of fourth order.
All of the chain rule is in it, also what the reduced equations leave out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Frames = Callable[[np.ndarray], np.ndarray]  # reduced coordinates (k, n_eta) to frames of some nodes (n_nodes, 3, k)

# rad that the rigid coordinate turns from point to point: a difference is wrong by TURN^4 / 90 of the acceleration, and
# by the closure of the mechanism, 1e-12, over TURN^2
TURN = 1e-2
DIFFERENCE = {-2: -1 / 12, -1: 16 / 12, 0: -30 / 12, 1: 16 / 12, 2: -1 / 12}
LARGEST = 2**22  # numbers that are kept at once


@dataclass(frozen=True)
class Instant:
    """Nodal motion at one instant.

    Attributes
    ----------
    q, a
        Positions and accelerations that belong together, each of shape (n_dofs, n_samples).
    shaken
        Positions of the outputs' nodes with what the vibrations lack, shape (3 n_nodes, n_samples).
    """

    q: np.ndarray
    a: np.ndarray
    shaken: np.ndarray


class ReferenceMotion:
    """Nodal motion at the instants of evaluation.

    Parameters
    ----------
    frames, output_frames
        Back-transformation of all nodes and of those of the outputs.
    states
        Reduced coordinates, velocities, accelerations and missing vibrations at every instant, shape (n_instants, 4,
        n_samples, n_eta).
    longest
        Largest step of the differences of every sample, shape (n_samples,), s: the bodies' own vibrations set it where
        the mechanism does not turn.
    """

    def __init__(self, frames: Frames, output_frames: Frames, states: np.ndarray, longest: np.ndarray) -> None:
        self._frames, self._output_frames = frames, output_frames
        self._states = states
        self._longest = longest
        self._first, self._kept = 0, (np.empty(0),) * 3

    def at(self, number: int) -> Instant:
        """Return an instant by its number; consecutive ones are computed together."""
        if not self._first <= number < self._first + len(self._kept[0]):
            self._compute(number)
        return Instant(*(part[number - self._first] for part in self._kept))

    def _compute(self, number: int) -> None:
        n_samples = self._states.shape[2]
        n_dofs = _nodal(self._frames, self._states[:1, 0]).shape[1]
        n_instants = max(1, LARGEST // (3 * n_dofs * n_samples))
        q, v, a, vibration = np.moveaxis(self._states[number : number + n_instants], 1, 0)
        pace = np.maximum(v[..., 0] ** 2 + TURN * np.abs(a[..., 0]), (TURN / self._longest) ** 2)
        tau = (TURN / np.sqrt(pace))[..., None]
        here = _nodal(self._frames, q)
        second = DIFFERENCE[0] * here
        for at in (-2, -1, 1, 2):
            second += DIFFERENCE[at] * _nodal(self._frames, q + at * tau * v + 0.5 * (at * tau) ** 2 * a)
        second /= np.moveaxis(tau, 2, 1) ** 2
        self._first, self._kept = number, (here, second, _nodal(self._output_frames, q + vibration))


def _nodal(frames: Frames, eta: np.ndarray) -> np.ndarray:
    """Return nodal unknowns (k, n_dofs, n_samples) for reduced coordinates (k, n_samples, n_eta)."""
    return np.moveaxis(frames(eta.reshape(-1, eta.shape[2])).reshape(-1, *eta.shape[:2]), 0, 1)
