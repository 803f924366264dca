"""Elastic joints against closed forms, an own beam code, and their rigid limit."""

import numpy as np
import pytest
from elastic_scenes import BEARINGS, DISCS, N_ELEMENTS, SHAFT, SIDE, machine, rigid_frame, rotor, vibrations
from machine_scenes import MODELS
from runs import history, read_meshes, samples
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from scenes import STEEL

GRAVITY = 9.81


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_rigid_frame_sinks_onto_its_mounts(model):
    """The step's error falls as its square: 0.5 s in steps of 2, 1 and 0.5 ms, against a solution of the linearised
    equations by hand; tilting, the frame's own motion is of second order, 1e-6 of its size."""
    m, inertia, k, c = 12.0, 1.5, 4e4, (90.0, 30.0)

    def rates(_, state):
        y, tilt, vy, spin = state
        ends = [-k * (y + s * tilt) - c_end * (vy + s * spin) for s, c_end in zip((-0.5, 0.5), c)]
        return [vy, spin, sum(ends) / m - GRAVITY, 0.5 * (ends[1] - ends[0]) / inertia]

    def of(step):
        scene = rigid_frame(f"simulation.step={step}")
        time, found = history(MODELS[model](scene), samples(scene, 1), 1)
        return time, found

    errors = []
    for step in (2e-3, 1e-3, 5e-4):
        time, found = of(step)
        exact = solve_ivp(rates, (0.0, time[-1]), np.zeros(4), t_eval=time, rtol=1e-10, atol=1e-14).y
        errors.append(np.max(np.abs(found["left"][:, 0] - exact[0] + 0.5 * exact[1])))
    assert np.max(np.abs(exact[0])) > 2e-3  # the mean of both mounts sinks by twice m g / 2 k
    assert 3.5 < errors[0] / errors[1] < 4.5 and 3.0 < errors[1] / errors[2] < 4.5
    assert errors[2] < 2e-5 * np.max(np.abs(exact[0])) * 50
    assert np.max(np.abs(found["x"])) < 1e-5  # the mounts along x are level with the centre


def _plane_of_rotor(stiffness: tuple[float, float]) -> np.ndarray:
    """Return the frequencies (Hz) of the shaft in one plane: Timoshenko elements of two nodes, one-point quadrature."""
    n, length, area, bending = N_ELEMENTS + 1, SHAFT / N_ELEMENTS, SIDE**2, SIDE**4 / 12.0
    shear = 10 * 1.3 / (12 + 11 * 0.3) * STEEL["E"] / 2.6 * area
    k, m = np.zeros((2, 2 * n, 2 * n))
    for e in range(N_ELEMENTS):
        own = np.arange(2 * e, 2 * e + 4)
        b = np.array([-1.0 / length, -0.5, 1.0 / length, -0.5])  # gamma of (w, phi) at both nodes
        kappa = np.array([0.0, -1.0, 0.0, 1.0]) / length
        k[np.ix_(own, own)] += length * (shear * np.outer(b, b) + STEEL["E"] * bending * np.outer(kappa, kappa))
        pair = np.array([[2.0, 1.0], [1.0, 2.0]]) * STEEL["rho"] * length / 6.0
        m[np.ix_(own[::2], own[::2])] += area * pair
        m[np.ix_(own[1::2], own[1::2])] += bending * pair
    for node, mass in DISCS.items():
        m[2 * int(node), 2 * int(node)] += mass
    for end, spring in zip((0, 2 * n - 2), stiffness):
        k[end, end] += spring
    return np.sqrt(eigh(k, m, eigvals_only=True)) / (2 * np.pi)


def test_a_rotor_at_rest_has_the_frequencies_of_another_code():
    """Six figures: both have the same elements, and round-off of stiff directions is left. The spin is free."""
    planes = [_plane_of_rotor(tuple(end[k] for end in BEARINGS)) for k in range(2)]
    expected = np.sort(np.concatenate(planes))[:6]
    assert vibrations(rotor()) == pytest.approx(expected, rel=1e-6)


def _on_mounts(k: str) -> Scene:
    """Return the machine with a stiffness of both mounts, N/m."""
    elastic = f"{{reference=[[1.0,0.0]],stiffness=[{k},{k}],turning_stiffness=[0.0]}}"
    return machine(*(f"joints.{name}.elastic={elastic}" for name in ("one", "two")))


def test_stiffness_to_infinity_gives_the_rigid_joint():
    """The difference falls as 1 / k, until it is the round-off of the stiff springs."""
    rigid, differences = vibrations(_on_mounts("inf")), []
    for k in ("1e10", "1e11", "1e12"):
        differences.append(np.abs(vibrations(_on_mounts(k))[:3] - rigid[:3]))
    ratios = np.array(differences[:-1]) / differences[1:]
    assert ratios == pytest.approx(10.0, rel=0.15)


def test_soft_mounts_do_not_change_the_count_of_coordinates():
    scene = machine()
    kinematics = RigidKinematics(Mechanism.from_scene(scene, read_meshes(scene)))
    assert kinematics.n_coordinates == 1
    motion = kinematics.motion(np.array([0.3]))
    assert motion.released.shape[-1] == 3  # of six directions of two mounts
