"""One reduced model over a range of lengths: frequencies and motion against models that were built at held-out ones."""

from collections.abc import Mapping

import numpy as np
import pytest
from length_scenes import GUIDE, long_crank, numbered
from runs import full_model, history, reduced_model, rom_of, samples

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.models import LengthLanes, ReducedModel, of_samples
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene

HELD_OUT = (0.668, 0.7293)
ACCURATE = ("reduction.angles=20", "simulation.duration=0.1")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return long_crank(*ACCURATE)


@pytest.fixture(scope="module")
def rom(scene: Scene) -> ReducedOrderModel:
    return rom_of(scene)


def frequencies(rom: ReducedOrderModel, values: Mapping[str, float]) -> np.ndarray:
    """Return the reduced frequencies of the modes that the basis was asked for."""
    weights = (evaluate_weights(own, values) for own in (rom.tables.mass_weights, rom.tables.stiffness_weights))
    return rom.tables.frequencies_hz(*weights)[:, : rom.frequencies_hz.shape[1]]


def differences(found: dict[str, np.ndarray], exact: dict[str, np.ndarray], sample: int = 0) -> dict[str, float]:
    """Return the largest difference of every output over time as a share of its largest value."""
    return {
        name: float(np.abs(found[name][:, sample] - values[:, 0]).max() / np.abs(values).max())
        for name, values in exact.items()
    }


def test_frequencies_and_motion_are_those_of_models_that_were_built_with_the_length(scene: Scene, rom) -> None:
    lanes = of_samples(ReducedModel(scene, rom), ["rod_length"])
    assert isinstance(lanes, LengthLanes)
    together = history(lanes, samples(scene, 2, rod_length=np.array(HELD_OUT)), 2)[1]
    for number, length in enumerate(HELD_OUT):
        own = scene.with_values({"rod_length": length})
        model, built = ReducedModel(own, rom), reduced_model(numbered(length, *ACCURATE))
        # the issue's: 1e-4 of frequencies, 0.01 % and 0.5 % of motion; polynomials of degree 4 leave a tenth and less
        np.testing.assert_allclose(frequencies(model.rom, own.values), frequencies(built.rom, own.values), rtol=2e-5)
        exact, alone = (history(one, samples(one.scene, 1), 1)[1] for one in (built, model))
        for found in (differences(alone, exact), differences(together, exact, number)):
            assert found["crank_angle"] < 1e-5 and found["slider_position"] < 1e-6
            assert found["slider_deformation"] < 2e-3
        # exact kinematics and interpolated ones: polynomials leave 6e-9 of the rigid inertia
        for name, values in together.items():
            np.testing.assert_allclose(values[:, number], alone[name][:, 0], atol=1e-6 * np.abs(alone[name]).max())


def test_the_family_says_how_far_off_it_is(scene: Scene, rom: ReducedOrderModel) -> None:
    check = rom.family.check
    assert check.values["rod_length"] not in [point["rod_length"] for point in rom.family.grid.points]
    at = scene.with_values(check.values)
    built = rom_of(numbered(check.values["rod_length"], *ACCURATE))
    found = frequencies(rom.at_lengths(at), scene.nominal) / frequencies(built, scene.nominal) - 1.0
    assert check.frequencies == pytest.approx(np.abs(found).max(), rel=1e-3) and check.frequencies < 1e-4
    assert 0.0 < check.inertia < 1e-7
    (said,) = (remark for remark in rom.record.remarks if remark.text.startswith("lengths: rod_length from 0.665"))
    assert said.kind == "note" and f"{check.frequencies:.2g}" in said.text


def test_full_order_samples_have_meshes_of_their_own(scene: Scene) -> None:
    model = of_samples(full_model(scene), ["rod_length"])
    assert model.largest_batch == 1
    found = history(model, samples(scene, 1, rod_length=np.array([0.68])), 1)[1]
    exact = history(full_model(numbered(0.68, *ACCURATE)), samples(numbered(0.68), 1), 1)[1]
    for name, values in exact.items():
        np.testing.assert_array_equal(found[name], values)


def test_a_place_of_the_ground_is_served_too() -> None:
    plain = (*ACCURATE, "reduction.second_order=false", "reduction.length_points=4", "simulation.duration=0.05")
    scene = long_crank(*plain, *GUIDE)
    lanes = of_samples(reduced_model(scene), ["height"])
    found = history(lanes, samples(scene, 1, height=np.array([0.031])), 1)[1]
    numbers = (GUIDE[0], "ground.points.guide=[0.0, 0.031]", GUIDE[3])
    other = long_crank(*plain, *numbers)
    exact = history(reduced_model(other), samples(other, 1), 1)[1]
    assert differences(found, exact)["slider_position"] < 1e-5
    # the guide's height is what the rod's end stands at, and where it begins follows from it
    start = 0.3 + np.sqrt(0.7**2 - 0.031**2)
    assert found["slider_position"][0, 0] == pytest.approx(start, rel=1e-7)
