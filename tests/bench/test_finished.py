"""Results of finished tasks: kept by their description, taken up again, and refused for another run."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from tradeoffs import small_scene

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.bench import Bench
from pgmp_petsc.bench.choice import choose
from pgmp_petsc.models import FullModel
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.checkpoint import Finished
from pgmp_petsc.scene import Scene
from scenes import meshes_of

RIGID = 'outputs={crank_angle={type="angle", joint="crank_hinge"}}'


def finished(path: Path, scene: Scene, resume: bool, **kind: object) -> Finished:
    return Finished(path / "f.h5", {"command": "test", **kind}, scene, meshes_of(scene), MPI.COMM_SELF, resume)


def test_a_task_is_known_by_its_description(tmp_path: Path) -> None:
    scene = small_scene()
    first = finished(tmp_path, scene, False)
    first.put("task", ("a", 1), {"x": np.arange(3.0)})
    assert first.get("task", ("a", 1)) is None, "what this run has done it knows itself"
    again = finished(tmp_path, scene, True)
    np.testing.assert_array_equal(again.get("task", ("a", 1))["x"], np.arange(3.0))
    assert again.get("task", ("a", 2)) is None and again.get("times", ("a", 1)) is None
    again.remove()
    assert not list(tmp_path.iterdir())


def test_without_resume_it_starts_anew_and_says_so(tmp_path: Path) -> None:
    scene = small_scene()
    finished(tmp_path, scene, False).put("task", 1, {"x": np.zeros(1)})
    anew = finished(tmp_path, scene, False)
    assert anew.get("task", 1) is None and "--resume was not given" in str(anew.remarks[0])


@pytest.mark.parametrize("other", ["kind", "scene"])
def test_another_run_is_refused(tmp_path: Path, other: str) -> None:
    finished(tmp_path, small_scene(), False)
    scene = small_scene("reduction.modes=3") if other == "scene" else small_scene()
    kind = {"quick": True} if other == "kind" else {}
    with pytest.raises(InputError, match=f"belongs to another run: its {'scene' if other == 'scene' else 'quick'}"):
        finished(tmp_path, scene, True, **kind)


GIVEN = (
    "modes=4, static_modes=true, inertia_modes=false, parameter_modes=0, second_order=false, angles=24, "
    'interpolation="spline"'
)


def test_a_build_by_tolerance_does_not_run_its_reference_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = small_scene(f"reduction={{tolerance=5e-2, {GIVEN}}}", RIGID)

    def choice(resume: bool):
        kept = finished(tmp_path, scene, resume)
        return choose(scene, meshes_of(scene), RankGroup.split(MPI.COMM_SELF, 1), finished=kept)

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Bench, "processor_times", killed)
        with pytest.raises(KeyboardInterrupt):
            choice(False)
    with monkeypatch.context() as patch:
        patch.setattr(Bench, "processor_times", lambda *_: (0.0, 0.0))
        patch.setattr(Bench, "finer_meshes", lambda *_: None)
        patch.setattr(FullModel, "batch", killed)
        resumed = choice(True)
    whole = choose(scene, meshes_of(scene), RankGroup.split(MPI.COMM_SELF, 1))
    assert resumed.selection.chosen == whole.selection.chosen
    for one, other in zip(resumed.selection.attempts, whole.selection.attempts, strict=True):
        # the eigensolver's random start changes the last digits
        np.testing.assert_allclose(one.errors, other.errors, rtol=1e-6, atol=1e-12)
