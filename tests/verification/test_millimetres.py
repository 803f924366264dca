"""A scene in SI units and in mm, t and s: bit for bit the same scene once it is read, and the same files up to units.

Numbers that are written in mm are rounded there, which is all that differs.
"""

import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np
import pytest
from conftest import ROOT
from coupled_scenes import GEARED
from exported import as_one, assert_equal, assert_same_in_c, needs_compiler, outputs_of
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text
from millimetres import differences, flat, in_millimetres, strange, with_short_numbers
from offset_scenes import CLAMPED
from refusals import assert_refused
from runs import one_message, pgmp, reduced_model
from sealed import resealed

from pgmp_petsc.api.files import read
from pgmp_petsc.api.modes import build as pgmp_build
from pgmp_petsc.api.runs import simulate
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import MM, STANDARD_GRAVITY, measure
from pgmp_petsc.c_export import fmu
from pgmp_petsc.reduction import tables as tables_of_reduction
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.units import own_values
from scenes import HEADER, tables

EXACT = 1e-12  # numbers that are converted: 3e-16 but for differences of such
FOUR_BAR = tables("""
scene: name = "four_bar"
ground.points: pivot = [0.412, -0.003]; post = [0.2, 0.5]
parameters.k: nominal = 2000.0; unit = "N/m"; distribution = { name = "norm", loc = 2000.0, scale = 200.0 }
parameters.thick: nominal = 8.0; unit = "mm"; distribution = { name = "norm", loc = 8.0, scale = 0.3 };
    bounds = [6.0, 10.0]
materials.alu: E = 70e9; nu = 0.33; rho = 2700.0
bodies.crank: line = { length = 0.1013, elements = 1 }; element = "beam2d"; material = "alu"; flexible = false;
    section = { shape = "circle", radius = 0.01 }
bodies.coupler: line = { length = 0.3982, elements = 4 }; element = "beam2d"; material = "alu";
    section = { shape = "rectangle", width = 0.02, height = "thick" };
    placement = { origin = [0.1013, 0.0], angle = 0.7 }
bodies.rocker: line = { length = 0.2497, elements = 4 }; element = "beam2d"; material = "alu";
    section = { shape = "rectangle", width = 0.02, height = "thick" };
    placement = { origin = [0.412, -0.003], angle = 1.6 }
joints: motor = { type = "revolute", connect = ["ground:origin", "crank:hinge"] };
    a = { type = "revolute", connect = ["crank:tip", "coupler:hinge"] };
    b = { type = "revolute", connect = ["coupler:tip", "rocker:tip"] };
    c = { type = "revolute", connect = ["ground:pivot", "rocker:hinge"] }
coordinates.theta: joint = "motor"; range = [0.0, 6.283185307179586]; periodic = true
effects.drive: type = "torque"; joint = "motor"; table = [[0.0, 0.0], [0.01, 0.3], [0.025, 0.1]]
effects.mount: type = "spring_damper"; points = ["ground:post", "rocker:tip"]; stiffness = "k"; damping = 5.0;
    rest = 0.25
effects.weight: type = "gravity"
effects.damping: type = "structural_damping"; stiffness = 1e-4
initial: equilibrium = true
reduction: modes = 5; static_modes = true; angles = 16; max_angles = 16; interpolation = "spline"
simulation: duration = 0.025; step = 5e-4; frames = 5
outputs: turned = { type = "angle", joint = "c" };
    bend = { type = "deformation", point = "rocker:tip", axis = "y", frame = "body" };
    stress = { type = "stress", body = "rocker", quantity = "stress_max" }
ensemble.probabilities.yielding: output = "stress"; above = 12e6; when = "ever"
""")
#: A cart on a rail with a pole of its own: two coordinates, of which one slides, with all that acts on them.
CART = HEADER + tables("""
parameters.drag: nominal = 0.4; unit = "N s/m"; distribution = { name = "uniform", loc = 0.3, scale = 0.2 }
bodies.cart.rigid: mass = 3.9; centre = [0.1, 0.0]; inertia = 0.0138; points = { hinge = [0.0, 0.0] }
bodies.pole: line = { length = 0.5, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.02 }
joints.rail: type = "prismatic"; connect = ["ground:origin", "cart:hinge"]; axis = [1.0, 0.0]
joints.pivot: type = "revolute"; connect = ["cart:hinge", "pole:hinge"]
coordinates.x: joint = "rail"; range = [-0.5, 0.5]
coordinates.swing: joint = "pivot"; range = [-3.4, 0.3]
effects.weight: type = "gravity"
effects.base: type = "base_motion"; direction = [1.0, 0.0]; of = "velocity"; table = [[0.0, 0.0], [0.02, 0.1]]
effects.motor: type = "torque"; joint = "pivot"; over = "rail"; table = [[-0.5, 0.3], [0.3, 0.0]]
effects.push: type = "force"; joint = "rail"; harmonic = { amplitude = 8.0, frequency_hz = 20.0, mean = 1.0 }
effects.rub: type = "joint_friction"; joint = "rail"; limit = 0.1; speed = 0.1
effects.drag: type = "joint_damping"; joint = "rail"; coefficient = "drag"
effects.stop: type = "end_stop"; joint = "rail"; lower = -0.1; upper = 2e-4; stiffness = 1e4; damping = 5.0
effects.tool: type = "point_mass"; point = "pole:tip"; mass = 0.1; inertia = 1e-5
reduction: modes = 2; angles = 6; static_modes = true
simulation: duration = 0.02; step = 2e-4; frames = 3
simulation.initial: x = { velocity = 0.02 }; swing = { position = -0.3 }
outputs.x: type = "sliding"; joint = "rail"
outputs.v: type = "speed"; joint = "rail"
outputs.swing: type = "angle"; joint = "pivot"
outputs.place: type = "position"; point = "pole:tip"; axis = "y"
outputs.apart: type = "distance"; points = ["ground:origin", "pole:tip"]
outputs.bent: type = "deformation"; point = "pole:tip"; axis = "y"; frame = "body"
outputs.moment: type = "stress"; body = "pole"; quantity = "bending_moment"; at = [0.1, 0.0]
effects.cogging: type = "law"; joint = "pivot"; force = "A * sin(12 * s) - c * v * (t > 0.005)";
    constants = { A = "0.2 N m", c = "0.01 N m s/rad" }
effects.pull: type = "law"; points = ["ground:origin", "pole:tip"]; force = "-k * (s - l)";
    constants = { k = "3 N/m", l = "500 mm" }
""")
#: A shaft in bearings that give way, with a disc, in space.
ROTOR = HEADER + tables("""
ground.points: right = [0.8, 0.0, 0.0]
parameters.k: nominal = 3e6; unit = "N/m"; distribution = { name = "uniform", loc = 2.5e6, scale = 1e6 }
bodies.shaft: line = { length = 0.8, elements = 4 }; element = "beam3d"; material = "steel";
    orientation = [0.0, 1.0, 0.0]; section = { shape = "rectangle", width = 0.02, height = 0.016 }
bodies.disc.rigid: mass = 3.0; centre = [0.0, 1e-3, 0.0]; inertia = [0.02, 0.01, 0.01, 0.0, 1e-4, 0.0];
    points = { hub = [0.0, 0.0, 0.0] }
bodies.disc.placement: origin = [0.8, 0.0, 0.0]
joints.left: type = "revolute"; connect = ["ground:origin", "shaft:hinge"]; axis = [1.0, 0.0, 0.0]
joints.left.elastic: reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    stiffness = [inf, "k", 2e6]; damping = [0.0, 30.0, 10.0]; turning_stiffness = [0.0, 50.0, 50.0]
joints.right: type = "cylindrical"; connect = ["ground:right", "shaft:tip"]; axis = [1.0, 0.0, 0.0]
joints.right.elastic: reference = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    stiffness = [0.0, 5e6, 4e6]; turning_stiffness = [0.0, 0.0, 0.0]
joints.clamp: type = "fixed"; connect = ["shaft:tip", "disc:hub"]
coordinates.spin: joint = "left"; range = [-0.2, 2.0]
effects.weight: type = "gravity"; direction = [0.0, 0.0, -1.0]
effects.motor: type = "torque"; joint = "left"; table = [[0.0, 0.0], [0.01, 4.0]]
reduction: modes = 4; angles = 6; static_modes = true
simulation: duration = 0.02; step = 2e-4; frames = 3; error_indicator = false
outputs.spin: type = "angle"; joint = "left"
outputs.sag: type = "displacement"; point = "shaft:middle"; axis = "z"
outputs.speed: type = "speed"; point = "shaft:tip"; axis = "z"
""")
#: A slider-crank of cells, with a random thickness and elasticity over the rod.
SOLID = HEADER + tables(f"""
parameters.thick: nominal = 0.01; unit = "m"; distribution = {{ name = "norm", loc = 0.01, scale = 5e-4 }};
    bounds = [5e-3, 15e-3]
bodies.crank: mesh = "{ROOT}/meshes/crank_solid2d.msh"; element = "solid2d"; material = "steel"; thickness = "thick"
bodies.rod: mesh = "{ROOT}/meshes/rod_solid2d.msh"; element = "solid2d"; material = "steel"; thickness = 0.01
fields.soft: body = "rod"; quantity = "E"; variation = 0.1; length = 0.3; terms = 2
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
joints.slider: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = [1.0, 0.0]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 1.0]
effects.motor: type = "torque"; joint = "crank_hinge"; table = [[0.0, 0.0], [0.01, 50.0]]
effects.push: type = "force"; point = "rod:tip"; direction = [1.0, 0.0]; follows = true;
    table = [[0.0, 0.0], [0.01, 80.0]]
effects.weight: type = "gravity"
reduction: modes = 3; angles = 6
simulation: duration = 0.01; step = 2e-4; frames = 3
simulation.initial.theta: position = 0.2
outputs.slider: type = "position"; point = "rod:tip"; axis = "x"
outputs.bent: type = "deformation"; point = "rod:tip"; axis = "y"; frame = "body"
outputs.stress: type = "stress"; body = "rod"; quantity = "von_mises"
""")
#: Geared cranks whose teeth give way.
TEETH = GEARED.replace("ratio = -1.0", 'ratio = -1.0\nelastic = { stiffness = "k", damping = 0.1 }')
TEETH = TEETH.replace("duration = 0.6", "duration = 0.01\nframes = 3").replace("angles = 48", "angles = 12")
TEETH = (
    TEETH.replace("second_order = true", "second_order = false")
    + """
[parameters]
k = { nominal = 800.0, unit = "N m/rad", distribution = { name = "norm", loc = 800.0, scale = 40.0 } }
"""
)
#: A beam between two clamps, of which one is off.
CLAMPED_OFF = (
    CLAMPED.replace("modes = 2", "modes = 2\nsecond_order = true")
    + """
[joints.right.offset]
place = [1e-5, "d"]
turn = [1e-4]
[effects.weight]
type = "gravity"
[parameters]
d = { nominal = 1e-5, unit = "m", distribution = { name = "norm", loc = 1e-5, scale = 1e-6 } }
"""
)
#: Steps of a scene, in this order, in a folder F of its own: what is asked of pgmp.
STEPS = {
    "check": "check F/scene.toml", "picture": "check F/scene.toml --plot F/assembled.png",
    "effects": "check F/scene.toml --effects",
    "check as JSON": "check F/scene.toml --json", "modes": "modes F/scene.toml -o F/modes.h5",
    "full": "simulate F/scene.toml --full -o F/full.h5",
    "components": "simulate F/scene.toml --components -o F/components.h5", "build": "build F/scene.toml -o F/rom.h5",
    "info": "info F/rom.h5", "run": "simulate F/rom.h5 -o F/run.h5",
    "run as JSON": "simulate F/rom.h5 -o F/again.h5 --json", "samples": "montecarlo F/rom.h5 -n 16 -o F/samples.h5",
    "samples as JSON": "montecarlo F/rom.h5 -n 16 -o F/samples2.h5 --json",
    "samples in components": "montecarlo F/scene.toml --components -n 4 -o F/some.h5",
    "differences": "diff F/run.h5 F/components.h5",
    "sensitivities": "sensitivities F/rom.h5 -o F/sensitivities.h5 --plot F",
    "design": "optimize F/rom.h5 GOAL --parameter VARIED -o F/design.h5 --plot F",
    "table": "export F/run.h5 -o F/run.csv", "measured": "export F/components.h5 -o F/measured.csv",
    "fit": "fit F/rom.h5 F/measured.csv --parameter VARIED --set START -o F/fit.h5 --plot F",
    "tolerance": "build F/scene.toml -o F/chosen.h5 --override reduction={tolerance=0.3}",
    "run with tolerance": "simulate F/chosen.h5 --override simulation.tolerance=0.1 -o F/chosen_run.h5",
    "trade-off": "tradeoff F/scene.toml --quick -o F/tradeoff.h5",
    "pictures": "plot F/modes.h5 -o F",
    "page": "report F/run.h5 F/samples.h5 -o F/page.html", "code": "export F/rom.h5 -o F/code",
    "unit": "export F/rom.h5 -o F/unit.fmu",
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A scene of the matrix, the parameter that is designed and fitted, and steps that it does not take."""

    text: str
    varied: str = ""
    goal: str = ""
    without: tuple[str, ...] = ()

    @property
    def steps(self) -> dict[str, str]:
        return {step: words for step, words in STEPS.items() if step not in self.without}


OF_ROM = tuple(step for step, words in STEPS.items() if re.search(r"(rom|run|samples|chosen)\w*\.h5", words))
OF_CHOICE = ("tolerance", "run with tolerance")
OF_PARAMETERS = ("sensitivities", "design", "measured", "fit")
# of which one scene shows all
SEEN_ONCE = ("run as JSON", "samples as JSON", "samples in components", "pictures", "picture")
CASES = {
    "four bar": Case(FOUR_BAR, "thick", "minimise max(abs(stress))",
                     ("check", "run as JSON", "samples as JSON", "code", "unit", "trade-off", *OF_CHOICE)),
    "four bar, chosen": Case(FOUR_BAR, "thick", "minimise max(abs(stress))", ("code", "unit", "trade-off")),
    "cart": Case(CART, without=tuple(set(STEPS) - {*"check effects full build run code unit".split()})),
    "cart, all": Case(CART, "drag", "minimise max(abs(x))", (*SEEN_ONCE, "fit", *OF_CHOICE, "trade-off")),
    "rotor": Case(ROTOR,
                  without=(*SEEN_ONCE, *OF_PARAMETERS, *"effects code unit page trade-off".split(), *OF_CHOICE)),
    "solid": Case(SOLID, "thick", "minimise max(abs(bent))", ("code", "unit", *OF_CHOICE, "trade-off")),
    "geared": Case(TEETH, without=(*OF_ROM, "effects", "trade-off")),
    "off": Case(CLAMPED_OFF, without=tuple(set(STEPS) - {*"check full build run".split()})),
}  # fmt: skip
THOROUGH = ("four bar, chosen", "cart, all", "solid", "geared")
ROWS = [
    pytest.param(name, step, marks=[pytest.mark.thorough] if name in THOROUGH else [])
    for name, case in CASES.items()
    for step in case.steps
]


@dataclass(frozen=True)
class Twin:
    """A scene in a folder of its own, what commands said there, and the texts of what they drew."""

    folder: Path
    said: dict[str, str]
    drawn: dict[str, list[str]]

    def file(self, step: str) -> Path:
        return self.folder / re.search(r"-o F/(\S+)", STEPS[step])[1]


@pytest.fixture(scope="module")
def twins(folder: Path) -> Callable[[str, str], Twin]:
    """Return a scene in SI units or in mm, after all of its steps."""
    found: dict[tuple[str, str], Twin] = {}

    def twin(name: str, which: str) -> Twin:
        if (name, which) not in found:
            found[name, which] = _made(CASES[name], which, folder / name.replace(" ", "_") / which)
        return found[name, which]

    return twin


def _made(case: Case, which: str, folder: Path) -> Twin:
    folder.mkdir(parents=True)
    (folder / "scene.toml").write_text(with_short_numbers(case.text, folder), encoding="utf-8")
    if which == "mm":
        (folder / "scene.toml").rename(folder / "si.toml")
        in_millimetres(folder / "si.toml", [], folder / "scene.toml")
    scene, said, drawn = load_scene(folder / "scene.toml"), {}, {}
    words = {"GOAL": case.goal, "VARIED": case.varied}
    start = own_values(scene, {case.varied: 1.02 * scene.nominal[case.varied]} if case.varied else {})
    words["START"] = "".join(f"{name}={value!r}" for name, value in start.items())
    for step, asked in case.steps.items():
        texts = drawn.setdefault(step, [])
        arguments = [words.get(word, word.replace("F", str(folder), word[:1] == "F")) for word in asked.split()]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Figure, "savefig", _reading(texts))
            patch.setattr(FigureCanvasSVG, "print_svg", lambda own, *to, **_: own.figure.savefig(*to, format="svg"))
            patch.setattr(tables_of_reduction, "N_FINE_OF_MORE", 24)  # the same in both
            patch.setattr(fmu, "PLATFORMS", {})  # of units descriptions are compared; their code is that of `code`
            said[step] = pgmp(*arguments).stdout.replace(str(folder), "F")
        if step == "measured":
            _shorten(folder / "measured.csv")
    return Twin(folder, said, drawn)


def _shorten(path: Path) -> None:
    """Round numbers to ten digits, which are the same in both units: a fit sees what differs in the last of 16."""
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    rows = [",".join(f"{float(number):.9e}" for number in row.split(",")) for row in rows]
    path.write_text("\n".join([head, *rows]), encoding="utf-8")


def _reading(texts: list[str]) -> Callable:
    """Return what keeps the texts of a picture, without those at ticks, in place of matplotlib's `savefig`: that it is
    drawn is tested elsewhere."""

    def savefig(figure: Figure, target: Path | IO, **given: object) -> None:
        if isinstance(target, Path):
            target.touch()
        else:
            target.write('<svg viewBox="0 0 1 1"></svg>' if given["format"] == "svg" else b"")
        of_axis = (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis))
        ticks = {id(text) for axis in of_axis for text in (*axis.get_ticklabels(), axis.get_offset_text())}
        shown = [text.get_text() for text in figure.findobj(Text) if id(text) not in ticks and text.get_visible()]
        texts.append("\n".join(filter(None, shown)))

    return savefig


#: Code and pages say how many bytes they have, and models say that they are in SI units.
UNLIKE = ("code", "info", "page")
CUT = ("sensitivities", "fit")  # titles where they are too long for the picture


@pytest.mark.parametrize(("name", "step"), ROWS)
def test_a_scene_in_mm_gives_what_it_gives_in_si(twins: Callable[[str, str], Twin], name: str, step: str) -> None:
    si, mm = twins(name, "si"), twins(name, "mm")
    say = flat if "--json" in STEPS[step] else str
    if step not in UNLIKE:
        _assert_alike(say(si.said[step]), say(mm.said[step]))
    assert len(si.drawn[step]) == len(mm.drawn[step])
    if step not in CUT:
        _assert_alike("\n".join(si.drawn[step]), "\n".join(mm.drawn[step]))
    kind = STEPS[step].split()[0]
    if kind in ("modes", "simulate", "montecarlo", "sensitivities", "optimize", "fit", "tradeoff"):
        _assert_same_numbers(si.file(step), mm.file(step))
        if kind in ("simulate", "montecarlo"):
            _assert_same_dataset(si.file(step), mm.file(step))
    elif kind == "report":
        _assert_alike(*(_words(twin.file(step)) for twin in (si, mm)))
    elif step in ("table", "measured"):
        _assert_same_table(si.file(step).read_text(), mm.file(step).read_text())
    elif step == "code":
        _assert_same_code(si, mm)
    elif step == "unit":
        _assert_same_unit(*(twin.file(step) for twin in (si, mm)))


def _assert_alike(si: str, mm: str) -> None:
    found = strange(si, mm)
    assert not found, found


def _assert_same_numbers(si: Path, mm: Path) -> None:
    found = differences(si, mm)
    beyond = {place: apart for place, apart in found.items() if not apart <= EXACT}
    assert found and not beyond, beyond


def _assert_same_dataset(si: Path, mm: Path) -> None:
    one, other = (read(path).to_xarray() for path in (si, mm))
    assert set(one.variables) == set(other.variables)
    for name, values in one.variables.items():
        unit = values.attrs.get("units")
        assert other[name].attrs.get("units") == (MM.unit(unit) if unit is not None else None), name


def _assert_same_table(si: str, mm: str) -> None:
    """Columns of numbers have the units of their heads."""
    (head, *rows), (other_head, *other_rows) = si.splitlines(), mm.splitlines()
    assert len(rows) == len(other_rows)
    units = [re.search(r"\((.*)\)$", name) for name in head.split(",")]
    units = [found[1] if found else "1" for found in units]
    assert other_head == ",".join(
        name.replace(f"({unit})", f"({MM.unit(unit)})") for name, unit in zip(head.split(","), units)
    )
    one, other = (np.array([[float(x) for x in row.split(",")] for row in part]) for part in (rows, other_rows))
    sizes = np.array(list(map(_si, units)))
    beyond = np.abs(other * sizes - one).max(axis=0) > 1e-7 * np.abs(one).max(axis=0)
    assert not beyond.any(), [name for name, is_off in zip(head.split(","), beyond) if is_off]


def _si(unit: str) -> float:
    """Return how many of an SI unit that of the same quantity is in mm, t and s."""
    return MM.size(measure("1" if unit == "" else unit)[1])


def _words(page: Path) -> str:
    text = page.read_text(encoding="utf-8").replace(str(page.parent), "F")
    text = " ".join(re.sub(r"(?s)<(script|style|svg).*?</\1>|<[^>]+>", " ", text).split())
    return re.sub(r" Cost file phase .* Where it comes from ", " ", text)  # times that runs took


def _assert_same_code(si: Twin, mm: Twin) -> None:
    """Compiled models print numbers in their units, and those of the program: iterations under friction stop where its
    own do, of which 2e-11 m more or less were 1e-6 of the 5 um that the cart's pole bends by."""
    run = read(si.file("run")).data
    one, other = (outputs_of(as_one(twin.file("code"), "reduced")) for twin in (si, mm))
    assert one.keys() == other.keys()
    assert_equal(one, {name: values for name, values in run.outputs.items() if name in one})
    assert_equal({name: other[name] * _si(run.units.get(name, "1")) for name in one}, one, 1e-7)


def _assert_same_unit(si: Path, mm: Path) -> None:
    """An FMU defines its units, and its starts and ranges are in them."""
    one, other = (_variables(path) for path in (si, mm))
    assert one.keys() == other.keys()
    for name, (unit, numbers) in one.items():
        other_unit, others = other[name]
        if name.startswith(("states.", "rates.", "der(")):  # inside, in SI units
            assert other_unit == unit and others == numbers
            continue
        assert other_unit == (unit and MM.unit(unit)), name
        np.testing.assert_allclose(np.array(others) * _si(unit), numbers, rtol=1e-9, err_msg=name)
    text = _description(mm)
    for unit, length in (("mm", 'm="1" factor="0.001"'), ("N mm", 'factor="0.001"')):
        assert unit not in dict(other.values()) or re.search(rf'<Unit name="{unit}"><BaseUnit [^>]*{length} ?/>', text)


def _description(fmu: Path) -> str:
    with ZipFile(fmu) as parts:
        return parts.read("modelDescription.xml").decode()


def _variables(fmu: Path) -> dict[str, tuple[str | None, list[float]]]:
    """Return unit, range and start of the real variables of an FMU that have a unit."""
    entries = ElementTree.fromstring(_description(fmu)).find("ModelVariables")
    found = {entry.get("name"): entry.attrib | (entry[0].attrib if len(entry) else {}) for entry in entries}
    known = {name: [float(of[key]) for key in ("min", "max", "start") if key in of] for name, of in found.items()
        if "unit" in of}  # fmt: skip
    return {name: (found[name]["unit"], numbers) for name, numbers in known.items()}


def test_gravity_that_is_not_said_is_that_of_the_earth(tmp_path: Path) -> None:
    text = FOUR_BAR.replace('name = "four_bar"', 'name = "four_bar"\nunits = "mm"')
    scene = scene_from_toml(text, tmp_path)
    assert scene.effects["weight"].acceleration == STANDARD_GRAVITY
    written = scene_to_toml(scene)
    assert scene_from_toml(written, tmp_path).model_dump() == scene.model_dump()
    own = tomllib.loads(written)
    assert own["effects"]["weight"]["acceleration"] == 9806.65
    assert own["parameters"]["thick"]["nominal"] == 8.0 and own["parameters"]["thick"]["unit"] == "mm"
    assert own["parameters"]["k"]["nominal"] == 2.0 and own["parameters"]["k"]["unit"] == "N/mm"


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        (
            "slider_crank", 'outputs.o={type="stress", body="rod", quantity="axial_force", at=[2000.0, 0.0]}',
            "[2000.0, 0.0]: outside the mesh of rod, which reaches from (300, 0) to (1000, 0) mm; its nearest node is "
            "at (1000, 0)\n",
        ),
        (
            "bridge_crane", "coordinates.x.range=[500.0, 31500.0]",
            "[500.0, 31500.0]: must be within the run of nodes, 0 to 12000 mm from the first point\n",
        ),
        (
            "slider_crank", 'fields.f={body="rod", quantity="E", variation=0.5, length=200.0, terms=3}',
            ", 0) mm, and must stay positive",
        ),
        (
            "worn_slider_crank", "joints.pin.clearance.exponent=15.0",
            "= 15.0: a number below 10 is needed in a scene in mm, where N/mm^exponent is the unit of the stiffness; "
            "or give the scene in SI units\n",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_in_mm_is_said_in_mm(name: str, change: str, words: str, tmp_path: Path) -> None:
    path = in_millimetres(ROOT / "scenes" / f"{name}.toml", [], tmp_path / "mm.toml")
    assert words in one_message("check", path, "--override", change)


def test_settings_are_in_the_units_of_the_scene(tmp_path: Path) -> None:
    (tmp_path / "si.toml").write_text(FOUR_BAR, encoding="utf-8")
    path = in_millimetres(tmp_path / "si.toml", [], tmp_path / "mm.toml")
    assert load_scene(path, (), ["thick=7"]).values["thick"] == 7e-3
    assert load_scene(path, (), ["thick=0.7 cm"]).values["thick"] == 7e-3
    assert load_scene(path, ['bodies.coupler.section.width="2 cm"']).bodies["coupler"].section.width == 0.02
    assert_refused(r"^parameters\.thick\.value = 12.0: must lie inside", load_scene, path, (), ["thick=12"])
    with pytest.raises(InputError, match=r"--set thick=7 kg: 'kg' is the unit of a mass; needed is a length \(mm\)"):
        load_scene(path, (), ["thick=7 kg"])
    with pytest.raises(InputError, match=r"coupler\.section\.width = \"7 kg\": .* needed is a length \(mm\)"):
        load_scene(path, ['bodies.coupler.section.width="7 kg"'])


def test_what_is_missing_is_said_in_the_units_of_the_scene(tmp_path: Path) -> None:
    path = tmp_path / "mm.toml"
    path.write_text(FOUR_BAR.replace('name = "four_bar"', 'name = "four_bar"\nunits = "mm"'), encoding="utf-8")
    for change, words in (
        ('outputs.s={type="stress", body="rocker"}', r"s\.quantity: .*principal_min \(MPa\) .*moment \(N mm\), "),
        ("bodies.rocker.line={elements=4}", r"rocker\.line\.length: missing; needed: length \(mm\), a"),
    ):
        assert_refused(words, load_scene, path, [change])


BAD = {
    "unit": ('scene.units="mmm"', r'scene\.units = "mmm": unknown'),
    "dimension": ('bodies.coupler.section.width="7 kg"', r"coupler\.section\.width .* a mass; needed is a length"),
    "name": ('bodies.coupler.section.width="7 mmm"', r"coupler\.section\.width .*did you mean 'mm'"),
    "motion": ('coordinates.theta.range=["0 m", "6.283185307179586 m"]', r"coordinates\.theta\.range .* a length"),
}


@pytest.mark.parametrize("name", BAD)
def test_units_that_do_not_fit_are_bad_input(tmp_path: Path, name: str) -> None:
    (path := tmp_path / "si.toml").write_text(FOUR_BAR, encoding="utf-8")
    assert re.search(BAD[name][1], pgmp("check", path, "--override", BAD[name][0], status=2).stderr)


SHIPPED = sorted((ROOT / "scenes").glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=[path.stem for path in SHIPPED])
def test_a_scene_in_mm_is_that_in_si_once_it_is_read(path: Path, tmp_path: Path) -> None:
    """Number by number and bit by bit, with its nodes; and so is what files have of it."""
    si, mm = load_scene(path), load_scene(in_millimetres(path, [], tmp_path / "mm.toml"))
    assert _tables(mm) == _tables(si)
    again = scene_from_toml(scene_to_toml(mm), tmp_path)
    assert again.model_dump() == mm.model_dump() and scene_to_toml(again) == scene_to_toml(mm)


def _tables(scene: Scene) -> dict[str, Any]:
    tables = scene.model_dump(exclude_unset=True)
    tables["scene"].pop("units", None)
    for body in tables["bodies"].values():
        body.pop("mesh", None)  # files of their own
    return tables


def test_a_controller_computes_in_the_units_of_the_scene(tmp_path: Path) -> None:
    """Gains and limits of a servo in N mm, beside an angle that a formula finds from places."""
    short = ["simulation.duration=0.1", "simulation.frames=3", "reduction.angles=24"]
    si = ROOT / "scenes" / "servo_arm.toml"
    own = ["parameters.kp.nominal=12000.0", "parameters.kp.bounds=[4000.0, 30000.0]", "parameters.kp.distribution={}"]
    own[-1:] = ['parameters.kp.distribution={name="uniform", loc=9000.0, scale=6000.0}']
    own += [
        'controllers.servo.gains={p="kp", i=15000.0, d=2400.0, filter=2e-2}',
        "controllers.servo.limits=[-4e3, 4e3]",
    ]
    for model in ("full", "reduced"):
        found = []
        for path, changes in ((si, short), (in_millimetres(si, short, tmp_path / "mm.toml"), own)):
            source = load_scene(path, changes) if model == "full" else pgmp_build(load_scene(path, changes))
            target = tmp_path / f"{model}_{len(found)}.h5"
            simulate(source, model=model if model == "full" else None, output=target)
            found.append(target)
        _assert_same_numbers(*found)


def test_a_model_of_an_earlier_version_in_mm_is_refused(tmp_path: Path) -> None:
    (tmp_path / "si.toml").write_text(FOUR_BAR, encoding="utf-8")
    path = in_millimetres(tmp_path / "si.toml", ["reduction.angles=8"], tmp_path / "mm.toml")
    rom = reduced_model(load_scene(path)).rom
    rom.write(file := tmp_path / "rom.h5")
    assert read(file).data.rom.record.system == MM
    with resealed(file) as old:
        del old.attrs["computed_in"]
    assert_refused(r"rom\.h5': an earlier version computed it in mm, t and s; make it anew", read, file)


@needs_compiler
def test_rates_in_c_are_those_of_the_program(tmp_path: Path) -> None:
    """Differences in C, chain rule here: 2e-10 by round-off of a closed loop, as in SI. Steps that took mm for m left
    2e-8 of accelerations."""
    rates = [
        f'outputs.{of}_{order}={{type="rate",of="{of}",order={order}}}'
        for of in ("bend", "turned", "place")
        for order in (1, 2)
    ]
    place = 'outputs.place={type="position",point="rocker:tip",axis="x"}'
    changes = ["initial.equilibrium=false", 'outputs.stress={type="speed",joint="c"}', "ensemble={}", place, *rates]
    (tmp_path / "si.toml").write_text(FOUR_BAR, encoding="utf-8")
    path = in_millimetres(tmp_path / "si.toml", changes, tmp_path / "mm.toml")
    assert_same_in_c(reduced_model(load_scene(path)), tmp_path, 1e-9)
