"""Prescribed motions: angle, speed and acceleration belong together, and end where they should."""

import numpy as np
import pytest

from pgmp_petsc.effects.motion import Motion, PrescribedMotion

ENTRIES = {
    "table": {"table": [[0.1, 0.2], [0.5, 1.0], [0.9, -0.5], [1.4, 0.3]]},
    "harmonic": {"harmonic": {"amplitude": 0.4, "frequency_hz": 1.5, "phase": 0.3, "mean": 0.1}},
    "spin_up": {"spin_up": {"speed": 6.0, "time": 1.2, "start": 0.3}},
    "constant_speed": {"constant_speed": {"speed": -2.0, "start": 0.3}},
}
EDGES = {"table": (0.1, 1.4), "spin_up": (1.2,)}  # where formulas change, s
STEP = 1e-5


def motion(name: str) -> Motion:
    """Return the motion of an entry above."""
    return Motion("drive", PrescribedMotion(type="prescribed_motion", coordinate="theta", **ENTRIES[name]))


@pytest.mark.parametrize("name", ENTRIES)
def test_speed_and_acceleration_are_derivatives(name: str) -> None:
    moved = motion(name)
    for time in np.linspace(0.013, 1.913, 39):
        ahead, behind = moved.at(time + STEP), moved.at(time - STEP)
        # second order, 1e-10 times third derivatives of a few hundred at most; splines have kinks in the acceleration
        assert moved.at(time)[1] == pytest.approx((ahead[0] - behind[0]) / (2 * STEP), rel=0, abs=1e-7)
        assert moved.at(time)[2] == pytest.approx((ahead[1] - behind[1]) / (2 * STEP), rel=0, abs=1e-6)


@pytest.mark.parametrize("name", EDGES)
def test_angle_and_speed_have_no_jump_where_formulas_meet(name: str) -> None:
    moved, tiny = motion(name), 1e-9
    for time in EDGES[name]:
        before, after = moved.at(time - tiny), moved.at(time + tiny)
        np.testing.assert_allclose(before[:2], after[:2], rtol=0, atol=1e-7)
        if name == "spin_up":
            assert before[2] == pytest.approx(after[2], abs=1e-7)


def test_a_table_is_followed_from_rest_to_rest() -> None:
    moved = motion("table")
    for time, angle in ENTRIES["table"]["table"]:
        assert moved.at(time)[0] == pytest.approx(angle, abs=1e-14)
    for time in (0.1, 1.4, 0.0, 9.0):
        assert moved.at(time)[1] == pytest.approx(0.0, abs=1e-13)
    assert moved.at(0.0) == (0.2, 0.0, 0.0)
    assert moved.at(9.0) == (0.3, 0.0, 0.0)


def test_a_spin_up_starts_at_rest_and_lags_behind_by_half_its_time() -> None:
    moved = motion("spin_up")
    assert moved.at(0.0) == pytest.approx((0.3, 0.0, 0.0), abs=1e-15)
    assert moved.at(1.2) == pytest.approx((0.3 + 6.0 * 0.6, 6.0, 0.0), abs=1e-13)
    assert moved.at(3.2) == pytest.approx((0.3 + 6.0 * 2.6, 6.0, 0.0), abs=1e-13)
    peak = moved.at(0.6)[2]
    assert peak == pytest.approx(2 * 6.0 / 1.2), "twice the mean acceleration, in the middle"
