"""What an eigenproblem finds at one configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ModeSet:
    """Rigid and flexible modes at one configuration, local rows, in body frames.

    Attributes
    ----------
    theta
        The configuration, shape (n_theta,), rad.
    eigenvalues
        Of the flexible modes, ascending, shape (n_modes,), (rad/s)^2.
    rigid
        ``d rho / d theta``, shape (n_local, n_theta).
    rigid_curvature
        ``d2 rho / d theta2``, shape (n_local, n_theta, n_theta).
    flexible
        M-orthonormal at the parameters of the problem and M-orthogonal to the free columns of `rigid`, shape (n_local,
        n_modes).
    free
        Numbers of the coordinates that are not prescribed.
    """

    theta: np.ndarray
    eigenvalues: np.ndarray
    rigid: np.ndarray
    rigid_curvature: np.ndarray
    flexible: np.ndarray
    free: np.ndarray

    @property
    def eigenvectors(self) -> np.ndarray:
        """All vectors of the eigenproblem, those of its zero eigenvalues first, shape (n_local, n_free + n_modes)."""
        return np.hstack([self.rigid[:, self.free], self.flexible])

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Eigenfrequencies, shape (n_modes,)."""
        return np.sqrt(np.maximum(self.eigenvalues, 0.0)) / (2 * np.pi)
