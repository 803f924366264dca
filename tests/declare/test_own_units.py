"""Formulas in the units of a scene, and the same in SI units."""

import math

import numpy as np
import pytest

from pgmp_petsc.declare.formulas import declared, evaluated, in_si

MM = {"s": 3, "v": 3, "phi": 0, "t": 0, "push": 0, "mass": -3, "stress": -6}  # of mm, t, s, N and MPa
#: Formulas, what they are of, and what is written anew.
ROWS = {
    "numbers that are lengths and stiffnesses": ("-3 * (s - 500)", 0, "((-3000.0) * (s - 0.5))"),
    "a number that divides": ("exp(s / 20)", 0, "exp((s / 0.02))"),
    "a number within a function": ("5 * sin(12 * s)", 0, "(5.0 * sin((12000.0 * s)))"),
    "a largest value": ("max(s, 2)", 3, "max(s, 0.002)"),
    "a case": ("where(s > 20, v, 0)", 3, "(v if (s > 0.02) else 0.0)"),
    "a root": ("sqrt(s) * sqrt(s) + 3", 3, "((sqrt(s) * sqrt(s)) + 0.003)"),
    "a power": ("2 * s ** 3 + t", 0, "((2000000000.0 * (s ** (3))) + t)"),
    "nothing to change": ("push * sin(phi) * (t > 0.1)", 0, "((push * sin(phi)) * (1 if (t > 0.1) else 0))"),
    "what does not fit": ("t + s", 0, "(t + (1000.0 * s))"),
    "nor a power": ("s ** 2 + s", 0, "(1000000.0 * ((s ** (2)) + (s / 1000.0)))"),
    "a sum of kinds": ("mass + 1000 * stress", -3, "(mass + (1.0 * stress))"),
    "an exponent that changes": ("t ** s", 0, "(t ** (1000.0 * s))"),
}


def _number(text: str, values: dict[str, float]) -> float:
    """Return a formula of numbers by Python itself."""
    return eval(text, {name: getattr(math, name) for name in ("sin", "exp", "sqrt")} | {"max": max} | values)


@pytest.mark.parametrize("row", ROWS)
def test_a_formula_is_written_as_one_would_in_si(row: str) -> None:
    text, power, wanted = ROWS[row]
    own, _ = declared(text, {name: name for name in MM}, "")
    found = in_si({"f": own}, MM, {"f": power}).texts["f"]
    assert found == wanted
    rng = np.random.default_rng(1)
    for _ in range(5):
        si = {name: float(x) for name, x in zip(MM, rng.uniform(0.01, 0.05, len(MM)))}
        scaled = {name: 10.0 ** MM[name] * x for name, x in si.items()}
        assert _number(own, scaled) == pytest.approx(10.0**power * _number(found, si), rel=1e-13)


def test_constants_have_what_a_formula_asks_for() -> None:
    """Of a spring of k and l without units of their own, and of the law of a controller with its state."""
    spring = in_si({"f": "k * (l - s)"}, MM, {"f": 0})
    assert spring.number("k", 0.003) == 3.0 and spring.number("l", 500.0) == 0.5 and spring.number("k", "k") == "k"
    assert spring.texts["f"] == "k * (l - s)"
    law = {"f": "p * (r - phi) + sum", "sum": "i * (r - phi) + (limited - free) * i / p"}
    found = in_si(law, MM | {"free": 3, "limited": 3}, {"f": 3, "sum": "sum"})
    assert found.texts == law
    assert {name: found.number(name, 12000.0) for name in ("p", "i", "r")} == {"p": 12.0, "i": 12.0, "r": 12000.0}


def test_both_sides_are_of_one_unit_which_follows() -> None:
    found = in_si({"left": "stress", "right": "12 + 2 * 4"}, MM, {"left": "both", "right": "both"})
    assert evaluated(found.texts["right"], {}, _Floats()) == 20e6 and found.powers["both"] == -6


class _Floats:
    def number(self, value: float) -> float:
        return value


def test_a_scene_in_si_keeps_its_formulas() -> None:
    assert in_si({"f": "s  +  1"}, dict.fromkeys(MM, 0), {"f": 0}).texts == {"f": "s  +  1"}
