"""The assembled mechanism of a scene at its start, with its bodies undeformed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, words_of
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.models.model import start_of
from pgmp_petsc.results.selection import Assembly
from pgmp_petsc.results.trajectory import Frames
from pgmp_petsc.scene import GROUND, Scene
from pgmp_petsc.scene.unit_systems import unit_system


def assembly_of(scene: Scene, meshes: Mapping[str, LineMesh | SolidMesh]) -> Assembly:
    """Return where bodies, joints and named points are at the start.

    Raises `InputError` if the mechanism cannot be assembled.
    """
    mechanism = Mechanism.from_scene(scene, meshes)
    kinematics = RigidKinematics(mechanism)
    theta = start_of(scene, mechanism)[0]
    poses = kinematics.poses(theta)
    poses = poses.reshape(*poses.shape[:2])
    space = mechanism.space
    d = space.dimension
    places = {
        body.name: space.place(pose, body.shape.nodes).reshape(len(body.shape.nodes), -1)
        for body, pose in zip(mechanism.bodies, poses)
    }
    angles = (lambda n: (1, n)) if d == 2 else (lambda n: (1, n, 3))
    frames = Frames(
        time=np.zeros(1),
        positions={name: at[None, :, :d] for name, at in places.items()},
        rotations={name: np.zeros(angles(len(at))) for name, at in places.items()},
        nodes={body.name: body.shape.nodes for body in mechanism.bodies},
        cells={body.name: body.shape.cells for body in mechanism.bodies},
        rigid=frozenset(body.name for body in mechanism.bodies if not body.flexible),
    )
    points = {
        f"{body.name}:{name}": places[body.name][node, :d]
        for body in mechanism.bodies
        for name, node in body.shape.points.items()
    }
    used = {side for joint in scene.joints.values() for side in joint.connect}
    for name in [*(("origin",) if f"{GROUND}:origin" in used else ()), *scene.ground.points]:
        points[f"{GROUND}:{name}"] = np.asarray(scene.ground_position(name))
    # of what slides the second point is the one that moves
    joints = {
        connection.name: connection.b.frame_of_pose(poses).ravel()[:d]
        for connection in mechanism.connections
        if connection.name in scene.joints
    }
    where = words_of(mechanism.coordinates, theta, 4)
    return Assembly(scene.name, where, frames, joints, points, unit_system(scene).unit("m"))
