"""Joints in space: what they hold and leave free, their derivatives, their place on bodies, and the angle of a
hinge."""

from types import SimpleNamespace

import numpy as np
import pytest
from joint_arrays import jacobian, lengths, residual
from joint_arrays import joint as make_joint
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from pgmp_petsc.mechanism.body_frames import BodyGradients
from pgmp_petsc.mechanism.joints import Attachment, Connection, orthonormality, share_position, triad
from pgmp_petsc.mechanism.space import SPATIAL, directors
from pgmp_petsc.mechanism.statement_rows import StatementRows
from pgmp_petsc.mechanism.statements import Statement, angle

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


# --- constraints and their derivatives -------------------------------------------------------------------------------


def test_the_number_of_constraints(kind: str, joint: tuple[Statement, ...]) -> None:
    assert len(joint) == COUNTS[kind] == lengths(joint).size
    assert share_position(joint) == (kind in ("spherical", "revolute", "universal", "fixed"))
    # each length is the gap of one direction that the joint holds
    assert lengths(joint).sum() == 3 - len(SLIDES.get(kind, ()))


@pytest.mark.parametrize("seed", range(2))
def test_frames_that_obey_a_joint_leave_no_residual(kind: str, seed: int) -> None:
    axes = axes_of(seed + 20)
    np.testing.assert_allclose(residual(make_joint(kind, *axes), *obeying(kind, axes, seed)), 0.0, rtol=0, atol=EPSILON)


@pytest.mark.parametrize("seed", range(2))
def test_a_gap_is_its_own_residual(kind: str, seed: int) -> None:
    """The residual of a gap in a direction that is held is as long as the gap; in others there is none."""
    axes = axes_of(seed)
    joint, (a, b) = make_joint(kind, *axes), obeying(kind, axes, seed)
    for k in range(3):
        for gap in (1e-3, 0.7):
            moved = b.copy()
            moved[:3] += gap * directors(a) @ axes[0][:, k]
            found = residual(joint, a, moved)
            held = k not in SLIDES.get(kind, ())
            assert np.linalg.norm(found[lengths(joint)]) == pytest.approx(gap * held, abs=EPSILON)
            np.testing.assert_allclose(found[~lengths(joint)], 0.0, rtol=0, atol=EPSILON)


@pytest.mark.parametrize("seed", range(2))
def test_a_wrong_rotation_is_measured_by_its_sine(kind: str, seed: int) -> None:
    """What a joint holds of the rotation is held by cosines of right angles: linear in small angles."""
    axes = axes_of(seed)
    joint, (a, b) = make_joint(kind, *axes), obeying(kind, axes, seed)
    if kind == "universal":
        # at a right angle to both axes, wherever they are now
        held = [np.cross(directors(a) @ axes[0][:, 0], directors(b) @ axes[1][:, 1])]
    else:
        held = [directors(a) @ axes[0][:, k] for k in range(3) if k not in TURNS.get(kind, ())]
    assert len(held) == np.sum(~lengths(joint))
    for axis in held:
        for tilt in (1e-3, 0.4):
            turned = frame(b[:3], Rotation.from_rotvec(tilt * axis).as_matrix() @ directors(b))
            found = residual(joint, a, turned)
            assert np.linalg.norm(found[~lengths(joint)]) == pytest.approx(np.sin(tilt), abs=EPSILON)
            np.testing.assert_allclose(found[lengths(joint)], 0.0, rtol=0, atol=EPSILON)


# --- what joints leave free ------------------------------------------------------------------------------------------


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


def test_orthonormality_is_that_of_rotations() -> None:
    (parts, values), nowhere = orthonormality(), np.zeros(12)
    pose = frame(np.array([1.0, -2.0, 0.5]), Rotation.random(random_state=4).as_matrix())
    rigid = tuple(parts)
    np.testing.assert_allclose(residual(rigid, nowhere, pose), values, rtol=0, atol=EPSILON)
    assert len(rigid) == SPATIAL.n_tied == 6 and not lengths(rigid).any()
    found = jacobian(rigid, nowhere, pose)
    assert not np.any(found[:, :12])
    # what it leaves of twelve numbers are displacements and rotations
    left, gradient = null_space(found[:, 12:]), SPATIAL.frame_gradient(pose)
    assert left.shape[1] == np.linalg.matrix_rank(gradient) == 6
    np.testing.assert_allclose(gradient, left @ (left.T @ gradient), rtol=0, atol=10 * EPSILON)
    # a stretched director and a sheared pair are told by their square and by their cosine
    stretched, sheared = pose.copy(), pose.copy()
    stretched[3:6] *= 1.1
    sheared[9:12] += 0.2 * pose[6:9]
    assert np.linalg.norm(residual(rigid, nowhere, stretched) - values) == pytest.approx(1.1**2 - 1, rel=1e-13)
    assert (residual(rigid, nowhere, sheared) - values).max() == pytest.approx(0.2, rel=1e-13)


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


# --- on bodies -------------------------------------------------------------------------------------------------------

POINTS = (np.array([0.3, -0.1, 0.2]), np.array([-0.2, 0.4, 0.1]))


def poses_of_two_bodies(n: int = 3) -> np.ndarray:
    """Return n pairs of poses of rigid bodies, shape (2, 12, n)."""
    turns = Rotation.random(2 * n, random_state=8).as_matrix()
    places = np.random.default_rng(8).normal(size=(2 * n, 3))
    return np.moveaxis(np.array([frame(*pair) for pair in zip(places, turns)]).reshape(n, 2, 12), 0, -1)


