"""Angles that a build adds for its stress outputs, and what it says of them."""

import numpy as np
import pytest
from conftest import ROOT
from length_scenes import numbered
from mpi4py import MPI
from runs import built_rom, rom_of
from spatial_beams import pendulum_in_space
from two_coordinates import double_pendulum

from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction import angles
from pgmp_petsc.reduction.angles import _between, _Halves
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.interpolation import interpolant, samples_for
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.scene import load_scene
from scenes import meshes_of


def asked(name: str, quantity: str, place: str, body: str) -> str:
    """Return the override that adds a stress output."""
    return f'outputs.{name}={{type="stress", body="{body}", quantity="{quantity}", {place}}}'


class Tables:
    """Samples alone."""

    def __init__(self, *axes) -> None:
        self.samples = SampleGrid(axes)


def wave(theta: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(3.0 * theta), np.exp(np.cos(theta))], axis=-1)


@pytest.mark.parametrize("scheme", ["overhauser", "spline", "spectral"])
@pytest.mark.parametrize(("periodic", "n"), [(True, 16), (True, 17), (False, 17), (False, 16)])
def test_samples_are_predicted_by_the_others_as_the_model_interpolates(scheme: str, periodic: bool, n: int) -> None:
    samples = samples_for(scheme, 0.0, 2.0 * np.pi, n, periodic)
    halves, tables = _Halves.of(samples, scheme), Tables(samples)
    found = halves.predicted(tables, 0, wave(samples.theta))
    known = halves.known(tables, 0, wave(samples.theta))
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
    assert _Halves.of(samples_for("spline", 0.0, 1.0, n, periodic), "spline") is None


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


def test_a_force_that_is_not_there_asks_for_no_angles() -> None:
    """Nothing twists a bar that is bent: what round-off leaves changes from angle to angle."""
    twist = asked("twist", "torsion_moment", "at=[0.3,0.0,0.0]", "arm")
    weight = 'effects.weight={type="gravity", direction=[0.0,-1.0,0.0]}'
    scene = pendulum_in_space(twist, weight, "reduction.angles=16", "reduction.static_modes=true")
    with RankGroup.split(MPI.COMM_SELF, 1) as group:
        rom = build_rom(scene, meshes_of(scene), group)
    assert rom.tables.samples.n == 16 and not rom.record.remarks


def test_matrices_that_are_indefinite_between_angles_ask_for_more() -> None:
    """Without terms of second order too: of beams of 40 elements, samples at r1 = 3.92 mm broke off at 0.21 s."""
    fine = [f'bodies.{body}.mesh="../meshes/{body}_40.msh"' for body in ("crank", "rod")]
    rom = rom_of(load_scene(ROOT / "scenes" / "slider_crank.toml", ("reduction.second_order=false", *fine)))
    assert rom.tables.samples.n == 96
    assert not [remark for remark in rom.record.remarks if "not positive definite" in remark.text]
