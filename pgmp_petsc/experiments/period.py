"""The period of a model's first flexible mode at the start: what numbers of time steps are counted by.

The frequency is the lowest one of the mechanism at rest, without springs, at nominal parameters; prescribed coordinates
are held. Of a mesh, or of condensed bodies, it comes from the eigenproblem of the modes; of a reduced model from its
tables; of bodies in floating frames from the same constraints on their frames: with the rigid motion r and amplitudes
xi of every body, frames move by ``u = R r + S xi``, constraints say ``C u = 0``, and

    (N^T K N - omega^2 N^T M N) y = 0,     N a basis of the null space of C [R S].
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag, eigh, null_space

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.bodies.inertia_moments import rigid_motions
from pgmp_petsc.bodies.matrices import mass_of_bodies
from pgmp_petsc.experiments.history import AnyModel
from pgmp_petsc.mechanism.constraints import constraint_jacobian
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.models import ComponentModel, ReducedModel
from pgmp_petsc.models.model import start_of
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from mpi4py import MPI

DEPENDENT = 1e-9  # of the largest singular value of the constraints: those below follow from others


def first_period(scene: Scene, kinematics: RigidKinematics, comm: MPI.Comm, group: MPI.Comm) -> float:
    """Return the period of meshes, beams and condensed bodies (s). Collective on `comm`.

    Parameters
    ----------
    comm
        All ranks.
    group
        Ranks that share an eigenproblem.
    """
    frequency = 0.0
    with agreed(comm, "first mode"), ModalProblem(kinematics, scene.nominal, 1, group) as problem:
        frequency = float(problem.solve(start_of_coordinates(scene, kinematics)).frequencies_hz[0])
    # the first rank's: numbers of steps follow from it on all of them
    return 1.0 / comm.bcast(frequency)


def period_of(model: AnyModel, comm: MPI.Comm) -> float:
    """Return the period of any model (s). Collective on `comm`."""
    if isinstance(model, ReducedModel):
        return on_root(comm, _of_tables, model)
    if isinstance(model, ComponentModel):
        return on_root(comm, _of_floating_bodies, model)
    return first_period(model.scene, model.kinematics, comm, comm)


def start_of_coordinates(scene: Scene, kinematics: RigidKinematics) -> np.ndarray:
    """Return where the coordinates of a scene start, shape (n_theta,), rad."""
    return start_of(scene, kinematics.mechanism)[0]


def _of_tables(model: ReducedModel) -> float:
    """Return the period of a reduced model, from its tables at the sample nearest to the start."""
    tables, nominal, r = model.terms.tables, model.scene.nominal, model.terms.tables.n_coordinates
    at = int(tables.samples.nearest(np.asarray(model.start[0])[None])[0])
    mass = sum(float(w.evaluate(nominal)) * part for w, part in zip(tables.mass_weights, tables.mass[at]))
    total = sum(float(w.evaluate(nominal)) * part for w, part in zip(tables.stiffness_weights, tables.stiffness[at]))
    free = [k for k, coordinate in enumerate(model.kinematics.coordinates) if not coordinate.prescribed]
    kept = [*free, *range(r, len(mass))]
    stiffness = block_diag(np.zeros((len(free), len(free))), total)
    return _period(stiffness, mass[np.ix_(kept, kept)], len(free))


def _of_floating_bodies(model: ComponentModel) -> float:
    """Return the period of bodies in floating frames."""
    kinematics, nominal = model.kinematics, model.scene.nominal
    mechanism = kinematics.mechanism
    pose = kinematics.poses(start_of_coordinates(model.scene, kinematics)[None])[..., 0]
    clamped = [coordinate for coordinate in kinematics.coordinates if coordinate.prescribed]
    moved, masses, stiffnesses = [], [], []
    for body in mechanism.bodies:
        rigid = body.linear_fields()[: body.node_dofs * body.n_nodes] @ rigid_motions(np.zeros(body.dimension))
        columns = np.zeros((mechanism.n_dofs, rigid.shape[1] + body.n_amplitudes))
        columns[body.dofs[: len(rigid)], : rigid.shape[1]] = rigid
        mass, stiffness = np.zeros((2, columns.shape[1], columns.shape[1]))
        for floating in body.blocks("floating"):
            shapes = floating.shapes.reshape(-1, floating.n)
            columns[body.dofs[: len(shapes)], rigid.shape[1] :] = shapes
            mass = _inertia(floating, nominal)
            own = slice(rigid.shape[1], None)
            stiffness[own, own] = _sum(floating.stiffness, nominal)
        moved.append(columns)
        masses.append(mass)
        stiffnesses.append(stiffness)
    motion = np.hstack(moved)
    # what is not in floating frames: rigid bodies, and masses at frames
    others = mass_of_bodies(mechanism.bodies, range(mechanism.n_dofs))
    mass = block_diag(*masses) + sum(
        float(weight.evaluate(nominal)) * (motion.T @ (matrix @ motion)) for weight, matrix in others.items()
    )
    held = constraint_jacobian(mechanism, pose, clamped) @ motion
    free = null_space(held, rcond=DEPENDENT)
    n_rigid = len(kinematics.coordinates) - len(clamped)
    return _period(free.T @ block_diag(*stiffnesses) @ free, free.T @ mass @ free, n_rigid)


def _inertia(floating: FloatingBody, nominal: dict[str, float]) -> np.ndarray:
    """Return the mass of rigid motions and amplitudes of a body in a floating frame, in its own frame."""
    d = floating.centres.shape[1]
    moments, n_rigid = _sum(floating.moments, nominal), d * (d + 1) // 2
    rigid, total = rigid_motions(np.zeros(d)), np.zeros((n_rigid + floating.n,) * 2)
    for k in range(d):
        # the k-th component of the displacement, by the scalar fields (1, X, Psi_1, .. Psi_d)
        fields = np.zeros((len(moments), n_rigid + floating.n))
        fields[0, :n_rigid], fields[1 : 1 + d, :n_rigid] = rigid[k], rigid[d + d * k : d + d * (k + 1)]
        own = slice(1 + d + k * floating.n, 1 + d + (k + 1) * floating.n)
        fields[own, n_rigid:] = np.eye(floating.n)
        total += fields.T @ moments @ fields
    return total


def _sum(terms: dict[Monomial, np.ndarray], values: dict[str, float]) -> np.ndarray:
    return sum(float(weight.evaluate(values)) * matrix for weight, matrix in terms.items())


def _period(stiffness: np.ndarray, mass: np.ndarray, n_rigid: int) -> float:
    """Return the period of the lowest eigenvalue but those of the rigid motion."""
    values = eigh(stiffness, mass, eigvals_only=True, subset_by_index=(0, n_rigid))
    return float(2.0 * np.pi / np.sqrt(values[n_rigid]))
