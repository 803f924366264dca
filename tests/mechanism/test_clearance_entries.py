"""What is refused of clearance in joints and of elastic joints, with the entry's name."""

import pytest
from elastic_scenes import machine, rigid_frame, rotor
from loose_scenes import ball, gears, worn
from refusals import cases, check_said, refusal
from runs import overridden, refused

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities, foretold
from pgmp_petsc.scene import scene_from_toml, scene_to_toml
from pgmp_petsc.studies.check import describe_scene
from scenes import mechanism_of, meshes_of

REFUSED = cases("""
joints.pin.clearance.radius=1.0 -> joints.pin.clearance.radius = 1.0: is larger than crank, which is 0.1 m long
joints.pin.clearance.radius=-1e-4 -> joints.pin.clearance.radius = -0.0001: a positive number
joints.pin.clearance.radius=0.0 -> joints.pin.clearance.radius = 0.0: a positive number
joints.pin.clearance.stiffness=-1e8 -> joints.pin.clearance.stiffness = -100000000.0: a positive number
joints.pin.clearance.exponent=0.9 -> joints.pin.clearance.exponent = 0.9: must be at least 1
joints.pin.clearance.restitution=0.0 -> joints.pin.clearance.restitution = 0.0: a positive number
joints.pin.clearance.restitution=1.1 -> joints.pin.clearance.restitution = 1.1: must be above 0 and at most 1
joints.pin.clearance.restitution="K" -> parameters.K.nominal = 500000000.0: joints.pin.clearance.restitution: must be
joints.pin.clearance.restitution_speed=0.0 -> joints.pin.clearance.restitution_speed = 0.0: a positive number
joints.pin.clearance.damping="none" -> joints.pin.clearance.damping = "none"
joints.pin.clearance.friction=-0.1 -> joints.pin.clearance.friction = -0.1: a number that is not negative
joints.pin.clearance.friction=0.1 -> joints.pin.clearance.friction_speed: friction needs the speed up to which it
joints.pin.clearance.friction_speed=0.1 -> joints.pin.clearance.friction_speed = 0.1: without effect, as there is no
joints.pin.clearance.radios=0.1 -> joints.pin.clearance.radios = 0.1: unknown key; did you mean 'radius'
joints.pin.elastic={reference=[[1.0,0.0]],stiffness=[1e6,1e6]} -> joints.pin.elastic: a joint has elastic or clearance
joints.pin.offset={place=[1e-4,0.0]} -> joints.pin.offset: a joint has offset or clearance, not both
joints.pin.type="fixed" -> joints.pin.clearance: a joint of type fixed has none; those that have are | revolute
effects.pin={type="gravity"} -> effects.pin: joints.pin has clearance, and its forces have this name
controllers.pin={type="pid", joint="main", measures="theta", gains={p=1.0}} -> controllers.pin: joints.pin has clearance
""")


@pytest.mark.parametrize(("asked", "said"), REFUSED)
def test_refused(asked, said):
    check_said(refusal(lambda: mechanism_of(worn(asked))), said, asked)


def test_a_ball_in_its_socket_has_no_friction_and_a_parameter_keeps_within_bounds():
    socket = (
        "joints.bore={type='spherical',connect=['ground:origin','ball:centre'],clearance={radius=1e-3,stiffness=1e8,"
    )
    with pytest.raises(InputError, match="for mechanisms in space"):
        ball(socket + "restitution=0.9,friction=0.1,friction_speed=1e-3}}")
    drawn = "parameters.e={nominal=0.8,distribution={name='norm',loc=0.8,scale=0.1}}"
    entry = "joints.pin.clearance.restitution"
    assert f"parameters.e.bounds = -inf: {entry}: must be above 0" in refusal(worn, drawn, f"{entry}='e'")
    assert worn(drawn.replace("}}", "},bounds=[0.5,1.0]}"), f"{entry}='e'").parameters["e"]
    bounds = "parameters.e={nominal=0.8,bounds=[0.5,1.2]}"
    assert f"parameters.e.bounds = 1.2: {entry}: must be above 0" in refusal(worn, bounds, f"{entry}='e'")


TEETH = cases("""
joints.mesh.clearance.restitution=1.5 -> joints.mesh.clearance.restitution = 1.5: must be above 0 and at most 1
joints.mesh.clearance.radius=-1e-3 -> joints.mesh.clearance.radius = -0.001: a positive number
joints.mesh.elastic={stiffness=1e5} -> joints.mesh.elastic: a joint has elastic or clearance, not both
joints.mesh={type="belt",joints=["input","output"],radii=[0.1,0.2],clearance={radius=1e-3,stiffness=1e5,
    restitution=0.9}} -> joints.mesh.clearance: a joint of type belt has none; those that have are
joints.mesh.clearance={radius=2e-3,stiffness=1e5,restitution=0.8,friction=0.1} ->
    joints.mesh.clearance.friction = 0.1: unknown key
""")


