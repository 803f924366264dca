"""Runs over grids and tables of parameters, and of an ensemble's samples: the numbers of single runs, bit for bit."""

import json
from pathlib import Path

import numpy as np
import pandas
import pytest
import xarray
from refusals import assert_refused, cases

import pgmp_petsc as pgmp
from pgmp_petsc.api import sweeps
from pgmp_petsc.scene import scene_from_toml
from scenes import HEADER, tables

# an arm whose hinge leaves its range where it is pushed by more than 0.4 N m; 70 steps, more than a block of lanes
ARM = HEADER + tables("""
parameters.height: nominal = 8e-3; unit = "m"; bounds = [5e-3, 11e-3];
    distribution = { name = "norm", loc = 8e-3, scale = 0.4e-3 }
parameters.push: nominal = 0.1
parameters.stiff: nominal = 0.2
bodies.arm: line = { length = 0.8, elements = 2 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.02, height = "height" }
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:hinge"]
coordinates.theta: joint = "hinge"; range = [-0.2, 0.2]
effects.motor: type = "torque"; joint = "hinge"; table = [[0.0, 1.0], [1.0, 1.0]]; scale = "push"
effects.spring: type = "spring_damper"; joint = "hinge"; stiffness = "stiff"
reduction: modes = 2; angles = 6; static_modes = true
simulation: duration = 0.7; step = 1e-2
outputs.angle: type = "angle"; joint = "hinge"
outputs.bending: type = "deformation"; point = "arm:tip"; axis = "y"; frame = "body"
""")


@pytest.fixture(scope="module")
def rom() -> pgmp.Rom:
    return pgmp.build(scene_from_toml(ARM, "."))


def assert_single(data: xarray.Dataset, rom: pgmp.Rom, values: dict[str, float], at: dict[str, int]) -> None:
    """Assert that a point of a dataset has what a run of its own has."""
    run, point = pgmp.simulate(rom, values), data.isel(at)
    for name, output in run.outputs.items():
        assert np.array_equal(output, point[name].values) and np.array_equal(run.time, data["time"].values)


def test_a_grid_has_the_numbers_of_single_runs(rom: pgmp.Rom) -> None:
    grid = {"height": np.linspace(6e-3, 1e-2, 4), "stiff": [0.1, 0.2, 0.3], "push": 0.05}
    data = pgmp.simulate(rom, grid)
    assert data["angle"].dims == ("height", "stiff", "time") and data["angle"].shape == (4, 3, 71)
    assert (data["sample.status"] == 0).all() and data["bending"].attrs["units"] == "m"
    assert data["height"].attrs["units"] == "m" and json.loads(data.attrs["parameters"]) == {"push": 0.05}
    assert any("errors were not estimated" in one for one in data.attrs["remarks"])
    for i, height in enumerate(grid["height"]):
        for j, stiff in enumerate(grid["stiff"]):
            assert_single(data, rom, {"height": height, "stiff": stiff, "push": 0.05}, {"height": i, "stiff": j})


TABLE = {"height": np.array([6e-3, 7e-3, 9e-3]), "push": np.array([0.05, 0.1, 0.02])}


@pytest.mark.parametrize(
    ("points", "dimension"),
    [
        ({name: ("case", values) for name, values in TABLE.items()}, "case"),
        (pandas.DataFrame(TABLE), "point"),
        (pandas.DataFrame(TABLE, index=pandas.Index(["a", "b", "c"], name="case")), "case"),
        (xarray.Dataset({name: ("sample", values) for name, values in TABLE.items()}), "sample"),
        (xarray.Dataset({"push": ("height", TABLE["push"])}, {"height": TABLE["height"]}), "height"),
        (xarray.Dataset({f"parameter.{k}": ("n", v) for k, v in TABLE.items()} | {"angle": ("n", [0, 0, 0])}), "n"),
    ],
)
def test_a_table_has_a_point_a_row(points: object, dimension: str, rom: pgmp.Rom) -> None:
    data = pgmp.simulate(rom, points)
    assert data["angle"].dims == (dimension, "time") and np.array_equal(data["push"].values, TABLE["push"])
    assert_single(data, rom, {name: values[2] for name, values in TABLE.items()}, {dimension: 2})
    if dimension == "case" and isinstance(points, pandas.DataFrame):
        assert data["angle"].sel(case="b").shape == (71,)


def test_other_models_and_estimates(rom: pgmp.Rom) -> None:
    """Full-order runs have the numbers of single ones too; errors are estimated where they are asked for."""
    scene = scene_from_toml(ARM, ".")
    data = pgmp.simulate(scene, {"push": [0.05, 0.1]}, model="full")
    single = pgmp.simulate(scene, {"push": 0.1}, model="full")
    assert np.allclose(data["angle"].values[1], single.outputs["angle"], rtol=1e-12, atol=0.0)  # by other factors
    data = pgmp.simulate(rom, {"push": [0.05, 0.1]}, overrides={"ensemble.checked_share": 1.0})
    single = pgmp.simulate(rom, {"push": 0.1})
    assert data["error.angle"].values[1] == pytest.approx(np.abs(single.errors.outputs["angle"]).max(), rel=1e-12)


