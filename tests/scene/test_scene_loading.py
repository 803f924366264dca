"""Scenes from files and back: what is read, changed by options, resolved and written, and what cannot be."""

from pathlib import Path
from typing import Any

import pytest
from refusals import assert_refused

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.joints.of_points import PointOnLine, Revolute
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.loading import apply_overrides, apply_settings
from scenes import tables

ROOT = Path(__file__).resolve().parents[2]
SLIDER_CRANK = ROOT / "scenes" / "slider_crank.toml"

MINIMAL = tables("""
scene: name = "pendulum"
materials.steel: E = 210e9; nu = 0.3; rho = 7800
bodies.arm: mesh = "arm.msh"; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.01, height = 0.02 }
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:0"]
coordinates.phi: joint = "hinge"; range = [-1.0, 1.0]
""")


@pytest.fixture(scope="module")
def slider_crank() -> Scene:
    return load_scene(SLIDER_CRANK)


def test_the_shipped_scene_is_the_published_mechanism(slider_crank: Scene) -> None:
    scene = slider_crank
    assert scene.name == "slider_crank"
    assert scene.nominal == scene.values == {"r1": 5.6e-3}
    assert scene.bodies["crank"].section.radius == "r1"
    assert scene.number(scene.bodies["crank"].section.radius) == scene.bodies["rod"].section.radius == 5.6e-3
    assert scene.parameters["r1"].bounds == (1.0e-3, 12.0e-3)
    frozen = scene.parameters["r1"].distribution.frozen
    assert (frozen.mean(), frozen.std()) == pytest.approx((5.6e-3, 0.56e-3), rel=1e-15)
    steel = scene.materials["steel"]
    assert (steel.E, steel.nu, steel.rho) == (210e9, 0.3, 7800.0)
    assert isinstance(scene.joints["elbow"], Revolute)
    assert isinstance(scene.joints["slider"], PointOnLine)
    assert scene.joints["slider"].direction == (1.0, 0.0)
    assert scene.effects["motor"].table == ((0.0, 0.0), (0.25, 0.5), (1.0, 0.5))
    assert list(scene.outputs) == ["crank_angle", "slider_position", "slider_deformation"]
    assert (scene.reduction.modes, scene.reduction.angles) == (3, 48)


def test_the_paper_s_scene_is_the_same_mechanism_with_the_paper_s_reduction(slider_crank: Scene) -> None:
    paper = load_scene(SLIDER_CRANK.with_name("slider_crank_paper.toml"))
    reduction = paper.reduction
    assert (reduction.modes, reduction.angles, reduction.interpolation) == (15, 629, "overhauser")
    assert not (reduction.static_modes or reduction.second_order)
    same = paper.model_dump(exclude={"scene", "reduction", "directory"})
    assert same == slider_crank.model_dump(exclude={"scene", "reduction", "directory"})


def test_defaults(tmp_path: Path) -> None:
    scene = scene_from_toml(MINIMAL, tmp_path)
    assert scene.directory == tmp_path
    assert scene.path_of("arm.msh") == tmp_path / "arm.msh"
    assert scene.ground.positions == {"origin": (0.0, 0.0)}
    assert (scene.parameters, scene.effects, scene.outputs, scene.values) == ({}, {}, {}, {})
    # defaults of entries are on docs/scene_reference.md, which tests/test_handbook.py compares
    assert scene.bodies["arm"].placement is None
    assert not scene.coordinates["phi"].periodic
    assert scene.initial_state("phi").model_dump() == {"position": 0.0, "velocity": 0.0}
    assert isinstance(scene.materials["steel"].rho, float)


def test_the_resolved_scene_reads_back_unchanged(slider_crank: Scene) -> None:
    scene = load_scene(SLIDER_CRANK, ["reduction.modes=7"], ["r1=5e-3"])
    text = scene_to_toml(scene)
    assert scene_from_toml(text, scene.directory) == scene != slider_crank
    assert scene_to_toml(scene_from_toml(text, scene.directory)) == text
    assert "spectral_radius = 0.8" in text and "batch = 512" in text
    assert str(ROOT) not in text
    soft = "joints.elbow.elastic={reference=[[1.0, 0.0]], stiffness=[1e7, 1e7]}"  # has splines by default, in files too
    assert 'interpolation = "spline"' in scene_to_toml(load_scene(SLIDER_CRANK.with_stem("slider_crank_paper"), [soft]))


def test_set_gives_the_value_of_a_run_and_keeps_the_nominal_one() -> None:
    scene = load_scene(SLIDER_CRANK, settings=["r1=6e-3", "r1 = 5e-3"])
    assert scene.values == {"r1": 5e-3}
    assert scene.nominal == {"r1": 5.6e-3}
    assert scene.number("r1") == 5e-3
    again = scene_from_toml(scene_to_toml(scene), scene.directory, settings=["r1=4e-3"])
    assert again.values == {"r1": 4e-3}


def test_a_missing_file(tmp_path: Path) -> None:
    assert_refused(r"nowhere.toml: there is no such scene file$", load_scene, tmp_path / "nowhere.toml")
    (tmp_path / "pendulum.toml").write_text(MINIMAL)
    assert_refused(r"no such scene file; did you mean 'pendulum.toml'\? in ", load_scene, tmp_path / "pendulm.toml")
    with pytest.raises(InputError, match=r"the scene file cannot be read \(Not a directory\)"):
        load_scene(tmp_path / "pendulum.toml" / "scene.toml")
    assert_refused("the scene's text: not valid TOML: .*line 1", scene_from_toml, "a b", ".")


@pytest.mark.parametrize("text", ["[scene]\nname = slider", "[scene]\nname = " + 5000 * "1"])
def test_invalid_toml(tmp_path: Path, text: str) -> None:
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(InputError, match=r"bad.toml: not valid TOML: (.*line 2, column 8|Exceeds the limit)"):
        load_scene(tmp_path / "bad.toml")


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("a.b=2", {"a": {"b": 2}, "c": 3}), (" a . b = 2.5 ", {"a": {"b": 2.5}, "c": 3}),
        ("a={ x = 1 }", {"a": {"x": 1}, "c": 3}), ("c=[[0.0, 1.0]]", {"a": {"b": 1}, "c": [[0.0, 1.0]]}),
        ("d.e.f=true", {"a": {"b": 1}, "c": 3, "d": {"e": {"f": True}}}),
        ('a."x=y.z"="p=q"', {"a": {"b": 1, "x=y.z": "p=q"}, "c": 3}), ("a.b='x.msh'", {"a": {"b": "x.msh"}, "c": 3}),
    ],
)  # fmt: skip
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
    assert_refused("no parameter 'r1'; none is defined", apply_settings, {}, ["r1=1"])
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
        ("simulation.step=1", r"no parameter 'simulation.step'; --override sets entries of the scene"),
    ],
)
def test_a_malformed_setting_is_explained(setting: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        apply_settings({"parameters": {"r1": {"nominal": 1.0}}, "simulation": {"step": 1e-3}}, [setting])
