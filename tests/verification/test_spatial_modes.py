"""Modes of mechanisms in space: beams in the plane, closed forms, bodies that are not condensed, and nearly equal
modes."""

from functools import lru_cache

import numpy as np
import pytest
import scipy.linalg
import spatial
from conftest import ROOT
from mpi4py import MPI
from pencils import dense_pencil
from runs import ONE_RANK, built_rom, history, samples
from scipy.spatial.transform import Rotation
from scrambling import clusters, turned

from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.effects.damping import free_modes
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.inputs import read_scene
from scenes import kinematics_of, meshes_of


def condensed_kinematics(scene: Scene, meshes: dict[str, BodyShape] | None = None) -> RigidKinematics:
    shapes = condensed(scene, meshes_of(scene) if meshes is None else meshes, ONE_RANK)
    return RigidKinematics(Mechanism.from_scene(scene, shapes))


def modal_problem(scene: Scene, kinematics: RigidKinematics, n_modes: int | None = None) -> ModalProblem:
    """Return the problem of one process at the nominal parameters."""
    return ModalProblem(kinematics, scene.nominal, n_modes or scene.reduction.modes, MPI.COMM_SELF)


def out_of_plane(kinematics: RigidKinematics, flexible: np.ndarray) -> np.ndarray:
    """Return the share of every mode, 0 to 1, that moves the frames out of the plane z = 0 or tilts them."""
    moved = kinematics.mechanism.by_node(flexible) * np.array([1.0] * 3 + [kinematics.size] * 3)[None, :, None]
    sizes = np.sum(moved**2, axis=0)
    return np.sum(sizes[[2, 3, 4]], axis=0) / np.sum(sizes, axis=0)


@lru_cache(maxsize=None)
def round_rods() -> tuple[Scene, dict[str, BodyShape]]:
    """Return the repository's slider-crank of solid rods, condensed."""
    scene, meshes = read_scene(ROOT / "scenes" / "slider_crank_solid3d.toml", (), (), MPI.COMM_SELF, Purpose.CHECK)
    return scene, condensed(scene, meshes, ONE_RANK)


def test_the_modes_in_the_plane_are_those_of_beams() -> None:
    scene, shapes = round_rods()
    fine = [f'bodies.{name}.mesh="../meshes/{name}_40.msh"' for name in ("crank", "rod")]
    planar, meshes = read_scene(ROOT / "scenes" / "slider_crank.toml", fine, (), MPI.COMM_SELF, Purpose.CHECK)
    kinematics = RigidKinematics(Mechanism.from_scene(scene, shapes))
    beams = RigidKinematics(Mechanism.from_scene(planar, meshes))
    # rigid bodies do not need what holds the rod in the plane twice, flexible ones do
    assert kinematics.n_redundant == 1
    with modal_problem(scene, kinematics) as deep, modal_problem(planar, beams, 4) as flat:
        assert deep.n_redundant == 0
        for theta in (0.0, 0.7, np.pi / 2, 2.4, np.pi, 4.0):
            modes = deep.solve(theta)
            shares = out_of_plane(kinematics, modes.flexible)
            # the rods and their joints are symmetric: a mode is in the plane or out of it
            np.testing.assert_allclose(shares, np.rint(shares), rtol=0, atol=1e-6)
            assert shares.sum() == pytest.approx(5.0, abs=1e-5)
            found = modes.frequencies_hz[shares < 0.5][:4]
            # beams have a straight section and the solids' frames give way a little; measured 0.6 % at most
            np.testing.assert_allclose(found, flat.solve(theta).frequencies_hz, rtol=0.01)


LENGTH = 1.0
# roots of cos x cosh x = -1 (one end clamped) and tan x = tanh x (one end hinged), the other end free
CLAMPED, HINGED = np.array([1.875104, 4.694091, 7.854757]), np.array([3.926602, 7.068583])


def one_bar(axis: tuple[float, float, float]) -> Scene:
    """Return a slender bar of 1 m on a hinge."""
    hinge = spatial.table("joints.drive", type="revolute", connect=["ground:origin", "bar:hinge"], axis=axis)
    return spatial.assembled(spatial.solid("bar", LENGTH), hinge, coordinate="range = [0.0, 1.0]")


def frequencies_of_one_bar(axis: tuple[float, float, float], n_modes: int) -> np.ndarray:
    scene = one_bar(axis)
    kinematics = condensed_kinematics(scene, {"bar": spatial.bar(0.0, LENGTH, 40)})
    with modal_problem(scene, kinematics, n_modes) as problem:
        return problem.solve(0.4).frequencies_hz


def bending(roots: np.ndarray) -> np.ndarray:
    """Return frequencies (Hz) of a slender bar in bending by Euler and Bernoulli."""
    speed = np.sqrt(210e9 / spatial.DENSITY) * spatial.WIDTH / np.sqrt(12.0)
    return (roots / LENGTH) ** 2 * speed / (2 * np.pi)