@pytest.mark.parametrize(("asked", "said"), TEETH)
def test_refused_of_gears(asked, said):
    check_said(refusal(gears, asked), said, asked)


def test_what_knows_no_released_directions_says_so():
    with pytest.raises(InputError, match="joints.pin.clearance: sizes of effects are those on joints without room"):
        check_capabilities(worn(), Purpose.SIZES)


def test_a_check_says_at_which_speed_restitution_holds():
    """Given or left out, of a joint and of teeth that turn."""
    given, left_out = "joints.pin.clearance.restitution_speed=0.2", ", as restitution_speed is left out"
    pin = {"radius": 1e-4, "stiffness": 5e8, "restitution": 0.9}
    without = f"joints.pin.clearance={{{','.join(f'{key}={value}' for key, value in pin.items())}}}"
    for scene, said in (
        (worn(given), "pin: restitution 0.9 at impacts of 0.2 m/s; 0.99 at a tenth of it, 0.46 at ten times"),
        (worn(without), f"pin: restitution 0.9 at impacts of 1 m/s{left_out}; 0.99 at a tenth of it, 0.46 at"),
        (gears(), "mesh: restitution 0.8 at impacts of 0.2 rad/s; 0.98 at a tenth of it, 0.26 at ten times"),
    ):
        assert f"  clearance     {said}" in describe_scene(scene, meshes_of(scene))


IN_THE_PLANE = cases("""
joints.one.elastic.stiffness=[-1.0, 1.0] -> joints.one.elastic.stiffness[0] = -1.0: a number that is not negative, inf
joints.one.elastic.stiffness=[nan, 1.0] -> joints.one.elastic.stiffness[0] = nan: a number that is not negative, inf
joints.one.elastic.stiffness=["nothing", 1.0] -> joints.one.elastic.stiffness = "nothing"
joints.one.elastic.stiffness=[1.0] -> = [1.0]: 2 numbers, one for each axis, are needed in the plane
joints.one.elastic.damping=[1.0, -1.0] -> joints.one.elastic.damping[1] = -1.0: a number that is not negative
joints.one.elastic.damping=[1.0, 1.0, 1.0] -> = [1.0, 1.0, 1.0]: 2 numbers, one for each axis
joints.one.elastic.stiffness=[1.0, inf] -> joints.one.elastic.damping = [60.0, 90.0]: what is rigid (inf in | has no
joints.one.elastic.stiffness=[] -> joints.one.elastic.damping = [60.0, 90.0]: what it holds stays rigid without
joints.one.elastic.turning_stiffness=[1.0, 2.0] -> = [1.0, 2.0]: one number is needed in the plane
joints.one.elastic.reference=[[1.0, 0.0], [0.0, 1.0]] -> = [[1.0, 0.0], [0.0, 1.0]]: one axis, [[1.0, 0.0]] for
    example, is needed in the plane
joints.one.elastic.reference=[[0.0, 0.0]] -> joints.one.elastic.reference[0] = [0.0, 0.0]: a direction other than
joints.one.elastic.stifness=[1.0, 1.0] -> joints.one.elastic.stifness = [1.0, 1.0]: unknown key; did you mean
    'stiffness'
joints.hub.elastic={reference=[[1.0,0.0]],turning_stiffness=[2.0]} -> joints.hub.elastic.turning_stiffness = [2.0]: the
    joint leaves turning free: 0 is needed there
joints.hub.elastic={reference=[[1.0,0.0]],turning_stiffness=[inf]} -> joints.hub.elastic.turning_stiffness = [inf]: the
    joint leaves turning free
joints.hub.elastic={reference=[[1.0,0.0]],turning_stiffness=["k"]} -> parameters.k: joints.hub.elastic.turning_stiffness
joints.hub.elastic={reference=[[1.0,0.0]],turning_stiffness=[0.0],turning_damping=[1.0]} ->
    joints.hub.elastic.turning_damping = [1.0]: the joint leaves turning free
effects.one={type="gravity"} -> effects.one: joints.one has elastic, and its forces have this name
""")
IN_SPACE = cases("""
joints.right.offset={turn=[0.0, 1e-3, 0.0]} -> joints.right.offset.turn = [0.0, 0.001, 0.0]: turns what the joint slides
    along, which it releases across that by more the further it slides
joints.left.elastic.reference=[[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]] -> = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]: the axes
    must not be parallel
joints.left.elastic.reference=[[1.0, 0.0, 0.0]] -> = [[1.0, 0.0, 0.0]]: two axes of three numbers
joints.left.elastic.stiffness=[1.0, 1.0] -> = [1.0, 1.0]: 3 numbers, one for each axis, are needed in space
joints.left.elastic.turning_stiffness=[0.0, 1.0] -> = [0.0, 1.0]: 3 numbers, one for each axis
joints.left.elastic.turning_stiffness=[5.0, 0.0, 0.0] -> = [5.0, 0.0, 0.0]: the joint leaves turning about the first
    axis of reference free: 0 is needed there
joints.right.elastic.stiffness=[5.0, 1.0, 1.0] -> = [5.0, 1.0, 1.0]: the joint leaves sliding along the first axis
joints.right.elastic.stiffness=[inf, 1.0, 1.0] -> = [inf, 1.0, 1.0]: the joint leaves sliding along the first axis
joints.right.elastic.reference=[[1.0, 1.0, 0.0], [0.0, 1.0, 0.0]] -> joints.right.elastic.stiffness = | an axis that is
    oblique to what the joint leaves free is neither held nor free | joints.right.elastic.reference
""")
EVERYWHERE = [(rigid_frame, *case) for case in IN_THE_PLANE] + [(rotor, *case) for case in IN_SPACE]


