"""Whole small studies: what is measured, what is recorded when it fails, and what is refused."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from length_scenes import SMALL, long_crank, numbered
from mpi4py import MPI
from runs import full_model, reduced_model
from tradeoffs import LEAST, small_scene, study

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.bench.cases import held_out
from pgmp_petsc.bench.history import floors_of, largest_errors, run_history
from pgmp_petsc.bench.tradeoff import measure_tradeoff
from pgmp_petsc.results import Tradeoff
from pgmp_petsc.scene import load_scene
from scenes import meshes_of

# a part of the revolution: the closure takes less time
LIMITED = 'coordinates.theta={joint="crank_hinge", range=[-0.5, 1.0]}'


@lru_cache(maxsize=1)
def small() -> Tradeoff:
    """Return the study of the small scene."""
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
    run = "reduction.angles=24", "ensemble.batch=16"
    named = long_crank(*SMALL, *run, settings=("rod_length=0.68",))
    number = numbered(0.68, *SMALL, *run, "parameters.rod_length={nominal=0.7}")
    one, other = (
        measure_tradeoff(scene, meshes_of(scene), LEAST, 1000, True, MPI.COMM_SELF) for scene in (named, number)
    )
    assert one.varied == ("r1",)
    # the eigensolver starts from a random vector
    np.testing.assert_allclose(one.errors, other.errors, rtol=1e-5)
    (said,) = [remark.text for remark in one.record.remarks if "settings are compared at" in remark.text]
    assert "rod_length = 0.68, other values with --set; over all lengths a build is 4 of those" in said
    assert not [remark for remark in other.record.remarks if "compared at" in remark.text]


def test_a_reference_that_fails_ends_the_study() -> None:
    # a torque that no step can follow, at every test value
    mad = "effects.motor.table=[[0.0, 1e9]]"
    with pytest.raises(RunError, match=r"the full-order reference: 8 of 8 samples failed, the first \(r1 = 0.004297\)"):
        study(small_scene(LIMITED, mad), LEAST)
