"""Laws that a scene writes as formulas: values and derivatives, motions against an independent integration, in C."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from alike import assert_alike
from differences import differences
from machine_scenes import MODELS, cart, cart_errors, run
from refusals import cases, check_said, refusal
from runs import assert_close, overridden, reduced_model, refused

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare.formulas import declared
from pgmp_petsc.design.derivatives import difference_remarks
from pgmp_petsc.effects.formula import WORDS, known, law_of
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.stepping.status import Status

#: A formula of every function, and the same by numpy.
EXAMPLES = {
    "A * sin(12 * s) - c * v": lambda s, v, t, A, c: A * np.sin(12 * s) - c * v,
    "A * (t > 0.1) + c * (s > 0) * (v < 1)": lambda s, v, t, A, c: A * (t > 0.1) + c * (s > 0) * (v < 1),
    "A ** 2 * s ** 3 - c / (1 + v ** 2)": lambda s, v, t, A, c: A**2 * s**3 - c / (1 + v**2),
    "exp(-A * t) * cos(s) + c * log(2 + v)": lambda s, v, t, A, c: np.exp(-A * t) * np.cos(s) + c * np.log(2 + v),
    "where(s > c, A * s, -A * v) - abs(v)": lambda s, v, t, A, c: np.where(s > c, A * s, -A * v) - np.abs(v),
    "where(s - c, A, t)": lambda s, v, t, A, c: np.where(s - c != 0, A, t),
    "A * tanh(v / c) + sqrt(4 + s) + tan(t)": lambda s, v, t, A, c: A * np.tanh(v / c) + np.sqrt(4 + s) + np.tan(t),
    "min(A, s) * max(c, v) + sign(s)": lambda s, v, t, A, c: np.minimum(A, s) * np.maximum(c, v) + np.sign(s),
    "A * atan2(s, v) + c * atan2(-v, -t) + 2 ** s": lambda s, v, t, A, c: (
        A * np.arctan2(s, v) + c * np.arctan2(-v, -t) + 2.0**s
    ),
    "A * (0 < s < 1) - (2 ** -1 + 3) * c * s ** -2": lambda s, v, t, A, c: A * (0 < s) * (s < 1) - 3.5 * c / s**2,
}
STATES = [(s, v, t) for s in (-1.3, -0.2, 0.4, 1.7) for v in (-0.7, 0.3, 1.9) for t in (0.05, 0.6)]


@pytest.mark.parametrize("text", EXAMPLES)
def test_a_formula_and_its_derivatives(text: str) -> None:
    """Values to round-off, slopes by differences away from jumps, in Python and from machine code."""
    law, h = law_of(declared(text, known(("A", "c")), WORDS)[0], ("A", "c")), 1e-6

    def wanted(s: float, v: float, t: float, A: float = 0.7, c: float = 0.35) -> float:  # noqa: N803
        return float(EXAMPLES[text](s, v, t, A, c))

    for s, v, t in STATES:
        found, slopes = law.evaluate([0.7, 0.35], s, v, t), [0.0] * 3
        law.code.slopes([0.7, 0.35], t, s, v, slopes)
        assert found.force == pytest.approx(wanted(s, v, t), rel=1e-13, abs=1e-13)
        of_state = (
            -(wanted(s + h, v, t) - wanted(s - h, v, t)), -(wanted(s, v + h, t) - wanted(s, v - h, t)),
            wanted(s, v, t, A=0.7 + h) - wanted(s, v, t, A=0.7 - h),
            wanted(s, v, t, c=0.35 + h) - wanted(s, v, t, c=0.35 - h),
            wanted(s, v, t + h) - wanted(s, v, t - h),
        )  # fmt: skip
        exact = (found.stiffness, found.damping, *slopes)
        np.testing.assert_allclose(exact, np.array(of_state) / (2 * h), rtol=1e-7, atol=1e-7)


LAWS = (
    'effects.push={type="law",joint="rail",force="where(t > 0.05, F * sin(20 * (t - 0.05)), 0) - c * v - k * s ** 3",'
    'constants={F=6.0,c="damping",k=400.0}}',
    'effects.cogging={type="law",joint="pivot",force="A * sin(12 * s) - 0.01 * tanh(v / 0.2)",constants={A=0.2}}',
    "parameters.damping={nominal=3.0}",
)
START = ("simulation.initial.x.velocity=0.3", "simulation.initial.swing.velocity=-2.0")


def force(t: float, x: float, phi: float, v: float, w: float) -> float:
    return 6.0 * math.sin(20 * (t - 0.05)) * (t > 0.05) - 3.0 * v - 400.0 * x**3


def torque(t: float, x: float, phi: float, v: float, w: float) -> float:
    return 0.2 * math.sin(12 * phi) - 0.01 * math.tanh(w / 0.2)


def test_formulas_move_a_cart_and_a_pole() -> None:
    """Errors fall as the square of the step: the force that sets in has no jump."""
    errors = cart_errors((*START, *LAWS), (0.0, 0.0, 0.3, -2.0), force, torque)(2e-3, 1e-3, 5e-4)
    assert np.all(errors[0] / errors[-1] > 10.0) and np.all(errors[-1] < [3e-6, 3e-5]), errors


def test_formulas_in_every_model() -> None:
    full, components, reduced = (run(cart(*START, *LAWS), model)[1] for model in MODELS)
    assert_close(full, reduced, components, x=2e-4, swing=2e-4, bent=0.03)


def test_a_formula_between_points_is_a_spring() -> None:
    """The force makes the distance larger: -k (s - rest) is the spring of that stiffness."""
    spring = '{type="spring_damper",points=["ground:origin","pole:tip"],stiffness=30.0,damping=0.5,rest=0.4}'
    formula = '{type="law",points=["ground:origin","pole:tip"],force="-30 * (s - 0.4) - 0.5 * v"}'
    for model in ("full", "reduced"):
        scenes = (cart(f"effects.own={own}", "reduction.angles=6") for own in (spring, formula))
        (_, one), (_, other) = (run(scene, model) for scene in scenes)
        assert_alike(one, other, 1e-6)


def test_derivatives_with_a_constant() -> None:
    model = reduced_model(cart(*START, *LAWS, "simulation.duration=0.1"))
    found = differentiate(model, model.scene.values, ["damping"])
    wanted = differences(model, "damping", 1e-3)
    for name in ("x", "swing"):
        largest = np.abs(wanted[name]).max()
        np.testing.assert_allclose(found.derivatives[name]["damping"], wanted[name], rtol=0, atol=1e-5 * largest)


@pytest.mark.parametrize(
    ("force", "jumps"),
    [("-c * v * (s < 0.31)", True), ("-c * sign(v)", True), ("where(v > c, 1, 2)", True),
     ("-c * max(s, 0) * (t > 0.1)", False), ("-c * tanh(v / 0.1)", False),
     ("where(s < 2 * c, 3 * (2 * c - s), 0)", False), ("-c * (s - 0.1) * (0.1 <= s)", False),
     ("-c * sign(v) * v**2", False), ("where(s < 2 * c, 3 * (2 * c - s), 1e-3)", True),
     ("-c * (s**2 - v) * (s > v)", True), ("-c * (0 < s < 1)", True), ("where(s < s * c, 0, s)", True),
     ("-c * sign(s + v) * (s + v)", True), ("log(-c) * (s > 0.1)", True), ("c / (s > 0.1)", True),
     ("c + 1 / (s > 0.1)", True), ("where(s < c, c - s, abs(c) - c)", True), ("where(v > 0, sqrt(c * v), 0)", False),
     ("where(s < 500, 0, where(t > 100, c, s - 500))", True)],
)  # fmt: skip
def test_derivatives_say_that_they_leave_out_jumps_that_move(force: str, jumps: bool) -> None:
    """Not those at an instant, which is none of the motion."""
    law = f'{{type="law",joint="rail",force="{force}",constants={{c=1.0}}}}'
    model = SimpleNamespace(name="reduced", scene=cart(f"effects.e={law}"))
    found = [remark.text for remark in difference_remarks(model, 0.0)]
    assert [text.split(":")[0] for text in found] == ["effects.e.force"] * jumps
    cure = Status.NOT_CONVERGED.cure("reduced", model.scene.beyond_steps)
    assert cure.endswith("where none helps effects.e.force written without a jump (max, min, tanh)") == jumps


FORMULA = 'effects.e={type="law",joint="pivot",force='
REFUSED = """
FORMULA"sinn(s)"} -> effects.e.force = "sinn(s)": calls 'sinn', which is no function; did you mean 'sin'?
FORMULA"amplitud * s",constants={amplitude=1.0}} -> \
    effects.e.force = "amplitud * s": names 'amplitud', which is not known; did you mean 'amplitude'?
