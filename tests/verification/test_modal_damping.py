"""Modal damping of bodies on meshes: each mode its ratio, rigid motions nothing, and what it takes is what is lost."""

import numpy as np
import pytest
from combinations import KINDS, TINY, meshes_for
from runs import motion
from scipy.spatial.transform import Rotation

from pgmp_petsc.effects import effects_of
from pgmp_petsc.effects.damping import ModalDamping, free_modes, modal_damping
from pgmp_petsc.full.damping import ModalFactors, add_modal_damping
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.mechanism.space import cross_matrix
from pgmp_petsc.scene import Scene, scene_from_toml

RATIOS = (0.05, 0.05)


def scene_of(kind: str, *more: str) -> Scene:
    damping = f'effects.loss={{type="structural_damping",ratios={list(RATIOS)}}}'
    return scene_from_toml(KINDS[kind], ".", (*TINY, damping, *more))


@njit(cache=True, entry=True)
def take_damping(*of):  # what the kernels have compiled; a call of Python's own would be compiled for itself
    add_modal_damping(*of)


def damped(damping: ModalDamping, d: int, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the forces on the unknowns that are damped, and their power, for unknowns and rates (n_dofs, 1)."""
    modal = ModalFactors.of((damping,), d, lambda dofs: dofs, range(len(q)))
    taken, powers = np.zeros_like(q), np.empty((1, 1))
    take_damping(Reference(modal), d, q, v, taken, np.arange(len(q)), powers)
    return -taken[damping.dofs], powers[0]


@pytest.mark.parametrize("kind", ["cells in the plane", "solids in space"])
def test_modes_are_damped_and_rigid_motions_are_not(kind: str) -> None:
    scene = scene_of(kind)
    mechanism = Mechanism.from_scene(scene, meshes_for(scene))
    damping = modal_damping(effects_of(scene, mechanism), mechanism.bodies, scene.nominal)[0]
    body, d = mechanism.bodies[0], scene.dimension
    omega, phi, mass = free_modes(body, scene.nominal, 2, "entry")
    places = body.points
    turn = Rotation.from_rotvec([0.3, -1.1, 2.0] if d == 3 else [0.0, 0.0, 2.0]).as_matrix()[:d, :d]
    q, moving = np.zeros((mechanism.n_dofs, 1)), np.zeros((mechanism.n_dofs, 1))
    q[damping.dofs, 0] = (places @ turn.T + 0.7).ravel()
    # a spin about an axis off the body, and a translation
    spin = np.zeros((d, d))
    spin[0, 1], spin[1, 0] = -3.0, 3.0
    moving[damping.dofs, 0] = ((places @ turn.T + 0.7) @ spin.T + 0.2).ravel()
    forces, power = damped(damping, scene.dimension, q, moving)
    # modes are orthogonal to rigid motions to the round-off of the eigensolver, some 1e-9; these move at 4 m/s
    np.testing.assert_allclose(forces, 0.0, atol=1e-8 * np.abs(damping.factor).max() ** 2)
    for ratio, frequency, mode in zip(RATIOS, omega, phi.T):
        turned = (mode.reshape(-1, d) @ turn.T).ravel()
        moving[damping.dofs, 0] = turned
        forces, power = damped(damping, scene.dimension, q, moving)
        assert power[0] == pytest.approx(-2.0 * ratio * frequency, rel=1e-6)
        inertia = ((mass @ mode).reshape(-1, d) @ turn.T).ravel()
        np.testing.assert_allclose(forces[:, 0], -2.0 * ratio * frequency * inertia, atol=1e-6 * np.abs(forces).max())


def test_modes_of_beams_in_space_are_damped_and_rigid_motions_are_not() -> None:
    scene = scene_of("beams in space")
    mechanism = Mechanism.from_scene(scene, meshes_for(scene))
    unknowns = Unknowns(mechanism)
    damping = modal_damping(effects_of(scene, mechanism), unknowns.bodies, scene.nominal)[0]
    body = mechanism.bodies[0]
    omega, phi, mass = free_modes(body, scene.nominal, 2, "entry")
    turn = Rotation.from_rotvec([0.3, -1.1, 2.0]).as_matrix()
    poses = np.tile(np.concatenate([[0.7, 0.1, -0.2], turn.T.ravel()]), (len(mechanism.bodies), 1))
    q, spin = unknowns.place(poses)[:, None], cross_matrix(np.array([0.4, -3.0, 1.0]))
    moving = np.concatenate([[0.2, 0.0, 1.0], (spin @ turn).T.ravel()])
    forces, _ = damped(damping, scene.dimension, q, unknowns.place(np.tile(moving, (len(poses), 1)))[:, None])
    np.testing.assert_allclose(forces, 0.0, atol=1e-8 * np.abs(damping.factor).max() ** 2)
    for ratio, frequency, mode in zip(RATIOS, omega, phi.T):
        moved, turned = mode.reshape(-1, 2, 3).transpose(1, 0, 2)
        rates = np.zeros((body.n_nodes, 12))
        rates[:, :3] = moved @ turn.T
        # d_k' = omega x d_k = R (phi x e_k)
        rates[:, 3:] = np.array([(turn @ cross_matrix(phi_i)).T.ravel() for phi_i in turned])
        v = np.zeros_like(q)
        v[damping.dofs, 0] = rates.ravel()
        forces, power = damped(damping, scene.dimension, q, v)
        assert power[0] == pytest.approx(-2.0 * ratio * frequency, rel=1e-6)
        assert forces[:, 0] @ v[damping.dofs, 0] == pytest.approx(power[0], rel=1e-9)


@pytest.mark.parametrize("kind", ["cells in the plane", "solids in space", "beams in space"])
def test_what_it_takes_is_what_is_lost(kind: str) -> None:
    """The energy balance falls at order 2, and the reduced model with the same modes loses the same."""
    down = "[0.0,-1.0,0.0]" if "space" in kind else "[0.0,-1.0]"
    # let go from rest under its weight, the rod vibrates with some 45 Hz in the first mode
    common = (
        f'effects.weight={{type="gravity",direction={down}}}', "coordinates.theta.range=[-0.6,1.2]",
        "coordinates.theta.periodic=false", "simulation.initial.theta.position=0.5", "simulation.duration=0.014",
        "simulation.spectral_radius=0.99", "reduction.static_modes=true", "reduction.modes=5", "reduction.angles=9",
        "simulation.step=1e-4",
    )  # fmt: skip
    found = []
    for step in (2e-4, 1e-4):
        scene = scene_of(kind, *common, f"simulation.step={step}")
        found.append(motion("full", scene, meshes_for(scene)))
    coarse, fine = (np.abs(run.balance.residual).max() for run in found)
    lost = -found[1].balance.work["loss"]
    assert np.all(np.diff(lost) > -1e-12) and lost[-1] > 1e-7
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.4)
    reduced = motion("reduced", scene, meshes_for(scene))
    assert -reduced.balance.work["loss"][-1] == pytest.approx(lost[-1], rel=0.05)
