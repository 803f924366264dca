"""Goals and constraints as users write them: values, derivatives, and errors with their position."""

import numpy as np
import pytest
from refusals import refusal

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import MM, SI
from pgmp_petsc.design.derivatives import Outcome, read_constraint, read_goal
from pgmp_petsc.gradients.differentiated import DifferentiatedRun

OUTPUTS, PARAMETERS = ("angle", "bend"), ("r1", "max", "c-2")
TIME = np.linspace(0.0, 2.0, 201)


def outcome(r1: float = 2.0, c: float = 3.0) -> Outcome:
    """Return a run with ``angle = r1 sin t`` and ``bend = - c t``."""
    zero = np.zeros_like(TIME)
    run = DifferentiatedRun(
        TIME,
        {"angle": r1 * np.sin(TIME), "bend": -c * TIME},
        {"angle": {"r1": np.sin(TIME), "c-2": zero}, "bend": {"r1": zero, "c-2": -TIME}},
    )
    return Outcome(run, {"r1": r1, "c-2": c, "max": 7.0}, ("r1", "c-2"))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("max(angle)", 2.0 * np.sin(TIME).max()), ("max(abs(bend))", 6.0), ("min(bend)", -6.0),
        ("start(bend) + end(bend)", -6.0), ("mean(bend)", -3.0), ("rms(bend)", 6.0 / np.sqrt(3.0)),
        ("2 * r1 ^ 2 - c-2 / 4", 8.0 - 0.75), ("-r1^-2 + 1e-1", -0.25 + 0.1), ("(r1 + c-2) * (r1 - 1.5)", 2.5),
        ("max + .5", 7.5), ("- - r1", 2.0), ("r1 ^ r1 + 2 ** 3", 12.0),
        ("sqrt(r1) * max(end(bend), min(c-2, 5))", 3.0 * np.sqrt(2.0)),
        ("60 mm + 2 cm", 0.08), ("60 \N{MICRO SIGN}m * r1", 1.2e-4), ("90 \N{DEGREE SIGN}", np.pi / 2.0),
        ("30 deg * 3", np.pi / 2.0), ("(3 N m) * r1 / 2", 3.0), ("3 kN m / 2", 1500.0),
        ("5 mm^2 + 1 mm2", 6e-6), ("where(3 mm > 2 mm, 3 km/h, 1 m/s) * 1.2", 1.0), ("600 rpm / r1", 10.0 * np.pi),
        ("where(c-2 > r1, rms(angle), 1 / r1) + (r1 < 1)", 2.0 * np.sqrt(0.5 - np.sin(4.0) / 8.0)),
    ],
)  # fmt: skip
def test_expressions_have_their_values_and_derivatives(text: str, value: float) -> None:
    expression = read_goal(f"minimise {text}", OUTPUTS, PARAMETERS).expression
    found = expression(outcome())
    # the mean square of a line by trapezoids: 1/(6 n^2) too much of it
    assert found.value == pytest.approx(value, rel=1e-5)
    h = 1e-5
    for k, moved in enumerate(((h, 0.0), (0.0, h))):
        ahead, behind = (expression(outcome(2.0 + s * moved[0], 3.0 + s * moved[1])).value for s in (1.0, -1.0))
        assert found.slope[k] == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("text", ["r1 / (c-2 - 3)", "(r1 - 2) ^ 0.5", "(r1 - 3) ^ 0.5", "r1 ^ 1e9"])
def test_what_has_no_value_or_no_derivative_is_not_finite(text: str) -> None:
    """Python's own numbers would raise, or become complex."""
    found = read_goal(f"minimise {text}", OUTPUTS, PARAMETERS).expression(outcome())
    assert not (np.isfinite(found.value) and np.isfinite(found.slope).all())
    assert not np.iscomplexobj(found.value)


def test_the_power_zero_is_one() -> None:
    found = read_goal("minimise (r1 - 2) ^ 0", OUTPUTS, PARAMETERS).expression(outcome())
    assert found.value == 1.0 and not found.slope.any()


@pytest.mark.parametrize(("word", "sense"), [("minimise", 1.0), ("minimize", 1.0), ("maximise", -1.0)])
def test_goals_have_a_sense(word: str, sense: float) -> None:
    assert read_goal(f"{word} r1", OUTPUTS, PARAMETERS).sense == sense


@pytest.mark.parametrize(("relation", "sense"), [("<=", 1.0), (">=", -1.0)])
def test_constraints_have_two_sides(relation: str, sense: float) -> None:
    constraint = read_constraint(f"max(angle) {relation} 2*r1", OUTPUTS, PARAMETERS)
    assert constraint.sense == sense
    assert constraint.right(outcome()).value == 4.0


