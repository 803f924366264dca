"""Units of parameters: converted where they are compatible with what uses the parameter, refused where not."""

import re
from pathlib import Path

import numpy as np
import pytest
from refusals import cases, check_said, refusal

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import OTHERS, UNITS, measure, names_in_others
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.scene import load_scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.units import result_units

SLIDER_CRANK = Path(__file__).resolve().parents[2] / "scenes" / "slider_crank.toml"
MILLIMETRES = (
    'parameters.r1={nominal=5.6, unit="mm", bounds=[1, 12], distribution={name="norm", loc=5.6, scale=0.56}, value=6}'
)


def with_parameter(unit: str, entry: str, *more: str, nominal: float = 70.0) -> dict[str, float]:
    """Return nominal value and unit of a parameter of this unit that stands for an entry."""
    scene = load_scene(SLIDER_CRANK, [f'parameters.q={{nominal={nominal}, unit="{unit}"}}', *more, f'{entry}="q"'])
    return scene.parameters["q"].nominal, scene.parameters["q"].unit


def test_a_unit_of_mass_that_is_a_quotient_is_in_brackets() -> None:
    (inches,) = (system for system in OTHERS if system.names[0] == "in")
    assert [inches.unit(one) for one in ("kg", "kg m2", "N m")] == ["lbf s2/in", "(lbf s2/in) in2", "lbf in"]


def test_parameters_without_a_unit_have_that_of_the_entries_that_name_them() -> None:
    damped = 'effects.oil={type="joint_damping", joint="crank_hinge", coefficient="c"}'
    names = ["parameters.c={nominal=0.02}", "parameters.idle={nominal=1.0}", damped]
    assert result_units(load_scene(SLIDER_CRANK, names)) == {"r1": "m", "c": "N m s/rad", "idle": "1"}
    inches = load_scene(SLIDER_CRANK, [*names, "materials.steel.rho=7.3e-4", "materials.steel.E=30e6"])
    assert result_units(inches)["c"] == "lbf in s/rad"
    assert RunRecord(scene_to_toml(inches), {}, None, 1).system.unit("J") == "lbf in"


def test_all_numbers_of_a_parameter_are_converted() -> None:
    scene = load_scene(SLIDER_CRANK, [MILLIMETRES])
    given = scene.parameters["r1"]
    assert (given.nominal, given.unit, given.bounds, given.value) == (5.6e-3, "m", (1e-3, 12e-3), 6e-3)
    assert given.distribution.arguments == {"loc": 5.6e-3, "scale": 0.56e-3}
    assert given.distribution == load_scene(SLIDER_CRANK).parameters["r1"].distribution
    for law, known in (
        ('name="lognorm", s=0.1, scale=5.6', {"s": 0.1, "scale": 5.6e-3}),  # shapes have no unit
        ('name="uniform", loc=5', {"loc": 5e-3, "scale": 1e-3}),  # the default scale is one of the unit
    ):
        scene = load_scene(SLIDER_CRANK, [f'parameters.r1={{nominal=5.6, unit="mm", distribution={{{law}}}}}'])
        assert scene.parameters["r1"].distribution.arguments == known
    assert load_scene(SLIDER_CRANK, [MILLIMETRES], ["r1=5e-3"]).values["r1"] == 5e-3
    with pytest.raises(InputError, match=r"= 5.0: .* \[0.001, 0.012\] m \(in SI units; the parameter's unit is mm\)$"):
        load_scene(SLIDER_CRANK, [MILLIMETRES], ["r1=5"])


def test_the_resolved_scene_is_in_si_units() -> None:
    scene = load_scene(SLIDER_CRANK, [MILLIMETRES])
    text = scene_to_toml(scene)
    assert "mm" not in text
    assert scene_from_toml(text, SLIDER_CRANK.parent) == scene


SPRING = 'effects.s={type="spring_damper", joint="crank_hinge", stiffness="q"}'
RESTING = 'effects.s={type="spring_damper", joint="crank_hinge", stiffness=1.0, rest="q"}'
SLIDING = 'effects.s={type="spring_damper", joint="slider", stiffness="q"}'
DAMPER = 'effects.s={type="joint_damping", joint="crank_hinge", coefficient="q"}'

SERVO = 'controllers.c={type="pid", measures="%s", reference=0.0, gains={i="q"}, joint="%s"}'
TURNING, PUSHING = SERVO % ("crank_angle", "crank_hinge"), SERVO % ("slider_position", "slider")