def test_points_that_fail_are_no_numbers_with_their_status(rom: pgmp.Rom, caplog: pytest.LogCaptureFixture) -> None:
    data = pgmp.simulate(rom, {"push": [0.01, 5.0]})
    assert data["sample.status"].values.tolist() == [0, 3] and np.isfinite(data["angle"].values[0]).all()
    assert np.isnan(data["angle"].values[1]).all() and data["sample.failure_time"].values[1] < 0.7
    assert "left the range" in json.loads(data["sample.status"].attrs["meanings"])["3"]
    said = "1 of 2 runs failed and are not a number, 1 with status 3: a coordinate left the range"
    assert said in caplog.text and any(said in one for one in data.attrs["remarks"])


def test_histories_are_those_of_the_samples(rom: pgmp.Rom, tmp_path: Path) -> None:
    changed = {"simulation.duration": 0.4, "parameters.push.distribution": {"name": "norm", "loc": 0.1, "scale": 0.01}}
    ensemble = pgmp.montecarlo(rom, 20, seed=3, overrides=changed, output=tmp_path / "samples.h5")
    data = pgmp.histories(rom, ensemble, [17, 3])
    assert data["angle"].dims == ("sample", "time") and data["sample"].values.tolist() == [17, 3]
    assert np.array_equal(data["height"].values, ensemble.parameters["height"][[17, 3]])
    for name, ends in ensemble.outputs.items():
        assert np.array_equal(data[name].values[:, -1], ends[[17, 3]])
    assert not any("differ" in one for one in data.attrs["remarks"])
    assert data.identical(pgmp.histories(rom, tmp_path / "samples.h5", np.array([17, 3])))
    # a model of the same tables by name, but with others in it
    other = pgmp.build(scene_from_toml(ARM, "."), overrides={"outputs.angle": {"type": "angle", "joint": "hinge"}})
    assert pgmp.histories(other, ensemble, [0])["angle"].shape == (1, 41)
    ensemble.data.outputs["angle"][5] += 1e-3
    said = pgmp.histories(rom, ensemble, [5]).attrs["remarks"]
    assert any("angle by up to 0.001: this model, machine or version" in one for one in said)


def test_what_memory_cannot_hold_is_refused(rom: pgmp.Rom, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweeps, "free_memory", lambda: 1e3)
    with pytest.raises(pgmp.InputError, match="parameters: 2 points need 6.82e-06 GB .* 1e-06 GB are free; take fewer"):
        pgmp.simulate(rom, {"push": [0.01, 0.02]})


WRONG = cases("""
{"push": [0.1], "r7": [1.0]} -> parameters r7: the scene has no parameter 'r7'
{"push": [0.1, "a"]} -> parameters: push, entry 1: str 'a' received; a number is needed
{"push": [True, True]} -> parameters: push, entry 0: bool True received; a number is needed
{"push": []} -> parameters: there are no points in push {'push': 0}
{"push": [[0.1, 0.2]]} -> parameters: push has shape (1, 2); allowed is a number, a list
{"push": ("x", [[0.1]])} -> parameters: push has shape (1, 1); allowed is a number, a list
{"push": ("x", [0.1]), "stiff": ("x", [0.1, 0.2])} -> parameters: dimensions differ in length or labels: push {'x': 1}
{"push": ("angle", [0.1])} -> parameters: angle is the name of an output, or of time
{"push": ("time", [0.1])} -> parameters: time is the name of an output, or of time
{"height": [6e-3, 1.0]} -> parameters: point 1: height = 1; must lie in parameters.height.bounds
{"push": [np.nan]} -> parameters: point 0: push = nan; a finite number is needed
{"push": [0.1], "stiff": "soft"} -> parameters stiff=soft: 'soft' is not a finite number
{"push": ("stiff", [0.1]), "stiff": 0.3} -> = Dataset
pandas.DataFrame({1: [0.1]}) -> parameters: a column is called 1; allowed are names
pandas.DataFrame({"r7": [0.1]}) -> parameters r7: the scene has no parameter 'r7'
xarray.Dataset() -> parameters: there are no points in it
""")


@pytest.mark.parametrize(("points", "said"), WRONG)
def test_wrong_points_are_named(points: str, said: str, rom: pgmp.Rom) -> None:
    given = eval(points, {"np": np, "pandas": pandas, "xarray": xarray})
    if said == "= Dataset":  # a dimension may have the name of a parameter that has one value
        assert pgmp.simulate(rom, given)["angle"].dims == ("stiff", "time")
        return
    with pytest.raises(pgmp.InputError) as caught:
        pgmp.simulate(rom, given)
    assert str(caught.value).startswith(said)


def test_what_does_not_go_with_points_is_refused(rom: pgmp.Rom, tmp_path: Path) -> None:
    with pytest.raises(pgmp.InputError, match="output: runs over arrays of parameters are a Dataset"):
        pgmp.simulate(rom, {"push": [0.1]}, output=tmp_path / "x.h5")
    ensemble = pgmp.montecarlo(rom, 4)
    for samples, said in (([4], r"samples = \[4\]: allowed are numbers from 0 to 3"), ([], "and not an empty one")):
        assert_refused(said, pgmp.histories, rom, ensemble, samples)
    assert_refused("ensemble: Built received; allowed is an ensemble", pgmp.histories, rom, rom, [0])
    with pytest.raises(pgmp.InputError, match="ensemble: samples of the reduced model; here it is the full one"):
        pgmp.histories(rom.scene, ensemble, [0], model="full")
    stiffer = pgmp.build(scene_from_toml(ARM, "."), overrides={"materials.steel.E": 1e11})
    with pytest.raises(pgmp.InputError, match=r"ensemble: its \[materials\] is not that of the reduced model"):
        pgmp.histories(stiffer, ensemble, [0])
