"""Flexible bodies in floating frames: what is left of a mesh is moments, a stiffness and the shapes at its frames.

A continuum body's fields are those that it is condensed to (`component_modes`): they answer its frames whatever these
are joined to. A body of beams in the plane has its lowest free modes and what its frames' forces do beyond them
statically. In both cases the fields are turned to free modes, which are orthogonal to the rigid motions in the mass at
nominal parameters, and these are left out: the frame makes them (`bodies.floating`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from mpi4py import MPI
from scipy.linalg import eigh

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.bodies.section import BeamSection
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.component_modes import condense, weighted_sum_dense
from pgmp_petsc.components.condensing import serving_points
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.points import points_used

DEPENDENT = 1e-9  # of the largest eigenvalue of vectors' products in the mass


def floating_shapes(scene: Scene, shapes: Mapping[str, BodyShape], comm: MPI.Comm) -> dict[str, BodyShape]:
    """Return the shapes of a scene's bodies, the flexible ones in floating frames. Collective on `comm`.

    Raises
    ------
    InputError
        If a body cannot be put into a floating frame.
    RunError
        If an eigenproblem fails; on all ranks, whichever rank met it.
    """
    flexible = [name for name, body in scene.bodies.items() if body.flexible]
    own, found = flexible[comm.rank :: comm.size], {}
    with agreed(comm, "component modes"), progress(len(own), "bodies in floating frames", comm) as bar:
        for name in own:
            found[name] = _floating(scene, name, shapes[name])
            bar.update()
    done = dict(shapes)
    for part in comm.allgather(found):
        done.update(part)
    return done


def _floating(scene: Scene, name: str, shape: BodyShape) -> FloatingBody:
    points, entry = points_used(scene, name), scene.bodies[name]
    if not points:
        raise InputError(
            f"bodies.{name}: nothing holds it: no joint, effect or output names a point of it, so that component modes "
            "have no frame to answer; name one, or leave the body out"
        )
    if isinstance(shape, SolidMesh):
        if entry.section_scale is not None:
            raise InputError(
                f"bodies.{name}.section_scale: bodies with a scaled cross-section have no component model yet; take "
                "pgmp build and a reduced model, or pgmp simulate --full"
            )
        return _of_solid(scene, FramedSolid.of(name, entry, scene.materials, shape, points))
    if isinstance(shape, LineMesh) and entry.element == "beam2d":
        return _of_beam(scene, name, shape, points)
    raise InputError(
        f'bodies.{name}.element = "{entry.element}": bodies of beams in space have no component model yet; take '
        "pgmp build and a reduced model, or pgmp simulate --full"
    )


def _of_solid(scene: Scene, meshed: FramedSolid) -> FloatingBody:
    """Condense a body on its mesh, and put it into a floating frame."""
    solid, d = meshed.solid, meshed.solid.mesh.dimension
    n_modes = scene.reduction.modes + scene.n_overconstrained
    component, recovery = condense(solid, meshed.frames, serving_points(scene, meshed), n_modes, MPI.COMM_SELF)
    nominal = scene.nominal
    modes, scale = _free_modes(
        weighted_sum_dense(component.mass, nominal), weighted_sum_dense(component.stiffness, nominal), d, recovery
    )
    fields = [np.ones((solid.mesh.n_nodes, 1)), solid.mesh.nodes, *(recovery[k::d] @ modes for k in range(d))]
    scalars = np.hstack(fields)
    moments = {
        weight: scalars.T @ (matrix.tocsr()[::d, ::d] @ scalars)
        for weight, matrix in solid.mass(range(solid.mesh.n_nodes)).items()
    }
    stiffness = {weight: modes.T @ matrix @ modes for weight, matrix in component.stiffness.items()}
    shapes = modes[: component.n_frame_dofs].reshape(len(component.frames), -1, modes.shape[1])
    return FloatingBody(component.frames, component.centres, shapes, moments, stiffness)


def _of_beam(scene: Scene, name: str, mesh: LineMesh, points: Mapping[str, str]) -> FloatingBody:
    """Put a body of beams in the plane into a floating frame."""
    entry = scene.bodies[name]
    section = BeamSection.of(entry.section, scene.materials[entry.material] if entry.material else None)
    body = Body.beam(name, mesh, section)
    matrices = assemble([body], range(body.dofs.size))
    mass, stiffness = (
        {weight: matrix.toarray() for weight, matrix in terms.items()} for terms in (matrices.mass, matrices.stiffness)
    )
    held = np.array([mesh.point(point, blame) for point, blame in points.items()])
    loads = np.zeros((body.dofs.size, 3 * held.size))
    loads[(3 * held[:, None] + np.arange(3)).ravel(), np.arange(3 * held.size)] = 1.0
    total_mass, total = (weighted_sum_dense(terms, scene.nominal) for terms in (mass, stiffness))
    basis = _answering(total_mass, total, loads, scene.reduction.modes + scene.n_overconstrained)
    modes, _ = _free_modes(
        basis.T @ total_mass @ basis, basis.T @ total @ basis, 2, basis[np.arange(len(basis)) % 3 < 2]
    )
    modes = basis @ modes
    shapes = modes.reshape(mesh.n_nodes, 3, -1)[held]
    frames = {point: number for number, point in enumerate(points)}
    reduced = {weight: modes.T @ matrix @ modes for weight, matrix in stiffness.items()}
    return FloatingBody(frames, mesh.nodes[held], shapes, _moments_of_beam(body, modes), reduced)


def _answering(mass: np.ndarray, stiffness: np.ndarray, loads: np.ndarray, n_modes: int) -> np.ndarray:
    """Return the rigid motions, the lowest elastic modes and what they miss of the static answers to loads that are
    balanced by inertia forces."""
    values, vectors = eigh(stiffness, mass)
    kept = min(3 + n_modes, values.size)
    missed = vectors[:, kept:] @ ((vectors[:, kept:].T @ loads) / values[kept:, None])
    squares, directions = eigh(missed.T @ mass @ missed)
    chosen = squares > DEPENDENT * max(squares[-1], 0.0)
    return np.hstack([vectors[:, :kept], missed @ (directions[:, chosen] / np.sqrt(squares[chosen]))])


def _free_modes(mass: np.ndarray, stiffness: np.ndarray, d: int, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the elastic free modes in given coordinates, shape (n, n - n_rigid), and their largest displacements
    before these were made 1 m.

    `moved` gives displacements on the mesh in these coordinates, shape (n_displacements, n).
    """
    _, vectors = eigh(stiffness, mass)
    elastic = vectors[:, d * (d + 1) // 2 :]
    largest = np.max(np.abs(moved @ elastic), axis=0)
    return elastic / largest, largest


def _moments_of_beam(body: Body, modes: np.ndarray) -> dict[Monomial, np.ndarray]:
    """Return the moments of fields of a body of beams, of unit displacements (n_dofs, n).

    A point at the height eta of the section moves with ``u + eta phi' J e_n``: scalar fields are ``a + eta b`` with a
    linear between the nodes, and b from the rotations there; the section's moments are those of 1 and of eta.
    """
    mesh, n = body.mesh, modes.shape[1]
    by_node = modes.reshape(mesh.n_nodes, 3, n)
    along = np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0] / mesh.lengths[:, None]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
    consistent = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    line, rotary = body.section.line_density, body.section.rotary_density
    shared = np.hstack([np.ones((mesh.n_nodes, 1)), mesh.nodes, by_node[:, 0], by_node[:, 1]])
    found: dict[Monomial, np.ndarray] = {}
    for nodes, length, e, normal in zip(mesh.cells, mesh.lengths, along, normals):
        turned = np.hstack([np.zeros((2, 1)), np.tile(normal, (2, 1)), *(-e[k] * by_node[nodes, 2] for k in range(2))])
        for quantity, fields in ((line, shared[nodes]), (rotary, turned)):
            if quantity.coefficient:
                part = quantity.coefficient * length * (fields.T @ consistent @ fields)
                found[quantity.monomial] = found.get(quantity.monomial, 0.0) + part
    return found