@pytest.mark.parametrize(
    ("unit", "entry", "more", "value", "si"),
    [
        ("GPa", "materials.steel.E", (), 70e9, "Pa"), ("N/mm2", "materials.steel.E", (), 70e6, "Pa"),
        ("g/cm3", "materials.steel.rho", (), 70e3, "kg/m3"), ("t/m^3", "materials.steel.rho", (), 70e3, "kg/m3"),
        ("in", "bodies.rod.section.radius", (), 70 * 0.0254, "m"), ("kNm", "effects.motor.scale", (), 70e3, "N m"),
        ("percent", "effects.motor.scale", (), 0.7, "1"),
        ("N mm/deg", "effects.s.stiffness", (SPRING,), 0.07 * 180 / 3.141592653589793, "N m/rad"),
        ("deg", "effects.s.rest", (RESTING,), 70 * 3.141592653589793 / 180, "rad"),
        ("rpm", "simulation.initial.theta.velocity", (), 70 * 2 * 3.141592653589793 / 60, "rad/s"),
        ("Nm/rad", "effects.s.stiffness", (SPRING,), 70.0, "Nm/rad"),
        ("kN/m", "effects.s.stiffness", (SLIDING,), 70e3, "N/m"),
        ("N*m*s", "effects.s.coefficient", (DAMPER,), 70.0, "N*m*s"),
        ("", "effects.s.coefficient", (DAMPER,), 70.0, ""),
        ("N mm/(rad s)", "controllers.c.gains.i", (TURNING,), 0.07, "N m/(rad s)"),
        ("N/mm/s", "controllers.c.gains.i", (PUSHING,), 70e3, "N/(m s)"),
    ],
)  # fmt: skip
def test_compatible_units(unit: str, entry: str, more: tuple[str, ...], value: float, si: str) -> None:
    found, label = with_parameter(unit, entry, *more)
    assert found == pytest.approx(value, rel=1e-15) and label == si


def test_one_parameter_for_two_quantities() -> None:
    with pytest.raises(InputError, match=r"^parameters\.r1: materials\.steel\.E \(Pa\) and .* different quantities"):
        load_scene(SLIDER_CRANK, ['materials.steel.E="r1"', "parameters.r1={nominal=1e9}"])


@pytest.mark.parametrize("unit", {**UNITS, **names_in_others()})
def test_units_as_the_library_has_them(unit: str) -> None:
    """Units that are taken without pint against it, which reads products with a factor of 1; both round some times."""
    assert measure(f"{unit}*1") == (pytest.approx(measure(unit)[0], rel=1e-15), measure(unit)[1])
    assert measure(unit)[0] == 1.0 or unit not in UNITS


def test_a_blank_between_units() -> None:
    """Metre seconds are no milliseconds, though units of SI may be written without blanks."""
    assert measure("m s") == (1.0, (0, 1, 1)) and measure("ms") == (1e-3, (0, 0, 1)) and measure("Nm")[0] == 1.0


