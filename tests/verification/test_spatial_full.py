"""Full-order runs in space: constraints and their derivatives, against reduced models, beams in the plane, closed
forms, ranks."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from equations import load_vectors
from mpi4py import MPI
from runs import assert_close, full_model, motion
from spatial import WIDTH, arm, slider_crank_in_space, spatial_slider_crank

from pgmp_petsc.effects import effects_of, motions_of
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene
from scenes import kinematics_of, slider_crank

TORQUE = 'effects.motor={type="torque", joint="crank_hinge", table=[[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]}'
WEIGHT = 'effects.weight={type="gravity", direction=[0.0, -1.0, 0.3]}'
DRIVEN = 'effects.motor={type="prescribed_motion", coordinate="theta", spin_up={speed=25.0, time=0.2}}'
ACCURATE = (
    "reduction.angles=48", "reduction.static_modes=true", "reduction.inertia_modes=true",
    'reduction.interpolation="spline"',
)  # fmt: skip


def outputs(joint: str, point: str, axis: str) -> str:
    parts = {
        "angle": f'{{type="angle", joint="{joint}"}}',
        "position": f'{{type="position", point="{point}", axis="x"}}',
        "deformation": f'{{type="deformation", point="{point}", axis="{axis}"}}',
    }
    return f"outputs={{{', '.join(f'{name}={entry}' for name, entry in parts.items())}}}"


LIMITED = tuple(
    f"coordinates.{name}.{entry}" for name in ("theta1", "theta2") for entry in ("range=[-0.4, 0.4]", "periodic=false")
)
SLIDER = outputs("crank_hinge", "rod:tip", "x")


def over(duration: float, step: float = 1e-3) -> tuple[str, str]:
    return f"simulation.duration={duration}", f"simulation.step={step}"


def full_run(scene: Scene) -> Trajectory:
    return motion("full", scene)


def reduced_run(scene: Scene) -> Trajectory:
    return motion("reduced", scene)


def largest(difference: np.ndarray, values: np.ndarray) -> float:
    return float(np.abs(difference).max() / np.abs(values).max())


@lru_cache
def constraints(driven: bool) -> tuple[ConstraintSet, Unknowns, RigidKinematics]:
    scene = spatial_slider_crank(*([f"effects={{{DRIVEN[8:]}}}"] if driven else []))
    kinematics = kinematics_of(scene)
    unknowns = Unknowns(kinematics.mechanism)
    return ConstraintSet(unknowns), unknowns, kinematics


def dense(found: ConstraintSet, q: np.ndarray) -> np.ndarray:
    jacobian = np.zeros((found.n_constraints, q.size))
    np.add.at(jacobian, found.jacobian_pattern, found.jacobian_values(q[:, None])[:, 0])
    return jacobian


@pytest.mark.parametrize("driven", [False, True])
def test_constraints_hold_and_have_these_derivatives(driven: bool) -> None:
    """At a configuration of the undeformed mechanism, and beside it by central differences."""
    found, unknowns, kinematics = constraints(driven)
    theta = np.array([0.7])
    poses = kinematics.poses(theta)
    q = unknowns.place(poses[..., 0])
    moving = unknowns.place(kinematics.rates(poses)[..., 0, 0])
    angle = theta if driven else None
    assert np.abs(found.residual(q[:, None], angle)).max() < 1e-12
    speeds = dense(found, q) @ moving
    assert np.abs(speeds[: found.n_constraints - found.n_driven]).max() < 1e-12
    if driven:
        assert speeds[-1] == pytest.approx(1.0, abs=1e-12)
    rng = np.random.default_rng(3)
    away, step, h = q + 1e-2 * rng.standard_normal(q.size), rng.standard_normal(q.size), 1e-5
    sides = [away + h * step, away - h * step]
    residuals = [found.residual(side[:, None], angle)[:, 0] for side in sides]
    slope = (residuals[0] - residuals[1]) / (2 * h)
    np.testing.assert_allclose(dense(found, away) @ step, slope, atol=1e-8 * np.abs(slope).max())
    multipliers = rng.standard_normal((found.n_constraints, 1))
    if driven:
        multipliers[-1] = 0.0  # its second derivatives hold on rigid directors alone
    forces = [dense(found, side).T @ multipliers[:, 0] for side in sides]
    curvature = np.zeros((q.size, q.size))
    np.add.at(curvature, found.curvature_pattern, found.curvature_values(away[:, None], multipliers)[:, 0])
    curvature += np.tril(curvature, -1).T + np.triu(curvature, 1).T
    change = (forces[0] - forces[1]) / (2 * h)
    np.testing.assert_allclose(curvature @ step, change, atol=1e-7 * np.abs(change).max())


@pytest.mark.parametrize("driven", [False, True])
def test_the_drift_is_what_the_motion_of_rigid_bodies_needs(driven: bool) -> None:
    """``C a + drift = 0`` for the accelerations of the undeformed mechanism that turns at a steady speed."""
    found, unknowns, kinematics = constraints(driven)

    def state(angle: float) -> tuple[np.ndarray, np.ndarray]:
        poses = kinematics.poses(np.array([angle]))
        return unknowns.place(poses[..., 0]), unknowns.place(kinematics.rates(poses)[..., 0, 0])

    (q, v), h = state(0.7), 1e-5
    a = (state(0.7 + h)[1] - state(0.7 - h)[1]) / (2 * h)
    drift = found.drift(q[:, None], v[:, None], np.zeros(found.n_driven))[:, 0]
    np.testing.assert_allclose(dense(found, q) @ a + drift, 0.0, atol=1e-7)


def test_constraints_that_follow_from_others_are_left_out() -> None:
    found, unknowns, kinematics = constraints(False)
    q = unknowns.place(kinematics.poses(np.array([0.7]))[..., 0])
    kept = found.independent(q)
    assert np.linalg.matrix_rank(dense(found, q), tol=1e-9) == kept.n_constraints <= found.n_constraints
    assert np.linalg.matrix_rank(dense(kept, q), tol=1e-9) == kept.n_constraints


@pytest.mark.parametrize(
    ("scene", "limits"),
    [
        # measured: 2.9e-5, 1.5e-7, 0.5 %; of the spatial one 3.8e-5, 6e-7, 0.1 %; of the arm 2.7e-4, 4e-6, 7 %
        (lambda: slider_crank_in_space(*over(0.1), TORQUE, SLIDER, *ACCURATE), (1e-4, 1e-6, 0.02)),
        (lambda: spatial_slider_crank(*over(0.05), outputs("crank_hinge", "slider:tip", "x")), (1e-4, 2e-6, 0.01)),
        (
            lambda: spatial_slider_crank(
                *over(0.05), "bodies.slider.flexible=false", outputs("crank_hinge", "slider:tip", "x")
            ),
            (1e-4, 2e-6, 0.01),
        ),
        (
            lambda: arm(*over(0.06), WEIGHT, *LIMITED, "reduction.angles=5", "reduction.static_modes=true",
                        'reduction.interpolation="spline"', outputs("shoulder", "lower:tip", "y")),
            (1e-3, 3e-5, 0.15),
        ),
    ],
    ids=["slider-crank", "spatial slider-crank", "with a rigid slider", "arm with two coordinates"],
)  # fmt: skip
@pytest.mark.usefixtures("coarse")
def test_the_reduced_run_is_that_of_the_full_order_model(
    scene: Callable[[], Scene], limits: tuple[float, float, float]
) -> None:
    made = scene()
    full, reduced = full_run(made), reduced_run(made)
    for (name, values), limit in zip(full.outputs.items(), limits):
        assert largest(reduced.outputs[name] - values, values) < limit, name
    # the full-order coordinates are measured at the joints' frames, the reduced ones are those of rigid motion
    np.testing.assert_allclose(full.outputs["angle"], full.coordinates[:, 0], atol=1e-12)


RAMP = "table=[[0.0, 0.0], [0.05, 5.0], [1.0, 5.0]]"
EFFECTS = (
    f"effects={{pull={{type='force', point='rod:tip', direction=[1.0, 0.0, 1.0], {RAMP}}},"
    f"push={{type='force', point='crank:tip', direction=[0.0, 0.0, 1.0], {RAMP}}},"
    "knob={type='point_mass', point='rod:tip', mass=0.2, inertia=1e-4},"
    "friction={type='structural_damping', stiffness=1e-4, mass=2.0},"
    "motor={type='torque', joint='crank_hinge', table=[[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]}}"
)


def test_effects_together() -> None:
    """Forces across the plane and on the guided point, a point mass with inertia, both dampings and a torque; balance
    within the step's error."""
    made = slider_crank_in_space(*over(0.07), EFFECTS, outputs("crank_hinge", "crank:tip", "z"), *ACCURATE)
    full, reduced = full_run(made), reduced_run(made)
    assert_close(full.outputs, reduced.outputs, angle=3e-4, position=5e-6, deformation=0.05)
    assert np.abs(full.balance.residual).max() < 1e-3 * full.balance.exchanged


