"""How far a reduced run leaves what a linear reduced basis assumes; looked at in every run and every sample.

What is looked at, when, and from which size on it counts: docs/method.md, validity.

**Elastic rotation**, rad: of a node, or of a frame of a continuum body, less that of its rigid body; with what elastic
joints give way. Without terms of second order forces do not turn with it, so that a rotation phi is a share phi of what
they do: said from 2 % on. **Elastic strain**: ``|eps| + c |kappa|`` with c the distance of the outermost fibre of a
beam from its axis (`half_height`). Both are evaluated in the most deformed states only, one of every twentieth part of
the run: those with the largest strain energy, and that in which elastic joints give way most.

**Stiffness gained and lost**: the largest and the least share by which the forces in the bodies change the stiffness of
a mode (`reduction.tables.StiffnessChanges`); -1 is buckling.

What is looked at in every second step is compiled, LANES samples side by side. At the sampled configuration next to a
state, with the weights w of a sample's own parameters and packed lower triangles of the stiffness, halved on the
diagonal, the elastic energy and the shares by which the stiffness of mode k has changed are

    E = sum_ij (sum_t w_t K_t)_ij delta_i delta_j,     s_k = h_k.f / sum_t w_t psi_k.K_t psi_k,     i >= j.

What follows from place and parameters alone is kept for each sample until it comes to another place.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce
from typing import NamedTuple, Self

import numpy as np

from pgmp_petsc.base.errors import Remark, gathered, note, warning
from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.beam3d import strains_of
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.shape import length_share
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import SampleBlocks, empty_lanes
from pgmp_petsc.lanes.vectors import LANES, aligned_zeros, beyond, differing, larger, load, select, spread, store
from pgmp_petsc.mechanism.capabilities import comparing
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.models import Reduced
from pgmp_petsc.reduced.kernel import gather
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.tables import StiffnessChanges
from pgmp_petsc.results.estimates import ROTATION_LIMIT, VALIDITY, limits_of
from pgmp_petsc.results.numbers import Arrays, plain
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.stepping.second_order_system import Observer, State

EVERY = 2  # a motion that the steps resolve has ten and more a period: every second one misses its peak by 5 % at most
N_PARTS = 20  # evaluating a state costs about as much as a step of a single run, less in a batch
SHORTEST = 10  # looks of which one state is evaluated
TURNED = 0.02  # rad, beyond which a rotation is a share of what forces that do not turn with it do
LARGEST = 2**17  # displacements that are evaluated together, no more than stay in the cache
EVERYONE = (1 << LANES) - 1
NOTHING = 1e-15  # rad, or a share: what sums of numbers of the size of 1 leave of none
ROUND_OFF = 1e-9  # of an angle: so close to the middle between two places, the nearer one is found anew


class Validity(Observer):
    """The observer of a batch that keeps the largest values of every sample, one of `every` so many steps.

    The model is reduced, of one mechanism or of lanes of lengths; parameter values of the batch have shape
    (n_samples,).
    """

    every = EVERY

    def __init__(self, model: Reduced, system: ReducedSystem, values: Arrays, simulation: Simulation) -> None:
        self._model, self._system, self._values = model, system, values
        n_steps = self._n_steps = simulation.n_steps
        self._part = max(SHORTEST, -(-n_steps // (EVERY * N_PARTS)))
        n_looks = n_steps // EVERY + 1 + (n_steps % EVERY > 0)
        self._strains = BodyStrains(model.scene, model.kinematics.mechanism, values, model.terms.layout.second_order)
        n, tables = system.n_samples, model.terms.tables
        of_mass, of_stiffness = (
            np.broadcast_to(evaluate_weights(weights, values).T, (n, len(weights)))
            for weights in (tables.mass_weights, tables.stiffness_weights)
        )
        self._weights = Weights.of(of_mass, system.load_weights, of_stiffness)
        self._places = Places.of(tables.samples, tables.stiffness, model.stiffness_changes)
        self._kept = Kept.nothing(self._places, -(-n_looks // self._part), n, system.n_eta)
        self._released = tables.n_coordinates + tables.unstrained
        self._turning = _turning(model, tables.unstrained) if tables.unstrained.size else np.zeros(0)
        self._furthest, self._released_most = np.full(n, -1.0), np.zeros((n, system.n_eta))
        self._n_looks = 0
        self._deformed = {name: np.full(n, np.nan) for name in ("elastic_rotation", "elastic_strain")}

    @property
    def extremes(self) -> dict[str, np.ndarray]:
        """By the names of `VALIDITY`, each of shape (n_samples,): NaN where nothing is known, 0 where round-off is."""
        gained, lost = self._kept.shares(self._system.n_samples)
        found = self._deformed | {"stiffness_gained": gained, "stiffness_lost": lost}
        return {name: np.where(np.abs(found[name]) < NOTHING, 0.0, found[name]) for name in VALIDITY}

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        """Look at those of many states whose turn it is; see `Observer`."""
        trail = states.motion
        looked_at = np.flatnonzero((numbers % EVERY == 0) | (numbers == self._n_steps))
        # a sample that fails may overflow here before it is given up
        with np.errstate(all="ignore"):
            if looked_at.size:
                self._look(times[looked_at], trail if looked_at.size == times.size else trail[looked_at])
            if numbers[-1] == self._n_steps:
                self._strain()

    def _look(self, times: np.ndarray, trail: np.ndarray) -> None:
        """Follow the stiffness over states (n_t, 3, n, n_eta), and keep the most deformed ones."""
        # one layout, one compiled function
        loads = np.ascontiguousarray(self._system.load_amplitudes(times))
        forces = np.ascontiguousarray(self._system.action_forces(times, trail))
        look_at(self._places, self._weights, self._n_looks, self._part, loads, forces, trail, self._kept)
        self._n_looks += times.size
        if self._released.size:  # keep the states in which elastic joints give way most by a bound of rotations
            states = trail[:, 0]
            sizes = np.nan_to_num(np.abs(states[..., self._released]) @ self._turning, nan=-1.0)
            largest, each = np.argmax(sizes, axis=0), np.arange(sizes.shape[1])
            further = sizes[largest, each] > self._furthest
            self._furthest[further] = sizes[largest, each][further]
            self._released_most[further] = states[largest, each][further]

    def _strain(self) -> None:
        """Evaluate rotations and strains of the most deformed states, as many parts of the run together as fit."""
        states = self._kept.deformed(self._system.n_samples)
        if self._released.size:
            states = np.concatenate([states, self._released_most[None]])
        n_together = max(1, LARGEST // (states.shape[1] * self._model.kinematics.mechanism.n_dofs))
        for first in range(0, len(states), n_together):
            some = states[first : first + n_together]
            together = {
                name: np.tile(np.broadcast_to(own, some.shape[1]), len(some)) for name, own in self._values.items()
            }
            found = self._strains.largest(self._model.local_displacements(some.reshape(-1, states.shape[2]), together))
            for name, values in zip(self._deformed, found):
                values = np.where(np.isfinite(values), values, np.nan).reshape(some.shape[:2])
                self._deformed[name] = np.fmax(self._deformed[name], np.fmax.reduce(values, axis=0))


def _turning(model: Reduced, coordinates: np.ndarray) -> np.ndarray:
    """Return the largest rotations of nodes at any sample for a unit of some flexible coordinates, shape (n,), rad."""
    mechanism = model.kinematics.mechanism
    shapes = np.concatenate([member.rom.projection[:, :, coordinates] for member in model.members])
    moved = mechanism.by_node(np.moveaxis(shapes, 0, -1))
    return np.linalg.norm(moved[:, mechanism.space.dimension :], axis=1).max(axis=(0, 2))


class BodyStrains:
    """Elastic rotations and strains from displacements in body frames, at parameter values that are numbers or of shape
    (n,).

    `curved` tells whether displacements are of second order in the deformation, so that bending shortens a beam:
    strains are then geometrically exact, in space to second order. Without, the linear ones are what the model has.
    """

    def __init__(
        self, scene: Scene, mechanism: Mechanism, values: Mapping[str, np.ndarray | float], curved: bool
    ) -> None:
        self._curved = curved
        self._spatial = mechanism.space is SPATIAL
        self._flexible = [body for body in mechanism.bodies if body.flexible]
        self._half_heights = {
            body.name: np.reshape(np.asarray(half_height(scene, body.name, values), dtype=float), -1)
            for body in self._flexible
            if body.fibred
        }
        self._longer = {name: np.reshape(length_share(scene, name, values), -1) for name in self._half_heights}

    def largest(self, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest rotation (rad), and strain of n states, each of shape (n,); NaN where there is no beam.

        Displacements and rotations of all nodes in body frames have shape (n, n_nodes, 3), in space (n, n_nodes, 6);
        all samples are in the order of the parameter values, as often as there are states of each.
        """
        rotation, strain = np.zeros(len(local)), np.full(len(local), np.nan)
        for body in self._flexible:
            moved = local[:, body.nodes]
            turned = np.linalg.norm(moved[..., 3:], axis=2) if self._spatial else np.abs(moved[..., 2])
            rotation = np.maximum(rotation, np.max(turned, axis=1))
            if body.name in self._half_heights:
                strain = np.fmax(strain, self._of_beam(body, moved))
        return rotation, strain

    def _of_beam(self, body: Body, moved: np.ndarray) -> np.ndarray:
        """Return the largest strain of a beam from its nodes' displacements (n, n_nodes, n_dofs), shape (n,)."""
        own = self._longer[body.name], self._half_heights[body.name]
        longer, half_heights = (np.tile(each, len(moved) // each.size) for each in own)
        # samples are last: numpy sums over neighbours in memory, four times as fast
        rest = (body.rest_operator @ moved.reshape(len(moved), -1).T).reshape(-1, len(body.mesh.cells), len(moved))
        if self._spatial:
            rest[[0, 1, 2, 6, 7, 8]] /= longer  # what is over the length of an element
            strains = strains_of(rest, self._curved)
            axial, bending = strains[0], np.linalg.norm(strains[4:], axis=0)
        else:
            axial, across, turn = rest[0] / longer, rest[1] / longer, rest[2]
            if self._curved:
                axial = (1.0 + axial) * np.cos(turn) + across * np.sin(turn) - 1.0
            bending = rest[3] / longer
        return np.max(np.abs(axial) + half_heights * np.abs(bending), axis=0)


def half_height(scene: Scene, body: str, values: Mapping[str, np.ndarray | float]) -> np.ndarray | float:
    """Return the distance of a beam's outermost fibre from its axis, m.

    A section given by coefficients has none; ``2 sqrt(EI / EA)`` is that of a circle with its radius of gyration. In
    space a section bends both ways, and the distance is half its diagonal.
    """
    section = scene.bodies[body].section
    if section.reach is None:
        resists = BeamSection.of(scene, body)
        bending = reduce(np.maximum, (part.at(values) for part in resists.bending))
        return 2.0 * np.sqrt(bending / resists.axial.at(values))
    along_2, along_3 = (reach.at(values) for reach in section.reach)
    return along_2 if scene.dimension == 2 or section.round else np.hypot(along_2, along_3)


@gathered
def remarks_of(scene: Scene, validity: Mapping[str, np.ndarray | float], whose: str = "samples") -> Iterator[Remark]:
    """Return warnings of what is beyond its limit in a run or in some samples, or in what they are, and notes on what
    is not known.

    What is looked at comes by the names of `VALIDITY`, each a number or of shape (n,).
    """
    limits = limits_of(scene.second_order)
    for name, text in _beyond(scene).items():
        values = np.atleast_1d(validity[name])
        too_far = np.abs(values) > limits[name]  # NaN, where nothing is known, is not
        if too_far.any():
            some = "" if values.size == 1 else f"{int(too_far.sum())} of {values.size} {whose}: "
            worst = values[too_far][np.argmax(np.abs(values[too_far]))]
            yield warning(some + text.format(f"{worst:.2g}"))
    yield from _given_way(scene, np.atleast_1d(validity["elastic_rotation"]))
    continuum = [name for name, body in scene.bodies.items() if body.continuum and body.flexible]
    given = [name for name in continuum if scene.bodies[name].matrices is not None]
    meshed = [name for name in continuum if name not in given]
    if meshed:
        yield note(
            f"strain is not computed of continuum bodies ({', '.join(meshed)}): a stress output has the "
            "stresses of a body; rotations are those of their frames only"
        )
    if given:
        yield note(
            f"strain and change of stiffness are not computed: matrices ({', '.join(given)}) do not tell them, and "
            f"rotations are those of their frames only; {comparing(scene)}"
        )
    elif meshed and np.isnan(validity["stiffness_gained"]).all():
        yield note(
            f"change of stiffness is not computed with continuum bodies ({', '.join(meshed)}) in a model "
            "without terms of second order; take pgmp check --effects, or geometric_stiffening in the build"
        )
    beams = {name: body for name, body in scene.bodies.items() if body.flexible and body.section is not None}
    by_coefficients = [name for name, body in beams.items() if body.section.reach is None]
    if by_coefficients:
        yield note(
            f"strain of {', '.join(by_coefficients)}: sections given by coefficients have no height; that of a "
            "circle with the same EI/EA is taken"
        )


def _given_way(scene: Scene, rotations: np.ndarray) -> Iterator[Remark]:
    """Say where elastic joints turn bodies by so much that it is a share of what a model of first order has."""
    elastic = [f"joints.{name}" for name, joint in scene.joints.items() if joint.elastic is not None]
    largest = np.nanmax(rotations, initial=0.0)
    if elastic and not scene.second_order and TURNED < largest <= ROTATION_LIMIT:
        yield warning(
            f"rotations of {largest:.2g} rad with what {', '.join(elastic)} give way: a model without terms of second "
            f"order turns neither lengths nor forces by them, so that deformations, and places of what gives way, may "
            f"be off by {plain(100.0 * largest)} to {plain(300.0 * largest)} %; estimated errors have that. Take terms "
            f"of second order where bending is small (reduction.second_order), or {comparing(scene)}"
        )


def _beyond(scene: Scene) -> dict[str, str]:
    """Return what to say where a value is beyond its limit, by name."""
    full = comparing(scene)
    limits = limits_of(scene.second_order)
    rotation, strain, share = (limits[name] for name in ("elastic_rotation", "elastic_strain", "stiffness_lost"))
    elastic = [f"joints.{name}" for name, joint in scene.joints.items() if joint.gives_way]
    given = f", with what {', '.join(elastic)} give way, which is taken as small" if elastic else ""
    texts = {
        "elastic_rotation": f"elastic rotations of {{}} rad{given}, beyond {rotation}: linear strains are wrong by "
        f"more than 1 %; {full}",
        "elastic_strain": f"elastic strains of {{}}, beyond {strain}: few materials are linear there; {full}",
    }
    if scene.second_order:
        texts["stiffness_lost"] = (
            f"forces in the bodies change the stiffness of a mode by {{}} times itself, beyond {share}: close to "
            "buckling or beyond it (-1), where geometric_stiffening, of first order in these forces, does not hold; "
            f"{full}"
        )
        return texts
    cure = f"name it in [effects], with mode_inertia, and build again, or {full}"
    what = "geometric_stiffening, which the model leaves out, changes the stiffness of a mode by {} times itself"
    texts["stiffness_gained"] = f"{what}: {cure}"
    texts["stiffness_lost"] = f"{what} (-1 is buckling): {cure}"
    return texts


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
            more = beyond(energy, load(largest, 0)) & ~differing(energy, energy)
            if more:
                store(largest, 0, select(more, energy, load(largest, 0)))
                for i in range(n_eta):
                    store(states, part * n_eta + i, select(more, load(q, i), load(states, part * n_eta + i)))
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
        moved |= beyond(load(ends, 2 * axis), theta) | beyond(theta, load(ends, 2 * axis + 1))
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
        store(largest, 1, select(finite & beyond(share, gained), larger(share, none), gained))
        store(largest, 2, select(finite & beyond(lost, share), select(beyond(share, none), none, share), lost))
