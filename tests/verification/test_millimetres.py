"""The same scene in SI units and in mm, t and s: the same files up to units, command by command; what is refused.

Numbers are computed with as they are, so that both differ by round-off. How far it reaches hangs on the conditioning
of what is computed (a shear force is the difference of far larger displacements): as a measure of it the SI scene is run
again with its numbers changed in the last digits.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from conftest import run_mpi
from millimetres import differences, in_millimetres
from runs import IN_TURN, pgmp

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.scene import load_scene, scene_from_toml, scene_to_toml

ROUND_OFF = 1e-12
REACH = 3000.0  # times what last digits of some numbers do: in mm all are others, and errors are estimated from them
FOUR_BAR = """
[scene]
name = "four_bar"
[ground.points]
pivot = [0.412, -0.003]
post = [0.2, 0.5]
[parameters.k]
nominal = 2000.0
unit = "N/m"
distribution = { name = "norm", loc = 2000.0, scale = 200.0 }
[parameters.t]
nominal = 8.0
unit = "mm"
distribution = { name = "norm", loc = 8.0, scale = 0.3 }
bounds = [6.0, 10.0]
[materials.alu]
E = 70e9
nu = 0.33
rho = 2700.0
[bodies.crank]
line = { length = 0.1013, elements = 1 }
element = "beam2d"
material = "alu"
flexible = false
section = { shape = "circle", radius = 0.01 }
[bodies.coupler]
line = { length = 0.3982, elements = 4 }
element = "beam2d"
material = "alu"
section = { shape = "rectangle", width = 0.02, height = "t" }
placement = { origin = [0.1013, 0.0], angle = 0.7 }
[bodies.rocker]
line = { length = 0.2497, elements = 4 }
element = "beam2d"
material = "alu"
section = { shape = "rectangle", width = 0.02, height = "t" }
placement = { origin = [0.412, -0.003], angle = 1.6 }
[joints]
motor = { type = "revolute", connect = ["ground:origin", "crank:hinge"] }
a = { type = "revolute", connect = ["crank:tip", "coupler:hinge"] }
b = { type = "revolute", connect = ["coupler:tip", "rocker:tip"] }
c = { type = "revolute", connect = ["ground:pivot", "rocker:hinge"] }
[coordinates.theta]
joint = "motor"
range = [0.0, 6.283185307179586]
periodic = true
[effects.drive]
type = "torque"
joint = "motor"
table = [[0.0, 0.0], [0.01, 0.3], [0.025, 0.1]]
[effects.mount]
type = "spring_damper"
points = ["ground:post", "rocker:tip"]
stiffness = "k"
damping = 5.0
rest = 0.25
[effects.weight]
type = "gravity"
[effects.damping]
type = "structural_damping"
stiffness = 1e-4
[initial]
equilibrium = true
[reduction]
modes = 5
static_modes = true
angles = 16
max_angles = 16
interpolation = "spline"
[simulation]
duration = 0.025
step = 5e-4
frames = 5
[outputs]
turned = { type = "angle", joint = "c" }
bend = { type = "deformation", point = "rocker:tip", axis = "y", frame = "body" }
stress = { type = "stress", body = "rocker", quantity = "stress_max" }
[ensemble.probabilities.yielding]
output = "stress"
above = 12e6
when = "ever"
"""
COMMANDS = {
    "modes": ("modes", "SCENE"),
    "full": ("simulate", "SCENE", "--full"),
    "components": ("simulate", "SCENE", "--components"),
    "run": ("simulate", "ROM"),
    "samples": ("montecarlo", "ROM", "-n", "16"),
    "sensitivities": ("sensitivities", "ROM"),
    "design": ("optimize", "ROM", "minimise max(abs(stress))", "--parameter", "t"),
}


@pytest.fixture(scope="module")
def written(folder: Path) -> Callable[[str, str], Path]:
    """Return what a command wrote of the scene in SI units, in SI units with other last digits, and in mm."""
    text = FOUR_BAR
    nudged = re.sub(
        r"(?m)((?:E|rho|length|width|radius|damping|rest|stiffness) = )([0-9.]+(?:e-?[0-9]+)?)",
        lambda found: f"{found[1]}{float(np.nextafter(float(found[2]), np.inf))!r}", text,
    )  # fmt: skip
    assert nudged != text
    (folder / "si.toml").write_text(text, encoding="utf-8")
    (folder / "nudged.toml").write_text(nudged, encoding="utf-8")
    in_millimetres(folder / "si.toml", [], folder / "mm.toml")
    commands = []
    for which in ("si", "nudged", "mm"):
        known = {"SCENE": str(folder / f"{which}.toml"), "ROM": str(folder / f"{which}_rom.h5")}
        commands.append(["build", known["SCENE"], "-o", known["ROM"]])
        for name, words in COMMANDS.items():
            commands.append([*(known.get(word, word) for word in words), "-o", str(folder / f"{which}_{name}.h5")])
    done = run_mpi(1, "-c", IN_TURN, json.dumps(commands))
    assert [line for line in done.stdout.splitlines() if line.startswith("[")] == ["[0]"] * len(commands), done.stderr
    return lambda which, command: folder / f"{which}_{command}.h5"


@pytest.mark.parametrize("command", COMMANDS)
def test_files_in_mm_are_those_in_si_up_to_units(written: Callable[[str, str], Path], command: str) -> None:
    of_digits = differences(written("si", command), written("nudged", command), alike=True)
    found = differences(written("si", command), written("mm", command))
    reach = {place: max(ROUND_OFF, REACH * off) for place, off in of_digits.items()}
    beyond = {place: (off, reach[place]) for place, off in found.items() if not off <= reach[place]}
    assert found and not beyond, beyond


def test_a_scene_in_mm_says_so_everywhere(written: Callable[[str, str], Path]) -> None:
    scene = written("mm", "full").parent / "mm.toml"
    said = pgmp("check", scene).stdout
    assert "398.2 mm" in said and "bend (mm), stress (MPa)" in said and "k = 2 N/mm" in said and "t = 8 mm" in said
    told = pgmp("info", written("mm", "full")).stdout
    assert re.search(r"bend .* mm\b", told) and re.search(r"stress .* MPa\b", told)
    page = written("mm", "full").with_suffix(".html")
    pgmp("report", written("mm", "full"), "-o", page)
    text = page.read_text(encoding="utf-8")
    assert "mm" in text and "MPa" in text and "GPa" not in text and "kPa" not in text and "m/s2" not in text
    table = written("mm", "full").with_suffix(".csv")
    pgmp("export", written("mm", "full"), "-o", table)
    head = table.read_text(encoding="utf-8").splitlines()[0]
    assert "bend (mm)" in head and "stress (MPa)" in head


def test_an_exported_model_in_mm_defines_its_units(written: Callable[[str, str], Path]) -> None:
    scene = written("mm", "full").with_name("mm.toml")
    rom, fmu = scene.with_name("undeformed.h5"), scene.with_name("undeformed.fmu")
    pgmp("build", scene, "--override", "initial.equilibrium=false", "-o", rom)
    pgmp("export", rom, "-o", fmu)
    with ZipFile(fmu) as parts:
        text = parts.read("modelDescription.xml").decode()
    assert re.search(r'<Unit name="mm"><BaseUnit m="1" factor="0.001" ?/>', text)
    assert re.search(r'<Unit name="N mm"><BaseUnit [^>]*factor="0.001" ?/>', text)  # of the torque
    assert 'description="in mm"' in text


def test_gravity_that_is_not_said_is_that_of_the_earth(tmp_path: Path) -> None:
    text = FOUR_BAR.replace('name = "four_bar"', 'name = "four_bar"\nunits = "mm"')
    scene = scene_from_toml(text, tmp_path)
    assert scene.effects["weight"].acceleration == pytest.approx(1e3 * _earth(tmp_path), rel=1e-15)
    assert scene_from_toml(scene_to_toml(scene), tmp_path) == scene
    assert scene.parameters["t"].nominal == 8.0 and scene.parameters["t"].unit == "mm"
    assert scene.parameters["k"].nominal == 2.0 and scene.parameters["k"].unit == "N/mm"


def _earth(folder: Path) -> float:
    return scene_from_toml(FOUR_BAR, folder).effects["weight"].acceleration


def test_settings_are_in_the_units_of_the_scene(tmp_path: Path) -> None:
    (tmp_path / "si.toml").write_text(FOUR_BAR, encoding="utf-8")
    path = in_millimetres(tmp_path / "si.toml", [], tmp_path / "mm.toml")
    assert load_scene(path, (), ["t=7"]).values["t"] == 7.0
    assert load_scene(path, (), ["t=0.7 cm"]).values["t"] == 7.0
    assert load_scene(path, ['bodies.coupler.section.width="2 cm"']).bodies["coupler"].section.width == 20.0
    with pytest.raises(InputError, match=r"^parameters\.t\.value = 12.0: must lie inside"):
        load_scene(path, (), ["t=12"])
    with pytest.raises(InputError, match=r"--set t=7 kg: 'kg' is the unit of a mass; needed is a length \(mm\)"):
        load_scene(path, (), ["t=7 kg"])
    with pytest.raises(InputError, match=r"coupler\.section\.width = \"7 kg\": .* needed is a length \(mm\)"):
        load_scene(path, ['bodies.coupler.section.width="7 kg"'])


BAD = {
    "unit": ('scene.units="mmm"', r'scene\.units = "mmm": unknown'),
    "dimension": ('bodies.coupler.section.width="7 kg"', r"coupler\.section\.width .* a mass; needed is a length"),
    "name": ('bodies.coupler.section.width="7 mmm"', r"coupler\.section\.width .*did you mean 'mm'"),
    "motion": ('coordinates.theta.range=["0 m", "6.283185307179586 m"]', r"coordinates\.theta\.range .* a length"),
}


@pytest.mark.parametrize("n", [1, 3])
def test_units_that_do_not_fit_are_bad_input_on_all_ranks(tmp_path: Path, mpirun: Callable, n: int) -> None:
    path = tmp_path / "si.toml"
    path.write_text(FOUR_BAR, encoding="utf-8")
    commands = [["check", str(path), "--override", change] for change, _ in BAD.values()]
    done = mpirun(n, "-c", IN_TURN, json.dumps(commands))
    assert done.stdout.splitlines() == [json.dumps([2] * n)] * len(BAD), done.stderr
    assert done.stderr.count("pgmp: error") == len(BAD) and "Traceback" not in done.stderr
    for _, message in BAD.values():
        assert re.search(message, done.stderr), done.stderr
