"""Loads whose values over time name parameters, as several loads with a scale each."""

import pytest

from pgmp_petsc.api.sources import _check_tables_hold
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.effects.time_function import amplitude_of
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from scenes import slider_crank

PARAMETERS = ("parameters.A={nominal=2.0}", "parameters.B={nominal=-0.5}")
TIMES = (-0.1, 0.0, 0.03, 0.1, 0.17, 0.2, 0.5)


def scene_with(over_time: str, *overrides: str) -> Scene:
    motor = f'effects.motor={{type="torque",joint="crank_hinge",{over_time}}}'
    return slider_crank(*PARAMETERS, motor, "simulation.duration=0.5", "simulation.step=1e-3", *overrides)


@pytest.mark.parametrize(
    ("over_time", "names"),
    [
        ('table=[[0.0,"A"],[0.1,3.0],[0.2,"B"]]', ["motor", "motor_A", "motor_B"]),
        ('table=[[0.0,0.0],[0.1,"A"],[0.2,"A"]],scale=3.0', ["motor"]),
        ('table=[[0.0,"B"],[0.1,"A"]]', ["motor_B", "motor_A"]),
        ('harmonic={amplitude="A",frequency_hz=3.0,phase=0.4}', ["motor"]),
        ('harmonic={amplitude="A",frequency_hz=3.0,mean="A"},scale=-2.0', ["motor"]),
        ('harmonic={amplitude="A",frequency_hz=3.0,mean=1.5},scale=-2.0', ["motor", "motor_A"]),
        ('harmonic={amplitude=1.0,frequency_hz=3.0,mean="B"}', ["motor", "motor_B"]),
    ],
)
def test_parts_add_up_to_the_load_with_its_numbers(over_time: str, names: list[str]) -> None:
    scene = scene_with(over_time)
    assert list(scene.plain_effects) == names
    number = scene_with(over_time.replace('"A"', "2.0").replace('"B"', "-0.5")).effects["motor"]
    for time in TIMES:
        found = sum(scene.number(part.scale) * amplitude_of(part)(time) for part in scene.plain_effects.values())
        assert found == pytest.approx(number.scale * amplitude_of(number)(time), rel=1e-14, abs=1e-14)
    assert scene_from_toml(scene_to_toml(scene), ".").effects == scene.effects


def test_a_part_has_no_name_of_another_effect() -> None:
    with pytest.raises(InputError, match=r"^effects.motor_A: a part of effects.motor has this name; give it another"):
        scene_with('table=[[0.0,1.0],[0.1,"A"]]', 'effects.motor_A={type="gravity"}')


def test_an_impulse_that_steps_miss_is_refused_of_parts_too() -> None:
    with pytest.raises(InputError, match=r"^effects.motor.table: has an impulse of .* smaller simulation.step"):
        scene_with('table=[[0.0,0.0],[0.10005,0.0],[0.1002,"A"],[0.10035,0.0]]')


def test_another_parameter_in_a_load_is_another_reduced_model() -> None:
    built = scene_with('harmonic={amplitude="A",frequency_hz=3.0}')
    _check_tables_hold(built, scene_with('harmonic={amplitude="A",frequency_hz=5.0}'), "rom.h5")
    for over_time in ("amplitude=3.0", 'amplitude="B"', 'amplitude="A",mean=1.0'):
        with pytest.raises(InputError, match=r"^--override effects.*: 'rom.h5' was built from this"):
            _check_tables_hold(built, scene_with(f"harmonic={{{over_time},frequency_hz=3.0}}"), "rom.h5")
