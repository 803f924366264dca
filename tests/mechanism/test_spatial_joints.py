"""Joints in space: the motions that they leave free, and their axes."""

import numpy as np
import pytest
from joint_arrays import jacobian, lengths
from joint_arrays import joint as make_joint
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from pgmp_petsc.mechanism.joints import share_position, triad
from pgmp_petsc.mechanism.space import SPATIAL, directors
from pgmp_petsc.mechanism.statements import Statement

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
EPSILON = 1e-14  # round-off of sums of products of numbers of order 1


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
def joint(kind: str) -> tuple[Statement, ...]:
    return make_joint(kind, *axes_of(1))


def test_the_number_of_constraints(kind: str, joint: tuple[Statement, ...]) -> None:
    assert len(joint) == COUNTS[kind] == lengths(joint).size
    assert share_position(joint) == (kind in ("spherical", "revolute", "universal", "fixed"))
    # each length is the gap of one direction that the joint holds
    assert lengths(joint).sum() == 3 - len(SLIDES.get(kind, ()))


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
    joint, (a, b) = make_joint(kind, *axes), obeying(kind, axes, seed)
    twists = jacobian(joint, a, b)[:, 12:] @ SPATIAL.frame_gradient(b)
    left = null_space(twists)
    expected = free_twists(kind, axes, a, b)
    assert left.shape[1] == expected.shape[1] == 6 - COUNTS[kind]
    # one space: both projections onto it agree
    np.testing.assert_allclose(expected @ np.linalg.pinv(expected), left @ left.T, rtol=0, atol=10 * EPSILON)


def test_triads() -> None:
    for axis in np.random.default_rng(0).normal(size=(5, 3)):
        for second in (None, np.array([0.3, -1.0, 2.0])):
            found = triad(axis, second)
            np.testing.assert_allclose(found.T @ found, np.eye(3), rtol=0, atol=EPSILON)
            assert np.linalg.det(found) == pytest.approx(1.0, rel=1e-13)
            np.testing.assert_allclose(found[:, 0], axis / np.linalg.norm(axis), rtol=0, atol=EPSILON)
            if second is not None:
                # as near to the other direction as a right angle to the axis allows: in their plane, on its side
                assert abs(found[:, 2] @ second) < 10 * EPSILON and found[:, 1] @ second > 0.0
    np.testing.assert_array_equal(triad(np.array([0.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0]))[:, 1], [1.0, 0.0, 0.0])
