"""Sensitivities at the start of a run.

An undeformed start depends on no parameter, velocities on those that are some of them; first accelerations follow
from the equations of motion, ``by_a S_a = - (by_p + by_q S_q + by_v S_v)``. In static equilibrium with free coordinates
the residual at rest vanishes, ``by_q S_q = - by_p``. With held ones the angles s of their joints are given and torques
mu hold them,

    R(eta, p) + G^T mu = 0,     s(eta) = s_0,     G = ds/d eta,
    [by_q + sum_k mu_k d2 s_k/d eta2   G^T] [S_q ]     [by_p + (d G/dp)^T mu]
    [G                                 0  ] [S_mu] = - [d s/dp              ],

where s depends on parameters that are lengths alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.gradients.linearisation import Linearisation, Linearised
from pgmp_petsc.models import LengthLanes, ReducedModel
from pgmp_petsc.models.reduced_statics import JointAngles
from pgmp_petsc.scene.uses import velocity_names

DIFFERENCE = 1e-3  # of second differences of fourth order: rounding and truncation leave 1e-9 of them


def start_of_sensitivities(model: ReducedModel | LengthLanes, linearisation: Linearisation, start: State) -> np.ndarray:
    """Return S_q, S_v, S_a and S_A of a sample at time zero, shape (4, n_parameters, n_eta).

    Parameters
    ----------
    start
        State at the start, arrays of shape (1, n_eta).
    """
    n_parameters, n = len(linearisation.names), start.q.shape[1]
    moment = np.zeros((4, n_parameters, n))
    free = np.array([k not in model.motions for k in range(n)])
    time, initial = np.zeros(1), model.scene.initial
    if initial.equilibrium:
        still = replace(start, v=np.zeros_like(start.v), a=np.zeros_like(start.a))
        at_rest = linearisation.at(time, still)
        if initial.coordinates == "free":
            moment[0][:, free] = -_solved(at_rest.by_q[0], at_rest.by_parameters[0], free)
        else:
            moment[0] = _held(model, start.q, at_rest, linearisation)
        if initial.coordinates == "free" and not model.motions:
            return moment  # at rest it stays there: no accelerations, whatever the parameters
    named = velocity_names(model.scene)
    for k, coordinate in enumerate(model.kinematics.coordinates):
        for row, name in zip(moment[1], linearisation.names):
            row[k] = float(named.get(coordinate.name) == name)
    now = linearisation.at(time, start)
    pushed = now.by_parameters[0] + moment[0] @ now.by_q[0].T + moment[1] @ now.by_v[0].T
    moment[2][:, free] = -_solved(now.by_a[0], pushed, free)
    moment[3] = moment[2]
    return moment


def _solved(matrix: np.ndarray, rows: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the solutions for the free coordinates of right-hand sides in rows."""
    return np.linalg.solve(matrix[np.ix_(free, free)], rows[:, free].T).T


def _held(
    model: ReducedModel | LengthLanes, eta: np.ndarray, at_rest: Linearised, linearisation: Linearisation
) -> np.ndarray:
    """Return S_q of coordinates (n_parameters, n_eta) whose joints' angles are held, at eta (1, n_eta)."""
    angles = [member.joint_angles for member in model.members]
    slopes, curvatures = _angle_derivatives(model, angles, model.shares(linearisation.values), eta)
    r, n = slopes.shape
    torques = np.linalg.lstsq(slopes.T, -at_rest.residual[0], rcond=None)[0]
    matrix = np.zeros((n + r, n + r))
    matrix[:n, :n] = at_rest.by_q[0] + np.einsum("k,kij->ij", torques, curvatures)
    matrix[:n, n:], matrix[n:, :n] = slopes.T, slopes
    right = np.concatenate([at_rest.by_parameters[0], np.zeros((len(at_rest.by_parameters[0]), r))], axis=1)
    for row, name in zip(right, linearisation.names):
        shares = model.shares(linearisation.values, name)
        if shares.any():
            row[:n] += torques @ _angle_derivatives(model, angles, shares, eta)[0]
            row[n:] += _angles(angles, shares, eta)[0]
    return -np.linalg.solve(matrix, right.T).T[:, :n]


def _angle_derivatives(
    model: ReducedModel | LengthLanes, angles: Sequence[JointAngles], shares: np.ndarray, eta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return first and second derivatives of the coordinates' angles, (n_theta, n_eta) and (n_theta, n_eta, n_eta)."""
    offsets, factors = np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
    steps = np.diag(DIFFERENCE / model.terms.scale)
    lines = offsets[:, None, None] * steps
    slopes = np.einsum("o,oik->ki", factors, _angles(angles, shares, eta + lines))
    planes = lines[:, :, None, None] + lines
    curvatures = np.einsum("o,p,oipjk->kij", factors, factors, _angles(angles, shares, eta + planes))
    inverse = 1.0 / np.diag(steps)
    return slopes * inverse, curvatures * np.outer(inverse, inverse)


def _angles(angles: Sequence[JointAngles], shares: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Return the angles at eta of shape (..., n_eta), sums over members with shares, shape (..., n_theta)."""
    rows = eta.reshape(-1, eta.shape[-1])
    found = sum(share * own.of(rows) for share, own in zip(shares, angles))
    return found.reshape(*eta.shape[:-1], found.shape[1])