@pytest.mark.parametrize(("scene", "asked", "said"), EVERYWHERE)
def test_refused_of_elastic_joints(scene, asked, said):
    check_said(refusal(lambda: mechanism_of(scene(asked))), said, asked)


def test_refused_on_several_ranks(tmp_path):
    """Clearances, elastic joints and offsets that nothing holds, each with one message of all ranks."""
    given = "joints.one.elastic={reference=[[1.0,0.0]],stiffness=[1e6,0.0],turning_stiffness=[0.0]}"
    loose = machine(given, "joints.one.offset={place=[0.0,1e-3]}", "effects={}")
    paths = [tmp_path / f"{name}.toml" for name in ("worn", "rotor", "loose")]
    for path, written in zip(paths, (worn(), rotor(), loose)):
        path.write_text(scene_to_toml(written))
    room, elastic, held = paths
    commands = [["check", room, *overridden(REFUSED[row][0])] for row in (0, 6)]
    commands += [["modes", elastic, *overridden(IN_SPACE[row][0]), "-o", tmp_path / "m.h5"] for row in (5, 1)]
    commands += [["check", held], ["simulate", held, "--full", "-o", tmp_path / "f.h5"]]
    words = ["joints.pin.clearance", "joints.left.elastic"]
    words.append("nothing holds what joints.one.elastic.stiffness = [1e+06, 0] releases")
    for said, word in zip(refused(2, commands), [word for word in words for _ in range(2)]):
        assert said.count(word) == 1


def test_infinity_is_written_and_read():
    text = scene_to_toml(rotor())
    assert "inf" in text and scene_from_toml(text, ".") == rotor()


AUTOMATIC = ("reduction.effects='auto'", "effects={}")
PLAY = (
    "joints.hub.clearance={radius=1e-4,stiffness=5e8,restitution=0.9,restitution_speed=0.1}",
    "joints.one.offset={place=[0.0,1e-3]}",
)
NOT_WITH_THESE = {
    "off beside room": (Purpose.BUILD, PLAY, "joints.one.offset with joints.hub.clearance: runs begin with what is"),
    "preload": (Purpose.MODES, ("reduction.preload=true",), "reduction.preload = true with joints.one.elastic: the"),
    "sizes": (Purpose.SIZES, PLAY[:1], "joints.hub.clearance: sizes of effects are those on joints without room"),
    "automatic": (
        Purpose.BUILD,
        (*AUTOMATIC, PLAY[0]),
        'reduction.effects = "auto" with joints.hub.clearance: effects',
    ),
}


@pytest.mark.parametrize(("purpose", "asked", "said"), NOT_WITH_THESE.values(), ids=NOT_WITH_THESE)
def test_what_elastic_joints_are_not_taken_with(purpose, asked, said):
    assert refusal(check_capabilities, machine(*asked), purpose).startswith(said)
    # pgmp check says what a build is refused with, too
    assert purpose is not Purpose.BUILD or said in " ".join(foretold(machine(*asked)))
    check_capabilities(rigid_frame(), Purpose.FULL)
