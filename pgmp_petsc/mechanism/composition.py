"""From a scene to bodies and connections: numbering, attachments, and where the assembly begins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.beam3d import section_axes
from pgmp_petsc.bodies.body import Body, LumpedMass, joined
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.rigid_component import rigid_component, rigid_line
from pgmp_petsc.bodies.section import BeamSection, SpatialSection
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.connection import Connection
from pgmp_petsc.mechanism.joints import N_FRAME, Fixed, Joint, PointOnLine, Revolute
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene.effects import PointMass
from pgmp_petsc.scene.points import points_used
from pgmp_petsc.scene.schema import Scene

GROUND = "ground"


def bodies_of(scene: Scene, meshes: Mapping[str, BodyShape]) -> tuple[Body, ...]:
    """Return the bodies of a scene with the point masses that they carry, numbered one after the other.

    A point mass away from the centre of a rigid body is a body of its own, welded to it (`connections_of`): the mass
    matrices then stay constant, and affine in the parameters.

    Raises
    ------
    InputError
        If a point mass is at a point that its body's mesh does not have.
    """
    bodies: dict[str, Body] = {}
    for name, entry in scene.bodies.items():
        if entry.continuum:
            bodies[name] = _continuum(scene, name, meshes[name])
            continue
        if entry.element == "beam3d":
            bodies[name] = _beam_in_space(scene, name, meshes[name])
            continue
        material = None if entry.material is None else scene.materials[entry.material]
        section = BeamSection.of(entry.section, material)
        make = Body.beam if entry.flexible else Body.rigid
        bodies[name] = make(name, meshes[name], section)
    for name, effect in scene.effects.items():
        if isinstance(effect, PointMass):
            owner, _, point = effect.point.partition(":")
            node = bodies[owner].shape.point(point, f"effects.{name}.point")
            lumps = _lumps(effect)
            if bodies[owner].flexible:
                bodies[owner] = bodies[owner].with_lumps(node, lumps)
            else:
                bodies[owner], lent = bodies[owner].lend_inertia()
                particle = Body.particle(_welded(name), bodies[owner].shape.nodes[node], lumps)
                bodies[_welded(name)] = particle.with_lumps(0, lent)
    numbered, first_node = [], 0
    first_internal = sum(body.node_dofs * body.n_nodes for body in bodies.values())
    for body in bodies.values():
        numbered.append(body.numbered(first_node, first_internal))
        first_node += body.n_nodes
        first_internal += body.n_internal
    return tuple(numbered)


def _beam_in_space(scene: Scene, name: str, mesh: LineMesh) -> Body:
    """Return a body of beams in space, flexible or rigid.

    Raises
    ------
    InputError
        If the orientation of its section is parallel to one of its elements.
    """
    entry = scene.bodies[name]
    edges = np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0]
    axes = section_axes(edges, None if entry.orientation is None else np.array(entry.orientation))
    parallel = np.flatnonzero(np.isnan(axes).any(axis=(1, 2)))
    if parallel.size:
        raise InputError(
            f"bodies.{name}.orientation = {list(entry.orientation)}: parallel to element {parallel[0]} of the body, "
            f"along {(edges[parallel[0]] / np.linalg.norm(edges[parallel[0]])).round(6).tolist()} in its frame; needed: "
            "orientation = [x, y, z], a direction across all elements, that of the section's height"
        )
    material = None if entry.material is None else scene.materials[entry.material]
    section = SpatialSection.of(entry.section, material, scene.nominal)
    if entry.flexible:
        return Body.beam_in_space(name, mesh, section, axes)
    return replace(Body.condensed(name, rigid_line(name, mesh, section, axes)), shape=mesh)


def _continuum(scene: Scene, name: str, shape: SolidMesh | Component) -> Body:
    """Return a continuum body from its mesh, or condensed."""
    if isinstance(shape, Component):
        return Body.condensed(name, shape)
    meshed = FramedSolid.of(name, scene.bodies[name], scene.materials, shape, points_used(scene, name)).at(scene.values)
    if not scene.bodies[name].flexible:
        return Body.condensed(name, rigid_component(meshed))
    return Body.continuum(name, meshed)


def attachment_at(scene: Scene, bodies: Sequence[Body], address: str, entry: str) -> Attachment:
    """Return the attachment at ``"body:point"`` or ``"ground:point"``.

    Raises
    ------
    InputError
        If the body's mesh has no such point; `entry` is the scene entry to blame.
    """
    name, _, point = address.partition(":")
    if name == GROUND:
        return Attachment(-1, -1, np.asarray(scene.ground.position(point, 2)))
    index = next(i for i, body in enumerate(bodies) if body.name == name)
    body = bodies[index]
    number = body.shape.point(point, entry)
    place = body.shape.nodes[number]
    if body.flexible:
        return Attachment(index, body.first_node + number, place)
    return Attachment(index, body.first_node, place, place - body.mesh.nodes[0])


def connections_of(scene: Scene, bodies: Sequence[Body]) -> tuple[Connection, ...]:
    """Return the joints of a scene, and the welds of point masses to rigid bodies.

    Raises
    ------
    InputError
        If a joint names a point that its body's mesh does not have.
    """
    sides = {
        name: tuple(attachment_at(scene, bodies, address, f"joints.{name}.connect") for address in entry.connect)
        for name, entry in scene.joints.items()
    }
    kinds = {name: entry.type for name, entry in scene.joints.items()}
    for name, (effect, index) in welded_masses(scene, bodies).items():
        carrier = attachment_at(scene, bodies, effect.point, f"effects.{name}.point")
        particle = Attachment(index, bodies[index].first_node, bodies[index].mesh.nodes[0])
        sides[_welded(name)], kinds[_welded(name)] = (carrier, particle), "fixed"
    connections, row = [], 0
    for name, (a, b) in sides.items():
        joint: Joint
        if kinds[name] == "revolute":
            joint = Revolute()
        elif kinds[name] == "fixed":
            welded = name not in scene.joints  # a point mass, which has the direction of its body
            joint = Fixed(0.0 if welded else _placed_angle(scene, bodies, b) - _placed_angle(scene, bodies, a))
        else:
            joint = PointOnLine(scene.joints[name].direction, turning=not a.on_ground)
        connections.append(Connection(name, joint, a, b, slice(row, row + joint.n_constraints)))
        row += joint.n_constraints
    return tuple(connections)


def first_guess(scene: Scene, bodies: Sequence[Body], connections: Sequence[Connection]) -> np.ndarray:
    """Return poses to start the assembly from, shape (n_bodies, 3); they choose the assembly branch.

    A body with a `placement` takes that; the others are moved, joint by joint from the ground, so that their joint
    point meets the one already placed, with the direction that they have in their mesh.
    """
    poses = np.zeros((len(bodies), N_FRAME))
    placed = np.zeros(len(bodies), dtype=bool)
    for i, body in enumerate(bodies):
        placement = scene.bodies[body.name].placement if body.name in scene.bodies else None
        if placement is not None:
            poses[i] = (*placement.origin, placement.angle)
            placed[i] = True
    waiting = list(connections)
    while True:
        ready = [
            c
            for c in waiting
            if isinstance(c.joint, (Revolute, Fixed))
            and (c.a.on_ground or placed[c.a.body]) != (c.b.on_ground or placed[c.b.body])
        ]
        if not ready:
            return poses
        connection = ready[0]
        a, b = connection.a, connection.b
        anchor, loose = (a, b) if a.on_ground or placed[a.body] else (b, a)
        if isinstance(connection.joint, Fixed) and bodies[loose.body].name not in scene.bodies:
            poses[loose.body, 2] = poses[anchor.body, 2]
        gap = anchor.frame_of_pose(poses)[:2] - loose.frame_of_pose(poses)[:2]
        poses[loose.body, :2] += gap
        placed[loose.body] = True
        waiting.remove(connection)


def _placed_angle(scene: Scene, bodies: Sequence[Body], side: Attachment) -> float:
    """Return the angle that a body is placed at, rad; 0 for the ground."""
    entry = None if side.on_ground else scene.bodies[bodies[side.body].name]
    return 0.0 if entry is None or entry.placement is None else entry.placement.angle


def welded_masses(scene: Scene, bodies: Sequence[Body]) -> dict[str, tuple[PointMass, int]]:
    """Return the point masses on rigid bodies by their names, with the numbers of the bodies that they are."""
    numbers = {body.name: number for number, body in enumerate(bodies)}
    return {
        name: (effect, numbers[_welded(name)])
        for name, effect in scene.effects.items()
        if isinstance(effect, PointMass) and _welded(name) in numbers
    }


def _lumps(effect: PointMass) -> dict[Monomial, LumpedMass]:
    mass = Quantity.of(effect.mass)
    lumps = {mass.monomial: LumpedMass(mass.coefficient, 0.0)}
    if effect.inertia:
        return joined(lumps, {Monomial(): LumpedMass(0.0, effect.inertia)})
    return lumps


def _welded(effect: str) -> str:
    """Return the name of the body that a point mass on a rigid body is; no scene's name has a colon."""
    return f"{effect}:mass"