@pytest.mark.parametrize(
    ("text", "reason", "position"),
    [
        ("max(angle)", "a goal begins with minimise or maximise", 0),
        ("", "a goal begins with minimise or maximise", 0),
        ("minimise", "a sum is missing there, of numbers, parameters, figures", 8),
        ("minimise max(angel)", "there is no such output; did you mean 'angle'?", 13),
        ("minimise max(abs(angle)", "angle is an output over time; take a figure of it, such as max(angle)", 17),
        ("minimise angle", "angle is an output over time; take a figure of it, such as max(angle)", 9),
        ("minimise rms(angle^2)", "rms is a figure of one output or of its abs: rms(OUTPUT) or rms(abs(", 9),
        ("minimise c-3", "'c-3'; for a difference leave spaces around -, which names may have in them; did you", 9),
        ("minimise r1 r1", "it is no formula", 12), ("minimise r1 +* 2", "it is no formula", 13),
        ("minimise " + "(" * 40, "it is no formula ('(' was never closed)", 48),
        ("minimise 1 + 1 / 0", "it has 1.0 / 0.0, which is no finite number", 13),
        ("minimise 0 ^ -1", "which is no finite number", 9), ("minimise 10 ^ 999 * r1", "which is no finite number", 9),
        ("minimise where(r1 > 2, 3)", "it gives where 2 arguments; it takes 3", 9),
        ("minimise 2*1e400", "1e400 is no finite number", 11),
        ("minimise r1 ^ -1e999", "1e999 is no finite number", 15), ("minimise r1 <= 2", "'<=' is too much", 12),
        ("minimise 2 mmm", "no parameter, figure, function or unit of a number 'mmm'", 11),
        ("minimise 5 Hz", "'Hz' counts turns, and an angular speed is needed", 10),
        ("minimise 5 mm + 2 * 3 s", "with the unit of this number it adds or compares m and s", 9),
        ("minimise 5 max", "it is no formula", 11), ("minimise 3 m *", "it is no formula", 9),
        ("minimise r1 ; 2", "';' has no place in a formula", 12),
        ("minimise r1 # 2", "'#' has no place in a formula", 12),
    ],
)  # fmt: skip
def test_errors_mark_their_position(text: str, reason: str, position: int) -> None:
    first, shown, mark = refusal(read_goal, text, OUTPUTS, PARAMETERS).split("\n")
    assert first.startswith("goal: ") and reason in first
    assert shown == f"  {text}" and mark.index("^") == 2 + position


def test_units_follow_from_what_is_named_and_are_those_of_the_scene() -> None:
    units = {"angle": "rad", "bend": "m", "parameters.r1": "N/m", "parameters.c-2": "Pa", "parameters.max": ""}
    for text, in_si, in_mm in (
        ("max(abs(bend))", "m", "mm"), ("2 * max(angle)", "rad", "rad"), ("r1 * rms(bend)", "N", "N"),
        ("c-2 + 3", "Pa", "MPa"), ("max * end(bend)", "1", "1"), ("r1 + c-2", "1", "1"),
    ):  # fmt: skip
        for system, unit in ((SI, in_si), (MM, in_mm)):
            assert read_goal(f"minimise {text}", OUTPUTS, PARAMETERS, units, system).unit == unit
    assert read_constraint("end(bend) <= 5", OUTPUTS, PARAMETERS, units, MM).unit == "mm"
    for text, unit in (("end(bend) <= 5 mm", "m"), ("max(angle) <= 30 deg", "rad"), ("c-2 <= 3 N/mm^2", "Pa")):
        for system in (SI, MM):  # numbers with units of their own are the same in both
            found = read_constraint(text, OUTPUTS, PARAMETERS, units, system)
            expected = {"m": 5e-3, "rad": np.pi / 6.0, "Pa": 3e6}[unit]
            assert found.unit == system.unit(unit) and found.right(outcome()).value == pytest.approx(
                expected, rel=1e-15
            )
    with pytest.raises(InputError, match="with the unit of this number it adds or compares m and Pa\n.*\n {15}\\^"):
        read_constraint("end(bend) <= 60 MPa", OUTPUTS, PARAMETERS, units)
    assert read_constraint("5 >= r1 * end(bend)", OUTPUTS, PARAMETERS, units).right.outputs == {"bend"}


def test_a_constraint_needs_a_relation() -> None:
    with pytest.raises(InputError, match="--subject-to: 3000 characters; at most 1000 are read"):
        read_constraint("(" * 3000, OUTPUTS, PARAMETERS)
    for text, place in (("<= 2", 0), ("max(angle) <= ", 14)):
        first, _, mark = refusal(read_constraint, text, OUTPUTS, PARAMETERS).split("\n")
        assert first.startswith("--subject-to: a sum is missing there") and mark.index("^") == 2 + place
    for text in ("max(angle) = 2", "1 <= max(angle) <= 2", "max(angle) < 2"):
        with pytest.raises(InputError, match="--subject-to: <= or >= is needed, once"):
            read_constraint(text, OUTPUTS, PARAMETERS)
