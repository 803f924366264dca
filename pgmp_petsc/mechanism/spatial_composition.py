"""From a scene to a mechanism in space: attachments, joints with their axes, and where the assembly begins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.composition import welded_masses
from pgmp_petsc.mechanism.space import SPATIAL, directors
from pgmp_petsc.mechanism.spatial_attachment import SpatialAttachment
from pgmp_petsc.mechanism.spatial_connection import SpatialConnection
from pgmp_petsc.mechanism.spatial_joints import SpatialJoint, spatial_joint, triad
from pgmp_petsc.scene.schema import Scene

GROUND = "ground"


def spatial_attachment(scene: Scene, bodies: Sequence[Body], address: str, entry: str) -> SpatialAttachment:
    """Return the attachment at ``"body:point"`` or ``"ground:point"``; raises as `composition.attachment_at`."""
    name, _, point = address.partition(":")
    if name == GROUND:
        return SpatialAttachment(-1, -1, np.asarray(scene.ground.position(point, 3)))
    index = next(i for i, body in enumerate(bodies) if body.name == name)
    body = bodies[index]
    number = body.shape.point(point, entry)
    place = body.shape.nodes[number]
    if body.flexible:
        return SpatialAttachment(index, body.first_node + number, place)
    return SpatialAttachment(index, body.first_node, place, place - body.mesh.nodes[0])


def spatial_connections(
    scene: Scene, bodies: Sequence[Body], poses: np.ndarray
) -> tuple[SpatialConnection, ...]:
    """Return the joints of a scene, and the welds of point masses to rigid bodies.

    A joint's axes in the second body are those of the first at poses (n_bodies, 12).
    """
    connections, row = [], 0
    for name, entry in scene.joints.items():
        a, b = (spatial_attachment(scene, bodies, address, f"joints.{name}.connect") for address in entry.connect)
        in_a = triad(*(np.asarray(axis, dtype=float) for axis in entry.axes))
        turns = [np.eye(3) if side.on_ground else directors(poses[side.body]) for side in (a, b)]
        axes = (in_a, turns[1].T @ turns[0] @ in_a)
        joint: SpatialJoint = spatial_joint(entry.type, axes)
        connections.append(SpatialConnection(name, joint, a, b, slice(row, row + joint.n_constraints), axes))
        row += joint.n_constraints
    for name, a, b in _welds(scene, bodies):
        axes = (np.eye(3), np.eye(3))
        joint = spatial_joint("fixed", axes)
        connections.append(SpatialConnection(f"{name}:mass", joint, a, b, slice(row, row + joint.n_constraints), axes))
        row += joint.n_constraints
    return tuple(connections)


def _welds(scene: Scene, bodies: Sequence[Body]) -> Iterator[tuple[str, SpatialAttachment, SpatialAttachment]]:
    """Yield the point masses that are welded to rigid bodies: name, carrier and particle."""
    for name, (effect, index) in welded_masses(scene, bodies).items():
        carrier = spatial_attachment(scene, bodies, effect.point, f"effects.{name}.point")
        yield name, carrier, SpatialAttachment(index, bodies[index].first_node, bodies[index].mesh.nodes[0])


def spatial_first_guess(scene: Scene, bodies: Sequence[Body]) -> np.ndarray:
    """Return poses to start the assembly from, shape (n_bodies, 12); they choose the assembly branch.

    A body with a `placement` takes that; the others are moved, joint by joint from the ground, so that their joint
    point meets the one already placed, with the direction that they have in their mesh.
    """
    poses = np.tile(SPATIAL.identity, (len(bodies), 1))
    placed = np.zeros(len(bodies), dtype=bool)
    for number, body in enumerate(bodies):
        placement = scene.bodies[body.name].placement if body.name in scene.bodies else None
        if placement is not None:
            poses[number, :3] = placement.origin_in(3)
            poses[number, 3:] = Rotation.from_rotvec(placement.rotation or (0.0, 0.0, 0.0)).as_matrix().T.ravel()
            placed[number] = True
    waiting = [
        tuple(spatial_attachment(scene, bodies, address, f"joints.{name}.connect") for address in entry.connect)
        for name, entry in scene.joints.items()
        if entry.type in ("spherical", "revolute", "universal", "fixed")
    ]
    waiting += [(carrier, particle) for _, carrier, particle in _welds(scene, bodies)]
    while True:
        ready = [(a, b) for a, b in waiting if (a.on_ground or placed[a.body]) != (b.on_ground or placed[b.body])]
        if not ready:
            return poses
        a, b = ready[0]
        anchor, loose = (a, b) if a.on_ground or placed[a.body] else (b, a)
        if bodies[loose.body].name not in scene.bodies:
            poses[loose.body, 3:] = poses[anchor.body, 3:]
        poses[loose.body, :3] += anchor.frame_of_pose(poses)[:3] - loose.frame_of_pose(poses)[:3]
        placed[loose.body] = True
        waiting.remove((a, b))
