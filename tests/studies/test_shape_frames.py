"""Frames of the whole mechanism: beams by their nodes, rigid bodies by the nodes of their shape."""

import numpy as np
from effect_scenes import BAR, mechanism_with_lines, scene_of

from pgmp_petsc.mechanism.space import PLANE
from pgmp_petsc.studies.field_frames import shape_frames
from scenes import tables

FOREARM = tables("""
[bodies.forearm]
line = { length = 0.6, elements = 3 }
element = "beam2d"
section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1.0, \
rotary_density = 1.0e-3 }
joints.elbow: type = "revolute"; connect = ["bar:tip", "forearm:hinge"]
coordinates.bend: joint = "elbow"; range = [-1.0, 1.0]
""")


def test_undeformed_bodies_stand_where_their_poses_place_their_shapes() -> None:
    mechanism = mechanism_with_lines(scene_of(BAR, FOREARM))
    poses = np.random.default_rng(3).normal(size=(2, 3, 5))
    nodal = np.moveaxis(mechanism.place(poses).reshape(mechanism.n_nodes, 3, 5), -1, 0)
    frames = shape_frames(mechanism, nodal, np.arange(5.0))
    for body, pose in zip(mechanism.bodies, poses):
        exact = np.moveaxis(PLANE.place(pose, body.shape.nodes), -1, 0)
        np.testing.assert_allclose(frames.positions[body.name], exact[..., :2], atol=1e-14)
        np.testing.assert_array_equal(frames.rotations[body.name], exact[..., 2])
    assert frames.rigid == {"bar"}
    assert {name: len(cells) for name, cells in frames.cells.items()} == {"bar": 2, "forearm": 3}


def test_a_point_mass_is_a_single_node() -> None:
    bob = 'effects.bob: type = "point_mass"; point = "bar:tip"; mass = 2.0'
    mechanism = mechanism_with_lines(scene_of(BAR, tables(bob)))
    poses = np.zeros((len(mechanism.bodies), 3, 1))
    nodal = np.moveaxis(mechanism.place(poses).reshape(mechanism.n_nodes, 3, 1), -1, 0)
    frames = shape_frames(mechanism, nodal, np.zeros(1))
    lone = [name for name, cells in frames.cells.items() if not len(cells)]
    assert frames.rigid == set(frames.nodes) and len(lone) == len(mechanism.bodies) - 1
