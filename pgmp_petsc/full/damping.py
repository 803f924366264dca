"""Modal damping in full-order samples on one rank, compiled; the equations are those of `effects.damping`.

Samples lie side by side in the last axis (lanes).

Structural damping in the full-order model; see `effects.damping` for the equations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.effects import Effect
from pgmp_petsc.effects.damping import ModalDamping, amplitude_damping, modal_damping
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import SPATIAL


@dataclass(frozen=True, eq=False)
class BodyDampings:
    """The damping of all bodies."""

    rayleigh: np.ndarray  # beta (s) and alpha (1/s) of each body, shape (n_bodies, 2)
    #: name of the effect that each body's own damping belongs to, Rayleigh's or of its amplitudes, by the body's number
    effects: dict[int, str]
    modal: tuple[ModalDamping, ...]  # modal damping of bodies on their meshes
    #: modal damping of bodies in floating frames, N s/m of each amplitude, by the body's number
    amplitudes: dict[int, np.ndarray]

    @classmethod
    def of(cls, effects: Sequence[Effect], mechanism: Mechanism, bodies: Sequence[Body] | None = None) -> BodyDampings:
        """Collect the structural damping of all effects.

        `bodies` are the mechanism's with another numbering of their unknowns, where it is not the mechanism's own.
        Raises `InputError` if a body has fewer modes than ratios are given.
        """
        rayleigh, names = np.zeros((len(mechanism.bodies), 2)), {}
        for effect in effects:
            for number, damping in effect.dampings.items():
                if damping.stiffness or damping.mass:
                    rayleigh[number], names[number] = (damping.stiffness, damping.mass), effect.name
        bodies, nominal = mechanism.bodies if bodies is None else bodies, mechanism.scene.nominal
        braked = amplitude_damping(effects, bodies, nominal)
        names |= {number: effect for number, (effect, _) in braked.items()}
        amplitudes = {number: coefficients for number, (_, coefficients) in braked.items()}
        return cls(rayleigh, names, modal_damping(effects, bodies, nominal), amplitudes)


TURNING, POSITION, DIRECTED = range(3)  # what a node has: (x, y, phi), a position, or a position and directors
MOST_ROWS = 6  # of a factor for a node: velocity and spin
POLAR_STEPS = 12  # Newton's steps to a rotation: from a body's mean strain of 1 they are 6


class ModalFactors(NamedTuple):
    """Modal damping of all bodies; body k has the nodes ``starts[k]`` to ``starts[k + 1]``."""

    starts: np.ndarray  # shape (n_bodies + 1,)
    kinds: np.ndarray  # what the nodes of each body have, shape (n_bodies,)
    firsts: np.ndarray  # first unknown of every node, shape (n_nodes,)
    #: p in the body's frame, shape (n_nodes, 6, n_modes); zero where a node has fewer rows or a body fewer modes
    factors: np.ndarray
    levers: np.ndarray  # what the body's rotation is measured by, shape (n_nodes, 3)
    counted: np.ndarray  # whether the power of a body is counted here, shape (n_bodies,)

    @classmethod
    def of(
        cls, damped: Sequence[ModalDamping], dimension: int, local: Callable[[np.ndarray], np.ndarray], rows: range
    ) -> ModalFactors:
        """Collect modal damping for the unknowns of one rank.

        `local` gives the numbers of unknowns here; bodies are counted where their first unknown is among `rows`.
        """
        n_modes = max((one.factor.shape[1] for one in damped), default=0)
        n_nodes = [len(one.levers) for one in damped]
        starts = np.cumsum([0, *n_nodes])
        factors, levers = np.zeros((starts[-1], MOST_ROWS, n_modes)), np.zeros((starts[-1], 3))
        firsts, kinds = np.zeros(starts[-1], dtype=np.int64), np.zeros(len(damped), dtype=np.int64)
        for k, (one, n) in enumerate(zip(damped, n_nodes)):
            own = slice(starts[k], starts[k + 1])
            per_node, n_rows = one.dofs.size // n, one.factor.shape[0] // n
            factors[own, :n_rows, : one.factor.shape[1]] = one.factor.reshape(n, n_rows, -1)
            levers[own, : one.levers.shape[1]] = one.levers
            firsts[own] = local(one.dofs[::per_node])
            kinds[k] = DIRECTED if per_node == SPATIAL.n_pose else POSITION if one.levers.shape[1] > 1 else TURNING
        counted = np.array([int(one.dofs[0]) in rows for one in damped], dtype=bool)
        return cls(starts, kinds, firsts, factors, levers, counted)


@njit(cache=True, apart=True, error_model="numpy")
def add_modal_damping(modal, d, q, v, x, place, powers):
    """Take the forces of modal damping in d dimensions from x; `powers` are those of each body, (n_bodies, n_lanes)."""
    n_modes = modal.factors.shape[2]
    along, turn, local = np.zeros(n_modes), np.zeros((3, 3)), np.zeros(MOST_ROWS)
    for body in range(modal.kinds.size):
        kind, nodes = modal.kinds[body], range(modal.starts[body], modal.starts[body + 1])
        for lane in range(q.shape[1]):
            _rotation(modal, body, d, q, lane, turn)
            along[:] = 0.0
            for node in nodes:
                _to_body(kind, d, turn, modal.firsts[node], q, v, lane, local)
                for row in range(MOST_ROWS):
                    for mode in range(n_modes):
                        along[mode] += modal.factors[node, row, mode] * local[row]  # P^T R^T q'
            powers[body, lane] = 0.0
            for mode in range(n_modes):
                powers[body, lane] -= along[mode] * along[mode]
            for node in nodes:
                for row in range(MOST_ROWS):
                    local[row] = 0.0
                    for mode in range(n_modes):
                        local[row] -= modal.factors[node, row, mode] * along[mode]
                _take_from(kind, d, turn, modal.firsts[node], q, lane, local, x, place)


@njit(cache=True, error_model="numpy")
def _rotation(modal, body, d, q, lane, turn):
    """Fill the rotation (3, 3) of a body."""
    kind = modal.kinds[body]
    turn[:] = 0.0
    if kind == TURNING:
        angle = 0.0
        for node in range(modal.starts[body], modal.starts[body + 1]):
            angle += modal.levers[node, 0] * q[modal.firsts[node] + 2, lane]
        turn[0, 0] = turn[1, 1] = np.cos(angle)
        turn[1, 0], turn[0, 1] = np.sin(angle), -np.sin(angle)
        return
    for node in range(modal.starts[body], modal.starts[body + 1]):
        first = modal.firsts[node]
        for i in range(d):
            for j in range(d):
                if kind == POSITION:
                    turn[i, j] += q[first + i, lane] * modal.levers[node, j]
                else:
                    turn[i, j] += modal.levers[node, 0] * q[first + d + d * j + i, lane]
    if d == 2:
        angle = np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
        turn[0, 0] = turn[1, 1] = np.cos(angle)
        turn[1, 0], turn[0, 1] = np.sin(angle), -np.sin(angle)
    else:
        _closest_rotation(turn)


@njit(cache=True, error_model="numpy")
def _closest_rotation(a):
    """Replace a matrix (3, 3) of positive determinant by the rotation closest to it, by Newton's iteration for the
    polar decomposition, ``A <- (s A + A^-T / s) / 2`` with the scale s of Higham (1986)."""
    cofactors = np.empty((3, 3))
    for _ in range(POLAR_STEPS):
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for c in range(3):
                m, n = (c + 1) % 3, (c + 2) % 3
                cofactors[i, c] = a[j, m] * a[k, n] - a[j, n] * a[k, m]
        determinant, size, inverse = 0.0, 0.0, 0.0
        for c in range(3):
            determinant += a[0, c] * cofactors[0, c]
        for i in range(3):
            for c in range(3):
                cofactors[i, c] /= determinant
                size += a[i, c] ** 2
                inverse += cofactors[i, c] ** 2
        scale, change = (inverse / size) ** 0.25, 0.0
        for i in range(3):
            for c in range(3):
                new = 0.5 * (scale * a[i, c] + cofactors[i, c] / scale)
                change = max(change, abs(new - a[i, c]))
                a[i, c] = new
        if change < 1e-15:
            return


@njit(cache=True, error_model="numpy")
def _to_body(kind, d, turn, first, q, v, lane, local):
    """Fill the velocity of a node, and its spin where it has one, in the body's axes, shape (6,)."""
    local[:] = 0.0
    for j in range(d):
        for i in range(d):
            local[j] += turn[i, j] * v[first + i, lane]
    if kind == TURNING:
        local[2] = v[first + 2, lane]
    elif kind == DIRECTED:
        for i in range(3):
            m, n = (i + 1) % 3, (i + 2) % 3
            spin = 0.0
            for k in range(3):  # 1/2 sum_k d_k x d_k'
                at = first + 3 + 3 * k
                spin += 0.5 * (q[at + m, lane] * v[at + n, lane] - q[at + n, lane] * v[at + m, lane])
            for j in range(3):
                local[3 + j] += turn[i, j] * spin


@njit(cache=True, error_model="numpy")
def _take_from(kind, d, turn, first, q, lane, local, x, place):
    """Take the force, and the couple where there is one, in the body's axes from x."""
    for i in range(d):
        for j in range(d):
            x[place[first + i], lane] -= turn[i, j] * local[j]
    if kind == TURNING:
        x[place[first + 2], lane] -= local[2]
    elif kind == DIRECTED:
        for i in range(3):
            m, n = (i + 1) % 3, (i + 2) % 3
            one, other = 0.0, 0.0  # components m and n of the couple
            for j in range(3):
                one += turn[m, j] * local[3 + j]
                other += turn[n, j] * local[3 + j]
            for k in range(3):  # 1/2 m x d_k
                at = first + 3 + 3 * k
                x[place[at + i], lane] -= 0.5 * (one * q[at + n, lane] - other * q[at + m, lane])
