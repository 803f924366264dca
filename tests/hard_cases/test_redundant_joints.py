"""Joints that say again what others say: how many constraints are dropped, and that the motion stays the same."""

from functools import lru_cache

import numpy as np
import pytest
from mechanisms import Outputs, accurate, both, run_for, start
from mpi4py import MPI
from runs import assert_close, full_model, quick_return, rom_of, run_model

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.generalised_alpha import integrate
from scenes import kinematics_of, trammel

AGAIN = 'joints.again={type="point_on_line", connect=["ground:origin", "rod:tip"], direction=[-3.0, 0.0]}'
TWICE = 'joints.twice={type="revolute", connect=["crank:tip", "rod:hinge"]}'
DOUBLED = {"line": ((AGAIN,), 1), "line and revolute": ((AGAIN, TWICE), 3)}
MOVING = (*run_for(0.06, 1e-3), *start(0.5, 4.0))

# a block of 0.2 m behind the rod, guided at both its ends along the x axis; a third guide in its middle
GUIDED = (
    'bodies.block={mesh="1.0:1.2:4", element="beam2d", material="steel", section={shape="circle", radius=8e-3}}',
    'joints.wrist={type="revolute", connect=["rod:tip", "block:hinge"]}',
    'joints.guide={type="point_on_line", connect=["ground:origin", "block:tip"], direction=[1.0, 0.0]}',
    'outputs.block={type="position", point="block:tip", axis="x"}',
)
THIRD = 'joints.third={type="point_on_line", connect=["ground:origin", "block:2"], direction=[1.0, 0.0]}'


@lru_cache(maxsize=1)
def plain() -> tuple[Outputs, Outputs]:
    return both(accurate(*MOVING, angles=24))


@pytest.mark.parametrize("name", DOUBLED)
def test_doubled_joints_are_dropped_from_both_models(name: str) -> None:
    joints, n_redundant = DOUBLED[name]
    scene = accurate(*MOVING, *joints, angles=24)
    rom = rom_of(scene)
    assert (rom.n_redundant, kinematics_of(scene).n_redundant) == (n_redundant, n_redundant)
    # round-off of the tables; measured 2e-14 and 2e-11
    for exact, found in zip(plain(), both(scene, rom=rom)):
        assert_close(exact, found, angle=1e-11, bent=1e-8, slider=1e-11)


def test_a_doubled_line_that_turns_with_a_body() -> None:
    again = 'joints.again={type="point_on_line", connect=["rocker:2", "crank:tip"], direction=[-2.0, 0.0]}'
    ends = []
    for joints in ((), (again,)):
        system, run = run_model(full_model(quick_return("simulation.duration=0.1", *joints)))
        assert run.status[0] == 0
        ends.append(system.unpack(run.state.q))
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-11)


def test_doubled_joints_are_dropped_from_the_distributed_model() -> None:
    scene = accurate(*MOVING, TWICE, "simulation.duration=0.02")
    with full_model(scene).distributed(scene.values, MPI.COMM_SELF) as system:
        assert integrate(system, scene.simulation).status[0] == 0


def test_a_third_guide_of_a_guided_block() -> None:
    """Redundant for the rigid mechanism alone: it takes a bending mode from the block, which no force excites."""
    pair = accurate(*MOVING, *GUIDED, "reduction.modes=8", angles=24)
    triple = accurate(*MOVING, *GUIDED, THIRD, angles=24)
    assert kinematics_of(pair).n_redundant == 0
    assert kinematics_of(triple).n_redundant == 1
    # 8 modes of which the block's own (874 Hz) is the fifth, or 7 without it: the same of the rest
    two, three = rom_of(pair), rom_of(triple)
    kept = np.delete(two.frequencies_hz, 4, axis=1)
    np.testing.assert_allclose(three.frequencies_hz, kept, rtol=1e-9)
    # the flexible bodies meet in different nodes, so that nothing is redundant there
    assert (two.n_redundant, three.n_redundant) == (0, 0)
    for one, other in zip(both(pair, rom=two), both(triple, rom=three)):
        assert_close(one, other, angle=1e-10, bent=1e-8, slider=1e-10, block=1e-10)


@lru_cache(maxsize=1)
def trammel_rom() -> ReducedOrderModel:
    return rom_of(loaded_trammel(0.0))


def loaded_trammel(torque: float) -> Scene:
    """Return a rod with its ends on two lines and its middle on a crank, under a torque that rises over 0.3 s."""
    return trammel(
        "reduction.modes=8", "reduction.static_modes=true", "reduction.angles=48", 'reduction.interpolation="spline"',
        f'effects.motor={{type="torque", joint="crank_hinge", table=[[0.0, 0.0], [0.3, {torque}]]}}',
        'outputs.angle={type="angle", joint="crank_hinge"}', *run_for(0.4, 1e-3),
        'outputs.bent={type="deformation", point="rod:tip", axis="y"}',
    )  # fmt: skip


@pytest.mark.parametrize("torque", [2.0, 0.02])
def test_an_elliptic_trammel_with_a_redundant_crank(torque: float) -> None:
    """One constraint more than the rigid rod needs, at every angle; measured up to 4e-5, and 0.5 % of 3 mm."""
    scene = loaded_trammel(torque)
    assert kinematics_of(scene).n_redundant == 1
    assert_close(*both(scene, rom=trammel_rom()), angle=1e-4, bent=1e-2)
