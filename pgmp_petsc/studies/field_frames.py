"""What can be seen of a run, as results keep it: fields of bodies over its frames, and shapes at instants.

Fields have what deforms bodies apart from their rigid motion. Deformation is position less that in the rigid mechanism
at the same measured coordinates, as outputs of that type report it (`outputs`). In the rigid mechanism bodies meet at
their joints as the deformed ones do, so that a deformation that is enlarged takes no joint apart but for what is of
second order in it.

A beam's shape is that of its nodes. A rigid body's only node is its centre of mass ``(X, Y, phi)``: its shape is its
mesh, placed by ``x_k = (X, Y) + R(phi) (s_k - s_centre)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy

from pgmp_petsc.base.errors import InputError, Remark, note
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models.body_fields import FieldPoints, Fields, FieldSet, joined, placed
from pgmp_petsc.outputs.readings import RigidReference
from pgmp_petsc.results.trajectory import BodyField, Frames, Trajectory

if TYPE_CHECKING:
    from pgmp_petsc.models import ReducedModel
    from pgmp_petsc.models.reduced_fields import ReducedFields


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
        raise InputError(f"no body can be seen: {'; '.join(map(' '.join, fields.seen.left_out.items())) or 'no mesh'}")
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
    return frames_of(mechanism, time, shapes, {name: turned(shape) for name, shape in shapes.items()})


def frames_of(
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
