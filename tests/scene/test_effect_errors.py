"""What a scene may not say of effects, rigid bodies and welds: the entry, what was received, what is allowed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from effect_scenes import BAR, BASE, CANTILEVER, line_model, scene_of
from runs import IN_TURN

from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import scene_from_toml
from pgmp_petsc.scene.effects import EFFECTS

POINT = 'a point is needed, written "body:point" or "ground:point"'
ALLOWED = ", ".join(EFFECTS.names)
WAVE = "harmonic={amplitude=1, frequency_hz=1}"
DRIVE = f'{{type="prescribed_motion", coordinate="theta", {WAVE}}}'

# overrides of the base, and all lines that they are answered with
CASES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    # one of several alternatives
    "no function": (
        ('effects.e={type="torque", joint="hinge"}',),
        ("effects.e.table: exactly one of table, harmonic is needed; none is given",),
    ),
    "two functions": (
        (f'effects.e={{type="torque", joint="hinge", table=[[0, 1]], {WAVE}}}',),
        (
            "effects.e.harmonic = { amplitude = 1, frequency_hz = 1 }: exactly one of table, harmonic is needed; "
            "table and harmonic are given",
        ),
    ),
    "no direction": (
        (f'effects.e={{type="force", point="rod:tip", {WAVE}}}',),
        ("effects.e.direction: exactly one of direction, towards is needed; none is given",),
    ),
    "two directions": (
        (f'effects.e={{type="force", point="rod:tip", direction=[1, 0], towards="ground:origin", {WAVE}}}',),
        (
            'effects.e.towards = "ground:origin": exactly one of direction, towards is needed; direction and towards '
            "are given",
        ),
    ),
    "follows a point": (
        (f'effects.e={{type="force", point="rod:tip", towards="ground:origin", follows=true, {WAVE}}}',),
        ("effects.e.follows = true: a direction that turns with the body needs `direction`",),
    ),
    "no place of a spring": (
        ('effects.e={type="spring_damper", stiffness=1}',),
        ("effects.e.joint: exactly one of joint, points is needed; none is given",),
    ),
    "no motion": (
        ('effects.e={type="prescribed_motion", coordinate="theta"}',),
        ("effects.e.table: exactly one of table, harmonic, spin_up, constant_speed is needed; none is given",),
    ),
    "a motion of one row": (
        ('effects.e={type="prescribed_motion", coordinate="theta", table=[[0, 0]]}',),
        ("effects.e.table = [[0, 0]]: a motion needs at least two rows",),
    ),
    # values
    "no direction at all": (
        ('effects.e={type="gravity", direction=[0, 0]}',),
        ("effects.e.direction = [0, 0]: a direction other than [0, 0] is needed",),
    ),
    "times": (
        ('effects.e={type="torque", joint="hinge", table=[[0, 1], [0, 2]]}',),
        ("effects.e.table = [[0, 1], [0, 2]]: times must increase strictly, but 0.0 s follows 0.0 s",),
    ),
    "no mass": (
        ('effects.e={type="point_mass", point="rod:tip", mass=0}',),
        ("effects.e.mass = 0: a positive number or the name of a parameter is needed",),
    ),
    "negative inertia": (
        ('effects.e={type="point_mass", point="rod:tip", mass=1, inertia=-1}',),
        ("effects.e.inertia = -1: a number that is not negative or the name of a parameter is needed",),
    ),
    "a parameter that is not positive": (
        ('effects.e={type="point_mass", point="rod:tip", mass="negative"}',),
        ("parameters.negative.nominal = -1.0: must be positive, because effects.e.mass uses it",),
    ),
    "negative friction": (
        ('effects.e={type="joint_friction", joint="hinge", limit=-1, speed=1}',),
        ("effects.e.limit = -1: a number that is not negative or the name of a parameter is needed",),
    ),
    "friction without a speed": (
        ('effects.e={type="joint_friction", joint="hinge", limit=1}',),
        (
            "effects.e.speed: missing; needed: rate at which 76 % of the limit are reached (rad/s or m/s), a number or "
            "a parameter's name",
        ),
    ),
    "no spring": (
        ('effects.e={type="spring_damper", joint="hinge"}',),
        ('effects.e = { type = "spring_damper", joint = "hinge" }: at least one of stiffness and damping is needed',),
    ),
    "no rest": (
        ('effects.e={type="spring_damper", points=["ground:origin", "rod:tip"], stiffness=1}',),
        ("effects.e.rest: a spring between points needs the distance without force (m)",),
    ),
    "no damping": (
        ('effects.e={type="structural_damping"}',),
        ('effects.e = { type = "structural_damping" }: at least one of stiffness, mass and ratios must be above zero',),
    ),
    "a ratio of one": (
        ('effects.e={type="structural_damping", ratios=[0.1, 1.0]}',),
        ("effects.e.ratios[1] = 1.0: must be less than 1.0",),
    ),
    "no bodies": (
        ('effects.e={type="structural_damping", mass=1, bodies=[]}',),
        ("effects.e.bodies = []: at least 1 entry is needed",),
    ),
    "no end": (
        ('effects.e={type="end_stop", joint="hinge", stiffness=1}',),
        (
            'effects.e = { type = "end_stop", joint = "hinge", stiffness = 1 }: at least one of lower and upper is '
            "needed",
        ),
    ),
    "ends that cross": (
        ('effects.e={type="end_stop", joint="hinge", stiffness=1, lower=1, upper=0.5}',),
        ("effects.e.lower = 1.0: must be below upper = 0.5",),
    ),
    "ends that cross by a parameter": (
        ('effects.e={type="end_stop", joint="hinge", stiffness=1, lower="p", upper=0.5}',),
        ('effects.e.lower = "p": must be below upper = 0.5, not 1',),
    ),
    "ends that cross by the value of a run": (
        ('effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0.5, upper="p"}', "parameters.p.value=0.2"),
        ("effects.e.lower = 0.5: must be below upper = 0.2",),
    ),
    "an end that is no parameter": (
        ('effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0, upper="q"}',),
        ('effects.e.upper = "q": there is no such parameter; known: negative, p',),
    ),
    "a speed that is not positive": (
        ('effects.e={type="joint_friction", joint="hinge", limit=1, speed="negative"}',),
        ("parameters.negative.nominal = -1.0: must be positive, because effects.e.speed uses it",),
    ),
    "damping of a stop below zero": (
        ('effects.e={type="end_stop", joint="hinge", stiffness=1, lower=0, damping="negative"}',),
        ("parameters.negative.nominal = -1.0: must not be negative, because effects.e.damping uses it",),
    ),
    "a soft stop": (
        ('effects.e={type="end_stop", joint="hinge", stiffness=0, lower=1}',),
        ("effects.e.stiffness = 0: a positive number or the name of a parameter is needed",),
    ),
    "no time to spin up": (
        ('effects.e={type="prescribed_motion", coordinate="theta", spin_up={speed=1, time=0}}',),
        ("effects.e.spin_up.time = 0: must be greater than 0.0",),
    ),
    # kinds and names
    "unknown type": (
        ('effects.e={type="gravty"}',),
        (f"effects.e.type = \"gravty\": unknown; did you mean 'gravity'? (allowed: {ALLOWED})",),
    ),
    "unknown key": (
        ('effects.e={type="gravity", axceleration=9}',),
        (
            "effects.e.axceleration = 9: unknown key; did you mean 'acceleration'? (allowed: type, direction, "
            "acceleration)",
        ),
    ),
    "torque on a slider": (
        (f'effects.e={{type="torque", joint="slider", {WAVE}}}',),
        (
            'effects.e.joint = "slider": a revolute joint is needed, this one is a point_on_line (allowed: hinge, '
            "elbow)",
        ),
    ),
    "damping of a weld": (
        ('effects.e={type="joint_damping", joint="weld", coefficient=1}',),
        (
            'effects.e.joint = "weld": a point_on_line or revolute joint is needed, this one is a fixed '
            "(allowed: hinge, elbow, slider)",
        ),
    ),
    "friction in no joint": (
        ('effects.e={type="joint_friction", joint="slidr", limit=1, speed=1}',),
        ("effects.e.joint = \"slidr\": there is no such point_on_line or revolute joint; did you mean 'slider'?",),
    ),
    "a stop of no joint": (
        ('effects.e={type="end_stop", joint="elbo", stiffness=1, lower=1}',),
        ("effects.e.joint = \"elbo\": there is no such point_on_line or revolute joint; did you mean 'elbow'?",),
    ),
    "a spring on a weld": (
        ('effects.e={type="spring_damper", joint="weld", stiffness=1}',),
        (
            'effects.e.joint = "weld": a point_on_line or revolute joint is needed, this one is a fixed '
            "(allowed: hinge, elbow, slider)",
        ),
    ),
    "unknown parameter": (
        ('effects.e={type="spring_damper", joint="hinge", stiffness="q"}',),
        ('effects.e.stiffness = "q": there is no such parameter; known: negative, p',),
    ),
    "no point": (('effects.e={type="point_mass", point="rod", mass=1}',), (f'effects.e.point = "rod": {POINT}',)),
    "a mass on no body": (
        ('effects.e={type="point_mass", point="rd:tip", mass=1}',),
        ("effects.e.point = \"rd:tip\": there is no body 'rd'; did you mean 'rod'?",),
    ),
    "a mass on the ground": (
        ('effects.e={type="point_mass", point="ground:wall", mass=1}',),
        ('effects.e.point = "ground:wall": a point of a body is needed; the ground does not move',),
    ),
    "a force on the ground": (
        (f'effects.e={{type="force", point="ground:wall", direction=[1, 0], {WAVE}}}',),
        ('effects.e.point = "ground:wall": a point of a body is needed; the ground does not move',),
    ),
    "towards nothing": (
        (f'effects.e={{type="force", point="rod:tip", towards="ground:wal", {WAVE}}}',),
        ("effects.e.towards = \"ground:wal\": there is no such ground point; did you mean 'ground:wall'?",),
    ),
    "a spring from nothing": (
        ('effects.e={type="spring_damper", points=["grund:wall", "rod:tip"], stiffness=1, rest=1}',),
        ("effects.e.points = \"grund:wall\": there is no body 'grund'; did you mean 'ground'?",),
    ),
    # points whose distance does not change
    "a spring on one point": (
        ('effects.e={type="spring_damper", points=["rod:tip", "rod:tip"], stiffness=1, rest=1}',),
        ('effects.e.points = ["rod:tip", "rod:tip"]: two different points are needed',),
    ),
    "a spring on the ground": (
        ('effects.e={type="spring_damper", points=["ground:wall", "ground:origin"], stiffness=1, rest=1}',),
        ('effects.e.points = ["ground:wall", "ground:origin"]: a point of a body is needed; the ground does not move',),
    ),
    "a spring within a rigid body": (
        ('effects.e={type="spring_damper", points=["crank:tip", "crank:hinge"], stiffness=1, rest=1}',),
        (
            'effects.e.points = ["crank:tip", "crank:hinge"]: crank is rigid; the distance of its points does not '
            "change",
        ),
    ),
    "a force within a rigid body": (
        (f'effects.e={{type="force", point="crank:tip", towards="crank:hinge", {WAVE}}}',),
        (
            'effects.e.towards = ["crank:tip", "crank:hinge"]: crank is rigid; the distance of its points does not '
            "change",
        ),
    ),
    "a force towards where it is": (
        (f'effects.e={{type="force", point="rod:tip", towards="rod:tip", {WAVE}}}',),
        ('effects.e.towards = ["rod:tip", "rod:tip"]: two different points are needed',),
    ),
    # time
    "too fast a torque": (
        ('effects.e={type="torque", joint="hinge", harmonic={amplitude=1, frequency_hz=1000}}',),
        (
            "effects.e.harmonic.frequency_hz = 1000.0: needs a simulation.step of at most 0.000125 s, 8 a period; it "
            "is 0.001 s",
        ),
    ),
    "too fast a motion": (
        ('effects.e={type="prescribed_motion", coordinate="theta", harmonic={amplitude=1, frequency_hz=1000}}',),
        (
            "effects.e.harmonic.frequency_hz = 1000.0: needs a simulation.step of at most 0.000125 s, 8 a period; it "
            "is 0.001 s",
        ),
    ),
    "a pulse between steps": (
        (
            'effects.e={type="force", point="rod:tip", direction=[1, 0], '
            "table=[[0.5002, 0], [0.5004, 100], [0.5006, 0]]}",
            "simulation.step=1e-3",
        ),
        (
            "effects.e.table: has an impulse of 0.02 N s, but 0 with a force read every 0.001 s; take a smaller "
            "simulation.step, or a pulse that lasts several steps",
        ),
    ),
    # damping
    "damping of no body": (
        ('effects.e={type="structural_damping", mass=1, bodies=["rd"]}',),
        ("effects.e.bodies = [\"rd\"]: there is no body 'rd'; did you mean 'rod'?",),
    ),
    "damping of a rigid body": (
        ('effects.e={type="structural_damping", mass=1, bodies=["rod", "crank"]}',),
        ('effects.e.bodies = ["rod", "crank"]: crank is rigid; only flexible bodies have structural damping',),
    ),
    "damped twice": (
        (
            'effects.e={type="structural_damping", mass=1, bodies=["rod"]}',
            'effects.f={type="structural_damping", ratios=[0.1], bodies=["rod"]}',
        ),
        ("effects.f: effects.e damps rod too; give all the damping of a body in one effect",),
    ),
    # prescribed motion
    "no coordinate": (
        (f'effects.e={{type="prescribed_motion", coordinate="thet", {WAVE}}}',),
        ("effects.e.coordinate = \"thet\": there is no such coordinate; did you mean 'theta'?",),
    ),
    "driven twice": (
        (f"effects.e={DRIVE}", f"effects.f={DRIVE}"),
        ('effects.f.coordinate = "theta": effects.e prescribes the same coordinate',),
    ),
    "driven against a torque": (
        (f"effects.e={DRIVE}", f'effects.f={{type="torque", joint="hinge", {WAVE}}}'),
        (
            'effects.e.coordinate = "theta": contradicts effects.f, of type torque on the same joint hinge: a '
            "prescribed motion takes whatever torque it needs; leave one of them out",
        ),
    ),
    "driven into a stop": (
        (f"effects.e={DRIVE}", 'effects.f={type="end_stop", joint="hinge", stiffness=1, lower=-1}'),
        (
            'effects.e.coordinate = "theta": contradicts effects.f, of type end_stop on the same joint hinge: a '
            "prescribed motion takes whatever torque it needs; leave one of them out",
        ),
    ),
    "driven from two starts": (
        (f"effects.e={DRIVE}", "simulation.initial.theta.position=0.1"),
        ("simulation.initial.theta: effects.e prescribes this coordinate from the start on; leave one of them out",),
    ),
    # what a scene has once, and what belongs together
    "two of a kind": (
        ('effects.e={type="gyroscopic"}', 'effects.f={type="gyroscopic"}'),
        ("effects.f: effects.e is of the same type; a scene has one at most",),
    ),
    "stiffening alone": (
        ('effects.e={type="geometric_stiffening"}',),
        (
            "effects.e: is half of what is of second order in the deformation, and wrong by itself where bodies spin; "
            'name an effect of type "mode_inertia" too, or neither',
        ),
    ),
    "shapes alone": (
        ('effects.e={type="mode_inertia"}',),
        (
            "effects.e: is half of what is of second order in the deformation, and wrong by itself where bodies spin; "
            'name an effect of type "geometric_stiffening" too, or neither',
        ),
    ),
    "stiffening without its forces": (
        (
            'effects.e={type="geometric_stiffening"}',
            'effects.f={type="mode_inertia"}',
            'effects.g={type="gyroscopic", keep=false}',
        ),
        (
            "effects.g.keep = false: leaves out the forces by velocities whose stiffening effects.e asks for; keep "
            "them, or leave out both",
        ),
    ),
    "second order without its forces": (
        ('effects.g={type="gyroscopic", keep=false}', "reduction.second_order=true"),
        (
            "effects.g.keep = false: leaves out the forces by velocities whose stiffening reduction.second_order asks "
            "for; keep them, or leave out both",
        ),
    ),
    # bodies
    "a material for coefficients": (
        ('bodies.rod.material="steel"',),
        ('bodies.rod.material = "steel": a section given by coefficients has no material',),
    ),
    "no material": (
        ('bodies.rod.section={shape="circle", radius=1e-2}',),
        ("bodies.rod.material: missing; needed: name of a material",),
    ),
    "mesh and line": (
        ('bodies.rod.mesh="rod.msh"',),
        (
            "bodies.rod.line = { length = 0.7, elements = 2 }: exactly one of mesh, line, matrices is "
            "needed; mesh and line are given",
        ),
    ),
    "no elements": (("bodies.rod.line.elements=0",), ("bodies.rod.line.elements = 0: must be at least 1",)),
    "flexible without rotary inertia": (
        ("bodies.crank.flexible=true",),
        (
            'bodies.crank.section = { shape = "coefficients", axial = 1.0, shear = 1.0, bend ...: a flexible body '
            "needs section.rotary_density above 0",
        ),
    ),
}


def refused(*overrides: str) -> InputError:
    """Return the error that the base with overrides ends with."""
    with pytest.raises(InputError) as caught:
        scene_from_toml(BASE, ".", overrides)
    return caught.value


def test_the_base_is_sound() -> None:
    assert line_model(scene_from_toml(BASE, ".", [f"effects.e={DRIVE}"])).kinematics.mechanism.n_nodes == 5


@pytest.mark.parametrize("name", CASES)
def test_every_error_of_effects(name: str) -> None:
    overrides, lines = CASES[name]
    error = refused(*overrides)
    assert str(error).splitlines() == list(lines)
    assert error.exit_status == 2


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
    with pytest.raises(InputError) as caught:
        scene_of(BAR, '[effects.e]\ntype = "structural_damping"\nmass = 1.0')
    assert str(caught.value) == "effects.e: all bodies are rigid; only flexible bodies have structural damping"


IN_THE_MESH = {
    "point_mass": ('effects.e={type="point_mass", point="crank:middel", mass=1}', "effects.e.point"),
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
    scene = scene_from_toml(BASE, ".", [override])
    with pytest.raises(InputError) as caught:
        line_model(scene)
    assert str(caught.value).startswith(f"{entry} = ") and "did you mean" in str(caught.value)
    assert caught.value.exit_status == 2


def test_more_ratios_than_a_body_has_modes() -> None:
    ratios = [0.01] * 30
    model = line_model(scene_of(CANTILEVER, f'[effects.e]\ntype = "structural_damping"\nratios = {ratios}'))
    with pytest.raises(InputError, match=r"^effects\.e\.ratios: 30 modes of beam are asked for; its mesh has 24$"):
        model.batch({}, 1)


COMMANDS = (
    "torque on a slider",
    "driven against a torque",
    "unknown type",
    "stiffening alone",
    "damping of a rigid body",
)


@pytest.mark.parametrize("n_ranks", [1, 3])
def test_the_command_ends_with_one_message(mpirun: Callable, tmp_path: Path, n_ranks: int) -> None:
    scene = tmp_path / "base.toml"
    scene.write_text(BASE)
    commands = [
        ["check", str(scene), *(word for override in CASES[name][0] for word in ("--override", override))]
        for name in COMMANDS
    ]
    beyond = ["simulate", str(scene), "--full", "-o", str(tmp_path / "out.h5"), "--override", IN_THE_MESH["force"][0]]
    done = mpirun(n_ranks, "-c", IN_TURN, json.dumps([*commands, beyond]))
    statuses = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]  # beside warnings
    assert statuses == [[2] * n_ranks] * (len(commands) + 1)
    messages = [line for line in done.stderr.splitlines() if line.startswith("pgmp: ")]
    assert messages[:-1] == [f"pgmp: error: {CASES[name][1][0]}" for name in COMMANDS]
    assert messages[-1].startswith("pgmp: error: effects.e.point = ")
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out.h5").exists()
