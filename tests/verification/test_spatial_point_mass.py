"""Point masses on rigid bodies in space: welded there, with their mass, their arm and their moment of inertia."""

import numpy as np
import pytest
from mpi4py import MPI
from runs import full_model, motion, rom_of
from spatial import WIDTH, assembled, bars_of, slider_crank_in_space, table

from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.check import describe_scene
from scenes import STEEL

LENGTH, MASS, INERTIA = 0.5, 0.7, 2e-3
BAR_MASS = STEEL["rho"] * WIDTH**2 * LENGTH


def pendulum(rotation: tuple[float, float, float] = (0.0, 0.0, 0.0), *more: str) -> Scene:
    """Return a rigid bar that turns about z at one end, with a point mass on the other."""
    return assembled(
        f'[bodies.bar]\nmesh = "0.0:{LENGTH}:1"\nelement = "solid3d"\nmaterial = "steel"\nflexible = false\n',
        table("bodies.bar.placement", origin=(0.0, 0.0, 0.0), rotation=rotation),
        table("joints.drive", type="revolute", connect=["ground:origin", "bar:hinge"], axis=(0.0, 0.0, 1.0)),
        table("effects.bob", type="point_mass", point="bar:tip", mass=MASS, inertia=INERTIA),
        *more,
    )


def about_the_hinge() -> float:
    return BAR_MASS * (LENGTH**2 / 3 + WIDTH**2 / 12) + MASS * LENGTH**2 + INERTIA


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.9)])
def test_the_moment_of_inertia_about_the_hinge_is_that_of_bar_and_mass(rotation: tuple[float, float, float]) -> None:
    scene = pendulum(rotation)
    assert "bob:mass" in describe_scene(scene, bars_of(scene))
    model = full_model(scene)
    with model.distributed({}, MPI.COMM_SELF) as system:
        _, v = system._equations.place(np.array([0.4]), np.array([1.0]))
        np.testing.assert_allclose(2.0 * system.kinetic_energy(v), about_the_hinge(), rtol=1e-9)


def test_a_pendulum_with_a_bob_swings_with_the_period_of_a_compound_one() -> None:
    swing = 0.01
    torque = (0.5 * BAR_MASS + MASS) * LENGTH * 9.80665
    period = 2 * np.pi * np.sqrt(about_the_hinge() / torque) * (1 + swing**2 / 16)
    scene = pendulum(
        (0.0, 0.0, 0.0),
        table("effects.weight", type="gravity", direction=(0.0, -1.0, 0.0)),
        table("simulation", duration=period, step=period / 400, spectral_radius=1.0),
        table("simulation.initial.theta", position=-0.5 * np.pi + swing),
        table("outputs.angle", type="angle", joint="drive"),
    )
    trajectory = motion("full", scene)
    angle = trajectory.outputs["angle"] + 0.5 * np.pi
    # the trapezoidal rule lengthens the period by (2 pi / 400)^2 / 12 = 2e-5: it is back to 1 - (1e-4)^2
    np.testing.assert_allclose(angle[-1], swing, rtol=1e-6)
    np.testing.assert_allclose(angle[200], -swing, rtol=1e-6)


def test_a_reduced_model_has_the_mass_on_its_rigid_crank() -> None:
    overrides = ('effects={bob={type="point_mass", point="crank:tip", mass=0.7}}', "bodies.crank.flexible=false",
                 "reduction={modes=2, angles=8}")  # fmt: skip
    scene = slider_crank_in_space(*overrides)
    rom = rom_of(scene)
    without = slider_crank_in_space("effects={}", *overrides[1:])
    plain = rom_of(without)
    # the crank's tip is 0.3 m from the hinge at any angle
    found = [np.array([m.batch({}, 1).kinetic_energy(*_turning(m, theta)) for theta in (0.3, 2.0)])
             for m in (ReducedModel(scene, rom), ReducedModel(without, plain))]  # fmt: skip
    np.testing.assert_allclose(2 * (found[0] - found[1]), 0.7 * 0.3**2, rtol=1e-8)


def _turning(model: ReducedModel, theta: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a state of the undeformed mechanism that turns at 1 rad/s."""
    q = np.zeros((1, model.terms.layout.n_eta))
    v = q.copy()
    q[0, 0], v[0, 0] = theta, 1.0
    return q, v
