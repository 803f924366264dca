"""Speeds against closed forms and differences of places and angles: in every model, in the plane and in space."""

import numpy as np
import pytest
from runs import motion, reduced_model
from spatial import slider_crank_in_space
from test_free_play import MODELS

from pgmp_petsc.stepping.second_order_system import State
from scenes import CRANK, ROD, slider_crank

SMALL = ("reduction.modes=3", "reduction.angles=24", 'reduction.interpolation="spline"')
SPIN = 4.0  # rad/s
DRIVEN = slider_crank(
    *SMALL, "simulation.duration=0.02", "simulation.step=2.5e-4",
    f'effects={{drive={{type="prescribed_motion",coordinate="theta",constant_speed={{speed={SPIN},start=0.3}}}}}}',
    'outputs={turning={type="speed",joint="crank_hinge"},elbow={type="speed",joint="elbow"},'
    'sliding={type="speed",joint="slider"},v={type="speed",point="rod:tip",axis="x"},'
    'up={type="speed",point="crank:2",axis="y"},angle={type="angle",joint="elbow"},'
    'x={type="position",point="rod:tip",axis="x"},y={type="position",point="crank:2",axis="y"}}',
)  # fmt: skip
PAIRS = {"v": "x", "up": "y", "elbow": "angle"}


@pytest.mark.parametrize("name", MODELS)
def test_speeds_of_a_driven_crank(name: str) -> None:
    model = MODELS[name](DRIVEN)
    run = motion(model)
    found, time = run.outputs, run.time
    theta = 0.3 + SPIN * time
    root = np.sqrt(ROD**2 - (CRANK * np.sin(theta)) ** 2)
    slider = -SPIN * CRANK * np.sin(theta) * (1.0 + CRANK * np.cos(theta) / root)
    # the crank's hinge is on a node that may vibrate; the slider's speed differs by that of the vibration that the
    # sudden start leaves, 8 % at 40 rad/s, and falls with the speed
    np.testing.assert_allclose(found["turning"], SPIN, rtol=1e-9 if name == "reduced" else 1e-6)
    np.testing.assert_allclose(found["sliding"], found["v"], rtol=0, atol=1e-9 * SPIN)
    assert np.abs(found["v"] - slider).max() < 0.05 * np.abs(slider).max()
    for speed, place in PAIRS.items():
        # second differences of the scheme and of these, (omega h)^2 of that vibration
        differenced = np.gradient(found[place], time, edge_order=2)[4:-4]
        np.testing.assert_allclose(found[speed][4:-4], differenced, rtol=0, atol=0.02 * np.abs(differenced).max())


IN_SPACE = (
    'outputs={turning={type="speed",joint="crank_hinge"},v={type="speed",point="rod:tip",axis="x"},'
    'w={type="speed",point="crank:tip",axis="z"},x={type="position",point="rod:tip",axis="x"},'
    'z={type="position",point="crank:tip",axis="z"},angle={type="angle",joint="crank_hinge"}}'
)


@pytest.mark.parametrize("dimension", [2, 3])
def test_speeds_of_a_reduced_model_are_derivatives_along_its_motion(dimension: int) -> None:
    """In any state; places are differenced with fourth order within a cell of the tables."""
    if dimension == 2:
        model, pairs = reduced_model(DRIVEN), PAIRS
    else:
        scene = slider_crank_in_space(IN_SPACE, *SMALL)
        model = reduced_model(scene)
        pairs = {"turning": "angle", "v": "x", "w": "z"}
    random, n = np.random.default_rng(2), model.terms.layout.n_eta
    eta, v = 1e-3 * random.normal(size=(6, n)), random.normal(size=(6, n))
    eta[:, 0], v[:, 0] = random.uniform(0.0, 6.0, 6), random.normal(size=6)
    values = model.scene.values

    def outputs(far: float) -> dict[str, np.ndarray]:
        states = State(eta + far * v, v, 0.0 * v, np.zeros(0))
        return model.outputs.evaluate(model.observed_of(0.0, states, values))

    found, h = outputs(0.0), 1e-4
    for speed, place in pairs.items():
        parts = [factor * outputs(k * h)[place] for k, factor in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0))]
        # round-off and closure to 1e-12 over the step
        np.testing.assert_allclose(found[speed], sum(parts) / (12.0 * h), rtol=0, atol=1e-7, err_msg=speed)
