"""The reduced model of a mechanism with two rigid coordinates against the full-order one: a falling double pendulum."""

from __future__ import annotations

import numpy as np
from runs import full_model, history, reduced_model, samples
from two_coordinates import double_pendulum

SETTINGS = (
    "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.angles=12",
    'reduction.interpolation="spline"', "simulation.duration=0.3", "simulation.step=1e-3",
    'outputs.shoulder={type="angle",joint="shoulder"}', 'outputs.elbow={type="angle",joint="elbow"}',
    'outputs.bend={type="deformation",point="lower:tip",axis="x"}',
)  # fmt: skip
WEIGHT = 'effects.weight={type="gravity"}'
SPRING = 'effects.spring={type="spring_damper",joint="elbow",stiffness=4.0,damping=0.02}'
DRIVE = (
    'effects={weight={type="gravity"},'
    'drive={type="prescribed_motion",coordinate="theta1",spin_up={speed=3.0,time=0.2}}}'
)


def compare(*overrides: str) -> dict[str, float]:
    """Return the largest differences of the outputs, as a share of their ranges."""
    scene = double_pendulum(*SETTINGS, *overrides)
    values = samples(scene, 1)
    _, reduced = history(reduced_model(scene), values, 1)
    _, full = history(full_model(scene), values, 1)
    assert np.ptp(full["elbow"]) > 0.1
    return {name: float(np.abs(reduced[name] - full[name]).max() / np.ptp(full[name])) for name in full}


def test_a_falling_double_pendulum() -> None:
    errors = compare(WEIGHT)
    # 16 angles leave 3e-5 and 1e-3, 24 leave 1e-5 and 1e-3
    assert max(errors["shoulder"], errors["elbow"]) < 2e-4 and errors["bend"] < 5e-3, errors


def test_with_a_spring_in_the_elbow() -> None:
    errors = compare(WEIGHT, SPRING)
    # 12 angles
    assert max(errors["shoulder"], errors["elbow"]) < 2e-4 and errors["bend"] < 0.03, errors


def test_with_a_driven_shoulder() -> None:
    errors = compare(DRIVE)
    assert errors["shoulder"] < 1e-12 and errors["elbow"] < 2e-4 and errors["bend"] < 2e-2, errors
