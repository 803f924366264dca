"""The reduced model as a second-order system for the integrator; a batch of samples with their own parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from mpi4py import MPI

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.dynamics.generalised_alpha import Scheme, State
from pgmp_petsc.dynamics.reduced_kernel import correct
from pgmp_petsc.effects import Effect
from pgmp_petsc.reduction.interpolation import interpolate_slope
from pgmp_petsc.reduction.tables import ReducedTables


class ReducedSystem:
    """A batch of samples of the reduced model, on one rank.

    Parameters
    ----------
    tables
        Reduced tables (one rigid coordinate).
    effects
        Effects of the scene; they give the loads' amplitudes over time.
    values
        Parameter values of the samples, each of shape (n_samples,).
    initial
        Position (rad) and velocity (rad/s) of the rigid coordinate at the start.
    scale
        Displacement per unit of the flexible coordinates, shape (n_modes,); see `displacement_scale`.
    """

    comm = MPI.COMM_SELF

    def __init__(
        self,
        tables: ReducedTables,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[float, float],
        scale: np.ndarray,
        n_samples: int,
    ) -> None:
        grid = tables.grid
        self.tables = tables
        self.n_samples = n_samples
        self._initial = initial
        self._grid = (grid.lower, grid.step, grid.n, grid.periodic)
        self._packed = (pack(tables.mass), coupling_of(tables), pack(tables.stiffness), tables.load)
        self._weights = tuple(
            np.ascontiguousarray(np.broadcast_to(evaluate_weights(w, values).T, (n_samples, len(w))))
            for w in (tables.mass_weights, tables.stiffness_weights, tables.load_weights)
        )
        by_name = {effect.name: effect for effect in effects}
        self._load_effects = [by_name[name] for name in tables.load_effects]
        self._scale = np.concatenate([np.ones(tables.n_coordinates), scale])
        self._factors = np.empty((n_samples, self._packed[0].shape[2]))
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
            self._grid,
            self._packed,
            self._weights,
            amplitudes,
            self._scale,
            (state.q, state.v, state.a),
            (scheme.gain_v, scheme.gain_a),
            active,
            fresh,
            self._factors,
            self._size,
        )
        return self._size.copy()

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        for now, before in ((state.q, previous.q), (state.v, previous.v), (state.a, previous.a)):
            now[samples] = before[samples]

    def outside(self, state: State) -> np.ndarray:
        """Return the samples whose rigid coordinate left the sampled range."""
        grid = self.tables.grid
        if grid.periodic:
            return np.zeros(self.n_samples, dtype=bool)
        theta = state.q[:, 0]
        return (theta < grid.lower) | (theta > grid.upper)


LARGE = 1e30  # gain that makes stiffness negligible beside mass in the iteration matrix


def coupling_of(tables: ReducedTables) -> np.ndarray:
    """Return ``b_i = (d rho/d theta)^T M_i (d Psi/d theta)`` at the samples, shape (n, n_mass_terms, n_delta).

    By the product rule it is the derivative of the mass table's coupling block, taken from the interpolant, less the
    inertia table.
    """
    block = tables.mass[:, :, 0, 1:]
    return interpolate_slope(tables.grid, block, tables.grid.theta) - tables.inertia[:, :, 0, 0]


def pack(matrices: np.ndarray) -> np.ndarray:
    """Pack symmetric matrices (..., n, n) as lower triangles row by row."""
    rows, columns = np.tril_indices(matrices.shape[-1])
    return np.ascontiguousarray(matrices[..., rows, columns])


def displacement_scale(projection: np.ndarray, size: float) -> np.ndarray:
    """Return the largest displacement per unit of each flexible coordinate.

    Parameters
    ----------
    projection
        Flexible modes, shape (n, n_dofs, n_modes).
    size
        Length that translations are measured in, m.

    Returns
    -------
    ndarray, shape (n_modes,)
    """
    units = np.tile([1.0 / size, 1.0 / size, 1.0], projection.shape[1] // 3)
    return np.max(np.abs(projection) * units[:, None], axis=(0, 1))
