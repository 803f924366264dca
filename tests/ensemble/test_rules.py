"""Rules of --until: what they mean, and where they are wrong."""

import pytest
from refusals import refusal
from runs import paper_scene

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.stopping import Rule, read_rule
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Event

LABEL = 'ensemble.probabilities.behind={output="crank_angle", below=0.0, when="ever"}'


@pytest.fixture(scope="module")
def scene() -> Scene:
    return paper_scene(LABEL, "ensemble.extremes=true")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("std(crank_angle) < 1 %", ("std", "crank_angle", None, 0.01, True)),
        (" mean ( slider_position )+-1e-4 ", ("mean", "slider_position", None, 1e-4, False)),
        ("mean(slider_position)\u00b11e-4", ("mean", "slider_position", None, 1e-4, False)),
        ("mean(slider_position) +- 2 %", ("mean", "slider_position", None, 0.02, True)),
        ("mean(crank_angle.max) < .5%", ("mean", "crank_angle.max", None, 0.005, True)),
        ("P(behind) < 10%", ("P", "behind", None, 0.1, True)),
        (
            "P(slider_deformation < -1.5e-4) +- 0.002",
            ("P", "", Event(output="slider_deformation", below=-1.5e-4), 0.002, False),
        ),
        ("P(crank_angle>3) +- 0.01", ("P", "", Event(output="crank_angle", above=3.0), 0.01, False)),
    ],
)
def test_what_rules_mean(scene: Scene, text: str, expected: tuple) -> None:
    assert read_rule(text, scene) == Rule(text, *expected)


@pytest.mark.parametrize(
    ("text", "place", "expected"),
    [
        ("", 1, "mean, std or P"),
        ("median(crank_angle) < 1 %", 1, "mean, std or P"),
        ("std crank_angle", 5, "'('"),
        ("std(angle) < 1 %", 5, "the name of an output; did you mean 'crank_angle'?"),
        ("std(1) < 1 %", 5, "the name of an output"),
        ("P(crank_angle) < 1 %", 14, "'<' or '>'"),
        ("P(crank_angle < high) +- 0.1", 17, "a number"),
        ("P(nothing) +- 0.1", 3, "an output or a label of ensemble.probabilities"),
        ("std(crank_angle) < 1", 21, "'%'"),
        ("std(crank_angle) < -1 %", 20, "a positive precision"),
        ("P(crank_angle > 1e999) +- 0.1", 17, "0 or a magnitude from 1e-30 to 1e+30"),
        ("P(crank_angle > -1e31) +- 0.1", 17, "0 or a magnitude from 1e-30 to 1e+30"),
        ("std(crank_angle) < 1e999 %", 20, "0 or a magnitude from 1e-30 to 1e+30"),
        ("std(crank_angle) = 1 %", 18, "'<' or '+-'"),
        ("std(crank_angle", 16, "')'"),
        ("std(crank_angle) < 1 % please", 24, "the end"),
        ("mean(crank_angle) +- 1rad", 22, "a number"),
    ],
)
def test_what_is_no_rule_is_marked(scene: Scene, text: str, place: int, expected: str) -> None:
    first, shown, marked = refusal(read_rule, text, scene).splitlines()
    assert first.startswith(f'--until "{text}": expected at character {place}: {expected}')
    assert shown == f"  {text}" and marked == " " * (place + 1) + "^"


def test_extremes_are_quantities_where_they_are_asked_for() -> None:
    with pytest.raises(InputError, match="expected at character 6: the name of an output"):
        read_rule("mean(crank_angle.max) < 1 %", paper_scene())
