"""Effects in files of users: taken, refused, and named in result files; the one of docs/extending.md in every model."""

import json
import re
import sys
import tomllib
from collections.abc import Callable
from functools import reduce
from hashlib import sha256
from html import unescape
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import h5py
import numpy as np
import pytest
import tomli_w
from combinations import _build, _components, _full, meshes_for, scene_of
from conftest import ROOT
from effect_scenes import BASE
from exported import as_one, assert_equal, outputs_of
from handbook_blocks import blocks_of
from refusals import assert_refused
from runs import in_turn, motion, overridden, refused, trajectory

import pgmp_petsc as pgmp
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.plugins import IN_USE, check_plugins
from pgmp_petsc.base.units import UNITS
from pgmp_petsc.c_export.constants import constants_of
from pgmp_petsc.cli.declared import PLUGIN
from pgmp_petsc.declare import ideas
from pgmp_petsc.declare.ideas import FAMILIES
from pgmp_petsc.files.checkpoint_folder import CheckpointFolder
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.bodies import Body
from pgmp_petsc.scene.reference_page import reference_page
from pgmp_petsc.studies.building import choose_effects
from scenes import tables

LISTING, JOINT, CONTROLLER = (
    block.text for block in blocks_of(ROOT / "docs" / "extending.md") if "file" in block.marks
)
OUTPUT = """
from typing import Literal
import numpy as np
from pgmp_petsc.mechanism.statements import Combination, along
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.scene.fields import Direction, Point
from pgmp_petsc.scene.outputs import OutputEntry

class Along(OutputEntry):
    \'\'\'Place of a point along a direction, from the ground's origin (m).\'\'\'

    type: Literal["along"]
    reads, unit = "frames", "m"
    point: Point
    direction: Direction

    def reading(self, name, start, kinematics):
        mechanism = kinematics.mechanism
        sides = mechanism.attachment("ground:origin", name), mechanism.attachment(self.point, name)
        return Reading("MEASURE", sides, along(np.array(self.direction)), space=mechanism.space)
"""
pytestmark = pytest.mark.usefixtures("no_plugins")
TABLE = '{type="line_spring", point="rod:tip", direction=[0.0, 1.0], stiffness=20.0}'


def plugged(folder: Path, *texts: str) -> Path:
    """Use files of these texts; return the first."""
    paths = [folder / f"mine{number or ''}.py" for number in range(len(texts))]
    for path, text in zip(paths, texts):
        path.write_text(text)
        pgmp.use(path)
    return paths[0]


def beams(*overrides: str) -> Scene:
    """Return the slider-crank of `combinations`, of beams."""
    return scene_from_toml(scene_to_toml(scene_of("beams", "nothing")), ".", overrides)


def assert_same_in_c(rom: object, folder: Path, wanted: Trajectory) -> None:
    """Check that the model's program in C runs as the model has."""
    pgmp.export_model(rom, str(folder / "model"))
    assert_equal(outputs_of(as_one(folder / "model", "reduced")), wanted.outputs)


@pytest.fixture
def line_spring(tmp_path: Path) -> Path:
    """The file of docs/extending.md."""
    path = tmp_path / "line_spring.py"
    path.write_text(LISTING)
    return path


MODELS: dict[str, Callable[[Scene], Trajectory]] = {
    "full": lambda scene: trajectory(_full(scene, meshes_for(scene), {})),
    "components": lambda scene: trajectory(_components(scene, meshes_for(scene), {})),
    "reduced": lambda scene: trajectory(ReducedModel(scene, _build(scene, meshes_for(scene), {}))),
}
BY_ANGLE = """
from typing import Literal
import numpy as np
from pgmp_petsc.effects.action import NOTHING, Action
from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.action import joint_measure
from pgmp_petsc.effects.law import Law
from pgmp_petsc.mechanism.statements import following
from pgmp_petsc.scene.effects import EffectEntry
from pgmp_petsc.scene.fields import Direction, Point

LAW = Law("by_angle", ("k",), force="k * s")

class ByAngle(EffectEntry):
    \'\'\'A force that turns with a body, and grows with the angle of a joint.\'\'\'

    type: Literal["by_angle"]
    acts, local, joints = "forces", True, ("turning",)
    joint: str
    point: Point
    direction: Direction

    def forces(self, name, mechanism):
        sides = (mechanism.attachment(one, name) for one in ("ground:origin", self.point))
        lead = Action(name, law=NOTHING, parameters=(), **joint_measure(mechanism, self))
        push = Action(name, following(np.array(self.direction)), *sides, LAW, (Quantity(3.0),), led=True)
        return ActionEffect(name, [lead, push], mechanism)
"""
#: What `Along` and others add to say more of themselves than what they read; an output of another one's multipliers; an
#: output that is twice another one, in its own words.
STATED = """
    def stated(self, name, mechanism):
        sides = (mechanism.attachment(one, name) for one in ("ground:origin", self.point))
        return {"statement": along(np.array(self.direction)), **dict(zip("ab", sides))}
"""
PULL = """
from typing import Literal
from pgmp_petsc.outputs.joint_forces import JointForce
from pgmp_petsc.scene.outputs import OutputEntry

class Pull(OutputEntry):
    \'\'\'How a joint pulls along x.\'\'\'

    type: Literal["pull"]
    reads, unit = "multipliers", "N"
    bearing: str

    def multiplied(self, name, kinematics):
        return JointForce(type="joint_force", joint=self.bearing, component="x").multiplied(name, kinematics)
"""
TWICE = """
from dataclasses import dataclass
from typing import Any, Literal
from pgmp_petsc.outputs.of_outputs import Combined
from pgmp_petsc.scene.outputs import OutputEntry

@dataclass(frozen=True, eq=False)
class Doubled:
    of: Any

    @property
    def needs(self):
        return self.of.needs

    def depth(self, order):
        return self.of.depth(order)

    def jet(self, seen, order):
        return [2.0 * part for part in self.of.jet(seen, order)]

class Twice(OutputEntry):
    \'\'\'Twice another output.\'\'\'

    type: Literal["twice"]
    reads, unit = "outputs", "m"
    of: str

    @property
    def made_of(self):
        return {self.of: "of"}

    def combined(self, name, parts, scene):
        return Doubled(parts[self.of])
"""
EXPRESSED = """
    def expression(self, scene, seen):
        from pgmp_petsc.outputs.of_outputs import FormulaOf

        return FormulaOf("2 * a", (("a", seen(self.of)),), ())
"""
#: An effect whose point is in an entry that no effect of the program has.
HELD = LISTING.replace("    point: Point", "    held: Point").replace("self.point", "self.held")
ALONG = 'outputs.mine={type="along", point="rod:tip", direction=[2.0, 0.0]}'
DOUBLED = 'outputs.mine={type="twice", of="place"}'
AT_TIP = 'point="crank:tip", direction=[0.0, 1.0]'
BY_REFERENCE = 'measures="angle", joint="crank_hinge", reference=0.2'
BY_SPEED = BY_REFERENCE.replace("angle", "speed")
SPEED = 'outputs.speed={type="speed", joint="crank_hinge"}'
MEASURES = 'controllers.x={type="formula", joint="crank_hinge", measures="%s", output="20 * (0.9 - %s)"}'
#: Files, what is beside, an entry of theirs, the program's own that is the same, how far runs with these are off, and
#: what either moves the crank by at least. Without a statement iterations have no slopes by what a controller measures,
#: and leave more. Those of one statement, law and numbers differ by round-off of each value.
WRITINGS = {
    "effect of the page": (
        (LISTING,), ("simulation.initial.theta={position=0.4, velocity=0.0}",),
        'effects.x={type="line_spring", point="rod:tip", direction=[0.6, 0.8], stiffness=20.0, damping=0.5}',
        'effects.x={type="bushing", points=["ground:origin", "rod:tip"], reference=[[0.6, 0.8]], '
        "stiffness=[20.0, 0.0], damping=[0.5, 0.0]}", 1e-12, 1e-5,
    ),
    "effect at an entry of its own name": (
        (HELD,), ("simulation.initial.theta={position=0.4, velocity=0.0}",),
        'effects.x={type="line_spring", held="rod:1", direction=[0.6, 0.8], stiffness=20.0, damping=0.5}',
        'effects.x={type="bushing", points=["ground:origin", "rod:1"], reference=[[0.6, 0.8]], '
        "stiffness=[20.0, 0.0], damping=[0.5, 0.0]}", 1e-12, 1e-5,
    ),
    "controller of the page": (
        (CONTROLLER,), (), f'controllers.x={{type="bang", most=2.0, {BY_REFERENCE}}}',
        f'controllers.x={{type="formula", output="2 * tanh((r - y) / 0.05)", {BY_REFERENCE}}}', 1e-12, 1e-6,
    ),
    "controller of a speed": (
        (CONTROLLER,), (SPEED,), f'controllers.x={{type="bang", most=2.0, {BY_SPEED}}}',
        f'controllers.x={{type="formula", output="2 * tanh((r - y) / 0.05)", {BY_SPEED}}}', 1e-12, 1e-6,
    ),
    "force at a point by an angle": (
        (BY_ANGLE,), ("simulation.initial.theta={position=0.4, velocity=0.0}",),
        f'effects.x={{type="by_angle", joint="crank_hinge", {AT_TIP}}}',
        f'effects.x={{type="force", over="crank_hinge", table=[[-9,-27],[9,27]], follows=true, {AT_TIP}}}', 1e-9, 1e-5,
    ),
    "measure of a statement": (
        (OUTPUT + STATED,), (ALONG,), MEASURES % ("mine", "y"), MEASURES % ("place", "y"), 1e-12, 1e-4),
    "measure of a reading": ((OUTPUT,), (ALONG,), MEASURES % ("mine", "y"), MEASURES % ("place", "y"), 1e-6, 1e-4),
    "measure of another output": (
        (TWICE,), (DOUBLED,), MEASURES % ("mine", "y"), MEASURES % ("place", "2 * y"), 1e-6, 1e-4),
    "measure of an expression": (
        (TWICE + EXPRESSED,), (DOUBLED,), MEASURES % ("mine", "y"), MEASURES % ("place", "2 * y"), 1e-12, 1e-4),
}  # fmt: skip


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", WRITINGS)
def test_two_writings_of_one_force_act_alike(tmp_path: Path, name: str, model: str) -> None:
    texts, beside, theirs, own, share, moved = WRITINGS[name]
    plugged(tmp_path, *texts)
    plugin, wanted, none = (MODELS[model](beams(*beside, *entry)).outputs for entry in ((theirs,), (own,), ()))
    for output, values in wanted.items():
        close = {"rtol": share, "atol": 1e-14} if "page" in name else {"rtol": 0, "atol": share * np.abs(values).max()}
        np.testing.assert_allclose(plugin[output], values, **close, err_msg=output)
    assert np.abs(wanted["angle"] - none["angle"]).max() > moved


