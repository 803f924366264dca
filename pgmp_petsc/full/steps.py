"""Corrections and steps of the generalised-alpha scheme for blocks of full-order samples, compiled.

The equations and the control of the iteration are those of `alpha_step`: a step is predicted with the accelerations
extrapolated linearly, and corrected until what remains is below the tolerance, every sample by itself. Equal steps in
turn are one call, whose cost from Python is that of several of a small mechanism.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.controllers.running import (
    States,
    begin_carried,
    begin_state,
    follow_states,
    give_forces,
    keep_carried,
    take_carried,
)
from pgmp_petsc.effects.law import any_bend
from pgmp_petsc.full.carried import Carried, find_carried
from pgmp_petsc.full.forces import act, doubt_limited, forget_rates
from pgmp_petsc.full.joint_kernel import correct_joints, count_turns_in_joints
from pgmp_petsc.full.joint_map import place
from pgmp_petsc.full.kernel import correct_block, count_turns
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import borrowed, items, keep, lanes_of, select
from pgmp_petsc.stepping.alpha_step import FIRST_CONTRACTION, MAX_ITERATIONS, REFRESH_EVERY, ROUND_OFF, judge


class Beside(NamedTuple):
    """What is found along with the mechanics in steps that are taken in turn."""

    carried: Carried  # joints whose forces friction hangs on; there may be none
    states: States  # continuous controllers; there may be none
    over: np.ndarray  # time, and references with their rates, at the ends of the steps, (n_t, 1 + 2 n)


@njit(cache=True, entry=True, error_model="numpy")
def correct(problem, joints, factors, strengths, residual, states, gains, typical_mass, active, fresh, size):
    """Do one Newton correction of every active sample at each of some instants in place; fill their sizes, (n_t,
    n_blocks, n_lanes).

    Arguments are as of `kernel.evaluate`, of all instants and blocks: `strengths` what acts, states (n_t, n_blocks,
    n_dofs, n_constraints or n_turns, n_lanes), residuals (n_t, n_blocks, n_constraints or 0, n_lanes); `joints` as of
    `take_steps`. The constraints are scaled to the inertia of a mass, (n_blocks, n_lanes), kg: each sample's own, so
    that none is felt by another. Where it is not `fresh`, the matrix is that of `factors` as it is.
    """
    scale = np.empty(size.shape[2])
    size[:] = 0.0
    for k in range(size.shape[0]):
        amplitudes = strengths.loads[k], strengths.actions[k]
        for block in range(size.shape[1]):
            if active[block].any():
                own = (
                    states[0][k, block], states[1][k, block], states[2][k, block], states[3][k, block],
                    states[4][k, block],
                )  # fmt: skip
                _correct_block(
                    problem, joints, factors, block, amplitudes, strengths.angles[k], residual[k, block], own, gains,
                    typical_mass[block], lanes_of(active[block]), fresh, scale, size[k, block],
                )  # fmt: skip


@njit(inline="always")
def _correct_block(
    problem, joints, factors, block, amplitudes, angles, residual, state, gains, typical_mass, lanes, fresh, scale, size
):  # fmt: skip
    """Correct some lanes of a block; `scale` is a work array (n_lanes,)."""
    if joints is None:
        correct_block(
            problem, factors, block, amplitudes, angles, residual, state, gains, typical_mass, lanes, fresh, scale, size
        )
    else:
        correct_joints(
            problem, joints, borrowed(factors.matrix)[block], block, amplitudes, angles, residual, state, gains,
            typical_mass, lanes, fresh, scale, size,
        )  # fmt: skip


@njit(cache=True, entry=True, error_model="numpy")
def take_steps(
    problem, joints, beside, factors, strengths, probed, scheme, typical_mass, step, reference, behind, before, samples,
    after, lost, n_corrections,
):  # fmt: skip
    """Take equal steps (s) of the samples of all blocks, up to one in which an iteration fails; return their number.

    `joints` is the mechanism in joint coordinates or None, `beside` what is found along with it or None: forces that
    joints carry are found before each correction, until they are settled too (`controllers.running`). `factors` are the
    matrices of the iteration, `strengths` what acts at the ends of the steps, one a row, and `probed` which of these
    are corrected as if nothing were known of the contraction, (n_steps,). The scheme is ``(alpha_m, alpha_f, beta,
    gamma, gain_v, gain_a)``, and typical masses are as for `correct`. States are about a `reference`: positions,
    velocities and accelerations of a motion at the ends of the steps, (n_steps, n_blocks, n_dofs, n_lanes); of no steps
    where they are the motion itself. `behind` are accelerations one step before the beginning, (n_blocks, n_dofs,
    n_lanes), and `before` ``(q, v, a, multipliers, turns, auxiliary)`` there, (n_blocks, n_dofs, n_constraints or
    n_turns, n_lanes), the contraction to be expected, (n_blocks, n_lanes), and the numbers beside, (n_blocks, n_beside,
    n_lanes). Only `samples` advance, (n_blocks, n_lanes).

    Filled are `after`, as `before` with a leading axis of steps, the samples whose iteration failed in the last step,
    `lost`, (n_blocks, n_lanes), and the Newton corrections of each step, all samples together, (n_steps,).
    """
    n_steps = n_taken = strengths.loads.shape[0]
    n_blocks, n_lanes = samples.shape
    n_corrections[:] = 0
    # when each sample was lost; a block goes through all steps while it is in the cache
    when = np.full((n_blocks, n_lanes), n_steps)
    work, flags = np.empty((3, n_lanes)), np.empty((2, n_lanes), dtype=np.bool_)
    of_before = (
        borrowed(before[0]), borrowed(before[1]), borrowed(before[2]), borrowed(before[3]), borrowed(before[4]),
        borrowed(before[5]), borrowed(before[6]), borrowed(before[7]),
    )  # fmt: skip
    of_after = (
        borrowed(after[0]), borrowed(after[1]), borrowed(after[2]), borrowed(after[3]), borrowed(after[4]),
        borrowed(after[5]), borrowed(after[6]), borrowed(after[7]),
    )  # fmt: skip
    for block in range(n_blocks):
        n_taken = _take_steps_of_block(
            problem, joints, beside, factors, block, n_taken, strengths, probed, scheme, typical_mass[block], step,
            reference, borrowed(behind[block]), of_before, borrowed(samples[block]), of_after, borrowed(work),
            borrowed(flags), borrowed(when[block]), n_corrections,
        )  # fmt: skip
    keep(work)
    keep(flags)
    keep(when)
    for block in range(n_blocks):
        for lane in range(n_lanes):
            lost[block, lane] = when[block, lane] == n_taken - 1
    return n_taken


@njit(inline="always")
def _take_steps_of_block(
    problem, joints, beside, factors, block, n_steps, strengths, probed, scheme, typical_mass, step, reference, behind,
    before, samples, after, work, flags, when, n_corrections,
):  # fmt: skip
    """Take up to n_steps steps of a block, to the one in which an iteration fails; return how many."""
    width, lanes = problem.width, lanes_of(samples)
    gains = (scheme[4], scheme[5], 1.0)
    size, last, scale, active = work[0], work[1], work[2], flags[0]
    lost, itself = flags[1], np.empty((0, samples.size))
    lost[:] = False
    about = reference[0].shape[0] > 0
    q, v, a, multipliers = before[0][block], before[1][block], before[2][block], before[3][block]
    turns, auxiliary, contraction, numbers = before[4][block], before[5][block], before[6][block], before[7][block]
    rates, bending = borrowed(problem.actions.about)[block], any_bend(problem.actions.laws)
    parameters, matrix = borrowed(problem.actions.parameters)[block], borrowed(factors.matrix)[block]
    all_lanes = np.arange(samples.size)
    for k in range(n_steps):
        ahead = after[0][k, block], after[1][k, block], after[2][k, block]
        forces, counted = after[3][k, block], after[4][k, block]
        follows, expected, noted = after[5][k, block], after[6][k, block], after[7][k, block]
        amplitudes, angles = (strengths.loads[k], strengths.actions[k]), strengths.angles[k]
        _predict(width, scheme, step, q, v, a, auxiliary, behind, lanes, ahead)
        _copy(width, multipliers, forces)
        _copy(width, turns, counted)
        _copy(width, numbers, noted)
        for lane in range(samples.size):
            expected[lane] = FIRST_CONTRACTION if probed[k] or bending else contraction[lane]
            active[lane] = samples[lane]
        if about:
            for part in range(3):
                _add(width, 1.0, reference[part][k, block], ahead[part])
        state = ahead[0], ahead[1], ahead[2], forces, counted
        going = lanes
        forget_rates(rates)
        if beside is not None:
            _begin(beside, k, scheme, step, noted, parameters, all_lanes, lanes)
        for iteration in range(MAX_ITERATIONS):
            if going == 0:
                break
            for lane in range(samples.size):
                n_corrections[k] += (going >> lane) & 1
            fresh, unsettled = iteration % REFRESH_EVERY == 0, 0
            if beside is not None:
                carried = beside.carried
                _act(problem, joints, beside, matrix, block, amplitudes, angles, state, typical_mass, all_lanes, going)
                unsettled = take_carried(carried.actions, carried.room, parameters, iteration, all_lanes, going)
            _correct_block(
                problem, joints, factors, block, amplitudes, angles, itself, state, gains, typical_mass, going, fresh,
                scale, size,
            )  # fmt: skip
            doubt_limited(rates, last)
            judge(iteration, size, last, expected, active, lost)
            for lane in range(samples.size):
                unsettled &= ~(np.int64(not size[lane] > ROUND_OFF) << lane)
            going &= lanes_of(active) | unsettled
        done = lanes & ~lanes_of(lost) & ~lanes_of(active)
        if beside is not None:
            _act(problem, joints, beside, matrix, block, amplitudes, angles, state, typical_mass, all_lanes, done)
            follow_states(beside.states, loaded(beside.states.law), scheme, noted, done)
            keep_carried(beside.carried.room, noted, done)
        for lane in range(samples.size):
            lost[lane] |= active[lane]
            if lost[lane]:
                expected[lane] = FIRST_CONTRACTION
                when[lane] = k
        if joints is None:
            count_turns(problem, ahead[0], counted)
        else:
            count_turns_in_joints(problem, joints, ahead[0], counted)
        if about:
            for part in range(3):
                _add(width, -1.0, reference[part][k, block], ahead[part])
        _follow(width, scheme, a, auxiliary, ahead[2], lanes, follows)
        if lanes_of(lost):
            return k + 1
        behind, q, v, a, multipliers = a, ahead[0], ahead[1], ahead[2], forces
        turns, auxiliary, contraction, numbers = counted, follows, expected, noted
    return n_steps


@njit(error_model="numpy")
def _begin(beside, number, scheme, step, noted, parameters, samples, lanes):
    """Begin the step with a number in some lanes, from what is `noted` beside them, (n_beside, n_lanes), at its
    beginning."""
    carried, states, law, over = beside.carried, beside.states, loaded(beside.states.law), beside.over
    begin_carried(carried.actions, carried.room, parameters, noted, samples, lanes)
    for lane in range(samples.size):
        if lanes & (1 << lane):
            for k in range(over.shape[1]):
                states.now[lane, k] = over[number, k]
            states.kappa[lane] = scheme[4] / scheme[5]
            for k in range(law.addresses.size):
                begin_state(states, law, k, lane, scheme[:4], step, noted, samples[lane], parameters)


@njit(cache=True, apart=True, error_model="numpy")
def _act(problem, joints, beside, matrix, block, amplitudes, angles, state, typical_mass, samples, lanes):
    """Give the actions in some lanes the forces of controllers about an iterate, whose motions actions measure, and
    find the forces that joints carry."""
    width, law, turns = problem.width, loaded(beside.states.law), state[4][problem.angles.dofs.shape[0] :]
    if law.addresses.size:
        if joints is None:
            act(problem.actions, width, block, amplitudes[1], state[0], state[1], turns, 0.0, False)
        else:
            room = joints.room
            place(problem.dimension, joints.tree, width, state[0], state[1], state[2], room)
            act(problem.actions, width, block, amplitudes[1], room.q, room.v, turns, 0.0, False)
        give_forces(beside.states, law, borrowed(problem.actions.parameters)[block], samples, lanes)
    if beside.carried.actions.size:
        find_carried(problem, joints, matrix, beside.carried, block, amplitudes, angles, state, typical_mass)


@njit(error_model="numpy", forceinline=True)
def _copy(width, x, into):
    """Copy x (n, n_lanes)."""
    x, into = items(x, width), items(into, width)
    for k in range(x.size):
        into[k] = x[k]


@njit(error_model="numpy", forceinline=True)
def _add(width, factor, x, into):
    """Add a multiple of x (n_dofs, n_lanes)."""
    x, into = items(x, width), items(into, width)
    for dof in range(x.size):
        into[dof] += factor * x[dof]


@njit(error_model="numpy", forceinline=True)
def _predict(width, scheme, step, q, v, a, auxiliary, behind, lanes, ahead):
    """Predict the end of a step with the accelerations at its beginning and one step before, (n_dofs, n_lanes)."""
    alpha_m, alpha_f, beta, gamma, _, _ = scheme
    q, v, a, auxiliary = items(q, width), items(v, width), items(a, width), items(auxiliary, width)
    behind, places, rates = items(behind, width), items(ahead[0], width), items(ahead[1], width)
    accelerations, weight = items(ahead[2], width), 1.0 / (1.0 - alpha_m)
    for dof in range(q.size):
        now, known = a[dof], auxiliary[dof]
        then = now + (now - behind[dof])
        end = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * known) * weight
        moved = step * v[dof] + step * step * ((0.5 - beta) * known + beta * end)
        places[dof] = q[dof] + select(lanes, moved, 0.0)
        rates[dof] = v[dof] + select(lanes, step * ((1.0 - gamma) * known + gamma * end), 0.0)
        accelerations[dof] = select(lanes, then, now)


@njit(error_model="numpy", forceinline=True)
def _follow(width, scheme, a, auxiliary, ahead, lanes, follows):
    """Find the auxiliary accelerations at the end of a step from the accelerations there."""
    alpha_m, alpha_f = scheme[0], scheme[1]
    a, auxiliary, ahead, follows = items(a, width), items(auxiliary, width), items(ahead, width), items(follows, width)
    for dof in range(a.size):
        # to the last bit what `alpha_step` finds where a neighbour is lost
        end = ((1.0 - alpha_f) * ahead[dof] + alpha_f * a[dof] - alpha_m * auxiliary[dof]) / (1.0 - alpha_m)
        follows[dof] = select(lanes, end, auxiliary[dof])