def test_a_planar_mechanism_moves_in_space_as_beams_do_in_the_plane() -> None:
    """Quadratic elements six times as long as wide against beams of the same square section."""
    square = f'section={{shape="rectangle", width={WIDTH}, height={WIDTH}}}'
    bodies = [
        f'bodies.{name}={{mesh="{mesh}", element="beam2d", material="steel", {square}}}'
        for name, mesh in (("crank", "0.0:0.3:20"), ("rod", "0.3:1.0:20"))
    ]
    torque = TORQUE.partition("=")[2]
    plane = slider_crank(
        "parameters={}", *bodies, *over(0.12), f"effects={{motor={torque}}}", SLIDER, "reduction.parameter_modes=0"
    )
    expected = motion("full", plane)
    finer = ('bodies.crank.mesh="0.0:0.3:5"', 'bodies.rod.mesh="0.3:1.0:9"')
    found = full_run(slider_crank_in_space(*over(0.12), TORQUE, SLIDER, *finer))
    assert_close(expected.outputs, found.outputs, angle=1e-3, position=1e-4, deformation=0.03)


def test_energy_is_balanced_with_the_square_of_the_step() -> None:
    shares = []
    for step in (1e-3, 5e-4, 2.5e-4):
        run = full_run(spatial_slider_crank(*over(0.02, step), "simulation.spectral_radius=1.0"))
        shares.append(np.abs(run.balance.residual).max() / run.balance.exchanged)
    orders = np.log2(np.array(shares[:-1]) / shares[1:])
    assert np.all(orders > 1.7), (shares, orders)


