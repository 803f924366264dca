"""Sampled configurations: where they lie, whether at equal distances, two revolutions, what lies in their range."""

import numpy as np
import pytest

from pgmp_petsc.reduction.sample_grid import Samples


def test_a_periodic_range_leaves_out_its_end() -> None:
    periodic, limited = Samples.uniform(1.0, 3.0, 4, True), Samples.uniform(1.0, 3.0, 5, False)
    np.testing.assert_allclose(periodic.theta, [1.0, 1.5, 2.0, 2.5], atol=1e-15)
    np.testing.assert_allclose(limited.theta, [1.0, 1.5, 2.0, 2.5, 3.0], atol=1e-15)
    assert (periodic.n, limited.n) == (4, 5)
    for samples in (periodic, limited):
        assert (samples.lower, samples.upper) == (1.0, 3.0)
    assert periodic.periodic and not limited.periodic


@pytest.mark.parametrize("n", [2, 3, 4, 33])
def test_chebyshev_points_have_equal_angles_on_the_circle_and_contain_the_ends(n: int) -> None:
    samples = Samples.chebyshev(-1.0, 3.0, n)
    assert (samples.n, samples.lower, samples.upper, samples.periodic) == (n, -1.0, 3.0, False)
    assert (samples.theta[0], samples.theta[-1]) == (-1.0, 3.0)
    assert np.all(np.diff(samples.theta) > 0)
    np.testing.assert_allclose(samples.theta + samples.theta[::-1], 2.0, rtol=0, atol=1e-14)
    circle = np.arccos(np.clip((1.0 - samples.theta) / 2, -1.0, 1.0))
    np.testing.assert_allclose(np.diff(circle), np.pi / (n - 1), rtol=0, atol=1e-6)


@pytest.mark.parametrize("periodic", [True, False])
def test_equal_distances_are_those_of_the_range(periodic: bool) -> None:
    uniform = Samples.uniform(-2.0, 5.0, 20, periodic)
    assert uniform.is_uniform
    for samples in (
        Samples(uniform.theta + 1e-9 * np.sin(uniform.theta), -2.0, 5.0, periodic),
        # equal distances that do not fill the range
        Samples(uniform.theta + 0.1, -2.0, 5.0, periodic),
        Samples(uniform.theta, -2.0, 5.0, not periodic),
    ):
        assert not samples.is_uniform
    assert Samples(uniform.theta + 1e-13, -2.0, 5.0, periodic).is_uniform
    assert not Samples.chebyshev(0.0, 1.0, 5).is_uniform


def test_two_turns() -> None:
    once = Samples.uniform(0.5, 2.5, 8, True)
    twice = once.over_two_turns()
    assert (twice.n, twice.lower, twice.upper, twice.periodic) == (16, 0.5, 4.5, True)
    np.testing.assert_array_equal(twice.theta[:8], once.theta)
    np.testing.assert_array_equal(twice.theta[8:], once.theta + 2.0)
    assert twice.is_uniform
    np.testing.assert_allclose(twice.theta, Samples.uniform(0.5, 4.5, 16, True).theta, rtol=0, atol=1e-15)


def test_what_lies_in_a_range() -> None:
    theta = np.array([-1e9, 0.5 - 1e-12, 0.5, 1.0, 2.5, 2.5 + 1e-12, 1e9])
    limited, periodic = Samples.uniform(0.5, 2.5, 4, False), Samples.uniform(0.5, 2.5, 4, True)
    np.testing.assert_array_equal(limited.contains(theta), [False, False, True, True, True, False, False])
    np.testing.assert_array_equal(periodic.contains(theta), True)
    for value, inside in zip(theta, limited.contains(theta)):
        assert limited.contains(float(value)) == inside
        assert periodic.contains(float(value))


def test_a_place_is_told_within_the_coordinates_range() -> None:
    """Bases that come back with other signs are tabulated over two turns, which the scene does not know of."""
    two = Samples.uniform(-1.0, 2.0 * np.pi - 1.0, 16, periodic=True).over_two_turns()
    assert (two.n // two.turns, two.turns) == (16, 2)
    assert two.in_first_turn(10.8) == pytest.approx(10.8 - 2.0 * np.pi) and two.in_first_turn(-0.5) == -0.5
    limited = Samples.uniform(0.0, 9.0, 4, periodic=False)
    assert limited.turns == 1 and limited.in_first_turn(8.0) == 8.0
