"""Results survive their files, and refuse shapes that do not fit together."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import synthetic
from every_result import LISTINGS, PARTS, RESULTS, listing
from sealed import resealed
from synthetic import assert_same

from pgmp_petsc import results
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.results import Ensemble, Trajectory


@pytest.mark.parametrize("name", RESULTS)
def test_files_are_as_they_were_and_come_back(name: str, tmp_path: Path) -> None:
    """A listing changes only where a file is to change."""
    result = RESULTS[name]()
    result.write(tmp_path / "f.h5")
    assert listing(tmp_path / "f.h5") == (LISTINGS / f"{name}.txt").read_text()
    with type(result).opened(tmp_path / "f.h5") as again:
        assert_same(again, result)


def test_parts_of_reduced_models_are_as_they_were_and_come_back(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        for part in PARTS:
            assert type(part).found_in(file) is None
            part.put(file)
        file.flush()  # readers look at how large the file is
        for part in PARTS:
            assert_same(type(part).found_in(file), part)
    assert listing(tmp_path / "f.h5") == (LISTINGS / "parts.txt").read_text()


@pytest.mark.parametrize(
    "result",
    [
        synthetic.trajectory("reduced", n_frames=0),
        synthetic.ensemble("reduced", 50, n_failed=0),
        synthetic.rare_event(),
        synthetic.tradeoff(n_outputs=1, surfaces=False, refined=False),
    ],
    ids=["without frames", "without failures", "without design points", "short trade-off"],
)
def test_round_trip(result, tmp_path):
    result.write(tmp_path / "f.h5")
    again = type(result).read(tmp_path / "f.h5")
    assert_same(again, result)
    assert not isinstance(result, Trajectory) or list(again.outputs) == list(result.outputs), "the scene's order"


RUN, MANY = synthetic.trajectory(), synthetic.ensemble(n_samples=10)
FRAMES = synthetic.frames(np.linspace(0.0, 1.0, 4))


@pytest.mark.parametrize(
    ("result", "change", "message"),
    [
        (RUN, {"model": "small"}, "model is 'small'; allowed: full, components, reduced"),
        (RUN, {"time": np.zeros((3, 2))}, r"time has shape \(3, 2\); needed: \(time\)"),
        (RUN, {"outputs": {"a": np.zeros(5)}}, r"outputs 'a' has shape \(5,\); needed: \(time: 1001\)"),
        (RUN, {"coordinates": np.zeros(1001)}, r"coordinates has shape"),
        (RUN, {"modal": np.zeros((5, 2))}, r"modal has shape"),
        (FRAMES, {"cells": {}}, "name different bodies"),
        (FRAMES, {"rigid": frozenset({"flywheel"})}, "rigid bodies of frames are none of theirs: flywheel"),
        (FRAMES, {"time": FRAMES.time[:3]}, "positions of 'crank' has shape"),
        (MANY, {"meanings": {0: "fine"}}, r"status \[2\] has no meaning; known: \[0\]"),
        (MANY, {"parameters": {"r1": np.zeros(4)}}, r"outputs 'crank_angle' has shape \(10,\); needed: \(sample: 4\)"),
        (synthetic.statistics(np.arange(9.0)), {"edges": np.zeros(3)}, "edges has shape"),
        (synthetic.modes_table(), {"theta": np.zeros(7)}, "full_hz has shape"),
    ],
)
def test_what_does_not_fit_together_is_refused(result, change, message):
    with pytest.raises(ValueError, match=message):
        replace(result, **change)


def test_a_file_whose_shapes_disagree_is_bad_input(tmp_path):
    synthetic.ensemble(n_samples=9).write(tmp_path / "f.h5")
    with resealed(tmp_path / "f.h5") as file:
        del file["outputs/crank_angle"]
        file["outputs/crank_angle"] = np.zeros(5)
        file["outputs/crank_angle"].attrs["unit"] = "rad"
    with pytest.raises(InputError, match=r"damaged: outputs 'crank_angle' has shape \(5,\); needed: \(sample: 9\)"):
        Ensemble.read(tmp_path / "f.h5")


def test_results_are_imported_by_their_names_when_they_are_asked_for() -> None:
    for name in results.__all__:
        assert getattr(results, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'Trajectories'"):
        _ = results.Trajectories


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("design", "goal", np.zeros(5), r"goal has shape \(5,\); needed: \(2\)"),
        ("rare_event", "curve/probability", np.zeros(5), r"curve/probability has shape \(5,\); needed: \(2\)"),
        ("rare_event", "parameters/r1", np.zeros(5), r"parameters 'r1' has shape \(5,\); needed: \(sample: 6\)"),
        ("ensemble", "corrected/crank_angle/mean_alone_interval", None, "mean_alone_interval' is missing"),
        ("ensemble", "sobol/crank_angle/ST", None, "total Sobol indices and their intervals go together"),
        ("ensemble", "kept/unstable_start", np.zeros(5), r"'unstable_start' has shape \(5,\); needed: \(sample: 12"),
        ("ensemble", "bands/crank_angle/mean", np.zeros(5), r"mean has shape \(5,\); needed: \(time: 21\)"),
        ("trajectory", "fields/bar/points/00001", None, r"deformation has shape \(3, 13, 2\); needed: \(frame: 2"),
        ("trajectory", "fields/bar/at_cells/von_mises", None, "quantities at nodes, in cells and units of a body"),
        ("tradeoff", "settings/angles", None, "/settings lacks angles"),
        ("shard", "columns/status", None, "columns lack 'status'"),
    ],
)
def test_what_does_not_fit_together_is_told(name: str, place: str, value: object, message: str, tmp_path: Path) -> None:
    result, path = RESULTS[name](), tmp_path / "f.h5"
    result.write(path)
    with resealed(path) as file:
        del file[place]
        if value is not None:
            file[place] = value
            file[place].attrs["unit"] = "1"
    with pytest.raises(InputError, match=f"f.h5'.*{message}"), type(result).opened(path):
        pass
