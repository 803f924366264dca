"""What can be seen of a mechanism: fields of bodies over a run's frames, shapes at instants, assembled at the start,
and modes of vibration, as results keep them.

Fields have what deforms bodies apart from their rigid motion. Deformation is position less that in the rigid mechanism
at the same measured coordinates, as outputs of that type report it (`outputs`). In the rigid mechanism bodies meet at
their joints as the deformed ones do, so that a deformation that is enlarged takes no joint apart but for what is of
second order in it.

A beam's shape is that of its nodes. A rigid body's only node is its centre of mass ``(X, Y, phi)``: its shape is its
mesh, placed by ``x_k = (X, Y) + R(phi) (s_k - s_centre)``.

Modes of a reduced model at a configuration are brought back to the meshes of its bodies. With the reduced matrices M
and K at the configuration theta, ``K v = omega^2 M v`` for v = [rates of the free coordinates, flexible coordinates].
The mode moves the nodes by

    u = (d rho / d theta) v_theta + R Psi(theta) v_delta,

as eq. (4) of Naets et al. 2015 does to first order.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy
from scipy.linalg import eigh

from pgmp_petsc.base.errors import InputError, Remark, note
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.shape import Shapes
from pgmp_petsc.effects import start_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, rigid_velocities, words_of
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models.body_fields import FieldPoints, Fields, FieldSet, joined, placed
from pgmp_petsc.outputs.readings import RigidReference
from pgmp_petsc.results.trajectory import BodyField, Frames, ModeShape, Trajectory
from pgmp_petsc.scene import GROUND, Scene
from pgmp_petsc.scene.fields import MOST_RADIANS
from pgmp_petsc.scene.loading import scene_to_toml

if TYPE_CHECKING:
    from pgmp_petsc.models import ReducedModel
    from pgmp_petsc.models.body_fields import ReducedFields
    from pgmp_petsc.results.selection import Assembly


def field_frames(
    seen: FieldSet, kinematics: RigidKinematics, nodal: np.ndarray, values: Fields
) -> dict[str, BodyField]:
    """Return the fields of all bodies that are seen, from those of the models at the same instants, or more; nothing
    where there are no frames of all nodes, (n_f, n_nodes, n_frame), see `shape_frames`."""
    if not values:
        return {}
    poses = RigidReference(kinematics).poses(dict(enumerate(np.moveaxis(nodal, 0, -1))))
    n, fields = poses.shape[2], {}
    for name, field in seen.points.items():
        own = values[name]
        rigid = placed(kinematics.mechanism.space, poses[field.number], field.mesh.nodes[:, :, None])
        places = own.positions[..., :n]
        tables = ({quantity: table[:, :n] for quantity, table in part.items()} for part in (own.at_nodes, own.at_cells))
        fields[name] = body_field(field, places, places - rigid, *tables)
    return fields


def fields_over(fields: ReducedFields, eta: np.ndarray, values: Mapping[str, float]) -> Fields:
    """Return the fields for reduced coordinates (n, n_eta), as many instants at once as are best evaluated together."""
    n = fields.seen.at_once if fields.seen.points else max(1, len(eta))
    with np.errstate(all="ignore"):
        return joined([fields.of(eta[first : first + n], values) for first in range(0, len(eta), n)])


def fields_at(model: ReducedModel, run: Trajectory, times: Sequence[float]) -> dict[str, BodyField]:
    """Return the fields at any instants (n,), s, of a run of a reduced model; between steps its coordinates are linear.
    Raises `InputError` if the run is not of this model, an instant is outside it, or no mesh is known."""
    instants, tables = np.atleast_1d(np.asarray(times, dtype=float)), model.rom.tables
    n_eta = tables.n_coordinates + tables.n_modes
    columns = run.coordinates if run.modal is None else np.hstack([run.coordinates, run.modal])
    if run.model != "reduced" or columns.shape[1] != n_eta:
        why = f"the run is of a {run.model} model with {columns.shape[1]} coordinates, the reduced model has {n_eta}"
        raise InputError(f"{why}; give the reduced model that it was made with")
    outside = instants[~((instants >= run.time[0]) & (instants <= run.time[-1]))]
    if outside.size:
        raise InputError(f"times: {outside[0]:g} s is outside the run, from {run.time[0]:g} to {run.time[-1]:g} s")
    eta = np.stack([np.interp(instants, run.time, column) for column in columns.T], axis=1)
    fields = model.fields(instants.size)
    if not fields.seen.points:
        why = "; ".join(map(" ".join, fields.seen.left_out.items())) or "no instant is given, or no mesh is known"
        raise InputError(f"no body can be seen: {why}")
    nodal = np.moveaxis(model.frames_of(eta), 2, 0)
    return field_frames(fields.seen, model.kinematics, nodal, fields_over(fields, eta, model.scene.values))


def body_field(
    field: FieldPoints,
    positions: np.ndarray,
    deformation: np.ndarray,
    at_nodes: Mapping[str, np.ndarray],
    at_cells: Mapping[str, np.ndarray],
) -> BodyField:
    """Return the record of a body at n instants, from positions and deformation (n_nodes, d, n), m, and quantities at
    nodes and cells, each of shape (n_nodes or n_cells, n)."""
    return BodyField(
        kind=field.mesh.kind,
        nodes=field.mesh.nodes,
        cells=field.mesh.cells,
        positions=np.moveaxis(positions, 2, 0),
        deformation=np.moveaxis(deformation, 2, 0),
        at_nodes={quantity: table.T for quantity, table in at_nodes.items()},
        at_cells={quantity: table.T for quantity, table in at_cells.items()},
        units=field.units,
        rigid=field.stresses is None,
        radius=field.radius,
    )


def left_out_of_fields(seen: FieldSet) -> tuple[Remark, ...]:
    """Say which bodies are not stored as they can be seen, and why."""
    if not seen.left_out:
        return ()
    said = "; ".join(f"{name} ({why})" for name, why in seen.left_out.items())
    return (note(f"displacements and stresses over the whole body are not stored of {said}"),)


def shape_frames(mechanism: Mechanism, nodal: np.ndarray, time: np.ndarray) -> Frames:
    """Return the shapes of all bodies at instants (n_f,), s, from the frames of all nodes in the ground frame, shape
    (n_f, n_nodes, n_frame): ``(x, y, phi)``, m and rad, in the plane, position and directors in space."""
    shapes = {body.name: _shape(mechanism, body, nodal[:, body.nodes]) for body in mechanism.bodies}
    turned = _rotation_vectors if mechanism.space is SPATIAL else (lambda shape: shape[..., 2])
    return _frames(mechanism, time, shapes, {name: turned(shape) for name, shape in shapes.items()})


def _frames(
    mechanism: Mechanism, time: np.ndarray, shapes: Mapping[str, np.ndarray], rotations: dict[str, np.ndarray]
) -> Frames:
    """Return the frames of bodies of shapes (n_f, n_shape, d or more), m, and rotations, rad."""
    return Frames(
        time=time,
        positions={name: shape[..., : mechanism.space.dimension] for name, shape in shapes.items()},
        rotations=rotations,
        nodes={body.name: body.shape.nodes for body in mechanism.bodies},
        cells={body.name: body.shape.cells for body in mechanism.bodies},
        rigid=frozenset(body.name for body in mechanism.bodies if not body.flexible),
    )


def _shape(mechanism: Mechanism, body: Body, nodal: np.ndarray) -> np.ndarray:
    """Return the frames of the nodes of a body's shape, (n_f, n_shape, n_frame), from those of its own nodes."""
    if body.flexible:
        return nodal
    arms = body.shape.nodes - body.mesh.nodes
    return np.moveaxis(mechanism.space.place(nodal[:, 0, : mechanism.space.n_pose].T, arms), -1, 0)


