"""The full-order model of one sample, distributed over ranks: the reference.

    M q'' + g_int(q) + C(q)^T lambda = g_ext(t),     c(q) = 0

(Naets et al. 2015, eq. (3)). Nodes are dealt to ranks in contiguous shares, multipliers belong to the last rank. Each
rank evaluates the elements that touch its nodes and assembles its rows of

    [ gain_a M + K(q, lambda)   s C^T ]
    [ s C                        0    ]

with constraints scaled by s to the size of the inertia terms (Bottasso, Bauchau and Cardona 2007); a direct solver
factorises it in parallel.

Options prefix: ``pgmp_full_`` (e.g. ``-pgmp_full_mat_mumps_icntl_4 2``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from mpi4py import MPI
from numba import njit
from petsc4py import PETSc

from pgmp_petsc.bodies.beam2d import N_PACKED, PACKED_COLUMNS, PACKED_ROWS, force_and_tangent
from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.bodies.matrices import assemble, element_dofs, owned_rows, weighted_sum
from pgmp_petsc.dynamics.generalised_alpha import Scheme, State
from pgmp_petsc.effects import Effect, loads_of
from pgmp_petsc.mechanism.connections import independent_constraints
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.matrices import aij_matrix

PREFIX = "pgmp_full_"


class FullDistributed:
    """One full-order sample on all ranks of a communicator. Collective on `comm`.

    Local state arrays hold this rank's unknowns; multipliers are on the last rank only.

    Parameters
    ----------
    kinematics
        Rigid kinematics; the start is an undeformed configuration.
    effects
        Effects of the scene.
    values
        Parameter values.
    initial
        Position (rad) and velocity (rad/s) of the rigid coordinate at the start.
    comm
        Ranks that share the model.
    """

    n_samples = 1

    def __init__(
        self,
        kinematics: RigidKinematics,
        effects: Sequence[Effect],
        values: Mapping[str, float],
        initial: tuple[float, float],
        comm: MPI.Comm,
    ) -> None:
        mechanism = kinematics.mechanism
        self.comm = comm
        self._kinematics, self._initial = kinematics, initial
        self._constraints = independent_constraints(kinematics, initial[0])
        self.n_dofs = mechanism.n_dofs
        self.rows = owned_rows(self.n_dofs, comm.rank, comm.size)
        self._n_multipliers = self._constraints.n_constraints if comm.rank == comm.size - 1 else 0
        matrices = assemble(mechanism.bodies, self.rows)
        loads = loads_of(effects, matrices)
        by_name = {effect.name: effect for effect in effects}
        self._load_effects = [by_name[load.effect] for load in loads]
        self._load_vectors = np.array(
            [load.weight.evaluate(values) * load.vector for load in loads]
        ).reshape(len(loads), len(self.rows))
        mass = weighted_sum(matrices.mass, values)
        self._mass = aij_matrix(mass, comm, len(self.rows))
        self._typical_mass = comm.allreduce(float(mass.diagonal(self.rows.start).sum())) / self.n_dofs
        self._elements(values)
        self._numbering()
        units = np.tile([1 / kinematics.size, 1 / kinematics.size, 1.0], len(self.rows) // DOFS_PER_NODE)
        self._units = units
        self._solver()

    def close(self) -> None:
        """Destroy the PETSc objects."""
        vectors = (self._x, self._rhs, self._ghosts, self._a, self._ma)
        for item in (self._ksp, self._matrix, self._mass, self._scatter, *vectors):
            item.destroy()

    def __enter__(self) -> FullDistributed:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> State:
        """Return the undeformed start with consistent accelerations and multipliers."""
        position, velocity = self._initial
        poses = self._kinematics.poses(np.array([position]))
        rates = self._kinematics.rates(poses)
        mechanism = self._kinematics.mechanism
        own = slice(self.rows.start, self.rows.stop)
        q = mechanism.place(poses)[:, 0]
        v = mechanism.place_rates(poses[..., 0], rates[..., 0]) @ np.array([velocity])
        state = State(q[own], v[own], np.zeros(len(self.rows)), np.zeros(self._n_multipliers))
        drift = self._constraints.drift(q[:, None], v[:, None])[:, 0]
        step, multipliers = self._solve(0.0, state, 1.0, 0.0, drift, fresh=True)
        return State(state.q, state.v, state.a - step, state.multipliers - multipliers)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        step, multipliers = self._solve(time, state, scheme.gain_a, 1.0, None, fresh)
        state.q -= step
        state.v -= scheme.gain_v * step
        state.a -= scheme.gain_a * step
        state.multipliers -= multipliers
        moved = float(np.max(np.abs(step) * self._units, initial=0.0)) if np.all(np.isfinite(step)) else np.inf
        return np.array([self.comm.allreduce(moved, op=MPI.MAX)])

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put the sample back."""
        if samples[0]:
            for now, before in (
                (state.q, previous.q),
                (state.v, previous.v),
                (state.a, previous.a),
                (state.multipliers, previous.multipliers),
            ):
                now[:] = before

    def outside(self, state: State) -> np.ndarray:
        """Return False: the full-order model is valid everywhere."""
        return np.zeros(1, dtype=bool)

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Gather a state's array from all ranks as (n, 1), on every rank."""
        return np.concatenate(self.comm.allgather(array))[:, None]

    def _solve(
        self, time: float, state: State, gain_a: float, gain_k: float, constraint: np.ndarray | None, fresh: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the residual and solve for the correction; `constraint` replaces c(q) where given."""
        scale = gain_a * self._typical_mass
        q, multipliers = self._gather(state)
        forces, tangents = np.empty((len(self._dofs), 6)), np.empty((len(self._dofs), N_PACKED))
        evaluate_elements(self._dofs, self._lengths, self._directions, self._sections, q, forces, tangents)
        everywhere = np.zeros((self.n_dofs, 1))
        everywhere[self._needed_dofs, 0] = q[self._needed_dofs]
        jacobian = self._constraints.jacobian_values(everywhere)[:, 0]
        if constraint is None:
            constraint = self._constraints.residual(everywhere)[:, 0]
        rows, columns = self._constraints.jacobian_pattern
        residual = np.zeros(self.n_dofs)
        np.add.at(residual, self._dofs.ravel(), forces.ravel())
        np.add.at(residual, columns, jacobian * multipliers[rows])
        own = residual[self.rows.start : self.rows.stop]
        self._a.setArray(state.a)
        self._mass.mult(self._a, self._ma)
        own += self._ma.getArray(readonly=True)
        for effect, vector in zip(self._load_effects, self._load_vectors):
            own -= effect.amplitude(time) * vector
        if fresh:
            curvature = self._constraints.curvature_values(everywhere, multipliers[:, None])[:, 0]
            self._assemble(gain_a, gain_k, scale, tangents, jacobian, curvature)
        self._rhs.setArray(np.concatenate([own, scale * constraint[: self._n_multipliers]]))
        self._ksp.solve(self._rhs, self._x)
        if self._ksp.getConvergedReason() < 0:
            raise RunError(
                f"full-order step that ends at {time:.6g} s: the linear solver failed "
                f"(reason {self._ksp.getConvergedReason()}); see -{PREFIX}ksp_converged_reason"
            )
        solution = self._x.getArray(readonly=True)
        n_own = len(self.rows)
        return solution[:n_own].copy(), scale * solution[n_own:]

    def _elements(self, values: Mapping[str, float]) -> None:
        """Collect the elements that touch this rank's nodes."""
        first, last = self.rows.start // DOFS_PER_NODE, self.rows.stop // DOFS_PER_NODE
        dofs, lengths, directions, sections, masses = [], [], [], [], []
        for body in self._kinematics.mechanism.bodies:
            chosen = np.flatnonzero(((body.elements >= first) & (body.elements < last)).any(axis=1))
            section = body.section
            numbers = [
                quantity.coefficient * float(quantity.monomial.evaluate(values))
                for quantity in (section.axial, section.shear, section.bending)
            ]
            dofs.append(element_dofs(body.elements[chosen]))
            lengths.append(body.mesh.lengths[chosen])
            directions.append(body.directions[chosen])
            sections.append(np.tile(numbers, (chosen.size, 1)))
            entries = body.mass_entries(chosen)
            masses.append(sum(float(w.evaluate(values)) * matrix for w, matrix in entries.items()))
        self._dofs = np.concatenate(dofs)
        self._lengths, self._directions = np.concatenate(lengths), np.concatenate(directions)
        self._sections, self._mass_entries = np.concatenate(sections), np.concatenate(masses)

    def _numbering(self) -> None:
        """Find which unknowns are needed here, and where element and constraint entries go in this rank's rows."""
        rows, columns = self._constraints.jacobian_pattern
        curved_rows, curved_columns = self._constraints.curvature_pattern
        off_diagonal = curved_rows != curved_columns
        self._mirrored = off_diagonal
        self._needed_dofs = np.unique(np.concatenate([self._dofs.ravel(), columns]))
        i = np.concatenate(
            [
                np.repeat(self._dofs, 6, axis=1).ravel(), columns, self.n_dofs + rows,
                curved_rows, curved_columns[off_diagonal], self.n_dofs + np.arange(self._constraints.n_constraints),
            ]
        )
        j = np.concatenate(
            [
                np.tile(self._dofs, (1, 6)).ravel(), self.n_dofs + rows, columns,
                curved_columns, curved_rows[off_diagonal], self.n_dofs + np.arange(self._constraints.n_constraints),
            ]
        )
        stop = self.n_dofs + self._constraints.n_constraints if self._n_multipliers else self.rows.stop
        self._chosen = np.flatnonzero((i >= self.rows.start) & (i < stop))
        n_columns = self.n_dofs + self._constraints.n_constraints
        keys = (i[self._chosen] - self.rows.start) * n_columns + j[self._chosen]
        unique, self._positions = np.unique(keys, return_inverse=True)
        n_rows = stop - self.rows.start
        self._indices = (unique % n_columns).astype(PETSc.IntType)
        self._indptr = np.searchsorted(unique // n_columns, np.arange(n_rows + 1)).astype(PETSc.IntType)

    def _solver(self) -> None:
        n_local = len(self.rows) + self._n_multipliers
        self._matrix = PETSc.Mat().createAIJ(
            size=((n_local, None), (n_local, None)),
            csr=(self._indptr, self._indices, np.zeros(self._indices.size)),
            comm=self.comm,
        )
        self._x, self._rhs = self._matrix.createVecs()
        self._a, self._ma = self._mass.createVecs()
        needed = np.concatenate(
            [self._needed_dofs, self.n_dofs + np.arange(self._constraints.n_constraints)]
        ).astype(PETSc.IntType)
        source = PETSc.IS().createGeneral(needed, comm=PETSc.COMM_SELF)
        self._ghosts = PETSc.Vec().createSeq(needed.size)
        self._scatter = PETSc.Scatter().create(self._x, source, self._ghosts, None)
        source.destroy()
        self._ksp = PETSc.KSP().create(self.comm)
        self._ksp.setOptionsPrefix(PREFIX)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.getPC().setType(PETSc.PC.Type.LU)
        self._ksp.getPC().setFactorSolverType("mumps")
        self._ksp.setOperators(self._matrix)
        self._ksp.setFromOptions()

    def _gather(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return q (n_dofs,), valid where it is needed here, and all multipliers."""
        self._x.setArray(np.concatenate([state.q, state.multipliers]))
        self._scatter.scatter(self._x, self._ghosts, addv=False, mode=PETSc.Scatter.Mode.FORWARD)
        ghosts = self._ghosts.getArray(readonly=True)
        q = np.zeros(self.n_dofs)
        q[self._needed_dofs] = ghosts[: self._needed_dofs.size]
        return q, ghosts[self._needed_dofs.size :].copy()

    def _assemble(
        self,
        gain_a: float,
        gain_k: float,
        scale: float,
        tangents: np.ndarray,
        jacobian: np.ndarray,
        curvature: np.ndarray,
    ) -> None:
        matrices = gain_a * self._mass_entries
        packed = gain_k * tangents
        matrices[:, PACKED_ROWS, PACKED_COLUMNS] += packed
        below = PACKED_ROWS != PACKED_COLUMNS
        matrices[:, PACKED_COLUMNS[below], PACKED_ROWS[below]] += packed[:, below]
        values = np.concatenate(
            [
                matrices.ravel(), scale * jacobian, scale * jacobian,
                gain_k * curvature, gain_k * curvature[self._mirrored], np.zeros(self._constraints.n_constraints),
            ]
        )
        data = np.bincount(self._positions, weights=values[self._chosen], minlength=self._indices.size)
        self._matrix.setValuesCSR(self._indptr, self._indices, data)
        self._matrix.assemble()
        self._ksp.setOperators(self._matrix)


@njit(cache=True)
def evaluate_elements(dofs, lengths, directions, sections, q, forces, tangents):
    """Evaluate force (n_e, 6) and packed tangent (n_e, 21) of every element at q (n_dofs,)."""
    u, force = np.empty((6, 1)), np.empty((6, 1))
    section, tangent = np.empty((3, 1)), np.empty((N_PACKED, 1))
    for e in range(len(lengths)):
        for i in range(6):
            u[i, 0] = q[dofs[e, i]]
        for i in range(3):
            section[i, 0] = sections[e, i]
        force_and_tangent(u, lengths[e], directions[e], section, force, tangent)
        forces[e] = force[:, 0]
        tangents[e] = tangent[:, 0]
