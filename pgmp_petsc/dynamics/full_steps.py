"""Steps of the generalised-alpha scheme for blocks of full-order samples, compiled.

The equations and the control of the iteration are those of `alpha_step`: a step is predicted with the accelerations
extrapolated linearly, and corrected until what remains is below the tolerance, every sample by itself. Equal steps in
turn are one call, whose cost from Python is that of several of a small mechanism.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.alpha_step import FIRST_CONTRACTION, MAX_ITERATIONS, REFRESH_EVERY, judge
from pgmp_petsc.dynamics.full_kernel import correct, count_turns
from pgmp_petsc.runtime.compiled import njit


@njit(cache=True, error_model="numpy")
def take_steps(
    problem, factors, strengths, probed, scheme, typical_mass, step, reference, behind, before, samples, after, lost,
    n_corrections,
):  # fmt: skip
    """Take equal steps of the samples of all blocks, up to one in which an iteration fails; return their number.

    Parameters
    ----------
    problem, factors
        The equations, and the matrices of the iteration.
    strengths
        What acts at the ends of the steps, one a row.
    probed
        Which steps are corrected as if nothing were known of the contraction, shape (n_steps,).
    scheme
        ``(alpha_m, alpha_f, beta, gamma, gain_v, gain_a)``.
    typical_mass
        As for `correct`.
    step
        s.
    reference
        Positions and accelerations of a motion at the ends of the steps, (n_steps, n_blocks, n_dofs, n_lanes), about
        which the states below are; of no steps where they are the motion itself.
    behind
        Accelerations one step before the beginning, shape (n_blocks, n_dofs, n_lanes).
    before
        ``(q, v, a, multipliers, turns, auxiliary)`` at the beginning, shapes (n_blocks, n_dofs, n_constraints or
        n_turns, n_lanes), and the contraction to be expected, (n_blocks, n_lanes).
    samples
        Which to advance, shape (n_blocks, n_lanes); others stay as they are.
    after
        Results, as `before` with a leading axis of steps.
    lost
        Result: the samples whose iteration failed in the last step, shape (n_blocks, n_lanes).
    n_corrections
        Result: Newton corrections of each step, all samples together, shape (n_steps,).
    """
    n_steps = strengths.loads.shape[0]
    n_blocks, n_lanes = samples.shape
    gains = (scheme[4], scheme[5], 1.0)
    itself = np.empty((n_blocks, 0, n_lanes))
    active, size, last = samples.copy(), np.zeros((n_blocks, n_lanes)), np.zeros(n_lanes)
    lost[:] = False
    now = before
    for k in range(n_steps):
        end = after[0][k], after[1][k], after[2][k], after[3][k], after[4][k], after[5][k], after[6][k]
        state = end[0], end[1], end[2], end[3], end[4]
        amplitudes, angles = (strengths.loads[k], strengths.actions[k]), strengths.angles[k]
        n_corrections[k] = 0
        for block in range(n_blocks):
            predict_block(
                scheme, step, now[0][block], now[1][block], now[2][block], now[5][block], behind[block],
                samples[block], end[0][block], end[1][block], end[2][block],
            )  # fmt: skip
            end[3][block], end[4][block], expected = now[3][block], now[4][block], end[6][block]
            expected[:] = now[6][block]
            if probed[k]:
                expected[:] = FIRST_CONTRACTION
            if reference[0].shape[0] > 0:
                end[0][block] += reference[0][k, block]
                end[2][block] += reference[1][k, block]
            active[block] = samples[block]
            for iteration in range(MAX_ITERATIONS):
                if not active[block].any():
                    break
                n_corrections[k] += active[block].sum()
                fresh = iteration % REFRESH_EVERY == 0
                correct(
                    problem, factors, (block, block + 1), amplitudes, angles, itself, state, gains, typical_mass,
                    active, fresh, size,
                )  # fmt: skip
                judge(iteration, size[block], last, expected, active[block], lost[block])
            for lane in range(n_lanes):
                lost[block, lane] = lost[block, lane] or active[block, lane]
                if lost[block, lane]:
                    expected[lane] = FIRST_CONTRACTION
            count_turns(problem, end[0][block], end[4][block])
            if reference[0].shape[0] > 0:
                end[0][block] -= reference[0][k, block]
                end[2][block] -= reference[1][k, block]
            follow_block(scheme, now[2][block], now[5][block], end[2][block], samples[block], end[5][block])
        if lost.any():
            return k + 1
        behind, now = now[2], end
    return n_steps


@njit(cache=True, error_model="numpy")
def predict_block(scheme, step, q, v, a, auxiliary, behind, samples, ahead_q, ahead_v, ahead_a):
    """Predict the end of a step with the accelerations at its beginning and one step before, (n_dofs, n_lanes)."""
    alpha_m, alpha_f, beta, gamma, _, _ = scheme
    weight = 1.0 / (1.0 - alpha_m)
    for dof in range(q.shape[0]):
        for lane in range(q.shape[1]):
            now, known = a[dof, lane], auxiliary[dof, lane]
            then = now + (now - behind[dof, lane])
            ahead = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * known) * weight
            moved = step * v[dof, lane] + step * step * ((0.5 - beta) * known + beta * ahead)
            faster = step * ((1.0 - gamma) * known + gamma * ahead)
            ahead_q[dof, lane] = q[dof, lane] + (moved if samples[lane] else 0.0)
            ahead_v[dof, lane] = v[dof, lane] + (faster if samples[lane] else 0.0)
            ahead_a[dof, lane] = then if samples[lane] else now


@njit(cache=True, error_model="numpy")
def follow_block(scheme, a, auxiliary, ahead_a, samples, ahead_auxiliary):
    """Find the auxiliary accelerations at the end of a step from the accelerations there."""
    alpha_m, alpha_f = scheme[0], scheme[1]
    for dof in range(a.shape[0]):
        for lane in range(a.shape[1]):
            weighted = (1.0 - alpha_f) * ahead_a[dof, lane] + alpha_f * a[dof, lane] - alpha_m * auxiliary[dof, lane]
            ahead_auxiliary[dof, lane] = weighted / (1.0 - alpha_m) if samples[lane] else auxiliary[dof, lane]