def _rotation_vectors(shape: np.ndarray) -> np.ndarray:
    """Return the rotations of nodes (n_f, n_nodes, n_frame) in space as axis times angle, shape (n_f, n_nodes, 3)."""
    directors = shape[..., 3:12].reshape(-1, 3, 3)
    turns = scipy.spatial.transform.Rotation.from_matrix(directors.swapaxes(1, 2)).as_rotvec()
    return turns.reshape(*shape.shape[:2], 3)


def assembly_of(scene: Scene, meshes: Shapes) -> Assembly:
    """Return where bodies, joints and named points are at the start; raises `InputError` if the mechanism cannot be
    assembled."""
    from pgmp_petsc.results.selection import Assembly, spans_in  # runs do not wait for them

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
    unturned = {name: np.zeros((1, len(at)) if d == 2 else (1, len(at), 3)) for name, at in places.items()}
    frames = _frames(mechanism, np.zeros(1), {name: at[None] for name, at in places.items()}, unturned)
    named = ((body.name, *point) for body in mechanism.bodies for point in body.shape.points.items())
    points = {f"{body}:{name}": places[body][node, :d] for body, name, node in named}
    used = {side for joint in scene.joints.values() for side in joint.connect}
    for name in [*(("origin",) if f"{GROUND}:origin" in used else ()), *scene.ground.points]:
        points[f"{GROUND}:{name}"] = np.asarray(scene.ground_position(name))
    # of what slides the second point is the one that moves
    joints = {
        connection.name: connection.b.frame_of_pose(poses).ravel()[:d]
        for connection in mechanism.connections
        if connection.name in scene.joints
    }

    def at(address: str) -> np.ndarray:
        return mechanism.attachment(address, address).frame_of_pose(poses).ravel()[:d]

    points |= {side: at(side) for side in sorted(used - points.keys())}
    spans = {
        name: np.array(list(map(at, pair))) for name, pair in spans_in(tomllib.loads(scene_to_toml(scene))).items()
    }
    where = words_of(mechanism.coordinates, theta, 4)
    system = scene.system
    frames = frames.converted(system.shown)
    shown = ({name: system.shown(place, "m") for name, place in one.items()} for one in (joints, points, spans))
    return Assembly(scene.name, where, frames, *shown, system.unit("m"))


