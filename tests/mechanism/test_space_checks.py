"""What a scene may not say of continuum bodies, and of the plane in space and of space in the plane."""

import pytest
from conftest import ROOT
from refusals import cases, check_said, refusal

from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.scene import load_scene

BEAMS, PLANE, SPACE = "slider_crank", "slider_crank_solid2d", "slider_crank_solid3d"
MOUNT = "effects.mount={type='bushing', points=['crank:tip', 'rod:tip'], stiffness=[1, 1, 1], reference="
GUIDE = "joints.elbow={type='cylindrical', connect=['crank:tip', 'rod:hinge'], axis=[0, 0, 1]}"
SPRINGY = "effects.more={type='spring_damper', joint='elbow', stiffness=1.0"
#: Of cells in the plane and in space, which a D stands for.
OF_CELLS = """
bodies.crank.section={shape='circle', radius=0.01} -> = { shape = "circle", radius = 0.01 }: solidDd takes its shape
bodies.crank={line={length=0.3, elements=4}, element='solidDd', material='steel'} -> \
    bodies.crank.line = { length = 0.3, elements = 4 }: solidDd takes its shape from a mesh; line is for beamDd
bodies.crank.line={length=0.3, elements=4} -> \
    = { length = 0.3, elements = 4 }: exactly one of mesh, line, matrices, rigid
bodies.crank={mesh='a.msh', element='solidDd', thickness=0.01} -> bodies.crank.material: missing; needed: name of a
bodies.rod.material='stel' -> = "stel": there is no such material; did you mean 'steel'?
bodies.rod.regions={core='stel'} -> bodies.rod.regions.core = "stel": there is no such material; did you mean 'steel'?
bodies.rod.regions={core=3} -> bodies.rod.regions.core = 3: text in quotes is needed
"""
REFUSED = {
    BEAMS: """
bodies.crank.thickness=0.01 -> = 0.01: for solid2d and solid3d only
bodies.crank.regions={core='steel'} -> = { core = "steel" }: for solid2d and solid3d only
bodies.crank.section_scale=1.1 -> = 1.1: for solid2d and solid3d only
bodies.crank.element='solid2d' -> bodies.crank.section = { shape = "circle", radius = "r1" }: solid2d takes its shape
bodies.crank.element='solid3d' -> bodies.crank.section = { shape = "circle", radius = "r1" }: solid3d takes its shape
joints.slider={type='spherical', connect=['ground:origin', 'rod:tip']} -> \
    joints.slider.type = "spherical": for mechanisms in space (allowed in the plane: fixed, point_on_beam
joints.slider={type='universal', connect=['ground:origin', 'rod:tip'], axis=[1, 0, 0], second_axis=[0, 1, 0]} -> \
    joints.slider.type = "universal": for mechanisms in space (allowed in the plane: fixed, point_on_beam
joints.slider={type='cylindrical', connect=['ground:origin', 'rod:tip'], axis=[1, 0, 0]} -> \
    joints.slider.type = "cylindrical": for mechanisms in space (allowed in the plane: fixed, point_on_beam
joints.slider={type='prismatic', connect=['ground:origin', 'rod:tip'], axis=[1, 0, 0]} -> \
    joints.slider.axis = [1.0, 0.0, 0.0]: two numbers (x, y) are needed in the plane
joints.slider={type='point_on_plane', connect=['ground:origin', 'rod:tip'], normal=[1, 0, 0]} -> \
    joints.slider.type = "point_on_plane": for mechanisms in space (allowed in the plane: fixed, point_on_beam
joints.elbow.axis=[0, 0, 1] -> = [0.0, 0.0, 1.0]: for mechanisms in space; in the plane the axis is z
joints.elbow.axis=[0, 1] -> = [0, 1]: three finite numbers in brackets are needed, such as [0.0, 0.0, 1.0]
ground.points.a=[1, 2, 3] -> = [1.0, 2.0, 3.0]: two numbers (x, y) are needed in the plane
joints.slider.direction=[1, 2, 3] -> = [1.0, 2.0, 3.0]: two numbers (x, y) are needed in the plane
bodies.crank.placement={origin=[1, 2, 3]} -> bodies.crank.placement.origin = [1.0, 2.0, 3.0]: two numbers (x, y) are
effects.weight={type='gravity', direction=[0, -1, 0]} -> \
    effects.weight.direction = [0.0, -1.0, 0.0]: two numbers (x, y) are needed in the plane
effects.push={type='force', point='rod:tip', direction=[0, -1, 0], table=[[0, 1]]} -> \
    effects.push.direction = [0.0, -1.0, 0.0]: two numbers (x, y) are needed in the plane
bodies.crank.placement={rotation=[0, 0, 1]} -> bodies.crank.placement.rotation = [0.0, 0.0, 1.0]: for mechanisms in
MOUNT[[1, 0, 0], [0, 1, 0]]} -> \
    effects.mount.reference = [[1.0, 0.0, 0.0], [0.0, 1.0 || effects.mount.stiffness = [1.0, 1.0, 1.0]: 2 numbers
outputs.slider_position.axis='z' -> = "z": x or y is needed in the plane
""",
    PLANE: """
bodies.rod={mesh='a.msh', element='solid2d', material='steel'} -> bodies.rod.thickness: missing; needed: thickness of
bodies.rod.thickness=0 -> = 0: a positive number or the name of a parameter is needed
bodies.rod.thickness='t2' -> = "t2": there is no such parameter; known: t1
parameters.t1={nominal=-1} -> parameters.t1.nominal = -1.0: must be positive, because bodies.crank.thickness uses it
bodies.rod.section_scale=-1.0 -> = -1.0: a positive number or the name of a parameter is needed
bodies.rod.section_scale='s' -> = "s": there is no such parameter; known: t1
joints.elbow.axis=[0, 0, 1] -> = [0.0, 0.0, 1.0]: for mechanisms in space; in the plane the axis is z
""",
    SPACE: """
bodies.rod.thickness=0.01 -> = 0.01: for solid2d only; a solid3d body has its thickness from its mesh
bodies.rod={mesh='a.msh', element='solid3d', material='steel', section_scale=1.1, flexible=false} -> \
    bodies.rod.section_scale = 1.1: for flexible bodies; the inertia of a rigid one would not be affine in it
bodies.rod={mesh='a.msh', element='solid2d', material='steel', thickness=0.01} -> \
    bodies.rod.element = "solid2d": in the plane, but crank (solid3d) in space; all bodies are beam2d and solid2d, or
bodies.crank={mesh='a.msh', element='beam2d', material='steel', section={shape='circle', radius=0.005}} -> \
    bodies.crank.element = "beam2d": in the plane, but rod (solid3d) in space; all bodies are beam2d and solid2d, or
joints.elbow={type='revolute', connect=['crank:tip', 'rod:hinge']} -> joints.elbow.axis: missing; needed in space: axis
joints.elbow.axis=[0, 1] -> = [0, 1]: three finite numbers in brackets are needed, such as [0.0, 0.0, 1.0]
joints.elbow.axis='z' -> = "z": three finite numbers in brackets are needed, such as [0.0, 0.0, 1.0]
joints.elbow.axis=[0, 0, 0] -> = [0, 0, 0]: a direction other than [0, 0, 0] is needed
joints.elbow={type='cylindrical', connect=['crank:tip', 'rod:hinge']} -> joints.elbow.axis: missing; needed: axis (x, y
joints.elbow={type='prismatic', connect=['crank:tip', 'rod:hinge']} -> joints.elbow.axis: missing; needed: axis (x, y
joints.slider={type='point_on_plane', connect=['ground:origin', 'rod:tip']} -> \
    joints.slider.normal: missing; needed: normal (x, y, z) of the plane, fixed to the owner of the first point
joints.slider={type='point_on_plane', connect=['ground:origin', 'rod:tip'], normal=[0, 1]} -> \
    joints.slider.normal = [0, 1]: three finite numbers in brackets are needed, such as [0.0, 0.0, 1.0]
joints.elbow={type='universal', connect=['crank:tip', 'rod:hinge'], axis=[0, 0, 1]} -> \
    joints.elbow.second_axis: missing; needed: axis fixed in the second body; in the frame of the first one, as
joints.elbow={type='universal', connect=['crank:tip', 'rod:hinge'], axis=[1, 2, 3], second_axis=[-2, -4, -6]} -> \
    joints.elbow.second_axis = [-2, -4, -6]: must not have the direction of axis; both axes are at a right angle
joints.slider={type='spherical', connect=['ground:origin', 'rod:tip'], axis=[0, 0, 1]} -> \
    joints.slider.axis = [0, 0, 1]: unknown key (allowed: connect, elastic, offset, clearance, type)
joints.elbow.type='hinge' -> = "hinge": unknown
coordinates.theta.joint='slider' -> coordinates.theta.periodic = true: for angles; what slides has two ends
ground.points.a=[1, 2] -> = [1.0, 2.0]: three numbers (x, y, z) are needed in space
joints.slider.direction=[1, 2] -> = [1.0, 2.0]: three numbers (x, y, z) are needed in space
bodies.crank.placement={origin=[1, 2]} -> bodies.crank.placement.origin = [1.0, 2.0]: three numbers (x, y, z) are needed
bodies.crank.placement={origin=[1, 2, 3, 4]} -> bodies.crank.placement.origin = [1, 2, 3, 4]: two finite numbers in
effects.weight={type='gravity', direction=[0, -1]} -> effects.weight.direction = [0.0, -1.0]: three numbers (x, y, z)
effects.push={type='force', point='rod:tip', direction=[0, -1], table=[[0, 1]]} -> \
    effects.push.direction = [0.0, -1.0]: three numbers (x, y, z) are needed in space
effects.weight={type='gravity', direction=[0, 0, 0]} -> effects.weight.direction = [0, 0, 0]: a direction other than [0
bodies.crank.placement={angle=0.3} -> bodies.crank.placement.angle = 0.3: for the plane; give rotation
bodies.crank.placement={rotation=0.3} -> bodies.crank.placement.rotation = 0.3: a rotation vector has three numbers
effects.weight={type='gravity'} -> effects.weight.direction: missing; needed in space: direction (x, y, z)
effects.push={type='force', point='rod:tip', table=[[0, 1]], direction=[0, -1], follows=true} -> \
    effects.push.direction = [0.0, -1.0]: three numbers (x, y, z) are needed in space
effects.mount={type='bushing', points=['crank:tip', 'rod:tip'], stiffness=[1, 1, 1]} -> \
    effects.mount.reference: missing; needed: first axis, and in space a second one, of the frame in which it is stiff
MOUNT[[1, 0, 0]]} -> effects.mount.reference = [[1.0, 0.0, 0.0]]: two axes of three numbers, [[1.0, 0.0, 0.0], [0.0
MOUNT[[1, 0], [0, 1]]} -> effects.mount.reference = [[1.0, 0.0], [0.0, 1.0]]: two axes of three numbers, [[1.0, 0.0
MOUNT[[1, 0, 2], [2, 0, 4]]} -> effects.mount.reference = [[1.0, 0.0, 2.0], [2.0, 0.0, 4.0]]: the axes must not be
MOUNT[[1, 0, 0], [0, 0, 0]]} -> effects.mount.reference[1] = [0, 0, 0]: a direction other than [0, 0, 0] is needed
MOUNT[[1, 0, 0], [0, 1, 0]], turning_stiffness=[1.0]} -> effects.mount.turning_stiffness = [1.0]: 3 numbers, one for
effects.mount={type='bushing', points=['crank:tip', 'rod:tip'], reference=[[1, 0, 0], [0, 1, 0]]} -> \
    = { type = "bushing", points = ["crank:tip", "rod:tip"], r ...: at least one of stiffness, damping
effects.more={type='joint_damping', joint='slider', coefficient=1.0, motion='turning'} -> \
    effects.more.motion = "turning": slider is point_on_line: allowed is "sliding"
outputs.tilt={type='rotation', point='rod:tip'} -> outputs.tilt.type = "rotation": a rotation in space is no single
""",
}
ENTRIES = [(scene, *case) for scene, text in REFUSED.items() for case in cases(text.replace("MOUNT", MOUNT))]
ENTRIES += [(scene, *case) for scene in (PLANE, SPACE) for case in cases(OF_CELLS.replace("Dd", scene[-2:]))]


