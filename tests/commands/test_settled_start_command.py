"""Runs and samples that start from static equilibrium, by the commands; those that have none."""

from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from runs import overridden, pgmp

from pgmp_petsc.results import Ensemble, Trajectory

SCENE = ROOT / "scenes" / "slider_crank.toml"
SHORT = overridden(
    "reduction.modes=2", "reduction.angles=8", "reduction.parameter_modes=0", "simulation.duration=0.004",
    "coordinates.theta.range=[-0.3, 0.6]", "coordinates.theta.periodic=false", "ensemble.checked_share=1.0",
)  # fmt: skip
HELD = overridden("initial.equilibrium=true", "effects.motor.table=[[0.0, 0.5], [1.0, 0.5]]")
# nothing holds a torque on a mechanism without weight
LOST = [*HELD, *overridden('initial.coordinates="free"')]


@pytest.fixture(scope="module")
def rom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("settled") / "rom.h5"
    pgmp("build", SCENE, *SHORT, "-o", path)
    return path


def test_a_built_model_takes_another_start(rom: Path, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    out = pgmp("simulate", rom, *HELD, "-o", path).stdout
    assert "note: the run starts from static deformation with coordinates held at theta = 0 rad" in out
    run = Trajectory.read(path)
    assert run.balance.strain[0] > 0.0 and run.errors is not None
    assert any("starts from static deformation" in remark.text for remark in run.record.remarks)
    # held, the crank turns by nothing
    assert abs(run.outputs["crank_angle"][0]) < 1e-9


@pytest.mark.parametrize("full", [False, True])
def test_a_run_without_equilibrium_is_refused(full: bool, rom: Path, tmp_path: Path) -> None:
    source = [SCENE, "--full", *SHORT] if full else [rom]
    message = pgmp("simulate", *source, *LOST, "-o", tmp_path / "run.h5", status=2).stderr
    for words in ('initial.coordinates = "free"', "no static equilibrium", "N m on theta", 'coordinates = "held"'):
        assert words in message
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("full", [False, True])
def test_samples_without_equilibrium_are_records(full: bool, rom: Path, tmp_path: Path) -> None:
    source, path = [SCENE, "--full", *SHORT] if full else [rom], tmp_path / "samples.h5"
    done = pgmp("montecarlo", *source, *LOST, "-n", 3, "-o", path, status=1)
    assert "Traceback" not in done.stderr
    warned = "3 of 3 samples failed (status 7): no static equilibrium was found to start from"
    assert done.stdout.count(warned) == 1, "said once"
    np.testing.assert_array_equal(Ensemble.read(path).status, 7)


def test_a_prescribed_coordinate_is_not_said_to_be_let_go(tmp_path: Path) -> None:
    """One of two coordinates is prescribed; then both, none of which is let go."""
    rest = "[[0.0, {0}], [0.05, {0}], [0.1, {1}]]"
    left, right = (
        f'effects.{name}_motor={{type="prescribed_motion",coordinate="{name}",table={rest.format(*ends)}}}'
        for name, ends in (("left", (2.0, 2.1)), ("right", (1.1, 1.2)))
    )
    short = ["initial.equilibrium=true", "simulation.duration=0.002", "reduction.static_modes=false"]
    held, started = "the run starts from static deformation with coordinates held at left = 2 rad, right = 1.", []
    scene, path = ROOT / "scenes" / "five_bar.toml", tmp_path / "run.h5"
    for drives, begun in (
        ([], "left={position=2.0},right={position=1.1}"), ([left], "right={position=1.1}"), ([left, right], ""),
    ):  # fmt: skip
        given = overridden(*short, *drives, f"simulation.initial={{{begun}}}")
        out = pgmp("simulate", scene, "--full", *given, "-o", path).stdout
        started += [line for line in out.splitlines() if held in line]
    assert [line.split(" rad")[-1] for line in started] == [", and lets them go", ", and lets right go", ""]
