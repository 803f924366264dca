"""Dead centres of the slider-crank, and rods hardly longer, or shorter, than the crank."""

import numpy as np
import pytest
from mechanisms import QUIET, accurate, both, nominal_rom, run_for, start
from runs import assert_close

from scenes import CRANK, ROD, kinematics_of, slider_crank


@pytest.mark.parametrize(("theta", "sign"), [(0.0, 1.0), (np.pi, -1.0), (2 * np.pi, 1.0)])
def test_the_rigid_velocities_at_dead_centres_are_those_of_the_closed_form(theta: float, sign: float) -> None:
    """The slider stands still and the rod turns by -L1/L2 of the crank; x'' = -L1 (cos theta + L1/L2)."""
    kinematics = kinematics_of(slider_crank())
    poses = kinematics.poses(np.array([theta]))
    rates = kinematics.rates(poses)
    curvatures = kinematics.curvatures(poses, rates)[:, :, 0, 0, 0]
    rod_pose, rod_rate, rod_curvature = poses[1, :, 0], rates[1, :, 0, 0], curvatures[1]
    arm = np.array([np.cos(rod_pose[2]), np.sin(rod_pose[2])])  # of the rod's tip, 1 m from its mesh's origin
    across = np.array([-arm[1], arm[0]])
    # the closure is exact to 1e-12 of the mechanism's size
    np.testing.assert_allclose(rod_rate[:2] + rod_rate[2] * across, 0.0, rtol=0, atol=1e-11)
    assert rod_rate[2] == pytest.approx(-sign * CRANK / ROD, rel=1e-10)
    acceleration = rod_curvature[:2] + rod_curvature[2] * across - rod_rate[2] ** 2 * arm
    np.testing.assert_allclose(acceleration, [-CRANK * (sign + CRANK / ROD), 0.0], rtol=0, atol=1e-10)


# from rest 0.6 rad before the dead centre, the torque (N m) rising over a time (s), speed there, and what is allowed;
# half of the angle's errors and more are the two models' different errors of time integration
@pytest.mark.parametrize("centre", [0.0, np.pi], ids=["outer", "inner"])
@pytest.mark.parametrize(
    ("torque", "rise", "speed", "angle", "bent"),
    [(0.02, 0.5, 1.0, 4e-5, 1e-3), (6.0, 0.03, 17.0, 6e-5, 1.5e-2)],
    ids=["slowly", "fast"],
)
def test_driven_through_a_dead_centre(
    centre: float, torque: float, rise: float, speed: float, angle: float, bent: float
) -> None:
    duration, step = (5.5 if centre == 0.0 else 3.5) * rise, rise / 100
    table = f"effects.motor.table=[[0.0, 0.0], [{rise}, {torque}]]"
    full, reduced = both(accurate(table, *start(centre - 0.6), *run_for(duration, step)), rom=nominal_rom())
    passed = np.searchsorted(full["angle"][:, 0], centre)
    assert 10 < passed < len(full["angle"]) - 10
    assert (full["angle"][passed, 0] - full["angle"][passed - 1, 0]) / step == pytest.approx(speed, rel=0.05)
    assert_close(full, reduced, angle=angle, bent=bent, slider=angle)


def test_let_go_at_a_dead_centre_at_a_speed_that_shakes_the_bodies() -> None:
    """5 rad/s from an undeformed start, which is no equilibrium: all modes swing, and gyroscopic forces shift them.

    The share of these forces is the speed over a frequency, here 5 rad/s over 400 rad/s; measured 4.1 % of the slider's
    deformation at the outer dead centre, where its first-order part vanishes, against 1.8 % in the middle.
    """
    for position, bent in ((-0.25, 0.07), (np.pi / 2 - 0.25, 0.04)):
        scene = accurate(QUIET, *start(position, 5.0), *run_for(0.1, 2e-4))
        assert_close(*both(scene, rom=nominal_rom()), angle=2e-5, bent=bent, slider=1e-6)


def test_a_rod_one_per_cent_longer_than_the_crank() -> None:
    """Over theta = pi/2 the rod swings through 3 rad within 0.3 rad of the crank, and the tables with it.

    Measured 8e-6 of the angle and 0.17 % of the deformation; with 96 angles 1.1 %.
    """
    rod = 'bodies.rod.mesh="0.3:0.603:5"'
    scene = accurate(rod, QUIET, *start(0.0, 0.5), *run_for(2 * np.pi, 5e-3), angles=192)
    full, reduced = both(scene)
    assert full["slider"].min() < 0.01 < 0.6 < full["slider"].max()
    assert_close(full, reduced, angle=2e-5, bent=4e-3, slider=2e-5)
