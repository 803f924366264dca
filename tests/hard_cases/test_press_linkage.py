"""A four-bar of slender beams: the linear reduced model is wrong by half, that of second order by some per cent where
bodies follow their shortening at once, and it stops where they do not, in some samples of an ensemble too.

All say so, with what to do, where the run is made, in its file and in `pgmp info`."""

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from runs import ONE_RANK, overridden, pgmp, rom_of, trajectory

from pgmp_petsc.api.sources import Origin
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.scene import Scene, load_scene
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.building import estimate_effects, remarks_on_sizes
from pgmp_petsc.studies.inputs import read_scene

SCENE = Path(__file__).with_name("press_linkage.toml")
SECOND_ORDER = ('effects.stiffening={type="geometric_stiffening"}', 'effects.changing={type="mode_inertia"}')
DYNAMIC = ('effects.stiffening={type="geometric_stiffening", stretching="dynamic"}', SECOND_ORDER[1])


def scene_of(*overrides: str) -> Scene:
    return load_scene(SCENE, overrides, ())


@lru_cache(maxsize=1)
def linear() -> Trajectory:
    return trajectory("reduced", scene_of())


@lru_cache(maxsize=1)
def of_full_order() -> Trajectory:
    return trajectory(FullModel(scene_of(), rom_of(scene_of()).meshes))


def test_the_linear_model_errs_and_warns() -> None:
    """Figures are worth what the warning says: the stiffness changes by a share, and bending by more than a fifth."""
    run = linear()
    full = of_full_order()
    ours, exact = (np.max(np.abs(r.outputs["coupler_bending"])) for r in (run, full))
    late = run.time > 0.45
    difference = np.max(np.abs(run.outputs["coupler_bending"] - full.outputs["coupler_bending"])[late])
    assert run.status == full.status == 0 and full.validity == {}
    assert difference > 0.2 * max(ours, exact), "otherwise this is no hard case"
    assert run.validity["stiffness_gained"] > 0.2
    text = "\n".join(remark.text for remark in run.record.remarks if remark.kind == "warning")
    assert "geometric_stiffening, which the model leaves out, changes the stiffness" in text
    assert "name it in [effects], with mode_inertia, and build again" in text
    assert run.errors.maximum("coupler_bending") > 0.1 * difference, "what is estimated is no small error"


def test_static_stretching_follows_it_to_the_end() -> None:
    """What is left, some seven per cent of the bending, is a tenth of what the linear model leaves."""
    scene = scene_of(*SECOND_ORDER)
    run = trajectory("reduced", scene)
    full = of_full_order()
    assert run.status == 0
    exact = full.outputs["coupler_bending"]
    errors = [np.max(np.abs(r.outputs["coupler_bending"] - exact)) / np.max(np.abs(exact)) for r in (run, linear())]
    assert errors[0] < 0.1 and errors[0] < 0.2 * errors[1]


def test_the_change_of_stiffness_is_that_of_the_size_check() -> None:
    """The rigid mechanism's run gives the largest share at a few instants, the reduced run that at others."""
    scene, meshes = read_scene(SCENE, (), (), MPI.COMM_SELF, Purpose.SIZES)
    sizes = {size.kind: size.share for size in estimate_effects(scene, meshes).sizes}
    found = max(abs(linear().validity[name]) for name in ("stiffness_gained", "stiffness_lost"))
    assert 0.5 < found / sizes["geometric_stiffening"] < 2.0
    texts = [str(remark) for remark in remarks_on_sizes(scene, meshes)]
    assert any(text.startswith("warning: the scene leaves out geometric_stiffening") for text in texts)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of the run of second order with coordinates that stretch bodies, which stops."""
    folder = tmp_path_factory.mktemp("press")
    rom_of(scene_of(*DYNAMIC)).write(folder / "rom.h5")
    pgmp("simulate", folder / "rom.h5", "-o", folder / "run.h5", *overridden("simulation.frames=40"), status=1)
    return folder / "run.h5"


def test_the_model_of_second_order_stops_and_keeps_its_part(stopped: Path, tmp_path: Path, undrawn: None) -> None:
    part = Trajectory.read(stopped)
    assert part.status == Status.BROKE_DOWN and 0.2 < part.time[-1] < 0.5
    assert all(np.isfinite(values).all() for values in part.outputs.values())
    assert part.frames.time[-1] <= part.time[-1] and len(part.frames.time) > 10
    # tried with half the step as well; the file keeps what went further
    assert part.steps_divided in (1, 2) and "down to 1/2" in part.record.remarks[1].text
    np.testing.assert_allclose(part.time, np.arange(part.time.size) * 1e-3 / part.steps_divided, rtol=1e-12)
    why = part.record.remarks[0].text
    limits = (Status.BROKE_DOWN.meaning, "is indefinite from 0.2")
    cures = ("no step helps", "only hides it", 'stretching = "static"', "--full")
    for words in (*limits, *cures):
        assert words in why
    pictures, scenery = ("plot", stopped, "-o", tmp_path), ("export", stopped, "-o", tmp_path / "x.xdmf")
    for command in (("info", stopped), pictures, scenery):
        assert f"warning: {why}" in pgmp(*command).stdout


def test_a_full_order_run_that_fails_keeps_its_part_too(tmp_path: Path, undrawn: None) -> None:
    """A torque that no step of this length follows; the file says so, and every command reads it."""
    table = "effects.motor.table=[[0.0, 0.0], [0.004, 0.0], [0.005, 1e9]]"
    path = tmp_path / "run.h5"
    pgmp("simulate", SCENE, "--full", "-o", path, *overridden(table, "simulation.duration=0.01"), status=1)
    run = Trajectory.read(path)
    assert run.status in (Status.NOT_CONVERGED, Status.NOT_FINITE) and 0.002 < run.time[-1] < 0.01
    assert all(np.isfinite(values).all() for values in run.outputs.values())
    texts = [remark.text for remark in run.record.remarks]
    assert texts[0].startswith("full simulation stopped at 0.0") and Status(run.status).cure("full") in texts[0]
    assert "steps down to 1/8 of simulation.step = 0.001 s" in texts[1]
    assert texts[2] == "errors of the time step were not estimated: the run stopped before its end"
    assert texts[3].startswith("errors of the mesh were not estimated")
    for command in (("info", path), ("plot", path, "-o", tmp_path), ("export", path, "-o", tmp_path / "x.xdmf")):
        assert texts[0] in pgmp(*command).stdout


ENSEMBLE = Path(__file__).parent / "press_linkage_ensemble.toml"
N, SEED = 64, 0


@pytest.fixture(scope="module")
def rom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("press") / "rom.h5"
    scene, meshes = read_scene(ENSEMBLE, (), (), MPI.COMM_SELF, Purpose.BUILD)
    build_rom(scene, meshes, ONE_RANK).write(path)
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
    biased = r"warning: mean, deviation and density .* are biased: failures are mostly at high T \(median"
    assert re.search(biased, output)
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
    scene, meshes = read_scene(ENSEMBLE, (), (), MPI.COMM_SELF, Purpose.BUILD)
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
    model = Origin.of(MPI.COMM_SELF, rom, None, (), ()).prepared(MPI.COMM_SELF)
    scene = model.scene
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