def test_a_prescribed_coordinate_turns_as_prescribed_and_counts_its_turns() -> None:
    made = slider_crank_in_space(*over(0.4, 2e-3), f"effects={{{DRIVEN[8:]}}}", SLIDER)
    run = full_run(made)
    (driven,) = motions_of(made, full_model(made).kinematics.mechanism).values()
    expected = np.array([driven.at(t)[0] for t in run.time])
    assert expected[-1] > 2 * np.pi
    # the constraint is met at every step, to the Newton iteration's tolerance
    np.testing.assert_allclose(run.coordinates[:, 0], expected, atol=1e-8)
    np.testing.assert_allclose(run.outputs["angle"], expected, atol=1e-8)
    reach = 0.3 * np.cos(expected) + np.sqrt(0.7**2 - (0.3 * np.sin(expected)) ** 2)
    # the slender bars bend by 3 mm
    np.testing.assert_allclose(run.outputs["position"], reach, atol=4e-3)
    assert np.abs(run.balance.residual).max() < 1e-2 * run.balance.exchanged


def test_effects_find_their_vectors() -> None:
    """The weight is that of the whole mass, whatever it is spread over; its work is that of the fall of the centre of
    mass."""
    made = spatial_slider_crank()
    model = full_model(made)
    with model.distributed(made.values, MPI.COMM_SELF) as system:
        unknowns = Unknowns(model.kinematics.mechanism)
        vectors = load_vectors(system._equations)  # noqa: SLF001
        up = np.zeros(unknowns.n_dofs)
        unknowns.frames(up)[:, 1] = 1.0
        up[unknowns.frames(up).size :].reshape(-1, 3)[:, 1] = 1.0
        volume = (0.1 + 0.3 + 0.05) * WIDTH**2
        assert vectors["gravity"] @ up == pytest.approx(-7800.0 * 9.81 * volume, rel=1e-12)
    assert {effect.name for effect in effects_of(made, model.kinematics.mechanism)} == {"motor", "gravity"}
