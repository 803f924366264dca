"""Functions of time in compiled code and motions by them: what scenes give, at any instant."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pgmp_petsc.effects.loads import Torque
from pgmp_petsc.effects.motion import Motion, PrescribedMotion
from pgmp_petsc.effects.time_function import Piece, TimeFunction, amplitude_of, joined

TIMES = np.concatenate([np.linspace(-0.5, 3.0, 701), [0.2, 0.9, 1.4]])
ROWS = [[0.2, 1.0], [0.9, -3.0], [0.95, 4.0], [1.4, 4.5]]


def torque(**entry: object) -> TimeFunction:
    """Return the amplitude of a torque."""
    return amplitude_of(Torque(type="torque", joint="hinge", **entry))


def test_tables_are_linear_between_their_rows_and_constant_outside() -> None:
    times, values = np.array(ROWS).T
    np.testing.assert_allclose(torque(table=ROWS)(TIMES), np.interp(TIMES, times, values), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(torque(table=ROWS)(times), values)
    np.testing.assert_array_equal(torque(table=[[0.5, 2.0]])(TIMES), 2.0)


def test_harmonics_are_sines() -> None:
    wave = {"amplitude": 0.7, "frequency_hz": 2.0, "phase": 0.4, "mean": 0.2}
    expected = 0.2 + 0.7 * np.sin(4.0 * np.pi * TIMES + 0.4)
    np.testing.assert_allclose(torque(harmonic=wave)(TIMES), expected, rtol=0, atol=1e-15)


def test_motions_by_tables_are_clamped_splines() -> None:
    times, angles = np.array(ROWS).T
    spline = CubicSpline(times, angles, bc_type="clamped")
    motion = PrescribedMotion(type="prescribed_motion", coordinate="theta", table=ROWS).motion("drive")
    found = np.array([motion.at(time) for time in TIMES]).T
    outside = (TIMES < times[0]) | (TIMES >= times[-1])
    for order, size in enumerate((1.0, 1e2, 1e4)):
        expected = spline(np.clip(TIMES, times[0], times[-1]), order)
        expected[outside & (order > 0)] = 0.0
        np.testing.assert_allclose(found[order], expected, rtol=0, atol=1e-13 * size)


def test_third_derivatives_are_those_of_the_second() -> None:
    wave, table = {"amplitude": 0.7, "frequency_hz": 2.0, "phase": 0.4}, ROWS
    for entry in ({"harmonic": wave}, {"table": table}, {"spin_up": {"speed": 8.0, "time": 1.0}}):
        angle = PrescribedMotion(type="prescribed_motion", coordinate="theta", **entry).motion("drive").angle
        for time, h in ((-0.1, 1e-4), (0.5, 1e-4), (0.97, 1e-4), (3.0, 1e-4)):
            before, after = (float(angle.with_rates(time + s * h)[2]) for s in (-1, 1))
            expected = (after - before) / (2.0 * h)
            # truncation of the differences is (w h)^2 / 6, with w up to 13 / s
            assert angle.jet(np.array([time]), 3)[3] == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_functions_are_joined_one_behind_the_other() -> None:
    parts = [
        TimeFunction.constant(2.0),
        TimeFunction(Piece(cubic=(1.0, 2.0)), Piece(0.5, 0.5, (7.0,), (1.0, 2.0, 3.0))),
    ]
    together = joined(parts)
    np.testing.assert_array_equal(together.firsts, [0, 1, 3])
    np.testing.assert_array_equal(together.begins, [-np.inf, -np.inf, 0.5])
    np.testing.assert_array_equal(together.cubics[:, 0], [2.0, 1.0, 7.0])
    assert parts[1](0.25) == 1.5 and parts[1](0.5) == pytest.approx(7.0 + np.sin(4.0), rel=1e-15)
    assert joined([]).waves.shape == (0, 3)


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
    return PrescribedMotion(type="prescribed_motion", coordinate="theta", **ENTRIES[name]).motion("drive")


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