TEXTS = [
    ('bodies.rod.section.radius="5 mm"', lambda scene: scene.bodies["rod"].section.radius, 5e-3),
    ('materials.steel={E="210 GPa", nu=0.3, rho="7.8 g/cm3"}', lambda scene: scene.materials["steel"].E, 210e9),
    ('materials.steel={E="210 GPa", nu=0.3, rho="7.8 g/cm3"}', lambda scene: scene.materials["steel"].rho, 7800.0),
    ('ground.points={far=["30 cm", 0.1]}', lambda scene: scene.ground.points["far"], (0.3, 0.1)),
    ('bodies.rod.placement={origin=["100 mm", 0.0], angle="30 deg"}',
     lambda scene: (*scene.bodies["rod"].placement.origin, scene.bodies["rod"].placement.angle), (0.1, 0.0, np.pi / 6)),
    ('coordinates.theta.range=["0 deg", "360 deg"]', lambda scene: scene.coordinates["theta"].range, (0, 2 * np.pi)),
    ('simulation.duration="200 ms"', lambda scene: scene.simulation.duration, 0.2),
    ('simulation.initial.theta={position="-90 deg", velocity="60 rpm"}',
     lambda scene: (scene.initial_state("theta").position, scene.initial_state("theta").velocity),
     (-np.pi / 2, 2 * np.pi)),
    ('effects.motor={type="torque", joint="crank_hinge", table=[["0 ms", "1 N cm"], ["1 min", 2]]}',
     lambda scene: sum(scene.effects["motor"].table, ()), (0.0, 0.01, 60.0, 2.0)),
    ('effects.motor={type="torque", joint="crank_hinge", harmonic={amplitude="2 N cm", frequency_hz="300 rpm"}}',
     lambda scene: (scene.effects["motor"].harmonic.amplitude, scene.effects["motor"].harmonic.frequency_hz),
     (0.02, 5.0)),
    ('effects.s={type="spring_damper", joint="crank_hinge", stiffness="5 N mm/deg", rest="90 deg"}',
     lambda scene: (scene.effects["s"].stiffness, scene.effects["s"].rest), (0.9 / np.pi, np.pi / 2)),
    ('parameters.r1={nominal="5.6 mm",bounds=["0.1 cm", 0.012],distribution={name="norm",loc="5.6 mm",scale="560 um"}}',
     lambda scene: (scene.nominal["r1"], *scene.parameters["r1"].distribution.arguments.values()),
     (5.6e-3, 5.6e-3, 0.56e-3)),
    ('fields.soft={body="rod", quantity="E", variation=0.1, length="20 cm", terms=1}',
     lambda scene: scene.fields["soft"].length, 0.2),
    ('joints.cam={type="cam", joints=["crank_hinge", "slider"], motion="sliding",'
     ' table=[[0.0, "0 mm"], ["90 deg", "5 mm"], [3.0, 0.001], ["360 deg", "0 mm"]]}',
     lambda scene: sum(scene.joints["cam"].table, ()), (0.0, 0.0, np.pi / 2, 0.005, 3.0, 0.001, 2 * np.pi, 0.0)),
    ('effects.d={type="structural_damping", stiffness="20 us", mass="30 1/min"}',
     lambda scene: (scene.effects["d"].stiffness, scene.effects["d"].mass), (2e-5, 0.5)),
    ('outputs={s={type="stress", body="rod", quantity="stress_max"},'
     ' d={type="rainflow", of="s", curve={table=[["100 MPa", 1e6], [2e8, 1e4]]}}}',
     lambda scene: sum(scene.outputs["d"].curve.table, ()), (1e8, 1e6, 2e8, 1e4)),
]  # fmt: skip


@pytest.mark.parametrize(("entry", "value", "expected"), TEXTS, ids=[entry[:60] for entry, *_ in TEXTS])
def test_numbers_with_their_own_unit_are_converted(entry: str, value: object, expected: object) -> None:
    scene = load_scene(SLIDER_CRANK, [entry])
    assert value(scene) == pytest.approx(expected, rel=1e-15)
    assert scene_from_toml(scene_to_toml(scene), SLIDER_CRANK.parent) == scene


def test_a_setting_may_have_its_unit() -> None:
    for law in (['parameters.r1.unit="m"'], [MILLIMETRES]):
        assert load_scene(SLIDER_CRANK, law, ["r1=5 mm"]).values["r1"] == 5e-3
        with pytest.raises(InputError, match="'kg' is the unit of a mass"):
            load_scene(SLIDER_CRANK, law, ["r1=5 kg"])
    with pytest.raises(InputError, match="'Hz' counts turns"):
        load_scene(SLIDER_CRANK, ['parameters.q={nominal=120.0, unit="rpm"}'], ["q=2 Hz"])


