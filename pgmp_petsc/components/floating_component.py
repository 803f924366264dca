"""Condensed bodies in floating frames: moments, a stiffness and the shapes at the frames, from the condensed matrices.

With the linear displacement fields of a condensed body in its unknowns y, the scalar fields 1 and X_k are components of
displacements ``T y`` as all others are, so that its moments ``int rho u_i v_j dV`` are all that inertia needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.linalg import eigh

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.floating import FloatingBody, second_moments
from pgmp_petsc.bodies.inertia_moments import rigid_motions
from pgmp_petsc.components.component_modes import weighted_sum_dense


def in_floating_frame(component: Component, nominal: Mapping[str, float]) -> FloatingBody:
    """Put a flexible condensed body into a floating frame, the mean axes at the nominal parameters.

    It follows its foreshortening where that is known.
    """
    d, modes = component.centres.shape[1], elastic_modes(component, nominal)
    rigid = component.fields @ rigid_motions(np.zeros(d))
    n_frames, n = len(component.frames), modes.shape[1]
    stiffness = {weight: modes.T @ matrix @ modes for weight, matrix in component.stiffness.items()}
    shapes, moments = modes[: component.n_frame_dofs].reshape(n_frames, -1, n), _moments_of(component, modes)
    bent, curved = np.zeros((n_frames, d, n, n)), {}
    if component.foreshortening is not None:
        bent, curved = foreshortened(component.foreshortening, shapes, moments)
    kept = None if component.recovery is None else replace(component.recovery, shapes=component.recovery.shapes @ modes)
    return FloatingBody(
        component.frames,
        component.centres,
        shapes,
        moments,
        stiffness,
        bent,
        curved,
        kept,
        np.linalg.inv(np.hstack([rigid, modes])),
    )


def elastic_modes(component: Component, nominal: Mapping[str, float]) -> np.ndarray:
    """Return the elastic free modes of a condensed body at the nominal parameters, of a mean square displacement of 1
    m2, shape (n, n - n_rigid)."""
    mass, stiffness = (weighted_sum_dense(terms, nominal) for terms in (component.mass, component.stiffness))
    along = component.fields[:, 0]  # the unit displacement along x
    return np.sqrt(along @ mass @ along) * free_modes(mass, stiffness, component.centres.shape[1])


def foreshortened(
    curvature: np.ndarray, shapes: np.ndarray, moments: Mapping[Monomial, np.ndarray]
) -> tuple[np.ndarray, dict[Monomial, np.ndarray]]:
    """Return what amplitudes of second order (n, n, n) displace frames by, and their moments; see `FloatingBody`."""
    d = {3: 2, 6: 3}[shapes.shape[1]]
    curved = {
        weight: np.einsum("klm,mij->klij", second_moments(part, d)[1], curvature) for weight, part in moments.items()
    }
    return np.einsum("fkm,mij->fkij", shapes[:, :d], curvature), curved


def _moments_of(component: Component, modes: np.ndarray) -> dict[Monomial, np.ndarray]:
    """Return the moments of 1, of the coordinates and of modes (n, n_modes) of a condensed body; see `FloatingBody`."""
    d, (n, n_modes) = component.centres.shape[1], modes.shape
    # scalar fields as components of displacements: 1 and X_k along the first axis, every mode along all of them
    fields = np.zeros((1 + d + d * n_modes, d, n))
    fields[0, 0] = component.fields[:, 0]
    fields[1 : 1 + d, 0] = component.fields[:, d : 2 * d].T
    for k in range(d):
        fields[1 + d + k * n_modes : 1 + d + (k + 1) * n_modes, k] = modes.T
    flat = fields.reshape(len(fields), d * n)
    return {w: flat @ part.swapaxes(1, 2).reshape(d * n, d * n) @ flat.T for w, part in component.moments.items()}


def free_modes(mass: np.ndarray, stiffness: np.ndarray, d: int) -> np.ndarray:
    """Return the elastic free modes in given coordinates, M-orthonormal, shape (n, n - n_rigid)."""
    return eigh(stiffness, mass)[1][:, d * (d + 1) // 2 :]
