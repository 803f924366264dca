"""Functions of time in compiled code and motions by them: what scenes give, at any instant."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pgmp_petsc.effects.loads import Torque
from pgmp_petsc.effects.motion import PrescribedMotion
from pgmp_petsc.effects.time_function import Piece, TimeFunction, amplitude_of, joined

TIMES = np.concatenate([np.linspace(-0.5, 3.0, 701), [0.2, 0.9, 1.4]])
ROWS = [[0.2, 1.0], [0.9, -3.0], [0.95, 4.0], [1.4, 4.5]]


def torque(**entry: object) -> TimeFunction:
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
    outside = (TIMES < times[0]) | (TIMES > times[-1] + 1e-9)  # runs that end at the last row end with the spline
    for order, size in enumerate((1.0, 1e2, 1e4)):
        expected = spline(np.clip(TIMES, times[0], times[-1]), order)
        expected[outside & (order > 0)] = 0.0
        np.testing.assert_allclose(found[order], expected, rtol=0, atol=1e-13 * size)
    np.testing.assert_array_equal(found[1:, outside], 0.0)


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


# angle, speed and acceleration in closed form
FORMULAS = {
    "harmonic": (
        {"amplitude": 0.4, "frequency_hz": 1.5, "phase": 0.3, "mean": 0.1},
        lambda t, w=3.0 * np.pi: (
            0.1 + 0.4 * np.sin(w * t + 0.3), 0.4 * w * np.cos(w * t + 0.3), -0.4 * w**2 * np.sin(w * t + 0.3)),
    ),
    "constant_speed": ({"speed": -2.0, "start": 0.3}, lambda t: (0.3 - 2.0 * t, -2.0, 0.0)),
    # from rest, with twice the mean acceleration in the middle, and behind by half its time from its end on
    "spin_up": (
        {"speed": 6.0, "time": 1.2, "start": 0.3},
        lambda t, w=2.0 * np.pi / 1.2: (0.3 + 6.0 * (t - 0.6), 6.0, 0.0) if t > 1.2 else (
            0.3 + 5.0 * (0.5 * t**2 + (np.cos(w * t) - 1.0) / w**2), 5.0 * (t - np.sin(w * t) / w),
            5.0 * (1.0 - np.cos(w * t))),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMULAS)
def test_motions_by_formulas_are_those_and_their_derivatives(name: str) -> None:
    entry, formula = FORMULAS[name]
    moved = PrescribedMotion(type="prescribed_motion", coordinate="theta", **{name: entry}).motion("drive")
    for time in np.append(np.linspace(0.0, 3.2, 65), 1.2):
        np.testing.assert_allclose(moved.at(time), formula(time), rtol=1e-13, atol=1e-13)
