"""What a scene may not say: every refusal names the entry, what was received and what is allowed."""

from pathlib import Path

import pytest
from refusals import cases, check_said, refusal

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.scene import load_scene, scene_from_toml
from pgmp_petsc.scene.messages import dotted_name, input_error, problem, toml_text

SLIDER_CRANK = Path(__file__).resolve().parents[2] / "scenes" / "slider_crank.toml"
WORDS_OF_LIBRARIES = ("pydantic", "validation error", "input should", "extra_forbidden", "tagged-union")
ENTRIES = cases(
    """
scene.name="" -> = "": text that is not empty is needed
scene.name=3 -> = 3: text in quotes is needed
bodies=1 -> = 1: a table is needed
bodies.crank=1 -> = 1: a table is needed
coordinates={} -> = {}: 1 or more entries are needed
materials.steel.nu="r1" -> = "r1": numbers are needed, no parameter: stiffness is no sum of products of parameters with
materials.steel.nu=0.5 -> = 0.5: must be less than 0.5
materials.steel.nu=-1 -> = -1: must be greater than -1.0
materials.steel.nu=nan -> = nan: a finite number is needed
materials.steel.E=inf -> = inf: a positive number or the name of a parameter is needed
materials.steel.rho=0 -> = 0: a positive number or the name of a parameter is needed
materials.steel.rho=HUGE -> = 10000000000000000000000000000000000000000000000000000000 ...: a positive number or the
bodies.rod.section.radius=true -> = true: a positive number or the name of a parameter is needed
effects.motor.scale=nan -> = nan: a finite number or the name of a parameter is needed
reduction.modes=1.5 -> = 1.5: an integer is needed
reduction.modes=0 -> = 0: must be at least 1
reduction.angles=3 -> = 3: must be at least 4
reduction.preload=1 -> = 1: true or false is needed
reduction.spring_modes="no" -> = "no": true or false is needed
simulation.spectral_radius=1.1 -> = 1.1: must be at most 1.0
simulation.frames=-1 -> = -1: must be at least 0
simulation.duration=0 -> = 0: must be greater than 0.0
simulation.step=2 -> = 2: must not exceed the duration, 1.0 s
simulation.duration=1e-4 -> simulation.step = 0.001: must not exceed the duration, 0.0001 s
ensemble.quantiles=[0.5, 1] -> ensemble.quantiles[1] = 1: must be less than 1.0
ensemble.quantiles=0.5 -> = 0.5: a list in brackets is needed
ensemble.batch=0 -> = 0: must be at least 1
ensemble.checked_share=1.1 -> = 1.1: must be at most 1.0
simulation.error_indicator=1 -> = 1: true or false is needed
coordinates.theta.periodic=1 -> = 1: true or false is needed
coordinates.theta.range=[0, 1] -> = [0, 1]: the range of a periodic coordinate is 2 pi = 6.283185307179586 long
coordinates.theta.range=[1, 1] -> = [1, 1]: the first number must be below the second
coordinates.theta.range=[1] -> = [1]: two finite numbers in brackets are needed, such as [0.0, 1.0]
joints.slider.direction=[0, 0] -> = [0, 0]: a direction other than [0, 0] is needed
effects.motor.table=[] -> = []: 1 or more entries are needed
effects.motor.table=[[0, 1], [1, nan]] -> effects.motor.table[1] = [1, nan]: a finite number, and one or the name of a
effects.motor.table=[[0, 1], ["r1", 1]] -> effects.motor.table[1] = ["r1", 1]: a finite number, and one or the name of a
effects.motor={type="torque",joint="crank_hinge",harmonic={amplitude="p",frequency_hz=2.0}} -> \
    effects.motor.harmonic.amplitude = "p": there is no such parameter; known: r1
effects.motor={type="torque",joint="crank_hinge",harmonic={amplitude="r1",frequency_hz=2.0},scale="r2"} -> \
    effects.motor.scale = "r2": a number is needed: values over time name r1, and loads are affine in their parameters
effects.motor={type="torque",joint="crank_hinge",harmonic={amplitude=1.0,frequency_hz="r1"}} -> \
    effects.motor.harmonic.frequency_hz = "r1": numbers are needed, no parameter: loads are affine in their parameters
effects.drive={type="prescribed_motion",coordinate="theta",table=[[0.0,0.0],[1.0,"r1"]]} -> \
    effects.drive.table = [[0.0, 0.0], [1.0, "r1"]]: numbers are needed, no parameter: a prescribed motion is a
effects.drive={type="prescribed_motion",coordinate="theta",spin_up={speed="r1",time=1.0}} -> \
    effects.drive.spin_up.speed = "r1": numbers are needed, no parameter: a prescribed motion is a constraint, one for
effects.loss={type="structural_damping",ratios=[0.1,"r1"]} -> effects.loss.ratios = [0.1, "r1"]: numbers are needed, no
simulation.initial.theta.position="r1" -> = "r1": numbers are needed, no parameter: displacements, and the turns of
effects.motor.table=[[0, 1], [0, 2]] -> = [[0, 1], [0, 2]]: times must increase strictly, but 0.0 s follows 0.0 s
foo=1 -> = 1: unknown key (allowed: scene, ground, parameters, materials, bodies, joints, coordinates, effects
bodies.crank.section.radus=0.1 -> = 0.1: unknown key; did you mean 'radius'? (allowed: shape, radius)
bodies.crank.section.circle=1 -> = 1: unknown key (allowed: shape, radius)
bodies.crank.section.flexible=true -> = true: unknown key; bodies.crank has one: write it above the head [bodies.crank.section] (allowed: shape, radius)
bodies.crank.section={shape='circle', circle=1} -> \
    bodies.crank.section.radius: missing; needed: radius || bodies.crank.section.circle = 1: unknown key (allowed:
scene={} -> scene.name: missing; needed: short name, used in reports and titles
bodies.crank.element='beam4d' -> = "beam4d": unknown; did you mean 'beam3d'? (allowed: beam2d, beam3d, solid2d, solid3d)
outputs.slider_position.axis='w' -> = "w": unknown (allowed: x, y, z)
outputs.slider_position.axis='z' -> = "z": x or y is needed in the plane
outputs.slider_position.axis=1 -> = 1: unknown (allowed: x, y, z)
effects.motor=3 -> = 3: a table is needed
bodies.rod.placement=3 -> = 3: a table is needed, with origin, angle
effects.motor={} -> effects.motor.type: missing
effects.motor.type='torqe' -> = "torqe": unknown; did you mean 'torque'?
outputs.a.type='pace' -> = "pace": unknown
bodies.crank.section.shape=1 -> = 1: unknown
effects."my motor"={type="gravity"} -> : a name starts with a letter or _ and goes on with letters, digits, _ or -
ground.points."a:b"=[0,1] -> : a name starts with a letter or _ and goes on with letters, digits, _ or -
ground.points.origin=[0, 1] -> = [0, 1]: the ground's origin is always at [0, 0]; give the point another name
parameters.r1.nominal=1 -> = 1: must lie inside the parameter's bounds [0.001, 0.012] m
parameters.r1.value=1 -> = 1: must lie inside the parameter's bounds [0.001, 0.012] m
parameters.r1.bounds=[2, 1] -> = [2, 1]: the first number must be below the second
parameters.r1.distribution=3 -> = 3: a table is needed
parameters.r1.distribution.loc='a' -> = "a": a number is needed
parameters.r1.distribution.loc=inf -> = inf: a finite number is needed
parameters.r1.distribution.scale=-1 -> = -1: a positive number is needed
parameters.r1.distribution.sale=2 -> = 2: unknown argument of norm; did you mean 'scale'? (allowed: loc, scale)
parameters.r1.distribution.name='normm' -> = "normm": no continuous distribution of scipy.stats; did you mean 'norm'?
parameters.r1.distribution.name='###' -> = "###": no continuous distribution of scipy.stats; known are norm, uniform
parameters.r1.distribution={name='beta', a=1} -> parameters.r1.distribution.b: missing; beta needs the shape parameters
parameters.r1.distribution={name='beta', a=-1, b=2} -> = { name = "beta", a = -1, b = 2 }: scipy.stats refuses these
parameters.r1.distribution.loc=1 -> \
    parameters.r1.distribution = { name = "norm", loc = 1, scale = 0.00056 }: gives no samples inside the parameter's
parameters.r1.distribution={name='vonmises', kappa=2, loc=6e-3, scale=5e-4} -> \
    = { name = "vonmises", kappa = 2, loc = 0.006, scale = 0.0 ...: has -1.01 of its samples below the parameter's
joints.elbow.connect=['crank:tip'] -> = ["crank:tip"]: two points in brackets are needed, such as ["ground:origin"
joints.elbow.connect=['crank:tip', 'rod'] -> joints.elbow.connect[1] = "rod": a point is needed, written "body:point" or
joints.elbow.connect=['crank:', 'rod:tip'] -> joints.elbow.connect[0] = "crank:": a point is needed, written
joints.elbow.connect=['crank:tip', 1] -> joints.elbow.connect[1] = 1: a point is needed, written "body:point" or
bodies.crank.material='stel' -> = "stel": there is no such material; did you mean 'steel'?
bodies.crank.section.radius='r2' -> = "r2": there is no such parameter; known: r1
effects.motor.scale='gain' -> = "gain": there is no such parameter; known: r1
parameters={} -> bodies.crank.section.radius = "r1": there is no such parameter; none is defined
parameters.r1={nominal=-1} -> parameters.r1.nominal = -1.0: must be positive, because bodies.crank.section.radius uses
parameters.r1={nominal=1, value=0} -> parameters.r1.value = 0.0: must be positive, because bodies.crank.section.radius
joints.elbow.connect=['crank:tip', 'rd:hinge'] -> = "rd:hinge": there is no body 'rd'; did you mean 'rod'?
joints.elbow.connect=['ground:orign', 'rod:hinge'] -> = "ground:orign": there is no such ground point; did you mean
joints.elbow.connect=['crank:tip', 'crank:hinge'] -> = ["crank:tip", "crank:hinge"]: a joint connects two different
joints.a={type='revolute', connect=['ground:origin', 'ground:origin']} -> \
    joints.a.connect = ["ground:origin", "ground:origin"]: a joint connects two different bodies, or a body and the
coordinates.theta.joint='elbw' -> = "elbw": there is no such point_on_beam, point_on_line, prismatic or revolute
coordinates.theta.joint='slider' -> coordinates.theta.motion: missing; slider is point_on_line: "sliding" or "turning"
coordinates.theta.motion='sliding' -> = "sliding": crank_hinge is revolute: allowed is "turning"
coordinates.theta={joint='slider', motion='sliding', range=[0, 1], periodic=true} -> \
    coordinates.theta.range = [0, 1]: the range of a periodic coordinate is 2 pi
coordinates.theta={joint='slider', motion='sliding', range=[0, 6.283185307179586], periodic=true} -> \
    coordinates.theta.periodic = true: for angles; what slides has two ends
coordinates.theta={range=[0, 1]} -> coordinates.theta.joint: exactly one of joint, points is needed; none is given
coordinates.theta={joint='elbow', points=['ground:origin', 'rod:tip'], range=[0, 1]} -> \
    coordinates.theta.points = ["ground:origin", "rod:tip"]: exactly one of joint, points is needed
coordinates.theta={motion='sliding', points=['ground:origin', 'rod:tip'], range=[0.1, 1]} -> \
    coordinates.theta.motion = "sliding": a distance has one motion; leave it out
coordinates.theta={points=['ground:origin', 'rod:tip'], range=[0, 1]} -> \
    coordinates.theta.range = [0.0, 1.0]: a distance is positive
coordinates.theta={points=['ground:origin', 'ground:origin'], range=[-1, 1]} -> \
    coordinates.theta.points = ["ground:origin", "ground:origin"]: two different points are needed || \
    coordinates.theta.range = [-1.0, 1.0]: a distance is positive
coordinates.phi={joint='crank_hinge', range=[-1, 1]} -> coordinates.phi.joint = "crank_hinge": coordinates.theta has the
effects.motor.joint='motor' -> = "motor": there is no such point_on_beam, point_on_line or revolute joint; known
outputs.crank_angle.joint='slidr' -> = "slidr": there is no such point_on_beam, point_on_line or revolute joint; did
outputs.time={type="angle", joint="crank_hinge"} -> : results keep instants under this name; give the output
outputs.status={type="angle", joint="crank_hinge"} -> : results keep what became of samples under this name
parameters.sample={nominal=1.0} -> : results keep the numbers of samples under this name; give the parameter
outputs.slider_position.point='rd:tip' -> = "rd:tip": there is no body 'rd'; did you mean 'rod'?
outputs.slider_position.point='ground:origin' -> = "ground:origin": a point of a body is needed; the ground does not
simulation.initial.thet={} -> : there is no such coordinate; did you mean 'theta'?
""".replace("HUGE", "1" + 400 * "0")
)


