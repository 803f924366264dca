"""The Python interface: what commands compute, bit for bit, on one rank and on two; its errors; its documentation."""

import copy
import json
import logging
import pickle
import re
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pandas
import pytest
import synthetic
from conftest import ROOT, SCRIPTS, run_mpi
from mpi4py import MPI
from refusals import assert_refused, cases
from result_files import KINDS, QUICK, assert_same
from runs import PAPER_SCENE

import pgmp_petsc as pgmp
from pgmp_petsc.api import ranks
from pgmp_petsc.figures.style import save
from pgmp_petsc.scene import Scene, load_scene, scene_from_tables

SCENES = sorted((ROOT / "scenes").glob("*.toml"))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return pgmp.load(PAPER_SCENE, QUICK)


@pytest.fixture(scope="module")
def rom(scene: Scene) -> pgmp.Rom:
    return pgmp.build(scene)


@pytest.fixture(scope="module")
def run(rom: pgmp.Rom) -> pgmp.Result:
    return pgmp.simulate(rom, {"r1": 5e-3})


@pytest.mark.parametrize("kind", [*KINDS, "full"])
def test_files_are_those_of_the_commands(kind: str, commands: Path, scene: Scene, rom, run, tmp_path: Path) -> None:
    make = {
        "rom": lambda: rom, "run": lambda: run, "ensemble": lambda: pgmp.montecarlo(rom, n=12, seed=7),
        "derivatives": lambda: pgmp.sensitivities(rom),
        "full": lambda: pgmp.simulate(scene, {"r1": 5e-3}, model="full"),
    }  # fmt: skip
    written = make[kind]().write(tmp_path / f"{kind}.h5")
    assert_same(written, commands / f"{kind}.h5")
    # and so are those of a result that was read
    assert_same(pgmp.read(commands / f"{kind}.h5").write(tmp_path / "again.h5"), written)


