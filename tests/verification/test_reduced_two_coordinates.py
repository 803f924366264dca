"""The reduced model of a mechanism with two rigid coordinates against the full-order one: a falling double pendulum."""

import numpy as np
import pytest
from runs import full_model, history, reduced_model, samples
from two_coordinates import double_pendulum

from pgmp_petsc.reduced.lagrangian import reduced_energy
from pgmp_petsc.stepping.generalised_alpha import integrate

SETTINGS = (
    "reduction.static_modes=true", "reduction.inertia_modes=true", "reduction.angles=12",
    'reduction.interpolation="spline"', "simulation.duration=0.3", "simulation.step=1e-3",
    'outputs.shoulder={type="angle",joint="shoulder"}', 'outputs.elbow={type="angle",joint="elbow"}',
    'outputs.bend={type="deformation",point="lower:tip",axis="x"}',
)  # fmt: skip
WEIGHT = 'effects.weight={type="gravity"}'
SPRING = 'effects.spring={type="spring_damper",joint="elbow",stiffness=4.0,damping=0.02}'
STIFFENED = 'effects.stiffening={type="geometric_stiffening"}'
CHANGING = 'effects.changing={type="mode_inertia"}'
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


@pytest.mark.parametrize(
    ("effects", "shoulder", "bend"),
    # 12 angles; 16 leave 3e-5 and 1e-3 under the weight alone, 24 leave 1e-5 and 1e-3
    [((WEIGHT,), 2e-4, 5e-3), ((WEIGHT, SPRING), 2e-4, 0.03), ((DRIVE,), 1e-12, 2e-2)],
    ids=["falling", "with a spring in the elbow", "with a driven shoulder"],
)
def test_a_double_pendulum_moves_as_its_mesh(effects: tuple[str, ...], shoulder: float, bend: float) -> None:
    errors = compare(*effects)
    assert errors["shoulder"] < shoulder and errors["elbow"] < 2e-4 and errors["bend"] < bend, errors


def test_bars_that_turn_fast_are_stiffened() -> None:
    """Soft bars at 15 rad/s: forces in the bars and the inertia of changing modes are a fifth of the deformation."""
    soft = ("materials.steel.E=5e9", "simulation.initial.theta1.velocity=15.0", "reduction.angles=16")
    without, with_them = compare(WEIGHT, *soft), compare(WEIGHT, *soft, STIFFENED, CHANGING)
    for name, error in with_them.items():
        assert error < 0.4 * without[name], (without, with_them)


def test_energy_is_kept_with_terms_of_second_order() -> None:
    """Free of loads, with the trapezoidal rule: what the energy varies by falls with the square of the step."""
    drifts = []
    for step in (2e-4, 1e-4):
        scene = double_pendulum(
            *SETTINGS, "effects={}", STIFFENED, CHANGING, "materials.steel.E=5e9", "simulation.spectral_radius=1.0",
            "simulation.initial.theta1.velocity=8.0", "simulation.initial.theta2.velocity=-5.0",
            f"simulation.step={step}",
        )  # fmt: skip
        model, states = reduced_model(scene), []
        system = model.batch(samples(scene, 1), 1)
        integrate(
            system,
            scene.simulation,
            observer=lambda _, __, state: states.append((state.q[0].copy(), state.v[0].copy())),
        )
        q, v = (np.array(parts) for parts in zip(*states))
        kinetic, strain = reduced_energy(model.terms, scene.nominal, q, v)
        assert np.max(strain) > 1e-4 * kinetic[0]
        drifts.append(np.ptp(kinetic + strain) / kinetic[0])
    assert drifts[0] < 1e-6 and 3.3 < drifts[0] / drifts[1] < 4.7, drifts
