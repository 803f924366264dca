"""Trade-off studies: what is measured, what is recorded when it fails, what is refused; what was finished is kept."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np
import pytest
from combinations import meshes_for, scene_of
from length_scenes import BRIEF, long_crank, numbered
from mpi4py import MPI
from runs import ONE_RANK, full_model, reduced_model
from tradeoffs import LEAST, small_scene, study

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.bench.bench import Bench
from pgmp_petsc.bench.choice import choose
from pgmp_petsc.bench.history import floors_of, held_out, largest_errors, run_history
from pgmp_petsc.bench.tradeoff import measure_tradeoff
from pgmp_petsc.models import FullModel
from pgmp_petsc.reduction.checkpoint import Finished
from pgmp_petsc.results import Tradeoff
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml, scene_to_toml
from scenes import meshes_of

# a part of the revolution: the closure takes less time
LIMITED = 'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}'


@lru_cache(maxsize=1)
def small() -> Tradeoff:
    return study(small_scene(LIMITED))


def test_every_setting_has_errors_and_times() -> None:
    result = small()
    assert set(result.families) == {"reduced", "components", "full", "surface"}
    assert result.reasons == ("",) * len(result.families)
    for values in (result.errors, *vars(result.wall).values(), *vars(result.processor).values()):
        assert np.isfinite(values).all() and (values > 0.0).all()
    assert result.pareto.any(axis=0).all()
    assert result.record.ranks == 1 and {"preparation", "times"} <= set(result.record.timings)
    assert (result.batch, result.samples, result.quick) == (16, 1000, True)
    np.testing.assert_array_equal(result.test_values["r1"], held_out(small_scene())[0]["r1"])
    assert result.advice
    # the first setting is the scene's own
    assert result.flags[0] == "" and result.families[0] == "reduced" and result.columns["cosine"][0] < 1.0
    assert [result.columns[name][0] for name in ("modes", "angles", "step", "coordinates")] == [4, 24, 1e-3, 5]
    at, mesh = result.references, result.mesh
    np.testing.assert_array_equal(at.refinement, [1, 2])
    assert at.step[0] <= 1e-3 / 16 and (at.moved < 0.05).all() and all(at.reason)
    np.testing.assert_array_equal([mesh.refinement, mesh.cells], [[1, 2, 4], [4, 8, 16]])
    assert (mesh.errors[0] > mesh.errors[1]).all() and (mesh.errors[2] == 0.0).all()
    with pytest.raises(InputError, match="outputs: the scene has none"):
        study(small_scene(outputs=""))


def test_errors_are_those_of_the_models_against_a_fine_full_order_run() -> None:
    result, scene = small(), small_scene(LIMITED)
    values, n = held_out(scene)
    n_steps = round(scene.simulation.duration / result.references.step[0])
    full = full_model(scene)
    exact, floors = run_history(full, values, n, n_steps), floors_of(full)
    own = run_history(reduced_model(scene), values, n, 20)
    # the eigensolver starts from a random vector
    np.testing.assert_allclose(result.errors[0], largest_errors(own, exact, floors), rtol=1e-6)
    row = result.families.index("full")
    coarse = run_history(full, values, n, 20)
    np.testing.assert_allclose(result.errors[row], largest_errors(coarse, exact, floors), rtol=1e-12)


def test_flags_make_the_setting(tmp_path) -> None:
    result, scene = small(), small_scene(LIMITED)
    path = tmp_path / "scene.toml"
    path.write_text(result.record.scene_toml)
    row = max(range(len(result.families)), key=lambda row: len(result.flags[row].split("--override")))
    overrides = [flag.strip().strip("'") for flag in result.flags[row].split("--override")[1:]]
    changed = load_scene(path, overrides)
    for name in ("modes", "angles", "static_modes", "interpolation", "second_order"):
        assert getattr(changed.reduction, name) == result.columns[name][row]
    assert changed.simulation.step == result.columns["step"][row]
    assert changed.reduction != scene.reduction


def test_a_setting_that_fails_is_recorded_and_the_others_go_on() -> None:
    result = study(small_scene(LIMITED, "reduction.modes=90"), replace(LEAST, tensor_modes=(2,)))
    failed = [row for row, reason in enumerate(result.reasons) if reason]
    assert failed == [row for row, modes in enumerate(result.columns["modes"]) if modes == 90] and 0 in failed
    assert "reduction.modes = 90" in result.reasons[0]
    assert np.isnan(result.errors[failed]).all() and np.isnan(result.wall.batch[failed]).all()
    assert np.isfinite(np.delete(result.errors, failed, axis=0)).all()


def test_leaving_a_limited_range_is_a_reason() -> None:
    fast = "simulation.initial.theta.velocity=120.0"
    result = study(small_scene(LIMITED, fast), replace(LEAST, component_modes=(3,), surfaces=1))
    for family, reason in zip(result.families, result.reasons):
        if family == "reduced":
            assert "left the range" in reason
        else:
            # the rigid mechanism is not known beyond the range, so the deformation ends there; the angle goes on
            assert reason == ""
    assert "take reduced" not in "\n".join(result.advice)


def test_without_uncertain_parameters_the_scenes_values_are_the_test() -> None:
    certain = ("parameters={}", "bodies.crank.section.radius=5e-3", "simulation.duration=0.01")
    result = study(small_scene(LIMITED, *certain), LEAST)
    assert result.test_values == {} and "surface" not in result.families
    assert np.isfinite(result.errors).all()


def test_several_parameters() -> None:
    density = 'parameters.rho={nominal=7.8e3, distribution={name="norm", loc=7.8e3, scale=1e2}}'
    result = study(small_scene(LIMITED, density, 'materials.steel.rho="rho"'), replace(LEAST, surfaces=2))
    assert set(result.test_values) == {"r1", "rho"}
    surfaces = [row for row, family in enumerate(result.families) if family == "surface"]
    assert [result.columns["nodes"][row] for row in surfaces] == [5, 10]
    assert np.isfinite(result.errors[surfaces]).all()
    assert (result.errors[surfaces[1]] < result.errors[surfaces[0]]).all()


def test_a_length_is_held_and_its_study_is_that_of_the_number() -> None:
    named = long_crank(*BRIEF, "ensemble.batch=16", settings=("rod_length=0.68",))
    number = numbered(0.68, *BRIEF, "ensemble.batch=16", "parameters.rod_length={nominal=0.7}")
    one, other = (
        measure_tradeoff(scene, meshes_of(scene), LEAST, 1000, MPI.COMM_SELF, print) for scene in (named, number)
    )
    assert one.varied == ("r1",)
    # the eigensolver starts from a random vector
    np.testing.assert_allclose(one.errors, other.errors, rtol=1e-5)
    (said,) = [remark.text for remark in one.record.remarks if "settings are compared at" in remark.text]
    assert "rod_length = 0.68 m, other values with --set; over all lengths a build is 4 of those" in said
    assert not [remark for remark in other.record.remarks if "compared at" in remark.text]


def test_a_reference_that_fails_ends_the_study() -> None:
    # a torque that no step can follow, at every test value
    mad = "effects.motor.table=[[0.0, 1e9]]"
    with pytest.raises(
        RunError, match=r"the full-order reference: 8 of 8 samples failed, the first \(r1 = 0.004297 m\)"
    ):
        study(small_scene(LIMITED, mad), LEAST)


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
        return choose(scene, meshes_of(scene), ONE_RANK, finished=kept)

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
    whole = choose(scene, meshes_of(scene), ONE_RANK)
    assert resumed.selection.chosen == whole.selection.chosen
    for one, other in zip(resumed.selection.attempts, whole.selection.attempts, strict=True):
        # the eigensolver's random start changes the last digits
        np.testing.assert_allclose(one.errors, other.errors, rtol=1e-6, atol=1e-12)


# settings of all models, the reference's two runs, and times
SWEEP = replace(LEAST, modes=(1,), component_modes=(2,), reference_halvings=(3, 3))
TIMES = ("timings", "offline", "online", "processor")
OF_TIMES = {"pareto", "advice"}  # what is decided by times


def written(path: Path, scene: Scene, resume: bool) -> dict[str, object]:
    """Measure and write the study; return what its file holds, but times and what follows from them."""
    meshes = meshes_for(scene)
    kept = Finished(path, {"command": "test"}, scene, meshes, MPI.COMM_SELF, resume)
    measure_tradeoff(scene, meshes, SWEEP, 1000, MPI.COMM_SELF, print, kept).write(path)
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
            written(path, scene, resume)
    return len(list(path.with_name(f"{path.name}.partial").glob("*.npz")))


def test_killed_and_resumed_it_leaves_the_same_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit by bit but for times: killed among the settings, and again while times were taken."""
    scene = scene_from_toml(scene_to_toml(scene_of("cells in the plane", "torque")), ".", ("ensemble.batch=4",))
    first = killed_after(2, monkeypatch, tmp_path / "killed.h5", scene, False)
    second = killed_after(5, monkeypatch, tmp_path / "killed.h5", scene, True)
    assert first == 2 and second > first, "what was finished is kept"
    resumed = written(tmp_path / "killed.h5", scene, True)
    whole = written(tmp_path / "whole.h5", scene, False)
    assert {"errors", "reference/moved", "settings/step", "@reference"} <= whole.keys()
    differing = [name for name in whole if resumed.get(name) != whole[name]]
    assert resumed.keys() == whole.keys() and not differing, differing
    assert not list(tmp_path.glob("*.partial"))
