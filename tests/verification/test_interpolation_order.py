"""Errors of the slider-crank's interpolated tables over angle spacing, against fresh eigenproblems between samples."""

from functools import lru_cache

import numpy as np
import pytest
from runs import rom_of

from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from scenes import slider_crank

BASIS = ("reduction.modes=3", "reduction.static_modes=true", "reduction.inertia_modes=true")
TABLES = ("mass", "stiffness", "inertia")
FINE = 1540  # five times 308: places all over the cells, for the Overhauser error vanishes in their middle


@lru_cache
def built(n: int) -> ReducedOrderModel:
    """Return the reduced model at n angles; even samples are the same for all schemes of a revolution."""
    return rom_of(slider_crank(*BASIS, f"reduction.angles={n}", 'reduction.interpolation="spline"'))


def errors(scheme: str, n: int) -> np.ndarray:
    """Return the largest error of every table, each entry over its own largest value, at 770 angles."""
    between, found = built(FINE).tables, []
    theta = between.samples.axes[0].theta[1::2]
    for name in TABLES:
        exact = getattr(between, name)[1::2]
        size = np.abs(exact).max(axis=0)
        size = np.where(size > 1e-8 * size.max(), size, np.inf)  # entries that are zero but for round-off
        tables = built(n).tables
        found.append(
            (np.abs(interpolant(tables.samples.axes[0], getattr(tables, name), scheme)(theta) - exact) / size).max()
        )
    return np.array(found)


@pytest.mark.parametrize(("scheme", "order"), [("overhauser", 3.0), ("spline", 4.0)])
def test_the_order_in_the_angle_spacing(scheme: str, order: float) -> None:
    """Measured from 154 to 308 angles: 3.03 to 3.23, and 4.14 to 4.28; from 77 to 154 3.3 to 3.5, and 4.5 to 5.4."""
    orders = np.log2(errors(scheme, 154) / errors(scheme, 308))
    assert np.all(np.abs(orders - order) < 0.4), orders


def test_spectral_errors_fall_faster_than_any_power() -> None:
    """From 48 to 64 to 96 to 128 to 192 angles: observed orders of 4.3, 7.5, 8.7 and 12.4."""
    n = np.array([48, 64, 96, 128, 192])
    worst = np.array([errors("spectral", k).max() for k in n])
    orders = -np.diff(np.log(worst)) / np.diff(np.log(n))
    assert np.all(orders > 4.0) and orders[-1] > 10.0, orders
    assert worst[-1] < 1e-5
