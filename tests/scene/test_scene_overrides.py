"""Changes from the command line: any entry may be replaced, and what is malformed is explained."""

from typing import Any

import pytest

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.scene.loading import apply_overrides, apply_settings


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("a.b=2", {"a": {"b": 2}, "c": 3}),
        (" a . b = 2.5 ", {"a": {"b": 2.5}, "c": 3}),
        ("a={ x = 1 }", {"a": {"x": 1}, "c": 3}),
        ("c=[[0.0, 1.0]]", {"a": {"b": 1}, "c": [[0.0, 1.0]]}),
        ("d.e.f=true", {"a": {"b": 1}, "c": 3, "d": {"e": {"f": True}}}),
        ('a."x=y.z"="p=q"', {"a": {"b": 1, "x=y.z": "p=q"}, "c": 3}),
        ("a.b='x.msh'", {"a": {"b": "x.msh"}, "c": 3}),
    ],
)
def test_an_override_creates_or_replaces(override: str, expected: dict[str, Any]) -> None:
    data: dict[str, Any] = {"a": {"b": 1}, "c": 3}
    apply_overrides(data, ["a.b=7", override] if override.replace(" ", "").startswith("a.b=") else [override])
    assert data == expected  # later ones win


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("b.mesh=x.msh", r"'x.msh' is not a TOML value; text needs quotes, as in --override 'b.mesh=\"text\"'"),
        ("a=", "'' is not a TOML value"),
        ("a=1\nb=2", "is not a TOML value"),
        ("a=" + 5000 * "1", "is not a TOML value"),
        ("modes", "dotted.key=VALUE is needed, such as --override reduction.modes=10"),
        ("=3", "'' is not a dotted key of TOML"),
        ("a b=3", "'a b' is not a dotted key of TOML"),
        ("x\na=3", "is not a dotted key of TOML"),
        ("c.d=1", "c is not a table, so it has no key 'd'; override c itself"),
        ('"x y".z.t=1', "\"x y\".z is not a table, so it has no key 't'"),
    ],
)
def test_a_malformed_override_is_explained(override: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        apply_overrides({"c": 3, "x y": {"z": 1}}, [override])
    shown = f"--override {override}: " if len(override) < 300 else f"--override {override[:200]}"
    assert str(caught.value).startswith(shown)
    assert len(str(caught.value)) < 1000


def test_a_setting_is_the_value_of_a_run() -> None:
    data: dict[str, Any] = {"parameters": {"r1": {"nominal": 1.0}}}
    apply_settings(data, ["r1=2", " r1 = 3e-3 "])
    assert data == {"parameters": {"r1": {"nominal": 1.0, "value": 3e-3}}}
    with pytest.raises(InputError, match="no parameter 'r1'; none is defined"):
        apply_settings({}, ["r1=1"])
    for parameters in (3, {"r1": 3}):  # left to the validation
        apply_settings(data := {"parameters": parameters}, ["r1=1"])
        assert data == {"parameters": parameters}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("r1", "--set r1: NAME=VALUE is needed, such as --set r1=5e-3"),
        ("=1", "--set =1: NAME=VALUE is needed"),
        ("r1=thick", "--set r1=thick: 'thick' is not a finite number"),
        ("r1=5 mmm", "--set r1=5 mmm: no such unit; did you mean 'mm'"),
        ("r1=inf m", r"'inf m' is not a finite number; a number of the scene's units \(m, kg and s\), or one with its"),
        ("r1=", "--set r1=: '' is not a finite number"),
        ("r1=nan", "--set r1=nan: 'nan' is not a finite number"),
        ("r1=inf", "--set r1=inf: 'inf' is not a finite number"),
        ("r3=1", r"--set r3=1: the scene has no parameter 'r3'; known: r1"),
    ],
)
def test_a_malformed_setting_is_explained(setting: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        apply_settings({"parameters": {"r1": {"nominal": 1.0}}}, [setting])
