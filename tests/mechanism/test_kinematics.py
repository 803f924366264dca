"""Rigid kinematics: closed forms, derivatives, revolutions, and every refusal."""

import re

import numpy as np
import pytest
from combinations import KINDS, WHEEL
from frames import check_derivatives
from refusals import refusal

from pgmp_petsc.scene import scene_from_toml
from scenes import CRANK, ROD, four_bar, kinematics_of, slider_crank, trammel

# several revolutions, negative angles, and the ends of the range
THETA = np.concatenate([np.linspace(-20.0, 20.0, 41), [0.0, np.pi / 2, np.pi, 2 * np.pi, -2 * np.pi]])
TURNS = 'type="revolute",axis=[0.0,0.0,1.0]'
NOT_PERIODIC = "coordinates.theta.periodic=false"


def slider_crank_poses(theta: np.ndarray) -> np.ndarray:
    """Return the closed form of the poses, shape (2, 3, n); the rod's mesh begins at x = CRANK."""
    zero, rod = 0.0 * theta, -np.arcsin(CRANK / ROD * np.sin(theta))
    origin = CRANK * np.array([np.cos(theta) - np.cos(rod), np.sin(theta) - np.sin(rod)])
    return np.array([[zero, zero, theta], [*origin, rod]])


def four_bar_poses(theta: np.ndarray) -> np.ndarray:
    """Return the closed form of the crank-rocker in its upper branch: two circles meet at the knee."""
    coupler, rocker = 0.9, 0.7
    elbow = CRANK * np.array([np.cos(theta), np.sin(theta)])
    pivot = np.array([1.0, 0.0])[:, None]
    along = pivot - elbow
    distance = np.hypot(*along)
    along = along / distance
    foot = (distance**2 + coupler**2 - rocker**2) / (2 * distance)
    knee = elbow + foot * along + np.sqrt(coupler**2 - foot**2) * np.array([-along[1], along[0]])
    zero = 0.0 * theta
    return np.array(
        [
            [zero, zero, theta],
            [*elbow, np.arctan2(*(knee - elbow)[::-1])],
            [zero + 1.0, zero, np.arctan2(*(knee - pivot)[::-1])],
        ]
    )


@pytest.mark.parametrize("lower", [-12.2, -20.1, -61.3])
def test_a_range_that_begins_turns_away_from_where_bodies_are_placed(lower: float) -> None:
    turning = kinematics_of(slider_crank(NOT_PERIODIC, f"coordinates.theta.range=[{lower}, 20.1]"))
    assert turning.branch.is_exact  # cells are placed to the round-off of the range, however many turns it has
    theta = np.linspace(lower, 20.1, 41)
    np.testing.assert_allclose(turning.poses(theta), slider_crank_poses(theta), rtol=0, atol=1e-11)


