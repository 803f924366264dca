"""Outputs over time at common instants, and errors as shares of the largest value."""

from __future__ import annotations

import numpy as np
import pytest
from runs import full_model, reduced_model, samples
from scenes import SLIDER_CRANK

from pgmp_petsc.dynamics.generalised_alpha import count_steps
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.studies.tradeoff_history import history_of, largest_errors, n_instants, step_of, with_steps

OUTPUTS = """
[outputs.crank_angle]
type = "angle"
joint = "crank_hinge"
[outputs.slider_deformation]
type = "deformation"
point = "rod:tip"
axis = "x"
"""


def scene(*overrides: str) -> Scene:
    return scene_from_toml(SLIDER_CRANK + OUTPUTS, ".", ("simulation.duration=0.02", *overrides))


@pytest.mark.parametrize(("duration", "n"), [(1.0, 1000), (1.0, 3), (0.3, 7), (2.0, 1), (0.123456, 100003)])
def test_a_step_gives_its_number_of_steps(duration: float, n: int) -> None:
    assert count_steps(duration, step_of(duration, n)) == n
    assert step_of(1.0, 2000) == 5e-4 and step_of(1.0, 1) == 1.0


def test_instants_are_the_steps_or_an_even_share() -> None:
    assert n_instants(Simulation(duration=1.0, step=1e-3)) == 1000
    assert n_instants(Simulation(duration=1.0, step=1e-4)) == 1250
    assert n_instants(Simulation(duration=1.0, step=1.0 / 3001.0)) == 3001


@pytest.mark.parametrize("make", [full_model, reduced_model])
def test_histories_have_their_instants_in_common(make) -> None:
    model = make(scene())
    values, simulation = samples(model.scene, 3, r1=np.array([5e-3, 5.6e-3, 6e-3])), model.scene.simulation
    own = history_of(model, values, simulation, 20)
    fine = history_of(model, values, with_steps(simulation, 80), 20)
    coarse = history_of(model, values, with_steps(simulation, 10), 20)
    assert own["crank_angle"].shape == fine["crank_angle"].shape == (21, 3)
    assert coarse["crank_angle"].shape == (11, 3)
    (own_angle, _), (coarse_angle, _) = (largest_errors(run, fine) for run in (own, coarse))
    assert 0.0 < own_angle < coarse_angle < 0.05
    one = history_of(model, {name: column[:1] for name, column in values.items()}, simulation, 20)
    # samples do not feel each other
    np.testing.assert_allclose(one["slider_deformation"][:, 0], own["slider_deformation"][:, 0], rtol=1e-9, atol=1e-15)


def test_a_sample_that_fails_is_named() -> None:
    limited = scene(
        "coordinates.theta.range=[0.0, 2.0]",
        "coordinates.theta.periodic=false",
        "simulation.initial.theta.velocity=200.0",
    )
    model = reduced_model(limited)
    message = r"2 of 2 samples failed, the first \(r1 = 0.005\) at 0.01.* s: a coordinate left"
    with pytest.raises(RunError, match=message):
        history_of(model, samples(limited, 2, r1=np.array([5e-3, 6e-3])), limited.simulation, 20)


def test_errors_are_shares_of_each_samples_largest_value() -> None:
    exact = {"a": np.array([[0.0, 0.0], [2.0, -10.0], [1.0, 4.0]])}
    found = {"a": exact["a"] + np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 1.0]])}
    np.testing.assert_allclose(largest_errors(found, exact), [0.1])
    assert largest_errors({"a": exact["a"][::2]}, exact) == [0.0]


def test_errors_of_what_is_zero() -> None:
    zero = {"a": np.zeros((3, 2)), "b": np.array([[0.0, 0.0], [0.0, 4.0], [0.0, 0.0]])}
    found = {"a": zero["a"] + 0.25, "b": zero["b"] + np.array([1.0, 0.0])}
    # "a" in its own unit; the sample of "b" that is zero as a share of the other's largest value
    np.testing.assert_allclose(largest_errors(found, zero), [0.25, 0.25])


def test_instants_without_a_number() -> None:
    nan = np.nan
    exact = {"a": np.array([[1.0], [2.0], [nan]])}
    assert largest_errors({"a": np.array([[1.0], [1.0], [nan]])}, exact) == [0.5]
    assert largest_errors({"a": np.array([[1.0], [1.0], [7.0]])}, exact) == [0.5]
    assert np.isnan(largest_errors({"a": np.array([[1.0], [nan], [7.0]])}, exact)).all()
    assert np.isnan(largest_errors(exact, {"a": np.full((3, 1), nan)})).all()
    long = {"a": np.ones((21, 1))}
    one_of_many = {"a": np.append(np.full((20, 1), 1.5), [[nan]], axis=0)}
    assert largest_errors(one_of_many, long) == [0.5]


def test_instants_that_are_not_common_are_a_mistake() -> None:
    with pytest.raises(ValueError, match="not among"):
        largest_errors({"a": np.zeros((4, 1))}, {"a": np.zeros((6, 1))})
