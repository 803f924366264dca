"""The reduced model as a second-order system for the integrator; a batch of samples with their own parameters.

What acts on reduced models over time: amplitudes of loads and of local effects, and prescribed motions.

The samples of a reduced batch as they lie in lanes, with all that the compiled equations take and keep of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from pgmp_petsc.base.surroundings import alone
from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.controllers.acting import NOTED, given_to
from pgmp_petsc.controllers.running import AFTER, MOST_STARTS, Controls
from pgmp_petsc.effects import Effect, Motion
from pgmp_petsc.effects.action import Action, amplitudes_over
from pgmp_petsc.full.part_reference import Reference
from pgmp_petsc.lanes.lane_items import aligned
from pgmp_petsc.lanes.vectors import LANES, N_POWERS, N_POWERS_OF_RIGID, aligned_zeros, same_in_all_lanes
from pgmp_petsc.reduced.action_frames import KeptPlaces
from pgmp_petsc.reduced.action_kernel import ABOUT, FORCE, POWER, STORED, Acting
from pgmp_petsc.reduced.actions import ReducedActions, functions_of_time
from pgmp_petsc.reduced.arrays import Equations, Matrix, Memory, Strengths, Weights
from pgmp_petsc.reduced.control import LARGE, Control
from pgmp_petsc.reduced.energy import damping_power, load_powers, reduced_energy
from pgmp_petsc.reduced.kernel import act_on, correct, evaluate_residual, fill_matrices
from pgmp_petsc.reduced.steps import Progress, advance
from pgmp_petsc.reduced.terms import ReducedTerms
from pgmp_petsc.stepping.energies import Energies
from pgmp_petsc.stepping.sample_blocks import SampleBlocks
from pgmp_petsc.stepping.second_order_system import Observer, Scheme, SecondOrderSystem, Settled, State, Stretch
from pgmp_petsc.stepping.status import Status


class ReducedLanes:
    """Samples in blocks of LANES, in an order that may change; no sample's numbers depend on its lane.

    Parameters
    ----------
    terms, actions
        Interpolated terms of the equations of motion, and local effects.
    effects
        Names of the effects with loads, each once.
    values
        Parameter values of the samples, each of shape (n_samples,).
    prescribed
        Whether a coordinate's motion is given, shape (n_eta,).
    n_samples
        Number of samples.

    Attributes
    ----------
    equations, memory
        What the kernels take, and what they keep of every block.
    load_weights, place_weights
        Weights of the load terms, shape (n_load_terms, n_samples), and of the terms of the places of actions.
    """

    def __init__(
        self,
        terms: ReducedTerms,
        actions: ReducedActions,
        effects: Sequence[str],
        values: Mapping[str, np.ndarray],
        prescribed: np.ndarray,
        n_samples: int,
    ) -> None:
        self._blocks = SampleBlocks(n_samples, LANES, -(-n_samples // LANES))
        self._term_weights, self.load_weights, self.place_weights = (
            np.broadcast_to(evaluate_weights(w, values).T, (n_samples, len(w))).T
            for w in (terms.weights, terms.tables.load_weights, actions.weights)
        )
        self.equations = Equations(
            terms.layout,
            terms.grid,
            terms.polynomials,
            Weights(
                self.packed(self._term_weights),
                self.packed(self.load_weights),
                np.array([effects.index(name) for name in terms.tables.load_effects], dtype=np.int64),
                np.zeros(len(terms.weights), dtype=np.int64),
            ),
            actions.of_samples(values, n_samples),
            0.0 if terms.damping is None else terms.damping.mass,
            prescribed,
            terms.scale,
        )
        self.memory = self._allocate(len(effects), len(actions.actions), len(actions.edges))

    def _allocate(self, n_effects: int, n_actions: int, n_edges: int) -> Memory:
        """Return what is kept of every block, empty."""
        layout, n_blocks = self.equations.layout, self._blocks.n_blocks
        r, m = len(layout.rigid), layout.n_eta - len(layout.rigid)
        n_powers = N_POWERS**r
        shapes = (m * (m + 1) // 2, r * r, r * m, r * m, m * (m + 1) // 2 if layout.second_order else 0)
        local, n_acting = self.equations.local.places, n_blocks if n_actions else 0
        cells, local_cells = aligned_zeros((n_blocks, LANES)), aligned_zeros((n_acting, 2, LANES))
        cells[:] = local_cells[:] = -1.0
        return Memory(
            self._blocks.samples,
            cells,
            aligned_zeros((n_blocks, layout.n_rigid * N_POWERS_OF_RIGID**r, LANES)),
            aligned_zeros((n_blocks, layout.end * n_powers, LANES)),
            aligned_zeros((n_blocks, n_effects * layout.load_end * n_powers, LANES)),
            Matrix(*(aligned_zeros((n_blocks, n, LANES)) for n in shapes)),
            KeptPlaces(
                local_cells,
                self.packed(self.place_weights)[:n_acting],
                *(aligned_zeros((n_acting, table.shape[2], LANES)) for table in (local.rigid, local.shapes)),
            ),
            Acting.empty(n_acting, layout.n_eta),
            np.empty((self._blocks.n_samples, ABOUT + 1, n_actions)),
            np.empty((self._blocks.n_samples, n_edges)),
        )

    def nothing_acting(self) -> Acting:
        """Return what local effects add where there are none."""
        return Acting.empty(self._blocks.n_blocks, self.equations.layout.n_eta)

    def zeros(self, dtype: type = float) -> np.ndarray:
        """Return a zero for every lane, aligned, shape (n_blocks, LANES)."""
        return aligned_zeros((self._blocks.n_blocks, LANES)).view(dtype)

    def packed(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (n, n_samples) as vectors, aligned, (n_blocks, n, LANES)."""
        blocks = aligned_zeros((self._blocks.n_blocks, len(rows), LANES))
        blocks[:] = self._blocks.pack(rows)
        return blocks

    def packed_over(self, rows: np.ndarray) -> np.ndarray:
        """Return rows at several instants, of all samples together or of each, (n_t, 1 or n_samples, n), as vectors,
        aligned, (n_t, n_blocks, n, LANES)."""
        found, by_rows = aligned((len(rows), self._blocks.n_blocks, rows.shape[2], LANES)), np.swapaxes(rows, 1, 2)
        found[:] = by_rows[:, None] if rows.shape[1] == 1 else self._blocks.pack(by_rows, 1)
        return found

    def unpacked(self, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (n_blocks, ..., LANES) by samples, shape (..., n_samples)."""
        return self._blocks.unpack(vectors)

    def sets(self, samples: np.ndarray) -> np.ndarray:
        """Return some samples, a mask, as sets of lanes, shape (n_blocks,)."""
        return self._blocks.mask(samples) @ (1 << np.arange(LANES))

    def regroup(self, q: np.ndarray, samples: np.ndarray) -> None:
        """Put samples that are near each other in the tables side by side, and those that are not to advance last.

        Lanes that enter a cell together are filled at once.

        Parameters
        ----------
        q
            Coordinates of all samples, shape (n_samples, n_eta).
        samples
            Mask of those to advance.
        """
        if self._blocks.n_blocks == 1:
            return
        number = np.zeros(len(q))
        with np.errstate(invalid="ignore"):
            for theta, axis in zip(q.T, self.equations.grid):
                place = (theta - axis.lower) / axis.step
                number = np.floor(number) * axis.n_cells + (place % axis.n_cells if axis.periodic else place)
        blocks = self._blocks.ordered(np.argsort(np.where(samples, number, np.inf), kind="stable"))
        memory, weights, of_lanes = self.memory, self.equations.weights, blocks.samples
        moved = of_lanes != memory.samples
        if moved.any():
            self._blocks = blocks
            memory.samples[:], memory.cells[moved] = of_lanes, -1.0
            np.moveaxis(memory.places.cells, 1, -1)[moved[: len(memory.places.cells)]] = -1.0
            weights.terms[:], weights.loads[:] = blocks.pack(self._term_weights), blocks.pack(self.load_weights)
            memory.places.weights[:] = blocks.pack(self.place_weights)[: len(memory.places.weights)]

    def matrices(self) -> np.ndarray:
        """Return the iteration matrices without their skew part, shape (n_samples, n_eta, n_eta)."""
        r, n = len(self.equations.layout.rigid), self.equations.layout.n_eta
        factor, corner, column, row = (self.unpacked(part).T for part in self.memory.matrix[:4])
        result = np.empty((len(factor), n, n))
        rows, columns = np.tril_indices(n - r)
        result[:, r + rows, r + columns] = result[:, r + columns, r + rows] = factor
        result[:, :r, :r] = corner.reshape(-1, r, r)
        result[:, r:, :r] = np.swapaxes(column.reshape(-1, r, n - r), 1, 2)
        result[:, :r, r:] = row.reshape(-1, r, n - r)
        return result


LARGEST = 2**19  # numbers that are written down, of all samples and steps
FURTHEST = 2**21  # numbers of all samples and steps: in more of them samples that began side by side drift apart
NO_LOADS = aligned((0, 0, 0, LANES))
STARTING_CORRECTIONS = 4  # one where stiffness does not change with the deformation


class ReducedTrail(State):
    """Room for states as they lie side by side, shape (n_t, 3, n_samples, n_eta)."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.whole = np.empty((shape[0], 3, *shape[1:]))
        super().__init__(*np.moveaxis(self.whole, 1, 0), np.zeros((shape[0], 0)), np.zeros((shape[0], 0)))


class ReducedSystem(SecondOrderSystem):
    """A batch of samples of the reduced model, on one rank.

    Parameters
    ----------
    terms
        Interpolated terms of the equations of motion.
    effects
        Effects of the scene; they give the loads' amplitudes over time.
    values
        Parameter values of the samples, each of shape (n_samples,).
    initial
        Positions (rad) and velocities (rad/s) of the rigid coordinates at the start, each a number or of shape
        (n_theta,).
    n_samples
        Number of samples.
    motions
        Of the prescribed coordinates, by their numbers.
    actions
        Local effects, if there are any.
    given
        Values of the coordinates that are given and do not move, the last ones, shape (n_given, n_samples).
    """

    steps_at_once, has_range = 2**31, True  # steps each by itself
    precise = False  # see `steps.Progress`

    def __init__(
        self,
        terms: ReducedTerms,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[np.ndarray | float, np.ndarray | float],
        n_samples: int,
        motions: Mapping[int, Motion] = MappingProxyType({}),
        actions: ReducedActions | None = None,
        given: np.ndarray | None = None,
    ) -> None:
        tables, layout = terms.tables, terms.layout
        self.tables = tables
        self.comm, self.n_samples = alone(), n_samples
        self._initial = initial
        self._terms, self._motions = terms, motions
        self.values = values
        by_name = {effect.name: effect for effect in effects}
        self._load_effects = [by_name[name] for name in dict.fromkeys(tables.load_effects)]
        names = [effect.name for effect in self._load_effects]
        self._actions = actions or ReducedActions.none(len(layout.rigid))
        self.built_in = given if tables.n_given else None
        self._begun: tuple[np.ndarray, np.ndarray] | None = None
        self._prescribed = tables.prescribed(motions)
        self._is_rigid = np.arange(self.n_eta) < tables.n_coordinates
        self._lanes = ReducedLanes(terms, self._actions, names, values, self._prescribed, n_samples)
        self._equations, self._memory = self._lanes.equations, self._lanes.memory
        self._passed = Reference(self._equations), Reference(self._memory)
        bounds = [(-np.inf, np.inf) if axis.periodic else (axis.lower, axis.upper) for axis in tables.samples]
        self._bounds = np.array(bounds, dtype=float)
        self._strengths = ReducedStrengths(
            self._load_effects, self._actions.actions, motions, self.tables.n_coordinates
        )
        self.controlled = given_to(self._actions.actions)
        self._led = []  # of these, the first of each force
        self._control = Control.of(None, [], np.zeros(0), self._actions, n_samples)
        self.n_events = self._memory.depths.shape[1]
        searched = (self._load_effects, self._actions.actions, motions) if self.n_events else ((), (), {})
        self._functions = functions_of_time(*searched, self.tables.n_coordinates)

    def control(self, controls: Controls, origins: np.ndarray | None) -> None:
        """Let controllers act; `origins` are what counts as zero of each motion that they measure, a row for each part
        of their forces, where actions measure all of them, and None elsewhere."""
        self.beside, self.carries = controls, origins is not None
        self._led = [self.controlled[first] for first in controls.firsts]
        if self.carries:
            self._control = Control.of(controls, self.controlled, origins, self._actions, self.n_samples)
        self._no_amplitudes = self._lanes.packed_over(np.zeros((1, 1, len(self._actions.actions))))

    def put_forces(self, forces: Sequence[np.ndarray]) -> None:
        """Take what is given to each action; see `Controls`."""
        for column, given in zip(self.controlled, forces):
            self._equations.local.actions.parameters[column, :, : given.shape[1]] = given

    def forces_beside(self, times: np.ndarray) -> np.ndarray:
        """Return what is given at times that are seen, of controllers what they hold from there on, (n_t, n_samples,
        n_names)."""
        return self.beside.forces(times, AFTER)

    def measured(self, state: State) -> np.ndarray:
        """Return the motions that forces of controllers are of, or are led by, and their rates, a row for each part of
        what is given, (n_rows, n_samples, 2)."""
        kept, n_actions = self._memory.known.copy(), len(self._actions.actions)
        everyone, found = np.ones(self.n_samples, dtype=bool), np.empty((1, self.n_samples, 3, n_actions))
        trail = np.array([[state.q, state.v]])
        act_on(
            *self._passed, self._no_amplitudes, trail, self._lanes.sets(everyone), 0.0, np.bool_(False), found, NO_LOADS
        )
        self._memory.known[:] = kept  # with what laws that are limited keep for the next iterate
        return self._equations.local.actions.parameters[self.controlled, :, NOTED]

    @property
    def n_eta(self) -> int:
        """Number of reduced coordinates."""
        return self.tables.n_coordinates + self.tables.n_modes

    @property
    def n_moving(self) -> int:
        """Number of these but for the given ones."""
        return self.n_eta - self.tables.n_given

    def undeformed(self, theta: np.ndarray) -> np.ndarray:
        """Return coordinates (n_samples, n_eta) without deformation but what is given, at theta, (n_samples, n_theta)
        or the same for all."""
        q = np.zeros((self.n_samples, self.n_eta))
        q[:, : self.tables.n_coordinates] = theta
        if self.built_in is not None:
            q[:, self.n_moving :] = self.built_in.T
        return q

    def start(self) -> State:
        """Return the start, undeformed or settled, with the accelerations that the equations of motion give."""
        r = self.tables.n_coordinates
        q = self.undeformed(self._initial[0])
        v = np.zeros_like(q)
        if self._begun is not None:
            q, v = (part.copy() for part in self._begun)
        elif self.settled is None:
            if self.built_in is not None:
                self._answer_offsets(q)
            v[:, :r] = self._initial[1]
        else:
            q[:] = self.settled.unknowns.T
        state = State(q, v, np.zeros_like(q), np.zeros(0))
        if self.beside is not None:
            self.beside.start(state)
        everyone = np.ones(self.n_samples, dtype=bool)
        self.accelerate(0.0, state, everyone)
        for _ in range(MOST_STARTS if self.beside is not None else 0):
            if not self.beside.settle(state):
                break
            self.accelerate(0.0, state, everyone)
        return state if self.settled is None else self.settled.at_rest(state, len(self._motions))

    def accelerate(self, time: float, state: State, samples: np.ndarray) -> None:
        """Give samples their accelerations; see `SecondOrderSystem`."""
        # they enter linearly: with stiffness negligible in the matrix, a correction solves M a = -r
        trial = state.copy()
        trial.a[:] = 0.0
        self.correct(time, trial, Scheme(0.0, 0.0, 0.0, 0.0, gain_v=0.0, gain_a=LARGE), samples, fresh=True)
        state.a[samples] = trial.a[samples]
        self._strengths.prescribe(time, state, samples)

    def _answer_offsets(self, q: np.ndarray) -> None:
        """Give the flexible coordinates of q what they add to the static answer to offsets, without loads, in place:
        nothing at the nominal parameters, in the terms of first order."""
        state, everyone = State(q, *np.zeros((2, *q.shape)), np.zeros(0)), np.ones(self.n_samples, dtype=bool)
        for _ in range(STARTING_CORRECTIONS):
            self.correct_at_rest(state, np.zeros_like(q), everyone, 0.0, LARGE)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        self._strengths.prescribe(time, state, active)
        self._act(time, state, scheme.gain_v, active, fresh)
        return self._correct(*self._passed, self._strengths.at(time), state, scheme, active, fresh)

    def begin_iteration(self) -> None:
        """Forget at which rates laws were evaluated; see `AlphaStep`."""
        self._memory.known[:, ABOUT] = np.nan

    def limited(self) -> np.ndarray:
        """Return the samples of which a law was limited in the last correction."""
        return np.isnan(self._memory.known[:, ABOUT]).any(axis=1)

    def _correct(
        self, equations: Reference, memory: Reference, strengths: Strengths, state: State, scheme: Scheme,
        active: np.ndarray, fresh: bool,
    ) -> np.ndarray:  # fmt: skip
        """Do one Newton correction of some samples in place; return its size."""
        size, gains = self._lanes.zeros(), (scheme.gain_v, scheme.gain_a)
        correct(equations, memory, strengths, _parts(state), gains, self._lanes.sets(active), np.bool_(fresh), size)
        return self._lanes.unpacked(size).copy()

    def begin_at(self, q: np.ndarray, v: np.ndarray) -> None:
        """Let the samples start from coordinates and velocities (n_samples, n_eta)."""
        self._begun = q, v

    def settle(self, settled: Settled) -> None:
        """Let the samples start at rest in static equilibria."""
        self.settled = settled

    def correct_at_rest(
        self, state: State, force: np.ndarray, active: np.ndarray, share: float, longest: float
    ) -> np.ndarray:
        """Do one Newton correction of the flexible coordinates at rest, under the loads at time zero, in place.

        Parameters
        ----------
        state
            At rest.
        force
            What else is in balance with the residual, shape (n_samples, n_eta): ``r + force = 0``.
        active
            Samples to correct, shape (n_samples,).
        share
            What part of the loads and local effects acts.
        longest
            Longer corrections are shortened to it, in units of the mechanism's size or of 1 rad.

        Returns
        -------
        ndarray, shape (n_samples,)
            Size of the correction before it was shortened.
        """
        before, memory, at_start = state.q.copy(), self._memory, self._strengths.at(0.0)
        at_start.loads[:] *= share
        acting = self._lanes.nothing_acting()
        if self._actions.actions:
            self._act(0.0, state, 0.0, active, True)
            acting.balance[:], acting.tangent[:] = share * memory.acting.balance, share * memory.acting.tangent
        acting.balance[:] += self._lanes.packed(force.T)
        size = self._correct(
            Reference(self._equations._replace(prescribed=self._prescribed | self._is_rigid)),
            Reference(memory._replace(acting=acting)),
            at_start,
            state,
            Scheme(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            active,
            True,
        )
        shortened = np.where(size > longest, longest / np.maximum(size, longest), 1.0)
        state.q[:] = np.where(shortened[:, None] < 1.0, before + shortened[:, None] * (state.q - before), state.q)
        return size

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the kinetic energy of the samples in a state, shape (n_samples,), J."""
        return reduced_energy(self._terms, self.values, q, v)[0]

    def strain_energy(self, q: np.ndarray) -> np.ndarray:
        """Return the strain energy of the samples at positions (n_samples, n_eta), shape (n_samples,), J."""
        return reduced_energy(self._terms, self.values, q, np.zeros_like(q))[1]

    def residual(self, time: float, state: State) -> np.ndarray:
        """Return the residual of the equations of motion, shape (n_samples, n_eta).

        In the rows of prescribed coordinates it is the force (N m) that drives them.
        """
        return self.residuals_at(np.full(self.n_samples, time), state)

    def residuals_at(self, times: np.ndarray, state: State) -> np.ndarray:
        """Return the residuals of samples that are each at a time of its own, (n_samples,), s; see `residual`."""
        everyone, strengths = np.ones(self.n_samples, dtype=bool), self._strengths.over(times)
        self._known(times[:1], np.array([[state.q, state.v]]), everyone, amplitudes=strengths.actions[None])
        result = np.empty_like(state.q)
        evaluate_residual(*self._passed, self._lanes.packed(strengths.loads.T), _parts(state), result)
        return result

    def node_loads(self, times: np.ndarray, state: State) -> np.ndarray:
        """Return what local effects do to displacements and rotations of their nodes in body frames, on samples that
        are each at a time of its own, (n_samples, n_nodes * n_dofs)."""
        d, n_blocks = self._actions.dimension, len(self._memory.samples)
        loads = aligned((n_blocks, self._actions.places.n_nodes, d * (d + 1) // 2, LANES))
        amplitudes = amplitudes_over(self._actions.actions, times)[None]
        self._known(times[:1], np.array([[state.q, state.v]]), amplitudes=amplitudes, loads=loads)
        return self._lanes.unpacked(loads).reshape(-1, self.n_samples).T

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed, shape (n_events, n_samples)."""
        self._act_on_all(time, state)
        return self._memory.depths.T.copy()

    def energies(self, time: float, state: State) -> Energies:
        """Return energies and powers at an instant, from the same tables as the equations of motion."""
        return self.energies_over(np.array([time]), np.array([[state.q, state.v, state.a]]))

    def energies_over(self, times: np.ndarray, trail: np.ndarray) -> Energies:
        """Return energies and powers at times (n_t,), in states of shape (n_t, 3, n_samples, n_eta): of all samples at
        one time after the other, each of shape (n_t * n_samples,)."""
        n, residual = times.size * self.n_samples, self._residuals(times, trail)
        known = self._known(times, trail).reshape(n, 3, len(self._actions.actions))
        values = {name: np.tile(value, times.size) for name, value in self.values.items()}
        *parts, residual = (part.reshape(n, -1) for part in (*np.moveaxis(trail, 1, 0), residual))
        return self._energies(values, np.repeat(times, self.n_samples), State(*parts, np.zeros(0)), residual, known)

    def energies_of_run(self, times: np.ndarray, states: State) -> Energies:
        """Return energies and powers of a system of one sample at several instants, each a row of the states."""
        values = {name: value[0] for name, value in self.values.items()}
        trail = np.stack([states.q, states.v, states.a], axis=1)[:, :, None]
        residual, known = self._residuals(times, trail)[:, 0], self._known(times, trail)[:, 0]
        return self._energies(values, times, states, residual, known)

    def _residuals(self, times: np.ndarray, trail: np.ndarray) -> np.ndarray:
        """Return the residuals at times (n_t,), shape (n_t, n_samples, n_eta); zeros if no coordinate is prescribed."""
        found = np.zeros_like(trail[:, 0])
        for k, time in enumerate(times if self._motions else ()):
            found[k] = self.residual(float(time), State(*trail[k], np.zeros(0)))
        return found

    def _energies(
        self, values: Mapping[str, Any], times: np.ndarray, state: State, residual: np.ndarray, known: np.ndarray
    ) -> Energies:
        energies = Energies(*reduced_energy(self._terms, values, state.q, state.v))
        for action, power, stored in zip(self._actions.actions, known[:, POWER].T, known[:, STORED].T):
            energies.add_power(action.effect, power)
            energies.add_potential(action.effect, stored)
        loads = load_powers(self._terms, values, state.q, state.v) if self._load_effects else {}
        for effect in self._load_effects:
            energies.add_power(effect.name, effect.amplitude(times) * loads[effect.name])
        if self._terms.damping is not None:
            power = damping_power(self._terms, values, state.q, state.v)
            energies.add_power(self._terms.damping.effect, power - 2.0 * self._terms.damping.mass * energies.kinetic)
        for k, motion in self._motions.items():
            energies.add_power(motion.name, residual[:, k] * state.v[:, k])
        return energies

    @property
    def load_weights(self) -> np.ndarray:
        """Weight of every load term, shape (n_samples, n_load_terms)."""
        return self._lanes.load_weights.T

    def load_amplitudes(self, times: np.ndarray) -> np.ndarray:
        """Return the amplitude of every load term at times (n_t,), without its weight, shape (n_t, n_load_terms)."""
        return self._strengths.over(times).loads[:, self._equations.weights.effects]

    def action_forces(self, times: np.ndarray, trail: np.ndarray) -> np.ndarray:
        """Return the force (N or N m) of every action at times (n_t,), in states of shape (n_t, 3, n_samples, n_eta).

        With the weight of every term of the actions' places, shape (n_t, n_samples, n_actions * n_terms).
        """
        if not self._actions.actions:
            return np.empty((times.size, self.n_samples, 0))
        forces = self._known(times, trail)[:, :, FORCE]
        weighted = forces[..., None] * self._lanes.place_weights.T[:, None]
        return weighted.reshape(*forces.shape[:2], forces.shape[2] * weighted.shape[3])

    def advance(self, stretch: Stretch) -> tuple[np.ndarray, np.ndarray]:
        """Take some samples through equal steps, each by itself, over edges of laws too; see `SecondOrderSystem`."""
        moment, scheme = stretch.moment, stretch.scheme
        self._lanes.regroup(moment.state.q, stretch.samples)
        progress = Progress(
            self._lanes.zeros(np.int64),
            self._lanes.zeros(np.int64),
            np.zeros(1, dtype=np.int64),
            np.ascontiguousarray(stretch.beyond.T),
            stretch.shown,
            stretch.trail.whole,
            self.precise,
        )
        beside = moment.state.beside if self.carries else np.empty((self.n_samples, 0))
        state = (*_parts(moment.state), moment.auxiliary, moment.before, moment.contraction[:, None], beside)
        control = self._control
        if self.carries:
            control = control.over_steps(self.beside, stretch.ends, stretch.goes_on, stretch.trail.forces)
        advance(
            *self._passed, self._strengths.over(stretch.ends), self._functions,
            (scheme.alpha_m, scheme.alpha_f, scheme.beta, scheme.gamma), (stretch.first, stretch.ends, stretch.step),
            state, self._bounds, self._lanes.sets(stretch.samples), progress, Reference(control),
        )  # fmt: skip
        if self.carries:
            self.beside.take(moment.state)
            self.beside.put_nothing()
        stretch.beyond[:] = progress.beyond.T
        stretch.counted[0] += progress.n_corrections.sum()
        return self._lanes.unpacked(progress.outcome), self._lanes.unpacked(progress.n_steps)

    def trail(self, state: State, n: int) -> ReducedTrail:
        """Return room for n states."""
        return ReducedTrail((n, *state.q.shape))

    def show(self, observer: Observer, numbers: np.ndarray, times: np.ndarray, trail: ReducedTrail) -> None:
        """Show the states after some steps to an observer."""
        observer.over(numbers, times, trail.whole)

    def steps_between_looks(self, every: int | None) -> int:
        """Return how many steps make one of PETSc's TS where it does not look; see `SecondOrderSystem`.

        Few samples go further at once; of many, what is written down is to stay in the cache.
        """
        largest = FURTHEST if every is None else min(LARGEST * every, FURTHEST)
        return max(1, largest // (3 * self.n_samples * self.n_eta))

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        for now, before in zip(_parts(state), _parts(previous)):
            now[samples] = before[samples]

    def restore_all(self, trail: State, states: State, samples: np.ndarray) -> None:
        """Put samples in all instants of a trail to what they are in other states."""
        for now, before in zip(_parts(trail), _parts(states)):
            now[:, samples] = before[:, samples]

    def outside(self, state: State) -> np.ndarray:
        """Return the samples whose rigid coordinates left the sampled range."""
        return ~self.tables.samples.contains(state.q[:, : self.tables.n_coordinates])

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why samples fail; see `SecondOrderSystem.reasons`.

        The model itself has broken down where the energy of its terms of first and second order in the deformation is
        no longer positive: where the inertia about the rigid motion, or with terms of second order the stiffness, is
        not positive definite.
        """
        finite = np.isfinite(state.q).all(axis=1) & np.isfinite(state.v).all(axis=1) & np.isfinite(state.a).all(axis=1)
        reasons = np.where(finite, Status.NOT_CONVERGED, Status.NOT_FINITE)
        stiffness, inertia = self.stiffness_and_inertia(time, state)
        r, n = self.tables.n_coordinates, self.n_moving
        for sample in np.flatnonzero(finite & samples):
            blocks = inertia[sample, :n, :n], stiffness[sample, r:n, r:n]
            lowest = [np.linalg.eigvalsh(matrix)[0] for matrix in blocks]
            if not min(lowest) > 0.0:
                reasons[sample] = Status.BROKE_DOWN
        return reasons[samples]

    def stiffness_and_inertia(self, time: float, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return the residual's derivatives with positions and with accelerations, each (n_samples, n_eta, n_eta)."""
        self._act(time, state, 0.0, np.ones(self.n_samples, dtype=bool), True)
        stiffness, both = (self._tangents(time, state, gain_a) for gain_a in (0.0, 1.0))
        return stiffness, both - stiffness

    def _tangents(self, time: float, state: State, gain_a: float) -> np.ndarray:
        """Return the iteration matrices with a given gain of the accelerations, shape (n_samples, n_eta, n_eta)."""
        fill_matrices(*self._passed, self._strengths.at(time), _parts(state), gain_a)
        return self._lanes.matrices()

    def _act(self, time: float, state: State, gain_v: float, active: np.ndarray, with_tangent: bool) -> None:
        """Evaluate the actions on the active samples, and what is known of them beside their forces."""
        if self._actions.actions:
            self._known(np.array([time]), np.array([[state.q, state.v]]), active, gain_v, with_tangent)

    def _known(
        self, times: np.ndarray, trail: np.ndarray, active: np.ndarray | None = None, gain_v: float = 0.0,
        with_tangent: bool = False, amplitudes: np.ndarray | None = None, loads: np.ndarray = NO_LOADS,
    ) -> np.ndarray:  # fmt: skip
        """Evaluate the actions on active samples, or on all, at times (n_t,); return what is known of them, (n_t,
        n_samples, 3, n_actions), as of `act`. Amplitudes are those of the times, or given, (n_t, 1 or n_samples,
        n_actions); `loads` are filled where there are any."""
        lanes = self._lanes.sets(np.ones(self.n_samples, dtype=bool) if active is None else active)
        actions = self._actions.actions
        found = np.zeros((times.size, self.n_samples, 3, len(actions)))
        if found.size:
            given = amplitudes_over(actions, times)[:, None] if amplitudes is None else amplitudes
            if self.beside is not None and not self.beside.iterates:
                given = np.repeat(given, self.n_samples // given.shape[1], axis=1)
                given[:, :, self._led] += self.beside.forces(times)
            act_on(
                *self._passed, self._lanes.packed_over(given), np.ascontiguousarray(trail), lanes, gain_v,
                np.bool_(with_tangent), found, loads,
            )  # fmt: skip
        return found

    def _act_on_all(self, time: float, state: State) -> None:
        self._act(time, state, 0.0, np.ones(self.n_samples, dtype=bool), False)


def _parts(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, velocities and accelerations."""
    return state.q, state.v, state.a


class ReducedStrengths:
    """Strengths that are the same for all samples of a batch.

    Parameters
    ----------
    load_effects
        Effects with loads, in the order of the tables.
    actions
        Local effects.
    motions
        Of the prescribed coordinates, by their numbers.
    n_coordinates
        Number of rigid coordinates.
    """

    def __init__(
        self,
        load_effects: Sequence[Effect],
        actions: Sequence[Action],
        motions: Mapping[int, Motion],
        n_coordinates: int,
    ) -> None:
        self._load_effects, self._actions, self._motions = load_effects, actions, motions
        self._n_motions = 3 * n_coordinates if motions else 0

    def at(self, time: float) -> Strengths:
        """Return what acts on every lane at an instant (s)."""
        return Strengths(*(same_in_all_lanes(part[0]) for part in self.over(np.array([time]))))

    def over(self, times: np.ndarray) -> Strengths:
        """Return what acts at several instants (n_t,), s, one a row."""
        loads = np.empty((times.size, len(self._load_effects)))
        for column, effect in zip(loads.T, self._load_effects):
            column[:] = effect.amplitude(times)
        motions = np.zeros((times.size, self._n_motions))
        for k, motion in self._motions.items():
            motions[:, 3 * k : 3 * k + 3] = np.transpose(motion.at(times))
        return Strengths(loads, amplitudes_over(self._actions, times), motions)

    def prescribe(self, time: float, state: State, samples: np.ndarray) -> None:
        """Put the prescribed coordinates of some samples (a mask) where they are at a time (s)."""
        for k, motion in self._motions.items():
            state.q[samples, k], state.v[samples, k], state.a[samples, k] = motion.at(time)
