"""A trade-off study of bodies of cells, killed twice and resumed, leaves the file of one that nothing disturbs."""

from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from combinations import meshes_for, scene_of
from mpi4py import MPI
from tradeoffs import LEAST

from pgmp_petsc.bench.bench import Bench
from pgmp_petsc.bench.tradeoff import measure_tradeoff
from pgmp_petsc.reduction.checkpoint import Finished
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml

# settings of all models, the reference's two runs, and times
SWEEP = replace(LEAST, modes=(1,), component_modes=(2,), reference_halvings=(3, 3))
TIMES = ("timings", "offline", "online", "processor")
OF_TIMES = {"pareto", "advice"}  # what is decided by times


def solid_scene() -> Scene:
    """Return a slider-crank of cells in the plane over a few steps, its torque uncertain."""
    return scene_from_toml(scene_to_toml(scene_of("cells in the plane", "torque")), ".", ("ensemble.batch=4",))


def study(path: Path, scene: Scene, resume: bool) -> dict[str, object]:
    """Measure and write the study; return what its file holds, but times and what follows from them."""
    meshes = meshes_for(scene)
    kept = Finished(path, {"command": "test"}, scene, meshes, MPI.COMM_SELF, resume)
    measure_tradeoff(scene, meshes, SWEEP, 1000, True, MPI.COMM_SELF, kept).write(path)
    kept.remove()
    found: dict[str, object] = {}

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if isinstance(item, h5py.Dataset) and name.split("/")[0] not in TIMES and name not in OF_TIMES:
            found[name] = item[()].tobytes() if item.dtype.kind != "O" else item[()].tolist()

    with h5py.File(path) as file:
        file.visititems(visit)
        return found | {f"@{name}": str(value) for name, value in file.attrs.items() if name != "waiting"}


def killed_after(n: int, monkeypatch: pytest.MonkeyPatch, path: Path, scene: Scene, resume: bool) -> int:
    """Run a study until it has begun n tasks that it does not find finished; return how many pieces are kept."""
    begun = [0]

    def counted(method: str) -> None:
        plain = getattr(Bench, method)

        def call(*arguments: object) -> object:
            begun[0] += 1
            if begun[0] > n:
                raise KeyboardInterrupt
            return plain(*arguments)

        patch.setattr(Bench, method, call)

    with monkeypatch.context() as patch:
        for method in ("_measured", "take_times"):
            counted(method)
        with pytest.raises(KeyboardInterrupt):
            study(path, scene, resume)
    return len(list(path.with_name(f"{path.name}.partial").glob("*.npz")))


def test_killed_and_resumed_it_leaves_the_same_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit by bit but for times: killed among the settings, and again while times were taken."""
    scene = solid_scene()
    first = killed_after(2, monkeypatch, tmp_path / "killed.h5", scene, False)
    second = killed_after(5, monkeypatch, tmp_path / "killed.h5", scene, True)
    assert first == 2 and second > first, "what was finished is kept"
    resumed = study(tmp_path / "killed.h5", scene, True)
    whole = study(tmp_path / "whole.h5", scene, False)
    assert {"errors", "reference/moved", "settings/step", "@reference"} <= whole.keys()
    differing = [name for name in whole if resumed.get(name) != whole[name]]
    assert resumed.keys() == whole.keys() and not differing, differing
    assert not list(tmp_path.glob("*.partial"))
