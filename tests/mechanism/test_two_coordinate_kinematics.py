"""Rigid kinematics over two coordinates: closed forms, derivatives, revolutions, assembly, and every refusal."""

import numpy as np
import pytest
from conftest import ROOT
from frames import check_derivatives
from refusals import refusal
from two_coordinates import BASE, COUPLER, LEFT, RIGHT, THIRD, UPPER, double_pendulum, five_bar

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.block_solves import solver, triangular_blocks
from pgmp_petsc.mechanism.closure import LoopClosure
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.scene import load_scene
from scenes import kinematics_of, slider_crank

# several revolutions of both coordinates, and the corners of the range
TURNS = np.random.default_rng(0).uniform(-15.0, 15.0, (60, 2))
THETA = np.concatenate([TURNS, [[0.0, 0.0], [2 * np.pi, 0.0], [0.0, 2 * np.pi], [2 * np.pi, -2 * np.pi]]])


def double_pendulum_poses(theta: np.ndarray) -> np.ndarray:
    """Return the closed form of the poses, shape (2, 3, n); the second coordinate is relative."""
    first, second = theta.T
    zero = 0.0 * first
    return np.array([[zero, zero, first], [UPPER * np.cos(first), UPPER * np.sin(first), first + second]])


def five_bar_pin(theta: np.ndarray) -> np.ndarray:
    """Return the closed form of the pin, shape (2, n): two circles about the elbows meet above them."""
    first, second = theta.T
    left = LEFT * np.array([np.cos(first), np.sin(first)])
    right = RIGHT * np.array([np.cos(second), np.sin(second)]) + np.array([[BASE], [0.0]])
    along = right - left
    half = np.hypot(*along) / 2
    normal = np.array([-along[1], along[0]]) / (2 * half)
    return (left + right) / 2 + np.sqrt(COUPLER**2 - half**2) * normal


@pytest.fixture(scope="module")
def linkage() -> RigidKinematics:
    return kinematics_of(five_bar())