def test_points_are_looked_at_whatever_their_entry_is_called(tmp_path: Path) -> None:
    plugged(tmp_path, HELD)
    held = TABLE.replace("point", "held")
    with pytest.raises(InputError, match=r'effects\.x\.held = "ground:eye": there is no such ground point'):
        beams(f"effects.x={held.replace('rod:tip', 'ground:eye')}")
    own = ["ground.points.eye=[0.0, 0.5]", f"effects.x={held.replace('rod:tip', 'ground:eye')}"]
    checked = pgmp.check(ROOT / "scenes" / "slider_crank.toml", overrides=own)
    assert not any("nothing is attached" in remark for remark in map(str, checked.scene.remarks))


@pytest.mark.parametrize(
    ("point", "words"),
    [
        # frames that a body was condensed to are no nodes of its mesh: one of them was taken for the node
        ("rod:1", r'"1": .* those of points that the scene names: hinge, tip; name it in an entry'),
        ("ground:orign", r'"ground:orign": there is no such ground point'),
        ("rdo:1", r"\"rdo:1\": there is no body 'rdo'"),
    ],
)
def test_component_models_refuse_a_point_that_no_entry_names(tmp_path: Path, point: str, words: str) -> None:
    plugged(tmp_path, LISTING.replace("attachment(self.point,", f'attachment("{point}",'))
    assert_refused(rf"effects\.x\.point = {words}", MODELS["components"], beams(f"effects.x={TABLE}"))


def test_a_joint_that_an_entry_of_its_own_names_and_the_scene_has_not_is_named(tmp_path: Path) -> None:
    plugged(tmp_path, PULL)
    pull = 'outputs.pull={type="pull", bearing="crank_hing"}'
    with pytest.raises(InputError, match=r'^joint = "crank_hing": there is no such joint; did you mean'):
        trajectory(_full(beams(pull), meshes_for(beams()), {}))


@pytest.mark.parametrize("model", MODELS)
def test_outputs_are_those_that_they_are_made_of(tmp_path: Path, model: str) -> None:
    plugged(tmp_path, OUTPUT, PULL)
    found = MODELS[model](beams(
        'outputs.along={type="along", point="rod:tip", direction=[1.0, 0.0]}',
        'outputs.pull={type="pull", bearing="crank_hinge"}',
        'outputs.own={type="joint_force", joint="crank_hinge", component="x"}',
        'effects.weight={type="gravity", direction=[0.0, -1.0]}',
    )).outputs  # fmt: skip
    np.testing.assert_allclose(found["along"], found["place"], rtol=1e-14)
    np.testing.assert_array_equal(found["pull"], found["own"])
    assert np.abs(found["own"]).max() > 1e-3


def test_rows_of_an_entry_of_a_plugin_s_own_may_be_in_a_file(tmp_path: Path) -> None:
    field = "direction: Direction\n    worn: LoadTable"
    plugged(tmp_path, OUTPUT.replace("direction: Direction", field).replace("import Dir", "import LoadTable, Dir"))
    (tmp_path / "worn.csv").write_text("0,1\n0.5,3 \n")
    entry = f'point="rod:tip", direction=[1.0, 0.0], worn="{tmp_path / "worn.csv"}"'
    assert beams(f'outputs.mine={{type="along", {entry}}}').outputs["mine"].worn == ((0.0, 1.0), (0.5, 3.0))


def test_a_derivative_that_an_output_does_not_say_is_refused_where_controllers_measure_it(tmp_path: Path) -> None:
    text = OUTPUT.replace("return Reading", "return Rate(Reading").replace("mechanism.space)", "mechanism.space))")
    plugged(tmp_path, text.replace("import Reading", "import Rate, Reading"))
    along = 'outputs.mine={type="along", point="rod:tip", direction=[1.0, 0.0]}'
    MODELS["full"](beams(along))
    acting = 'controllers.x={type="formula", measures="mine", joint="crank_hinge", output="-y"}'
    with pytest.raises(InputError, match=r"line \d+: class Along: it reads a derivative of order 1, and says 0; contr"):
        MODELS["full"](beams(along, acting))