@pytest.mark.parametrize("grounded", ["neither", "first", "second"])
def test_a_joint_on_rigid_bodies(kind: str, grounded: str) -> None:
    sides = [Attachment(number, number, point, point) for number, point in enumerate(POINTS)]
    if grounded != "neither":
        sides[grounded == "second"] = Attachment.on_ground_at(POINTS[0])
    parts = make_joint(kind, *axes_of(2))
    rows = StatementRows(parts, [tuple(sides)] * len(parts), lambda body: 12 * body + np.arange(12), 3)
    unknowns = poses_of_two_bodies().reshape(24, 3)
    gradients, hessians = rows.gradients(unknowns), rows.hessians(unknowns)
    moving = np.flatnonzero(rows.dofs[0] >= 0)
    assert moving.size == (24 if grounded == "neither" else 12)
    for column in moving:
        moved, back = unknowns.copy(), unknowns.copy()
        moved[rows.dofs[0, column]] += 1.0
        back[rows.dofs[0, column]] -= 1.0
        # of second degree: differences are exact
        slope = 0.5 * (rows.values(moved) - rows.values(back))
        np.testing.assert_allclose(gradients[:, column], slope, rtol=0, atol=10 * EPSILON)
        change = (rows.gradients(moved) - gradients)[:, moving]
        np.testing.assert_allclose(hessians[:, moving, column], change, rtol=0, atol=10 * EPSILON)


@pytest.mark.parametrize("arm", [np.zeros(3), np.array([0.1, 0.3, -0.2])])
def test_the_jacobian_in_body_frames_is_that_of_small_motions_of_nodes(kind: str, arm: np.ndarray) -> None:
    a = Attachment(0, 4, POINTS[0], arm)
    b = Attachment(1, 7, POINTS[1], np.zeros(3))
    joint, poses = make_joint(kind, *axes_of(2)), poses_of_two_bodies()[..., 0]
    connection = Connection("test", joint, a, b, slice(0, len(joint)), axes_of(2), tuple(joint), (), a)
    # of the mechanism only its numbers are looked at
    mechanism = SimpleNamespace(space=SPATIAL, n_dofs=48, bodies=(None, None))
    found = BodyGradients(mechanism, [(part, connection.sides) for part in joint])
    block_a, block_b = np.split(found.dense(poses)[:, [*range(24, 30), *range(42, 48)]], 2, axis=1)
    assert set(found.dofs) <= {*range(24, 30), *range(42, 48)}
    step = 1e-5
    for side, block in ((a, block_a), (b, block_b)):
        node = Attachment(side.body, side.node, side.point - side.arm, np.zeros(3)).frame_of_pose(poses)
        for column in range(6):
            residuals = []
            for sign in (step, -step):
                move = sign * np.eye(6)[column]
                turn = directors(node) @ Rotation.from_rotvec(move[3:]).as_matrix()
                moved = side.frame_of(frame(node[:3] + directors(node) @ move[:3], turn))
                frames = [moved if one is side else one.frame_of_pose(poses) for one in (a, b)]
                residuals.append(residual(joint, *frames))
            slope = (residuals[0] - residuals[1]) / (2 * step)
            # second order, 1e-10 over 6, and the round-off of numbers of order 1 over the step, 1e-11
            np.testing.assert_allclose(block[:, column], slope, rtol=0, atol=1e-9)


# --- the angle of a hinge --------------------------------------------------------------------------------------------

HINGE = axes_of(11)
TURN = angle(*HINGE)


def hinged(theta: np.ndarray, carrier: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frames a, with rotations (n, 3, 3), and b, turned by angles (n,) about the axis, each of shape (12, n)."""
    about = Rotation.from_rotvec(np.asarray(theta)[:, None] * [1.0, 0.0, 0.0]).as_matrix()
    turned = carrier @ HINGE[0] @ about @ HINGE[1].T
    return tuple(np.array([frame(np.ones(3), turn) for turn in turns]).T for turns in (carrier, turned))


def test_the_angle_over_whole_turns() -> None:
    theta = np.linspace(-7.0, 7.0, 141)
    a, b = hinged(theta, Rotation.random(theta.size, random_state=1).as_matrix())
    found = TURN.value(a, b)
    np.testing.assert_allclose(found, np.angle(np.exp(1j * theta)), rtol=0, atol=10 * EPSILON)
    # further rows, such as the coordinates of a reconstruction, do not matter
    np.testing.assert_array_equal(TURN.value(*(np.vstack([side, theta]) for side in (a, b))), found)
    assert np.ndim(TURN.value(a[:, 0], b[:, 0])) == 0


def test_a_bent_hinge_has_the_angle_of_its_second_axes() -> None:
    """A hinge's nodes tilt a little against each other on flexible bodies: what is seen along a's axis counts."""
    tilt = Rotation.from_rotvec([0.0, 0.01, 0.0]).as_matrix()
    a, b = hinged(np.array([0.3]), np.eye(3)[None])
    bent = frame(np.ones(3), HINGE[0] @ tilt @ HINGE[0].T @ directors(b[:, 0]))
    # second order in the tilt: tan changes by its cosine, 5e-5 times sin cos of the angle
    assert TURN.value(a[:, 0], bent) == pytest.approx(0.3, abs=5e-5)
    assert TURN.value(a[:, 0], bent) != pytest.approx(0.3, abs=1e-6)