def mode_shape(model: ReducedModel, number: int, at: Mapping[str, float]) -> ModeShape:
    """Return a mode of the reduced model without springs, numbered from 1, rigid motion left out; by one process.

    The configuration has coordinates `at` (rad or m), those at the start where not given. Raises `InputError` if there
    is no such mode, or no such configuration among those of the model.
    """
    mechanism, theta = model.kinematics.mechanism, _configuration(model, at)
    frequencies, vectors = _modes(model, theta)
    if not 1 <= number <= frequencies.size:
        raise InputError(f"--mode {number}: the reduced model has modes 1 to {frequencies.size}")
    rom, tables, free = model.rom, model.rom.tables.moving(), mechanism.free
    poses = model.kinematics.poses(theta[None])
    rigid = rigid_velocities(mechanism, poses[..., 0], model.kinematics.rates(poses)[..., 0])
    shapes = tables.over(model.scene.interpolation, theta[None])(rom.projection[..., : tables.n_modes])[0]
    moved = rigid[:, free] @ vectors[: free.size, number - 1] + shapes @ vectors[free.size :, number - 1]
    seen = FieldSet.of(model.scene, mechanism.bodies, 1)
    own = {name: _displacements(field, mechanism.bodies[field.number], moved) for name, field in seen.points.items()}
    d = mechanism.space.dimension
    largest = max((float(np.linalg.norm(part[:, :d, 0], axis=1).max()) for part in own.values()), default=0.0)
    if not largest > 0.0:
        raise InputError("the meshes of this model's bodies are not known: nothing of the mode can be seen")
    fields = {
        name: _mode_field(model, field, poses[field.number], own[name] / largest) for name, field in seen.points.items()
    }
    where = words_of(mechanism.coordinates, theta, 4)
    fields = {name: field.converted(rom.record.system.converting) for name, field in fields.items()}
    springs = dict.fromkeys(action.effect for action in model.actions.actions if action.stiffness)
    said = [f"{', '.join(springs)}: springs have no part in this mode"] if springs else []
    said += [f"{name} is not drawn: {why}" for name, why in seen.left_out.items()]
    return ModeShape(rom.record, number, float(frequencies[number - 1]), where, fields, tuple(said))


