"""What springs measure and their stiffness: against differences, with and without force; what is left out."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slopes import slopes
from spatial import assembled, solid, table
from spatial_beams import slider_crank_of_beams
from spring_measures import measure_of

from pgmp_petsc.effects import Action, actions_of, effects_of
from pgmp_petsc.effects.action import joint_measure
from pgmp_petsc.effects.effect import UnitForces
from pgmp_petsc.effects.law import Law
from pgmp_petsc.effects.springs import left_out, linear_springs, moving_dofs, spring_block, spring_force, spring_remarks
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import BodyStatements, Mechanism
from pgmp_petsc.scene import Scene
from scenes import kinematics_of, mechanism_of, slider_crank

# the crank is rigid, so that its points are at arms of its only node
PLANE = (
    "bodies.crank.flexible=false",
    "ground.points.far=[-1.0,0.3]",
    'effects.s={type="spring_damper",points=["crank:tip","ground:far"],stiffness=7.0,rest=0.2}',
    'effects.b={type="bushing",points=["crank:tip","rod:tip"],reference=[[1.0,0.4]],stiffness=[2.0,3.0],'
    "turning_stiffness=[4.0]}",
    'effects.t={type="spring_damper",joint="crank_hinge",stiffness=5.0,rest=0.1}',
    'effects.oil={type="joint_damping",joint="elbow",coefficient=1.0}',
)
SPACE = (
    "bodies.crank.flexible=false",
    "ground.points.far=[-1.0,0.3,0.2]",
    'effects.s={type="spring_damper",points=["crank:tip","ground:far"],stiffness=7.0,rest=0.2}',
    'effects.b={type="bushing",points=["crank:tip","rod:tip"],reference=[[1.0,0.4,0.1],[0.0,1.0,0.3]],'
    "stiffness=[2.0,3.0,4.0],turning_stiffness=[5.0,6.0,7.0]}",
    'effects.t={type="spring_damper",joint="elbow",stiffness=5.0,rest=0.1}',
)


@lru_cache
def springs_in(dimension: int) -> tuple[Scene, RigidKinematics, tuple[Action, ...]]:
    """Return a scene in 2 or 3 dimensions, its kinematics and springs: on a distance, a mount, an angle."""
    if dimension == 2:
        scene = slider_crank(*PLANE, "parameters={}", "bodies.crank.section.radius=5e-3")
        kinematics = kinematics_of(scene)
    else:
        scene = slider_crank_of_beams(*SPACE, "parameters={}", "bodies.crank.section.radius=5e-3")
        kinematics = kinematics_of(scene)
    return scene, kinematics, linear_springs(actions_of(effects_of(scene, kinematics.mechanism)))


@pytest.mark.parametrize(("dimension", "number"), [(2, k) for k in range(5)] + [(3, k) for k in range(8)])
def test_the_stiffness_is_that_of_the_energy(dimension: int, number: int) -> None:
    scene, kinematics, springs = springs_in(dimension)
    mechanism, theta = kinematics.mechanism, np.array([0.7])
    poses, spring = kinematics.poses(theta)[..., 0], springs[number]
    stiffness = spring.parameters[0].at(scene.values)
    dofs, measure = measure_of(spring, mechanism, poses)
    rest = np.zeros(dofs.size)
    slope, bend = slopes(measure, rest, 1e-5), slopes(lambda u: slopes(measure, u, 1e-4), rest, 1e-4)
    gradient = UnitForces([spring], mechanism).at(poses)[moving_dofs(spring), 0]
    plain = spring_block(spring, gradient, scene.values)
    np.testing.assert_array_equal(plain.dofs, dofs)
    # central differences with steps of 1e-5 and 1e-4 leave 1e-9 and 1e-7
    np.testing.assert_allclose(plain.matrix, stiffness * np.outer(slope, slope), rtol=0, atol=1e-8 * stiffness)
    force = spring_force(spring, mechanism, poses, theta, scene.values)
    away = measure(rest) - spring.parameters[2].at(scene.values)
    assert force == pytest.approx(-stiffness * away, rel=1e-12, abs=1e-12)
    hessian = BodyStatements(mechanism, [(spring.statement, spring.sides)]).second(poses)[0]
    loaded = spring_block(spring, gradient, scene.values, -3.0 * hessian)
    np.testing.assert_allclose(loaded.matrix - plain.matrix, 3.0 * bend, rtol=0, atol=1e-6)


def test_a_damper_between_points_needs_no_distance_without_force() -> None:
    at = 'points=["crank:tip","ground:far"],damping=3.0'
    for rest in ("", ",rest=0.2"):
        scene = slider_crank("ground.points.far=[-1.0,0.3]", f'effects.s={{type="spring_damper",{at}{rest}}}')
        (action,) = actions_of(effects_of(scene, mechanism_of(scene)))
        found = action.law.evaluate([quantity.at(scene.values) for quantity in action.parameters], 1.3, 2.0)
        assert found.force == -6.0
        assert not list(scene.effects["s"].doubts(scene, "effects.s", {}, lambda: None))


def test_dampers_are_named_and_springs_are_not() -> None:
    scene, kinematics, springs = springs_in(2)
    effects = effects_of(scene, kinematics.mechanism)
    assert list(left_out(actions_of(effects))) == ["oil"]
    assert all(moving_dofs(spring).size for spring in springs)
    said = [str(remark) for remark in spring_remarks(effects)]
    assert said[0] == "note: linear springs in the stiffness: s, b, t"
    assert "effects.oil is not in the stiffness: it is a damper" in said[1]
    of_basis = [str(remark) for remark in spring_remarks(effects, scene.reduction)]
    assert "static answers are in the basis, for any stiffness: s, b, t" in of_basis[0]


def test_a_controller_is_named_as_one() -> None:
    servo = 'controllers.servo={type="pid",joint="crank_hinge",measures="crank_angle",reference=1.0,gains={p=1.0}}'
    scene = slider_crank(servo, 'outputs.crank_angle={type="angle",joint="crank_hinge"}')
    said = [str(remark) for remark in spring_remarks(effects_of(scene, mechanism_of(scene)))]
    assert said == [
        "note: controllers.servo is not in the stiffness: it is a controller, whose force follows what it measures"
    ]


@pytest.mark.parametrize(
    ("force", "potential", "reason"),
    [("elastic", "k * s**4", "it is no linear spring"), ("-k * rate * abs(rate)", "0", "it is no linear spring")]
    + [("k * amplitude", "0", "")],
)
def test_laws_that_do_not_say_why_they_are_left_out_are_named_where_they_hang_on_the_motion(
    force: str, potential: str, reason: str
) -> None:
    law = Law(f"of_test_{len(force)}", ("k",), force=force, potential=potential)
    assert law.left_out == reason
    action = SimpleNamespace(law=law, stiffness="", effect="pole")
    assert left_out([action]) == ({"pole": reason} if reason else {})


AXIS, TURNED, MOVED = np.array([0.48, -0.6, 0.64]), 0.7, 0.2


def mechanism(kind: str) -> tuple[Mechanism, np.ndarray]:
    """Return a bar on a joint of the ground, and its pose turned about the axis and moved along it."""
    scene = assembled(
        solid("bar", 0.5, (0.0, 0.0, 0.0), (0.2, 0.5, -0.4)),
        solid("wheel", 0.2, (0.0, 0.0, 0.0)),
        table("joints.guide", type=kind, connect=["ground:origin", "bar:hinge"], axis=AXIS),
        table("joints.drive", type="revolute", connect=["bar:tip", "wheel:hinge"], axis=(0.0, 0.0, 1.0)),
    )
    made = mechanism_of(scene)
    poses = made.first_guess.copy()
    poses[0, 3:] = Rotation.from_rotvec(TURNED * AXIS).apply(poses[0, 3:].reshape(3, 3)).ravel()
    poses[0, :3] = MOVED * AXIS
    return made, poses


@pytest.mark.parametrize(
    ("kind", "motion", "expected"),
    [("cylindrical", "turning", TURNED), ("cylindrical", "sliding", MOVED), ("prismatic", None, MOVED),
     ("revolute", None, TURNED)],
)  # fmt: skip
def test_the_motion_in_a_joint(kind: str, motion: str | None, expected: float) -> None:
    made, poses = mechanism(kind)
    place = joint_measure(made, SimpleNamespace(joint="guide", motion=motion))
    frames = [place[side].frame_of_pose(poses) for side in "ab"]
    assert place["statement"].value(*frames) == pytest.approx(expected, abs=1e-12)
    assert joint_measure(made, SimpleNamespace(joint="drive"))["statement"] is made.coordinates[0].statement
