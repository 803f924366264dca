"""The fields that a body in a floating frame keeps: its lowest modes, and what they miss of static answers."""

import numpy as np
import pytest

from pgmp_petsc.components.condensing import _answering


@pytest.mark.parametrize("n_modes", [2, 3, 5])
def test_modes_of_one_frequency_are_kept_whichever_way_the_solver_turned_them(n_modes: int) -> None:
    """A round bar bends about two axes alike; a basis that ended between them moved runs by 8e-5 from processor to
    processor."""
    random = np.random.default_rng(4)
    values = np.array([0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 3.0, 4.0, 4.0, 5.0, 6.0])
    vectors, loads = np.linalg.qr(random.normal(size=(11, 11)))[0], random.normal(size=(11, 2))
    turned = vectors.copy()
    cos, sin = np.cos(0.7), np.sin(0.7)
    for pair in ([4, 5], [7, 8]):
        turned[:, pair] = vectors[:, pair] @ [[cos, -sin], [sin, cos]]
    spans = []
    for modes in (vectors, turned):
        fields = _answering(values, modes, loads, 3, n_modes, by_energy=False)
        spans.append(fields @ np.linalg.pinv(fields))
    np.testing.assert_allclose(spans[1], spans[0], atol=1e-12)
