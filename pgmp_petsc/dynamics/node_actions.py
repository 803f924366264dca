"""Actions on the unknowns of nodes, compiled; see `mechanism.node_statements`."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.effects.laws import about_zero, depth, law
from pgmp_petsc.mechanism.node_statements import scratch_of, state
from pgmp_petsc.runtime.compiled import njit


@njit(cache=True, error_model="numpy")
def evaluate_actions(
    actions, entries, amplitudes, y, rates, known, turned, gain_v, with_tangents, about, forces, tangents, powers,
    stored, depths
):  # fmt: skip
    """Evaluate all actions for all samples.

    Parameters
    ----------
    actions, amplitudes
        As from `compile_actions`, `amplitudes_over`.
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
    with_tangents
        Whether the tangents are wanted, whose second derivatives cost more than all the rest.
    about
        Of an iteration, the rates at which laws were evaluated last, shape (n_actions, n_samples): NaN before the
        first, and where one is limited (`laws.about_zero`); brought up to date. None, (0, n_samples), where laws are
        to be taken as they are.
    forces, tangents
        Results: force on the unknowns, shape (n_actions, 2 m, n_samples), and minus its derivative, the mean of each
        entry and its mirror, shape (n_entries, n_samples).
    powers, stored
        Results: power of what is not elastic (W) and potential energy of what is (J), shape (n_actions, n_samples).
    depths
        Result: how deep a stop is entered (negative: how far it is), NaN for other laws, shape (n_actions, n_samples).
    """
    starts, rows, columns = entries
    statements, m = actions.statements, y.shape[1] // 2
    scratch, own, g, h = scratch_of(statements, m), np.zeros(2 * m), np.zeros(2 * m), np.zeros((2 * m, 2 * m))
    for k in range(actions.laws.size):
        for sample in range(y.shape[2]):
            p = actions.parameters[k, sample]
            own[:] = y[k, :, sample]
            s = state(statements, k, own, known[k, sample], with_tangents, scratch, g, h)
            turned[k, sample] = s if np.isfinite(s) else known[k, sample]
            rate = 0.0
            for i in range(2 * m):
                rate += g[i] * rates[k, i, sample]
            force, stiffness, damping, elastic, potential = law(actions.laws[k], p, amplitudes[k], s, rate)
            if about.shape[0]:
                limited = with_tangents and about_zero(actions.laws[k], p, rate, about[k, sample])
                if limited:
                    damping = p[0] / p[1]
                    force = -damping * rate
                about[k, sample] = np.nan if limited else rate
            powers[k, sample] = (force - elastic) * rate
            stored[k, sample] = potential
            depths[k, sample] = depth(actions.laws[k], p, s)
            for i in range(2 * m):
                forces[k, i, sample] = force * g[i]
            for entry in range(starts[k], starts[k + 1] if with_tangents else starts[k]):
                i, j = rows[entry], columns[entry]
                # a force that turns with its body has no symmetric tangent; its mean serves the factorisation
                bent = 0.5 * force * (h[i, j] + h[j, i])
                tangents[entry, sample] = (stiffness + gain_v * damping) * g[i] * g[j] - bent
