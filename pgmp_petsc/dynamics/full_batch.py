"""The full-order model of a batch of samples as one second-order system for the integrator, on one rank."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.beam2d import PACKED_COLUMNS, PACKED_ROWS
from pgmp_petsc.bodies.matrices import assemble, element_dofs
from pgmp_petsc.dynamics.batched_ldl import analyse
from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.dynamics.body_damping import BodyDampings
from pgmp_petsc.dynamics.full_kernel import Elements, Entries, Lumps, Pattern, correct
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.dynamics.lanes import LANES
from pgmp_petsc.dynamics.local_forces import LocalForces
from pgmp_petsc.dynamics.lumped_masses import lumped_masses
from pgmp_petsc.dynamics.static_equilibrium import Settled
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.effects import Effect, Motion, actions_of, driven, loads_of
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.unknowns import Unknowns


class FullBatch:
    """A batch of full-order samples.

    Arrays have shape (n_blocks, n, LANES): sample k is lane ``k % LANES`` of block ``k // LANES``; the last block is
    filled up with copies of the last sample that are never active.

    Parameters
    ----------
    kinematics
        Rigid kinematics; the start is an undeformed configuration.
    effects
        Effects of the scene.
    values
        Parameter values of the samples, each of shape (n_samples,).
    initial
        Positions (rad) and velocities (rad/s) of the rigid coordinates at the start, each of shape (n_theta,).
    n_samples
        Number of samples.
    motions
        Prescribed motions by the number of their coordinate.
    settled
        Static equilibrium of every sample to start from; the undeformed mechanism if there is none.
    """

    comm = MPI.COMM_SELF

    def __init__(
        self,
        kinematics: RigidKinematics,
        effects: Sequence[Effect],
        values: Mapping[str, np.ndarray],
        initial: tuple[np.ndarray, np.ndarray],
        n_samples: int,
        motions: Mapping[int, Motion] = MappingProxyType({}),
        settled: Settled | None = None,
    ) -> None:
        self.settled = settled
        mechanism = self._mechanism = kinematics.mechanism
        self.n_samples = n_samples
        self.n_blocks = -(-n_samples // LANES)
        self.n_dofs = mechanism.n_dofs
        self._kinematics = kinematics
        self._initial = initial
        self._motions = list(motions.values())
        undeformed = kinematics.undeformed(*initial)[0]
        self._constraints = ConstraintSet(Unknowns(mechanism)).independent(undeformed)
        self.n_constraints = self._constraints.n_constraints
        values = {name: np.broadcast_to(value, (n_samples,)) for name, value in values.items()}
        self._damping = BodyDampings.of(effects, mechanism)
        self._section = self._sections(values)
        self._lumped = lumped_masses(mechanism.bodies, values, n_samples)
        padded = {name: self._block(value).ravel() for name, value in values.items()}
        self._local = LocalForces(actions_of(effects), padded, self.n_blocks * LANES, mechanism.node_dofs)
        self._edges = self._local.edges
        self._loads(effects, values)
        self._structure()
        lengths = np.array([body.mesh.lengths.sum() for body in mechanism.bodies])
        total = np.einsum("kbl,b->kl", self._section[:, :, 3], lengths)
        total += self._block(self._lumped.mass[::DOFS_PER_NODE].sum(axis=0))
        self._node_mass = total / mechanism.n_nodes
        self._units = np.tile([1 / kinematics.size, 1 / kinematics.size, 1.0], mechanism.n_nodes)
        self._size = np.empty((self.n_blocks, LANES))

    def start(self) -> State:
        """Return the start, undeformed or settled, with consistent accelerations and multipliers."""
        if self.settled is not None:
            state = self.consistent(self.settled.unknowns, np.zeros(self.n_dofs))
            return self.settled.at_rest(state, len(self._motions))
        return self.consistent(*self._kinematics.undeformed(*self._initial))

    def consistent(self, q: np.ndarray, v: np.ndarray) -> State:
        """Return the state at time 0 with given unknowns and velocities that obey the constraints.

        They have the shape (n_dofs,) where they are the same of all samples, or else (n_dofs, n_samples).
        """
        shape = (self.n_dofs, self.n_samples)
        state = State(
            self.pack(np.broadcast_to(q.reshape(self.n_dofs, -1), shape)),
            self.pack(np.broadcast_to(v.reshape(self.n_dofs, -1), shape)),
            np.zeros((self.n_blocks, self.n_dofs, LANES)),
            np.zeros((self.n_blocks, self.n_constraints, LANES)),
        )
        # acceleration and multipliers enter linearly: one correction with the mass alone solves
        # M a + C^T lambda = g_ext - g_int,  C a = -(dC/dt) v
        trial = state.copy()
        drift = self._constraints.drift(
            _lanes_last(state.q), _lanes_last(state.v), driven(self._motions, 0.0).acceleration
        )
        self._correct(0.0, trial, (0.0, 1.0, 0.0), _lanes_first(drift), self._everyone(), True)
        return State(state.q, state.v, trial.a, trial.multipliers)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        residual = _lanes_first(self._constraints.residual(_lanes_last(state.q), driven(self._motions, time).angle))
        gains = (scheme.gain_v, scheme.gain_a, 1.0)
        return self._correct(time, state, gains, residual, self._fill(active), fresh)

    def close(self) -> None:
        """Nothing is to be given back."""

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put samples back."""
        chosen = self._fill(samples)
        for now, before in (
            (state.q, previous.q),
            (state.v, previous.v),
            (state.a, previous.a),
            (state.multipliers, previous.multipliers),
        ):
            np.copyto(now, before, where=chosen[:, None, :])

    @property
    def n_events(self) -> int:
        """Number of actions whose law has an edge."""
        return len(self._edges)

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed, shape (n_events, n_samples)."""
        q, v = (_lanes_last(part).reshape(self.n_dofs, -1) for part in (state.q, state.v))
        return self._local.evaluate(time, q, v, 0.0, False).depths[self._edges, : self.n_samples]

    def outside(self, state: State) -> np.ndarray:
        """Return no sample: the full-order model is valid everywhere."""
        return np.zeros(self.n_samples, dtype=bool)

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why samples fail; see `SecondOrderSystem.reasons`."""
        finite = np.isfinite(self.unpack(state.v)[:, samples]).all(axis=0)
        return np.where(finite, Status.NOT_CONVERGED, Status.NOT_FINITE)

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Return a state's array as (n, n_samples)."""
        return _lanes_last(array).reshape(array.shape[1], -1)[:, : self.n_samples]

    def frames(self, state: State) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, 3, n_samples)."""
        return self._mechanism.by_node(self.unpack(state.q))

    def pack(self, rows: np.ndarray) -> np.ndarray:
        """Return rows of shape (n, n_samples) as a state's array."""
        return _lanes_first(self._block(rows))

    def _correct(
        self,
        time: float,
        state: State,
        gains: tuple[float, float, float],
        residual: np.ndarray,
        active: np.ndarray,
        fresh: bool,
    ) -> np.ndarray:
        amplitudes = np.array([effect.amplitude(time) for effect in self._load_effects])
        # of each sample by itself, so that none is felt by another
        scale = gains[1] * self._node_mass
        jacobian, curvature = self._linearise(state)
        local, tangents = self._local_effects(time, state, gains[0], fresh)
        if tangents.size:
            curvature = np.concatenate([curvature, tangents], axis=1)
        constraint = (residual, jacobian, curvature, self._load_values)
        with np.errstate(all="ignore"):
            correct(
                self._elements,
                self._lumps,
                self._section,
                self._jacobian,
                self._curvature,
                self._load_entries,
                self._pattern,
                constraint,
                amplitudes[:, None] * self._load_weights,
                local,
                (state.q, state.v, state.a, state.multipliers),
                gains,
                scale,
                active,
                fresh,
                self._factors,
                self._units,
                self._size,
            )
        return self._size.ravel()[: self.n_samples].copy()

    def _linearise(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return entries of the constraint Jacobian and of the constraints' curvature, by lane."""
        if self._constraints.linear and self._constant is not None:
            return self._constant
        q = _lanes_last(state.q)
        jacobian = _lanes_first(self._constraints.jacobian_values(q))
        curvature = _lanes_first(self._constraints.curvature_values(q, _lanes_last(state.multipliers)))
        self._constant = jacobian, curvature
        return self._constant

    def _local_effects(
        self, time: float, state: State, gain_v: float, fresh: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return forces of local effects (n_blocks, n_dofs, LANES) and their tangents; empty where there are none."""
        n = self.n_blocks * LANES
        if not (self._local.n_actions or self._damping.modal):
            return np.empty((self.n_blocks, 0, LANES)), np.empty((self.n_blocks, 0, LANES))
        q, v = (_lanes_last(part).reshape(self.n_dofs, n) for part in (state.q, state.v))
        total, tangents = np.zeros((self.n_dofs, n)), np.zeros((0, n))
        with np.errstate(all="ignore"):
            if self._local.n_actions:
                now = self._local.evaluate(time, q, v, gain_v, fresh)
                self._local.add_forces(now, total)
                tangents = now.tangents
            self._damping.add_modal_forces(q, v, total)
        return tuple(_lanes_first(part.reshape(-1, self.n_blocks, LANES)) for part in (total, tangents))

    def _sections(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Evaluate ``(EA, k_s GA, EI, rho A, rho I, beta, alpha)`` of every body (n_blocks, n_bodies, 7, LANES)."""
        bodies = self._kinematics.mechanism.bodies
        table = np.zeros((len(bodies), 7, self.n_samples))
        for number, (body, row) in enumerate(zip(bodies, table)):
            if body.flexible:
                s = body.section
                quantities = (s.axial, s.shear, s.bending, s.line_density, s.rotary_density)
                row[:5] = [q.coefficient * (q.monomial.evaluate(values) * np.ones(self.n_samples)) for q in quantities]
                row[5:] = np.array(self._damping.rayleigh_of(number))[:, None]
        return np.ascontiguousarray(np.moveaxis(self._block(table), 2, 0))

    def _loads(self, effects: Sequence[Effect], values: Mapping[str, np.ndarray]) -> None:
        mechanism = self._kinematics.mechanism
        matrices = assemble(mechanism.bodies, range(mechanism.n_dofs))
        loads = loads_of(effects, matrices)
        by_name = {effect.name: effect for effect in effects}
        self._load_effects = [by_name[load.effect] for load in loads]
        weights = evaluate_weights((load.weight for load in loads), values)
        weights = np.broadcast_to(weights if weights.ndim == 2 else weights[:, None], (len(loads), self.n_samples))
        self._load_weights = np.ascontiguousarray(np.moveaxis(self._block(weights), 1, 0))
        vectors = sp.coo_matrix(np.array([load.vector for load in loads]).reshape(len(loads), self.n_dofs))
        self._load_entries = Entries(vectors.row.astype(int), vectors.col.astype(int), np.zeros(0, dtype=int))
        self._load_values = vectors.data

    def _structure(self) -> None:
        """Number the entries of the iteration matrix and analyse it."""
        mechanism = self._kinematics.mechanism
        dofs = np.concatenate([element_dofs(body.elements) for body in mechanism.bodies])
        owner = np.concatenate([np.full(len(b.mesh.cells), i) for i, b in enumerate(mechanism.bodies)])
        rows, columns = self._constraints.jacobian_pattern
        curved_rows, curved_columns = (
            np.concatenate(parts) for parts in zip(self._constraints.curvature_pattern, self._local.pattern)
        )
        lumped = self._lumped.dofs
        multiplier = self.n_dofs + rows
        n = self.n_dofs + self.n_constraints
        i = np.concatenate([dofs[:, PACKED_ROWS].ravel(), multiplier, curved_rows, lumped])
        j = np.concatenate([dofs[:, PACKED_COLUMNS].ravel(), columns, curved_columns, lumped])
        lower = sp.coo_matrix((np.ones(i.size), (i, j)), shape=(n, n))
        symbolic = analyse(lower + lower.T, np.arange(self.n_dofs, n))
        place = np.empty(n, dtype=np.int64)
        place[symbolic.order] = np.arange(n)
        self._pattern = Pattern(place, symbolic.starts, symbolic.rows, symbolic.targets)
        self._elements = Elements(
            dofs,
            np.concatenate([body.mesh.lengths for body in mechanism.bodies]),
            np.concatenate([body.directions for body in mechanism.bodies]),
            owner,
            symbolic.position(dofs[:, PACKED_ROWS], dofs[:, PACKED_COLUMNS]),
            self._damping.any_rayleigh,
        )
        mass = np.ascontiguousarray(np.moveaxis(self._block(self._lumped.mass), 1, 0))
        self._lumps = Lumps(lumped, self._lumped.body, symbolic.position(lumped, lumped), mass)
        self._jacobian = Entries(rows, columns, symbolic.position(multiplier, columns))
        self._curvature = Entries(curved_rows, curved_columns, symbolic.position(curved_rows, curved_columns))
        self._factors = (
            np.empty((self.n_blocks, n, LANES)),
            np.empty((self.n_blocks, symbolic.rows.size, LANES)),
        )
        self._constant = None

    def _block(self, rows: np.ndarray) -> np.ndarray:
        """Split the last axis (samples) into (n_blocks, LANES), the last sample repeated to fill."""
        missing = self.n_blocks * LANES - self.n_samples
        filled = np.concatenate([rows, np.repeat(rows[..., -1:], missing, axis=-1)], axis=-1)
        return filled.reshape(*rows.shape[:-1], self.n_blocks, LANES)

    def _fill(self, samples: np.ndarray) -> np.ndarray:
        """Return a mask of samples as (n_blocks, LANES), False where there is none."""
        filled = np.zeros(self.n_blocks * LANES, dtype=bool)
        filled[: self.n_samples] = samples
        return filled.reshape(self.n_blocks, LANES)

    def _everyone(self) -> np.ndarray:
        return np.ones((self.n_blocks, LANES), dtype=bool)


def _lanes_last(array: np.ndarray) -> np.ndarray:
    """View (n_blocks, n, LANES) as (n, n_blocks, LANES)."""
    return np.moveaxis(array, 1, 0)


def _lanes_first(array: np.ndarray) -> np.ndarray:
    """Copy (n, n_blocks, LANES) to contiguous (n_blocks, n, LANES)."""
    return np.ascontiguousarray(np.moveaxis(array, 0, 1))