@pytest.mark.parametrize(("override", "said"), ENTRIES, ids=[override[:50] for override, _ in ENTRIES])
def test_a_wrong_entry_is_explained(override: str, said: str) -> None:
    message = refusal(load_scene, SLIDER_CRANK, [override])
    check_said(message, said, override)
    assert not any(word in message.lower() for word in WORDS_OF_LIBRARIES)


@pytest.mark.parametrize(
    ("initial", "position", "given"),
    [("", "0.0", "; a start that is not given is at zero"), ("theta = { position = 9 }", "9.0", "")],
)
def test_the_start_lies_in_a_range_that_is_not_periodic(initial: str, position: str, given: str) -> None:
    assert (
        refusal(
            load_scene,
            SLIDER_CRANK,
            ["coordinates.theta={joint='crank_hinge', range=[1, 2]}", f"simulation.initial={{{initial}}}"],
        )
        == f"simulation.initial.theta.position = {position}: must lie in the coordinate's range [1.0, 2.0]{given}"
    )
    scene = load_scene(SLIDER_CRANK, ["simulation.initial.theta.position=-7.0"])
    assert scene.initial_state("theta").position == -7.0, "a periodic coordinate starts anywhere"
    assert "parameters.r1.value = 0.5: must lie inside" in refusal(load_scene, SLIDER_CRANK, (), ["r1=0.5"])


