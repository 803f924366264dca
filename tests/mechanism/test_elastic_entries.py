"""What is refused of elastic joints, with the entry's name."""

import pytest
from elastic_scenes import machine, rigid_frame, rotor
from refusals import cases, check_said, refusal
from runs import mechanism, overridden, refused

from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.scene import scene_from_toml, scene_to_toml

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
def test_refused(scene, asked, said):
    check_said(refusal(lambda: mechanism(scene(asked))), said, asked)


def test_refused_on_several_ranks(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(scene_to_toml(rotor()))
    asked = (IN_SPACE[5][0], IN_SPACE[1][0])
    for said in refused(3, [["modes", scene, *overridden(one), "-o", tmp_path / "m.h5"] for one in asked]):
        assert said.count("joints.left.elastic") == 1


def test_offsets_that_nothing_holds_are_refused_on_several_ranks(tmp_path):
    scene, given = tmp_path / "scene.toml", "joints.one.elastic={reference=[[1.0,0.0]],stiffness=[1e6,0.0],"
    loose = given + "turning_stiffness=[0.0]}", "joints.one.offset={place=[0.0,1e-3]}", "effects={}"
    scene.write_text(scene_to_toml(machine(*loose)))
    for said in refused(3, [["check", scene], ["simulate", scene, "--full", "-o", tmp_path / "f.h5"]]):
        assert said.count("nothing holds what joints.one.elastic.stiffness = [1e+06, 0] releases") == 1


def test_infinity_is_written_and_read():
    text = scene_to_toml(rotor())
    assert "inf" in text and scene_from_toml(text, ".") == rotor()


LENGTH = ("parameters.l={nominal=0.3,bounds=[0.29,0.31]}", "bodies.crank.line.length='l'")
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
        'reduction.effects = "auto" with joints.hub.clearance: effects are chosen',
    ),
    "lengths": (Purpose.BUILD, LENGTH, 'bodies.crank.line.length = "l" with joints.one.elastic: models at several'),
}


@pytest.mark.parametrize(("purpose", "asked", "said"), NOT_WITH_THESE.values(), ids=NOT_WITH_THESE)
def test_what_elastic_joints_are_not_taken_with(purpose, asked, said):
    # pgmp check says what a build is refused with, too
    for asking in (purpose, Purpose.CHECK) if purpose is Purpose.BUILD else (purpose,):
        assert refusal(check_capabilities, machine(*asked), asking).startswith(said)
    check_capabilities(rigid_frame(), Purpose.FULL)