#: A force of its own beside that of `PULL`.
OWN_FORCE = PULL.replace(
    "\nclass Pull",
    """
class Mine:
    def __init__(self, of):
        self.of = of

    def __getattr__(self, name):
        return getattr(self.of, name)

class Pull""",
).replace('return JointForce(type="joint_force", joint=self.bearing, component="x").multiplied(name, kinematics)',
          'return Mine(JointForce(type="joint_force", joint=self.bearing, component="x").multiplied(name, kinematics))',
)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "entry", "words"),
    [
        (TWICE, DOUBLED, r"line \d+: class Doubled: a model in C has no code for it; make outputs"),
        (OWN_FORCE, 'outputs.mine={type="pull", bearing="crank_hinge"}',
         r"line \d+: class Mine: a model in C has no .*; make it of"),
    ],
    ids=("a reading", "a force"),
)  # fmt: skip
def test_what_c_has_no_code_for_is_refused_by_its_class(tmp_path: Path, text: str, entry: str, words: str) -> None:
    plugged(tmp_path, text)
    scene = beams(entry)
    rom = _build(scene, meshes_for(scene), {})
    assert_refused(words, constants_of, ReducedModel(scene, rom), "it")


#: Names of ideas, and of laws, which every file has for itself.
NAMED = re.compile(r'^(    (?:type|shape): Literal\["|    other_half = ")(\w+)', re.MULTILINE)
LAWS = re.compile(r'((?:Law|OfSquare|Acting)\(\s*f?")(\w+)')


@pytest.mark.parametrize(
    ("scene", "more"),
    [
        ("servo_arm", ['effects.rub={type="joint_friction", joint="hinge", coefficient=0.2, radius=0.01, speed=0.1}']),
        ("slider_crank_effects", []),
    ],
)
def test_copies_of_all_ideas_by_other_names_do_the_same(tmp_path: Path, scene: str, more: list[str]) -> None:
    """Nothing outside of an idea's file asks for its name or for its class: the program's own files, copied with other
    names of ideas and laws, act to the last bit as these."""
    names: dict[str, set[str]] = {}
    for family in FAMILIES:
        for path in sorted(ROOT.joinpath(*family.room.split(".")).glob("*.py")):
            text = path.read_text()
            named = {name for _, name in NAMED.findall(text)}
            if named:
                names.setdefault(family.group, set()).update(named)
                copy = tmp_path / f"{family.group}_{path.name}"
                copy.write_text(LAWS.sub(r"\1other_\2", NAMED.sub(r"\1other_\2", text)))
                pgmp.use(copy)
    own = pgmp.load(ROOT / "scenes" / f"{scene}.toml", overrides=["simulation.duration=0.02", *more])
    tables = tomllib.loads(scene_to_toml(own))
    for group in names.keys() & tables.keys():
        for entry in tables[group].values():
            entry["type"] = f"other_{entry['type']}"
    for body in tables["bodies"].values():
        if "shape" in body.get("section", {}):
            body["section"]["shape"] = f"other_{body['section']['shape']}"
    other = scene_from_toml(tomli_w.dumps(tables), own.directory)
    runs = [pgmp.simulate(one, model="full") for one in (own, other)]
    np.testing.assert_equal(runs[1].outputs, runs[0].outputs)


#: A bar of 1 m whose ends slide on the axes x and y, and the joint that its angle is measured in.
TRAMMEL = tables("""
scene: name = "trammel"
parameters.strength: nominal = 1.0
materials.stiff: E = 2.1e13; nu = 0.3; rho = 7850.0
bodies.bar: line = { length = 1.0, elements = 2 }; element = "beam3d"; material = "stiff";
    section = { shape = "circle", radius = 0.02 };
    placement = { origin = [0.8, 0.0, 0.0], rotation = [0.0, 0.0, 2.498091544796509] }
joints.end: type = "point_on_line"; connect = ["ground:origin", "bar:tip"]; direction = [0.0, 1.0, 0.0]
coordinates.theta: joint = "held"; range = [-0.4, 0.6]
effects.motor: type = "torque"; joint = "held"; table = [[0.0, 20.0], [1.0, 20.0]]; scale = "strength"
outputs.angle: type = "angle"; joint = "held"
outputs.place: type = "position"; point = "bar:hinge"; axis = "x"
reduction: modes = 3; angles = 12; interpolation = "spline"
simulation: duration = 0.3; step = 2e-3
""")
PIN = 'joints.held={type="pin_in_slot", connect=["ground:origin", "bar:hinge"], axis=[0, 0, 1], slot=[1, 0, 0]}'
GUIDE = 'joints.guide={type="point_on_line", connect=["ground:origin", "bar:hinge"], direction=[1.0, 0.0, 0.0]}'
#: Joints in which a bar slides and turns in a plane.
SLIDING_AND_TURNING = {
    "pin_in_slot": (PIN,),
    "planar": ('joints.held={type="planar", connect=["ground:origin", "bar:middle"], normal=[0, 0, 1]}', GUIDE),
}


@pytest.mark.parametrize("kind", SLIDING_AND_TURNING)
def test_a_bar_that_slides_and_turns_in_a_plane(tmp_path: Path, kind: str) -> None:
    """Its middle moves on a circle about the origin, so that a torque T turns it by T t^2 / (2 I) with I about its end:
    in every model, its derivatives and C."""
    plugged(tmp_path, JOINT)
    (scene_file := tmp_path / "trammel.toml").write_text(TRAMMEL)
    scene = pgmp.load(scene_file, overrides=SLIDING_AND_TURNING[kind])
    rom = pgmp.build(scene)
    area, second = np.pi * 0.02**2, np.pi * 0.02**4 / 4
    inertia = 7850.0 * (area / 3 + second)
    runs = {
        "reduced": pgmp.simulate(rom),
        "full": pgmp.simulate(scene, model="full"),
        "components": pgmp.simulate(scene, model="components"),
    }
    for model, run in runs.items():
        turned = 0.5 * 20.0 / inertia * run.time**2
        # deformation under the torque and its vibration, and the step's error
        np.testing.assert_allclose(run.outputs["angle"], turned, rtol=0, atol=2e-4 * turned[-1], err_msg=model)
        place = np.cos(np.arctan2(0.6, 0.8) - turned)
        np.testing.assert_allclose(run.outputs["place"], place, rtol=0, atol=2e-4 * turned[-1], err_msg=model)
    slopes = pgmp.sensitivities(rom)
    assert slopes.derivatives["angle"]["strength"][-1] == pytest.approx(turned[-1], rel=2e-4)
    assert_same_in_c(rom, tmp_path, runs["reduced"])


#: A charge in a magnetic field b: a force ``b v`` across the motion of a point, which does no work.
ACROSS = """
from typing import Literal
import numpy as np
from pgmp_petsc.bodies.affine import AffineSum
from pgmp_petsc.effects.action import NOTHING, Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.law import Law
from pgmp_petsc.mechanism.statements import along
from pgmp_petsc.scene.effects import EffectEntry
from pgmp_petsc.scene.fields import Point

LAW = Law("across", ("b",), force="b * rate")

class Across(EffectEntry):
    \'\'\'A force across the motion of a point, in the plane.\'\'\'

    type: Literal["across"]
    acts, local = "forces", True
    point: Point
    field: str

    def forces(self, name, mechanism):
        a, b = (mechanism.attachment(one, name) for one in ("ground:origin", self.point))
        x, y = ({"statement": along(way), "a": a, "b": b} for way in np.eye(2))
        acts = []
        for one, other, sign in ((x, y, 1.0), (y, x, -1.0)):
            field = AffineSum.of(self.field) * sign
            acts.append(Action(name, law=NOTHING, parameters=(), **other))
            acts.append(Action(name, law=LAW, parameters=(field,), led=True, **one))
        return ActionEffect(name, acts, mechanism)
"""


