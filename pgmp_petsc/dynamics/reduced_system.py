"""The reduced model as a second-order system for the integrator; a batch of samples with their own parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from mpi4py import MPI

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.dynamics.action_kernel import DEPTH, FORCE, POWER, STORED, Acting, evaluate_local
from pgmp_petsc.dynamics.cells import Cache
from pgmp_petsc.dynamics.energies import Energies
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.dynamics.lanes import LANES, aligned_zeros
from pgmp_petsc.dynamics.reduced_actions import ReducedActions
from pgmp_petsc.dynamics.reduced_energy import damping_power, load_powers, reduced_energy
from pgmp_petsc.dynamics.reduced_kernel import Equations, Weights, correct, evaluate_residual, fill_tangents
from pgmp_petsc.dynamics.reduced_terms import ReducedTerms
from pgmp_petsc.dynamics.static_equilibrium import Settled
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.effects import Effect, Motion
from pgmp_petsc.effects.action import amplitudes_of

LARGE = 1e30  # gain that makes stiffness negligible beside mass in the iteration matrix


class ReducedSystem:
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
    """

    comm = MPI.COMM_SELF

    def __init__(
        self,
        terms: ReducedTerms,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[np.ndarray | float, np.ndarray | float],
        n_samples: int,
        motions: Mapping[int, Motion] = MappingProxyType({}),
        actions: ReducedActions | None = None,
    ) -> None:
        tables, layout = terms.tables, terms.layout
        self.tables = tables
        self.n_samples = n_samples
        self.settled: Settled | None = None
        self._initial = initial
        self._terms, self._motions = terms, motions
        self._values = values
        by_name = {effect.name: effect for effect in effects}
        self._load_effects = [by_name[name] for name in dict.fromkeys(tables.load_effects)]
        names = [effect.name for effect in self._load_effects]
        of_terms, of_loads = (
            np.ascontiguousarray(np.broadcast_to(evaluate_weights(w, values).T, (n_samples, len(w))))
            for w in (terms.weights, tables.load_weights)
        )
        effects_of_loads = np.array([names.index(name) for name in tables.load_effects], dtype=np.int64)
        r = len(layout.rigid)
        self._actions = actions or ReducedActions.none(r)
        self._grids = terms.grids
        alpha = 0.0 if terms.damping is None else terms.damping.mass
        self._equations = Equations(
            layout,
            *self._grids,
            terms.polynomials,
            Weights(of_terms, of_loads, effects_of_loads),
            np.full(n_samples if alpha else 0, alpha),
            np.array([k in self._motions for k in layout.rigid]),
            terms.scale,
        )
        n_blocks, n_delta = -(-n_samples // LANES), layout.n_eta - r
        self._factors = (
            aligned_zeros((n_blocks, n_delta * (n_delta + 1) // 2, LANES)),
            aligned_zeros((n_blocks, r * r + 2 * r * n_delta, LANES)),
        )
        self._local = self._actions.of_samples(values, n_samples)
        n_actions = len(self._actions.actions)
        self._acting = Acting.empty(n_blocks if n_actions else 0, layout.n_eta)
        self._known = np.empty((n_samples, 4, n_actions))
        self._cache = Cache.empty(n_blocks, layout.end, len(names) * layout.load_end, r)
        self._size = np.empty(n_samples)

    @property
    def n_eta(self) -> int:
        """Number of reduced coordinates."""
        return self.tables.n_coordinates + self.tables.n_modes

    def start(self) -> State:
        """Return the start, undeformed or settled, with the accelerations that the equations of motion give."""
        r = self.tables.n_coordinates
        q = np.zeros((self.n_samples, self.n_eta))
        v = np.zeros_like(q)
        if self.settled is None:
            q[:, :r], v[:, :r] = self._initial
        else:
            q[:] = self.settled.unknowns.T
        state = State(q, v, np.zeros_like(q), np.zeros(0))
        # accelerations enter linearly: with stiffness negligible in the matrix, a correction solves M a = -r
        trial = state.copy()
        only_mass = Scheme(0.0, 0.0, 0.0, 0.0, gain_v=0.0, gain_a=LARGE)
        everyone = np.ones(self.n_samples, dtype=bool)
        self.correct(0.0, trial, only_mass, everyone, fresh=True)
        state.a = trial.a
        self._prescribe(0.0, state, everyone)
        return state if self.settled is None else self.settled.at_rest(state, len(self._motions))

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        self._prescribe(time, state, active)
        self._act(time, state, scheme.gain_v, active, fresh)
        correct(
            self._equations,
            self._amplitudes(time),
            self._acting,
            (state.q, state.v, state.a),
            (scheme.gain_v, scheme.gain_a),
            active,
            fresh,
            self._factors,
            self._cache,
            self._size,
        )
        return self._size.copy()

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
        layout, before = self._equations.layout, state.q.copy()
        acting = Acting.empty(len(self._factors[0]), layout.n_eta)
        if self._actions.actions:
            self._act(0.0, state, 0.0, active, True)
            acting.balance[:], acting.tangent[:] = share * self._acting.balance, share * self._acting.tangent
        samples = np.arange(self.n_samples)
        acting.balance[samples // LANES, :, samples % LANES] += force
        equations = self._equations._replace(prescribed=np.ones(len(layout.rigid), dtype=bool))
        factors, size = tuple(np.zeros_like(part) for part in self._factors), np.empty(self.n_samples)
        correct(
            equations, share * self._amplitudes(0.0), acting, (state.q, state.v, state.a), (0.0, 0.0), active, True,
            factors, self._cache, size,
        )  # fmt: skip
        shortened = np.where(size > longest, longest / np.maximum(size, longest), 1.0)
        state.q[:] = np.where(shortened[:, None] < 1.0, before + shortened[:, None] * (state.q - before), state.q)
        return size

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the kinetic energy of the samples in a state, shape (n_samples,), J."""
        return reduced_energy(self._terms, self._values, q, v)[0]

    def residual(self, time: float, state: State) -> np.ndarray:
        """Return the residual of the equations of motion, shape (n_samples, n_eta).

        In the rows of prescribed coordinates it is the force (N m) that drives them.
        """
        self._act_on_all(time, state)
        result = np.empty_like(state.q)
        evaluate_residual(
            self._equations, self._amplitudes(time), self._acting, (state.q, state.v, state.a), self._cache, result
        )
        return result

    @property
    def n_events(self) -> int:
        """Number of actions whose law has an edge."""
        return len(self._actions.edges)

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed, shape (n_events, n_samples)."""
        self._act_on_all(time, state)
        return self._known[:, DEPTH, self._actions.edges].T

    def energies(self, time: float, state: State) -> Energies:
        """Return energies and powers at an instant, from the same tables as the equations of motion."""
        residual = self.residual(time, state)
        energies = Energies(*reduced_energy(self._terms, self._values, state.q, state.v))
        for action, power, stored in zip(self._actions.actions, self._known[:, POWER].T, self._known[:, STORED].T):
            energies.add_power(action.effect, power)
            energies.add_potential(action.effect, stored)
        loads = load_powers(self._terms, self._values, state.q, state.v)
        for effect in self._load_effects:
            energies.add_power(effect.name, effect.amplitude(time) * loads[effect.name])
        if self._terms.damping is not None:
            power = damping_power(self._terms, self._values, state.q, state.v)
            energies.add_power(self._terms.damping.effect, power - 2.0 * self._terms.damping.mass * energies.kinetic)
        for k, motion in self._motions.items():
            energies.add_power(motion.name, residual[:, k] * state.v[:, k])
        return energies

    def load_amplitudes(self, time: float) -> np.ndarray:
        """Return the weighted amplitude of every load term, shape (n_samples, n_load_terms)."""
        weights = self._equations.weights
        return weights.loads * self._amplitudes(time)[weights.effects]

    def action_forces(self, time: float, state: State) -> np.ndarray:
        """Return the force (N or N m) of every action, shape (n_samples, n_actions)."""
        self._act_on_all(time, state)
        return self._known[:, FORCE].copy()

    def close(self) -> None:
        """Nothing is to be given back."""

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        for now, before in ((state.q, previous.q), (state.v, previous.v), (state.a, previous.a)):
            now[samples] = before[samples]

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
        self._act(time, state, 0.0, np.ones(self.n_samples, dtype=bool), True)
        stiff, heavy = (self._tangents(time, state, gain_a) for gain_a in (0.0, 1.0))
        r = self.tables.n_coordinates
        for sample in np.flatnonzero(finite & samples):
            inertia = heavy[sample] - stiff[sample]
            stiffness = stiff[sample, r:, r:]
            if not (np.linalg.eigvalsh(inertia)[0] > 0.0 and np.linalg.eigvalsh(stiffness)[0] > 0.0):
                reasons[sample] = Status.BROKE_DOWN
        return reasons[samples]

    def _tangents(self, time: float, state: State, gain_a: float) -> np.ndarray:
        """Return the iteration matrices with a given gain of the accelerations, shape (n_samples, n_eta, n_eta)."""
        packed, border = (np.empty_like(part) for part in self._factors)
        fill_tangents(
            self._equations, self._amplitudes(time), self._acting, (state.q, state.v, state.a), gain_a,
            (packed, border), self._cache, self.n_samples,
        )  # fmt: skip
        r, n = self.tables.n_coordinates, self.n_eta
        m = n - r
        packed, border = (np.moveaxis(part, 2, 1).reshape(-1, part.shape[1])[: self.n_samples] for part in (packed, border))
        matrices = np.empty((self.n_samples, n, n))
        rows, columns = np.tril_indices(m)
        matrices[:, r + rows, r + columns] = matrices[:, r + columns, r + rows] = packed
        matrices[:, :r, :r] = border[:, : r * r].reshape(-1, r, r)
        matrices[:, r:, :r] = np.swapaxes(border[:, r * r : r * r + r * m].reshape(-1, r, m), 1, 2)
        matrices[:, :r, r:] = border[:, r * r + r * m :].reshape(-1, r, m)
        return matrices

    def _prescribe(self, time: float, state: State, samples: np.ndarray) -> None:
        """Put the prescribed coordinates of some samples (a mask) where they are at a time."""
        for k, motion in self._motions.items():
            state.q[samples, k], state.v[samples, k], state.a[samples, k] = motion.at(time)

    def _act(self, time: float, state: State, gain_v: float, active: np.ndarray, with_tangent: bool) -> None:
        """Evaluate the actions on the active samples, and what is known of them beside their forces."""
        if self._actions.actions:
            amplitudes = amplitudes_of(self._actions.actions, time)
            evaluate_local(
                self._local, self._grids, amplitudes, (state.q, state.v), gain_v, active, with_tangent,
                self._acting, self._known,
            )  # fmt: skip

    def _act_on_all(self, time: float, state: State) -> None:
        self._act(time, state, 0.0, np.ones(self.n_samples, dtype=bool), False)

    def _amplitudes(self, time: float) -> np.ndarray:
        """Return the amplitudes of the effects with loads."""
        return np.array([effect.amplitude(time) for effect in self._load_effects])
