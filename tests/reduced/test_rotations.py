"""Rotations by a vector: against scipy, and their change against differences, small angles and large ones."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pgmp_petsc.reduced.action_frames import factors_of, rotation_of, spin_of


def rotation(phi: np.ndarray) -> np.ndarray:
    turn = np.empty((3, 3))
    rotation_of(phi, factors_of(phi), turn)
    return turn


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.0999, 0.1001, 1.3, 3.0])
def test_rotation_and_spin(angle: float) -> None:
    phi = angle * np.array([0.48, -0.6, 0.64])
    rate, h, spin = np.array([0.3, 0.7, -0.2]), 1e-6, np.empty(3)
    np.testing.assert_allclose(rotation(phi), Rotation.from_rotvec(phi).as_matrix(), rtol=0, atol=1e-15)
    spin_of(phi, factors_of(phi), rate, spin)
    change = rotation(phi).T @ (rotation(phi + h * rate) - rotation(phi - h * rate)) / (2 * h)
    np.testing.assert_allclose(spin, [change[2, 1], change[0, 2], change[1, 0]], rtol=0, atol=1e-9)