def test_runs_leave_no_more_than_derivatives_show(tmp_path: Path) -> None:
    """Derivatives are of runs that are corrected once more, so that differences of others show what these leave.

    The effect is small: 1e-11 of the size is 1e-4 of the largest derivative of the deformation. Accelerations of the
    undamped beams are far from where a step predicts them, so that factors from there serve badly.
    """
    plugged(tmp_path, ACROSS)
    push, field = "simulation.initial.theta={position=0.6, velocity=8.0}", "parameters.field={nominal=2.0}"
    effect, times = 'effects.x={type="across", point="rod:hinge", field="field"}', "simulation.duration=0.02"
    scene = pgmp.load(ROOT / "scenes/slider_crank.toml", overrides=[push, field, effect, times, "reduction.angles=32"])
    rom = pgmp.build(scene)
    high, low = (pgmp.simulate(rom, parameters={"field": b}).outputs for b in (2.02, 1.98))
    for output, derivatives in pgmp.sensitivities(rom).derivatives.items():
        slopes, difference = derivatives["field"], (high[output] - low[output]) / 0.04
        np.testing.assert_allclose(difference, slopes, rtol=0, atol=1e-5 * np.abs(slopes).max(), err_msg=output)


PARABOLA = """
from typing import Literal
import numpy as np
from pgmp_petsc.mechanism.statements import IDENTITY, Combination, Function, along
from pgmp_petsc.scene.joints import JointEntry

class Parabola(JointEntry):
    '''A slot y = a x^2.'''

    type: Literal["parabola"]
    dimensions = (2,)
    a: float

    def statements(self, in_a, in_b):
        square = Function(-self.a, np.zeros(2), np.array([[0.0, 0.0, 1.0, 0.0]]))
        return [Combination(((along(in_a[:, 1]), IDENTITY), (along(in_a[:, 0]), square)))]
"""


def test_a_point_stays_on_a_curve_in_every_model_and_in_c(tmp_path: Path) -> None:
    """Newton's iteration closes the constraint to round-off in full-order and component runs; a reduced one is off by
    what is of third order in its deformation. The force that guides it is square to the curve, to round-off."""
    plugged(tmp_path, PARABOLA)
    slot = 'joints.slider={type="parabola", connect=["ground:origin", "rod:tip"], a=0.3}'
    across = 'outputs.across={type="position", point="rod:tip", axis="y"}'
    forces = [f'outputs.{x}={{type="joint_force", joint="slider", component="{x}"}}' for x in "xy"]
    more = [slot, across, *forces, "simulation.duration=0.5"]
    scene = pgmp.load(ROOT / "scenes" / "slider_crank.toml", overrides=more)
    rom = pgmp.build(scene)
    runs = {model: pgmp.simulate(scene, model=model) for model in ("full", "components")}
    runs["reduced"] = pgmp.simulate(rom)
    for model, run in runs.items():
        off = run.outputs["across"] - 0.3 * run.outputs["slider_position"] ** 2
        assert np.abs(off).max() < (1e-7 if model == "reduced" else 1e-12), model
        angle, x, y = runs["full"].outputs["crank_angle"], run.outputs["x"], run.outputs["y"]
        np.testing.assert_allclose(run.outputs["crank_angle"], angle, rtol=0, atol=2e-4 * angle[-1], err_msg=model)
        along = -0.6 * run.outputs["slider_position"] * y
        np.testing.assert_allclose(x, along, rtol=0, atol=1e-12 * np.abs(y).max(), err_msg=model)
    assert_same_in_c(rom, tmp_path, runs["reduced"])
    with pytest.raises(InputError, match=r"^joints\.slider\.elastic: this joint has no axes that are the same"):
        springs = "joints.slider.elastic={reference=[[1.0, 0.0]], stiffness=[0.0, 1e5]}"
        pgmp.check(pgmp.load(ROOT / "scenes" / "slider_crank.toml", overrides=[slot, springs]))