def test_a_bar_across_its_hinge_is_hinged_in_one_plane_and_clamped_in_the_other() -> None:
    """A square bar has the same bending stiffness about every axis across it."""
    expected = np.sort(np.concatenate([bending(CLAMPED), bending(HINGED)]))
    # shear and rotary inertia: (root radius of gyration / length)^2 is 5e-4 for the highest one; measured 4.4e-4
    np.testing.assert_allclose(frequencies_of_one_bar((0.0, -3.0, 4.0), 5), expected, rtol=1e-3)


def test_a_bar_along_its_hinge_is_clamped_in_both_planes() -> None:
    found = frequencies_of_one_bar((1.0, 0.0, 0.0), 6)
    np.testing.assert_allclose(found, np.repeat(bending(CLAMPED), 2), rtol=1e-3)
    # pairs of equal modes, as the square has no preferred direction: round-off of the mesh, measured 1e-10
    np.testing.assert_allclose(found[::2], found[1::2], rtol=1e-8)


def test_the_free_modes_of_a_bar() -> None:
    """Those that modal damping damps: pairs of bending modes, none of the six rigid motions among them."""
    scene = one_bar((0.0, 0.0, 1.0))
    (body,) = condensed_kinematics(scene, {"bar": spatial.bar(0.0, LENGTH, 40)}).mechanism.bodies
    omega, phi, _ = free_modes(body, scene.nominal, 4, "test")
    # roots of cos x cosh x = 1
    expected = np.repeat(bending(np.array([4.730041, 7.853205])), 2)
    np.testing.assert_allclose(omega / (2 * np.pi), expected, rtol=1e-3)
    matrices = AffineMatrices([body.alone()], range(len(phi)))
    mass = weighted_sum(matrices.mass, scene.nominal)
    np.testing.assert_allclose(phi.T @ mass @ phi, np.eye(4), rtol=0, atol=1e-9)
    d, fields = 3, body.linear_fields()
    spins = [fields[:, d * (1 + i) + j] - fields[:, d * (1 + j) + i] for i in range(d) for j in range(i)]
    rigid = np.column_stack([fields[:, :d], *spins])
    sizes = np.sqrt(np.einsum("dk,dk->k", rigid, mass @ rigid))
    # zero eigenvalues are 1e-6 or so of the first elastic one
    np.testing.assert_allclose(phi.T @ (mass @ (rigid / sizes)), 0.0, rtol=0, atol=1e-6)


def test_the_size_of_a_body_does_not_depend_on_its_frames() -> None:
    """A body with a single frame has its size too, condensed or not: the closure is scaled with it."""
    scene = one_bar((0.0, 0.0, 1.0))
    meshes = {"bar": spatial.bar(0.3, 1.3, 4)}
    for kinematics in (condensed_kinematics(scene, meshes), RigidKinematics(Mechanism.from_scene(scene, meshes))):
        (body,) = kinematics.mechanism.bodies
        assert body.n_nodes == 1
        # a straight bar is as long as its radius of gyration says
        assert body.extent == kinematics.size == pytest.approx(LENGTH, rel=1e-9)


def test_nothing_depends_on_how_the_mechanism_lies_in_space() -> None:
    turn = Rotation.from_rotvec([0.5, -0.8, 1.1])
    upright = spatial.slider_crank_in_space(*spatial.LIMITED)
    # axes of joints with the ground are turned, and the bodies as they are placed; axes between bodies stay
    lying = spatial.slider_crank_in_space(
        *spatial.LIMITED,
        f"bodies.crank.placement={{origin=[0.0,0.0,0.0],rotation={turn.as_rotvec().tolist()}}}",
        f"bodies.rod.placement={{origin=[0.0,0.0,0.0],rotation={turn.as_rotvec().tolist()}}}",
        f"joints.crank_hinge.axis={turn.apply([0.0, 0.0, 1.0]).tolist()}",
        f"joints.slider.direction={turn.apply([1.0, 0.0, 0.0]).tolist()}",
    )
    found = []
    for scene in (upright, lying):
        with modal_problem(scene, condensed_kinematics(scene)) as problem:
            found.append([problem.solve(theta).frequencies_hz for theta in (-0.7, 0.2, 0.9)])
    # the solver's own tolerance is 1e-13 of the largest of the shifted and inverted values
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)


SCENES = {
    "slider_crank": (spatial.slider_crank_in_space(*spatial.LIMITED), ([-0.8], [0.3])),
    "spatial_slider_crank": (spatial.spatial_slider_crank(*spatial.LIMITED, "reduction.modes=6"), ([-0.8], [0.3])),
    "arm": (spatial.arm(*spatial.part_of_arm(0.5)), ([-0.4, 0.3], [0.2, 0.5])),
}