FORMULA"A * s",constants={A="strength"}} -> effects.e.constants.A = "strength": there is no such parameter
FORMULA"s.real"} -> effects.e.force = "s.real": has 's.real'; a formula has numbers
FORMULA"(lambda: s)()"} -> effects.e.force = "(lambda: s)()": has '(lambda: s)()'
FORMULA"s if t else v"} -> effects.e.force = "s if t else v": has 's if t else v'
FORMULA"s == 1"} -> effects.e.force = "s == 1": has 's == 1'
FORMULA"s # - c * v"} -> effects.e.force = "s # - c * v": has '#'; a formula has numbers
FORMULA"s *"} -> effects.e.force = "s *": is no formula (
FORMULA""} -> effects.e.force = "": is no formula
FORMULA"min(s)"} -> effects.e.force = "min(s)": gives min 1 arguments; it takes 2
FORMULA"9**9**9**9"} -> effects.e.force = "9**9**9**9": has 9 ** 9 ** 9, which is no finite number
FORMULA"1 / (2 - 2) + s"} -> effects.e.force = "1 / (2 - 2) + s": has 1 / (2 - 2), which is no finite number
FORMULA"1",constants={A=1.0}} -> effects.e.constants = { A = 1.0 }: the formula does not name 'A'
FORMULA"v",constants={v=1.0}} -> effects.e.constants = { v = 1.0 }: 'v' cannot be a name in a formula
FORMULA"1",constants={a-b=1.0}} -> effects.e.constants = { a-b = 1.0 }: 'a-b' cannot be a name in a formula
FORMULA"A",constants={A=true}} -> effects.e.constants.A = true: a finite number or the name of a parameter
effects.e={type="law",force="s"} -> effects.e.joint: exactly one of joint, points is needed
effects.e={type="law",joint="rail2",force="s",motion="spin"} -> effects.e.motion = "spin":
effects.e={type="law",joint="pivot",motion="sliding",force="s"} -> effects.e.motion = "sliding": pivot is revolute
"""
DEEP = "atan2(" * 8 + "s" + ", v)" * 8


@pytest.mark.parametrize(("override", "said"), cases(REFUSED.replace("FORMULA", FORMULA)))
def test_what_is_no_formula_is_explained(override: str, said: str) -> None:
    check_said(refusal(cart, override), said, override)


def test_long_and_deep_formulas_are_refused_at_once() -> None:
    for text, said in (("s + " * 400 + "s", "characters"), (DEEP, "too many functions within each other")):
        with pytest.raises(InputError, match=said):
            cart(f'{FORMULA}"{text}"}}')


AT_START = {
    "1 / s": "it is not finite at the start, where s = 0, v = 0 and t = 0",
    "log(s)": "it is not finite at the start",
    "s / (s - s)": "it is not finite at the start",
    "s ** 1.5 + 1 / t": "it is not finite at the start",
}


def test_a_formula_without_a_value_at_the_start_ends_a_command(tmp_path: Path) -> None:
    scene, file = tmp_path / "cart.toml", tmp_path / "o.h5"
    scene.write_text(scene_to_toml(cart()))
    said = {f'{FORMULA}"{text}"}}': f'effects.e.force = "{text}": {words}' for text, words in AT_START.items()}
    said[f'{FORMULA}"sinn(s)"}}'] = 'effects.e.force = "sinn(s)": calls'
    messages = refused(2, [["simulate", scene, "--full", "-o", file, *overridden(entry)] for entry in said])
    assert all(words in message for words, message in zip(said.values(), messages)), messages
