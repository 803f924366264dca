"""Flexible bodies in floating frames: what is left of a mesh is moments, a stiffness and the shapes at its frames.

A continuum body's fields are those that it is condensed to (`component_modes`): they answer its frames whatever these
are joined to. A body of beams has its lowest free modes and what its frames' forces do beyond them
statically. In both cases the fields are turned to free modes, which are orthogonal to the rigid motions in the mass at
nominal parameters, and these are left out: the frame makes them (`bodies.floating`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy.linalg import eigh

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.bodies.recovery import Recovery
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.component_modes import condense, weighted_sum_dense
from pgmp_petsc.components.condensing import serving_points
from pgmp_petsc.components.displacement_fields import linear_fields
from pgmp_petsc.components.floating_component import free_modes, in_floating_frame
from pgmp_petsc.components.foreshortening import foreshortening
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.points import points_used
from pgmp_petsc.scene.stress_checks import stressed_bodies

DEPENDENT = 1e-9  # of the largest eigenvalue of vectors' products in the mass


def floating_shapes(
    scene: Scene, shapes: Mapping[str, BodyShape], bodies: Sequence[Body], comm: MPI.Comm
) -> dict[str, BodyShape]:
    """Return the shapes of a scene's bodies, the flexible ones in floating frames. Collective on `comm`.

    Parameters
    ----------
    scene
        The scene.
    shapes
        By the name of the body.
    bodies
        That were made of them.

    Raises
    ------
    RunError
        If an eigenproblem fails; on all ranks, whichever rank met it.
    """
    flexible = [body for body in bodies if body.flexible]
    own, found = flexible[comm.rank :: comm.size], {}
    with agreed(comm, "component modes"), progress(len(own), "bodies in floating frames", comm) as bar:
        for body in own:
            found[body.name] = _floating(scene, replace(body.alone(), lumps={}), shapes[body.name])
            bar.update()
    done = dict(shapes)
    for part in comm.allgather(found):
        done.update(part)
    return done


def _floating(scene: Scene, body: Body, shape: BodyShape) -> FloatingBody:
    points = points_used(scene, body.name)
    if body.meshed is None:
        return _of_beams(scene, body, points)
    # not the mechanism's own, whose mesh has the cross-section of one sample already
    return _of_solid(scene, FramedSolid.of(body.name, scene.bodies[body.name], scene.materials, shape, points))


def _of_solid(scene: Scene, meshed: FramedSolid) -> FloatingBody:
    """Condense a body on its mesh, and put it into a floating frame."""
    n_modes, stressed = scene.reduction.modes + scene.n_overconstrained, meshed.solid.name in stressed_bodies(scene)
    points = serving_points(scene, meshed)
    component, *_ = condense(meshed.solid, meshed.frames, points, n_modes, MPI.COMM_SELF, stressed=stressed)
    return in_floating_frame(component, scene.nominal)


def _of_beams(scene: Scene, body: Body, points: Mapping[str, str]) -> FloatingBody:
    """Put a body of beams into a floating frame."""
    matrices, per_node = assemble([body], range(body.dofs.size)), body.node_dofs
    mass, stiffness = (
        {weight: matrix.toarray() for weight, matrix in terms.items()} for terms in (matrices.mass, matrices.stiffness)
    )
    held = np.array([body.mesh.point(point, blame) for point, blame in points.items()])
    loads = np.zeros((body.dofs.size, per_node * held.size))
    loads[(per_node * held[:, None] + np.arange(per_node)).ravel(), np.arange(per_node * held.size)] = 1.0
    total_mass, total = (weighted_sum_dense(terms, scene.nominal) for terms in (mass, stiffness))
    stressed, d = body.name in stressed_bodies(scene), body.mesh.nodes.shape[1]
    if stressed:  # inertia forces of rigid motion
        fields = linear_fields(body.mesh.nodes).reshape(body.n_nodes, d, -1)
        loads = np.hstack([loads, total_mass @ _of_nodes(fields, per_node)])
    values, vectors = eigh(total, total_mass)
    basis = _answering(values, vectors, total_mass, loads, per_node, scene.reduction.modes + scene.n_overconstrained)
    # torsion moves no node: of rotations what they move at the body's extent
    moved = basis * np.where(np.arange(len(basis)) % per_node < d, 1.0, body.extent)[:, None]
    elastic = free_modes(basis.T @ total_mass @ basis, basis.T @ total @ basis, d)
    modes = basis @ (elastic / np.max(np.abs(moved @ elastic), axis=0))
    shapes = modes.reshape(body.n_nodes, per_node, -1)[held]
    frames = {point: number for number, point in enumerate(points)}
    reduced = {weight: modes.T @ matrix @ modes for weight, matrix in stiffness.items()}
    n = modes.shape[1]
    bent, curved = np.zeros((held.size, d, n, n)), {}
    if scene.static_stretching:
        elastic = values[per_node:], vectors[:, per_node:]
        axial = body.section.axial.at(scene.nominal)
        chi = foreshortening(body, modes, modes.T @ total @ modes, axial, elastic)
        bent = chi.reshape(body.n_nodes, per_node, n, n)[held, :d]
        parts = _moments_of_beams(body, chi.reshape(-1, n * n), slice(1, 1 + d), slice(1 + d, None))
        curved = {weight: part.reshape(d, d, n, n) for weight, part in parts.items()}
    moments, kept = _moments_of_beams(body, modes), Recovery(body, modes) if stressed else None
    return FloatingBody(frames, body.mesh.nodes[held], shapes, moments, reduced, bent, curved, kept)


def _of_nodes(fields: np.ndarray, per_node: int) -> np.ndarray:
    """Return displacement fields (n_nodes, d, k) of beams as unknowns (n_nodes per_node, k) without rotations."""
    n_nodes, d, k = fields.shape
    nodal = np.zeros((n_nodes, per_node, k))
    nodal[:, :d] = fields
    return nodal.reshape(n_nodes * per_node, k)


def _answering(
    values: np.ndarray, vectors: np.ndarray, mass: np.ndarray, loads: np.ndarray, n_rigid: int, n_modes: int
) -> np.ndarray:
    """Return the rigid motions, the lowest elastic modes and what they miss of the static answers to loads that are
    balanced by inertia forces, from all eigenvalues and modes."""
    kept = min(n_rigid + n_modes, values.size)
    missed = vectors[:, kept:] @ ((vectors[:, kept:].T @ loads) / values[kept:, None])
    squares, directions = eigh(missed.T @ mass @ missed)
    chosen = squares > DEPENDENT * np.max(squares, initial=0.0)
    return np.hstack([vectors[:, :kept], missed @ (directions[:, chosen] / np.sqrt(squares[chosen]))])


def _moments_of_beams(
    body: Body, modes: np.ndarray, rows: slice = slice(None), columns: slice = slice(None)
) -> dict[Monomial, np.ndarray]:
    """Return the moments of fields of a body of beams, of unit displacements and rotations (n_dofs, n), or some
    rows and columns of them.

    A point at the place ``sum_s eta_s t_s`` of a section moves with ``u + sum_s eta_s phi x t_s``: scalar fields are
    ``a + sum_s eta_s b_s`` with a linear between the nodes, and b from the rotations there; the section's moments are
    those of 1 and of eta_s.
    """
    mesh, n, d = body.mesh, modes.shape[1], body.mesh.nodes.shape[1]
    by_node = modes.reshape(mesh.n_nodes, body.node_dofs, n)
    axes = body.axes if d == 3 else _planar_axes(mesh)
    spins = by_node[:, d:] if d == 3 else np.insert(by_node[:, d:], 0, np.zeros((2, 1, n)), axis=1)
    shared = np.hstack([np.ones((mesh.n_nodes, 1)), mesh.nodes, *by_node[:, :d].swapaxes(0, 1)])
    consistent = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    # rho I_2 is the moment of what lies along t_3, and rho I_3 of what lies along t_2; in the plane rho I of t_2
    across = (2, 1) if d == 3 else (1,)
    found: dict[Monomial, np.ndarray] = {}
    for nodes, length, own in zip(mesh.cells, mesh.lengths, axes):
        fields = [shared[nodes]]
        for s in across:
            turned = np.cross(spins[nodes], np.resize(own[:, s], 3) * (np.arange(3) < d), axisa=1, axisb=0)
            at_rest = np.hstack([np.zeros((2, 1)), np.tile(own[:, s], (2, 1))])
            fields.append(np.hstack([at_rest, *(turned[..., k] for k in range(d))]))
        for weight, coefficients in body.section.mass_terms().items():
            for coefficient, field in zip(coefficients, fields):
                if coefficient:
                    part = coefficient * length * (field[:, rows].T @ consistent @ field[:, columns])
                    found[weight] = found.get(weight, 0.0) + part
    return found


def _planar_axes(mesh: LineMesh) -> np.ndarray:
    """Return the directions along and across the elements of a mesh in the plane, one a column, (n_elements, 2, 2)."""
    along = np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0] / mesh.lengths[:, None]
    return np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=2)
