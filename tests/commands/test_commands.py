"""Every command as a user runs it: what it writes, prints and ends with, on one rank and on three."""

import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest
from runs import PAPER_SCENE, SMALL, besides_progress, full_model, history, overridden, paper_scene, pgmp, samples

from pgmp_petsc import __version__
from pgmp_petsc.results import Ensemble, ModesTable, Trajectory

OUTPUTS = ("crank_angle", "slider_position", "slider_deformation")
N_STEPS = 50
SCENE_OPTIONS = overridden(*SMALL)


def made(path: Path, said: str, *words: object) -> Path:
    """Return the file that a command wrote; it said so, and nothing of errors."""
    done = pgmp(*words, "-o", path)
    assert said in done.stdout and besides_progress(done.stderr) == ""
    return path


@pytest.fixture(scope="module")
def rom(folder: Path) -> Path:
    return made(folder / "rom.h5", "24 angles, 4 modes", "build", PAPER_SCENE, *SCENE_OPTIONS)


@pytest.fixture(scope="module")
def reduced(folder: Path, rom: Path) -> Path:
    return made(folder / "reduced.h5", "reduced model, 50 steps to 0.05 s", "simulate", rom)


@pytest.fixture(scope="module")
def full(folder: Path) -> Path:
    words = ("simulate", PAPER_SCENE, "--full", *SCENE_OPTIONS)
    return made(folder / "full.h5", "full model, 50 steps to 0.05 s", *words)


@pytest.fixture(scope="module")
def ensemble(folder: Path, rom: Path) -> Path:
    words = ("montecarlo", rom, "-n", 12, "--seed", 7, "--override", "ensemble.checked_share=1.0")
    return made(folder / "ensemble.h5", "reduced model, 12 samples", *words)


@pytest.fixture(scope="module")
def table(folder: Path, rom: Path) -> Path:
    return made(folder / "modes.h5", "24 angles", "modes", PAPER_SCENE, "--rom", rom, *SCENE_OPTIONS)


def assert_origin(path: Path, seed: int | None = None) -> None:
    """Check what a file says of its own making; what else is in it is in tests/listings."""
    with h5py.File(path) as file:
        assert file.attrs["program_version"] == __version__ and file.attrs["ranks"] == 1
        assert (file.attrs["seed"] == seed) if seed is not None else isinstance(file.attrs["seed"], h5py.Empty)
        scene = tomllib.loads(file.attrs["scene"])
        assert scene["scene"]["name"] == "slider_crank_paper"
        assert scene["reduction"]["modes"] == 4
        assert scene["simulation"]["spectral_radius"] == 0.8, "resolved: with its defaults"
        assert len(file["timings"]) > 0 and all(phase[()] >= 0.0 for phase in file["timings"].values())


def arrays(path: Path, *names: str) -> dict[str, np.ndarray]:
    with h5py.File(path) as file:
        return {name: file[name][()] for name in names}


@pytest.mark.parametrize("kind", ["reduced", "full"])
def test_a_trajectory_keeps_the_contract(kind: str, request: pytest.FixtureRequest, rom: Path) -> None:
    path = request.getfixturevalue(kind)
    assert_origin(rom)
    assert_origin(path)
    data = arrays(path, "time", *(f"outputs/{name}" for name in OUTPUTS))
    for values in data.values():
        assert values.shape == (N_STEPS + 1,) and np.isfinite(values).all()
    assert data["time"][0] == 0.0
    assert data["time"][-1] == pytest.approx(0.05, rel=1e-12)
    assert data["outputs/slider_position"][0] == pytest.approx(1.0, abs=1e-9)
    trajectory = Trajectory.read(path)
    assert trajectory.model == kind
    assert trajectory.frames is not None and trajectory.frames.time[-1] == data["time"][-1]
    assert trajectory.record.parameters == {"r1": 5.6e-3}
    assert (trajectory.modal is not None) == (kind == "reduced")
    assert trajectory.errors.what == {"full": "of the time step", "reduced": "reduced less full-order"}[kind]


def test_a_reduced_run_says_how_wrong_it_is(folder: Path, rom: Path, reduced: Path) -> None:
    with h5py.File(reduced) as file:
        assert file["errors/time"][-1] == pytest.approx(0.05, rel=1e-12)
        for name in OUTPUTS:
            about, largest = file[f"errors/{name}"].attrs, np.abs(file[f"outputs/{name}"][()]).max()
            assert about["share"] == pytest.approx(about["maximum"] / largest, rel=1e-12)
        assert 0.0 < file["validity/elastic_rotation"][()] < 0.01
        assert 0.0 < file["validity/elastic_strain"][()] < 0.01
    path = folder / "silent.h5"
    done = pgmp("simulate", rom, "-o", path, "--override", "simulation.error_indicator=false")
    assert (
        "note: errors were not estimated: simulation.error_indicator = false switches the estimate off" in done.stdout
    )
    silent = Trajectory.read(path)
    assert silent.errors is None and silent.record.remarks[0].kind == "note"
    assert silent.validity == Trajectory.read(reduced).validity, "looked at in every run"
    assert "note: errors were not estimated" in pgmp("info", path).stdout


