"""Angles that a build adds for stress outputs and definite matrices, what it says of them; ranges that it serves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from length_scenes import numbered
from refusals import refusal
from runs import SMALL, built_rom, paper_scene, rom_of
from spatial_beams import pendulum_in_space
from two_coordinates import double_pendulum

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction import angles
from pgmp_petsc.reduction.angles import _between, _Halves
from pgmp_petsc.reduction.interpolation import interpolant, samples_for
from pgmp_petsc.reduction.rom import ReducedOrderModel, Served, check_samples, check_served, outside_of
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.tables import indefinite_between
from pgmp_petsc.scene import load_scene, scene_from_toml
from pgmp_petsc.texts.models import report
from scenes import HEADER, RADIUS, slider_crank, tables


def asked(name: str, quantity: str, place: str, body: str) -> str:
    return f'outputs.{name}={{type="stress", body="{body}", quantity="{quantity}", {place}}}'


def wave(theta: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(3.0 * theta), np.exp(np.cos(theta))], axis=-1)


@pytest.mark.parametrize("scheme", ["overhauser", "spline", "spectral"])
@pytest.mark.parametrize(("periodic", "n"), [(True, 16), (True, 17), (False, 17), (False, 16)])
def test_samples_are_predicted_by_the_others_as_the_model_interpolates(scheme: str, periodic: bool, n: int) -> None:
    samples = samples_for(scheme, 0.0, 2.0 * np.pi, n, periodic)
    halves = _Halves.of(SampleGrid((samples,)), 0, scheme)
    found, known = halves.predicted(wave(samples.theta)), halves.known(wave(samples.theta))
    np.testing.assert_allclose(known, wave(halves.theta), rtol=0.0, atol=1e-12)  # of the second turn of 17, too
    off = np.abs(found - known).max()
    if n % 2 == (not periodic):
        half = samples_for(scheme, 0.0, 2.0 * np.pi, (n + 1) // 2, periodic)
        np.testing.assert_allclose(
            found, interpolant(half, wave(half.theta), scheme)(halves.theta), rtol=0.0, atol=1e-12
        )
    theta = np.linspace(0.1, 5.0, 300)
    exact = interpolant(samples, wave(samples.theta), scheme)(theta) - wave(theta)
    assert np.abs(exact).max() < off < 2.0


@pytest.mark.parametrize(("periodic", "n"), [(True, 7), (False, 6)])
def test_too_few_samples_tell_nothing(periodic: bool, n: int) -> None:
    assert _Halves.of(SampleGrid((samples_for("spline", 0.0, 1.0, n, periodic),)), 0, "spline") is None


@pytest.mark.parametrize(("scheme", "periodic"), [("spectral", False), ("spline", False), ("overhauser", True)])
def test_halved_distances_are_samples_that_the_scheme_takes(scheme: str, periodic: bool) -> None:
    few = samples_for(scheme, -1.0, 2.0, 9, periodic)
    many = samples_for(scheme, -1.0, 2.0, 18 if periodic else 17, periodic)
    np.testing.assert_allclose(np.sort(np.append(few.theta, _between(few, scheme))), many.theta, rtol=0.0, atol=1e-14)


def test_scenes_without_stress_outputs_keep_their_angles() -> None:
    rom = rom_of(numbered(0.7))
    assert rom.tables.samples.n == 48 and not rom.record.remarks


def test_outputs_that_two_coordinates_interpolate_badly_are_named() -> None:
    """A grid is not refined by itself: its price is the square."""
    rom = rom_of(double_pendulum(asked("pull", "axial_force", "at=[0.25,0.0]", "upper")))
    (said,) = (remark for remark in rom.record.remarks if "stress outputs" in remark.text)
    assert rom.tables.samples.shape == (8, 8) and said.kind == "warning"
    assert "pull 12.5 %; take more reduction.angles" in said.text


def test_of_few_angles_along_two_coordinates_nothing_is_known() -> None:
    rom = rom_of(double_pendulum(asked("pull", "axial_force", "at=[0.25,0.0]", "upper"), "reduction.angles=6"))
    (said,) = (remark.text for remark in rom.record.remarks if "stress outputs" in remark.text)
    assert "between 36 configurations" in said and "pull not known; take more reduction.angles" in said


def test_angles_that_a_tolerance_finds_are_left_to_it() -> None:
    rod = asked("rod_force", "axial_force", "at=[0.35,0.0]", "rod")
    rom = rom_of(numbered(0.7, rod, "reduction.angles=12", "reduction.sampling_tolerance=10.0"))
    (said,) = (remark.text for remark in rom.record.remarks if "stress outputs" in remark.text)
    assert "between 24 configurations" in said and said.endswith("take a smaller reduction.sampling_tolerance")


def test_angles_that_do_not_help_are_not_added_for_ever(monkeypatch) -> None:
    left = iter((0.5, 0.4, 0.3))
    monkeypatch.setattr(angles, "stress_errors", lambda *_: {"rod_force": next(left)})
    rom = built_rom(numbered(0.7, asked("rod_force", "axial_force", "at=[0.35,0.0]", "rod"), "reduction.angles=12"))
    (said,) = (remark for remark in rom.record.remarks if remark.kind == "warning")
    assert rom.tables.samples.n == 48
    assert "rod_force 30 %; four times the angles left 60 % of that, so that no more were tried" in said.text


def test_an_inertia_force_that_hardly_stresses_a_body_asks_for_no_angles(monkeypatch) -> None:
    """A small force of another sign at every other angle, which nothing interpolates, beside those of the speed."""
    scene = numbered(0.7, asked("rod_force", "axial_force", "at=[0.35,0.0]", "rod"), "reduction.second_order=false")
    of_the_scene = angles._stiffness_and_loads
    for beside, warned in ((0, False), (-1, True)):

        def found(*arguments):
            stiffness, loads, kin = of_the_scene(*arguments)
            small = 1e-5 * loads[:, :, list(kin).index(0)] * np.resize([1.0, -1.0], len(loads))[:, None]
            return stiffness, np.dstack([loads, small]), np.append(kin, beside)

        monkeypatch.setattr(angles, "_stiffness_and_loads", found)
        said = [remark.text for remark in built_rom(scene).record.remarks]
        assert any("stress outputs are off by interpolation" in text for text in said) == warned, said


GEARED = HEADER + tables("""
ground.points: end = [0.24, 0.0]
bodies.pinion: rigid = { mass = 0.8, inertia = 4e-4, points = { hub = [0.0, 0.0] } }
bodies.wheel: rigid = { mass = 4.0, inertia = 1.2e-2, points = { hub = [0.0, 0.0], rim = [0.05, 0.0] } };
    placement = { origin = [0.24, 0.0] }
