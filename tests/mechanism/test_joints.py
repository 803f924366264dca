"""Joints in the plane: what their constraints mean, on bodies and on the ground."""

import numpy as np
import pytest
from joint_arrays import jacobian, joint, residual

from pgmp_petsc.mechanism.joints import Attachment, ridden, triad
from pgmp_petsc.mechanism.space import PLANE

EPSILON = 1e-15  # round-off of sums of products of numbers of order 1
NATURAL = PLANE.natural


def line(direction: tuple[float, float]):
    axes = triad(np.array(direction))
    return joint("point_on_line", axes, axes)


def test_a_line_on_the_ground_holds_the_distance() -> None:
    # whatever the length of the direction; how the second body is turned does not matter
    ground, on_line = np.array([1.0, 2.0, 0.0]), np.array([1.0 + 2 * 0.6, 2.0 + 2 * 0.8, 0.3])
    assert residual(line((3.0, 4.0)), *map(NATURAL, (ground, on_line))) == pytest.approx([0.0], abs=EPSILON)
    off_line = on_line + [-0.8, 0.6, 0.0]
    assert residual(line((3.0, 4.0)), *map(NATURAL, (ground, off_line))) == pytest.approx([1.0], rel=1e-14)


def test_a_turning_line_goes_with_its_body() -> None:
    angle = 0.7
    carrier = np.array([1.0, 2.0, angle])
    point = carrier + [3 * np.cos(angle), 3 * np.sin(angle), 9.0]
    assert residual(line((1.0, 0.0)), *map(NATURAL, (carrier, point))) == pytest.approx([0.0], abs=EPSILON)


def test_a_revolute_joint_leaves_the_rotation_free() -> None:
    hinge = joint("revolute", np.eye(2), np.eye(2))
    frames = [NATURAL(np.array(frame)) for frame in ((1.0, 2.0, 3.0), (1.5, 2.0, -8.0))]
    np.testing.assert_array_equal(residual(hinge, *frames), [0.5, 0.0])
    assert not np.any(jacobian(hinge, *frames)[:, [2, 3, 4, 5, 8, 9, 10, 11]])


@pytest.mark.parametrize("away", [0.0, 1e-3, -0.4])
def test_a_weld_holds_the_angle_that_the_bodies_are_placed_at(away: float) -> None:
    placed = (0.3, 4.0)  # the second body half a turn and more against the first
    turns = [np.array([[np.cos(p), -np.sin(p)], [np.sin(p), np.cos(p)]]) for p in placed]
    weld = joint("fixed", np.eye(2), turns[1].T @ turns[0])
    frames = [NATURAL(np.array([0.5, 0.1, angle])) for angle in (placed[0] + 2.0, placed[1] + 2.0 + away)]
    found = residual(weld, *frames)
    np.testing.assert_array_equal(found[:2], 0.0)
    assert abs(found[2]) == pytest.approx(abs(np.sin(away)), abs=EPSILON)


def test_a_prismatic_joint_lets_nothing_turn() -> None:
    axes = triad(np.array([3.0, 4.0]))
    rail = joint("prismatic", axes, axes)
    carrier = np.array([1.0, 2.0, 0.7])
    along = carrier + [5.0 * np.cos(0.7 + np.arctan2(4.0, 3.0)), 5.0 * np.sin(0.7 + np.arctan2(4.0, 3.0)), 0.0]
    np.testing.assert_allclose(residual(rail, *map(NATURAL, (carrier, along))), 0.0, atol=10 * EPSILON)
    away = residual(rail, *map(NATURAL, (carrier, along + [0.0, 0.0, 0.1])))
    np.testing.assert_allclose(np.abs(away), [0.0, np.sin(0.1)], atol=10 * EPSILON)


BENT_AT = np.array([0.0, 0.3, 0.7, 1.2])


def missed(x: float, size: float, turned: float) -> float:
    """Return what a point that is turned misses on a run of uneven cells bent to ``size x^3``, at its place; in
    between nodes Hermite's interpolation is exact, beyond the ends the run goes on along its tangents."""
    run = [Attachment(0, k, np.array([place, 0.0]), np.zeros(2)) for k, place in enumerate(BENT_AT)]
    ((combination, sides),) = ridden(np.eye(2), np.eye(2), run, Attachment(1, 9, np.zeros(2), np.zeros(2)))
    on = np.clip(x, *BENT_AT[[0, -1]])
    point = NATURAL(np.array([x, size * (on**3 + 3 * on**2 * (x - on)), turned]))
    frames = [NATURAL(np.array([place, size * place**3, np.arctan(3 * size * place**2)])) for place in BENT_AT]
    values = (part.value(frames[side.node], point) for (part, _), side in zip(combination.terms, sides[::2]))
    return sum(function.factor * value for (_, function), value in zip(combination.terms, values))


@pytest.mark.parametrize("x", [-0.2, 0.0, 0.1, 0.3, 0.45, 0.69, 0.7, 1.1, 1.2, 1.5])
def test_what_rides_on_a_bent_beam_is_on_hermites_interpolation(x: float) -> None:
    # in what the nodes are turned the rest is of third order, and how the point is turned does not matter to first
    coarse, fine = (missed(x, size, 0.0) for size in (2e-3, 1e-3))
    assert abs(fine) < 1e-8
    assert abs(coarse) < 1e-14 or coarse / fine == pytest.approx(8.0, rel=0.05)
    assert abs(missed(x, 1e-3, 0.05) - fine) < 2e-6