SECTION = """
from typing import Annotated, Literal
from pgmp_petsc.bodies.affine import AffineSum
from pgmp_petsc.bodies.sections.section import ShapedSection
from pgmp_petsc.scene.fields import PositiveOrParameter, Unit

class Square(ShapedSection):
    '''A square.'''

    shape: Literal["square"]
    side: Annotated[PositiveOrParameter, Unit("m")]

    def area(self):
        return AffineSum.of(self.side) ** 2

    def inertia(self):
        return (1 / 12 * AffineSum.of(self.side) ** 4,) * 2

    def sheared(self, nu, nominal, spans):
        return (5 / 6 * self.area(),) * 2
"""
#: A change of a file, and what is said of it where a scene names what it declares.
LATER = {
    "an area of a number": (SECTION, ("return AffineSum.of(self.side) ** 2", "return 3.0"), r".*: TypeError: its area"),
    "an area below zero": (
        SECTION, ("return AffineSum.of(self.side)", "return -1 * AffineSum.of(self.side)"), r".* neg",
    ),
    "no inertia": (
        SECTION,
        ("def inertia", "def inertias"),
        r".*mine\.py, line 7: class Square: it needs the method inertia",
    ),
    "a shear of nothing": (
        SECTION, ("return (5 / 6 * self.area(),) * 2", "pass"),
        r".*Square: TypeError: sheared returns two AffineSum, of",
    ),
    "an inertia of one axis": (
        SECTION, (" ** 4,) * 2", " ** 4,)"), r".*Square: TypeError: inertia returns two AffineSum, of the second",
    ),
    "a section that fails": (SECTION, ("(5 / 6", "(5 / 0"), r"plugin '.*', line 20: ZeroDivisionError: .*; repair the"),
    "a reach of a number": (
        SECTION,
        ("def area", "sizes = ('side',)\n\n    @property\n    def reach(self):\n        return 1.0\n\n    def area"),
        r".*mine\.py, line 7: class Square: TypeError: its reach is two quantities",
    ),
    "made of a list": (
        OUTPUT, ("def reading", "@property\n    def made_of(self):\n        return [self.point]\n\n    def reading"),
        r".*mine\.py, line 9: class Along: made_of gives the entry",
    ),
    "what fails": (
        LISTING, ("statement = along", "statement = nothing; along"), r"plugin '.*', line 3\d: NameError: name",
    ),
    "forces of nothing": (
        LISTING,
        ("return ActionEffect", "from pgmp_petsc.effects.effect import Effect; return Effect(name); ActionEffect"),
        r".*: class LineSpring: forces returns an Effect without loads, actions, dampings or a field$",
    ),
    "a load that it does not say": (
        LISTING,
        (
            "import SPRING_DAMPER",
            "import ALONE\nfrom pgmp_petsc.effects.law import Law\n"
            "SPRING_DAMPER = Law('own', ('load', 'k', 'c'), force='-load', loaded=True)",
        ),
        r".*: class LineSpring: 1 of its actions have a law that is loaded; by_load says whether one has$",
    ),
    "no forces": (
        LISTING, ("return ActionEffect", "ActionEffect"), r".*: forces returns an Effect, .* not a NoneType$",
    ),
    "a parameter that is none": (
        LISTING, ("Quantity(0.0))", 'Quantity.of("far"))'),
        r".*: class LineSpring: its law is given the parameter 'far', which the scene has not$",
    ),
    "a direction in space of a law": (
        LISTING,
        (
            "return ActionEffect(name",
            "at = {'statement': along(np.eye(3)[0]), 'a': ground, 'b': point}\n"
            "        return ActionEffect.of_laws(name, mechanism, at, SPRING_DAMPER, (1.0, 0.0, 0.0))\n        (name",
        ),
        r".*mine\.py:3\d: .* directions have 2",
    ),
    "a direction in space": (LISTING, ("np.array(self.direction)", "np.eye(3)[0]"), r".*py:3\d: .* directions have 2"),
    "a controller without a number": (
        CONTROLLER, ('"width": 0.05', '"wide": 0.05'),
        r".*mine\.py, line \d+: class Bang: parameters gives its law bang \(.*\) no number for width; "
        "it gives most, wide$",
    ),
    "a controller with a parameter that is none": (
        CONTROLLER, ('"width": 0.05', '"width": "far"'), r".*: class Bang: its law is given the parameter 'far', which",
    ),
    "a controller of no law": (
        CONTROLLER, ("return LAW", "return LAW.name"), r".*: class Bang: law returns a ControlLaw, and not a str$",
    ),
    "a controller of a speed and no law": (
        CONTROLLER,
        ("return LAW", "return LAW.name\n\n    @property\n    def measured(self):\n        return {'y': 'speed'}"),
        r".*mine\.py, line \d+: class Bang: AttributeError: 'str' object has no attribute 'reads'",
    ),
    "a reading of no kind": (OUTPUT, ('"MEASURE"', '"PLACE"'), r"plugin '.*', line 20: .* and not 'PLACE'; repair"),
    "a reading in space": (OUTPUT, (", space=mechanism.space", ""), r"plugin '.*', line 20: .* 2 numbers in the plane"),
    "a reading of a sum": (
        OUTPUT,
        ("along(np.array(self.direction)),", "Combination((), {}),"),
        r"plugin '.*', line 20: TypeError: a reading is of a Statement, and not a Combination",
    ),
    "a reading of the ground": (
        OUTPUT, ("(self.point,", '("ground:origin",'), r"plugin '.*', line 20: .* fixed to the ground",
    ),
    "a formula that names what it has not": (
        TWICE, ("Doubled(parts[self.of])", "Combined('2 * y', {'x': parts[self.of]}, {})"),
        r".*mine\.py:\d+: Combined: '2 \* y' names 'y', which is not declared; an expression has numbers, x, time, abs",
    ),
    "a formula for controllers that names what it has not": (
        TWICE + EXPRESSED, ('"2 * a"', '"2 * b"'), r".*mine\.py:\d+: FormulaOf: '2 \* b' names 'b', which is not decl",
    ),
    "a formula of a parameter that is none": (
        TWICE, ("Doubled(parts[self.of])", "Combined('2 * y', {}, {'y': 'far'})"),
        r".*: class Twice: it reads the parameter 'far', which the scene has not$",
    ),
    "a reading of other instants": (
        TWICE, ("2.0 * part for part", "part[:0] for part"),
        r".*mine\.py, line 7: class Doubled: jet returns a list of 1 arrays of floats, .*not float64 of shape \(0,\)$",
    ),
    "a reading that ends": (
        TWICE, ("return [2.0 *", "raise SystemExit(0); [2.0 *"), r"plugin '.*', line \d+: SystemExit: 0; repair the file$",
    ),
    "a reading of nothing": (
        TWICE, ("return [2.0 *", "[2.0 *"), r".*, line 7: class Doubled: jet returns .*, and not object of shape \(\)$",
    ),
    "no reading": (
        OUTPUT, ("return Reading", "Reading"), r".*: an output is made of outputs\.readings, .* a NoneType$",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LATER)
def test_what_fails_in_a_scene_is_refused_with_its_line(tmp_path: Path, name: str) -> None:
    text, (before, after), words = LATER[name]
    assert before in text
    # a body made before: a table by itself does not know of later sections
    section = {"shape": "circle", "radius": 1}
    Body(element="beam2d", line={"length": 1.0, "elements": 2}, material="steel", section=section)
    plugged(tmp_path, text.replace(before, after, 1))
    along = 'outputs.e={type="along", point="rod:tip", direction=[1.0, 0.0]}'
    square = 'bodies.crank.section={shape="square", side=0.01}'
    bang = f'controllers.x={{type="bang", most=2.0, {BY_REFERENCE}}}'
    angle = 'outputs.angle={type="angle", joint="crank_hinge"}'
    twice = [angle, 'outputs.e={type="twice", of="angle"}']
    overrides = {OUTPUT: [along], LISTING: [f"effects.e={TABLE}"], SECTION: [square], CONTROLLER: [bang, angle, SPEED]}
    overrides |= {TWICE: twice, TWICE + EXPRESSED: [*twice, MEASURES % ("e", "y")]}
    with pytest.raises(InputError, match=words) as caught:
        pgmp.simulate(pgmp.load(ROOT / "scenes" / "slider_crank.toml", overrides=overrides[text]), model="full")
    assert "mine.py" in str(caught.value)


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("force='-2 * rate if s > at else 0'", "force jumps from .*let what sets in grow from zero"),
        ("force='elastic', potential='(1 if s > at else 0) + s**2'", "potential jumps from .*let its parts meet there"),
    ],
)
def test_a_law_that_jumps_at_an_edge_is_warned_of(tmp_path: Path, what: str, said: str) -> None:
    own = "import ALONE\nfrom pgmp_petsc.effects.law import Law\nSPRING_DAMPER = Law('own', ('k', 'c', 'at'), "
    plugged(tmp_path, LISTING.replace("import SPRING_DAMPER", f"{own}{what}, edges=('s - at',))", 1))
    scene = pgmp.load(ROOT / "scenes" / "slider_crank.toml", overrides=[f"effects.e={TABLE}"])
    (told,) = [str(remark) for remark in pgmp.check(scene).scene.remarks if "jumps" in str(remark)]
    assert re.search(rf"effects\.e: at the edge 's - at' = 0 .*mine\.py:\d+\), s = 0, its {said}", told)


BLOW = """
from typing import Literal
import numpy as np
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.effects.effect import Effect, Load
from pgmp_petsc.scene.effects import EffectEntry

class Blow(EffectEntry):
    'A load.'

    type: Literal["blow"]
    acts = "forces"

    def forces(self, name, mechanism):
        return Loads(name)

class Loads(Effect):
    def loads(self, matrices):
        return [Load(self.name, Monomial(), VECTOR, in_bodies=True)]
"""


@pytest.mark.parametrize(
    ("scene", "vector", "words"),
    [
        ("slider_crank", "np.ones(3)", r"a load has a number for each row of the matrices, \(36,\), and not \(3,\)$"),
        ("slider_crank", "np.ones(36)", "a force that turns with its body is an action"),
        ("spatial_mixed", "np.zeros(len(matrices.rows))", "no loads in space; natural_actions returns them there$"),
    ],
)
def test_loads_that_fit_no_model_are_refused(tmp_path: Path, scene: str, vector: str, words: str) -> None:
    plugged(tmp_path, BLOW.replace("VECTOR", vector))
    with pytest.raises(InputError, match=rf"mine\.py, line 17: class Loads: .*{words}"):
        pgmp.check(ROOT / "scenes" / f"{scene}.toml", overrides=['effects.e={type="blow"}'])