@pytest.mark.parametrize(("scene", "override", "said"), ENTRIES, ids=[f"{e[0]}: {e[1][:50]}" for e in ENTRIES])
def test_a_wrong_entry_is_explained(scene: str, override: str, said: str) -> None:
    check_said(refusal(load_scene, ROOT / "scenes" / f"{scene}.toml", [override]), said, override)


def test_an_effect_on_a_cylindrical_joint_says_on_which_of_its_motions() -> None:
    scene = ROOT / "scenes" / f"{SPACE}.toml"
    assert refusal(load_scene, scene, [GUIDE, SPRINGY + "}"]) == (
        'effects.more.motion: missing; elbow is cylindrical: "turning" or "sliding" is needed'
    )
    for motion in ("turning", "sliding"):
        assert load_scene(scene, [GUIDE, f"{SPRINGY}, motion='{motion}'}}"]).effects["more"].motion == motion


FITTING = [
    # zero is the same in the plane and in space
    (BEAMS, "ground.points.a=[0, 0, 0]"),
    (SPACE, "ground.points.a=[0, 0]"),
    (SPACE, "bodies.crank.placement={origin=[0, 0]}"),
    (SPACE, "bodies.crank.placement={origin=[0.1, 0, 0], rotation=[0, 0, 1], angle=0}"),
    (SPACE, "joints.elbow.axis=[0, 3, 0]"),
    (
        SPACE,
        "joints.elbow={type='universal', connect=['crank:tip', 'rod:hinge'], axis=[0, 0, 1], second_axis=[0, 3, 0]}",
    ),
    (SPACE, "effects.weight={type='gravity', direction=[0, -1, 0]}"),
    (SPACE, "effects.push={type='force', point='rod:tip', direction=[0, -1, 0], table=[[0, 1]]}"),
    (SPACE, "effects.push={type='force', point='rod:tip', direction=[0, -1, 0], follows=true, table=[[0, 1]]}"),
    (SPACE, "effects.push={type='force', point='rod:tip', towards='ground:origin', table=[[0, 1]]}"),
    (SPACE, "effects.more={type='joint_friction', joint='elbow', limit=0.1, speed=1}"),
    (SPACE, "effects.more={type='end_stop', joint='slider', lower=0.0, stiffness=1e3}"),
    (SPACE, MOUNT + "[[1, 0, 0], [0, 1, 0]]}"),
    (SPACE, "outputs.way={type='sliding', joint='slider'}"),
    (PLANE, "outputs.way={type='distance', points=['ground:origin', 'rod:tip']}"),
    (SPACE, "effects.ball={type='point_mass', point='rod:tip', mass=0.1}"),
    (SPACE, "effects.medium={type='structural_damping', mass=1.0}"),
    (SPACE, "effects.simple={type='gyroscopic', keep=false}"),
    (SPACE, "effects={drive={type='prescribed_motion', coordinate='theta', constant_speed={speed=1.0}}}"),
    (SPACE, "outputs.lift={type='deformation', point='rod:tip', axis='z'}"),
    (SPACE, "bodies.rod.regions={core='alloy'}"),
    (PLANE, "bodies.rod.regions={core='steel'}"),
]