bodies.arm: line = { length = 0.4, elements = 4 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.01 }; placement = { origin = [0.29, 0.0] }
joints.shaft: type = "revolute"; connect = ["ground:origin", "pinion:hub"]
joints.axle: type = "revolute"; connect = ["ground:end", "wheel:hub"]
joints.weld: type = "fixed"; connect = ["wheel:rim", "arm:hinge"]
joints.mesh: type = "gear"; joints = ["shaft", "axle"]; ratio = -0.5; elastic = { stiffness = 800.0, damping = 0.05 }
coordinates.theta: joint = "shaft"; range = [-1.0, 5.0]
effects.motor: type = "torque"; joint = "shaft"; table = [[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]
simulation: duration = 0.2; step = 1e-3
""")


def test_a_load_that_moves_a_body_without_bending_it_asks_for_no_angles() -> None:
    """Teeth that give way turn the wheel with all that is on it."""
    root = asked("root", "bending_moment", "group='hinge'", "arm")
    rom = rom_of(scene_from_toml(GEARED, ".", [root, "reduction.angles=48"]))
    assert rom.tables.samples.n == 48 and not [one for one in rom.record.remarks if "stress outputs" in one.text]


def test_a_load_that_moves_another_body_alone_asks_for_no_angles(monkeypatch) -> None:
    """A mount from the wheel to the tip of another arm on it bends that alone; what round-off leaves of the first one
    changes from angle to angle."""
    of_the_scene = angles._stiffness_and_loads

    def of_mounts(*arguments):
        stiffness, loads, kin = of_the_scene(*arguments)
        return stiffness, loads[:, :, kin < 0], kin[kin < 0]

    monkeypatch.setattr(angles, "_stiffness_and_loads", of_mounts)
    # of other frequencies: modes that are cut between two equal ones bend both arms
    arm, blade = (
        f"""line = {{ length = {length}, elements = 4 }}; element = "beam2d"; material = "steel";
    section = {{ shape = "circle", radius = 0.01 }}; placement = {{ origin = [0.05, 0.0] }}"""
        for length in (0.4, 0.36)
    )
    held = HEADER + tables(f"""
bodies.wheel: rigid = {{ mass = 4.0, inertia = 1.2e-2, points = {{ hub = [0.0, 0.0], rim = [0.05, 0.0] }} }}
bodies.arm: {arm}
bodies.blade: {blade}
joints.axle: type = "revolute"; connect = ["ground:origin", "wheel:hub"]
joints.weld: type = "fixed"; connect = ["wheel:rim", "arm:hinge"]
joints.foot: type = "fixed"; connect = ["wheel:rim", "blade:hinge"]
coordinates.theta: joint = "axle"; range = [-1.0, 5.0]
effects.stay: type = "bushing"; points = ["wheel:hub", "blade:tip"]; reference = [[1.0, 0.0]]; stiffness = [2e4, 2e4]
simulation: duration = 0.2; step = 1e-3
""")
    root = asked("root", "bending_moment", "group='hinge'", "arm")
    rom = rom_of(scene_from_toml(held, ".", [root, "reduction.angles=24", "reduction.static_modes=true"]))
    assert rom.tables.samples.n == 24 and not [one for one in rom.record.remarks if "stress outputs" in one.text]


def test_a_force_that_is_not_there_asks_for_no_angles() -> None:
    """Nothing twists a bar that is bent: what round-off leaves changes from angle to angle."""
    twist = asked("twist", "torsion_moment", "at=[0.3,0.0,0.0]", "arm")
    weight = 'effects.weight={type="gravity", direction=[0.0,-1.0,0.0]}'
    scene = pendulum_in_space(twist, weight, "reduction.angles=16", "reduction.static_modes=true")
    rom = rom_of(scene)
    assert rom.tables.samples.n == 16 and not rom.record.remarks


def test_matrices_that_are_indefinite_between_angles_ask_for_more() -> None:
    """Without terms of second order too: of beams of 40 elements, samples at r1 = 3.92 mm broke off at 0.21 s."""
    fine = [f'bodies.{body}.mesh="../meshes/{body}_40.msh"' for body in ("crank", "rod")]
    rom = rom_of(load_scene(ROOT / "scenes" / "slider_crank.toml", ("reduction.second_order=false", *fine)))
    assert rom.tables.samples.n == 96
    assert not [remark for remark in rom.record.remarks if "not positive definite" in remark.text]


def test_quick_vectors_have_further_angles_where_they_are_quick() -> None:
    """Next to the dead centre with the slider furthest out, on both sides of it; other schemes take them everywhere."""
    scene = load_scene(ROOT / "scenes" / "slider_crank.toml", ('reduction.interpolation="spline"',))
    rom, step = rom_of(scene), 2.0 * np.pi / 48
    more = np.setdiff1d(rom.tables.samples.axes[0].theta, step * np.arange(48))
    np.testing.assert_allclose(more, step * np.array([0.5, 1.5, 2.5, 45.5, 46.5, 47.5]), rtol=1e-12)
    assert "54 in place of 48" in " ".join(remark.text for remark in rom.record.remarks)
    everywhere = rom_of(load_scene(ROOT / "scenes" / "slider_crank.toml", ('reduction.interpolation="overhauser"',)))
    assert everywhere.tables.samples.n == 96


SPLINE = 'reduction.interpolation="spline"'
FEW = "reduction.angles=24", "reduction.max_angles=24"  # and no more where these do not do
UNCERTAIN = 'parameters.r1={nominal=5.6e-3, distribution={name="norm", loc=5.6e-3, scale=5.6e-4}}'
EXTENDED = (
    "reduction.modes=3", "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.parameter_modes=2",
)  # fmt: skip


def test_a_basis_that_turns_faster_than_the_angles_follow_is_warned_of(tmp_path: Path) -> None:
    rom = rom_of(slider_crank(UNCERTAIN, *EXTENDED, SPLINE, *FEW))
    assert rom.indefinite.startswith("with 24 angles the interpolated mass matrix is not positive definite at ")
    rom.write(tmp_path / "rom.h5")
    assert ReducedOrderModel.read(tmp_path / "rom.h5").indefinite == rom.indefinite
    assert f"  warning: {rom.indefinite}" in report(rom, tmp_path / "rom.h5")
    sound = rom_of(slider_crank(UNCERTAIN, *EXTENDED, SPLINE, "reduction.angles=48"))
    assert sound.indefinite == "" and "warning" not in report(sound, tmp_path)


def test_parameters_of_forces_alone_give_no_vectors() -> None:
    """Modes are the same at all values: what differs is round-off, which makes no basis, however many the angles."""
    drawn = 'parameters.hard={nominal=2e4, distribution={name="norm", loc=2e4, scale=2e3}}'
    stop = 'effects.stop={type="end_stop", joint="slider", upper=0.99, stiffness="hard"}'
    rom = rom_of(slider_crank(drawn, stop, *EXTENDED, "reduction.angles=24"))
    assert rom.tables.samples.n == 24 and rom.indefinite == ""
    assert rom.points.n_vectors == 0 and rom.points.points == [] and rom.points.missed.tolist() == [0.0]
    assert any("independent at every configuration: 0 in place of 2" in remark.text for remark in rom.record.remarks)


@pytest.mark.parametrize("name", ["mass", "stiffness"])
def test_the_matrix_and_the_parameters_are_named(name: str) -> None:
    tables = rom_of(slider_crank(SPLINE)).tables
    table = getattr(tables, name).copy()
    # one sample out of the way: the spline overshoots beside it
    table[5, :, -1, -1] *= 1e3
    spoilt = replace(tables, **{name: table})
    values = {"r1": np.array([RADIUS, 0.7 * RADIUS])}
    assert indefinite_between(tables, slider_crank(SPLINE), values, 2) == ""
    said = indefinite_between(spoilt, slider_crank(SPLINE), values, 2)
    assert f"the interpolated {name} matrix is not positive definite" in said and "r1 = 0.0056" in said
    assert said.endswith("take more reduction.angles or fewer reduction.modes"), "it is a spline already"
    other = indefinite_between(spoilt, slider_crank('reduction.interpolation="spectral"'), values, 2)
    assert name in other and other.endswith('or reduction.interpolation = "spline"')


DRAWN = (
    *SMALL,
    'parameters.push={nominal=1.0, distribution={name="norm", loc=1.0, scale=0.1}}',
    'effects.motor.scale="push"',
)
NOMINAL, DEVIATION = 5.6e-3, 0.56e-3


@pytest.fixture(scope="module")
def served() -> dict[str, Served]:
    scene = paper_scene(*DRAWN)
    return ReducedModel(scene, rom_of(scene)).served


def test_what_a_build_tries_is_served_and_loads_may_be_anything(served: dict[str, Served]) -> None:
    assert list(served) == ["r1"]
    # quantiles at three standard deviations, half as far again, and three times as far
    ends = [served["r1"].low, served["r1"].high, served["r1"].least, served["r1"].most]
    np.testing.assert_allclose(ends, NOMINAL + DEVIATION * np.array([-4.5, 4.5, -9.0, 9.0]), rtol=1e-4)
    assert check_served(served, paper_scene(*DRAWN)) == ()
    assert check_served(served, paper_scene(*DRAWN, settings=("push=50.0",))) == ()


@pytest.mark.parametrize(
    ("change", "line", "far"),
    [
        ("parameters.r1.value=2.9e-3", "parameters.r1.value = 0.0029: outside [0.00308", False),
        ('parameters.r1.distribution={name="norm", loc=7.5e-3, scale=0.5e-3}', "r1.distribution: 11 % of", False),
        ("parameters.r1.value=11e-3", "0.011: beyond what the model serves, [0.000560039, 0.01064] m", True),
        ('parameters.r1.distribution={name="uniform", loc=10e-3, scale=1.9e-3}', "the greater part beyond what", True),
    ],
)
def test_what_is_outside_is_warned_of_and_far_beyond_refused(served, change: str, line: str, far: bool) -> None:
    if far:
        assert line in refusal(check_served, served, paper_scene(*DRAWN, change))
        return
    (said,) = check_served(served, paper_scene(*DRAWN, change))
    assert said.kind == "warning" and line in said.text and "build with distributions, or bounds" in said.text


def test_samples_are_counted_and_refused_where_they_are_far_beyond(served: dict[str, Served]) -> None:
    values = {"r1": np.array([5e-3, 2.9e-3, 8.5e-3, 6e-3]), "push": np.array([1.0, 9.0, -9.0, 0.0])}
    (said,) = outside_of(served, values, "--samples table.csv")
    assert "--samples table.csv: 2 of 4 samples are outside the range" in said.text and "2 in r1 ([0.00308" in said.text
    check_samples(served, values, "--samples table.csv")
    assert outside_of(served, {"r1": np.array([5e-3])}, "") == () == outside_of(served, {"push": np.zeros(2)}, "")
    with pytest.raises(InputError, match="1 of 2 samples are beyond what the model serves, number 1 with r1 = 0.0115"):
        check_samples(served, {"r1": np.array([5e-3, 11.5e-3])}, "--samples table.csv")


def test_parameters_that_no_range_is_known_of_are_served_near_their_nominal_value() -> None:
    scene = paper_scene(*SMALL, "parameters.r1={nominal=5.6e-3}")
    served = ReducedModel(scene, rom_of(scene)).served["r1"]
    np.testing.assert_allclose([served.low, served.most], [NOMINAL * (1 - 0.45), NOMINAL * 1.9])