@pytest.mark.parametrize("name", SCENES)
def test_condensed_bodies_have_the_modes_of_their_meshes(name: str) -> None:
    scene, angles = SCENES[name]
    small, large = condensed_kinematics(scene), kinematics_of(scene)
    assert large.mechanism.n_dofs >= 2 * small.mechanism.n_dofs
    with modal_problem(scene, small) as condensed_problem, modal_problem(scene, large) as problem:
        for theta in np.array(angles):
            found, expected = condensed_problem.solve(theta), problem.solve(theta)
            exact = scipy.linalg.eigvalsh(*dense_pencil(large, theta[None], scene.nominal))
            # what the component modes leave, compliances are served to 1e-10, and round-off of the meshes' largest
            # eigenvalue
            round_off = 1e-16 * exact[-1]
            np.testing.assert_allclose(found.eigenvalues, expected.eigenvalues, rtol=1e-9, atol=round_off)
            n = expected.eigenvalues.size
            # the dense solver errs by more of it
            np.testing.assert_allclose(
                expected.eigenvalues, exact[theta.size : theta.size + n], rtol=1e-9, atol=10 * round_off
            )
            # the frames move alike in every mode, but for its sign; mode shapes have the root of that error
            nodal = slice(0, small.mechanism.by_node(found.flexible).shape[0])
            one, other = (
                kinematics.mechanism.by_node(modes.flexible)[nodal]
                for kinematics, modes in ((small, found), (large, expected))
            )
            signs = np.sign(np.sum(one * other, axis=(0, 1)))
            np.testing.assert_allclose(one * signs, other, rtol=0, atol=1e-4 * np.abs(other).max())


# A mode in the plane and one out of it cross near 1.7 rad. Weight in all directions moves both.
WEIGHT = (
    'effects.weight={type="gravity",direction=[0.3,-1.0,0.6]}',
    'outputs.lift={type="deformation",point="rod:hinge",axis="z"}', "simulation.duration=0.1",
    "reduction.static_modes=false", "reduction.inertia_modes=false",
)  # fmt: skip
# an arc around the crossing with angles so close that both modes form a cluster at many of them
ARC = (
    "coordinates.theta.range=[1.5,1.9]", "coordinates.theta.periodic=false", "reduction.angles=21",
    "simulation.initial.theta={position=1.55,velocity=3.0}",
)  # fmt: skip
#: Eigenvalues within such a share of each other are taken together, as the build itself does.
APART = 1e-2


def crossing_scene() -> Scene:
    path = ROOT / "scenes" / "slider_crank_solid3d.toml"
    return read_scene(path, (*WEIGHT, *ARC), (), MPI.COMM_SELF, Purpose.CHECK)[0]


def test_rotations_among_nearly_equal_modes_do_not_change_the_motion() -> None:
    scene, found = crossing_scene(), []

    def spoil(modes: ModeSet) -> ModeSet:
        found.append(len(clusters(modes.eigenvalues, APART)) < modes.eigenvalues.size)
        return turned(1, modes, APART)

    plain, spoilt = (built_rom(scene, *more, meshes=round_rods()[1]) for more in ((), (spoil,)))
    assert sum(found) >= 5
    # both modes are followed as one space, which turns little from one angle to the next
    assert plain.cosines.min() > 0.7
    np.testing.assert_allclose(spoilt.cosines, plain.cosines, rtol=0, atol=1e-9)
    one, other = (history(ReducedModel(scene, rom), samples(scene, 1), 1)[1] for rom in (plain, spoilt))
    assert np.abs(one["lift"]).max() > 1e-5 and np.ptp(one["crank_angle"]) > 0.1
    for output, expected in one.items():
        # round-off of the tables over a hundred steps would be 1e-10 or less; measured 1e-15
        np.testing.assert_allclose(other[output], expected, rtol=0, atol=1e-6 * np.abs(expected).max(), err_msg=output)


def test_the_crossing_modes_are_one_in_the_plane_and_one_out_of_it() -> None:
    """What the tests above turn against each other has nothing in common but its frequency."""
    scene = crossing_scene()
    kinematics = RigidKinematics(Mechanism.from_scene(scene, round_rods()[1]))
    with modal_problem(scene, kinematics) as problem:
        for theta, order in ((1.5, [1.0, 0.0]), (1.9, [0.0, 1.0])):
            modes = problem.solve(theta)
            pair = np.argsort(np.abs(modes.frequencies_hz - 420.0))[:2]
            shares = out_of_plane(kinematics, modes.flexible[:, np.sort(pair)])
            np.testing.assert_allclose(shares, order, rtol=0, atol=1e-6)
