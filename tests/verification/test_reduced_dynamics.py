"""Runs of the reduced model, over one coordinate and two: against full order, kept energy, signs of vectors."""

import numpy as np
import pytest
import runs
from alike import assert_alike
from runs import full_model, history, reduced_model, samples, with_step
from scrambling import scrambled
from two_coordinates import double_pendulum

from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.lagrangian import reduced_energy
from pgmp_petsc.reduction.rom import ReducedOrderModel
from scenes import RADIUS, slider_crank

SHARES = (0.9, 1.0, 1.1)
WIDE_SHARES = (0.7, 0.85, 1.0, 1.15, 1.3)


@pytest.fixture(scope="module")
def comparison() -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the outputs over time of the full-order and the reduced model for three radii."""
    scene = runs.paper_scene()
    values = runs.samples(scene, 3, r1=np.array(SHARES) * RADIUS)
    full = runs.history(runs.full_model(scene), values, 3)[1]
    return full, runs.history(ReducedModel(scene, runs.paper_rom()), values, 3)[1]


def test_the_papers_accuracy_with_the_papers_basis(comparison: tuple) -> None:
    """Naets et al. 2015, section 6: crank angle to 0.03 %, slider deformation to 8 %, of each sample's maximum."""
    for k in range(len(SHARES)):
        full, reduced = ({name: values[:, k] for name, values in one.items()} for one in comparison)
        runs.assert_close(full, reduced, crank_angle=3e-4, slider_deformation=0.08)


def test_a_static_mode_and_splines_are_worth_more_than_many_modes(accurate_rom: ReducedOrderModel) -> None:
    """7 modes and a static one, 48 angles, for five radii, nominal within 30 %; measured: crank angle to 0.004 %,
    slider deformation to 0.21 %."""
    assert (accurate_rom.tables.n_modes, accurate_rom.tables.samples.n) == (8, 48)
    assert accurate_rom.frequencies_hz.shape == (48, 7)
    n = len(WIDE_SHARES)
    values = runs.samples(runs.accurate_scene(), n, r1=np.array(WIDE_SHARES) * RADIUS)
    models = runs.full_model(runs.accurate_scene()), ReducedModel(runs.accurate_scene(), accurate_rom)
    both = [runs.history(model, values, n)[1] for model in models]
    for k in range(n):
        full, reduced = ({name: values[:, k] for name, values in one.items()} for one in both)
        runs.assert_close(full, reduced, crank_angle=1.2e-4, slider_deformation=3e-3)


def test_a_moving_line_gravity_and_a_moving_start() -> None:
    """The reduced model of a mechanism unlike the paper's, bending by a ten-thousandth of its size."""
    scene = runs.quick_return(
        "reduction.modes=12", "reduction.angles=90", "simulation.duration=0.3", "simulation.step=5e-4",
        "bodies.rocker.section.radius=8e-3", "effects.motor.table=[[0.0, 0.0], [0.2, 0.3]]",
        'outputs.angle={type="angle", joint="crank_hinge"}',
        'outputs.tip={type="position", point="rocker:tip", axis="x"}',
        'outputs.bent={type="deformation", point="rocker:tip", axis="x"}',
    )  # fmt: skip
    values = runs.samples(scene, 2, r1=np.array([5.6e-3, 6.5e-3]))
    full, reduced = (runs.history(model, values, 2)[1] for model in (runs.full_model(scene), runs.reduced_model(scene)))
    runs.assert_close(full, reduced, angle=3e-4, tip=3e-4, bent=0.08)


def test_a_rocker_that_turns_fast_is_integrated_with_the_full_models_step() -> None:
    """Backwards through the quick return, where the modes change fast: 16 rad/s, 500 rad/s2, bent by 4 mm of 800."""
    scene = runs.quick_return(
        "reduction.modes=8", "reduction.angles=180", "simulation.duration=0.3", "simulation.step=5e-4",
        "bodies.rocker.section.radius=8e-3", "effects.motor.table=[[0.0, 0.0], [0.2, 0.1]]",
        "simulation.initial.theta.velocity=2.0",
    )  # fmt: skip
    assert runs.run_model(runs.full_model(scene))[1].status[0] == 0
    assert runs.run_model(runs.reduced_model(scene))[1].status[0] == 0


def test_signs_and_order_of_the_eigenvectors_do_not_change_the_motion(seed: int = 1) -> None:
    scene = slider_crank(
        "simulation.duration=0.3", 'outputs.angle={type="angle", joint="crank_hinge"}',
        'outputs.bent={type="deformation", point="rod:tip", axis="x"}', "simulation.initial.theta.velocity=8.0",
    )  # fmt: skip
    plain = ReducedModel(scene, runs.rom_of(scene))
    spoilt = ReducedModel(scene, runs.rom_of(scene, lambda modes: scrambled(seed, modes)))
    values = runs.samples(scene, 2, r1=np.array([5.6e-3, 5e-3]))
    one, other = (runs.history(model, values, 2)[1] for model in (plain, spoilt))
    assert_alike(one, other, 1e-8)


def test_without_loads_and_motion_nothing_happens() -> None:
    scene = slider_crank("effects={}", "simulation.duration=0.05", "simulation.initial.theta.position=1.0")
    system, run = runs.run_model(runs.reduced_model(scene))
    np.testing.assert_array_equal(run.state.q, system.start().q)


def energies(model: ReducedModel) -> tuple[tuple[np.ndarray, np.ndarray], float]:
    """Return the reduced model's kinetic and strain energy over a free motion, and the number of revolutions."""
    scene = model.scene
    system = model.batch(runs.samples(scene, 1), 1)
    _, states = runs.watched(system, scene.simulation, lambda _, state: (state.q[0].copy(), state.v[0].copy()))
    q, v = np.moveaxis(np.array(states), 1, 0)
    return reduced_energy(model.terms, scene.nominal, q, v), (q[-1, 0] - q[0, 0]) / (2 * np.pi)


FREE = ("effects={}", "simulation.spectral_radius=1.0")


@pytest.mark.parametrize(
    ("scheme", "order"), [("overhauser", ()), ("spline", ("reduction.second_order=true",)), ("spectral", ())]
)
def test_energy_is_kept_without_loads_and_numerical_damping(scheme: str, order: tuple[str, ...]) -> None:
    scene = slider_crank(
        *FREE, *order, "simulation.initial.theta.velocity=12.0", "reduction.angles=90", "simulation.duration=0.2",
        f'reduction.interpolation="{scheme}"',
    )  # fmt: skip
    rom = runs.rom_of(scene)
    totals = (np.sum(energies(ReducedModel(with_step(scene, step), rom))[0], axis=0) for step in (1e-3, 5e-4))
    wrong = [np.abs(total / total[0] - 1).max() for total in totals]
    # the integrator's own error, of second order
    assert wrong[0] < 5e-3
    assert wrong[0] / wrong[1] > 3.0


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
    soft = ("materials.steel.E=5e9", "simulation.initial.theta1.velocity=15.0", "reduction.angles=12")
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
        (kinetic, strain), _ = energies(reduced_model(scene))
        assert np.max(strain) > 1e-4 * kinetic[0]
        drifts.append(np.ptp(kinetic + strain) / kinetic[0])
    assert drifts[0] < 1e-6 and 3.3 < drifts[0] / drifts[1] < 4.7, drifts
