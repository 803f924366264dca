"""What a scene may not say of effects, rigid bodies and welds: the entry, what was received, what is allowed."""

import pytest
from effect_scenes import BAR, BASE, CANTILEVER, line_model, scene_of
from refusals import cases, check_said, refusal

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.scene import scene_from_toml

WAVE = "harmonic={amplitude=1, frequency_hz=1}"
DRIVE = f'{{type="prescribed_motion", coordinate="theta", {WAVE}}}'

CASES = cases(
    """
effects.e={type="torque", joint="hinge"} -> effects.e.table: exactly one of table, harmonic is needed; none is given
effects.e={type="torque", joint="hinge", table=[[0, 1]], WAVE} -> \
    effects.e.harmonic = { amplitude = 1, frequency_hz = 1 }: exactly one of table, harmonic is needed; table and
effects.e={type="force", point="rod:tip", WAVE} -> effects.e.direction: exactly one of direction, towards is needed
effects.e={type="force", point="rod:tip", direction=[1, 0], towards="ground:origin", WAVE} -> \
    effects.e.towards = "ground:origin": exactly one of direction, towards is needed; direction and towards are given
effects.e={type="force", point="rod:tip", towards="ground:origin", follows=true, WAVE} -> \
    effects.e.follows = true: a direction that turns with the body needs `direction`
effects.e={type="spring_damper", stiffness=1} -> effects.e.joint: exactly one of joint, points is needed; none is given
effects.e={type="prescribed_motion", coordinate="theta"} -> effects.e.table: exactly one of table, harmonic, spin_up
effects.e={type="prescribed_motion", coordinate="theta", table=[[0, 0]]} -> \
    effects.e.table = [[0, 0]]: a motion needs at least two rows
effects.e={type="gravity", direction=[0, 0]} -> effects.e.direction = [0, 0]: a direction other than [0, 0] is needed
effects.e={type="point_mass", point="rod:tip", mass=0} -> effects.e.mass = 0: a positive number or the name of a
effects.e={type="point_mass", point="rod:tip", mass=1, inertia=-1} -> effects.e.inertia = -1: a number that is not
effects.e={type="point_mass", point="rod:tip", mass="negative"} -> \
    parameters.negative.nominal = -1.0: must be positive, because effects.e.mass uses it
effects.e={type="joint_friction", joint="hinge", limit=-1, speed=1} -> effects.e.limit = -1: a number that is not
effects.e={type="joint_friction", joint="hinge", limit=1} -> effects.e.speed: missing; needed: rate at which 76 % of the
effects.e={type="spring_damper", joint="hinge"} -> = { type = "spring_damper", joint = "hinge" }: at least one of
effects.e={type="spring_damper", points=["ground:origin", "rod:tip"], stiffness=1} -> \
    effects.e.rest: a spring between points needs the distance without force (m)
effects.e={type="structural_damping"} -> = { type = "structural_damping" }: at least one of stiffness, mass and ratios
effects.e={type="structural_damping", ratios=[0.1, 1.0]} -> effects.e.ratios[1] = 1.0: must be less than 1.0
effects.e={type="structural_damping", mass=1, bodies=[]} -> effects.e.bodies = []: 1 or more entries are needed
effects.e={type="end_stop", joint="hinge", stiffness=1} -> \
    = { type = "end_stop", joint = "hinge", stiffness = 1 }: at least one of lower and upper is needed
effects.e={type="end_stop", joint="hinge", stiffness=1, lower=1, upper=0.5} -> \
    effects.e.lower = 1.0: must be below upper = 0.5
effects.e={type="end_stop", joint="hinge", stiffness=1, lower="p", upper=0.5} -> \
    effects.e.lower = "p": must be below upper = 0.5, not 1
effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0.5, upper="p"} & parameters.p.value=0.2 -> \
    effects.e.lower = 0.5: must be below upper = 0.2
effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0, upper="q"} -> \
    effects.e.upper = "q": there is no such parameter; known: negative, p
effects.e={type="joint_friction", joint="hinge", limit=1, speed="negative"} -> \
    parameters.negative.nominal = -1.0: must be positive, because effects.e.speed uses it
effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0, damping="negative"} -> \
    parameters.negative.nominal = -1.0: must not be negative, because effects.e.damping uses it
effects.e={type="end_stop", joint="hinge", stiffness=0, lower=1} -> effects.e.stiffness = 0: a positive number or the
effects.e={type="prescribed_motion", coordinate="theta", spin_up={speed=1, time=0}} -> \
    effects.e.spin_up.time = 0: must be greater than 0.0
effects.e={type="gravty"} -> effects.e.type = "gravty": unknown; did you mean 'gravity'?
effects.e={type="gravity", axceleration=9} -> effects.e.axceleration = 9: unknown key; did you mean 'acceleration'?
effects.e={type="torque", joint="slidr", WAVE} -> effects.e.joint = "slidr": there is no such
effects.e={type="joint_damping", joint="weld", coefficient=1} -> \
    effects.e.joint = "weld": a point_on_beam, point_on_line, prismatic or
effects.e={type="joint_friction", joint="slidr", limit=1, speed=1} -> effects.e.joint = "slidr": there is no such
effects.e={type="end_stop", joint="elbo", stiffness=1, lower=1} -> effects.e.joint = "elbo": there is no such
effects.e={type="spring_damper", joint="weld", stiffness=1} -> \
    effects.e.joint = "weld": a point_on_beam, point_on_line, prismatic or
effects.e={type="spring_damper", joint="hinge", stiffness="q"} -> effects.e.stiffness = "q": there is no such parameter
effects.e={type="point_mass", point="rod", mass=1} -> effects.e.point = "rod": a point is needed, written "body:point"
effects.e={type="point_mass", point="rd:tip", mass=1} -> effects.e.point = "rd:tip": there is no body 'rd'; did you mean
effects.e={type="point_mass", point="ground:wall", mass=1} -> effects.e.point = "ground:wall": a point of a body is
effects.e={type="force", point="ground:wall", direction=[1, 0], WAVE} -> \
    effects.e.point = "ground:wall": a point of a body is needed; the ground does not move
effects.e={type="force", point="rod:tip", towards="ground:wal", WAVE} -> \
    effects.e.towards = "ground:wal": there is no such ground point; did you mean 'ground:wall'?
effects.e={type="spring_damper", points=["grund:wall", "rod:tip"], stiffness=1, rest=1} -> \
    effects.e.points = "grund:wall": there is no body 'grund'; did you mean 'ground'?
effects.e={type="spring_damper", points=["rod:tip", "rod:tip"], stiffness=1, rest=1} -> \
    effects.e.points = ["rod:tip", "rod:tip"]: two different points are needed
effects.e={type="spring_damper", points=["ground:wall", "ground:origin"], stiffness=1, rest=1} -> \
    effects.e.points = ["ground:wall", "ground:origin"]: a point of a body is needed; the ground does not move
effects.e={type="spring_damper", points=["crank:tip", "crank:hinge"], stiffness=1, rest=1} -> \
    effects.e.points = ["crank:tip", "crank:hinge"]: crank is rigid; the distance of its points does not change
effects.e={type="force", point="crank:tip", towards="crank:hinge", WAVE} -> \
    effects.e.towards = ["crank:tip", "crank:hinge"]: crank is rigid; the distance of its points does not change
effects.e={type="force", point="rod:tip", towards="rod:tip", WAVE} -> \
    effects.e.towards = ["rod:tip", "rod:tip"]: two different points are needed
effects.e={type="torque", joint="hinge", harmonic={amplitude=1, frequency_hz=1000}} -> \
    effects.e.harmonic.frequency_hz = 1000.0: needs a simulation.step of at most 0.000125 s, 8 a period; it is 0.001 s
effects.e={type="prescribed_motion", coordinate="theta", harmonic={amplitude=1, frequency_hz=1000}} -> \
    effects.e.harmonic.frequency_hz = 1000.0: needs a simulation.step of at most 0.000125 s, 8 a period; it is 0.001 s
effects.e={type="force", point="rod:tip", direction=[1, 0], table=[[0.5002, 0], [0.5004, 100], [0.5006, 0]]} & \
    simulation.step=1e-3 -> \
    effects.e.table: has an impulse of 0.02 N s, but 0 with a force read every 0.001 s; take a smaller simulation.step
effects.e={type="structural_damping", mass=1, bodies=["rd"]} -> effects.e.bodies = ["rd"]: there is no body 'rd'; did
effects.e={type="structural_damping", mass=1, bodies=["rod", "crank"]} -> \
    effects.e.bodies = ["rod", "crank"]: crank is rigid; only flexible bodies have structural damping
effects.e={type="structural_damping", mass=1, bodies=["rod"]} & \
    effects.f={type="structural_damping", ratios=[0.1], bodies=["rod"]} -> \
    effects.f: effects.e damps rod too; give all the damping of a body in one effect
effects.e={type="prescribed_motion", coordinate="thet", WAVE} -> effects.e.coordinate = "thet": there is no such
effects.e=DRIVE & effects.f=DRIVE -> effects.f.coordinate = "theta": effects.e prescribes the same coordinate
effects.e=DRIVE & effects.f={type="torque", joint="hinge", WAVE} -> effects.e.coordinate = "theta": contradicts
effects.e=DRIVE & effects.f={type="end_stop", joint="hinge", stiffness=1, lower=-1} -> \
    effects.e.coordinate = "theta": contradicts effects.f, of type end_stop on the same joint hinge: a prescribed \
    motion takes whatever torque it needs
effects.e=DRIVE & simulation.initial.theta.position=0.1 -> simulation.initial.theta: effects.e prescribes this
effects.e={type="gyroscopic"} & effects.f={type="gyroscopic"} -> effects.f: effects.e is of the same type; a scene has
effects.e={type="geometric_stiffening"} -> : is half of what is of second order in the deformation, and wrong by itself
effects.e={type="mode_inertia"} -> : is half of what is of second order in the deformation, and wrong by itself where
effects.e={type="geometric_stiffening"} & effects.f={type="mode_inertia"} & \
    effects.g={type="gyroscopic", keep=false} -> \
    effects.g.keep = false: leaves out the forces by velocities whose stiffening effects.e asks for; keep them, or leave
effects.g={type="gyroscopic", keep=false} & reduction.second_order=true -> effects.g.keep = false: leaves out the forces
bodies.rod.material="steel" -> = "steel": a section given by coefficients has no material
bodies.rod.section={shape="circle", radius=1e-2} -> bodies.rod.material: missing; needed: name of a material
bodies.rod.mesh="rod.msh" -> \
    bodies.rod.line = { length = 0.7, elements = 2 }: exactly one of mesh, line, matrices, rigid
bodies.rod.line.elements=0 -> = 0: must be at least 1
bodies.crank.flexible=true -> \
    bodies.crank.section = { shape = "coefficients", axial = 1.0, shear = 1.0, bend ...: a flexible body needs
""".replace("WAVE", WAVE).replace("DRIVE", DRIVE)
)


