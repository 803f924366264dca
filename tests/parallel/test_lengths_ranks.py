"""Lengths as parameters: built and drawn by two ranks as by one, and refused without a hang."""

from pathlib import Path

import numpy as np
from conftest import run_mpi
from length_scenes import BRIEF, PART, SLIDER_CRANK, long_crank
from runs import ONE_RANK, PGMP, full_model, in_turn, overridden, rom_of

from pgmp_petsc.ensemble.integration import run_ensemble
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Ensemble

N, SEED, BATCH = 9, 3, "ensemble.batch=4"


def test_two_ranks_build_and_draw_lengths_as_one_does(tmp_path: Path) -> None:
    path, rom = tmp_path / "scene.toml", tmp_path / "rom.h5"
    path.write_text(SLIDER_CRANK, encoding="utf-8")
    few = ["--seed", str(SEED), *overridden(BATCH)]
    wanted = [
        ["build", str(path), *overridden(*BRIEF), "-o", str(rom)],
        ["montecarlo", str(rom), "-n", str(N), *few, "-o", str(tmp_path / "reduced.h5")],
        ["montecarlo", str(path), "--full", *overridden(*BRIEF), "-n", "3", *few, "-o", str(tmp_path / "full.h5")],
        ["simulate", str(rom), "--set", "rod_length=0.6", "-o", str(tmp_path / "run.h5")],
        ["info", str(rom)],
    ]
    statuses, done = in_turn(2, wanted)
    said = f"{done.stdout}\n{done.stderr}"
    assert statuses == [[0, 0]] * 3 + [[2, 2]] + [[0, 0]], said
    # 3 points, of which one is nominal, and a model between them
    assert "models at 3 points, 3 along each, and one more to compare with, times 5 configurations are 20 eig" in said
    assert "parameters.rod_length.value = 0.6: must lie inside the parameter's bounds" in said
    assert "/lengths/<models of all lengths>/projection" in said

    found, own = ReducedOrderModel.read(rom), rom_of(long_crank(*BRIEF))
    for one, other in zip(found.family.members, own.family.members, strict=True):
        # eigensolvers of one and of two ranks agree to their tolerance
        scale = np.abs(other.tables.stiffness).max()
        np.testing.assert_allclose(one.tables.stiffness, other.tables.stiffness, atol=1e-6 * scale)
    scene = long_crank(*BRIEF, BATCH)
    for name, model, n in (("reduced", ReducedModel(scene, found), N), ("full", full_model(scene), 3)):
        expected = run_ensemble(model, Plan(n, SEED, tmp_path / f"one_{name}.h5"), ONE_RANK)
        several = Ensemble.read(tmp_path / f"{name}.h5")
        np.testing.assert_array_equal(several.parameters["rod_length"], expected.parameters["rod_length"])
        for output, values in expected.outputs.items():
            np.testing.assert_array_equal(several.outputs[output], values)
        words = "contain what they are off by" if name == "reduced" else "each sample has a mechanism of its own"
        assert any(words in remark.text for remark in several.record.remarks)
        assert bool(several.validity) == (name == "reduced") and several.errors
        for kind in ("errors", "validity"):
            for key, values in getattr(expected, kind).items():
                np.testing.assert_array_equal(getattr(several, kind)[key], values)
                # so few steps of a mesh tell nothing of their own error, which is said
                assert np.isfinite(values[:1]).all() or key == "stiffness_lost" or name == "full"


def test_two_ranks_take_angles_and_values_of_the_nominal_lengths_as_one_does(tmp_path: Path) -> None:
    """The first rank alone knows the nominal model: points and angles of the others come from it."""
    path, rom = tmp_path / "scene.toml", tmp_path / "rom.h5"
    path.write_text(SLIDER_CRANK, encoding="utf-8")
    settings = (
        "reduction.parameter_modes=2", "reduction.length_points=2", "reduction.second_order=false", "reduction.modes=2",
        "reduction.angles=5", PART,
    )  # fmt: skip
    run_mpi(2, *PGMP, "build", path, *overridden(*settings), "-o", rom)
    found, own = ReducedOrderModel.read(rom), rom_of(long_crank(*settings))
    for one, other in zip(found.family.members, own.family.members, strict=True):
        np.testing.assert_array_equal(one.tables.samples.theta, other.tables.samples.theta)
        assert one.points.n_vectors == other.points.n_vectors == 2
        # eigensolvers of one and of two ranks agree to their tolerance
        for name in ("r1", "rod_length"):
            np.testing.assert_allclose(one.points.values[name], other.points.values[name], rtol=1e-9)
        scale = np.abs(other.tables.stiffness).max()
        np.testing.assert_allclose(one.tables.stiffness, other.tables.stiffness, atol=1e-6 * scale)