def test_a_body_may_not_be_called_ground() -> None:
    text = SLIDER_CRANK.read_text().replace("[bodies.rod]", "[bodies.ground]").replace("rod:", "crank:")
    with pytest.raises(InputError, match="bodies.ground: this name means the points fixed in space"):
        scene_from_toml(text, ".")


def test_an_empty_scene_is_told_which_tables_are_needed() -> None:
    assert refusal(scene_from_toml, "", ".").splitlines() == [
        "scene: missing; needed: table with the scene's name",
        "bodies: missing; needed: a table for each body, [bodies.NAME]",
        "joints: missing; needed: a table for each joint, [joints.NAME]",
        "coordinates: missing; needed: a table for each rigid coordinate, [coordinates.NAME]",
    ]


def test_many_problems_are_cut_to_eight_lines() -> None:
    lines = str(input_error([f"a{i}: wrong" for i in range(20)])).splitlines()
    assert len(lines) == 8
    assert lines[6:] == ["a6: wrong", "... and 13 more problems"]
    assert str(input_error([f"a{i}: wrong" for i in range(8)])).splitlines()[-1] == "a7: wrong"


@pytest.mark.parametrize(
    "change",
    [
        'joints.elbow.connect=["crank:tip", "NAME:hinge"]',
        'effects.e={type="structural_damping", mass=1, bodies=["NAME"]}',
        'effects.e={type="law", joint="crank_hinge", force="NAME * s"}',
        'effects.e={type="law", joint="crank_hinge", force="NAME(s)"}',
    ],
)
def test_long_names_are_cut(change: str) -> None:
    assert max(map(len, refusal(load_scene, SLIDER_CRANK, [change.replace("NAME", "n" * 2000)]).splitlines())) < 600


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ('a"b', '"a\\"b"'),
        (True, "true"),
        (1e-3, "0.001"),
        ({"a b": [1, {}]}, '{ "a b" = [1, {}] }'),
        ("x" * 80, '"' + "x" * 55 + " ..."),
    ],
)
def test_received_values_are_shown_as_toml(value: object, text: str) -> None:
    assert toml_text(value) == text


def test_lines_and_dotted_names() -> None:
    assert dotted_name(["a", "b c", 2, "d"]) == 'a."b c"[2].d'
    assert problem("a.b", "allowed", None) == "a.b = None: allowed"
    assert problem("a.b", "allowed") == "a.b: allowed"