def test_what_fails_in_a_scene_ends_a_command_on_ranks(tmp_path: Path) -> None:
    (scene := tmp_path / "base.toml").write_text(BASE)
    text, (before, after), words = LATER["what fails"]
    (path := tmp_path / "mine.py").write_text(text.replace(before, after, 1))
    alone = "from mpi4py import MPI; 1 // (1 - MPI.COMM_WORLD.rank); return [2.0 *"  # what the last rank's samples ask
    (other := tmp_path / "other.py").write_text(TWICE.replace("return [2.0 *", alone))
    more = overridden("simulation.duration=0.01", 'outputs.mine={type="twice", of="slider_position"}')
    sampled = ["montecarlo", ROOT / "scenes/slider_crank.toml", "--full", "-n", 24, "-o", tmp_path / "many.h5", *more]
    first = ["check", scene, "--override", f"effects.e={TABLE}", "--plugin", path]
    message, of_samples = refused(2, [first, [*sampled, "--plugin", other]])
    assert re.search(words, message)
    assert re.search(r"other\.py', line \d+: ZeroDivisionError: .*; repair the file$", of_samples)


def test_what_it_declares_is_on_the_page_of_entries_and_in_messages(line_spring: Path) -> None:
    pgmp.use(line_spring)
    assert '`[effects.NAME]` with `type = "line_spring"`' in reference_page()
    with pytest.raises(InputError, match=r"^effects\.e\.stiffness = -1\.0: a positive number or the name"):
        scene_from_toml(BASE, ".", [f"effects.e={TABLE.replace('20.0', '-1.0')}"])
    parameter = ['parameters.k={nominal=1.0, unit="kg"}', f"effects.e={TABLE.replace('20.0', chr(34) + 'k' + chr(34))}"]
    assert_refused(r"effects\.e\.stiffness uses it, which needs N/m", scene_from_toml, BASE, ".", parameter)


LAW = 'from pgmp_petsc.effects.law import Law\nlaw = Law("{}", ("k",), force="{}")\n'
NOTHING = """
from typing import Literal
from pgmp_petsc.scene.effects import EffectEntry
class Nothing(EffectEntry):
    type: Literal["nothing"]
    acts = "{}"
"""


def test_a_term_of_the_reduction_is_kept_and_not_judged_by_its_work(tmp_path: Path) -> None:
    plugged(tmp_path, f"{NOTHING.format('reduction')}    second_order = True\n")
    scene = beams("effects.mine={type='nothing'}")
    meshes = meshes_for(scene)
    chosen, sizes = choose_effects(scene, meshes, meshes)
    assert "mine" not in {size.name for size in sizes.sizes}
    assert {"nothing"} == {effect.type for effect in chosen.effects.values() if effect.acts == "reduction"}
    assert chosen.second_order


#: A change of the file (text, in its place), and what is said of it behind the file's name.
BROKEN = {
    "no Python": (("@", "class ("), r"plugin '.*', line 1: this is not Python: invalid syntax$"),
    "null bytes": (("@", "\0"), r"plugin '.*', line 1: this is not Python: source code .* null bytes$"),
    "nothing in it": (("*", "x = 1\n"), r"plugin '.*': no idea is declared in it; needed: a subclass of EffectEntry"),
    "it fails": (("@", "import numpy\nnumpy.nothing\n"), r"plugin '.*', line 2: AttributeError: .*; repair the file$"),
    "it is a part of a package": (
        ("@", "from .parts import PART\n"),
        r"plugin '.*', line 1: ImportError: .*; a file of a package is no plugin by itself: install the pack",
    ),
    "it ends": (("@", "raise SystemExit(3)\n"), r"plugin '.*', line 1: SystemExit: 3; repair the file$"),
    "a name that is taken": (('"line_spring"', '"torque"'), r"line \d+: .* 'torque' already, .*loads\.py, line \d+"),
    "no name": (('Literal["line_spring"]', "str"), r'\.py, line \d+: .* type: Literal\["NAME"\]$'),
    "a maker that takes too little": (
        ("(self, name, mechanism)", "(self, name)"),
        r"line \d+: .*: forces is a method that is called as forces\(self, name, mechanism\)$",
    ),
    "no property": (
        ("*", OUTPUT.replace("def reading", "def is_stated(self):\n        pass\n\n    def reading")),
        r"line \d+: class Along: is_stated is a property: write @property above it$",
    ),
    "a start of no state": (
        ("*", CONTROLLER.replace('("most", "width"), {}', '("most", "width"), {}, starts={"slo": "1"}')),
        r"mine\.py:\d+: controller bang: a start is given for 'slo', which is no state of it; it has none$",
    ),
    "no maker": (("def forces", "def force"), r"\.py, line \d+: .* needs the method forces\(self, name, mechanism\)"),
    "a maker too many": (('acts = "forces"', 'acts = "reduction"'), r'acts = "reduction" has no forces$'),
    "a part of no mechanism": (("*", NOTHING.format("mechanism")), r"line 4: .* is an AddedMass, or a Driving"),
    "a part of no reduction": (("*", NOTHING.format("reduction")), r"line 4: .* says of which: second_order, is_str"),
    "not said what": (('    acts = "forces"\n', ""), r"an effect says what it is: acts = "),
    "an entry that is not": (('"damping")', '"dampng")'), r"there is no entry dampng; its entries: "),
    "no unit": (
        ('Annotated[NotNegativeOrParameter, Unit("N s/m")]', "NotNegativeOrParameter"),
        r"damping may name a parameter, and has no unit: write Annotated",
    ),
    "no SI unit": (('"N s/m"', '"lbf"'), r"damping is in 'lbf', which is no SI unit of a scene; such units: "),
    "no motion of the joint": (("    local", "    joint: str\n    local"), r"joints = \(\"turning\", \"sliding\"\)"),
    "an output without a maker": (("*", OUTPUT.replace("def reading", "def read")), r"an output has the method read"),
    "an output without a unit": (("*", OUTPUT.replace('"m"', '""')), r'an output of frames says its unit: unit = "m"$'),
    "an output in another unit": (("*", OUTPUT.replace('"m"', '"lbf"')), r"unit = 'lbf' is no SI unit: it is 4\.4"),
    "an output of outputs in another unit": (
        ("*", TWICE.replace('"m"', '"lbf"')),
        r"unit = 'lbf' is no SI unit: it is 4\.",
    ),
    "a type that is nowhere": ((": Point =", ": Pnt ="), r"line \d+: .*: an entry has the type Pnt, which is not def"),
    "a type without what it is": (
        ("import Annotated, Literal", "import Annotated"),
        r"line \d+: class LineSpring: its type is Literal\['line_spring'\], which is not defined; import what it",
    ),
    "a law of plain numbers": (("Quantity(0.0)", "0.0"), r"mine\.py:3\d: .* is given 0\.0; a parameter is a Quantity"),
    "an output that reads nothing": (("*", OUTPUT.replace('"frames"', '"none"')), r"an output says what it reads: "),
    "an output of multipliers without a maker": (
        ("*", OUTPUT.replace('"frames"', '"multipliers"')),
        r"line \d+: class Along: an output has the method multiplied\(self, name, kinematics\) if it reads multipliers",
    ),
    "an output of a stress of nothing": (
        ("*", OUTPUT.replace('"frames"', '"stresses"')),
        r"an output that reads stresses has the entries body, .*; missing: body, quantity, at, group, region$",
    ),
    "an output of no joint": (
        ("*", OUTPUT.replace("reads,", 'joints = ("turning",); reads,')),
        r'joints = \("turning",\)$',
    ),
    "a joint that holds numbers": (("*", PARABOLA.replace("Combination(((", "(((")), r"line \d+: .*: statements: "),
    "an output of a joint": (("*", OUTPUT.replace("point: Point", "joint: str")), r'joints = \("turning",\)$'),
    "a law that names what it has not": (("@", LAW.format("own", "-k * z")), r"mine\.py:2: law own: force: .*'z'"),
    "a law without bounds": (("@", LAW.format("own", "-k / s")), r"mine\.py:2: law own: .* not finite at s = 0"),
    "a law of other parameters": (
        (", Quantity(0.0))", ")"),
        r"mine\.py:3\d: effects\.line_spring: law spring_damper .* parameters k, c, rest, and is given 2; give one for",
    ),
    "a potential that is not in the force": (
        ("@", LAW.format("own", "-k * s").replace("force=", "potential='k * s**2 / 2', force=")),
        r"mine\.py:2: law own: elastic is -dV/ds .*, and force '-k \* s' leaves it out, and the potential is 'k",
    ),
    "a force of no potential": (("@", LAW.format("own", "elastic")), r"'elastic' names it, and there is no potential$"),
    "a load of no joint": (('acts = "forces"', 'acts = "forces"; by_load = True'), r"\(by_load\) has the entry joint$"),
    "a load of no parameter": (
        ("@", LAW.format("own", "-s").replace('("k",)', "(), loaded=True")),
        r"mine\.py:2: law own: it is loaded; its first parameter is the force that the joint carries$",
    ),
    "a load that is known in an edge": (
        ("@", LAW.format("own", "-k").replace('("k",)', '("k",), loaded=True, edges=("s - k",)')),
        r"mine\.py:2: law own: edges\[0\]: .*'k'",
    ),
    "a load with an amplitude": (
        ("@", LAW.format("own", "-k - amplitude").replace('("k",)', '("k",), loaded=True')),
        r"mine\.py:2: law own: force: .*'amplitude'",
    ),
    "a law of a taken name": (
        ("@", LAW.format("stop", "-k * s")),
        r"mine\.py:2: the name 'stop' is .*joint_effects\.py",
    ),
    "two laws of one name": (
        ("@", 2 * LAW.format("own", "-k * s") + "other = Law('own', ('k',), force='k')\n"),
        r"mine\.py:4: the name 'own' is taken by .*mine\.py:5; take another one$",
    ),
    "a joint that holds nothing": (("*", JOINT.replace("def statements", "def x")), r"line \d+: .* statements\(self"),
    "a joint of statements that fail": (
        ("*", JOINT.replace("in_a[:, 2]", "in_c")),
        r"line \d+: .* NameError: .*'in_c'",
    ),
    "a joint of other statements": (
        ("*", JOINT.replace("along(in_a[:, 2])", "1")),
        r".*: TypeError: a list of mechanism\.",
    ),
    "a joint of a parameter": (
        ("*", JOINT.replace("slot: Axis", "slot: NumberOrParameter").replace("import Axis", "import *")),
        r"line \d+: .* slot may name a parameter, and what a joint holds has numbers alone: write Annotated",
    ),
    "a joint that is nowhere": (("*", JOINT.replace("(3,)", "(4,)")), r"a joint says where it can be: dimensions = "),
    "a joint of an unknown motion": (
        ("*", JOINT.replace('"turning"', '"rolling"')),
        "free are turning, sliding, spin$",
    ),
    "a joint of a taken name": (
        ("*", JOINT.replace('"pin_in_slot"', '"fixed"')),
        r"'fixed' already, .*of_points\.py, line",
    ),
    "no unit of the strength": (("(EffectEntry)", "(OverTime)"), r'strength_unit = "N m"$'),
}


