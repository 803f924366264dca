"""Actions on the unknowns of nodes, compiled: frames from unknowns, and one chain rule back.

A point at the arm X of a node has the frame ``p = r + sum_k X_k d_k`` with the node's directors d_k. The unknowns of a
node are its frame in natural coordinates, or in the plane ``(x, y, phi)``, with ``d d_k / d phi = J d_k``, J a right
angle's rotation.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.effects.laws import depth, law
from pgmp_petsc.mechanism.statements import ANGLE, evaluate
from pgmp_petsc.runtime.compiled import njit

PLANAR = 3  # unknowns of a node in the plane


@njit(cache=True, error_model="numpy")
def evaluate_actions(
    actions, entries, amplitudes, y, rates, known, turned, gain_v, forces, tangents, powers, stored, depths
):  # fmt: skip
    """Evaluate all actions for all samples.

    Parameters
    ----------
    actions, amplitudes
        As from `compile_actions`, `amplitudes_of`.
    entries
        Which entries of the tangents are wanted: first one of each action (n_actions + 1,), rows and columns among the
        unknowns of its two nodes, each (n_entries,).
    y, rates
        Unknowns of both nodes and their rates, zero on the ground, shape (n_actions, 2 m, n_samples), m = 3 in the
        plane or 12.
    known, turned
        What angles are nearest to, and as a result what they are, rad, shape (n_actions, n_samples).
    gain_v
        Derivative of velocities with positions in the iteration, 1/s.
    forces, tangents
        Results: force on the unknowns, shape (n_actions, 2 m, n_samples), and minus its derivative, the mean of each
        entry and its mirror, shape (n_entries, n_samples).
    powers, stored
        Results: power of what is not elastic (W) and potential energy of what is (J), shape (n_actions, n_samples).
    depths
        Result: how deep a stop is entered (negative: how far it is), NaN for other laws, shape (n_actions, n_samples).
    """
    starts, rows, columns = entries
    d, m = actions.axes.shape[2], y.shape[1] // 2
    n_pair = 2 * d * (d + 1)
    z, gradient, hessian = np.empty(n_pair), np.empty(n_pair), np.empty((n_pair, n_pair))
    half, g, h = np.zeros((n_pair, 2 * m)), np.zeros(2 * m), np.zeros((2 * m, 2 * m))
    for k in range(actions.kinds.size):
        for sample in range(y.shape[2]):
            p = actions.parameters[k, sample]
            place(actions, k, y[k, :, sample], z)
            if m == PLANAR and actions.kinds[k] == ANGLE:
                s = y[k, 5, sample] - y[k, 2, sample]  # linear in the unknowns, and counts turns by itself
                g[:], h[:] = 0.0, 0.0
                g[2], g[5] = -1.0, 1.0
            else:
                s = evaluate(actions.kinds[k], actions.axes[k], z, known[k, sample], gradient, hessian)
                to_unknowns(actions.arms[k], z, gradient, hessian, half, g, h)
            turned[k, sample] = s if np.isfinite(s) else known[k, sample]
            rate = 0.0
            for i in range(2 * m):
                rate += g[i] * rates[k, i, sample]
            force, stiffness, damping, elastic, potential = law(actions.laws[k], p, amplitudes[k], s, rate)
            powers[k, sample] = (force - elastic) * rate
            stored[k, sample] = potential
            depths[k, sample] = depth(actions.laws[k], p, s)
            for i in range(2 * m):
                forces[k, i, sample] = force * g[i]
            for entry in range(starts[k], starts[k + 1]):
                i, j = rows[entry], columns[entry]
                # a force that turns with its body has no symmetric tangent; its mean serves the factorisation
                bent = 0.5 * force * (h[i, j] + h[j, i])
                tangents[entry, sample] = (stiffness + gain_v * damping) * g[i] * g[j] - bent


@njit(cache=True, error_model="numpy")
def place(actions, k, y, z):
    """Fill both frames (2 d (d + 1),) of an action from the unknowns (2 m,) of its nodes."""
    d, m = actions.axes.shape[2], y.size // 2
    n = d * (d + 1)
    for side in range(2):
        frame, own = z[n * side : n * (side + 1)], y[m * side : m * (side + 1)]
        if actions.on_ground[k, side]:
            frame[:] = actions.ground[k, n * side : n * (side + 1)]
            continue
        if m == PLANAR:
            cos, sin = np.cos(own[2]), np.sin(own[2])
            frame[0], frame[1] = own[0], own[1]
            frame[2], frame[3], frame[4], frame[5] = cos, sin, -sin, cos
        else:
            frame[:] = own
        for j in range(d):
            for c in range(d):
                frame[c] += actions.arms[k, side, j] * frame[d + d * j + c]


@njit(cache=True, error_model="numpy")
def to_unknowns(arms, z, gradient, hessian, half, g, h):
    """Turn derivatives in two frames into g (2 m,) and h (2 m, 2 m), those in the unknowns of their nodes.

    Parameters
    ----------
    arms
        Of both sides, shape (2, d), m.
    z
        The frames, shape (2 d (d + 1),).
    gradient, hessian
        Derivatives in the frames; changed here to those in the frames of the nodes.
    half
        Work array, shape (2 d (d + 1), 2 m).
    """
    d, n_pair, m = arms.shape[1], z.size, g.size // 2
    n = n_pair // 2
    for side in range(2):
        for j in range(d):
            arm = arms[side, j]
            if arm != 0.0:
                for c in range(d):
                    at, point = n * side + d + d * j + c, n * side + c
                    gradient[at] += arm * gradient[point]
                    hessian[at] += arm * hessian[point]
                    hessian[:, at] += arm * hessian[:, point]
    if m == n:
        g[:], h[:] = gradient, hessian
        return
    # (x, y, phi): columns, then rows; J d_1 = d_2, J d_2 = -d_1
    for side in range(2):
        first, own = n * side, PLANAR * side
        for i in range(n_pair):
            half[i, own], half[i, own + 1] = hessian[i, first], hessian[i, first + 1]
            half[i, own + 2] = _around(z, first, hessian[i])
        g[own], g[own + 1], g[own + 2] = gradient[first], gradient[first + 1], _around(z, first, gradient)
    for side in range(2):
        first, own = n * side, PLANAR * side
        for j in range(2 * PLANAR):
            h[own, j], h[own + 1, j] = half[first, j], half[first + 1, j]
            h[own + 2, j] = _around(z, first, half[:, j])
        for c in range(2, 6):
            h[own + 2, own + 2] -= z[first + c] * gradient[first + c]  # d2 d_k / d phi2 = -d_k


@njit(inline="always")
def _around(z, first, values):
    """Return ``sum_k (J d_k) . values_k`` over the directors of the frame that begins at `first`."""
    x, y = z[first + 2], z[first + 3]
    return -y * values[first + 2] + x * values[first + 3] - x * values[first + 4] - y * values[first + 5]
