"""An ensemble whose reduced model breaks down in some samples: it ends, warns, and says what its figures are worth."""

import re
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from runs import pgmp

from pgmp_petsc.api.sources import read_rom
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.results import Ensemble
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.inputs import read_scene

SCENE = Path(__file__).parent / "press_linkage_ensemble.toml"
N, SEED = 64, 0


@pytest.fixture(scope="module")
def rom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("press") / "rom.h5"
    scene, meshes = read_scene(SCENE, (), (), MPI.COMM_SELF, Purpose.BUILD)
    build_rom(scene, meshes, RankGroup.split(MPI.COMM_SELF, 1)).write(path)
    return path


@pytest.fixture(scope="module")
def command(rom: Path) -> tuple[int, str, Ensemble]:
    """Return exit status, output and file of ``pgmp montecarlo``."""
    path = rom.with_name("many.h5")
    done = pgmp("montecarlo", rom, "-n", N, "--seed", SEED, "-o", path, status=1)
    return done.returncode, done.stdout, Ensemble.read(path)


def test_it_ends_with_status_one_and_names_the_models_limit(command: tuple) -> None:
    status, output, ensemble = command
    failed = ensemble.status != Status.FINE
    assert status == 1 and 5 < failed.sum() < N - 5
    np.testing.assert_array_equal(ensemble.status[failed], Status.BROKE_DOWN)
    said = f"{failed.sum()} of {N} samples failed (status 6): its deformation left what the reduced model holds for"
    assert said in output


def test_it_says_that_mean_and_deviation_are_biased_and_where(command: tuple) -> None:
    _, output, ensemble = command
    assert re.search(r"warning: mean, deviation and density .* are biased: they fail mostly at high T \(median", output)
    failed = ensemble.status != Status.FINE
    assert np.median(ensemble.parameters["T"][failed]) > np.median(ensemble.parameters["T"][~failed])
    # the same words are in the file
    assert any("biased" in remark.text for remark in ensemble.record.remarks)
    assert all(str(remark) in output for remark in ensemble.record.remarks)
    for name, statistics in ensemble.statistics.items():
        assert statistics.count == (N if name in ensemble.parameters else N - failed.sum())


def test_the_bounds_of_quantiles_hold_for_what_the_failed_samples_would_have_been(command: tuple, rom: Path) -> None:
    """The full-order model integrates them all; with its outputs in place of those that failed, the bounds hold."""
    _, output, ensemble = command
    scene, meshes = read_scene(SCENE, (), (), MPI.COMM_SELF, Purpose.BUILD)
    full = FullModel(scene, meshes)
    failed = np.flatnonzero(ensemble.status != Status.FINE)
    values = {name: value[failed] for name, value in draw(scene, SEED, 0, N).items()}
    system = full.batch(values, failed.size)
    run = integrate(system, scene.simulation)
    np.testing.assert_array_equal(run.status, Status.FINE)
    for name, found in full.outputs.evaluate(full.observed(system, run.state)).items():
        whole = ensemble.outputs[name].copy()
        whole[failed] = found
        statistics = ensemble.statistics[name]
        quantiles, (low, high) = np.quantile(whole, statistics.probabilities), statistics.quantile_bounds.T
        assert np.all(low <= quantiles) and np.all(quantiles <= high)
        assert np.isfinite(statistics.quantile_bounds).any()
    assert "whatever the failed ones would have been" in output and "no bound above" in output


def test_smaller_steps_save_some_and_change_no_other(command: tuple, rom: Path) -> None:
    _, output, ensemble = command
    scene, found = read_rom(rom, (), (), MPI.COMM_SELF)
    model = ReducedModel(scene, found)
    saved = (ensemble.status == Status.FINE) & (ensemble.steps_divided > 1)
    assert saved.any()
    assert f"{saved.sum()} of {N} samples failed with simulation.step = 0.001 s" in output
    batch = run_batch(model, draw(scene, SEED, 0, N))
    system = model.batch(draw(scene, SEED, 0, N), N)
    plain = integrate(system, scene.simulation)
    np.testing.assert_array_equal(plain.status != Status.FINE, ensemble.steps_divided > 1)
    untouched = plain.status == Status.FINE
    for name, values in model.outputs.evaluate(model.observed(system, plain.state)[..., untouched]).items():
        np.testing.assert_array_equal(batch.outputs[name][untouched], values, err_msg=name)
        # A process that compiles runs other machine code than one that loads what was compiled: their last bits differ,
        # which the steps amplify.
        np.testing.assert_allclose(ensemble.outputs[name][untouched], values, rtol=1e-9, atol=1e-12, err_msg=name)