def _configuration(model: ReducedModel, at: Mapping[str, float]) -> np.ndarray:
    names = [coordinate.name for coordinate in model.kinematics.coordinates]
    unknown = sorted(at.keys() - set(names))
    if unknown:
        raise InputError(f"--at {unknown[0]}: no such coordinate; those of this model are {', '.join(names)}")
    sizes = {c.name: c.system.size_of(c.unit) for c in model.kinematics.coordinates}
    given = {name: sizes[name] * value for name, value in at.items()}
    theta = np.array([given.get(name, start) for name, start in zip(names, model.start[0])])
    for axis, coordinate, value in zip(model.rom.tables.samples.axes, model.kinematics.coordinates, theta):
        received, unit = f"--at {coordinate.name}={coordinate.shown(value):g}", coordinate.system.unit(coordinate.unit)
        if abs(value) > MOST_RADIANS:
            raise InputError(f"{received}: allowed is up to {coordinate.shown(MOST_RADIANS):g} {unit}")
        if not axis.contains(value):
            ends = f"[{coordinate.shown(axis.lower):g}, {coordinate.shown(axis.upper):g}] {unit}"
            raise InputError(f"{received}: outside the sampled range {ends}")
    return theta


def _modes(model: ReducedModel, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (n,), Hz, rising, and vectors (n_free + n_delta, n) of all modes but the rigid ones."""
    from pgmp_petsc.reduction.tables import definite_mass

    tables, scheme, free = model.rom.tables.moving(), model.scene.interpolation, model.kinematics.mechanism.free
    matrices = tables.vibrating(model.scene.values, free, tables.over(scheme, theta[None]))
    mass, stiffness = (matrix[0] for matrix in matrices)
    scale = 1.0 / np.sqrt(np.diag(mass))  # coordinates have units of their own
    with definite_mass(f"--at {words_of(model.kinematics.coordinates, theta)}", scheme):
        values, vectors = eigh(stiffness * scale * scale[:, None], mass * scale * scale[:, None])
    n_rigid = free.size + tables.unstrained.size
    return np.sqrt(np.maximum(values[n_rigid:], 0.0)) / (2.0 * np.pi), scale[:, None] * vectors[:, n_rigid:]


def _displacements(field: FieldPoints, body: Body, moved: np.ndarray) -> np.ndarray:
    """Return the displacements of a body's nodes in its frame, shape (n_nodes, n_of_a_node, 1)."""
    own = moved[body.dofs]
    if body.flexible:
        return body.displacements(own[:, None])
    d, arms = field.mesh.nodes.shape[1], field.mesh.nodes - body.mesh.nodes[0]
    turned = own[2] * np.column_stack([-arms[:, 1], arms[:, 0]]) if d == 2 else np.cross(own[3:], arms)
    return (own[:d] + turned)[:, :, None]


def _mode_field(model: ReducedModel, field: FieldPoints, pose: np.ndarray, moved: np.ndarray) -> BodyField:
    space, values, stresses = model.kinematics.mechanism.space, model.scene.values, field.stresses
    d = space.dimension
    nodes = field.mesh.nodes[:, :, None]
    rest, there = (placed(space, pose, nodes + part) for part in (0.0 * moved[:, :d], moved[:, :d]))
    at_nodes, at_cells = {}, {}
    if stresses is not None:
        at_nodes = stresses.at_nodes(stresses.nodal.of_displacements(moved), values)
        at_cells = stresses.at_cells(stresses.inner.of_displacements(moved), values)
    return body_field(field, rest, there - rest, at_nodes, at_cells)
