"""Modes of vibration of a reduced model at a configuration, brought back to the meshes of its bodies.

With the reduced matrices M and K at the configuration theta, ``K v = omega^2 M v`` for v = [rates of the free
coordinates, flexible coordinates]. The mode moves the nodes by

    u = (d rho / d theta) v_theta + R Psi(theta) v_delta,

as eq. (4) of Naets et al. 2015 does to first order.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.linalg import LinAlgError, eigh

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.mechanism.mechanism import words_of
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.models.body_fields import placed, undeformed
from pgmp_petsc.models.field_points import FieldPoints, FieldSet
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.tables import smoother
from pgmp_petsc.results.trajectory import BodyField, ModeShape
from pgmp_petsc.scene.fields import MOST_RADIANS
from pgmp_petsc.studies.field_frames import body_field


def mode_shape(model: ReducedModel, number: int, at: Mapping[str, float]) -> ModeShape:
    """Return a mode of the reduced model without springs; by one process.

    Raises `InputError` if there is no such mode, or no such configuration among those of the model.

    Parameters
    ----------
    number
        From 1, rigid motion left out.
    at
        Coordinates of the configuration, rad or m; where not given those at the start.
    """
    mechanism, theta = model.kinematics.mechanism, _configuration(model, at)
    frequencies, vectors = _modes(model, theta)
    if not 1 <= number <= frequencies.size:
        raise InputError(f"--mode {number}: the reduced model has modes 1 to {frequencies.size}")
    scheme, rom = model.scene.reduction.interpolation, model.rom
    poses = model.kinematics.poses(theta[None])
    rigid = rigid_velocities(mechanism, poses[..., 0], model.kinematics.rates(poses)[..., 0])
    free, v = _free(model), vectors[:, number - 1]
    shapes = interpolant(rom.tables.samples, rom.projection, scheme)(theta[None])[0]
    moved = rigid[:, free] @ v[: free.size] + shapes @ v[free.size :]
    seen = FieldSet.of(model.scene, mechanism.bodies, 1)
    own = {name: _displacements(field, mechanism.bodies[field.number], moved) for name, field in seen.points.items()}
    d = mechanism.space.dimension
    largest = max((float(np.linalg.norm(part[:, :d, 0], axis=1).max()) for part in own.values()), default=0.0)
    if not largest > 0.0:
        raise InputError("the meshes of this model's bodies are not known: nothing of the mode can be seen")
    fields = {
        name: _field(model, field, poses[field.number], own[name] / largest) for name, field in seen.points.items()
    }
    where = words_of(mechanism.coordinates, theta, 4)
    return ModeShape(rom.record, number, float(frequencies[number - 1]), where, fields, _left_out(model, seen))


def _left_out(model: ReducedModel, seen: FieldSet) -> tuple[str, ...]:
    springs = dict.fromkeys(action.effect for action in model.actions.actions if action.stiffness)
    said = [f"{', '.join(springs)}: springs have no part in this mode"] if springs else []
    return (*said, *(f"{name} is not drawn: {why}" for name, why in seen.left_out.items()))


def _configuration(model: ReducedModel, at: Mapping[str, float]) -> np.ndarray:
    """Return the coordinates of a configuration, shape (n_theta,)."""
    names = [coordinate.name for coordinate in model.kinematics.coordinates]
    unknown = sorted(at.keys() - set(names))
    if unknown:
        raise InputError(f"--at {unknown[0]}: no such coordinate; those of this model are {', '.join(names)}")
    theta = np.array([at.get(name, start) for name, start in zip(names, model.start[0])])
    for axis, coordinate, value in zip(model.rom.tables.samples.axes, model.kinematics.coordinates, theta):
        name, unit = coordinate.name, coordinate.unit
        if abs(value) > MOST_RADIANS:
            raise InputError(f"--at {name}={value:g}: allowed is up to {MOST_RADIANS:g} {unit}")
        if not axis.contains(value):
            ends = f"[{axis.lower:g}, {axis.upper:g}] {unit}"
            raise InputError(f"--at {name}={value:g}: outside the sampled range {ends}")
    return theta


def _free(model: ReducedModel) -> np.ndarray:
    return np.array([k for k, c in enumerate(model.kinematics.coordinates) if not c.prescribed], dtype=int)


def _modes(model: ReducedModel, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (n,), Hz, rising, and vectors (n_free + n_delta, n) of all modes but the rigid ones."""
    tables, scheme = model.rom.tables, model.scene.reduction.interpolation

    def at_theta(weights: tuple, table: np.ndarray) -> np.ndarray:
        here = interpolant(tables.samples, table, scheme)(theta[None])[0]
        return np.einsum("t,tij->ij", evaluate_weights(weights, model.scene.values), here)

    free, r = _free(model), tables.n_coordinates
    kept = np.concatenate([free, np.arange(r, r + tables.n_modes)])
    mass = at_theta(tables.mass_weights, tables.mass)[np.ix_(kept, kept)]
    stiffness = np.zeros_like(mass)
    stiffness[free.size :, free.size :] = at_theta(tables.stiffness_weights, tables.stiffness)
    scale = 1.0 / np.sqrt(np.diag(mass))  # coordinates have units of their own
    try:
        values, vectors = eigh(stiffness * scale * scale[:, None], mass * scale * scale[:, None])
    except LinAlgError as error:
        place = ", ".join(f"{c.name} = {angle:g}" for c, angle in zip(model.kinematics.coordinates, theta))
        why = f"--at {place}: the interpolated mass matrix is not positive definite there"
        raise InputError(f"{why}; build with {smoother(scheme)}, or take a sampled angle") from error
    n_rigid = free.size + tables.unstrained.size
    return np.sqrt(np.maximum(values[n_rigid:], 0.0)) / (2.0 * np.pi), scale[:, None] * vectors[:, n_rigid:]


def _displacements(field: FieldPoints, body: Body, moved: np.ndarray) -> np.ndarray:
    """Return the displacements of a body's nodes in its frame, shape (n_nodes, n_of_a_node, 1)."""
    own = moved[body.dofs]
    if body.flexible:
        return body.displacements(own[:, None])
    d, arms = field.mesh.nodes.shape[1], field.mesh.nodes - body.mesh.nodes[0]
    if d == 2:
        turned = own[2] * np.column_stack([-arms[:, 1], arms[:, 0]])
    else:
        turned = np.cross(own[3:], arms)
    return (own[:d] + turned)[:, :, None]


def _field(model: ReducedModel, field: FieldPoints, pose: np.ndarray, moved: np.ndarray) -> BodyField:
    space, values, stresses = model.kinematics.mechanism.space, model.scene.values, field.stresses
    d = space.dimension
    rest, there = (placed(space, pose, undeformed(field) + part) for part in (0.0 * moved[:, :d], moved[:, :d]))
    at_nodes, at_cells = {}, {}
    if stresses is not None:
        at_nodes = stresses.at_nodes(stresses.nodal.of_displacements(moved), values)
        at_cells = stresses.at_cells(stresses.inner.of_displacements(moved), values)
    return body_field(field, rest, there - rest, at_nodes, at_cells)