REFUSED = cases("""
# units of parameters: of another quantity than what uses them, or none
bodies.rod.section.radius="q" & Q="GPa"} -> parameters.q.unit = "GPa": | bodies.rod.section.radius uses it | needs m
materials.steel.E="q" & Q="m"} -> parameters.q.unit = "m": | materials.steel.E uses it | needs Pa
SPRING & Q="N/m"} -> parameters.q.unit = "N/m": | effects.s.stiffness | N m/rad
SLIDING & Q="Nm/rad"} -> parameters.q.unit = "Nm/rad": | effects.s.stiffness | N/m
effects.motor.scale="q" & Q="N"} -> parameters.q.unit = "N": | effects.motor.scale | 1 (no unit) or N m
materials.steel.E="q" & Q="Mpa"} -> parameters.q.unit = "Mpa": | no such unit | did you mean 'MPa'?
materials.steel.E="q" & Q="kelvin"} -> parameters.q.unit = "kelvin": | [temperature]
materials.steel.E="q" & Q="m**9**9**9"} -> parameters.q.unit = "m**9**9**9": | a unit such as
materials.steel.E="q" & Q="__import__('os')"} -> parameters.q.unit = "__import__('os')": | a unit such as
materials.steel.E="q" & Q="MMM"} -> parameters.q.unit = "mmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmmm | a unit such as
materials.steel.E="q" & Q="/"} -> parameters.q.unit = "/": | a unit such as
# units behind numbers
bodies.rod.section.radius="5 kg" -> = | 'kg' is the unit of a mass; | a length
bodies.rod.section.radius="5" -> = | has its unit behind it
bodies.rod.section.radius="5 mmm" -> = | did you mean 'mm'
bodies.rod.section.radius="5 K" -> = | scenes have no use for
simulation.step="1 mm" -> = | a length; needed is a time (s)
simulation.initial.theta={position="1 mm"} -> simulation.initial.theta.position | a length; | angle
simulation.initial.theta={velocity="5 Hz"} -> simulation.initial.theta.velocity | counts turns
coordinates.theta.range=["0 m", "6.283185307179586 m"] -> = "0 m": | a length || coordinates.theta.range = | a length
effects.s={type="spring_damper", joint="crank_hinge", stiffness="5 N/mm"} -> effects.s.stiffness = | stiff
effects.s={type="spring_damper", joint="slider", stiffness="5 N mm"} -> effects.s.stiffness =
effects.motor={type="torque", joint="crank_hinge", table=[[0, "1 N"]]} -> effects.motor.table[0] | a force
effects.motor={type="torque", joint="crank_hinge", table=[["1 m", 1]]} -> effects.motor.table[0][0]
effects={} & effects.m={type="prescribed_motion", coordinate="theta", constant_speed={speed="1 m/s"}} ->
    effects.m.constant_speed.speed = | a speed; needed is a frequency or an angular speed
SERVED reference={table=[["1 m", 0.0]]}} -> controllers.c.reference.table[0][0] = "1 m": | a length; needed is a time
SERVED reference={table=[[0.0, "1 mm"]]}} -> controllers.c.reference.table[0] = "1 mm": | a length; | an angle (rad)
SERVED limits=["-1 N", 1.0]} -> controllers.c.limits = "-1 N": | a force; needed is a torque
joints.cam={type="cam", joints=["crank_hinge", "slider"], motion="sliding", table=[[0, 0], [1, "5 deg"], [3, 0], [6.283185307179586, 0]]}
    -> joints.cam.table[1][1] = "5 deg": | an angle | a length
ensemble.probabilities.far={output="slider_position", above="5 N"} -> ensemble.probabilities.far.above =
parameters.r1={nominal="5.6 mm", bounds=["1 kg", 12]} -> parameters.r1 = "1 kg": | a mass
parameters.q={nominal="2 Hz", unit="rpm"} -> parameters.q = "2 Hz": | counts turns
parameters.r1={nominal="5.6"} -> parameters.r1 = "5.6": | unit behind
parameters.r1={nominal="5.6 mmm"} -> parameters.r1 = | did you mean 'mm'
scene.units="mmm" -> = "mmm": unknown; did you mean 'mm'? (allowed: SI, mm)
scene.units=3 -> = 3: unknown (allowed: SI, mm)
# scenes with something else that is wrong
materials.steel.E="stiff" -> = "stiff": there is no such parameter
parameters.r1.distribution={name=[1]} -> parameters.r1.distribution.name = [1]
parameters.r1.distribution={name={a=1}} -> parameters.r1.distribution.name
""")
SERVED = 'controllers.c={type="pid", measures="crank_angle", gains={p=1.0}, joint="crank_hinge",'
WORDS = {"Q": "parameters.q={nominal=70.0, unit", "MMM": "m" * 1000, "SPRING": SPRING, "SLIDING": SLIDING}
WORDS["SERVED"] = SERVED


@pytest.mark.parametrize(("asked", "said"), REFUSED)
def test_units_that_do_not_fit_are_refused(asked: str, said: str) -> None:
    given = re.sub(rf"\b({'|'.join(WORDS)})\b", lambda word: WORDS[word[0]], asked)
    check_said(refusal(load_scene, SLIDER_CRANK, given.split(" & ")), said, given)