def changed(name: str) -> str:
    """Return the file with one mistake."""
    (place, text), _ = BROKEN[name]
    if place == "*":
        return text
    if place == "@":
        return text + LISTING
    assert place in LISTING
    return LISTING.replace("import EffectEntry", "import EffectEntry, OverTime").replace(place, text, 1)


@pytest.mark.parametrize("name", BROKEN)
def test_a_plugin_that_is_not_whole_is_refused_and_leaves_nothing(tmp_path: Path, name: str) -> None:
    pgmp.load(ROOT / "scenes" / "slider_crank.toml")
    path, known = tmp_path / "mine.py", [dict(family.classes) for family in FAMILIES]
    path.write_bytes(changed(name).encode())
    with pytest.raises(InputError, match=BROKEN[name][1]) as caught:
        pgmp.use(path)
    assert "mine.py" in str(caught.value) and caught.value.exit_status == 2
    assert [family.classes for family in FAMILIES] == known and not IN_USE


def test_a_file_that_has_changed_is_read_again(line_spring: Path) -> None:
    with pytest.raises(InputError, match=r"^plugin '.*none\.py': No such file or directory; a Python file is needed$"):
        pgmp.use(line_spring.with_name("none.py"))
    for _ in range(2):
        pgmp.use(line_spring)
    changes = {'"line_spring"': '"other_spring"', '"N s/m"': '"N s2/m3"', "[PositiveOrParameter": "[float"}
    line_spring.write_text(reduce(lambda text, one: text.replace(*one), changes.items(), LISTING))
    pgmp.use(line_spring)
    with pytest.raises(InputError, match=r'^effects\.e\.stiffness = "soft": a number is needed$'):
        scene_from_toml(BASE, ".", [f"effects.e={TABLE.replace('line_', 'other_').replace('20.0', repr('soft'))}"])
    (effect,) = scene_from_toml(BASE, ".", [f"effects.e={TABLE.replace('line_', 'other_')}"]).effects.values()
    assert effect.damping == 0.0 and UNITS["N s2/m3"] == (1, -2, 0), "a unit that no entry of the program has"
    assert_refused(r'^effects\.e\.type = "line_spring": unknown', scene_from_toml, BASE, ".", [f"effects.e={TABLE}"])


def test_a_copy_of_a_file_is_that_file(line_spring: Path, tmp_path: Path) -> None:
    (copy := tmp_path / "copy.py").write_text(LISTING)
    for path in (line_spring, copy):
        pgmp.use(path)
    (plugin,) = IN_USE.values()
    assert plugin.path == str(line_spring) and ideas.place_of(ideas.EFFECTS.classes["line_spring"])[0] == line_spring


def test_files_beside_a_plugin_are_no_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But where the path has their folder; then they are given by what imports them."""
    own, other = (tmp_path / f"{name}_of_test.py" for name in ("own", "other"))
    other.write_text(LISTING)
    own.write_text("from other_of_test import LineSpring\n" + LISTING.replace('"line_spring"', '"own"'))
    assert_refused(r"line 1: ModuleNotFoundError: .*; files beside a plugin are no modules: ", pgmp.use, own)
    monkeypatch.syspath_prepend(tmp_path)
    pgmp.use(other)
    assert_refused(r"'line_spring' already, .*other_of_test\.py, line 17; another plugin impor", pgmp.use, own)
    IN_USE.clear()
    for family in FAMILIES:
        family.classes = {name: cls for name, cls in family.classes.items() if cls.__module__.startswith("pgmp_petsc.")}
    for path in (own, other):
        pgmp.use(path)
    assert {plugin.name for plugin in IN_USE.values()} == {"own_of_test.py", "other_of_test"}
    sys.modules.pop("other_of_test")


def test_what_a_plugin_imported_before_it_failed_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules run once in a process: once repaired, the plugin imports them, and they declare nothing again."""
    own, other = (tmp_path / f"{name}_of_repair.py" for name in ("own", "other"))
    other.write_text(LISTING)
    monkeypatch.syspath_prepend(tmp_path)
    repaired = "from other_of_repair import LineSpring\n" + LISTING.replace('"line_spring"', '"own"')
    own.write_text(repaired + "\n1 / 0\n")
    assert_refused("ZeroDivisionError", pgmp.use, own)
    assert "own" not in FAMILIES[0].names
    own.write_text(repaired)
    pgmp.use(own)
    for effect in ("line_spring", "own"):
        scene_from_toml(BASE, ".", [f"effects.x={TABLE.replace('line_spring', effect)}"])
    assert {plugin.name for plugin in IN_USE.values()} == {"own_of_repair.py", "other_of_repair"}
    sys.modules.pop("other_of_repair")