def test_a_warning_where_bodies_bend_too_far(folder: Path, rom: Path) -> None:
    """Some hundred times the torque; what the full-order equations say of it is in the file."""
    path = folder / "bent.h5"
    table = "effects.motor.table=[[0.0, 0.0], [0.02, 200.0]]"
    done = pgmp("simulate", rom, "-o", path, "--override", table)
    assert Trajectory.read(path).validity["elastic_rotation"] > 0.14
    assert "warning: elastic rotations of " in done.stdout and "beyond 0.14: linear strains" in done.stdout
    again = pgmp("montecarlo", rom, "-n", 2, "-o", folder / "bent_too.h5", "--override", table)
    assert "warning: 2 of 2 samples: elastic rotations of " in again.stdout
    assert "warning: elastic rotations" in pgmp("info", path).stdout


def test_the_full_run_is_that_of_the_model(full: Path) -> None:
    scene = paper_scene(*SMALL)
    expected = history(full_model(scene), samples(scene, 1), 1)[1]
    for name, values in Trajectory.read(full).outputs.items():
        np.testing.assert_allclose(values, expected[name][:, 0], rtol=0, atol=1e-10)


def test_frames_and_outputs_tell_the_same(reduced: Path, full: Path) -> None:
    for path in (reduced, full):
        trajectory = Trajectory.read(path)
        at = np.searchsorted(trajectory.time, trajectory.frames.time)
        np.testing.assert_allclose(
            trajectory.frames.positions["rod"][:, -1, 0], trajectory.outputs["slider_position"][at], rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(
            trajectory.frames.rotations["crank"][:, 0], trajectory.outputs["crank_angle"][at], rtol=0, atol=1e-12
        )


def test_an_ensemble_keeps_the_contract(ensemble: Path) -> None:
    assert_origin(ensemble, seed=7)
    data = arrays(ensemble, "parameters/r1", "status", *(f"outputs/{name}" for name in OUTPUTS))
    for values in data.values():
        assert values.shape == (12,)
    np.testing.assert_array_equal(data["status"], 0)
    with h5py.File(ensemble) as file:
        for name in (*OUTPUTS, "r1"):
            group = file[f"statistics/{name}"]
            values = data[f"outputs/{name}" if name in OUTPUTS else f"parameters/{name}"]
            assert group["mean"][()] == pytest.approx(values.mean(), rel=1e-12)
            assert group["std"][()] == pytest.approx(values.std(ddof=1), rel=1e-9)
            # of 12 samples: no more than these tell
            assert group["edges"].shape == (len(group["pdf"]) + 1,) and 3 <= len(group["pdf"]) <= 12
    assert not ensemble.with_name("ensemble.h5.partial").exists()


def test_a_table_of_modes_keeps_the_contract(table: Path) -> None:
    assert_origin(table)
    data = arrays(table, "theta", "full/frequencies_hz", "reduced/frequencies_hz")
    assert data["theta"].shape == (24,)
    assert data["full/frequencies_hz"].shape == data["reduced/frequencies_hz"].shape == (24, 4)
    # at the sampled angles and nominal parameters, the reduced model has the full model's frequencies
    np.testing.assert_allclose(data["reduced/frequencies_hz"], data["full/frequencies_hz"], rtol=1e-8)
    # published: 64.067 Hz at theta = 0 (method, section 6)
    assert data["full/frequencies_hz"][0, 0] == pytest.approx(64.067, abs=1e-3)


def test_modes_without_a_model_and_at_other_angles(folder: Path) -> None:
    path = folder / "few.h5"
    pgmp("modes", PAPER_SCENE, "-o", path, "--angles", 5, *SCENE_OPTIONS, "--set", "r1=6e-3")
    found = ModesTable.read(path)
    assert found.full_hz.shape == (5, 4) and found.reduced_hz is None
    assert found.record.parameters == {"r1": 6e-3}


def test_check_describes_and_writes_nothing(tmp_path: Path) -> None:
    done = pgmp("check", PAPER_SCENE, *SCENE_OPTIONS, cwd=tmp_path)
    for words in (
        "scene slider_crank", "crank: 6 nodes, 5 elements", "36 nodal", "1 rigid + 4 flexible",
        "motor: torque, 1 load term", "crank_angle (rad)", "memory", "5 constraints",
    ):  # fmt: skip
        assert words in done.stdout, words
    assert list(tmp_path.iterdir()) == []
    silent = pgmp("check", PAPER_SCENE, "--override", "effects={}")
    assert "motor" not in silent.stdout and "effects       none" in silent.stdout


def test_set_and_override_reach_every_command(folder: Path, rom: Path) -> None:
    """A parameter's value and any entry; a model is built at the nominal value whatever is set."""
    checked = pgmp("check", PAPER_SCENE, "--set", "r1=5.0e-3", "--override", 'scene.name="other"')
    assert "scene other" in checked.stdout and "r1 = 0.005" in checked.stdout
    paths = {name: folder / f"set_{name}.h5" for name in ("rom", "reduced", "full", "ensemble")}
    changes = ("--set", "r1=5.0e-3", "--override", "simulation.duration=0.01")
    pgmp("build", PAPER_SCENE, "-o", paths["rom"], *SCENE_OPTIONS, *changes)
    with h5py.File(paths["rom"]) as one, h5py.File(rom) as other:
        np.testing.assert_allclose(one["tables/mass"], other["tables/mass"], rtol=1e-9, atol=1e-12)
    constant = ("--override", "effects.motor.table=[[0.0, 0.4]]")
    pgmp("simulate", rom, "-o", paths["reduced"], *changes, *constant)
    pgmp("simulate", PAPER_SCENE, "--full", "-o", paths["full"], *SCENE_OPTIONS, *changes, *constant)
    one, other = (Trajectory.read(paths[name]) for name in ("reduced", "full"))
    assert one.record.parameters == other.record.parameters == {"r1": 5e-3}
    assert one.time[-1] == other.time[-1] == pytest.approx(0.01)
    assert one.outputs["crank_angle"][-1] == pytest.approx(other.outputs["crank_angle"][-1], rel=0.1)
    uniform = 'parameters.r1.distribution={name="uniform", loc=5e-3, scale=1e-4}'
    others = overridden("simulation.duration=0.01", "ensemble.bins=3", uniform)
    pgmp("montecarlo", rom, "-n", 2, "-o", paths["ensemble"], *others)
    found = Ensemble.read(paths["ensemble"])
    assert np.all((found.parameters["r1"] >= 5e-3) & (found.parameters["r1"] <= 5.1e-3))
    assert found.statistics["crank_angle"].pdf.shape == (3,)


def test_info_tells_what_every_file_holds(rom: Path, reduced: Path, ensemble: Path, table: Path) -> None:
    run = ("trajectory of the reduced model", "/time", "/outputs/crank_angle", "estimated errors", "elastic strain")
    many = ("ensemble of the reduced model", "seed       7", "/status", "12 samples: median, largest")
    told = {rom: ("reduced model", "/tables/mass"), reduced: run, ensemble: many, table: ("table of modes", "/theta")}
    for path, words in told.items():
        printed = pgmp("info", path).stdout
        for word in (*words, "slider_crank", "r1 = 0.0056", "timings", f"pgmp {__version__}"):
            assert word in printed, (path, word)
    assert tomllib.loads(pgmp("info", "--scene", reduced).stdout)["scene"]["name"] == "slider_crank_paper"


def test_options_for_petsc_are_passed_on(folder: Path, rom: Path) -> None:
    path = folder / "monitored.h5"
    short = ("--override", "simulation.duration=0.003")
    done = pgmp("simulate", rom, "-o", path, *short, "--", "-pgmp_ts_ts_monitor", "-log_view")
    assert "3 TS dt 0.001 time 0.003" in done.stdout
    assert "PETSc Performance Summary" in done.stdout or "TSStep" in done.stdout
    other = pgmp("simulate", PAPER_SCENE, "--full", "-o", path, *short, "--", "-pgmp_full_ksp_view")
    assert "mumps" in other.stdout
    # the scene says how long a run is and how it is stepped; of full order: parallel/test_more_ranks_than_work.py
    end = ("--", "-pgmp_ts_ts_max_time", "0.001")
    refused = pgmp("simulate", rom, "-o", folder / "stepped.h5", *end, status=2).stderr
    assert "option -pgmp_ts_ts_max_time 0.001" in refused and not (folder / "stepped.h5").exists()


def test_outputs_effects_and_frames_are_not_required(folder: Path) -> None:
    short = "simulation.frames=0", "simulation.duration=0.003"
    bare = (*SMALL, "outputs={}", "effects={}", *short, "simulation.initial.theta.velocity=1.0")
    pgmp("build", PAPER_SCENE, "-o", folder / "bare_rom.h5", *overridden(*bare))
    pgmp("simulate", PAPER_SCENE, "--full", "-o", folder / "full_bare.h5", *overridden(*short))
    pgmp("simulate", folder / "bare_rom.h5", "-o", folder / "bare.h5")
    assert all(Trajectory.read(folder / f"{name}.h5").frames is None for name in ("bare", "full_bare"))
    pgmp("montecarlo", folder / "bare_rom.h5", "-n", 2, "-o", folder / "bare_e.h5")
    assert Ensemble.read(folder / "bare_e.h5").outputs == {}


def test_one_sample_and_an_output_named_like_a_parameter(folder: Path, rom: Path) -> None:
    short, named = "simulation.duration=0.003", 'outputs.r1={type="position", point="rod:tip", axis="x"}'
    done = pgmp("montecarlo", rom, "-n", 1, "-o", folder / "one.h5", *overridden(short))
    assert besides_progress(done.stderr) == ""
    assert np.isnan(Ensemble.read(folder / "one.h5").statistics["crank_angle"].std)
    assert done.stdout.count("unknown") == 1 + 4 * 3  # in the first line, and in the table
    assert done.stdout.count("note: one sample has no deviation") == 1
    words = ("montecarlo", rom, "-n", 4, "-o", folder / "named.h5", *overridden(short, named))
    assert "outputs.r1" in pgmp(*words, status=2).stderr