def test_slider_crank_poses() -> None:
    crank_slider = kinematics_of(slider_crank())
    poses = crank_slider.poses(THETA)
    # the closure is solved to 1e-12 of the largest body, 0.7 m
    np.testing.assert_allclose(poses, slider_crank_poses(THETA), rtol=0, atol=1e-11)
    slider = crank_slider.mechanism.attachment("rod:tip", "test").frame_of_pose(poses)
    expected = CRANK * np.cos(THETA) + np.sqrt(ROD**2 - (CRANK * np.sin(THETA)) ** 2)
    np.testing.assert_allclose(slider[0], expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(slider[1], 0.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(slider[2], poses[1, 2], rtol=0, atol=0)


def lever_poses(theta: np.ndarray) -> list:
    zero, lever = 0.0 * theta, np.arctan2(CRANK * np.sin(theta), 1.0 + CRANK * np.cos(theta))
    return [[zero, zero, theta], [zero - 1.0, zero, lever]]


def trammel_poses(theta: np.ndarray) -> list:
    """Return poses at the rod's end on the x axis: it turns backwards, and its ends are on the axes."""
    zero = 0.0 * theta
    return [[np.cos(theta), zero, np.pi - theta], [zero, zero, theta]]


#: The placement chooses the branch in which a mechanism is assembled.
MIRRORED = (
    "bodies.coupler.placement={origin=[0.3,0.0],angle=-0.8}", "bodies.rocker.placement={origin=[1.0,0.0],angle=-1.5}",
)  # fmt: skip
CLOSED_FORMS = {
    "four-bar": (four_bar, four_bar_poses),
    "slotted lever": (lambda: quick_return(), lever_poses),
    "another branch": (
        lambda: four_bar(*MIRRORED), lambda theta: four_bar_poses(-theta) * np.array([1.0, -1.0, -1.0])[:, None]),
    "turns backwards": (trammel, trammel_poses),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_poses_are_those_of_the_closed_form(name: str) -> None:
    scene, poses = CLOSED_FORMS[name]
    np.testing.assert_allclose(kinematics_of(scene()).poses(THETA), poses(THETA), rtol=0, atol=1e-11)


NAMES = ("slider-crank", "four-bar", "quick return", "trammel")


@pytest.mark.parametrize("scene", [slider_crank, four_bar, lambda: quick_return(), trammel], ids=NAMES)
def test_derivatives_are_those_of_the_poses(scene) -> None:
    # dead centres are among the places
    check_derivatives(kinematics_of(scene()), np.linspace(-3.0, 9.0, 13)[:, None])


def quick_return() -> object:
    """Return a slotted lever: a pin of the crank runs in a line that turns with the lever."""
    return slider_crank(
        "ground.points.pivot=[-1.0,0.0]",
        'bodies.rod.mesh="0.0:1.5:5"',
        "bodies.rod.placement={origin=[-1.0,0.0],angle=0.0}",
        'joints.elbow={type="revolute",connect=["ground:pivot","rod:hinge"]}',
        'joints.slider={type="point_on_line",connect=["rod:hinge","crank:tip"],direction=[1.0,0.0]}',
    )


def test_a_rod_too_short_cannot_close() -> None:
    message = refusal(kinematics_of, slider_crank('bodies.rod.mesh="0.3:0.5:5"'))
    assert message.startswith("joints.slider: the mechanism cannot close at theta = 0.7")
    # the rod reaches as far as sin(theta) = 2/3, 0.7297 rad; one step of 0.02 rad later it does not
    assert 0.7297 < float(message.split("theta = ")[1].split(" rad")[0]) < 0.7297 + 0.02
    for part in ("a gap of ", "lengths and placements", "coordinates.theta.range"):
        assert part in message


def joined_by(coordinate: str, *joints: str) -> object:
    """Return a slider-crank with some of its joints, whose coordinate is in one of them."""
    scene = slider_crank()
    kept = {name.replace("elbow", coordinate): scene.joints[name] for name in joints}
    coordinates = {"theta": scene.coordinates["theta"].model_copy(update={"joint": coordinate})}
    return scene.model_copy(update={"joints": kept, "coordinates": coordinates})


def up_to(upper: float, lower: float = 0.0, rod: str = "0.3:0.6:5", *more: str) -> object:
    """Return a slider-crank that starts at the lower end of a range; its rod is as long as its crank unless said."""
    ends = f"coordinates.theta.range=[{lower},{upper}]", f"simulation.initial.theta.position={lower}"
    return slider_crank(f'bodies.rod.mesh="{rod}"', NOT_PERIODIC, *ends, *more)


DEAD = np.arcsin(2 / 3)  # the rod of 0.2 m stands upright under a crank of 0.3 m
#: A triangle of both ends on the ground, assembled at the only angle that it can have.
TRIANGLE = np.arccos((1.0 + CRANK**2 - 0.8**2) / (2 * CRANK))
TO_A_WALL = "ground.points.wall=[1.0,0.0]", 'joints.pin={type="revolute",connect=["ground:wall","rod:tip"]}'
#: Mechanisms, and one of the ways in which each may be refused: how it begins, and further words.
REFUSED = {
    "too many degrees of freedom": (
        lambda: slider_crank().model_copy(update={"joints": joined_by("elbow", "crank_hinge", "elbow").joints}),
        ("joints: they leave the rigid mechanism 2 degrees of freedom (6 of its 2 bodies less 4 independent "
         "constraints), but 1 coordinate was named: theta. Both numbers must be equal. rod can move by itself in "
         "elbow: name a coordinate for it, or join it otherwise",),
    ),
    "more coordinates": (
        lambda: slider_crank('coordinates.psi={joint="elbow",range=[0.0,1.0]}'),
        ("joints: they leave the rigid mechanism 1 degree of freedom (6 of its 2 bodies less 5 independent "
         "constraints), but 2 coordinates were named: theta, psi. Both numbers must be equal",),
    ),
    # a frame on mounts that are effects, and a crank on it: neither moves while the other rests
    "joined to each other alone": (
        lambda: joined_by("hub", "elbow"),
        ("", "4 degrees of freedom", "crank and rod are joined to each other alone", "elastic.stiffness"),
    ),
    # a parallelogram with its links in one line, where it can fold as well
    "begins in a singular position": (
        lambda: four_bar(*(f'bodies.{name}.mesh="0.0:{length}:4"' for name, length in
                           {"crank": 0.3, "coupler": 1.0, "rocker": 0.3}.items())),
        ("joints: at theta = 0 rad the rigid mechanism is in a singular position", "2 degrees of freedom",
         "elsewhere it has 1, as many as coordinates"),
    ),
    # links that reach in one line alone: there is no other configuration
    "is in a singular position alone": (
        lambda: four_bar('bodies.coupler.mesh="0.0:0.4:4"', 'bodies.rocker.mesh="0.0:0.3:3"'),
        ("joints: they leave the rigid mechanism 2 degrees of freedom", "9 of its 3 bodies less 7 independent",
         "All 8 would leave as many as were named", "where links fall into one line"),
    ),
    "no degree of freedom": (
        lambda: up_to(2.0, TRIANGLE, "0.0:0.8:5", *TO_A_WALL),
        ("", "leave the rigid mechanism 0 degrees of freedom", "6 of its 2 bodies less 6 independent constraints"),
    ),
    # a step of the continuation falls on pi/2, where both stand upright
    "loses control": (
        lambda: up_to(np.pi),
        ("coordinates.theta: it does not control the mechanism at 1.5708 rad (smallest singular",
         "choose another joint or a range without this configuration"),
    ),
    # steps fall beside pi/2: the determinant of the closure changes its sign between them
    **{
        f"loses control between steps to {upper}": (
            lambda upper=upper: up_to(upper), ("", "coordinates.theta: it does not control the mechanism at 1.57")
        )
        for upper in (2.0, 2 * np.pi)
    },
    "closes nowhere": (
        lambda: four_bar('bodies.coupler.mesh="0.0:0.1:2"', 'bodies.rocker.mesh="0.0:0.1:2"'),
        ("joints.", "the mechanism cannot close at theta = 0 rad", "a gap of ", " remains",
         "the first guess of how it is assembled; angles in rad"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_move_by_its_coordinates_is_refused(name: str) -> None:
    scene, (start, *words) = REFUSED[name]
    message = refusal(kinematics_of, scene())
    assert message.startswith(start) and all(one in message for one in words), message
    assert name not in ("too many degrees of freedom", "more coordinates") or message == start


@pytest.mark.parametrize("ends", [(0.0, DEAD), (DEAD, 1.0)], ids=["upper", "lower"])
def test_a_dead_centre_at_an_end_of_the_range(ends: tuple[float, float]) -> None:
    start = f"simulation.initial.theta.position={DEAD}"
    message = refusal(kinematics_of, up_to(ends[1], ends[0], "0.3:0.5:5", start))
    # the closure, solved to 1e-12, finds a double root to 1e-6 only: which refusal comes first is a matter of round-off
    assert "it does not control the mechanism at 0.729" in message or "cannot close at theta = 0.7" in message


def test_a_direction_that_other_joints_hold_is_not_released() -> None:
    """An elastic hinge may move along its axis, but the slider's line does not let it: the motion that is left is that
    of the teeth."""
    hinge = "joints.crank_hinge.elastic={reference=[[1,0,0],[0,1,0]],stiffness=[1e6,2e6,3e6],damping=[1.0,1.0,1.0]}"
    mesh = "joints.mesh={type='gear',joints=['crank_hinge','sleeve'],ratio=-2.0,elastic={stiffness=5.0}}"
    wheel = (entry.format(moments=[4e-3, 5e-3, 6e-3, 0, 0, 0], origin=[0, 0, 0], turns=TURNS) for entry in WHEEL)
    kinematics = kinematics_of(scene_from_toml(KINDS["all rigid in space"], ".", (*wheel, hinge, mesh)))
    released = kinematics.motion(np.array([0.3])).released
    assert kinematics.carries.tolist() == [True, True, False]
    assert np.max(np.abs(released[0, 2])) < 1e-12 < np.max(np.abs(released[2, :, 2]))
    # nor does stiffness along it hold what moves across
    loose = hinge.replace("1e6,2e6", "0.0,inf")
    kinematics = kinematics_of(
        scene_from_toml(KINDS["all rigid in space"], ".", (loose.replace("1.0,1.0", "1.0,0.0"),))
    )
    assert kinematics.unheld(np.array([0.3]), [False, True]) == 0


def test_a_turn_that_does_not_come_back() -> None:
    overrides = ('coordinates.theta.joint="middle"', "coordinates.theta.range=[-3.141592653589793,3.141592653589793]")
    message = refusal(kinematics_of, trammel(*overrides))
    assert message == (
        "coordinates.theta.periodic = true: after one turn the mechanism does not come back to where it began "
        "(it moved to another assembly branch); give a range that is not periodic"
    )
    kinematics = kinematics_of(trammel(*overrides, NOT_PERIODIC))
    theta = np.linspace(-np.pi, np.pi, 9)
    crank = kinematics.poses(theta)[1, 2]
    np.testing.assert_allclose(np.diff(crank), np.full(8, np.pi / 8), rtol=0, atol=1e-11)


@pytest.mark.parametrize("angles", [(-3.0, -1.0), (3.0, 1.0)])
def test_placements_too_far_off_are_told_with_others_that_close(angles: tuple[float, float]) -> None:
    """What the message says assembles the mechanism."""
    lines = [
        f"bodies.coupler.placement={{origin=[0.3,0.0],angle={angles[0]}}}",
        f"bodies.rocker.placement={{origin=[1.0,0.0],angle={angles[1]}}}",
    ]
    message = refusal(kinematics_of, four_bar(*lines))
    assert "placements are the first guess" in message and "e-1" not in message
    given = re.findall(r"bodies\.(\w+)\.placement = (\{[^}]*\})", message)
    assert [name for name, _ in given] == ["crank", "coupler", "rocker"]
    kinematics_of(four_bar(*(f"bodies.{name}.placement={table}" for name, table in given)))
