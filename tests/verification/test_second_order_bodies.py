"""Second order in the deformation of bodies of cells and in space: energy on the mesh, joints, full-order runs."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from alike import orders
from frames import pair_products
from green_lagrange import energy_of
from mpi4py import MPI
from runs import motion, rom_of
from solid_scenes import solid_meshes, solid_slider_crank
from spatial import slider_crank_in_space, spatial_slider_crank
from spatial_beams import slider_crank_of_beams

from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.components.component_modes import condense
from pgmp_petsc.components.large_deformation import with_second_order
from pgmp_petsc.effects import effects_of, loads_of, patterns_of
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.build import Manifold
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sampler import Sampler
from pgmp_petsc.reduction.static_loads import StaticLoads
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.references import points_used
from scenes import meshes_of, slider_crank

HALVINGS = 5
SECOND = "reduction.second_order=true"
CELLS = {
    "plane": (solid_slider_crank, lambda scene: solid_meshes(n_per_metre=10)),
    "space": (slider_crank_in_space, meshes_of),
}


def rom_with(scene: Scene, meshes: dict) -> ReducedOrderModel:
    return rom_of(scene, meshes=meshes)


@pytest.mark.parametrize("made", CELLS.values(), ids=CELLS)
def test_the_cubic_energy_is_that_of_the_mesh(made: tuple[Callable, Callable]) -> None:
    """Displacements of the mesh, ``T (Psi delta + 1/2 chi delta delta)``, in the nonlinear strain energy."""
    scene = made[0]("reduction.modes=3")
    meshes, bodies = made[1](scene), {}
    for name, mesh in meshes.items():
        meshed = FramedSolid.of(name, scene.bodies[name], scene.materials, mesh, points_used(scene, name))
        component, recovery, _ = condense(meshed.solid, meshed.frames, [{}], 6, MPI.COMM_SELF, large=True)
        bodies[name] = (meshed.solid, with_second_order(component, meshed.solid, recovery, MPI.COMM_SELF, {}), recovery)
    mechanism = Mechanism.from_scene(scene, {name: part[1] for name, part in bodies.items()})
    kinematics, theta = RigidKinematics(mechanism), np.array([1.0])
    matrices, effects = assemble(mechanism.bodies, range(mechanism.n_dofs)), effects_of(scene, mechanism)
    loads, patterns = loads_of(effects, matrices), patterns_of(effects, matrices)
    with ModalProblem(kinematics, {}, 3, MPI.COMM_SELF, matrices) as problem:
        static_loads = StaticLoads.of(problem, patterns, scene.reduction)
        sample = Sampler(problem, loads, static_loads).sample(theta, lambda modes: modes)
        chi, tables = Manifold(problem, loads, static_loads).at(theta, sample, np.eye(sample.n_kept))

    def energy(u: np.ndarray) -> float:
        return sum(
            energy_of(solid, {})((recovery @ u[body.dofs]).reshape(-1, solid.mesh.dimension))
            for body, (solid, _, recovery) in zip(mechanism.bodies, bodies.values())
        )

    stiffness, cubic = sample.stiffness.sum(axis=0), tables.cubic[0].sum(axis=0)
    delta = np.random.default_rng(2).normal(size=len(stiffness)) / np.sqrt(np.diagonal(stiffness))
    delta *= 0.05 / np.max(np.abs(sample.shape[: 3 * mechanism.n_nodes] @ delta))
    left, sizes = [], []
    for k in range(HALVINGS):
        d = delta / 2**k
        # of fourth order, what T leaves out is large: sections that turn are too stiff in it. The odd part is not
        there, back = (energy(sample.shape @ e + chi @ pair_products(e[None])[0]) for e in (d, -d))
        expected = np.einsum("ijk,i,j,k", cubic, d, d, d) / 6
        left.append(abs(0.5 * (there - back) - expected))
        sizes.append(abs(expected) / there)
    assert sizes[0] > 1e-4, sizes
    assert abs(orders(left)[1] - 5) < 0.3, left


def frames_and_residual(scene: Scene, meshes: dict) -> list[dict[str, list[float]]]:
    """Return by how much joints are missed with and without the curvature, deformations halved each time."""
    rom = rom_with(scene, meshes)
    kinematics = RigidKinematics(Mechanism.from_scene(scene, rom.meshes))
    mechanism = kinematics.mechanism
    unknowns = Unknowns(mechanism)
    constraints = ConstraintSet(unknowns)
    m, row = rom.tables.n_modes, 1
    theta = rom.tables.samples.theta[row]
    size = 0.02 / np.max(np.abs(rom.projection[row, : 6 * mechanism.n_nodes]), axis=0)
    delta = size * np.random.default_rng(3).normal(size=m)
    errors: dict[str, list[float]] = {}
    for name, model in (("curved", rom), ("straight", replace(rom, curvature=None))):
        back = Reconstruction(kinematics, model, scene.interpolation, range(mechanism.n_nodes))
        errors[name] = []
        for k in range(HALVINGS):
            frames = back.frames(np.array([[*theta, *(delta / 2**k)]]))[:, :12]
            q = np.zeros((unknowns.n_dofs, 1))
            q[: frames.size, 0] = frames.ravel()
            errors[name].append(float(np.max(np.abs(constraints.residual(q)))))
    return errors


IN_SPACE = {
    "beams": (slider_crank_of_beams, meshes_of),
    "solids": (slider_crank_in_space, meshes_of),
    "ball, cross and guide": (spatial_slider_crank, meshes_of),
    "rigid crank": (lambda *more: slider_crank_in_space("bodies.crank.flexible=false", *more), meshes_of),
}


@pytest.mark.parametrize("made", IN_SPACE.values(), ids=IN_SPACE)
def test_joints_in_space_hold_to_third_order(made: tuple[Callable, Callable]) -> None:
    scene = made[0](SECOND, "reduction.modes=3", "reduction.angles=6", "reduction.static_modes=false")
    errors = frames_and_residual(scene, made[1](scene))
    assert abs(orders(errors["straight"])[-1] - 2) < 0.1, errors
    assert abs(orders(errors["curved"])[-1] - 3) < 0.15, errors


TORQUE = 'effects.motor={type="torque", joint="crank_hinge", table=[[0.0,0.0],[0.05,3.0],[0.1,0.0],[1.0,0.0]]}'
OUTPUTS = (
    'outputs.slider_position={type="position",point="rod:tip",axis="x"}',
    'outputs.slider_deformation={type="deformation",point="rod:tip",axis="x"}',
)
SHORT = (TORQUE, "simulation.duration=0.12", "simulation.step=5e-4", "reduction.angles=32")


def test_beams_in_the_plane_are_the_same_in_space() -> None:
    """The modes in the plane of those in space, and all of their second order: runs agree.

    How much of the shortening follows at once hangs on all modes, those out of the plane too: 4e-4 of the deformation.
    """
    common = (*SHORT, *OUTPUTS, SECOND, "reduction.static_modes=true", "reduction.inertia_modes=true",
              'reduction.stretching="dynamic"')  # fmt: skip
    deep = slider_crank_of_beams(*common, "reduction.modes=6")
    other = rom_with(deep, meshes_of(deep))
    many = slider_crank("reduction.modes=6", "reduction.angles=4")
    own = rom_with(many, meshes_of(many)).frequencies_hz[0]
    n = sum(np.abs(own / frequency - 1.0).min() < 1e-6 for frequency in other.frequencies_hz[0])
    assert 2 <= n < 6
    flat = slider_crank(*common, f"reduction.modes={n}")
    one = rom_with(flat, meshes_of(flat))
    runs = [motion(ReducedModel(scene, rom)) for scene, rom in ((flat, one), (deep, other))]
    for name, expected in runs[0].outputs.items():
        np.testing.assert_allclose(
            runs[1].outputs[name], expected, rtol=0, atol=1e-8 * np.abs(expected).max(), err_msg=name
        )


def test_second_order_brings_a_run_on_cells_closer_to_the_full_order_one() -> None:
    """Under a smooth pulse of torque; of 1.6e-3 of the deformation 5.0e-4 are left, part of it the step's."""
    times = np.linspace(0.0, 0.2, 41)
    pulse = [[float(t), round(float(4.8 * np.sin(np.pi * t / 0.2) ** 2), 9)] for t in times]
    common = (f'effects.motor={{type="torque", joint="crank_hinge", table={pulse}}}', "simulation.duration=0.2",
              "simulation.step=2.5e-4", "reduction.modes=7", "reduction.angles=48", "reduction.static_modes=true",
              "reduction.inertia_modes=true", 'reduction.interpolation="spline"')  # fmt: skip
    scene, meshes = solid_slider_crank(*common), solid_meshes()
    full = motion("full", scene, meshes).outputs["slider_deformation"]
    errors = []
    for more in ((), (SECOND,)):
        scene = solid_slider_crank(*common, *more)
        run = motion(ReducedModel(scene, rom_with(scene, meshes)))
        errors.append(np.abs(run.outputs["slider_deformation"] - full).max() / np.abs(full).max())
    assert errors[1] < 0.5 * errors[0], errors


@pytest.mark.parametrize("made", [IN_SPACE["beams"], IN_SPACE["solids"]], ids=["beams", "solids"])
def test_energy_is_balanced_with_the_square_of_the_step(made: tuple[Callable, Callable]) -> None:
    """Terms of second order in space have a Lagrangian; the torque is put on at once."""
    shares, motor = [], 'effects.motor={type="torque", joint="crank_hinge", table=[[0.0,3.0],[0.1,0.0],[1.0,0.0]]}'
    common = (motor, SECOND, "reduction.modes=4", "reduction.angles=24", "simulation.duration=0.05")
    scene = made[0](*common)
    rom = rom_with(scene, made[1](scene))
    for step in (4e-4, 2e-4):
        scene = made[0](*common, "simulation.spectral_radius=1.0", f"simulation.step={step}")
        balance = motion(ReducedModel(scene, rom)).balance
        shares.append(np.abs(balance.residual).max() / balance.exchanged)
    # 7e-6 with the smaller step
    assert shares[1] < 5e-5 and np.log2(shares[0] / shares[1]) > 1.8, shares
