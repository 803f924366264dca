"""The reduced model as a second-order system for the integrator; a batch of samples with their own parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from mpi4py import MPI

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.dynamics.cells import Cache
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.dynamics.lanes import LANES
from pgmp_petsc.dynamics.reduced_kernel import Weights, correct
from pgmp_petsc.dynamics.reduced_terms import ReducedTerms
from pgmp_petsc.effects import Effect

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
        Position (rad) and velocity (rad/s) of the rigid coordinate at the start.
    n_samples
        Number of samples.
    """

    comm = MPI.COMM_SELF
    n_events = 0

    def __init__(
        self,
        terms: ReducedTerms,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[float, float],
        n_samples: int,
    ) -> None:
        tables = terms.tables
        self.tables = tables
        self.n_samples = n_samples
        self._initial = initial
        self._layout = terms.layout
        self._grids = terms.grids
        self._polynomials = terms.polynomials
        by_name = {effect.name: effect for effect in effects}
        self._load_effects = [by_name[name] for name in dict.fromkeys(tables.load_effects)]
        names = [effect.name for effect in self._load_effects]
        of_terms, of_loads = (
            np.ascontiguousarray(np.broadcast_to(evaluate_weights(w, values).T, (n_samples, len(w))))
            for w in (terms.weights, tables.load_weights)
        )
        effects_of_loads = np.array([names.index(name) for name in tables.load_effects], dtype=np.int64)
        self._weights = Weights(of_terms, of_loads, effects_of_loads)
        self._scale = terms.scale
        n_blocks, n_delta = -(-n_samples // LANES), terms.layout.n_eta - 1
        self._factors = (
            np.empty((n_blocks, n_delta * (n_delta + 1) // 2, LANES)),
            np.empty((n_blocks, 1 + 2 * n_delta, LANES)),
        )
        self._cache = Cache.empty(n_blocks, terms.layout.end, len(names) * terms.layout.load_end)
        self._size = np.empty(n_samples)

    @property
    def n_eta(self) -> int:
        """Number of reduced coordinates."""
        return self.tables.n_coordinates + self.tables.n_modes

    def start(self) -> State:
        """Return the undeformed start with the accelerations that the equations of motion give."""
        q = np.zeros((self.n_samples, self.n_eta))
        v = np.zeros_like(q)
        q[:, 0], v[:, 0] = self._initial
        state = State(q, v, np.zeros_like(q), np.zeros(0))
        # with gain_a = 1 and stiffness left out of the balance (delta = 0), a correction solves M a = -r
        trial = state.copy()
        only_mass = Scheme(0.0, 0.0, 0.0, 0.0, gain_v=0.0, gain_a=LARGE)
        self.correct(0.0, trial, only_mass, np.ones(self.n_samples, dtype=bool), fresh=True)
        state.a = trial.a
        return state

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        amplitudes = np.array([effect.amplitude(time) for effect in self._load_effects])
        correct(
            self._layout,
            self._grids,
            self._polynomials,
            self._weights,
            amplitudes,
            self._scale,
            (state.q, state.v, state.a),
            (scheme.gain_v, scheme.gain_a),
            active,
            fresh,
            self._factors,
            self._cache,
            self._size,
        )
        return self._size.copy()

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        for now, before in ((state.q, previous.q), (state.v, previous.v), (state.a, previous.a)):
            now[samples] = before[samples]

    def outside(self, state: State) -> np.ndarray:
        """Return the samples whose rigid coordinate left the sampled range."""
        return np.broadcast_to(~self.tables.samples.axes[0].contains(state.q[:, 0]), (self.n_samples,))