def test_files_name_the_plugins_that_their_scene_needs(line_spring: Path, tmp_path: Path) -> None:
    pgmp.use(line_spring)
    bare, held = (scene_from_toml(BASE, ".", [f"effects.e={TABLE}"] * n) for n in (0, 1))
    paths = [tmp_path / "bare.h5", tmp_path / "held.h5"]
    for path, scene in zip(paths, (bare, held)):
        with h5py.File(path, "w") as file:
            RunRecord(scene_to_toml(scene), {}, None, 1).write(file)
            assert list(json.loads(file.attrs.get("plugins", "{}"))) == ["line_spring.py"] * (scene is held)
            RunRecord.read(file)
    with pytest.raises(InputError, match=r"^'a' was made with the plugin one\.py .*\n'a' was made with the plugin two"):
        check_plugins({"one.py": "0", "two.py": "1"}, "a")
    other = dict(IN_USE)
    IN_USE.clear()
    with h5py.File(paths[0]) as file:
        RunRecord.read(file)
    with (
        h5py.File(paths[1]) as file,
        pytest.raises(InputError, match=r"held\.h5' was made with the plugin line_spring\.py .* --plugin line_spring"),
    ):
        RunRecord.read(file)
    IN_USE.update(other)
    line_spring.write_text(LISTING + "\n")
    pgmp.use(line_spring)
    with (
        h5py.File(paths[1]) as file,
        pytest.raises(InputError, match=r"line_spring\.py is another one .*; give the plugin that it was made with"),
    ):
        RunRecord.read(file)


IN_COMMANDS = (
    "no Python", "nothing in it", "it fails", "a name that is taken", "a joint of a taken name",
    "no maker", "a law that names what it has not",
    "a law without bounds", "a law of other parameters",
)  # fmt: skip


def test_commands_take_plugins_and_end_with_one_message(line_spring: Path, tmp_path: Path) -> None:
    scene = tmp_path / "base.toml"
    scene.write_text(BASE)
    for name in IN_COMMANDS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(changed(name))
    check = ["check", str(scene), "--override", "reduction.modes=2", "--override", f"effects.e={TABLE}"]
    commands = [[*check, "--plugin", str(tmp_path / name / "mine.py")] for name in IN_COMMANDS]
    own, kept = ["--plugin", str(line_spring)], str(tmp_path / "run.h5")
    run = ["simulate", *check[1:], "--override", "simulation.duration=0.01", "--full", "-o", kept]
    page = tmp_path / "page.html"
    commands += [check, [*check, *own], [*run, *own], ["report", kept, "-o", str(page), *own], ["info", kept, *own]]
    statuses, done = in_turn(2, commands)
    assert statuses == [[2] * 2] * (len(IN_COMMANDS) + 1) + [[0] * 2] * 4
    told = unescape(page.read_text())
    assert re.search(r"\.h5 --scene --plugin line_spring\.py > scene", told) and re.search(
        r"pgmp \S+, line_spring\.", told
    )
    assert f"plugin     line_spring.py, SHA-256 {sha256(LISTING.encode()).hexdigest()[:12]}" in done.stdout
    messages = [line for line in done.stderr.splitlines() if line.startswith("pgmp: error: ")]
    for name, message in zip(IN_COMMANDS, messages):
        assert re.search(BROKEN[name][1], message)
    assert len(messages) == len(IN_COMMANDS) + 1 and messages[-1].endswith("if a plugin has it, give --plugin FILE.py")
    assert [family.what for family in FAMILIES if f"{family.what}s" not in PLUGIN] == []


def test_a_run_is_not_resumed_with_another_plugin(line_spring: Path, tmp_path: Path) -> None:
    def folder() -> CheckpointFolder:
        return CheckpointFolder(tmp_path / "out.h5", {"scene": "one"})

    pgmp.use(line_spring)
    begun = folder()
    begun.open(False)
    begun.put("samples-0", {"values": np.zeros(1)})
    assert folder().open(True) == ()
    line_spring.write_text(LISTING + "\n")
    pgmp.use(line_spring)
    assert_refused(r"belongs to another run: its plugins differs; repeat the command as it was", folder().open, True)


def test_installed_packages_have_ideas_behind_entry_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = {"spring": "mine_of_test", "broken": "not_there_of_test"}
    (tmp_path / "mine_of_test.py").write_text(LISTING)
    monkeypatch.syspath_prepend(tmp_path)

    def named(name: str, group: str) -> None:
        found = EntryPoint(name, points[name], f"pgmp.{group}")
        monkeypatch.setattr(ideas, "entry_points", lambda: EntryPoints([found]))
        ideas._load_installed.cache_clear()

    named("broken", "effects")
    told = (
        r"^pgmp\.effects: 'broken' of the installed package not_there_of_test cannot be imported: ModuleNotFoundError"
    )
    assert_refused(told, ideas.EFFECTS.found)
    named("spring", "outputs")  # whichever group it is, all ideas of its modules are there
    assert "line_spring" in ideas.EFFECTS.names
    assert IN_USE["effects", "line_spring"].name == "mine_of_test"
    sys.modules.pop("mine_of_test")
    (needed,) = ({plugin.name: plugin.sha256} for plugin in IN_USE.values())
    IN_USE.clear()
    with pytest.raises(InputError, match=r"the plugin mine_of_test .* which is not in use; install its package, or"):
        check_plugins(needed, "a.h5")
    (about := tmp_path / "mine_of_test-1.0.dist-info").mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine_of_test\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[pgmp.effects]\nspring = mine_of_test\n")
    with h5py.File(tmp_path / "a.h5", "w") as file:  # before any scene is read, as `pgmp info` and reports do
        RunRecord("", {}, None, 1, plugins=needed).write(file)
        assert RunRecord.read(file).plugins == needed
    check_plugins({"line_spring.py": next(iter(needed.values()))}, "a.h5")  # of a file that was the same
    (tmp_path / "mine_of_test.py").write_text(LISTING + "\n")
    assert_refused(r"the plugin mine_of_test .* which is not in use", check_plugins, needed, "a.h5")


@pytest.mark.parametrize(("units", "inertia"), [("SI", 1.0), ("mm", 1e3)])
def test_numbers_in_the_law_of_a_controller_are_in_the_units_of_the_scene(
    tmp_path: Path, units: str, inertia: float
) -> None:
    """A moment of 0.3 N m on 1 kg m2, or of 0.3 N mm on as many t mm2: in SI units a thousandth of it."""
    plugged(tmp_path, CONTROLLER.replace("most * tanh((r - y) / width)", "0.3 * tanh((r - y) / width)"))
    text = f"""scene: name = "wheel"; units = "{units}"
bodies.wheel: rigid = {{ mass = 1.0, inertia = {inertia}, points = {{ c = [0.0, 0.0] }} }}
joints.axle: type = "revolute"; connect = ["ground:origin", "wheel:c"]
coordinates.theta: joint = "axle"; range = [-6.0, 6.0]
controllers.push: type = "bang"; measures = "theta"; joint = "axle"; reference = 1e3; most = 1.0
simulation: duration = 1.0; step = 0.01
outputs.theta: type = "angle"; joint = "axle"
"""
    moment = 0.3 if units == "SI" else 0.3e-3
    found = motion("full", scene_from_toml(tables(text), "."))
    np.testing.assert_allclose(found.outputs["theta"][-1], 0.5 * moment, rtol=1e-9)  # a parabola, which steps follow
