"""Scenes of robots, URDF and MJCF: masses and places, the torques that hold them in closed form, and refusals."""

import re
from dataclasses import replace

import numpy as np
import pytest
from runs import one_message, refused, said

from pgmp_petsc.figures.trajectories import loads
from pgmp_petsc.mesh import read_by_library
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import load_scene

G = 9.80665
LIMIT = '<limit lower="-1.5" upper="1.2" effort="10" velocity="2"/>'
MASS = '<mass value="{}"/><inertia ixx="0.001" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.0105"/>'


def link(name: str, mass: float = 0.0, at: str = "0 0 0", turned: str = "0 0 0", more: str = "") -> str:
    inertial = f'<inertial><origin xyz="{at}" rpy="{turned}"/>{MASS.format(mass)}</inertial>' if mass else ""
    return f'<link name="{name}">{inertial}{more}</link>'


def joint(name: str, kind: str, parent: str, child: str, xyz: str, rpy: str, axis: str, limit: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{limit}</joint>'


LINKS = (link("base", 2.0), link("upper", 1.0, "0.2 0 0", "0 0 0.3"), link("fore", 0.5, "0.1 0 0"), link("lift", 0.8))
JOINTS = (
    joint("shoulder", "revolute", "base", "upper", "0 0 0.2", "0 0 0", "0 1 0", LIMIT),
    joint("elbow", "continuous", "upper", "fore", "0.4 0 0", "0 0 0.5", "0 0 1"),
    joint("flange", "fixed", "fore", "tool", "0.2 0 0", "0 0 0", "1 0 0"),
    joint("rail", "prismatic", "base", "lift", "0 1 0", "0 0 0", "0 0 2", LIMIT),
)


def mimic(joint: str, other: str, factor: float = 1.0, offset: float = 0.0) -> str:
    own = f'<mimic joint="{other}" multiplier="{factor}" offset="{offset}"/>'
    return joint.replace("</joint>", f"{own}</joint>")


def urdf(*parts: str) -> str:
    return f'<robot name="arm">{"".join(parts or (*LINKS, link("tool"), *JOINTS))}</robot>'


#: The same robot but for the rail's offset joint: its anchor is not at the body's origin.
MJCF = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="upper" pos="0 0 0.2"><joint name="shoulder" type="hinge" axis="0 1 0" range="-1.5 1.2" limited="true"/>
<inertial pos="0.2 0 0" euler="0 0 0.3" mass="1" diaginertia="0.001 0.01 0.0105"/>
<body name="fore" pos="0.4 0 0" euler="0 0 0.5"><joint name="elbow" type="hinge" axis="0 0 1"/>
<inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.01 0.0105"/></body></body>
<body name="lift" pos="0 1 0.3">
<joint name="rail" type="slide" axis="0 0 1" pos="0 0 -0.3" range="-1.5 1.2" limited="true"/>
<inertial pos="0 0 -0.3" mass="0.8" diaginertia="0.001 0.01 0.0105"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(("name", "text", "library"), [("arm.urdf", urdf(), "yourdfpy"), ("arm.xml", MJCF, "mujoco")])
def test_a_robot_is_held_by_the_torques_of_its_weight(name: str, text: str, library: str, tmp_path) -> None:
    pytest.importorskip(library)
    (tmp_path / name).write_text(text)
    out, _ = said("new", tmp_path / "robot", "--from", tmp_path / name)
    assert "3 of them move" in out and "upper: 1 kg" in out and "--full -o run.h5" in out
    scene = load_scene(tmp_path / "robot.toml")
    upper, fore = (scene.bodies[body] for body in ("upper", "fore"))
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
    known = turn @ np.diag([0.001, 0.01, 0.0105]) @ turn.T
    np.testing.assert_allclose(upper.rigid.tensor(float), known, atol=1e-12)
    np.testing.assert_allclose(fore.placement.origin, (0.4, 0.0, 0.2), atol=1e-12)
    np.testing.assert_allclose(fore.placement.rotation, (0.0, 0.0, 0.5), atol=1e-12)
    assert scene.coordinates["shoulder"].range == (-1.5, 1.2) and scene.coordinates["elbow"].periodic
    assert {one.type for one in scene.joints.values()} == {"revolute", "prismatic"}
    if library == "yourdfpy":
        assert "tool" in fore.rigid.places
    said("simulate", tmp_path / "robot.toml", "--full", "-o", tmp_path / "run.h5")
    outputs = Trajectory.read(tmp_path / "run.h5").outputs
    assert "warning" not in said("check", tmp_path / "robot.toml")[0]  # of the ground's points, say
    gravity = G if library == "yourdfpy" else 9.81  # MuJoCo's
    weight = -gravity * (1.0 * 0.2 + 0.5 * (0.4 + 0.1 * np.cos(0.5)))  # about y
    assert outputs["drive_shoulder"][-1] == pytest.approx(weight, rel=1e-9)
    assert outputs["drive_rail"][-1] == pytest.approx(0.8 * gravity, rel=1e-9)
    assert abs(outputs["drive_elbow"][-1]) < 1e-9


@pytest.fixture
def read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read robots in this process where one rank does: the libraries take half a second to be imported."""

    def made(_program: object, words: tuple, _seconds: float) -> dict[str, np.ndarray] | str:
        found = read_by_library.main(*map(str, words))
        return str(found["refused"]) if "refused" in found else found

    monkeypatch.setattr("pgmp_petsc.studies.new_scene.made_by", made)


SWAPPED = {
    "loop": (urdf(*LINKS, link("tool"), *JOINTS, joint("more", "fixed", "lift", "fore", "0 0 0", "0 0 0", "1 0 0")),
             "the link fore hangs on upper and, by the joint more, on lift: a loop"),
    "ring": (urdf(*LINKS[1:3], JOINTS[1], joint("back", "continuous", "fore", "upper", "0 0 0", "0 0 0", "1 0 0")),
             "every link hangs on another one, in a loop"),
    "apart": (urdf(*LINKS, link("tool"), *JOINTS[:3]), "the links base, lift hang on no other"),
    "mesh": (urdf(LINKS[0], link("upper", 1.0, more='<visual><geometry><mesh filename="package://arm/no.stl"/>'
             "</geometry></visual>"), JOINTS[0]), "the mesh package://arm/no.stl of the link upper is not there"),
    "massless": (urdf(LINKS[0], link("upper"), JOINTS[0]), "upper moves in the joint shoulder and has no mass"),
    "planar": (urdf(*LINKS[:2], JOINTS[0].replace("revolute", "planar")), "the joint shoulder is planar"),
    "limits": (urdf(*LINKS[:2], JOINTS[0].replace('upper="1.2"', 'upper="-2"')), "no limits that are a range"),
    "ring of mimics": (urdf(*LINKS[:3], mimic(JOINTS[0], "elbow"), mimic(JOINTS[1], "shoulder")),
               "the joints shoulder, elbow follow one another in a ring"),
    "mimics": (urdf(*LINKS, mimic(JOINTS[1], "wrist"), JOINTS[0], JOINTS[3]),
               "the joint elbow follows wrist; one that"),
    "no mimic": (urdf(*LINKS[:3], JOINTS[0], mimic(JOINTS[1], "shoulder", 0.0)),
                 "elbow follows shoulder with the factor 0"),
    "lost": (urdf(*LINKS[:2], JOINTS[0].replace("base", "bas")), "the link bas, which is not there"),
    "inertia": (urdf(LINKS[0], link("upper", 1.0).replace("0.0105", "0.2"), JOINTS[0]), "no body has it"),
    "twins": (urdf(*LINKS[:2], link("upper", 2.0), JOINTS[0]), "2 links upper; give each a name of its own"),
    "still": (urdf(*LINKS[:2], joint("weld", "fixed", "base", "upper", "0 0 0", "0 0 0", "1 0 0")),
              "no joint of it moves"),
    "turns": (urdf(LINKS[0], re.sub('(i[xyz]{2})="[0-9.]*"', r'\1="0"', LINKS[1]), JOINTS[0]),
              "the link upper has a mass and no moments of inertia"),
    "xacro": (urdf().replace('name="arm">', 'name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/>'),
              "it has tags of xacro: run xacro first"),
    "xml": (urdf()[:400], "yourdfpy cannot read this file (ParseError"),
}  # fmt: skip


def test_what_is_no_tree_of_bodies_is_refused_in_one_message_on_any_number_of_ranks(
    tmp_path, monkeypatch, read_here
) -> None:
    pytest.importorskip("yourdfpy")
    commands = []
    for name, (text, _) in SWAPPED.items():
        (tmp_path / f"{name}.urdf").write_text(text)
        commands.append(("new", tmp_path / f"{name}_scene", "--from", tmp_path / f"{name}.urdf"))
    for message, (name, (_, words)) in zip(refused(1, commands), SWAPPED.items()):
        assert message.startswith("--from ") and f"{name}.urdf: " in message and words in message, message
    assert not list(tmp_path.glob("*.toml"))
    (tmp_path / "absent").mkdir()
    (tmp_path / "absent" / "yourdfpy.py").write_text("raise ImportError('no such library')")
    (tmp_path / "absent" / "mujoco.py").write_text("raise ImportError('no such library')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "absent"))
    (tmp_path / "arm.xml").write_text(MJCF)
    commands = [("new", tmp_path / "x", "--from", tmp_path / name) for name in ("loop.urdf", "arm.xml")]
    for message, library in zip(refused(2, commands), ("yourdfpy", "mujoco")):
        assert f"pip install {library}" in message
    assert "no such file" in one_message("new", tmp_path / "x", "--from", tmp_path / "none.urdf")


def equal(constraints: str) -> str:
    return MJCF.replace("</worldbody>", f"</worldbody><equality>{constraints}</equality>")


def test_what_mjcf_has_and_a_tree_has_not(tmp_path, read_here) -> None:
    pytest.importorskip("mujoco")
    held = equal('<weld body1="fore" body2="lift"/>')
    bent = equal('<joint joint1="elbow" joint2="shoulder" polycoef="0 1 0.2 0 0"/>')
    both = equal('<joint joint1="elbow" joint2="shoulder"/><joint joint1="elbow" joint2="rail"/>')
    two = MJCF.replace('<inertial pos="0.1', '<joint name="more" type="hinge" axis="1 0 0"/><inertial pos="0.1')
    ball = MJCF.replace('<joint name="elbow" type="hinge" axis="0 0 1"/>', '<joint name="elbow" type="ball"/>')
    known = {"held": (held, "1 equality constraints, of loops or by powers"), "bent": (bent, "by powers among them"),
             "both": (both, "several move the same joint"), "two": (two, "the body fore has 2 joints"),
             "ball": (ball, "the joint elbow is ball")}  # fmt: skip
    for name, (text, words) in known.items():
        (tmp_path / f"{name}.xml").write_text(text)
        assert words in one_message("new", tmp_path / "x", "--from", tmp_path / f"{name}.xml")


def test_what_is_left_out_is_said_and_ranges_count_from_where_the_robot_stands(tmp_path, read_here) -> None:
    mujoco = pytest.importorskip("mujoco")
    text = MJCF.replace("<worldbody>", '<option gravity="0 0 -1.62"/><worldbody>', 1)
    text = text.replace('name="shoulder"', 'name="shoulder" ref="0.5" damping="0.3" stiffness="2" armature="0.1"')
    text = text.replace("</worldbody>", '</worldbody><actuator><motor name="drive" joint="elbow"/></actuator>')
    (tmp_path / "arm.xml").write_text(text)
    out, _ = said("new", tmp_path / "robot", "--from", tmp_path / "arm.xml")
    for words in ("damping (shoulder); add", "stiffness (shoulder)", "armature (shoulder)", "actuator (drive)"):
        assert f"left out      {words}" in out
    scene = load_scene(tmp_path / "robot.toml")
    np.testing.assert_allclose(scene.coordinates["shoulder"].range, (-2.0, 0.7), atol=1e-12)
    said("simulate", tmp_path / "robot.toml", "--full", "-o", tmp_path / "run.h5")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)  # at its reference, at rest: the bias is what holds it
    outputs = Trajectory.read(tmp_path / "run.h5").outputs
    drives = [outputs[f"drive_{name}"][-1] for name in ("shoulder", "elbow", "rail")]
    np.testing.assert_allclose(drives, data.qfrc_bias, rtol=1e-9, atol=1e-9)


def test_what_a_urdf_has_and_a_scene_has_not(tmp_path, read_here) -> None:
    pytest.importorskip("yourdfpy")
    long = LINKS[1].replace("0.2 0 0", "200 0 0")
    damped = JOINTS[0].replace("</joint>", '<dynamics damping="2" friction="0"/></joint>')
    (tmp_path / "arm.urdf").write_text(urdf(LINKS[0], long, damped))
    out, _ = said("new", tmp_path / "robot", "--from", tmp_path / "arm.urdf")
    assert "left out      damping (shoulder); add effects joint_damping" in out and "friction" not in out
    assert "joints and centres span 200 m" in out and "warning: lengths of arm.urdf are taken as m" in out
    # a film of it has no colours, as no body has stresses; a drive of constant speed has one speed
    moves = "effects.hold_shoulder.constant_speed={ speed = 2.0, start = -1.0 }"
    run = tmp_path / "run.h5"
    said("simulate", tmp_path / "robot.toml", "--full", "--override", moves, "-o", run)
    said("animate", run, "--seconds", 0.5, "-o", tmp_path / "film.gif")
    held = Trajectory.read(run)
    figure = loads(held, "torques")
    (curve,) = (line for line in figure.axes[0].lines if len(line.get_xdata()) > 2)
    assert np.ptp(curve.get_xdata()) == 0.0 and curve.get_xdata()[0] == pytest.approx(2.0, rel=1e-12)
    # one that holds its joint but for round-off has none
    noise = 1e-17 * np.random.default_rng(0).normal(size=held.coordinates.shape)
    figure = loads(replace(held, coordinates=noise), "torques")
    (curve,) = (line for line in figure.axes[0].lines if len(line.get_xdata()) > 2)
    assert not np.any(curve.get_xdata())


@pytest.mark.parametrize("library", ["yourdfpy", "mujoco"])
def test_joints_that_follow_others_are_coupled_and_load_their_drives(library: str, tmp_path, read_here) -> None:
    """The elbow as -0.5 of the shoulder and 0.3 rad more: by virtual work the drive carries both moments."""
    pytest.importorskip(library)
    if library == "yourdfpy":
        parts = (LINKS[0], *LINKS[1:3], mimic(JOINTS[1].replace("0 0 1", "0 1 0"), "shoulder", -0.5, 0.3), JOINTS[0])
        (tmp_path / "arm.urdf").write_text(urdf(*parts).replace("0 0 0.5", "0 0 0"))
        source, gravity = "arm.urdf", G
    else:
        own = '<joint joint1="elbow" joint2="shoulder" polycoef="0.3 -0.5 0 0 0"/><weld active="false" body1="fore"/>'
        text = equal(own).replace('type="hinge" axis="0 0 1"', 'type="hinge" axis="0 1 0"').replace("0 0 0.5", "0 0 0")
        (tmp_path / "arm.xml").write_text(text)
        source, gravity = "arm.xml", 9.81
    out, _ = said("new", tmp_path / "robot", "--from", tmp_path / source)
    assert "coupling      elbow = -0.5 shoulder + 0.3" in out
    assert library == "yourdfpy" or "left out      equality (number 2); it is not active" in out
    at = "effects.hold_shoulder.constant_speed={ speed = 0.0, start = 0.4 }"
    said("simulate", tmp_path / "robot.toml", "--full", "--override", at, "-o", tmp_path / "run.h5")
    outputs = Trajectory.read(tmp_path / "run.h5").outputs
    upper, fore = 0.4, 0.4 + 0.3 - 0.5 * 0.4  # rad, about y
    moments = 0.2 * np.cos(upper) + 0.5 * 0.4 * np.cos(upper) + 0.5 * 0.1 * np.cos(fore) * (1.0 - 0.5)
    assert outputs["drive_shoulder"][-1] == pytest.approx(-gravity * moments, rel=1e-8)
    assert "drive_elbow" not in outputs


def test_quarter_turns_leave_no_round_off_in_a_scene(tmp_path, read_here) -> None:
    """Two of them in a row had components of 1e-33 in axes and points, which scenes refuse."""
    pytest.importorskip("yourdfpy")
    quarter = "1.5707963267948966 0 1.5707963267948966"
    parts = (*LINKS[:3], link("tool", 0.1), JOINTS[0], JOINTS[1].replace("0 0 0.5", quarter))
    flange = joint("flange", "fixed", "fore", "tool", "0 0 0.2", quarter, "1 0 0")
    (tmp_path / "arm.urdf").write_text(urdf(*parts, flange))
    said("new", tmp_path / "robot", "--from", tmp_path / "arm.urdf")
    scene = load_scene(tmp_path / "robot.toml")
    assert scene.joints["elbow"].axis == (1.0, 0.0, 0.0)
    assert list(scene.bodies["fore"].rigid.places["flange"]) == [0.0, 0.0, 0.2]


def test_samples_of_a_robot_say_nothing_of_forces_that_are_round_off(tmp_path, read_here) -> None:
    """What holds a hand on a level rail is none beside the shoulder's torque: its errors were more than all of it."""
    pytest.importorskip("yourdfpy")
    rail = joint("rail", "prismatic", "upper", "fore", "0.4 0 0", "0 0 0", "0 1 0", LIMIT)
    (tmp_path / "arm.urdf").write_text(urdf(LINKS[0], *LINKS[1:3], JOINTS[0], rail))
    said("new", tmp_path / "robot", "--from", tmp_path / "arm.urdf")
    mass = 'parameters.m={nominal=0.5, distribution={name="uniform", loc=0.4, scale=0.2}}', 'bodies.fore.rigid.mass="m"'
    overrides = [word for one in mass for word in ("--override", one)]
    most = ("--full", "-n", "5", "--seed", "1", "-o", tmp_path / "many.h5")
    out, errors = said("montecarlo", tmp_path / "robot.toml", *most, *overrides)
    assert "drive_rail is constant" in out and "warning" not in out + errors, out + errors
