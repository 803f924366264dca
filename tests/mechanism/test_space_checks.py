"""What a scene may not say of continuum bodies, and of the plane in space and of space in the plane."""

from __future__ import annotations

import pytest
from conftest import ROOT

from pgmp_petsc.declare.ideas import JOINTS
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import load_scene


def kinds_with(motion: str, dimension: int) -> list[str]:
    """Return the joints that leave a motion free."""
    return [n for n, kind in zip(JOINTS.names, JOINTS.found()) if dimension in kind.dimensions and motion in kind.motions]


BEAMS, PLANE, SPACE = "slider_crank", "slider_crank_solid2d", "slider_crank_solid3d"
IN_SPACE = "for mechanisms in space (allowed in the plane: fixed, point_on_line, revolute)"
TRIPLE = "three finite numbers in brackets are needed, such as [0.0, 0.0, 1.0]"
MOUNT = "effects.mount={type='bushing', points=['crank:tip', 'rod:tip'], stiffness=[1, 1, 1], reference="
GUIDE = "joints.elbow={type='cylindrical', connect=['crank:tip', 'rod:hinge'], axis=[0, 0, 1]}"
SPRINGY = "effects.more={type='spring_damper', joint='elbow', stiffness=1.0"
FRAME = "two axes of three numbers, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] for example, is needed in space"
CIRCLE = '{ shape = "circle", radius = 0.01 }'

