"""Rigid kinematics in space: closed forms of open chains and of loops, the plane, derivatives, and every refusal."""

import numpy as np
import pytest
from frames import check_derivatives
from refusals import refusal
from scipy.spatial.transform import Rotation
from spatial import (
    LIMITED,
    ROD,
    SECOND_AXIS,
    TURN,
    UPPER,
    arm,
    assembled,
    crank_tip,
    part_of_arm,
    slider_crank_in_space,
    slider_place,
    solid,
    spatial_slider_crank,
    table,
)

from pgmp_petsc.mechanism.closure import LoopClosure
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import BodyStatements
from pgmp_petsc.mechanism.space import SPATIAL, directors
from pgmp_petsc.scene import Scene
from scenes import kinematics_of, slider_crank

# more than a revolution, and places between the configurations of the continuation
THETA = np.concatenate([np.linspace(0.0, 2 * np.pi, 37), np.random.default_rng(0).uniform(-15.0, 15.0, 40)])
CLOSED = 1e-11  # the closure is solved to 1e-12 of the mechanism's size
# a part of a revolution, which takes a third of the time to follow, and places in it
PART, IN_PART = "range = [-1.0, 1.0]", np.random.default_rng(1).uniform(-1.0, 1.0, 20)


def place(kinematics: RigidKinematics, address: str, theta: np.ndarray) -> np.ndarray:
    """Return the place of a point over theta, shape (3, n)."""
    return kinematics.mechanism.attachment(address, "test").frame_of_pose(kinematics.poses(theta))[:3]


def rotations(kinematics: RigidKinematics, body: str, theta: np.ndarray) -> np.ndarray:
    """Return the rotation matrices of a body over theta, shape (n, 3, 3)."""
    number = [one.name for one in kinematics.mechanism.bodies].index(body)
    return np.swapaxes(kinematics.poses(theta)[number, 3:].T.reshape(-1, 3, 3), 1, 2)


