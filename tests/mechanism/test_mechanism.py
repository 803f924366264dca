"""The mechanism: numbering, attachments, assembly and loads; what every feature needs of it."""

import numpy as np
import pytest
from combinations import KINDS, TINY
from conftest import ROOT
from mpi4py import MPI

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.matrices import AffineMatrices, owned_rows
from pgmp_petsc.effects import effects_of, loads_of
from pgmp_petsc.mechanism.capabilities import FEATURES, Purpose, check_capabilities
from pgmp_petsc.mechanism.mechanism import Unknowns
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.inputs import read_scene
from scenes import RADIUS, ROD, STEEL, four_bar, mechanism_of, slider_crank, trammel

ONE, R2, R4 = Monomial(), Monomial((("r1", 2),)), Monomial((("r1", 4),))
GRAVITY = 'effects.weight={type="gravity",direction=[0.0,-2.0],acceleration=9.81}'


def all_loads(scene: Scene) -> tuple:
    mechanism = mechanism_of(scene)
    return loads_of(effects_of(scene, mechanism), AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)))


def test_unknowns_are_numbered_body_after_body() -> None:
    mechanism = mechanism_of(slider_crank())
    assert [body.nodes for body in mechanism.bodies] == [slice(0, 6), slice(6, 12)]
    assert (mechanism.n_nodes, mechanism.n_dofs, mechanism.n_constraints) == (12, 36, 5)
    assert [connection.rows for connection in mechanism.connections] == [slice(0, 2), slice(2, 4), slice(4, 5)]
    np.testing.assert_array_equal(mechanism.bodies[1].elements, np.column_stack([range(6, 11), range(7, 12)]))
    np.testing.assert_allclose(mechanism.bodies[1].directions, 0.0, atol=0)
    assert mechanism.mass_weights == mechanism.stiffness_weights == (ONE, R2, R4)
    (coordinate,) = mechanism.coordinates
    assert (coordinate.lower, coordinate.upper, coordinate.periodic) == (0.0, 2 * np.pi, True)


def test_nodes_have_addresses() -> None:
    mechanism = mechanism_of(slider_crank())
    assert mechanism.attachment("rod:hinge", "outputs.a.point").node == 6
    assert mechanism.attachment("rod:tip", "outputs.a.point").node == 11
    assert mechanism.attachment("rod:2", "outputs.a.point").node == 8
    with pytest.raises(InputError, match=r'outputs\.a\.point = "tipp".*did you mean \'tip\''):
        mechanism.attachment("rod:tipp", "outputs.a.point").node
    with pytest.raises(InputError, match=r'joints\.elbow\.connect = "top".*no point of this name'):
        mechanism_of(slider_crank('joints.elbow.connect=["crank:top","rod:hinge"]'))


def test_the_frame_of_a_node_and_of_the_pose_agree() -> None:
    mechanism = mechanism_of(four_bar())
    poses = np.random.default_rng(0).normal(size=(3, 3, 4))
    q = Unknowns(mechanism).place(poses)
    assert q.shape == (mechanism.n_dofs, 4)
    for connection in mechanism.connections:
        for side in (connection.a, connection.b):
            if not side.on_ground:
                of_node = side.frame_of(mechanism.by_node(q)[side.node])
                np.testing.assert_allclose(of_node, side.frame_of_pose(poses), rtol=0, atol=1e-15)
                assert of_node.shape == (3, 4)
    pivot = mechanism.connection("rocker_hinge").b
    assert pivot.on_ground
    np.testing.assert_array_equal(pivot.frame_of_pose(poses[..., 0]), [1.0, 0.0, 0.0])


