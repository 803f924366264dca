"""Measures of validity in every second step of every sample, compiled, LANES samples side by side.

At the sampled configuration next to a state, with the weights w of a sample's own parameters and packed lower triangles
of the stiffness, halved on the diagonal, the elastic energy and the shares by which the stiffness of mode k has changed
(`reduction.tables.StiffnessChanges`) are

    E = sum_ij (sum_t w_t K_t)_ij delta_i delta_j,     s_k = h_k.f / sum_t w_t psi_k.K_t psi_k,     i >= j.

What follows from place and parameters alone is kept for each sample until it comes to another place.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import SampleBlocks, empty_lanes
from pgmp_petsc.lanes.vectors import LANES, aligned_zeros, blend, differing, exceeding, larger, load, spread, store
from pgmp_petsc.reduced.kernel import gather
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.tables import StiffnessChanges

EVERYONE = (1 << LANES) - 1
ROUND_OFF = 1e-9  # of an angle: so close to the middle between two places, the nearer one is found anew


class Axis(NamedTuple):
    """Places along one coordinate."""

    lower: float  # lower, turn: lower end of the range and, of a periodic one, its length, or else 0; rad
    turn: float
    middles: np.ndarray  # between neighbouring places, rad; behind the last one of a periodic range comes the first
    n: int  # number of places


class Places(NamedTuple):
    """The sampled configurations, and what holds at each of them."""

    axes: tuple[Axis, ...]  # an `Axis` of every coordinate
    #: lower triangles, halved on the diagonal, shape (n_places, n_terms, n_delta (n_delta + 1) / 2)
    stiffness: np.ndarray
    #: influence, of_modes: as of `StiffnessChanges`; without modes where nothing is known of these
    influence: np.ndarray
    of_modes: np.ndarray

    @classmethod
    def of(cls, samples: SampleGrid, stiffness: np.ndarray, changes: StiffnessChanges | None) -> Self:
        """Pack tables; `stiffness` has the shape (n_places, n_terms, n_delta, n_delta)."""
        axes = []
        for axis in samples:
            turn = axis.upper - axis.lower if axis.periodic else 0.0
            known = np.append(axis.theta, axis.theta[0] + turn) if axis.periodic else axis.theta
            axes.append(Axis(float(axis.lower), float(turn), 0.5 * (known[1:] + known[:-1]), axis.n))
        rows, columns = np.tril_indices(stiffness.shape[-1])
        lower = stiffness[..., rows, columns] * np.where(rows == columns, 0.5, 1.0)
        influence, of_modes = np.empty((samples.n, 0, 0)), np.empty((samples.n, stiffness.shape[1], 0))
        if changes is not None:
            influence, of_modes = changes.influence, changes.stiffness
        return cls(tuple(axes), *(np.ascontiguousarray(part) for part in (lower, influence, of_modes)))


class Weights(NamedTuple):
    """Weights of the terms of n samples, from their own parameters."""

    mass: np.ndarray  # mass, loads: vectors (n_blocks, n_terms, LANES)
    loads: np.ndarray
    stiffness: np.ndarray  # shape (n, n_terms)

    @classmethod
    def of(cls, mass: np.ndarray, loads: np.ndarray, stiffness: np.ndarray) -> Self:
        """Pack weights, each (n, n_terms)."""
        return cls(_side_by_side(mass), _side_by_side(loads), np.array(stiffness, order="C"))


class Kept(NamedTuple):
    """Values kept of n samples in lanes, sample k in lane ``k % LANES`` of block ``k // LANES``."""

    #: of the range of each coordinate that is nearest to the sample's place, lower and upper one, rad, shape (n_blocks,
    #: 2 n_theta, LANES); NaN before there is a place
    ends: np.ndarray
    #: stiffness, influences and stiffness of the modes at that place, shape (n_blocks, n_entries, LANES)
    terms: np.ndarray
    #: elastic energy in the present part of the run, least and largest share, shape (n_blocks, 3, LANES)
    largest: np.ndarray
    states: np.ndarray  # the most deformed one of every part, shape (n_blocks, n_parts, n_eta, LANES)

    @classmethod
    def nothing(cls, places: Places, n_parts: int, n: int, n_eta: int) -> Self:
        """Return what is kept before a run."""
        _, n_modes, n_columns = places.influence.shape
        n_entries = places.stiffness.shape[2] + n_modes * (n_columns + 1)
        shapes = ((2 * len(places.axes),), (n_entries,), (3,), (n_parts, n_eta))
        kept = cls(*(aligned_zeros((-(-n // LANES), *shape, LANES)) for shape in shapes))
        kept.ends[:], kept.largest[:] = np.nan, np.nan
        return kept

    def shares(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest shares gained and lost of n samples, each of shape (n,), NaN where nothing is known."""
        return tuple(self.largest[:, row].ravel()[:n] for row in (1, 2))

    def deformed(self, n: int) -> np.ndarray:
        """Return the most deformed state of each part and sample, shape (n_parts, n, n_eta)."""
        n_parts, n_eta = self.states.shape[1:3]
        return np.moveaxis(self.states, (0, 3), (1, 2)).reshape(n_parts, -1, n_eta)[:, :n]


def _side_by_side(rows: np.ndarray) -> np.ndarray:
    """Return what is known of n samples, (n, k), as vectors (n_blocks, k, LANES)."""
    n_blocks = -(-len(rows) // LANES)
    vectors = aligned_zeros((n_blocks, rows.shape[1], LANES))
    vectors[:] = SampleBlocks(len(rows), LANES, n_blocks).pack(rows.T)
    return vectors


@njit(cache=True, entry=True, error_model="numpy")
def look_at(places, weights, first, length, loads, forces, trail, kept):
    """Look at some states of all samples.

    Parameters
    ----------
    weights
        `Weights`.
    first, length
        Number of states of each sample that were looked at before, and in a part of the run.
    loads, forces
        Amplitudes of the load terms, shape (n_t, n_loads), and forces of the actions with their weights, shape (n_t, n,
        n_actions).
    trail
        Positions, velocities and accelerations, shape (n_t, 3, n, n_eta).
    kept
        Moved on.
    """
    n_eta, r = trail.shape[3], len(places.axes)
    q, rates, moving = empty_lanes(n_eta, LANES), empty_lanes(r, LANES), empty_lanes(r + r * (r + 1) // 2, LANES)
    loading = empty_lanes(places.influence.shape[2], LANES)
    samples = np.empty(LANES, dtype=np.int64)
    room = samples, q, rates, moving, loading, np.empty(places.stiffness.shape[2])
    _look_in_lanes(places, weights, first, length, loads, forces, trail, kept, room)


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def _look_in_lanes(places, weights, first, length, loads, forces, trail, kept, room):
    """Look at the states block by block; see `look_at`. `room` is for what holds at one state of a block."""
    samples, q, rates, moving, loading, own_stiffness = room
    n, n_eta, r = trail.shape[2], trail.shape[3], len(places.axes)
    for block in range(kept.ends.shape[0]):
        for lane in range(LANES):
            samples[lane] = min(block * LANES + lane, n - 1)  # behind the last one its copies
        ends, terms, largest, states = kept.ends[block], kept.terms[block], kept.largest[block], kept.states[block]
        for k in range(trail.shape[0]):
            part, place = divmod(first + k, length)
            if place == 0:
                store(largest, 0, -1.0)
            gather(trail[k, 0], samples, q)
            moved = _left(ends, q)
            for lane in range(LANES):
                if moved & (1 << lane):
                    own = weights.stiffness[samples[lane]]
                    _come_to(_nearest(places.axes, ends, q, lane), places, own, lane, own_stiffness, terms)
            energy = _energy(terms, q, r, n_eta)
            more = exceeding(energy, load(largest, 0)) & ~differing(energy, energy)
            if more:
                store(largest, 0, blend(more, energy, load(largest, 0)))
                for i in range(n_eta):
                    store(states, part * n_eta + i, blend(more, load(q, i), load(states, part * n_eta + i)))
            if places.influence.shape[1] > 0:
                of_block = weights.mass[block], weights.loads[block]
                _load_with(samples, of_block, loads[k], forces[k], trail[k], rates, moving, loading)
                _keep_shares(places.influence, places.stiffness.shape[2], terms, loading, largest)


@njit(inline="always")
def _left(ends, q):
    """Return the lanes that have left the surroundings of their places."""
    moved = 0
    for axis in range(ends.shape[0] // 2):
        theta = load(q, axis)
        moved |= exceeding(load(ends, 2 * axis), theta) | exceeding(theta, load(ends, 2 * axis + 1))
    return moved


@njit(inline="always")
def _nearest(axes, ends, q, lane):
    """Return the number of the place next to a lane, and keep the ends of its surroundings."""
    number = 0
    for k in range(len(axes)):
        lower, turn, middles, n = axes[k]
        theta = q[k, lane]
        inside = lower + (theta - lower) % turn if turn > 0.0 else theta
        i = 0
        if middles.size > 1:  # where it is among even places, and from there
            share = (inside - middles[0]) / (middles[-1] - middles[0])
            i = min(max(int(share * middles.size), 0), middles.size)
        while i > 0 and not middles[i - 1] < inside:
            i -= 1
        while i < middles.size and middles[i] < inside:
            i += 1
        from_ = middles[i - 1] if i > 0 else (lower if turn > 0.0 else -np.inf)
        to = middles[i] if i < middles.size else (lower + turn if turn > 0.0 else np.inf)
        away = ROUND_OFF * (1.0 + abs(theta))
        ends[2 * k, lane] = from_ + (theta - inside) + away
        ends[2 * k + 1, lane] = to + (theta - inside) - away
        number = number * n + i % n
    return number


@njit(inline="always")
def _come_to(place, places, weights, lane, own_stiffness, terms):
    """Keep what holds at a place for the parameters of a lane."""
    _, stiffness, influence, of_modes = places
    row = stiffness.shape[2]
    # along the entries, which lie side by side
    for entry in range(row):
        own_stiffness[entry] = weights[0] * stiffness[place, 0, entry]
    for term in range(1, weights.size):
        for entry in range(row):
            own_stiffness[entry] += weights[term] * stiffness[place, term, entry]
    for entry in range(row):
        terms[entry, lane] = own_stiffness[entry]
    for mode in range(influence.shape[1]):
        own = 0.0
        for term in range(weights.size):
            own += weights[term] * of_modes[place, term, mode]
        for column in range(influence.shape[2]):
            terms[row, lane] = influence[place, mode, column]
            row += 1
        terms[row, lane] = own
        row += 1


@njit(inline="always")
def _energy(terms, q, r, n_eta):
    """Return the elastic energy, a vector."""
    energy, entry = spread(0.0), 0
    for i in range(r, n_eta):
        half = spread(0.0)
        for j in range(r, i + 1):
            half += load(terms, entry) * load(q, j)
            entry += 1
        energy += half * load(q, i)
    return energy


@njit(inline="always")
def _load_with(samples, weights, loads, forces, state, rates, moving, loading):
    """Fill how much of every column of influences acts, vectors (n_columns, LANES), at a state (3, n, n_eta).

    `weights` are those of mass and load terms, vectors (n_terms, LANES); `rates` and `moving` have room for the
    velocities of the coordinates, (r, LANES), and for their accelerations and products of velocities.
    """
    mass_weights, load_weights = weights
    r, n_loads, n_forces = rates.shape[0], loads.size, forces.shape[1]
    for lane in range(LANES):
        sample = samples[lane]
        for k in range(r):
            rates[k, lane], moving[k, lane] = state[1, sample, k], state[2, sample, k]
        for column in range(n_forces):
            loading[n_loads + column, lane] = forces[sample, column]
    for column in range(n_loads):
        store(loading, column, load(load_weights, column) * loads[column])
    row = r
    for k in range(r):
        for j in range(k + 1):
            twice = 1.0 if j == k else 2.0
            store(moving, row, load(rates, k) * load(rates, j) * twice)  # theta_k' theta_j'
            row += 1
    row = n_loads + n_forces
    for term in range(mass_weights.shape[0]):
        for k in range(moving.shape[0]):
            store(loading, row, load(mass_weights, term) * load(moving, k))
            row += 1


@njit(inline="always")
def _keep_shares(influence, row, terms, loading, largest):
    """Replace the largest and the least share where one is beyond; terms of the first mode begin at a row."""
    none = spread(0.0)
    for _ in range(influence.shape[1]):
        force = none
        for column in range(influence.shape[2]):
            force += load(terms, row + column) * load(loading, column)
        share = force / load(terms, row + influence.shape[2])
        row += influence.shape[2] + 1
        finite = EVERYONE & ~differing(share * 0.0, none)
        gained, lost = load(largest, 1), load(largest, 2)
        store(largest, 1, blend(finite & exceeding(share, gained), larger(share, none), gained))
        store(largest, 2, blend(finite & exceeding(lost, share), blend(exceeding(share, none), none, share), lost))


@njit(cache=True, entry=True, error_model="numpy")
def look_at_planar_beam(local, nodes, cells, lengths, longer, angles, half_heights, curved, rotation, strain):
    """Enlarge rotations, (n,), to the largest one of a planar beam, and fill the largest strain of an outermost fibre,
    (n,); NaN where one is.

    Parameters
    ----------
    local
        Displacements and rotations of all nodes in body frames, shape (n, n_nodes, 3).
    nodes
        The beam's, first and behind the last.
    cells, lengths, angles
        Nodes of every element, shape (n_elements, 2), counted from the beam's first; lengths, m, and directions, rad,
        each of shape (n_elements,).
    longer
        How often these lengths one sample after the other has, or one for all.
    half_heights
        Of one sample after the other, or one for all, m.
    curved
        Whether strains are geometrically exact.
    """
    cos, sin = np.cos(angles), np.sin(angles)
    for k in range(local.shape[0]):
        for node in range(nodes[0], nodes[1]):
            turned = abs(local[k, node, 2])
            if turned > rotation[k] or np.isnan(turned):
                rotation[k] = turned
        half_height, stretch, strain[k] = half_heights[k % half_heights.size], longer[k % longer.size], 0.0
        for e in range(lengths.size):
            near, far, length = nodes[0] + cells[e, 0], nodes[0] + cells[e, 1], stretch * lengths[e]
            x = length * cos[e] + (local[k, far, 0] - local[k, near, 0])
            y = length * sin[e] + (local[k, far, 1] - local[k, near, 1])
            along, across = cos[e], sin[e]
            if curved:
                angle = angles[e] + 0.5 * (local[k, near, 2] + local[k, far, 2])
                along, across = np.cos(angle), np.sin(angle)
            axial = (along * x + across * y) / length - 1.0
            here = abs(axial) + half_height * abs((local[k, far, 2] - local[k, near, 2]) / length)
            if not here <= strain[k]:
                strain[k] = here
            if np.isnan(here):
                break