def test_the_base_is_sound() -> None:
    assert line_model(scene_from_toml(BASE, ".", [f"effects.e={DRIVE}"])).kinematics.mechanism.n_nodes == 5


@pytest.mark.parametrize(("asked", "said"), CASES)
def test_every_error_of_effects(asked: str, said: str) -> None:
    check_said(refusal(scene_from_toml, BASE, ".", asked.split(" & ")), said, asked)


def test_a_driven_coordinate_starts_where_its_motion_says() -> None:
    scene = scene_from_toml(
        BASE,
        ".",
        [
            "coordinates.theta.range=[1, 2]",
            'effects.e={type="prescribed_motion", coordinate="theta", constant_speed={speed=0, start=1.5}}',
        ],
    )
    assert scene.initial_state("theta").position == 0.0, "which is not looked at"


def test_rigid_bodies_alone_have_no_structural_damping() -> None:
    assert (
        refusal(scene_of, BAR, '[effects.e]\ntype = "structural_damping"\nmass = 1.0')
        == "effects.e: all bodies are rigid; only flexible bodies have structural damping"
    )


IN_THE_MESH = {
    "mass": ('effects.e={type="point_mass", point="crank:middel", mass=1}', "effects.e.point"),
    "force": (f'effects.e={{type="force", point="rod:midle", direction=[1, 0], {WAVE}}}', "effects.e.point"),
    "towards": (f'effects.e={{type="force", point="rod:tip", towards="crank:midle", {WAVE}}}', "effects.e.towards"),
    "spring": (
        'effects.e={type="spring_damper", points=["ground:wall", "rod:midle"], stiffness=1, rest=1}',
        "effects.e.points",
    ),
    "joint": ('joints.weld.connect=["rod:tip", "block:hing"]', "joints.weld.connect"),
}


@pytest.mark.parametrize("name", IN_THE_MESH)
def test_points_that_a_mesh_does_not_have(name: str) -> None:
    override, entry = IN_THE_MESH[name]
    message = refusal(line_model, scene_from_toml(BASE, ".", [override]))
    assert message.startswith(f"{entry} = ") and "did you mean" in message


def test_more_ratios_than_a_body_has_modes() -> None:
    ratios = [0.01] * 30
    model = line_model(scene_of(CANTILEVER, f'[effects.e]\ntype = "structural_damping"\nratios = {ratios}'))
    with pytest.raises(InputError, match=r"^effects\.e\.ratios: 30 modes of beam are asked for; its mesh has 24$"):
        model.batch({}, 1)
