"""Results survive their files, and refuse shapes that do not fit together."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace

import h5py
import numpy as np
import pytest
import synthetic
from sealed import resealed

from pgmp_petsc import results
from pgmp_petsc.results import Ensemble, Frames, ModesTable, Trajectory
from pgmp_petsc.runtime.errors import InputError


def assert_same(one, other, where: str = "result") -> None:
    """Compare two results down to every number, and the order of names."""
    assert type(one) is type(other), where
    if is_dataclass(one):
        for item in fields(one):
            assert_same(getattr(one, item.name), getattr(other, item.name), f"{where}.{item.name}")
    elif isinstance(one, dict):
        assert set(one) == set(other), where
        for name in one:
            assert_same(one[name], other[name], f"{where}[{name}]")
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, err_msg=where)
    else:
        assert one == other, where


@pytest.mark.parametrize(
    "result",
    [
        synthetic.trajectory("full"),
        synthetic.trajectory("reduced", n_frames=0),
        synthetic.ensemble("full", 100),
        synthetic.ensemble("reduced", 50, n_failed=0),
        synthetic.described(),
        synthetic.modes_table(),
        synthetic.modes_table(reduced=False),
        synthetic.tradeoff(),
        synthetic.tradeoff(n_outputs=1, surfaces=False, refined=False),
    ],
    ids=[
        "full",
        "reduced",
        "full ensemble",
        "reduced ensemble",
        "described ensemble",
        "modes",
        "full modes",
        "trade-off",
        "short trade-off",
    ],
)
def test_round_trip(result, tmp_path):
    result.write(tmp_path / "f.h5")
    assert_same(type(result).read(tmp_path / "f.h5"), result)


def test_outputs_keep_the_order_of_the_scene(tmp_path):
    run = synthetic.trajectory()
    run.write(tmp_path / "f.h5")
    assert list(Trajectory.read(tmp_path / "f.h5").outputs) == list(run.outputs)


def test_names_of_the_contract(tmp_path):
    synthetic.trajectory("reduced").write(tmp_path / "t.h5")
    synthetic.ensemble(n_samples=40).write(tmp_path / "e.h5")
    synthetic.modes_table().write(tmp_path / "m.h5")
    with h5py.File(tmp_path / "t.h5") as file:
        assert file["time"].shape == file["outputs/crank_angle"].shape == (1001,)
        assert file["outputs/slider_deformation"].attrs["unit"] == "m"
        assert file["state/coordinates"].shape == (1001, 1) and file["state/modal"].shape == (1001, 3)
    with h5py.File(tmp_path / "e.h5") as file:
        for name in ("parameters/r1", "outputs/crank_angle", "status"):
            assert file[name].shape == (40,)
        assert np.isnan(file["outputs/crank_angle"][-3:]).all() and file["status"][0] == 0
        names = {"mean", "std", "mean_standard_error", "std_standard_error", "pdf", "edges", "quantiles"}
        names |= {"count", "quantile_bounds", "mean_interval", "std_interval", "quantile_intervals"}
        assert set(file["statistics/crank_angle"]) == names
        assert file["statistics/crank_angle/mean"].shape == ()
        for name, shape in (("mean_interval", (2,)), ("std_interval", (2,)), ("quantile_intervals", (3, 2))):
            assert file[f"statistics/crank_angle/{name}"].shape == shape
    synthetic.described(40).write(tmp_path / "d.h5")
    with h5py.File(tmp_path / "d.h5") as file:
        assert set(file["bands/crank_angle"]) >= {"time", "mean", "std", "quantiles"}
        assert file["bands/crank_angle/quantiles"].shape == (21, 3)
        for name in ("max", "min", "time_of_max"):
            assert file[f"extremes/slider_deformation/{name}"].shape == (40,)
        assert file["probabilities/late/estimate"].shape == () and file["probabilities/late/interval"].shape == (2,)
        indices = file["sobol/crank_angle"]
        assert list(indices.attrs["parameters"]) == ["r1", "push"]
        assert indices["S1"].shape == indices["ST"].shape == (2,)
        assert indices["S1_interval"].shape == indices["ST_interval"].shape == (2, 2)
    with h5py.File(tmp_path / "m.h5") as file:
        assert file["theta"].shape == (200,)
        assert file["full/frequencies_hz"].shape == file["reduced/frequencies_hz"].shape == (200, 6)
    for name in ("t.h5", "e.h5", "d.h5", "m.h5"):
        with h5py.File(tmp_path / name) as file:
            bare = []
            file.visititems(
                lambda path, item: (
                    bare.append(path)
                    if isinstance(item, h5py.Dataset) and not {"unit", "description"} <= set(item.attrs)
                    else None
                )
            )
            assert bare == []


def test_modes_over_two_coordinates(tmp_path):
    table = replace(
        synthetic.modes_table(n_theta=12),
        theta=np.arange(24.0).reshape(2, 12),
        coordinate_units={"theta": "rad", "reach": "m"},
    )
    table.write(tmp_path / "f.h5")
    assert_same(ModesTable.read(tmp_path / "f.h5"), table)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "small"}, "model is 'small'; allowed: full, components, reduced"),
        ({"time": np.zeros((3, 2))}, r"time has shape \(3, 2\); needed: \(any\)"),
        ({"outputs": {"a": np.zeros(5)}}, r"output 'a' has shape \(5,\); needed: \(1001\)"),
        ({"coordinates": np.zeros(1001)}, r"coordinates has shape"),
        ({"modal": np.zeros((5, 2))}, r"modal has shape"),
    ],
)
def test_a_trajectory_that_does_not_fit_together(change, message):
    with pytest.raises(ValueError, match=message):
        replace(synthetic.trajectory(), **change)


def test_frames_that_do_not_fit_together():
    frames = synthetic.frames(np.linspace(0.0, 1.0, 4))
    with pytest.raises(ValueError, match="name different bodies"):
        replace(frames, cells={})
    with pytest.raises(ValueError, match="rigid bodies of frames are none of theirs: flywheel"):
        replace(frames, rigid=frozenset({"flywheel"}))
    with pytest.raises(ValueError, match="positions of 'crank' has shape"):
        Frames(frames.time[:3], frames.positions, frames.rotations, frames.nodes, frames.cells)


def test_an_ensemble_that_does_not_fit_together():
    ensemble = synthetic.ensemble(n_samples=10)
    with pytest.raises(ValueError, match=r"status \[2\] has no meaning; known: \[0\]"):
        replace(ensemble, meanings={0: "fine"})
    with pytest.raises(ValueError, match="'r1' has shape"):
        replace(ensemble, parameters={"r1": np.zeros(4)})
    with pytest.raises(ValueError, match="edges has shape"):
        replace(synthetic.statistics(np.arange(9.0)), edges=np.zeros(3))


def test_statistics_of_nothing_have_no_bins():
    empty = np.array([])
    statistics = replace(synthetic.statistics(np.arange(9.0)), pdf=empty, edges=empty)
    assert statistics.edges.shape == (0,)


def test_modes_that_do_not_fit_together():
    with pytest.raises(ValueError, match="full-order frequencies has shape"):
        replace(synthetic.modes_table(), theta=np.zeros(7))


@pytest.mark.parametrize(
    ("result", "dataset"),
    [
        (synthetic.trajectory(n_frames=2), "time"),
        (synthetic.trajectory(n_frames=2), "frames/points/00001"),
        (synthetic.trajectory(n_frames=2), "mesh/body"),
        (synthetic.trajectory(n_frames=2), "state/coordinates"),
        (synthetic.ensemble(n_samples=9), "status"),
        (synthetic.ensemble(n_samples=9), "statistics/crank_angle/edges"),
        (synthetic.modes_table(), "full/frequencies_hz"),
        (synthetic.modes_table(), "theta"),
    ],
)
def test_a_file_that_lacks_a_dataset_is_bad_input(result, dataset, tmp_path):
    result.write(tmp_path / "f.h5")
    with resealed(tmp_path / "f.h5") as file:
        del file[dataset]
    with pytest.raises(InputError, match="f.h5'"):
        type(result).read(tmp_path / "f.h5")


def test_a_file_whose_shapes_disagree_is_bad_input(tmp_path):
    synthetic.ensemble(n_samples=9).write(tmp_path / "f.h5")
    with resealed(tmp_path / "f.h5") as file:
        del file["outputs/crank_angle"]
        file["outputs/crank_angle"] = np.zeros(5)
        file["outputs/crank_angle"].attrs["unit"] = "rad"
    with pytest.raises(InputError, match=r"damaged: 'crank_angle' has shape \(5,\); needed: \(9\)"):
        Ensemble.read(tmp_path / "f.h5")


def test_results_are_imported_by_their_names_when_they_are_asked_for() -> None:
    for name in results.__all__:
        assert getattr(results, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'Trajectories'"):
        _ = results.Trajectories
