"""From configurations of several coordinates to those of one, until the kinematics takes both."""

from __future__ import annotations

import numpy as np


def as_coordinates(theta: np.ndarray) -> np.ndarray:
    """Return configurations (n, n_theta) as the kinematics takes them: of shape (n,) for one coordinate."""
    return theta[:, 0] if theta.shape[1] == 1 else theta