@pytest.mark.parametrize(("scene", "override"), FITTING, ids=[f"{e[0]}: {e[1][:50]}" for e in FITTING])
def test_what_fits_is_taken(scene: str, override: str) -> None:
    assert load_scene(ROOT / "scenes" / f"{scene}.toml", [override]).dimension == (3 if scene == SPACE else 2)


@pytest.mark.parametrize("scene", [PLANE, SPACE])
@pytest.mark.parametrize(
    ("overrides", "entry"),
    [
        (["reduction.second_order=true"], "reduction.second_order = true"),
        (["effects.a.type='geometric_stiffening'", "effects.b.type='mode_inertia'"], "effects.a"),
        (["reduction.effects='auto'"], 'reduction.effects = "auto"'),
    ],
)
def test_second_order_is_not_known_of_scaled_cross_sections(scene: str, overrides: list[str], entry: str) -> None:
    loaded = load_scene(ROOT / "scenes" / f"{scene}.toml", overrides)
    check_capabilities(loaded, Purpose.BUILD)
    scaled = load_scene(ROOT / "scenes" / f"{scene}.toml", [*overrides, "bodies.rod.section_scale=1.1"])
    assert refusal(check_capabilities, scaled, Purpose.BUILD) == (
        f"{entry}: not known of scaled cross-sections, of which the third derivative of the strain energy has other "
        "powers of the scale, but there is bodies.rod.section_scale; leave it out"
    )
