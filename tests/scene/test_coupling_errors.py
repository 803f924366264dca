"""Couplings that cannot be: every refusal, with the entry's name."""

import pytest
from coupled_scenes import CAM, RACK, ROTORS, ROTORS_IN_SPACE, SCREW
from refusals import cases, check_said, refusal

from pgmp_petsc.scene import scene_from_toml

REFUSED = {
    ROTORS: """
joints.mesh.ratio=0.0 -> = 0.0: a number other than 0 or the name of a parameter is needed
joints.mesh.ratio="r" -> = "r": there is no such parameter
joints.mesh.ratio=true -> = true: a number other than 0 or the name of a parameter is needed
joints.mesh.ratio="r" & parameters.r={nominal=0.5} -> \
    parameters.r.bounds: missing; joints.mesh.ratio uses it, and the reduced model is built between its ends: give \
bounds = [low, high], or a distribution
joints.mesh.ratio="r" & parameters.r={nominal=0.5, bounds=[-0.1, 0.6]} -> \
    parameters.r.bounds = [-0.1, 0.6]: must be on one side of 0, because joints.mesh.ratio uses it
joints.mesh.ratio="r" & parameters.r={nominal=0.0, bounds=[-0.1, 0.6]} -> \
    parameters.r.nominal = 0.0: must not be 0, because joints.mesh.ratio uses it || \
    parameters.r.bounds = [-0.1, 0.6]: must be on one side of 0
joints.mesh.ratio="r" & parameters.r={nominal=0.5, bounds=[0.4, 0.6], unit="m"} -> \
    parameters.r.unit = "m": joints.mesh.ratio uses it, which needs 1 (no unit)
joints.mesh.ratio="r" & parameters.r={nominal=0.5, bounds=[0.4, 0.6]} & bodies.one.rigid.mass="r" -> \
    parameters.r: joints.mesh.ratio and bodies.one.rigid.mass use it; what is a length, a place or || \
    parameters.r: joints.mesh.ratio (1) and bodies.one.rigid.mass (kg) use it, which are different quantities
joints.mesh.joints=["input"] -> = ["input"]: the names of two joints in brackets are needed
joints.mesh.joints="input" -> = "input": the names of two joints in brackets are needed
joints.mesh.joints=["input", 3] -> = ["input", 3]: the names of two joints in brackets are needed
joints.mesh={type="coupling", terms=3} -> joints.mesh.terms = 3
joints.mesh={type="coupling", terms={input="r", output=1.0}} -> joints.mesh.terms.input = "r": there is no such param
joints.mesh={type="gear", joints=["input", "output"]} -> joints.mesh.ratio: missing
joints.mesh.connect=["ground:origin", "one:hub"] -> = | unknown key
joints.mesh.joints=["input", "outptu"] -> = "outptu": there is no such joint; did you mean 'output'?
joints.mesh.joints=["input", "mesh"] -> = "mesh": a joint that has the motion turning is needed; this one is gear
joints.mesh.joints=["input", "input"] -> = "input": the same joint is named twice
joints.mesh.type="chain" -> = "chain": unknown
joints.mesh={type="belt", joints=["input", "output"]} -> joints.mesh.radii: exactly one of radii, ratio is needed; none
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, 0.2], ratio=2.0} -> \
    joints.mesh.ratio = 2.0: exactly one of radii, ratio is needed; radii and ratio are given
joints.mesh={type="belt", joints=["input", "output"], ratio=0.0} -> joints.mesh.ratio = 0.0: a number other than 0
joints.mesh={type="belt", joints=["input", "output"], ratio=2.0, crossed=true} -> \
    joints.mesh.crossed = true: a ratio says it by its sign
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, 0.0]} -> \
    joints.mesh.radii = [0.1, 0.0]: two positive numbers in brackets are needed, such as [0.05, 0.1], each a number or
joints.mesh={type="belt", joints=["input", "output"], radii=0.1} -> joints.mesh.radii = 0.1: two positive numbers
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, "5 kg"]} -> \
    joints.mesh.radii = [0.1, "5 kg"]: 'kg' is the unit of a mass; needed is a length (m)
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, "r"]} -> joints.mesh.radii = "r": there is no such
joints.mesh={type="belt", joints=["input", "output"], radii=["r", 0.1]} & parameters.r={nominal=1.0, bounds=[0, 2]} \
    -> parameters.r.bounds = [0.0, 2.0]: must be positive, because joints.mesh.radii uses it
joints.mesh={type="belt", joints=["input", "output"], radii=[0.1, 0.2], crossed=1} -> joints.mesh.crossed = 1
joints.mesh={type="belt", joints=["input", "input"], radii=[0.1, 0.2]} -> joints.mesh.joints = "input": the same joint
joints.mesh={type="screw", joint="input", lead=1.0} -> joints.mesh.type = "screw": for mechanisms in space
joints.mesh={type="rack", joints=["input", "output"], radius=1.0} -> \
    joints.mesh.joints = "output": a joint that has the motion sliding is needed; this one is revolute
joints.mesh={type="coupling", terms={input=1.0}} -> joints.mesh.terms
joints.mesh={type="coupling", terms={input=1.0, output=0.0}} -> joints.mesh.terms.output = 0.0: a number other than
joints.mesh={type="coupling", terms={input=1.0, outptu=2.0}} -> joints.mesh.terms = "outptu": there is no such joint
coordinates.phi.joint="mesh" -> = "mesh": a | joint is needed, this one is a gear
outputs.one.joint="mesh" -> = "mesh": a | joint is needed, this one is a gear
effects.motor.joint="mesh" -> = "mesh": a | joint is needed, this one is a gear
""",
    RACK: """
joints.teeth.radius=0.0 -> = 0.0: a number other than 0 or the name of a parameter is needed
joints.teeth.radius="r" & parameters.r={nominal=0.05, bounds=[0.04, 0.06], unit="kg"} -> \
    parameters.r.unit = "kg": joints.teeth.radius uses it, which needs m
joints.teeth.radius="r" & parameters.r={nominal=0.05} -> \
    parameters.r.bounds: missing; joints.teeth.radius uses it, and the reduced model is built between its ends: give \
bounds = [low, high] (m)
joints.teeth.radius="5 kg" -> = "5 kg": 'kg' is the unit of a mass; needed is a length (m)
joints.teeth={type="belt", joints=["axle", "teeth"], radii=[0.1, 0.2]} -> \
    joints.teeth.joints = "teeth": a joint that has the motion turning is needed; this one is belt
joints.teeth.joints=["rail", "teeth"] -> = "teeth": a joint that has the motion sliding is needed; this one is rack
""",
    SCREW: """
joints.thread.lead=0.0 -> = 0.0: a number other than 0 or the name of a parameter is needed
joints.thread.joint="thread" -> = "thread": a joint that has the motion sliding is needed; this one is screw || \
    joints.thread.joint = "thread": a joint that has the motion turning is needed; this one is screw
joints.thread={type="coupling", terms={shaft=1.0, thread=1.0}} -> \
    joints.thread.terms = "shaft": shaft is cylindrical, which turns and slides; couple it by a gear || \
    joints.thread.terms = "thread": a joint that turns or slides is needed; this one is coupling
""",
    ROTORS_IN_SPACE: """
coordinates.phi={points=["one:hub", "two:hub"], range=[0.1, 0.2]} & simulation.initial.phi.position=0.15 -> \
    joints.mesh.joints: in space turns are counted from the coordinates: all but one of the joints that turn must be
""",
    CAM: """
joints.lift.table=[[0.0, 0.0], [1.0, 0.1], [0.5, 0.1], [6.283185307179586, 0.0]] -> = | angles must increase; 0.5
joints.lift.table=[[0.0, 0.0], [1.0, 0.1], [3.0, 0.1], [6.0, 0.0]] -> = | must span one turn
joints.lift.table=[[0.0, 0.0], [1.0, 0.1], [3.0, 0.1], [6.283185307179586, 0.01]] -> = | must close
joints.lift.table=[[0.0, 0.0], [6.283185307179586, 0.0]] -> joints.lift.table
joints.lift.table=3 -> joints.lift.table = 3
joints.lift.table=[[0.0, "a"], [1.0, 0.1], [3.0, 0.1], [6.283185307179586, 0.0]] -> \
    joints.lift.table[0] = | two finite numbers in brackets are needed || \
    joints.lift.table = | entries are needed
""",
}


@pytest.mark.parametrize(
    ("text", "override", "said"), [(t, *case) for t, lines in REFUSED.items() for case in cases(lines)]
)
def test_a_coupling_is_refused(text: str, override: str, said: str) -> None:
    check_said(refusal(scene_from_toml, text, ".", override.split(" & ")), said, override)


def test_lengths_of_couplings_may_be_texts_with_units() -> None:
    assert scene_from_toml(RACK, ".", ['joints.teeth.radius="50 mm"']).joints["teeth"].radius == 0.05
    assert scene_from_toml(SCREW, ".", ['joints.thread.lead="5 cm"']).joints["thread"].lead == 0.05