def test_bodies_without_a_placement_are_joined_to_those_placed() -> None:
    mechanism = mechanism_of(slider_crank('bodies.rod.mesh="0.0:0.7:5"'))
    np.testing.assert_allclose(mechanism.first_guess, [[0, 0, 0], [0.3, 0, 0]], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(mechanism_of(trammel()).first_guess[0], [1.0, 0.0, np.pi])


def test_a_torque_on_the_ground_hinge_loads_one_node() -> None:
    (load,) = all_loads(slider_crank())
    expected = np.zeros(36)
    expected[2] = 1.0
    np.testing.assert_array_equal(load.vector, expected)
    assert (load.effect, load.weight) == ("motor", ONE)


def test_a_torque_between_bodies_has_its_reaction() -> None:
    scene = slider_crank('effects.motor.joint="elbow"', 'effects.motor.scale="gain"', "parameters.gain.nominal=1.0")
    (load,) = all_loads(scene)
    assert load.weight == Monomial((("gain", 1),))
    assert (load.vector[17], load.vector[20]) == (-1.0, 1.0)
    assert np.count_nonzero(load.vector) == 2


def test_the_table_of_a_torque_is_linear_and_constant_beyond_its_ends() -> None:
    scene = slider_crank("effects.motor.table=[[1.0,2.0],[2.0,6.0]]", "effects.motor.scale=3.0")
    (effect,) = effects_of(scene, mechanism_of(scene))
    assert [effect.amplitude(t) for t in (0.0, 1.0, 1.5, 2.0, 9.0)] == [2.0, 2.0, 4.0, 6.0, 6.0]
    (load,) = all_loads(scene)
    assert load.vector[2] == 3.0


def test_gravity_is_the_weight_of_every_body() -> None:
    loads = [load for load in all_loads(slider_crank(GRAVITY)) if load.effect == "weight"]
    assert {load.weight for load in loads} == {ONE, R2}  # the rotary mass, r1^4, takes no part
    for load in loads:
        nodal = load.vector.reshape(-1, 3)
        length, body = (ROD, slice(6, 12)) if load.weight == ONE else (0.3, slice(0, 6))
        area = np.pi * (RADIUS**2 if load.weight == ONE else 1.0)
        np.testing.assert_allclose(nodal[:, [0, 2]], 0.0, atol=0)
        assert nodal[body, 1].sum() == pytest.approx(-9.81 * STEEL["rho"] * area * length, rel=1e-14)
        assert np.count_nonzero(nodal[:, 1]) == 6
    scene = slider_crank(GRAVITY.replace("9.81", '"g"'), "parameters.g.nominal=9.81")
    assert {str(load.weight) for load in all_loads(scene) if load.effect == "weight"} == {"g", "g r1^2"}
    (effect,) = [effect for effect in effects_of(scene, mechanism_of(scene)) if effect.name == "weight"]
    assert effect.amplitude(3.0) == 1.0


@pytest.mark.parametrize("size", [2, 3])
def test_every_rank_has_its_rows_of_the_same_loads(size: int) -> None:
    """A load that vanishes in one rank's rows is still a load, or the ranks disagree on their number."""
    scene = slider_crank(GRAVITY)
    mechanism = mechanism_of(scene)
    effects = effects_of(scene, mechanism)
    whole = all_loads(scene)
    rows = [owned_rows(mechanism.n_dofs, rank, size) for rank in range(size)]
    shares = [loads_of(effects, AffineMatrices(mechanism.bodies, own)) for own in rows]
    for share in shares:
        assert [(load.effect, load.weight) for load in share] == [(load.effect, load.weight) for load in whole]
    for index, load in enumerate(whole):
        np.testing.assert_array_equal(np.concatenate([share[index].vector for share in shares]), load.vector)


#: What asks for each feature that an entry of a scene asks for.
ASKING = {
    "terms of second order": ("reduction.second_order=true",),
    "adaptive sampling": ("reduction.sampling_tolerance=0.1", 'reduction.interpolation="spline"'),
    "choice of the reduction by a tolerance": ("reduction.tolerance=0.1",),
    "choice of the step by a tolerance": ("simulation.tolerance=0.1",),
    "choice of effects": ('reduction.effects="auto"',),
    "stiffness by loads, inertia of changing modes": ('effects.x={type="mode_inertia"}',
                                                      'effects.y={type="geometric_stiffening"}'),
}  # fmt: skip


def scene_of(kind: str, *overrides: str) -> Scene:
    return scene_from_toml(KINDS[kind], ".", (*TINY, *overrides))


@pytest.mark.parametrize("asked", ASKING.values(), ids=ASKING)
@pytest.mark.parametrize("purpose", list(Purpose))
def test_a_feature_is_refused_where_it_is_used_and_nowhere_else(asked: tuple[str, ...], purpose: Purpose) -> None:
    beams = scene_of("beams", *asked)
    check_capabilities(beams, purpose)
    others = [one for one in FEATURES if purpose in one.purposes and not list(one.entries(beams))]
    commands = (Purpose.SIZES,)  # it takes no such mechanism, whatever the scene asks for
    for kind in ("two coordinates", "cells in the plane"):
        scene = scene_of(kind, *asked)
        if not any(list(other.entries(scene)) for other in others) and purpose not in commands:
            check_capabilities(scene, purpose)


@pytest.mark.parametrize("purpose", [Purpose.FULL, Purpose.CHECK, Purpose.BUILD, Purpose.TRADEOFF])
@pytest.mark.parametrize("name", ["five_bar", "platform_3rrr", "slider_crank_solid2d", "rssr_beams", "spatial_mixed"])
def test_every_kind_that_can_be_reduced_may_have_tolerances(name: str, purpose: Purpose) -> None:
    tolerances = ["simulation.tolerance=1e-2", "reduction.tolerance=1e-2"]
    read_scene(ROOT / "scenes" / f"{name}.toml", tolerances, [], MPI.COMM_SELF, purpose)


@pytest.mark.parametrize("purpose", [Purpose.FULL, Purpose.CHECK])
def test_the_step_of_rigid_mechanisms_is_not_chosen_by_a_tolerance(purpose: Purpose) -> None:
    with pytest.raises(InputError, match="simulation.tolerance = 0.1: .* but all are rigid; leave it out, and give"):
        check_capabilities(scene_of("all rigid in the plane", "simulation.tolerance=0.1"), purpose)


@pytest.mark.parametrize("purpose", [Purpose.BUILD, Purpose.MODES, Purpose.REDUCED, Purpose.TRADEOFF])
def test_rigid_mechanisms_have_nothing_to_reduce(purpose: Purpose) -> None:
    with pytest.raises(
        InputError, match="all are rigid, so there is nothing to reduce; run pgmp simulate SCENE --full"
    ):
        check_capabilities(scene_of("all rigid in the plane"), purpose)


def test_angles_that_a_tolerance_finds_are_priced_as_those_that_nobody_gives(tmp_path) -> None:
    """Three coordinates at 629 angles along each, the default of one, would be refused."""
    text = (ROOT / "scenes" / "platform_3rrr.toml").read_text()
    (tmp_path / "scene.toml").write_text(text.replace("angles = 6 ", "tolerance = 0.01 "))
    read_scene(tmp_path / "scene.toml", [], [], MPI.COMM_SELF, Purpose.BUILD)