def test_an_open_chain_follows_its_closed_form() -> None:
    kinematics = kinematics_of(double_pendulum())
    assert (kinematics.n_coordinates, kinematics.n_redundant) == (2, 0)
    assert [coordinate.name for coordinate in kinematics.coordinates] == ["theta1", "theta2"]
    # the closure is solved to 1e-12
    np.testing.assert_allclose(kinematics.poses(THETA), double_pendulum_poses(THETA), rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", ["double_pendulum", "five_bar", "scara", "delta_robot"])
def test_no_configuration_has_no_poses(name: str) -> None:
    """As where a run is out of the range from its first step on."""
    kinematics = kinematics_of(load_scene(ROOT / "scenes" / f"{name}.toml"))
    mechanism = kinematics.mechanism
    none = np.empty((0, kinematics.n_coordinates))
    assert kinematics.poses(none).shape == (len(mechanism.bodies), mechanism.space.n_pose, 0)


def test_a_five_bar_follows_its_closed_form(linkage: RigidKinematics) -> None:
    poses = linkage.poses(THETA)
    for name in ("first:tip", "second:tip"):
        pin = linkage.mechanism.attachment(name, "test").frame_of_pose(poses)
        np.testing.assert_allclose(pin[:2], five_bar_pin(THETA), rtol=0, atol=1e-11)
    np.testing.assert_allclose(poses[:2, 2], THETA.T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(LoopClosure(linkage.mechanism).residual(poses, THETA), 0.0, rtol=0, atol=2e-12)


def test_poses_of_patches_are_those_of_newtons_method(linkage: RigidKinematics, monkeypatch) -> None:
    kinematics, theta = kinematics_of(five_bar()), THETA % (2 * np.pi)
    poses = kinematics.poses(theta)
    monkeypatch.setattr("pgmp_petsc.mechanism.pose_patches.LARGEST", 0)
    np.testing.assert_array_equal(kinematics.poses(theta), poses)  # patches are forgotten, and made again
    closed = kinematics._closure.close(kinematics.branch.guess(theta), theta)
    np.testing.assert_allclose(poses, closed, rtol=0, atol=1e-11)
    monkeypatch.setattr("pgmp_petsc.mechanism.pose_patches.DEEPEST", 1)
    alone = kinematics_of(five_bar())
    monkeypatch.setattr("pgmp_petsc.mechanism.pose_patches.near_enough", lambda apart, gap: np.zeros(len(gap), bool))
    np.testing.assert_array_equal(alone.poses(theta), closed)  # no patch closes the loops
    near = alone.near(theta, closed, order=2)
    np.testing.assert_allclose(near(theta + 1e-3), linkage.near(theta, poses, order=2)(theta + 1e-3), atol=1e-10)


def test_a_step_near_a_singular_configuration_is_the_least() -> None:
    """Well-conditioned, almost singular and singular square Jacobians, by numpy's least squares."""
    jacobian, right = np.random.default_rng(1).normal(size=(2, 6, 6)), np.ones((2, 6, 1))
    for pivot in (1.0, 1e-7, 0.0):
        jacobian[1, 5] = pivot * jacobian[1, 5] + jacobian[1, 4]
        expected = np.array([np.linalg.lstsq(j, r, rcond=1e-10)[0] for j, r in zip(jacobian, right)])
        # digits that a condition of 1e8 takes off 1e-16
        np.testing.assert_allclose(solver(jacobian)(right), expected, rtol=1e-7)


@pytest.mark.filterwarnings("error")
def test_blocks_that_are_singular_are_solved_as_a_whole() -> None:
    blocks = kinematics_of(slider_crank())._closure._blocks
    n, starts = blocks.rows.size, blocks.starts
    assert starts.size > 2
    own = [(blocks.rows[a:b], blocks.columns[a:b]) for a, b in zip(starts, starts[1:])]
    pattern = np.zeros((n, n), dtype=bool)
    for k, (rows, columns) in enumerate(own):
        before = blocks.before[blocks.entered[k] : blocks.entered[k + 1]]
        pattern[np.ix_(rows, np.concatenate([columns, before]))] = True
    jacobian = np.where(pattern, np.random.default_rng(3).normal(size=(3, n, n)), 0.0)
    jacobian[1][np.ix_(*own[0])] = 0.0
    right = np.random.default_rng(4).normal(size=(3, n, 1))
    expected = [np.linalg.lstsq(one, other, rcond=1e-10)[0] for one, other in zip(jacobian, right)]
    np.testing.assert_allclose(solver(jacobian, blocks)(right), expected, rtol=1e-9, atol=1e-9)


def test_blocks_follow_from_those_before_them() -> None:
    # shuffled: a chain of blocks of 2, 3 and 1 columns, of which the last feels the first alone
    whole = np.zeros((6, 6), dtype=bool)
    whole[:2, :2] = whole[2:5, :5] = True
    whole[5, [0, 5]] = True
    rng = np.random.default_rng(0)
    rows, columns = rng.permutation(6), rng.permutation(6)
    pattern = whole[rows][:, columns]
    known: set[int] = set()
    for own_rows, own, before in triangular_blocks(pattern):
        assert pattern[own_rows].any(axis=0)[own].all() and own_rows.size == own.size
        assert set(np.flatnonzero(pattern[own_rows].any(axis=0))) == {*own, *before} and {*before} <= known
        known |= {*own}
    assert known == set(range(6))
    assert sorted(block[1].size for block in triangular_blocks(pattern)) == [1, 2, 3]
    for unsolvable in (pattern[:4], np.where(np.arange(6) == 3, False, pattern)):
        assert len(triangular_blocks(unsolvable)) == 1


def test_derivatives_are_those_of_the_poses(linkage: RigidKinematics) -> None:
    check_derivatives(linkage, np.random.default_rng(1).uniform(0.0, 2 * np.pi, (20, 2)))


def test_poses_next_to_known_ones_lie_on_tangents(linkage: RigidKinematics, monkeypatch: pytest.MonkeyPatch) -> None:
    poses, way, step = linkage.poses(THETA), np.random.default_rng(2).normal(size=THETA.shape), 1e-4
    rates = np.einsum("bpkn,nk->bpn", linkage.rates(poses), way)
    monkeypatch.setattr(linkage._closure, "newton", None)  # none is closed again
    near = linkage.near(THETA, poses)
    np.testing.assert_array_equal(near(THETA), poses)
    # round-off of angles, 15 rad, over the step
    np.testing.assert_allclose((near(THETA + step * way) - near(THETA - step * way)) / (2 * step), rates, atol=1e-9)
    bent = np.einsum("bpkln,nk,nl->bpn", linkage.curvatures(poses, linkage.rates(poses)), way, way)
    near, step = linkage.near(THETA, poses, order=2), 1e-2
    np.testing.assert_allclose((near(THETA + step * way) - near(THETA - step * way)) / (2 * step), rates, atol=1e-11)
    second = (near(THETA + step * way) - 2 * poses + near(THETA - step * way)) / step**2
    np.testing.assert_allclose(second, bent, atol=1e-9)
    near, step, unknown = linkage.near(THETA, poses), 1e-4, poses.copy()
    unknown[..., 3] = np.nan
    found = linkage.near(THETA, unknown)(THETA + step * way)
    assert np.isnan(found[..., 3]).all()
    fine = np.delete(np.arange(len(THETA)), 3)
    np.testing.assert_allclose(found[..., fine], near(THETA + step * way)[..., fine], rtol=0, atol=1e-14)
    assert np.isnan(linkage.near(THETA, np.full_like(poses, np.nan))(THETA)).all()


def test_poses_of_a_table_are_those_of_the_table() -> None:
    kinematics, theta = kinematics_of(slider_crank()), np.linspace(-5.0, 12.0, 30)[:, None]
    beside = kinematics.near(theta, kinematics.poses(theta))(theta + 0.1)
    np.testing.assert_array_equal(beside, kinematics.poses(theta + 0.1))


def test_motions_that_no_coordinate_has() -> None:
    scene = five_bar()
    alone = scene.model_copy(update={"coordinates": {"theta1": scene.coordinates["theta1"]}})
    with pytest.raises(InputError) as caught:
        kinematics_of(alone)
    others = "right_hinge (turning), left_elbow (turning), right_elbow (turning), pin (turning)"
    words = f"named: theta1. Both numbers must be equal. Motions that go on while these rest: {others}"
    assert str(caught.value).endswith(words)


def test_a_branching_chain() -> None:
    arm = (
        'bodies.branch={mesh="0.0:0.3:2",element="beam2d",material="steel",section={shape="circle",radius=4e-3}}',
        'joints.weld_a={type="revolute",connect=["upper:tip","branch:hinge"]}',
        'joints.weld_b={type="point_on_line",connect=["lower:hinge","branch:tip"],direction=[1.0,0.0]}',
    )
    kinematics = kinematics_of(double_pendulum(*arm))
    poses = kinematics.poses(THETA)
    # the branch lies along the lower bar, whichever way it was assembled
    np.testing.assert_allclose(np.sin(poses[2, 2] - poses[1, 2]), 0.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(poses[2, :2], double_pendulum_poses(THETA)[1, :2], rtol=0, atol=1e-11)


def test_reach() -> None:
    limited = (
        "coordinates.theta2.range=[0.2,1.0]",
        "coordinates.theta2.periodic=false",
        "simulation.initial.theta2.position=0.2",
    )
    kinematics = kinematics_of(double_pendulum(*limited))
    theta = np.array([[100.0, 0.5], [0.0, 0.18], [0.0, 0.1], [0.0, 1.1], [np.nan, 0.5], [1e20, 0.5]])
    assert kinematics.within_reach(theta).tolist() == [True, True, False, False, False, False]
    assert kinematics.within_reach(theta[None]).shape == (1, 6)
    near = np.array([[1.0, 1.04], [1.0, 0.16]])
    np.testing.assert_allclose(kinematics.poses(near), double_pendulum_poses(near), rtol=0, atol=1e-11)


def limited(name: str, lower: float, upper: float) -> tuple[str, ...]:
    return (
        f"coordinates.{name}.range=[{lower},{upper}]",
        f"coordinates.{name}.periodic=false",
        f"simulation.initial.{name}.position={lower}",
    )


def configuration(message: str) -> np.ndarray:
    return np.array(
        [float(message.split(f"{name} = ")[1].split(",")[0].split(" ")[0]) for name in ("theta1", "theta2")]
    )


def test_couplers_that_stretch_somewhere_are_refused() -> None:
    # short couplers: the elbows come as far apart as both are long, where the pin's two branches meet
    short = ('bodies.first.mesh="0.0:0.45:4"', 'bodies.second.mesh="0.0:0.45:4"')
    message = refusal(kinematics_of, five_bar(*short))
    theta = configuration(message)
    elbows = np.hypot(
        BASE + RIGHT * np.cos(theta[1]) - LEFT * np.cos(theta[0]), RIGHT * np.sin(theta[1]) - LEFT * np.sin(theta[0])
    )
    # the configuration beyond which they do not close, found to a step of the continuation
    assert elbows == pytest.approx(0.9, abs=0.06)
    assert (
        "cannot close at theta1" in message and "narrow coordinates.theta1.range or coordinates.theta2.range" in message
    )


# a bar that hangs from the tip of a body adds one free coordinate to any mechanism
def hanging(tip: str) -> tuple[str, ...]:
    """Return overrides that hang a bar from a point and make its angle the coordinate theta2."""
    return (
        'bodies.bar={mesh="0.0:0.2:2",element="beam2d",material="steel",section={shape="circle",radius=4e-3}}',
        f'joints.hook={{type="revolute",connect=["{tip}","bar:hinge"]}}',
        'coordinates.theta2={joint="hook",range=[0.0,6.283185307179586],periodic=true}',
    )


@pytest.mark.parametrize("upper", [2.0, 3.0, np.pi])
def test_a_line_of_singular_configurations_is_refused_wherever_the_grid_lies(upper: float) -> None:
    # crank and rod of one length: both stand upright at pi/2, whatever the bar does
    equal = (
        'bodies.rod.mesh="0.3:0.6:5"',
        "coordinates.theta.periodic=false",
        f"coordinates.theta.range=[0.0,{upper}]",
    )
    message = refusal(kinematics_of, slider_crank(*equal, *hanging("crank:tip")))
    assert message.startswith("coordinates.theta, theta2: they do not control the mechanism at theta = 1.57")
    assert ", theta2 = " in message and "smallest singular value of the closure " in message


@pytest.mark.parametrize("upper", [3.55, 3.61])
@pytest.mark.parametrize(("coupler", "refused"), [(0.525, True), (0.5249, True), (0.53, False)])
def test_an_isolated_singular_configuration_is_found_between_the_points_of_the_grid(
    coupler: float, refused: bool, upper: float
) -> None:
    # couplers as long as the elbows are apart at most: they stretch only where the cranks point away from each other
    scene = five_bar(
        f'bodies.first.mesh="0.0:{coupler}:4"',
        f'bodies.second.mesh="0.0:{coupler}:4"',
        *limited("theta1", 2.71, upper),
        *limited("theta2", -0.43, 0.41),
    )
    if not refused:
        kinematics_of(scene)
        return
    message = refusal(kinematics_of, scene)
    # two steps of the grid
    np.testing.assert_allclose(configuration(message), [np.pi, 0.0], rtol=0, atol=0.2)
    assert "they do not control the mechanism at theta1 = " in message or "cannot close at theta1 = " in message


def test_a_third_coordinate() -> None:
    """An open chain in the plane: every angle adds to those before it."""
    kinematics = kinematics_of(double_pendulum(*THIRD))
    theta = np.array([[0.4, -0.7, 0.2], [-2.0, 9.0, 1.0]])
    np.testing.assert_allclose(kinematics.poses(theta)[:, 2].T, np.cumsum(theta, axis=1), rtol=0.0, atol=1e-12)
    assert kinematics.n_redundant == 0 and kinematics.branch is None
