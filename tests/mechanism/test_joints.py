"""Joints: what their constraints mean on bodies and on the ground, the motions that they leave free, and their axes."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from pgmp_petsc.declare.ideas import JOINTS
from pgmp_petsc.mechanism.joints import Attachment, ridden, share_position, triad
from pgmp_petsc.mechanism.space import PLANE, SPATIAL, directors
from pgmp_petsc.mechanism.statements import Statement


def joint(kind: str, in_a: np.ndarray, in_b: np.ndarray) -> tuple[Statement, ...]:
    return tuple(JOINTS.named(kind).model_construct().statements(in_a, in_b))


def residual(joint: Sequence[Statement], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return c, shape (n_constraints, ...)."""
    return np.array([part.value(a, b) for part in joint])


def jacobian(joint: Sequence[Statement], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return dc/d(a, b), shape (n_constraints, 2 d (d + 1), ...)."""
    return np.array([part.gradient(a, b) for part in joint])


def lengths(joint: Sequence[Statement]) -> np.ndarray:
    """Return which constraints are measured in m, shape (n_constraints,)."""
    return np.array([part.is_length for part in joint])


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


# number of constraints of every type
COUNTS = {
    "spherical": 3, "revolute": 5, "universal": 4, "cylindrical": 4, "prismatic": 5, "fixed": 6, "point_on_line": 2,
    "point_on_plane": 1, "planar": 3,
}  # fmt: skip
# What b may do to a, along and about the joint's axes u, v, w (0, 1, 2). Rotations follow one another, each about an
# axis that those before it have turned.
SLIDES = {
    "cylindrical": (0,), "prismatic": (0,), "point_on_line": (0,), "point_on_plane": (1, 2), "planar": (1, 2),
}  # fmt: skip
TURNS = {
    "spherical": (0, 1, 2), "revolute": (0,), "universal": (0, 1), "cylindrical": (0,), "point_on_line": (0, 1, 2),
    "point_on_plane": (0, 1, 2), "planar": (0,),
}  # fmt: skip
ROUNDED = 1e-14  # round-off of sums of products of numbers of order 1


def frame(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return position and directors, the columns of a rotation matrix, one after the other."""
    return np.concatenate([position, rotation.T.ravel()])


def axes_of(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a joint's triad in the frames of a and of b: any rotations."""
    return tuple(Rotation.random(2, random_state=seed).as_matrix())


def obeying(kind: str, axes: tuple[np.ndarray, np.ndarray], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return two frames that obey a joint, moved as far as it lets them."""
    random = np.random.default_rng(seed)
    turn, position = Rotation.random(random_state=seed).as_matrix(), random.normal(size=3)
    in_a, in_b = axes
    away = sum((random.normal() * in_a[:, k] for k in SLIDES.get(kind, ())), np.zeros(3))
    relative = np.eye(3)
    for k in TURNS.get(kind, ()):
        relative = relative @ Rotation.from_rotvec(random.uniform(-3.0, 3.0) * np.eye(3)[k]).as_matrix()
    # the triads agree where nothing has turned: R_b in_b = R_a in_a relative
    return frame(position, turn), frame(position + turn @ away, turn @ in_a @ relative @ in_b.T)


@pytest.fixture(params=COUNTS)
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def made(kind: str) -> tuple[Statement, ...]:
    return joint(kind, *axes_of(1))


def test_the_number_of_constraints(kind: str, made: tuple[Statement, ...]) -> None:
    assert len(made) == COUNTS[kind] == lengths(made).size
    assert share_position(made) == (kind in ("spherical", "revolute", "universal", "fixed"))
    # each length is the gap of one direction that the joint holds
    assert lengths(made).sum() == 3 - len(SLIDES.get(kind, ()))


def free_twists(kind: str, axes: tuple[np.ndarray, np.ndarray], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the twists of b that a joint should leave free: displacement and rotation in b's frame, shape (6, n)."""
    back = directors(b).T @ directors(a)
    slides = [np.concatenate([back @ axes[0][:, k], np.zeros(3)]) for k in SLIDES.get(kind, ())]
    if kind == "universal":
        about = [back @ axes[0][:, 0], axes[1][:, 1]]
    else:
        about = [back @ axes[0][:, k] for k in TURNS.get(kind, ())]
    turns = [np.concatenate([np.zeros(3), axis]) for axis in about]
    return np.array([*slides, *turns]).reshape(-1, 6).T


@pytest.mark.parametrize("seed", range(2))
def test_the_relative_motions_left_free(kind: str, seed: int) -> None:
    axes = axes_of(seed + 7)
    made, (a, b) = joint(kind, *axes), obeying(kind, axes, seed)
    twists = jacobian(made, a, b)[:, 12:] @ SPATIAL.frame_gradients(b[None])[0]
    left = null_space(twists)
    expected = free_twists(kind, axes, a, b)
    assert left.shape[1] == expected.shape[1] == 6 - COUNTS[kind]
    # one space: both projections onto it agree
    np.testing.assert_allclose(expected @ np.linalg.pinv(expected), left @ left.T, rtol=0, atol=10 * ROUNDED)


def test_triads() -> None:
    for axis in np.random.default_rng(0).normal(size=(5, 3)):
        for second in (None, np.array([0.3, -1.0, 2.0])):
            found = triad(axis, second)
            np.testing.assert_allclose(found.T @ found, np.eye(3), rtol=0, atol=ROUNDED)
            assert np.linalg.det(found) == pytest.approx(1.0, rel=1e-13)
            np.testing.assert_allclose(found[:, 0], axis / np.linalg.norm(axis), rtol=0, atol=ROUNDED)
            if second is not None:
                # as near to the other direction as a right angle to the axis allows: in their plane, on its side
                assert abs(found[:, 2] @ second) < 10 * ROUNDED and found[:, 1] @ second > 0.0
    np.testing.assert_array_equal(triad(np.array([0.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0]))[:, 1], [1.0, 0.0, 0.0])