def test_a_scene_is_checked_as_the_command_does(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    found = pgmp.check(scene, effects=True, trial=True, picture=tmp_path / "assembled.png")
    assert found.picture == tmp_path / "assembled.png" and found.picture.stat().st_size > 0
    assert found.trial is None and found.trial_text.endswith("no continuum bodies: nothing to try")
    assert "crank_hinge" in found.text and found.scene.name == scene.name
    assert found.summary()["sizes_of_effects"] is found.sizes and "trial" not in found.summary()
    assert_refused("scene: int received; allowed is a scene", pgmp.check, 3)
    assert_refused("directory .*no.such' does not exist", pgmp.check, scene, picture=tmp_path / "no.such" / "a.png")


def test_an_ensemble_warns_of_errors_that_are_large_in_checked_samples(rom: pgmp.Rom) -> None:
    """Of those alone: shares are the largest error over the largest value of each sample."""
    overrides = {"ensemble.checked_share": 1.0, "ensemble.extremes": True}
    found = pgmp.montecarlo(rom, 8, 7, overrides=overrides)
    (warned,) = (
        one.text for one in found.record.remarks if one.text.startswith("large estimated errors of the samples")
    )
    for name, errors in found.errors.items():
        size = np.maximum(np.abs(found.extremes[f"{name}/max"]), np.abs(found.extremes[f"{name}/min"]))
        told, n = f"{name} ", int(np.sum(errors / size > 0.05))
        assert (told in warned) == (n > 0) and (n == 0 or f"in {n} of 8" in warned.split(told)[1])


def test_results_are_exported_and_filmed(run: pgmp.Result, rom: pgmp.Rom, commands: Path, tmp_path: Path) -> None:
    """As the commands do, which call these functions; of results that have a file."""
    for name in ("run.csv", "run.xdmf"):
        assert pgmp.export_result(commands / "run.h5", tmp_path / name) == tmp_path / name
    assert (tmp_path / "run.csv").read_text().startswith("time (s),")
    assert "run.h5:" in (tmp_path / "run.xdmf").read_text()
    short = pgmp.simulate(rom, overrides={"simulation.frames": 3})
    short.write(tmp_path / "short.h5")
    assert pgmp.animate(short, tmp_path / "short.gif", field="none").stat().st_size > 0


def test_what_the_first_rank_alone_has_is_said(run: pgmp.Result) -> None:
    absent = pgmp.Result("trajectory", None, MPI.COMM_SELF, Path())
    assert repr(absent) == "<pgmp trajectory on the first rank alone>"
    with pytest.raises(AttributeError, match="this trajectory is on the first rank alone"):
        _ = absent.time


@pytest.mark.parametrize("others", ["later", "never"])
def test_a_rank_that_runs_alone_waits_for_nobody(others: str, commands: Path) -> None:
    """PETSc starts on the ranks of a call; the other rank calls the interface later, or never, and the program ends."""
    done = run_mpi(2, SCRIPTS / "interface_apart.py", commands / "rom.h5", others)
    assert done.stdout.splitlines()[-1] == ("same" if others == "later" else "alone")


def test_two_ranks_of_a_script(commands: Path, tmp_path: Path) -> None:
    done = run_mpi(2, SCRIPTS / "python_interface.py", commands / "rom.h5", tmp_path)
    first, second = json.loads(done.stdout.splitlines()[-1])
    assert first == second and first["end"] == first["alone"]
    starts = ("parameters r7=1.0: the scene has no", "nowhere.toml: there is no", "n = 0: allowed", "output file ")
    assert len(first["failures"]) == len(starts)
    for failure, start in zip(first["failures"], starts):
        assert failure.startswith(start)
    for kind in KINDS:
        assert_same(tmp_path / f"{kind}.h5", commands / f"{kind}.h5")


def test_every_name_is_there() -> None:
    for name in pgmp.__all__:
        assert getattr(pgmp, name) is not None and name in dir(pgmp)
    with pytest.raises(AttributeError, match="no attribute 'simulat'; its interface: Scene, "):
        _ = pgmp.simulat


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_a_scene_survives_a_change(path: Path) -> None:
    """What was not given stays open, what was given keeps its value; that of a parameter is the last bit's."""
    before = load_scene(path)
    tables = before.model_dump(exclude_none=True, exclude_unset=True)
    after = scene_from_tables(tables, before.directory)
    assert after == before
    assert after.reduction.model_fields_set == before.reduction.model_fields_set
    assert after.simulation.model_fields_set == before.simulation.model_fields_set


def test_overrides_as_a_mapping_are_those_of_the_command() -> None:
    values = {"reduction.modes": np.int64(5), "scene.name": 'a "b"', "initial.equilibrium": False}
    values["effects.motor.table"] = np.array([[0.0, 0.0], [1.0, 0.5]])
    given = pgmp.load(PAPER_SCENE, values, {"r1": 0.1 * 0.1 * 0.3})
    texts = ["reduction.modes=5", 'scene.name="a \\"b\\""', "initial.equilibrium=false"]
    texts += ["effects.motor.table=[[0.0, 0.0], [1.0, 0.5]]"]
    wanted = load_scene(PAPER_SCENE, texts, ["r1=0.0030000000000000005"])
    assert given == wanted and given.values == {"r1": 0.1 * 0.1 * 0.3}


def test_datasets_have_the_arrays_and_their_units(rom: pgmp.Rom, run: pgmp.Result) -> None:
    data = run.to_xarray()
    assert np.array_equal(data["slider_deformation"].values, run.outputs["slider_deformation"])
    assert data["slider_deformation"].attrs["units"] == "m" and data["time"].attrs["units"] == "s"
    assert np.array_equal(data["state.theta"].values, run.coordinates[:, 0])
    assert data["state.theta"].attrs["units"] == "rad"
    assert data["error.crank_angle"].dims == ("error_time",) and data["energy.kinetic"].attrs["units"] == "J"
    assert data.attrs["scene"] == "slider_crank_paper" and json.loads(data.attrs["parameters"]) == {"r1": 5e-3}

    overrides = ["ensemble.extremes=true"]
    ensemble = pgmp.montecarlo(rom, n=4, seed=1, sampler="latin_hypercube", overrides=overrides)
    data = ensemble.to_xarray()
    assert np.array_equal(data["parameter.r1"].values, ensemble.parameters["r1"]) and dict(data.sizes)["sample"] == 4
    assert np.array_equal(data["max.crank_angle"].values, ensemble.extremes["crank_angle/max"])
    assert np.array_equal(data["mean.crank_angle"].values, ensemble.bands["crank_angle"].mean)
    assert (data["sample.status"] == 0).all() and data.attrs["seed"] == 1
    assert ensemble.scene.ensemble.sampler == "latin_hypercube"

    data = pgmp.sensitivities(rom, ["r1"]).to_xarray()
    assert data["derivative.crank_angle.r1"].attrs["units"] == "rad/m"


def test_a_dataset_of_frequencies(commands: Path) -> None:
    table = synthetic.modes_table()
    data = pgmp.Result("modes", table, MPI.COMM_SELF, Path()).to_xarray()
    assert np.array_equal(data["frequency.full"].values, table.full_hz)
    assert_refused("there is no dataset of a rom", pgmp.read(commands / "rom.h5").to_xarray)


def test_without_xarray(run: pgmp.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    assert_refused("xarray is not installed .pip install", run.to_xarray)


def test_groups_have_names_without_dots(rom: pgmp.Rom, run: pgmp.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    """The arrays of datasets, in a DataTree where the installed xarray has it."""
    ensemble = pgmp.montecarlo(rom, 4, overrides={"ensemble.extremes": True})
    table = pgmp.frequencies(rom.scene, angles=3)
    for result in (run, ensemble, table, pgmp.sensitivities(rom)):
        data, groups, n = result.to_xarray(), result.to_groups(), 0
        for path in groups if isinstance(groups, dict) else [one.path for one in groups.subtree]:
            for name, values in groups[path].data_vars.items():
                kind = "" if path.strip("/") == "output" else path.strip("/").replace("/", ".") + "."
                assert "." not in name and np.array_equal(values, data[f"{kind}{name}"], equal_nan=True)
                n += 1
        assert n == len(data.data_vars)
    assert "theta" in table.to_groups()["frequency"].coords
    assert run.to_groups()["output"]["crank_angle"].dims == ("time",)
    xarray = pytest.importorskip("xarray")
    made = type("DataTree", (), {"from_dict": staticmethod(lambda groups, name: (name, sorted(groups)))})
    monkeypatch.setattr(xarray, "DataTree", made, raising=False)
    assert table.to_groups() == ("modes", ["frequency"])


def test_notebooks_show_what_there_is(scene: Scene, rom: pgmp.Rom, run: pgmp.Result) -> None:
    """A title, parameters with values and units, figures, remarks, and datasets as xarray shows them, folded."""
    shown = {"scene": scene._repr_html_(), "rom": rom._repr_html_(), "run": run._repr_html_()}
    assert "crank (beam2d), rod (beam2d)" in shown["scene"] and "theta (periodic)" in shown["scene"]
    assert "<td" in shown["rom"] and "pgmp rom of scene" in shown["rom"] and "dataset" not in shown["rom"]
    assert all(">r1</td>" in one and ">m</td>" in one for one in shown.values()) and ">0.005</td>" in shown["run"]
    assert f">{run.outputs['crank_angle'][-1]:.6g}</td>" in shown["run"] and "<details>" in shown["run"]
    assert "xr-wrap" in shown["run"] and len(shown["scene"]) < 4000
    ensemble = pgmp.montecarlo(rom, 4)._repr_html_()
    assert "mean interval" in ensemble and "pgmp ensemble of scene" in ensemble
    assert "d crank_angle" in pgmp.sensitivities(rom)._repr_html_()  # remarks
    escaped = pgmp.compose({**scene.model_dump(exclude_none=True), "scene": {"name": "<b>"}}, scene.directory)
    assert "<b>" not in escaped._repr_html_() and "&lt;b&gt;" in escaped._repr_html_()
    absent = pgmp.Result("trajectory", None, MPI.COMM_SELF, Path())
    assert "on the first rank alone" in absent._repr_html_()


def test_results_draw_the_pictures_of_the_command(rom: pgmp.Rom, run: pgmp.Result, tmp_path: Path) -> None:
    run.write(tmp_path / "run.h5")
    pgmp.plot([tmp_path / "run.h5"], tmp_path)
    for name in ("trajectories", "mechanism", "energies"):
        save(run.plot(name), tmp_path / "own.png")
        own, drawn = (matplotlib.image.imread(path) for path in (tmp_path / "own.png", tmp_path / f"{name}.png"))
        assert np.array_equal(own, drawn)
    assert run.plot()._repr_png_().startswith(b"\x89PNG")  # as notebooks show it
    assert run.plot().axes and pgmp.montecarlo(rom, 6).plot().axes and pgmp.sensitivities(rom).plot().axes
    assert_refused("picture = 'film': of this trajectory there are trajectories, mechanism", run.plot, "film")
    assert_refused("plot: there is no picture of a reduced model", rom.plot)


def test_types_are_those_of_the_interface() -> None:
    """Checkers of types see the names that there are when the program runs."""
    text = Path(pgmp.__file__).read_text(encoding="utf-8")
    block = re.search(r"^if TYPE_CHECKING:.*?\n\n", text, re.MULTILINE | re.DOTALL)[0]
    assert {*re.findall(r"(\w+) as \1\b", block), "__version__"} == {*pgmp.__all__}
    assert Path(pgmp.__file__).with_name("py.typed").is_file()


def test_an_output_named_like_an_axis(rom: pgmp.Rom) -> None:
    renamed = {"outputs.mode": {"type": "angle", "joint": "crank_hinge"}}
    assert_refused("'mode' is the name of an axis", pgmp.simulate(rom, overrides=renamed).to_xarray)


def test_a_result_says_what_it_is(rom: pgmp.Rom, run: pgmp.Result) -> None:
    assert repr(rom).startswith("<pgmp rom of scene 'slider_crank_paper'>\n  note: the scene leaves out")
    assert run.scene.values == {"r1": 5e-3} and rom.scene == pgmp.load(PAPER_SCENE, QUICK)
    assert run.summary()["outputs"]["crank_angle"]["at_end"] == run.outputs["crank_angle"][-1]
    assert rom.summary()["modes"] == 4 and rom.frequencies_hz.shape == (24, 4)
    assert "outputs" in dir(run) and "tables" in dir(rom)
    with pytest.raises(AttributeError, match="'Trajectory' object has no attribute 'nothing'"):
        _ = run.nothing
    assert copy.copy(run).time is run.time


def test_a_run_that_stops_early_keeps_what_it_computed(rom: pgmp.Rom) -> None:
    with pytest.raises(pgmp.StoppedRun, match="the error's result holds") as stopped:
        pgmp.simulate(rom, overrides={"effects.motor.table": [[0.0, 0.0], [0.05, 1e4]]})
    found = stopped.value.result
    assert found.status != 0 and 0.0 < found.time[-1] < 0.05 and isinstance(stopped.value, pgmp.RunError)


def test_warnings_are_logged(rom: pgmp.Rom, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "pgmp_petsc"):
        made = pgmp.simulate(rom, overrides={"effects.motor.table": [[0.0, 0.0], [0.05, 300.0]]})
    logged = [record.message for record in caplog.records]
    assert logged == [str(remark) for remark in (*made.scene.remarks, *made.remarks)]
    assert {record.levelname for record in caplog.records} >= {"WARNING"}


def test_results_are_copied_and_pickled(rom: pgmp.Rom, run: pgmp.Result, commands: Path, tmp_path: Path) -> None:
    """Also what the first rank alone has, whose columns stay in a file, and the error of a run that stopped."""
    few = pgmp.montecarlo(rom, 8, output=tmp_path / "few.h5", on_all_ranks=False)
    kinds = (rom, run, few, rom.scene, pgmp.montecarlo(rom, 8), pgmp.sensitivities(rom), pgmp.frequencies(rom.scene))
    for made in (*kinds, pgmp.check(rom.scene), pgmp.contents(commands / "run.h5"), pgmp.StoppedRun("at 1 s", run)):
        for again in (copy.copy(made), copy.deepcopy(made), pickle.loads(pickle.dumps(made))):
            assert type(again) is type(made) and str(again) == str(made)
            if isinstance(made, pgmp.Result):
                assert str(again.summary()) == str(made.summary()) and again.comm.size == made.comm.size
    again = pickle.loads(pickle.dumps(run))
    assert_same(again.write(tmp_path / "again.h5"), run.write(tmp_path / "first.h5"))
    assert_same(pgmp.simulate(pickle.loads(pickle.dumps(rom)), {"r1": 5e-3}).write(tmp_path / "run.h5"), again.path)
    stopped = pickle.loads(pickle.dumps(pgmp.StoppedRun("at 1 s", run)))
    assert stopped.result.outputs.keys() == run.outputs.keys()
    alone = pgmp.Result("trajectory", None, rom.comm, tmp_path)
    assert repr(copy.deepcopy(alone)) == repr(pickle.loads(pickle.dumps(alone))) == repr(alone)


def test_samples_of_a_program(rom: pgmp.Rom, tmp_path: Path) -> None:
    """Tables of all kinds give what the same numbers in a file give."""
    columns = {"r1": np.array([5.2e-3, 5.6e-3, 6e-3, 5.9e-3]), "others": np.zeros(4)}
    frame = pandas.DataFrame(columns)
    frame.to_csv(tmp_path / "samples.csv", index=False)
    wanted = pgmp.montecarlo(rom, samples=tmp_path / "samples.csv")
    rows = np.array(list(zip(*columns.values())), dtype=[("r1", float), ("others", float)])
    for samples in (columns, frame, rows, {"r1": columns["r1"].tolist()}, frame.to_xarray()):
        found = pgmp.montecarlo(rom, samples=samples)
        np.testing.assert_array_equal(found.outputs["crank_angle"], wanted.outputs["crank_angle"])
        assert any(str(remark).startswith("note: samples are those of 'samples'") for remark in found.remarks)
    assert len(pgmp.montecarlo(rom, np.int64(2), samples=columns).status) == 2
    assert pgmp.simulate(rom, overrides=None).outputs.keys() == wanted.outputs.keys()


WRONG = cases("""
pgmp.simulate(3) -> source: int received; allowed is a built model
pgmp.simulate(scene) -> model = None: of a scene there are 'full' and 'components'
pgmp.simulate(rom, model="full") -> model = 'full': the reduced model is built already
pgmp.simulate(rom, {"r7": 1}) -> parameters r7=1.0: the scene has no parameter 'r7'
pgmp.simulate(rom, {"r1": "x"}) -> parameters r1=x: 'x' is not a finite number
pgmp.simulate(rom, "r1=1") -> parameters = 'r1=1': allowed are a mapping
pgmp.simulate(rom, ["r1"]) -> parameters r1:
pgmp.simulate("a", model="half") -> model = 'half': allowed are 'reduced'
pgmp.simulate("nowhere.h5") -> nowhere.h5
pgmp.simulate(PAPER_SCENE) -> 'pgmp build [^ ]*.toml -o ROM.h5', or give model = 'components', or for
pgmp.simulate(rom, overrides="a=1") -> overrides = 'a=1': allowed are a mapping
pgmp.simulate(rom, overrides={"reduction.modes": 5}) -> overrides reduction: 'the reduced model' was
pgmp.montecarlo(rom, n=0) -> n = 0: allowed are whole numbers from 1
pgmp.montecarlo(rom, n=1e3) -> n = 1000.0: allowed are whole numbers
pgmp.montecarlo(rom, 2, seed=-1) -> seed = -1: allowed are whole numbers from 0
pgmp.montecarlo(rom, 2, sampler="x") -> sampler = 'x': allowed are random, latin
pgmp.montecarlo(rom, 2, parameters={"r1": 5e-3}) -> parameters r1=0.005: every sample
pgmp.montecarlo(rom, 2, resume=True) -> resume: without output nothing is kept
pgmp.sensitivities(scene) -> model = None: of a scene there are
pgmp.sensitivities(rom, "r1") -> names = 'r1': allowed is a list
pgmp.sensitivities(rom, ["r7"]) -> names r7: there is no such parameter
pgmp.build(3) -> scene: int received; allowed is a scene
pgmp.build(scene, resume=True) -> resume: without output nothing is kept
pgmp.tradeoff(scene, resume=True) -> resume: without output nothing is kept
pgmp.frequencies(scene, angles=1) -> angles = 1: allowed are whole numbers from 2
pgmp.frequencies(scene, rom=3) -> rom: int received; allowed is a model that was built
pgmp.tradeoff(rom) -> scene: Rom received; allowed is a scene
pgmp.montecarlo(rom) -> n: missing; give the number of samples
pgmp.montecarlo(rom, 2, shard="1/2") -> shard: str received; allowed is pgmp.Shard
pgmp.export_result(pgmp.simulate(rom), "x.csv") -> result: a trajectory without a file; write
pgmp.export_result(3, "x.csv") -> result: int received; allowed is a result
pgmp.animate("x.h5", "x.avi", mode=1) -> output file 'x.avi': a film is named
pgmp.animate("x.h5", "x.gif", field="heat") -> field = 'heat': allowed are
pgmp.animate("x.h5", "x.gif", fps=500.0) -> fps = 500.0: allowed are
pgmp.animate("x.h5", "x.gif", mode=1, at={"theta": "a"}) -> at..theta.. = 'a': allowed are angles
pgmp.animate("x.h5", "x.gif", mode=1, at=[1.0]) -> at: list received
pgmp.animate("x.h5", "x.gif", mode=1.5) -> mode = 1.5: allowed are whole
pgmp.run(scene) -> scene: Scene received; allowed is the name
pgmp.run("x.toml", n=0) -> n = 0: allowed are whole numbers from 1
pgmp.montecarlo(rom, 2, shard=pgmp.Shard(3, 2)) -> shard 3/2: allowed are
pgmp.montecarlo(rom, 2, stopping=pgmp.Stopping("std(x) < 1 %")) -> stopping.until = 'std.x. < 1 %': allowed is a list of rules
pgmp.montecarlo(rom, 2, stopping=pgmp.Stopping(budget=-1)) -> stopping.budget = -1: allowed are numbers above 0 and at most 1e.08 s
pgmp.montecarlo(rom, 2, stopping=60) -> stopping: int received; allowed is pgmp.St
pgmp.montecarlo(rom, 20, correct=["full=9"]) -> correct: list received; allowed is
pgmp.montecarlo(rom, 20, correct=[pgmp.Correction("full", 9.5)]) -> correct full=9.5: allowed are
pgmp.montecarlo(rom, 2, ranks_per_sample=2) -> ranks_per_sample = 2: samples of a reduced model are small
pgmp.montecarlo(rom, 9, shard=pgmp.Shard(1, 2), stopping=pgmp.Stopping(budget=9.0)) -> shard 1/2: budget goes by all
pgmp.montecarlo(rom, samples="none.csv") -> samples none.csv: there is no such
pgmp.retry_failed(rom, rom) -> failed: Rom received; allowed is the file of an
pgmp.rare_event(rom, 3, 500) -> event: int received; allowed is a text
pgmp.rare_event(rom, "x < 1", 500) -> event "x < 1": expected at character 1: an output
pgmp.merge([]) -> files: list received; allowed is a list of names of shards
pgmp.fit(rom, 3) -> measured: int received; allowed is the name of a CSV file
pgmp.fit(rom, "a.csv", noise={"x": 0}) -> noise..x.. = 0: allowed are numbers above 0
pgmp.fit(rom, "a.csv", noise=0.1) -> noise: float received; allowed is a mapping
pgmp.export_model(rom, "a.txt") -> output 'a.txt': a model is exported as
pgmp.export_model(rom, 3) -> output: int received; allowed is the name of a file
pgmp.export_model(rom, "a", fmi=3) -> fmi 3 is for FMUs, and 'a' is none
pgmp.export_model(rom, "a.fmu", fmi=4) -> fmi = 4: allowed are whole numbers from 2 to 3
pgmp.optimize(rom, "minimise nothing") -> nothing
pgmp.optimize(rom, "minimise r1", subject_to="r1 < 1") -> subject_to = 'r1 < 1': allowed is a list
pgmp.optimize(rom, "minimise r1", robust=3) -> robust: int received; allowed is pg
pgmp.optimize(rom, "minimise r1", robust=pgmp.Robust(-1)) -> robust.deviations = -1: allowed are numbers from 0
pgmp.optimize(rom, "minimise r1", robust=pgmp.Robust(1, 1)) -> robust.n = 1: allowed are whole numbers from 2
pgmp.build(scene, ranks_per_angle=2) -> ranks_per_angle = 2: allowed are 1 to 1
pgmp.read("nowhere.h5") -> nowhere.h5
pgmp.compose([1]) -> tables: list received; allowed is a mapping of tables
pgmp.compose({"bodies": 3}) -> bodies = 3: a table is needed
pgmp.simulate(rom, comm=3) -> comm = 3: allowed is a communicator of mpi4py
pgmp.write_report([], "x.html") -> results: list received; allowed is a list
pgmp.simulate(rom, overrides=3) -> overrides = 3: allowed are a mapping
pgmp.simulate(rom, 3) -> parameters = 3: allowed are a mapping
pgmp.optimize(rom, 3) -> goal: int received; allowed is a text such as 'minimise
pgmp.optimize(rom, "minimise r1", subject_to=3) -> subject_to: int received; allowed is a list of constraints, such as
pgmp.simulate(rom, output=3) -> output: int received; allowed is the name of a file
pgmp.simulate(rom, output="") -> output = '': allowed is the name of a file
pgmp.simulate(rom, on_all_ranks="yes") -> on_all_ranks = 'yes': allowed are True
pgmp.montecarlo(rom, samples={"r1": ["a", "b"]}) -> samples: r1, entry 0: str 'a' received; a number is needed
pgmp.montecarlo(rom, samples={"r1": [[5e-3]]}) -> samples: column 'r1' has shape .1, 1.; numbers of shape .N,. are
pgmp.montecarlo(rom, samples=3) -> samples: int received; allowed is a CSV or HDF5 file, a DataFrame
pgmp.montecarlo(rom, samples={"r1": []}) -> samples: columns are empty: r1 0
pgmp.montecarlo(rom, samples={"r2": [1.0]}) -> samples: there is no column 'r1'
pgmp.montecarlo(rom, samples={"r1": [5e-3, -1.0]}) -> samples: sample 1: r1 = -1; must
rom.write(3) -> path: int received; allowed is the name of a file
pgmp.write_report([3], "x.html") -> results: list received; allowed is a list of
""")


@pytest.mark.parametrize(("call", "said"), WRONG)
def test_what_is_wrong_is_said(call: str, said: str, rom: pgmp.Rom, scene: Scene, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(pgmp.InputError, match=said) as caught:
        eval(call, {"pgmp": pgmp, "rom": rom, "scene": scene, "PAPER_SCENE": PAPER_SCENE})
    # arguments are called by their names in Python; commands that messages quote have their options
    assert not re.search(r"(?<![\w-])--?[a-z]", re.sub(r"pgmp (?:[^;,.)]|\.(?=\w))*", "", str(caught.value)))
    assert list(tmp_path.iterdir()) == []


def test_ranks_of_a_call() -> None:
    assert ranks.ranks_of(None) == MPI.COMM_SELF and ranks.ranks_of(MPI.COMM_WORLD) == MPI.COMM_WORLD
    assert_refused("allowed is a communicator", ranks.ranks_of, MPI.COMM_NULL)


def test_arguments_that_a_function_does_not_have_are_said_with_its_name() -> None:
    with pytest.raises(TypeError, match=r"^simulate\(\): too many positional arguments$"):
        pgmp.simulate("rom.h5", {}, {})


def test_the_documentation_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of docs/python.md run in order, as one program on two ranks, in a folder of their own."""
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    assert len(blocks) == text.count("```python")
    (tmp_path / "example.py").write_text("\n".join(blocks), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    done = run_mpi(2, "example.py")
    assert done.stdout.count("did you mean 'height'?") == 2
    assert {"report.html", "run.h5", "report_rom_1.h5"} <= {item.name for item in tmp_path.iterdir()}