def about(axis: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return rotations about a unit vector, shape (n, 3, 3)."""
    return Rotation.from_rotvec(np.multiply.outer(theta, np.asarray(axis))).as_matrix()


def lifted(planar: np.ndarray) -> np.ndarray:
    """Return poses in the plane (n_bodies, 3, ...) as poses in space (n_bodies, 12, ...)."""
    x, y, phi = np.moveaxis(planar, 1, 0)
    cos, sin, zero = np.cos(phi), np.sin(phi), np.zeros_like(phi)
    return np.stack([x, y, zero, cos, sin, zero, -sin, cos, zero, zero, zero, zero + 1.0], axis=1)


@pytest.fixture(scope="module")
def crank_and_slider() -> RigidKinematics:
    return kinematics_of(spatial_slider_crank())


def test_the_slider_of_the_spatial_slider_crank(crank_and_slider: RigidKinematics) -> None:
    # 5 + 3 + 4 + 5 constraints on three bodies of six degrees of freedom
    assert crank_and_slider.n_redundant == 0
    tip = place(crank_and_slider, "crank:tip", THETA)
    np.testing.assert_allclose(tip, crank_tip(THETA), rtol=0, atol=CLOSED)
    slider = place(crank_and_slider, "slider:hinge", THETA)
    np.testing.assert_allclose(slider[0], slider_place(THETA), rtol=0, atol=1e-10)
    np.testing.assert_allclose(slider[1:], 0.0, rtol=0, atol=CLOSED)
    # the stroke: between one and two crank lengths
    assert 0.1 < np.ptp(slider[0]) < 0.2


def test_the_bodies_of_the_spatial_slider_crank(crank_and_slider: RigidKinematics) -> None:
    for ends in (("rod:hinge", "crank:tip"), ("rod:tip", "slider:hinge")):
        one, other = (place(crank_and_slider, end, THETA) for end in ends)
        np.testing.assert_allclose(one, other, rtol=0, atol=CLOSED)
    # the prismatic guide keeps the slider from turning
    np.testing.assert_allclose(rotations(crank_and_slider, "slider", THETA) - np.eye(3), 0.0, rtol=0, atol=CLOSED)
    rod = rotations(crank_and_slider, "rod", THETA)
    along = place(crank_and_slider, "rod:tip", THETA) - place(crank_and_slider, "rod:hinge", THETA)
    np.testing.assert_allclose(rod[:, :, 0].T, along / ROD, rtol=0, atol=1e-10)
    # the universal joint: the direction that was z in the rod as it is placed stays at a right angle to y
    held = Rotation.from_rotvec([0.0, 0.07, -0.34]).as_matrix().T @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose((rod @ held)[:, 1], 0.0, rtol=0, atol=CLOSED)


def test_the_rates_of_the_spatial_slider_crank(crank_and_slider: RigidKinematics) -> None:
    check_derivatives(crank_and_slider, THETA[:, None])


def test_the_angle_of_a_coordinate_counts_turns_and_its_poses_do_not(crank_and_slider: RigidKinematics) -> None:
    theta = np.linspace(0.0, 6.0, 9)
    expected = crank_and_slider.poses(theta)
    for turns in (-3, 1):
        found = crank_and_slider.poses(theta + 2 * np.pi * turns)
        np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSED)
    residual = LoopClosure(crank_and_slider.mechanism).residual(expected, theta[:, None])
    assert residual.shape == (17 + 1, 9)  # joints and the coordinate
    np.testing.assert_allclose(residual, 0.0, rtol=0, atol=1e-12)


def test_a_slider_crank_in_space_moves_as_the_one_in_the_plane() -> None:
    deep, flat = kinematics_of(slider_crank_in_space()), kinematics_of(slider_crank())
    # 5 + 5 + 2 constraints leave one of twelve degrees of freedom: one of them says again what the others do
    assert (deep.n_redundant, flat.n_redundant) == (1, 0)
    poses, planar = deep.poses(THETA), flat.poses(THETA)
    np.testing.assert_allclose(poses, lifted(planar), rtol=0, atol=CLOSED)
    rates, flat_rates = deep.rates(poses), flat.rates(planar)
    second = deep.curvatures(poses, rates)
    flat_second = flat.curvatures(planar, flat_rates)
    many = np.repeat(poses, 400, axis=2)  # piece by piece, each as it is alone
    np.testing.assert_array_equal(deep.rates(many), np.repeat(rates, 400, axis=3))
    np.testing.assert_array_equal(deep.curvatures(many, deep.rates(many)), np.repeat(second, 400, axis=4))
    # the derivatives of cos phi and sin phi
    phi, turning = planar[:, 2], flat_rates[:, 2, 0]
    cos, sin = np.cos(phi), np.sin(phi)
    for flat_part, part, spin, centripetal in (
        (flat_rates[:, :, 0], rates[:, :, 0], turning, 0.0),
        (flat_second[:, :, 0, 0], second[:, :, 0, 0], flat_second[:, 2, 0, 0], turning**2),
    ):
        # the rates of the couplers are of order 1, and solved as the poses
        np.testing.assert_allclose(part[:, :2], flat_part[:, :2], rtol=0, atol=CLOSED)
        first = np.stack([-sin * spin - cos * centripetal, cos * spin - sin * centripetal, 0.0 * sin], axis=1)
        np.testing.assert_allclose(part[:, 3:6], first, rtol=0, atol=CLOSED)
        np.testing.assert_allclose(part[:, [2, *range(9, 12)]], 0.0, rtol=0, atol=CLOSED)


def test_the_sign_of_an_angle_follows_the_order_of_a_joints_points() -> None:
    """The coordinate is the second body's angle against the first: the ground's, if that is the second."""
    turned = 'joints.crank_hinge.connect=["crank:hinge","ground:origin"]'
    deep = kinematics_of(slider_crank_in_space(turned, *LIMITED))
    flat = kinematics_of(slider_crank(turned, *LIMITED))
    np.testing.assert_allclose(deep.poses(IN_PART), lifted(flat.poses(IN_PART)), rtol=0, atol=CLOSED)
    np.testing.assert_allclose(place(deep, "crank:tip", IN_PART)[1], -0.3 * np.sin(IN_PART), rtol=0, atol=CLOSED)


def test_an_angle_starts_where_the_bodies_are_placed() -> None:
    """In space an angle is 0 where a joint's bodies are as placed; in the plane it is that between their axes."""
    placed = "bodies.crank.placement={origin=[0.0,0.0,0.0],rotation=[0.0,0.0,0.5]}"
    kinematics = kinematics_of(slider_crank_in_space(placed, *LIMITED))
    tip, angle = place(kinematics, "crank:tip", IN_PART), IN_PART + 0.5
    np.testing.assert_allclose(tip[:2], 0.3 * np.array([np.cos(angle), np.sin(angle)]), rtol=0, atol=CLOSED)


def test_hinges_everywhere_say_many_things_again() -> None:
    """A slider of its own on a guide, hinged to the rod: 20 constraints of which 17 are independent."""
    slider = (
        'bodies.slider={mesh="1.0:1.1:1",element="solid3d",material="steel"}',
        'joints.slider={type="prismatic",connect=["ground:origin","slider:hinge"],axis=[1.0,0.0,0.0]}',
        'joints.wrist={type="revolute",connect=["rod:tip","slider:hinge"],axis=[0.0,0.0,1.0]}',
    )
    kinematics = kinematics_of(slider_crank_in_space(*slider, *LIMITED))
    flat = kinematics_of(slider_crank(*LIMITED))
    assert kinematics.n_redundant == 3
    np.testing.assert_allclose(kinematics.poses(IN_PART)[:2], lifted(flat.poses(IN_PART)), rtol=0, atol=CLOSED)
    check_derivatives(kinematics, 0.9 * IN_PART[:, None])


BENNETT = (0.3, 0.5)  # lengths of the sides, m
TWISTS = (0.5, np.arcsin(BENNETT[1] / BENNETT[0] * np.sin(0.5)))  # lengths over sines of twists are the same
BENNETT_START = 0.9


def step_along(theta: np.ndarray, length: float, twist: float) -> np.ndarray:
    """Return the transformations (n, 4, 4) of Denavit and Hartenberg from one axis to the next."""
    found = np.zeros((theta.size, 4, 4))
    tilt = about([1.0, 0.0, 0.0], np.array([twist]))[0]
    found[:, :3, :3] = about([0.0, 0.0, 1.0], theta) @ tilt
    found[:, :3, 3] = length * np.array([np.cos(theta), np.sin(theta), 0.0 * theta]).T
    found[:, 3, 3] = 1.0
    return found


def bennett_links(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (3, n, 3, 3) and origins (3, n, 3) of the three moving links (Bennett 1903).

    The angles at the four axes are ``theta, phi, -theta, -phi`` with ``tan(theta/2) tan(phi/2) = sin((beta + alpha)/2)
    / sin((beta - alpha)/2)``, alpha and beta the twists.
    """
    alpha, beta = TWISTS
    phi = 2 * np.arctan2(
        np.sin(0.5 * (beta + alpha)) * np.cos(0.5 * theta), np.sin(0.5 * (beta - alpha)) * np.sin(0.5 * theta)
    )
    angles = (theta, phi, -theta, -phi)
    steps = [step_along(angle, *link) for angle, link in zip(angles, 2 * list(zip(BENNETT, TWISTS)))]
    np.testing.assert_allclose(
        steps[0] @ steps[1] @ steps[2] @ steps[3], np.tile(np.eye(4), (theta.size, 1, 1)), atol=1e-14
    )
    before = [np.tile(np.eye(4), (theta.size, 1, 1)), steps[0], steps[0] @ steps[1]]
    turns = [one[:, :3, :3] @ about([0.0, 0.0, 1.0], angle) for one, angle in zip(before, angles)]
    return np.array(turns), np.array([one[:, :3, 3] for one in before])


def bennett() -> Scene:
    """Return a Bennett linkage: four hinges, no two of them parallel or meeting, that move all the same."""
    turns, origins = bennett_links(np.array([BENNETT_START]))
    lengths = (BENNETT[0], BENNETT[1], BENNETT[0])
    next_axes = [[0.0, -np.sin(twist), np.cos(twist)] for twist in (TWISTS[0], TWISTS[1], TWISTS[0])]
    bodies = [
        solid(f"link{k}", length, origin, Rotation.from_matrix(turn).as_rotvec())
        for k, (length, turn, origin) in enumerate(zip(lengths, turns[:, 0], origins[:, 0]))
    ]
    ends = [("ground:origin", "link0:hinge"), ("link0:tip", "link1:hinge"), ("link1:tip", "link2:hinge"),
            ("link2:tip", "ground:last")]  # fmt: skip
    axes = [[0.0, 0.0, 1.0], *next_axes]
    names = ("drive", "second", "third", "fourth")
    joints = [
        table(f"joints.{name}", type="revolute", connect=pair, axis=axis) for name, pair, axis in zip(names, ends, axes)
    ]
    return assembled(table("ground.points", last=[-BENNETT[1], 0.0, 0.0]), *bodies, *joints)


def test_a_bennett_linkage() -> None:
    kinematics = kinematics_of(bennett())
    # 20 constraints would take two degrees of freedom more than three bodies have
    assert kinematics.n_redundant == 3
    turns, origins = bennett_links(BENNETT_START + THETA)
    for k in range(3):
        np.testing.assert_allclose(rotations(kinematics, f"link{k}", THETA), turns[k], rtol=0, atol=1e-10)
        np.testing.assert_allclose(place(kinematics, f"link{k}:hinge", THETA), origins[k].T, rtol=0, atol=1e-10)
    check_derivatives(kinematics, THETA[:, None])


BEND = 0.6  # between two shafts, rad
ALONG = np.array([np.cos(BEND), np.sin(BEND), 0.0])


def cardan(bend: float = BEND) -> Scene:
    """Return two shafts that meet at the origin in a universal joint, the second one bent towards y."""
    along = np.array([np.cos(bend), np.sin(bend), 0.0])
    return assembled(
        table("ground.points", start=[-0.2, 0.0, 0.0], end=0.2 * along),
        solid("driver", 0.2, [-0.2, 0.0, 0.0]),
        solid("follower", 0.2, [0.0, 0.0, 0.0], [0.0, 0.0, bend]),
        table("joints.drive", type="revolute", connect=["ground:start", "driver:hinge"], axis=[1.0, 0.0, 0.0]),
        table("joints.bearing", type="revolute", connect=["ground:end", "follower:tip"], axis=along),
        table("joints.cross", type="universal", connect=["driver:tip", "follower:hinge"], axis=[0.0, 0.0, 1.0],
              second_axis=[-along[1], along[0], 0.0]),
    )  # fmt: skip


def test_a_universal_joint_turns_unevenly() -> None:
    """Hooke's joint: ``tan phi = tan theta cos bend``."""
    kinematics = kinematics_of(cardan())
    assert kinematics.n_redundant == 14 - 11
    phi = np.arctan2(np.sin(THETA) * np.cos(BEND), np.cos(THETA))
    expected = about(ALONG, phi) @ about([0.0, 0.0, 1.0], np.array([BEND]))
    np.testing.assert_allclose(rotations(kinematics, "follower", THETA), expected, rtol=0, atol=CLOSED)
    assert np.ptp(np.unwrap(phi[:37]) - THETA[:37]) > 0.1


def test_a_yoke_on_a_guide() -> None:
    """The crank's tip moves in a slot across the guide: a plane fixed in the yoke. x = r cos theta."""
    kinematics = kinematics_of(assembled(
        solid("crank", 0.1),
        solid("yoke", 0.2, [0.1, 0.0, 0.0]),
        table("joints.drive", type="revolute", connect=["ground:origin", "crank:hinge"], axis=[0.0, 0.0, 1.0]),
        table("joints.guide", type="prismatic", connect=["ground:origin", "yoke:hinge"], axis=[1.0, 0.0, 0.0]),
        table("joints.slot", type="point_on_plane", connect=["yoke:hinge", "crank:tip"], normal=[1.0, 0.0, 0.0]),
        coordinate=PART,
    ))  # fmt: skip
    assert kinematics.n_redundant == 0
    found = place(kinematics, "yoke:hinge", IN_PART)
    np.testing.assert_allclose(found, [0.1 * np.cos(IN_PART), 0.0 * IN_PART, 0.0 * IN_PART], rtol=0, atol=CLOSED)
    np.testing.assert_allclose(rotations(kinematics, "yoke", IN_PART) - np.eye(3), 0.0, rtol=0, atol=CLOSED)


def test_a_sleeve_that_slides_and_turns() -> None:
    """A sleeve on a rail below the crank carries a line through the crank's tip: both its motions are closed forms."""
    depth, radius = 0.15, 0.1
    kinematics = kinematics_of(assembled(
        table("ground.points", rail=[0.0, 0.0, -depth]),
        solid("crank", radius),
        solid("sleeve", 0.2, [radius, 0.0, -depth]),
        table("joints.drive", type="revolute", connect=["ground:origin", "crank:hinge"], axis=[0.0, 0.0, 1.0]),
        table("joints.rail", type="cylindrical", connect=["ground:rail", "sleeve:hinge"], axis=[1.0, 0.0, 0.0]),
        table("joints.pin", type="point_on_line", connect=["sleeve:hinge", "crank:tip"], direction=[0.0, 0.0, 1.0]),
    ))  # fmt: skip
    assert kinematics.n_redundant == 0
    found = place(kinematics, "sleeve:hinge", THETA)
    np.testing.assert_allclose(found, [radius * np.cos(THETA), 0.0 * THETA, 0.0 * THETA - depth], rtol=0, atol=CLOSED)
    turned = about([1.0, 0.0, 0.0], -np.arctan(radius * np.sin(THETA) / depth))
    np.testing.assert_allclose(rotations(kinematics, "sleeve", THETA), turned, rtol=0, atol=CLOSED)
    check_derivatives(kinematics, THETA[:, None])


def test_a_weld_keeps_the_rotation_as_placed() -> None:
    turn = np.array([0.4, -0.3, 0.8])
    kinematics = kinematics_of(assembled(
        solid("crank", 0.3),
        solid("arm", 0.2, [0.0, 0.0, 0.0], turn),  # its place follows from the weld
        table("joints.drive", type="revolute", connect=["ground:origin", "crank:hinge"], axis=[0.0, 0.6, 0.8]),
        table("joints.weld", type="fixed", connect=["crank:tip", "arm:hinge"]),
        coordinate=PART,
    ))  # fmt: skip
    assert kinematics.n_redundant == 0
    crank = about([0.0, 0.6, 0.8], IN_PART)
    expected = crank @ Rotation.from_rotvec(turn).as_matrix()
    np.testing.assert_allclose(rotations(kinematics, "arm", IN_PART), expected, rtol=0, atol=CLOSED)
    np.testing.assert_allclose(place(kinematics, "arm:hinge", IN_PART), 0.3 * crank[:, :, 0].T, rtol=0, atol=CLOSED)


SPINDLE = np.array([0.36, 0.48, 0.8])
ACROSS = np.array([0.8, -0.6, 0.0])
START = Rotation.from_matrix(np.column_stack([SPINDLE, ACROSS, np.cross(SPINDLE, ACROSS)]))


def spindle(kind: str, **entries: object) -> RigidKinematics:
    """Return the kinematics of a bar that turns about itself in a hinge, its other end in a second joint."""
    return kinematics_of(assembled(
        table("ground.points", end=0.3 * SPINDLE),
        solid("bar", 0.3, [0.0, 0.0, 0.0], START.as_rotvec()),
        table("joints.drive", type="revolute", connect=["ground:origin", "bar:hinge"], axis=SPINDLE),
        table("joints.second", type=kind, connect=["ground:end", "bar:tip"], **entries),
        coordinate=PART,
    ))  # fmt: skip


# every joint that lets the bar turn says nothing that the hinge does not: as many redundant constraints as it has
HARMLESS = {
    "spherical": (3, {}), "revolute": (5, {"axis": SPINDLE}),
    "universal": (4, {"axis": SPINDLE, "second_axis": ACROSS}), "cylindrical": (4, {"axis": SPINDLE}),
    "point_on_line": (2, {"direction": SPINDLE}), "point_on_plane": (1, {"normal": SPINDLE}),
}  # fmt: skip


@pytest.mark.parametrize("kind", HARMLESS)
def test_a_bar_that_turns_about_itself(kind: str) -> None:
    count, entries = HARMLESS[kind]
    kinematics = spindle(kind, **entries)
    assert kinematics.n_redundant == count
    expected = about(SPINDLE, IN_PART) @ START.as_matrix()
    np.testing.assert_allclose(rotations(kinematics, "bar", IN_PART), expected, rtol=0, atol=CLOSED)
    np.testing.assert_allclose(
        place(kinematics, "bar:tip", IN_PART), 0.3 * SPINDLE[:, None] + 0.0 * IN_PART, rtol=0, atol=CLOSED
    )


def test_an_open_chain_of_two_coordinates() -> None:
    kinematics = kinematics_of(arm(*part_of_arm(1.0)))
    theta = np.random.default_rng(1).uniform(-0.95, 0.95, (40, 2))
    assert (kinematics.n_coordinates, kinematics.n_redundant) == (2, 0)
    first = about([0.0, 0.0, 1.0], theta[:, 0])
    second = first @ about(SECOND_AXIS, theta[:, 1])
    np.testing.assert_allclose(rotations(kinematics, "upper", theta), first, rtol=0, atol=CLOSED)
    np.testing.assert_allclose(rotations(kinematics, "lower", theta), second, rtol=0, atol=CLOSED)
    np.testing.assert_allclose(place(kinematics, "lower:hinge", theta), UPPER * first[:, :, 0].T, rtol=0, atol=CLOSED)
    check_derivatives(kinematics, theta)


def test_the_derivatives_of_coordinates_in_small_motions_of_nodes() -> None:
    """By which the bending of a joint's nodes changes its angle, in body frames: of both bodies, or of the only one."""
    kinematics = kinematics_of(arm(*part_of_arm(1.0)))
    poses, step = kinematics.poses(np.array([[0.4, -0.7]]))[..., 0], 1e-5
    for coordinate, n_moving in zip(kinematics.coordinates, (1, 2)):
        joint = coordinate.connection
        gradient = BodyStatements(kinematics.mechanism, [(joint.angle, joint.sides)]).dense(poses)
        moving = [side for side in joint.sides if not side.on_ground]
        assert len(moving) == n_moving
        assert not np.delete(gradient, np.concatenate([side.dofs for side in moving]), axis=1).any()
        for moved in moving:
            for k, unit in enumerate(step * np.eye(6)):
                angles = []
                for motion in (unit, -unit):
                    frames = [side.frame_of_pose(poses) for side in coordinate.connection.sides]
                    number = coordinate.connection.sides.index(moved)
                    turn = directors(frames[number])
                    turned = turn @ Rotation.from_rotvec(motion[3:]).as_matrix()
                    frames[number] = np.concatenate([frames[number][:3] + turn @ motion[:3], turned.T.ravel()])
                    angles.append(SPATIAL.measure(coordinate.connection.angle, *frames))
                # second order, 1e-10, and round-off over the step, 1e-11
                assert gradient[0, moved.dofs[k]] == pytest.approx((angles[0] - angles[1]) / (2 * step), abs=1e-9)


def test_a_range_that_does_not_begin_at_zero() -> None:
    """More than half a turn away from the placement, where the measured angle is another one by a whole turn."""
    kinematics = kinematics_of(slider_crank_in_space(
        "coordinates.theta.range=[4.0,7.0]", "coordinates.theta.periodic=false",
        "simulation.initial.theta.position=4.0",
    ))  # fmt: skip
    theta = np.linspace(4.0, 7.0, 13)
    tip = place(kinematics, "crank:tip", theta)
    np.testing.assert_allclose(tip[:2], 0.3 * np.array([np.cos(theta), np.sin(theta)]), rtol=0, atol=CLOSED)
    assert kinematics.within_reach(np.array([[3.9], [3.96], [7.04], [7.1]])).tolist() == [False, True, True, False]


# a rod with its ends on the x and the y axis, of two halves, and a crank from the origin to its middle
TRAMMEL = (
    solid("crank", 0.5),
    solid("near", 0.5, [1.0, 0.0, 0.0], [0.0, 0.0, np.pi]),
    solid("far", 0.5, [0.5, 0.0, 0.0], [0.0, 0.0, np.pi]),
    table("joints.drive", type="revolute", connect=["ground:origin", "crank:hinge"], axis=[0.0, 0.0, 1.0]),
    table("joints.middle", type="revolute", connect=["near:tip", "crank:tip"], axis=[0.0, 0.0, 1.0]),
    table("joints.weld", type="fixed", connect=["near:tip", "far:hinge"]),
    table("joints.along_x", type="point_on_line", connect=["ground:origin", "near:hinge"], direction=[1.0, 0.0, 0.0]),
    table("joints.along_y", type="point_on_line", connect=["ground:origin", "far:tip"], direction=[0.0, 1.0, 0.0]),
)


def test_a_trammel() -> None:
    kinematics = kinematics_of(assembled(*TRAMMEL))
    assert kinematics.n_redundant == 3
    np.testing.assert_allclose(place(kinematics, "near:hinge", THETA)[0], np.cos(THETA), rtol=0, atol=CLOSED)
    np.testing.assert_allclose(place(kinematics, "far:tip", THETA)[1], np.sin(THETA), rtol=0, atol=CLOSED)


def test_too_few_coordinates_are_refused() -> None:
    """Balls at both ends leave the rod free to turn about itself."""
    loose = 'joints.cross={type="spherical",connect=["slider:hinge","rod:tip"]}'
    message = refusal(kinematics_of, spatial_slider_crank(loose))
    assert message.startswith(
        "joints: they leave the rigid mechanism 2 degrees of freedom (18 of its 3 bodies less 16 independent "
        "constraints), but 1 coordinate was named: theta. Both numbers must be equal. rod can spin idly about the line "
        "through its joints ball and cross: "
    )
    assert 'joints.cross: type = "universal", axis = [' in message
    # with what it says the mechanism is sound
    axes = message.split('type = "universal", ')[1]
    kinematics_of(spatial_slider_crank(loose.replace('"spherical"', f'"universal",{axes}')))


def test_a_chain_of_three_coordinates_is_where_its_angles_put_it() -> None:
    """Turns about three axes one after the other, from any configuration to any other."""
    third = (
        'bodies.hand={mesh="0.0:0.1:1",element="solid3d",material="steel"}',
        'joints.wrist={type="revolute",connect=["lower:tip","hand:hinge"],axis=[0.0,1.0,0.0]}',
        f'coordinates.theta3={{joint="wrist",{TURN.replace(";", ",")}}}',
    )
    kinematics = kinematics_of(arm(*third))
    theta = np.array([[0.3, -1.2, 2.0], [4.0, 0.5, -7.0], [0.3, -1.2, 2.1]])
    poses = kinematics.poses(theta)
    assert np.abs(LoopClosure(kinematics.mechanism).residual(poses, theta)).max() < 1e-11
    alone = kinematics.poses(theta[1:2])
    np.testing.assert_array_equal(poses[..., 1:2], alone)
    change = kinematics.poses(theta[:1] + [[0.0, 0.0, 1e-6]]) - kinematics.poses(theta[:1] - [[0.0, 0.0, 1e-6]])
    np.testing.assert_allclose(kinematics.rates(poses)[:, :, 2, 0], change[..., 0] / 2e-6, atol=1e-8)


def test_shafts_at_a_right_angle_are_refused() -> None:
    """A universal joint locks there: the follower stands still until both its axes lie in one direction."""
    message = refusal(kinematics_of, cardan(np.pi / 2))
    assert message.startswith("coordinates.theta: it does not control the mechanism at 1.57")


def test_a_rod_that_is_too_short_is_refused() -> None:
    message = refusal(kinematics_of, spatial_slider_crank('bodies.rod.mesh="0.0:0.21:1"'))
    assert "the mechanism cannot close at theta = " in message
    theta = float(message.split("theta = ")[1].split(" rad")[0])
    # there the crank's tip is as far from the slider's axis as the rod is long; 0.005 m are a step of the continuation
    assert np.hypot(*crank_tip(np.array([theta]))[1:, 0]) == pytest.approx(0.21, abs=0.005)