# A scene of the repository, one override of it, and the one line that it is answered with.
ENTRIES = [
    # beams are no continuum
    (BEAMS, "bodies.crank.thickness=0.01", "bodies.crank.thickness = 0.01: for solid2d and solid3d only"),
    (
        BEAMS,
        "bodies.crank.regions={core='steel'}",
        'bodies.crank.regions = { core = "steel" }: for solid2d and solid3d only',
    ),
    (BEAMS, "bodies.crank.section_scale=1.1", "bodies.crank.section_scale = 1.1: for solid2d and solid3d only"),
    *[
        (
            BEAMS,
            f"bodies.crank.element='{element}'",
            (
                'bodies.crank.section = { shape = "circle", radius = "r1" }: '
                f"{element} takes its shape from a mesh; section is for beam{element[-2:]}"
            ),
        )
        for element in ("solid2d", "solid3d")
    ],
    # continuum bodies are no beams
    *[
        entry
        for scene, element in ((PLANE, "solid2d"), (SPACE, "solid3d"))
        for entry in (
            (
                scene,
                "bodies.crank.section={shape='circle', radius=0.01}",
                (
                    f"bodies.crank.section = {CIRCLE}: "
                    f"{element} takes its shape from a mesh; section is for beam{element[-2:]}"
                ),
            ),
            (
                scene,
                f"bodies.crank={{line={{length=0.3, elements=4}}, element='{element}', material='steel'}}",
                (
                    "bodies.crank.line = { length = 0.3, elements = 4 }: "
                    f"{element} takes its shape from a mesh; line is for beam{element[-2:]}"
                ),
            ),
            (
                scene,
                "bodies.crank.line={length=0.3, elements=4}",
                (
                    "bodies.crank.line = { length = 0.3, elements = 4 }: exactly one of mesh, line, matrices is "
                    "needed; mesh and line are given"
                ),
            ),
            (
                scene,
                f"bodies.crank={{mesh='a.msh', element='{element}', thickness=0.01}}",
                "bodies.crank.material: missing; needed: name of a material",
            ),
            (
                scene,
                "bodies.rod.material='stel'",
                "bodies.rod.material = \"stel\": there is no such material; did you mean 'steel'?",
            ),
            (
                scene,
                "bodies.rod.regions={core='stel'}",
                "bodies.rod.regions.core = \"stel\": there is no such material; did you mean 'steel'?",
            ),
            (scene, "bodies.rod.regions={core=3}", "bodies.rod.regions.core = 3: text in quotes is needed"),
        )
    ],
    (
        PLANE,
        "bodies.rod={mesh='a.msh', element='solid2d', material='steel'}",
        "bodies.rod.thickness: missing; needed: thickness of the body (m), a number or a parameter's name",
    ),
    (
        PLANE,
        "bodies.rod.thickness=0",
        "bodies.rod.thickness = 0: a positive number or the name of a parameter is needed",
    ),
    (PLANE, "bodies.rod.thickness='t2'", 'bodies.rod.thickness = "t2": there is no such parameter; known: t1'),
    (
        PLANE,
        "parameters.t1={nominal=-1}",
        "parameters.t1.nominal = -1.0: must be positive, because bodies.crank.thickness uses it",
    ),
    (
        SPACE,
        "bodies.rod.thickness=0.01",
        "bodies.rod.thickness = 0.01: for solid2d only; a solid3d body has its thickness from its mesh",
    ),
    # scaled sections
    (
        SPACE,
        "bodies.rod={mesh='a.msh', element='solid3d', material='steel', section_scale=1.1, flexible=false}",
        "bodies.rod.section_scale = 1.1: for flexible bodies; the inertia of a rigid one would not be affine in it",
    ),
    (
        PLANE,
        "bodies.rod.section_scale=-1.0",
        "bodies.rod.section_scale = -1.0: a positive number or the name of a parameter is needed",
    ),
    (PLANE, "bodies.rod.section_scale='s'", 'bodies.rod.section_scale = "s": there is no such parameter; known: t1'),
    # bodies of one kind
    (
        SPACE,
        "bodies.rod={mesh='a.msh', element='solid2d', material='steel', thickness=0.01}",
        'bodies.rod.element = "solid2d": in the plane, but crank (solid3d) in space; '
        'all bodies are beam2d and solid2d, or beam3d and solid3d',
    ),
    (
        SPACE,
        "bodies.crank={mesh='a.msh', element='beam2d', material='steel', section={shape='circle', radius=0.005}}",
        'bodies.crank.element = "beam2d": in the plane, but rod (solid3d) in space; '
        'all bodies are beam2d and solid2d, or beam3d and solid3d',
    ),
    # joints: the plane's
    *[
        (BEAMS, f"joints.slider={{type='{kind}', connect=['ground:origin', 'rod:tip']{axes}}}",
         f'joints.slider.type = "{kind}": {IN_SPACE}')
        for kind, axes in {
            "spherical": "",
            "universal": ", axis=[1, 0, 0], second_axis=[0, 1, 0]",
            "cylindrical": ", axis=[1, 0, 0]",
            "prismatic": ", axis=[1, 0, 0]",
            "point_on_plane": ", normal=[1, 0, 0]",
        }.items()
    ],
    *[
        (
            scene,
            "joints.elbow.axis=[0, 0, 1]",
            "joints.elbow.axis = [0.0, 0.0, 1.0]: for mechanisms in space; in the plane the axis is z",
        )
        for scene in (BEAMS, PLANE)
    ],
    (BEAMS, "joints.elbow.axis=[0, 1]", f"joints.elbow.axis = [0, 1]: {TRIPLE}"),
    # joints: those of space
    (
        SPACE,
        "joints.elbow={type='revolute', connect=['crank:tip', 'rod:hinge']}",
        "joints.elbow.axis: missing; needed in space: axis (x, y, z) of the rotation",
    ),
    (SPACE, "joints.elbow.axis=[0, 1]", f"joints.elbow.axis = [0, 1]: {TRIPLE}"),
    (SPACE, "joints.elbow.axis='z'", f'joints.elbow.axis = "z": {TRIPLE}'),
    (
        SPACE,
        "joints.elbow.axis=[0, 0, 0]",
        "joints.elbow.axis = [0, 0, 0]: a direction other than [0, 0, 0] is needed",
    ),
    *[
        (
            SPACE,
            f"joints.elbow={{type='{kind}', connect=['crank:tip', 'rod:hinge']}}",
            "joints.elbow.axis: missing; needed: axis (x, y, z) in the frame of the first point's owner",
        )
        for kind in ("cylindrical", "prismatic")
    ],
    (
        SPACE,
        "joints.slider={type='point_on_plane', connect=['ground:origin', 'rod:tip']}",
        "joints.slider.normal: missing; needed: normal (x, y, z) of the plane, fixed to the owner of the first point",
    ),
    (
        SPACE,
        "joints.slider={type='point_on_plane', connect=['ground:origin', 'rod:tip'], normal=[0, 1]}",
        f"joints.slider.normal = [0, 1]: {TRIPLE}",
    ),
    (
        SPACE,
        "joints.elbow={type='universal', connect=['crank:tip', 'rod:hinge'], axis=[0, 0, 1]}",
        (
            "joints.elbow.second_axis: missing; needed: axis fixed in the second body; in the frame of the first one, "
            "as assembled"
        ),
    ),
    (
        SPACE,
        "joints.elbow={type='universal', connect=['crank:tip', 'rod:hinge'], axis=[1, 2, 3], second_axis=[-2, -4, -6]}",
        (
            "joints.elbow.second_axis = [-2, -4, -6]: must not have the direction of axis; both axes are at a right "
            "angle"
        ),
    ),
    (
        SPACE,
        "joints.slider={type='spherical', connect=['ground:origin', 'rod:tip'], axis=[0, 0, 1]}",
        "joints.slider.axis = [0, 0, 1]: unknown key (allowed: connect, type)",
    ),
    (
        SPACE,
        "joints.elbow.type='hinge'",
        f'joints.elbow.type = "hinge": unknown (allowed: {", ".join(JOINTS.names)})',
    ),
    (
        SPACE,
        "coordinates.theta.joint='slider'",
        (
            f'coordinates.theta.joint = "slider": a {" or ".join(kinds_with("turning", 3))} joint is needed, this one is '
            "a point_on_line (allowed: crank_hinge, elbow)"
        ),
    ),
    # numbers of components
    *[
        (BEAMS, f"{entry}=[1, 2, 3]", f"{entry} = [1.0, 2.0, 3.0]: two numbers (x, y) are needed in the plane")
        for entry in ("ground.points.a", "joints.slider.direction")
    ],
    *[
        (SPACE, f"{entry}=[1, 2]", f"{entry} = [1.0, 2.0]: three numbers (x, y, z) are needed in space")
        for entry in ("ground.points.a", "joints.slider.direction")
    ],
    (
        BEAMS,
        "bodies.crank.placement={origin=[1, 2, 3]}",
        "bodies.crank.placement.origin = [1.0, 2.0, 3.0]: two numbers (x, y) are needed in the plane",
    ),
    (
        SPACE,
        "bodies.crank.placement={origin=[1, 2]}",
        "bodies.crank.placement.origin = [1.0, 2.0]: three numbers (x, y, z) are needed in space",
    ),
    (
        SPACE,
        "bodies.crank.placement={origin=[1, 2, 3, 4]}",
        (
            "bodies.crank.placement.origin = [1, 2, 3, 4]: two finite numbers in brackets (three in space) are needed, "
            "such as [0.0, 1.0]"
        ),
    ),
    (
        BEAMS,
        "effects.weight={type='gravity', direction=[0, -1, 0]}",
        "effects.weight.direction = [0.0, -1.0, 0.0]: two numbers (x, y) are needed in the plane",
    ),
    (
        BEAMS,
        "effects.push={type='force', point='rod:tip', direction=[0, -1, 0], table=[[0, 1]]}",
        "effects.push.direction = [0.0, -1.0, 0.0]: two numbers (x, y) are needed in the plane",
    ),
    (
        SPACE,
        "effects.weight={type='gravity', direction=[0, -1]}",
        "effects.weight.direction = [0.0, -1.0]: three numbers (x, y, z) are needed in space",
    ),
    (
        SPACE,
        "effects.push={type='force', point='rod:tip', direction=[0, -1], table=[[0, 1]]}",
        "effects.push.direction = [0.0, -1.0]: three numbers (x, y, z) are needed in space",
    ),
    (
        SPACE,
        "effects.weight={type='gravity', direction=[0, 0, 0]}",
        "effects.weight.direction = [0, 0, 0]: a direction other than [0, 0, 0] is needed",
    ),
    # placements
    (
        BEAMS,
        "bodies.crank.placement={rotation=[0, 0, 1]}",
        "bodies.crank.placement.rotation = [0.0, 0.0, 1.0]: for mechanisms in space; give angle",
    ),
    (
        SPACE,
        "bodies.crank.placement={angle=0.3}",
        "bodies.crank.placement.angle = 0.3: for the plane; give rotation",
    ),
    (SPACE, "bodies.crank.placement={rotation=0.3}", f"bodies.crank.placement.rotation = 0.3: {TRIPLE}"),
    # effects
    (
        SPACE,
        "effects.weight={type='gravity'}",
        "effects.weight.direction: missing; needed in space: direction (x, y, z)",
    ),
    (
        SPACE,
        "effects.push={type='force', point='rod:tip', table=[[0, 1]], direction=[0, -1], follows=true}",
        "effects.push.direction = [0.0, -1.0]: three numbers (x, y, z) are needed in space",
    ),
    # bushings
    (
        SPACE,
        "effects.mount={type='bushing', points=['crank:tip', 'rod:tip'], stiffness=[1, 1, 1]}",
        (
            "effects.mount.reference: missing; needed: first axis, and in space a second one, of the frame in which it "
            "is stiff, in the frame of the first point's owner; their lengths do not matter"
        ),
    ),
    (SPACE, MOUNT + "[[1, 0, 0]]}", f"effects.mount.reference = [[1.0, 0.0, 0.0]]: {FRAME}"),
    (SPACE, MOUNT + "[[1, 0], [0, 1]]}", f"effects.mount.reference = [[1.0, 0.0], [0.0, 1.0]]: {FRAME}"),
    (
        SPACE,
        MOUNT + "[[1, 0, 2], [2, 0, 4]]}",
        (
            "effects.mount.reference = [[1.0, 0.0, 2.0], [2.0, 0.0, 4.0]]: the axes must not be parallel; the second "
            "one is at a right angle"
        ),
    ),
    (
        SPACE,
        MOUNT + "[[1, 0, 0], [0, 0, 0]]}",
        "effects.mount.reference[1] = [0, 0, 0]: a direction other than [0, 0, 0] is needed",
    ),
    (
        SPACE,
        MOUNT + "[[1, 0, 0], [0, 1, 0]], turning_stiffness=[1.0]}",
        "effects.mount.turning_stiffness = [1.0]: 3 numbers, one for each axis, are needed in space",
    ),
    (
        SPACE,
        "effects.mount={type='bushing', points=['crank:tip', 'rod:tip'], reference=[[1, 0, 0], [0, 1, 0]]}",
        (
            'effects.mount = { type = "bushing", points = ["crank:tip", "rod:tip"], r ...: at least one of stiffness, '
            "damping, turning_stiffness, turning_damping must be above zero"
        ),
    ),
    (
        BEAMS,
        MOUNT + "[[1, 0, 0], [0, 1, 0]]}",
        (
            "effects.mount.reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]: one axis, [[1.0, 0.0]] for example, is "
            "needed in the plane\n"
            "effects.mount.stiffness = [1.0, 1.0, 1.0]: 2 numbers, one for each axis, are needed in the plane"
        ),
    ),
    # joints that an effect may be on
    (
        SPACE,
        "effects.more={type='joint_damping', joint='slider', coefficient=1.0, motion='sliding'}",
        'effects.more.motion = "sliding": for cylindrical joints; others have one motion; leave it out',
    ),
    # outputs
    (
        SPACE,
        "outputs.tilt={type='rotation', point='rod:tip'}",
        'outputs.tilt.type = "rotation": a rotation in space is no single number; take the angle of a joint',
    ),
    (BEAMS, "outputs.slider_position.axis='z'", 'outputs.slider_position.axis = "z": x or y is needed in the plane'),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "override", "message"), ENTRIES, ids=[f"{e[0]}: {e[1][:50]}" for e in ENTRIES])
def test_a_wrong_entry_is_explained(scene: str, override: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scene(ROOT / "scenes" / f"{scene}.toml", [override])
    assert str(caught.value) == message
    assert caught.value.exit_status == 2


def test_an_effect_on_a_cylindrical_joint_says_on_which_of_its_motions() -> None:
    scene = ROOT / "scenes" / f"{SPACE}.toml"
    with pytest.raises(InputError) as caught:
        load_scene(scene, [GUIDE, SPRINGY + "}"])
    assert str(caught.value) == ('effects.more.motion: missing; elbow is cylindrical: "turning" or "sliding" is needed')
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
    with pytest.raises(InputError) as caught:
        check_capabilities(scaled, Purpose.BUILD)
    assert str(caught.value) == (
        f"{entry}: not known of scaled cross-sections, of which the third derivative of the strain energy has other "
        "powers of the scale, but there is bodies.rod.section_scale; leave it out"
    )
