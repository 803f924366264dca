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
from types import MappingProxyType

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from pgmp_petsc.dynamics.energies import Energies, joined
from pgmp_petsc.dynamics.full_equations import FullEquations
from pgmp_petsc.dynamics.rank_elements import ElementState
from pgmp_petsc.dynamics.rank_solids import SolidState
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.dynamics.static_equilibrium import Settled
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.effects import Held, Motion, driven
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.matrices import aij_matrix
from pgmp_petsc.runtime.petsc import petsc_solver

PREFIX = "pgmp_full_"
SPARE_MEMORY, MOST_SPARE_MEMORY = 20, 5000  # per cent of what MUMPS foresees, its ICNTL(14): its default, and the most
SHORT_OF_MEMORY = (-8, -9)  # INFOG(1) of MUMPS, the integer and the real work array


class FullDistributed:
    """One full-order sample on all ranks of a communicator. Collective on `comm`.

    Local state arrays hold this rank's unknowns; multipliers are on the last rank only.

    Parameters
    ----------
    equations
        Of the sample on this rank.
    comm
        Ranks that share the model, those that the equations were made for.
    motions
        Prescribed motions by the number of their coordinate.
    settled
        Static equilibrium to start from; the undeformed mechanism if there is none.
    """

    n_samples = 1
    instants_at_once = 1

    def __init__(
        self,
        equations: FullEquations,
        comm: MPI.Comm,
        motions: Mapping[int, Motion | Held] = MappingProxyType({}),
        settled: Settled | None = None,
    ) -> None:
        self.comm, self._equations, self.settled = comm, equations, settled
        self._motions = list(motions.values())
        self._constraints, self.n_dofs, self.rows = equations.constraints, equations.n_dofs, equations.rows
        self._n_multipliers = self._constraints.n_constraints if comm.rank == comm.size - 1 else 0
        self._load_effects, self._load_vectors = equations.load_effects, equations.load_vectors
        self._local, self._damping = equations.local, equations.damping
        self._elements, self._parts = equations.elements, equations.parts
        damped = any(elements.damped for elements in (self._elements, *self._parts))
        self._needs_rates = bool(self._local.n_actions or self._damping.modal or damped)
        self._mass = aij_matrix(equations.mass, comm, len(self.rows))
        diagonal = equations.mass.diagonal(self.rows.start).sum()
        self._typical_mass = comm.allreduce(float(diagonal)) / self.n_dofs
        self._numbering()
        self._units = equations.units[self.rows.start : self.rows.stop]
        self._solver_failed, self._finite_matrix = False, True
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
        """Return the start, undeformed or settled, with consistent accelerations and multipliers."""
        q, v = self._equations.start()
        if self.settled is None:
            return self.consistent(q, v)
        state = self.consistent(self.settled.unknowns[:, 0], np.zeros_like(v))
        return self.settled.at_rest(state, len(self._motions))

    def at_rest(self, q: np.ndarray) -> State:
        """Return a state at rest without multipliers, for unknowns of shape (n_dofs,)."""
        own, nothing = q[self.rows.start : self.rows.stop].copy(), np.zeros(len(self.rows))
        return State(own, nothing, nothing.copy(), np.zeros(self._n_multipliers))

    def correct_at_rest(self, state: State, share: float, longest: float) -> float:
        """Do one Newton correction of a state at rest under a share of the loads at time zero, in place.

        A correction longer than `longest`, in units of the mechanism's size or of 1 rad, is shortened to it. Returned
        is the size before, the same on all ranks. Collective on `comm`.
        """
        step, multipliers = self._solve(0.0, state, (0.0, 0.0, 1.0), None, fresh=True, share=share)
        moved = float(np.max(np.abs(step) * self._units, initial=0.0)) if np.all(np.isfinite(step)) else np.inf
        size = self.comm.allreduce(moved, op=MPI.MAX)
        if np.isfinite(size):
            shortened = min(1.0, longest / size) if size > 0.0 else 1.0
            state.q -= shortened * step
            state.multipliers -= shortened * multipliers
        return size

    def kinetic_energy(self, v: np.ndarray) -> float:
        """Return the kinetic energy for velocities of shape (n_dofs,), the same on all ranks. Collective on `comm`."""
        own = v[self.rows.start : self.rows.stop]
        self._a.setArray(own)
        self._mass.mult(self._a, self._ma)
        return self.comm.allreduce(0.5 * float(own @ self._ma.getArray(readonly=True)))

    def consistent(self, q: np.ndarray, v: np.ndarray) -> State:
        """Return the state at time 0 with given unknowns and velocities, shape (n_dofs,), that obey the constraints."""
        own = slice(self.rows.start, self.rows.stop)
        state = State(q[own], v[own], np.zeros(len(self.rows)), np.zeros(self._n_multipliers))
        drift = self._constraints.drift(q[:, None], v[:, None], driven(self._motions, 0.0).acceleration)[:, 0]
        step, multipliers = self._solve(0.0, state, (0.0, 1.0, 0.0), drift, fresh=True)
        return State(state.q, state.v, state.a - step, state.multipliers - multipliers)

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction; see `SecondOrderSystem.correct`."""
        with np.errstate(all="ignore"):  # a sample that fails may overflow before it is given up
            step, multipliers = self._solve(time, state, (scheme.gain_v, scheme.gain_a, 1.0), None, fresh)
        state.q -= step
        state.v -= scheme.gain_v * step
        state.a -= scheme.gain_a * step
        state.multipliers -= multipliers
        moved = float(np.max(np.abs(step) * self._units, initial=0.0)) if np.all(np.isfinite(step)) else np.inf
        return np.array([self.comm.allreduce(moved, op=MPI.MAX)])

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put the sample back."""
        if samples[0]:
            self._equations.forget()
            for now, before in (
                (state.q, previous.q),
                (state.v, previous.v),
                (state.a, previous.a),
                (state.multipliers, previous.multipliers),
            ):
                now[:] = before

    @property
    def n_events(self) -> int:
        """Number of actions whose law has an edge."""
        return len(self._local.edges)

    def depths(self, time: float, state: State) -> np.ndarray:
        """Return how far each edge is crossed, shape (n_events, 1), the same on all ranks. Collective on `comm`."""
        q, v = self._gather_rows(state.q), self._gather_rows(state.v)
        return self._local.evaluate(time, q[:, None], v[:, None], 0.0).depths[self._local.edges]

    def outside(self, state: State) -> np.ndarray:
        """Return False: the full-order model is valid everywhere."""
        return np.zeros(1, dtype=bool)

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why the sample fails; see `SecondOrderSystem.reasons`. Collective on `comm`."""
        finite = self.comm.allreduce(bool(np.isfinite(state.v).all()), op=MPI.LAND)
        if self._solver_failed:
            return np.array([Status.SOLVER_FAILED])
        return np.array([Status.NOT_CONVERGED if finite else Status.NOT_FINITE])

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Gather a state's array from all ranks as (n, 1), on every rank."""
        return np.concatenate(self.comm.allgather(array))[:, None]

    def frames(self, state: State) -> np.ndarray:
        """Return the frames of all nodes, shape (n_nodes, n_frame, 1), the same on all ranks. Collective on `comm`."""
        return self._equations.frames(self.unpack(state.q))

    def frames_over(self, states: Sequence[State]) -> np.ndarray:
        """Return the frames of all nodes in several states, shape (n_nodes, n_frame, n). Collective on `comm`."""
        return np.concatenate([self.frames(state) for state in states], axis=-1)

    def energies_over(self, times: Sequence[float], states: Sequence[State]) -> Energies:
        """Return energies and powers at several instants, each of shape (n,). Collective on `comm`."""
        return joined([self.energies(time, state) for time, state in zip(times, states)])

    def energies(self, time: float, state: State) -> Energies:
        """Return energies and powers at an instant, the same on all ranks. Collective on `comm`."""
        q, multipliers = self._gather(state)
        v = self._gather_rows(state.v)
        elements = self._elements.evaluate(q, v, 0.0)
        owned = self._elements.owned
        self._a.setArray(state.v)
        self._mass.mult(self._a, self._ma)
        kinetic = 0.5 * float(state.v @ self._ma.getArray(readonly=True))
        # what each rank knows of its own rows and elements; the rest is known to all
        strain = sum(part.strain_energy(q) for part in (self._elements, *self._parts))
        parts = {("kinetic", ""): kinetic, ("strain", ""): strain}
        braked_solids = [(solid, solid.evaluate(q, v, 0.0, fresh=False)) for solid in self._parts if solid.damped]
        for number, name in self._damping.effects.items():
            own = owned & (self._elements.body == number)
            braked = self._elements.lumped_body == number
            lumps = self._elements.lumped_forces(v)[braked] @ v[self._elements.lumped[braked]]
            solid = sum(float(now.powers[part.owned].sum()) for part, now in braked_solids if part.body == number)
            braking = float(elements.powers[own].sum()) + solid - float(lumps)
            parts["power", name] = parts.get(("power", name), 0.0) + braking
        for effect, vector in zip(self._load_effects, self._load_vectors):
            kind, moved = ("potential", -state.q) if effect.conservative else ("power", state.v)
            strength = float(effect.amplitude(time)) * float(vector @ moved)
            parts[kind, effect.name] = parts.get((kind, effect.name), 0.0) + strength
        names = list(parts)
        summed = self.comm.allreduce(np.array([parts[name] for name in names]), op=MPI.SUM)
        total = dict(zip(names, summed[:, None]))
        energies = Energies(total.pop(("kinetic", "")), total.pop(("strain", "")))
        for (kind, name), value in total.items():
            (energies.add_potential if kind == "potential" else energies.add_power)(name, value)
        self._add_local_energies(time, q, v, multipliers, energies)
        return energies

    def _add_local_energies(
        self, time: float, q: np.ndarray, v: np.ndarray, multipliers: np.ndarray, energies: Energies
    ) -> None:
        """Add what every rank knows: actions, modal damping, and the drives of prescribed coordinates."""
        if self._local.n_actions:
            now = self._local.evaluate(time, q[:, None], v[:, None], 0.0)
            for action, power, stored in zip(self._local.actions, now.powers, now.stored):
                energies.add_power(action.effect, power)
                energies.add_potential(action.effect, stored)
        if self._damping.modal:
            nowhere = np.zeros((self.n_dofs, 1))
            for name, power in self._damping.add_modal_forces(q[:, None], v[:, None], nowhere).items():
                energies.add_power(name, power)
        for motion, multiplier in zip(self._motions, multipliers[multipliers.size - len(self._motions) :]):
            energies.add_power(motion.name, np.array([-multiplier * motion.at(time)[1]]))

    def _solve(
        self,
        time: float,
        state: State,
        gains: tuple[float, float, float],
        constraint: np.ndarray | None,
        fresh: bool,
        share: float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the residual and solve for the correction; `constraint` replaces c(q) where given.

        Where the linear solver fails, the correction is no number: the sample is lost, and the others go on. `share` is
        what part of the loads and local effects acts.
        """
        gain_v, gain_a, gain_k = gains
        q, multipliers = self._gather(state)
        self._equations.follow(q, time)
        v = self._gather_rows(state.v) if self._needs_rates else np.zeros_like(q)
        elements = self._elements.evaluate(q, v, gain_v)
        solids = [solid.evaluate(q, v, gain_v, fresh) for solid in self._parts]
        scale = gain_a * self._typical_mass if gain_a else self._typical_stiffness([elements, *solids])
        everywhere = q[:, None]
        jacobian = self._constraints.jacobian_values(everywhere)[:, 0]
        if constraint is None:
            constraint = self._constraints.residual(everywhere, driven(self._motions, time).angle)[:, 0]
        rows, columns = self._constraints.jacobian_pattern
        residual = np.zeros(self.n_dofs)
        for part, now in zip((self._elements, *self._parts), (elements, *solids)):
            np.add.at(residual, part.dofs.ravel(), now.forces.ravel())
        np.add.at(residual, columns, jacobian * multipliers[rows])
        residual[self._elements.lumped] += self._elements.lumped_forces(v)
        tangents = np.zeros(0)
        if self._local.n_actions or self._damping.modal:
            local = np.zeros((self.n_dofs, 1))
            if self._local.n_actions:
                now = self._local.evaluate(time, everywhere, v[:, None], gain_v)
                self._local.add_forces(now, local)
                tangents = share * now.tangents[:, 0]
            local *= share
            self._damping.add_modal_forces(everywhere, v[:, None], local)
            residual -= local[:, 0]
        own = residual[self.rows.start : self.rows.stop]
        self._a.setArray(state.a)
        self._mass.mult(self._a, self._ma)
        own += self._ma.getArray(readonly=True)
        for effect, vector in zip(self._load_effects, self._load_vectors):
            own -= share * effect.amplitude(time) * vector
        if fresh:
            curvature = self._constraints.curvature_values(everywhere, multipliers[:, None])[:, 0]
            found = [now.tangents for now in (elements, *solids)]
            self._assemble(gains, scale, found, jacobian, np.concatenate([curvature, tangents]))
        self._rhs.setArray(np.concatenate([own, scale * constraint[: self._n_multipliers]]))
        n_own = len(self.rows)
        self._solver_failed = not self._solved()
        if self._solver_failed:
            return np.full(n_own, np.nan), np.full(self._n_multipliers, np.nan)
        solution = self._x.getArray(readonly=True)
        return solution[:n_own].copy(), scale * solution[n_own:]

    def _solved(self) -> bool:
        """Solve the linear system; return whether PETSc says that it is solved, the same on all ranks.

        Pivots of multipliers are zero, and MUMPS puts them off until it may run out of the memory that it foresaw: it is
        then given more. What an iteration that ran away made of the system is no matter of memory: it is not solved.
        """
        finite = self._finite_matrix and bool(np.isfinite(self._rhs.getArray(readonly=True)).all())
        if not self.comm.allreduce(finite, op=MPI.LAND):
            return False
        solved = self._solve_once()
        while not solved and self._short_of_memory() and self._spare < MOST_SPARE_MEMORY:
            self._spare *= 4
            preconditioner = self._ksp.getPC()
            preconditioner.reset()  # a matrix that is as it was would not be factorised again
            self._ksp.setOperators(self._matrix)
            preconditioner.setFactorSetUpSolverType()
            preconditioner.getFactorMatrix().setMumpsIcntl(14, self._spare)
            solved = self._solve_once()
        return solved

    def _short_of_memory(self) -> bool:
        preconditioner = self._ksp.getPC()
        direct = preconditioner.getType() == PETSc.PC.Type.LU and preconditioner.getFactorSolverType() == "mumps"
        return direct and preconditioner.getFactorMatrix().getMumpsInfog(1) in SHORT_OF_MEMORY

    def _solve_once(self) -> bool:
        try:
            with petsc_solver(PREFIX, "full-order linear solver"):
                self._ksp.solve(self._rhs, self._x)
            solved = self._ksp.getConvergedReason() > 0
        except RunError:  # a factorisation that ends in an error, or -pgmp_full_ksp_error_if_not_converged
            solved = False
        return bool(self.comm.allreduce(solved, op=MPI.LAND))

    def _typical_stiffness(self, states: Sequence[ElementState | SolidState]) -> float:
        """Return the size of a stiffness: that of the constraints where inertia plays no part. Collective on `comm`."""
        static = (0.0, 0.0, 1.0)
        matrices = [p.matrices(static, s.tangents) for p, s in zip((self._elements, *self._parts), states)]
        diagonals = np.abs(np.concatenate([np.einsum("eii->ei", matrix).ravel() for matrix in matrices]))
        total, count = self.comm.allreduce(np.array([diagonals.sum(), diagonals.size]), op=MPI.SUM)
        return total / count if total > 0.0 else 1.0

    def _numbering(self) -> None:
        """Find which unknowns are needed here, and where element and constraint entries go in this rank's rows."""
        rows, columns = self._constraints.jacobian_pattern
        curved_rows, curved_columns = (
            np.concatenate(parts) for parts in zip(self._constraints.curvature_pattern, self._local.pattern)
        )
        elements, lumped = [part.dofs for part in (self._elements, *self._parts)], self._elements.lumped
        modal = [damping.dofs for damping in self._damping.modal]
        off_diagonal = curved_rows != curved_columns
        self._mirrored = off_diagonal
        self._needed_dofs = np.unique(
            np.concatenate([*(dofs.ravel() for dofs in elements), columns, curved_rows, curved_columns, lumped, *modal])
        )
        i = np.concatenate(
            [
                *(np.repeat(dofs, dofs.shape[1], axis=1).ravel() for dofs in elements),
                columns,
                self.n_dofs + rows,
                curved_rows,
                curved_columns[off_diagonal],
                self.n_dofs + np.arange(self._constraints.n_constraints),
                lumped,
            ]
        )
        j = np.concatenate(
            [
                *(np.tile(dofs, (1, dofs.shape[1])).ravel() for dofs in elements),
                self.n_dofs + rows,
                columns,
                curved_columns,
                curved_rows[off_diagonal],
                self.n_dofs + np.arange(self._constraints.n_constraints),
                lumped,
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
        needed = np.concatenate([self._needed_dofs, self.n_dofs + np.arange(self._constraints.n_constraints)]).astype(
            PETSc.IntType
        )
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
        with petsc_solver(PREFIX, "full-order linear solver"):
            self._ksp.setFromOptions()
        self._spare = SPARE_MEMORY

    def _gather(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return q (n_dofs,), valid where it is needed here, and all multipliers."""
        self._x.setArray(np.concatenate([state.q, state.multipliers]))
        self._scatter.scatter(self._x, self._ghosts, addv=False, mode=PETSc.Scatter.Mode.SCATTER_FORWARD)
        ghosts = self._ghosts.getArray(readonly=True)
        q = np.zeros(self.n_dofs)
        q[self._needed_dofs] = ghosts[: self._needed_dofs.size]
        return q, ghosts[self._needed_dofs.size :].copy()

    def _gather_rows(self, rows: np.ndarray) -> np.ndarray:
        """Return a nodal vector (n_dofs,), valid where it is needed here, from its local rows."""
        self._x.setArray(np.concatenate([rows, np.zeros(self._n_multipliers)]))
        self._scatter.scatter(self._x, self._ghosts, addv=False, mode=PETSc.Scatter.Mode.SCATTER_FORWARD)
        everywhere = np.zeros(self.n_dofs)
        everywhere[self._needed_dofs] = self._ghosts.getArray(readonly=True)[: self._needed_dofs.size]
        return everywhere

    def _assemble(
        self,
        gains: tuple[float, float, float],
        scale: float,
        tangents: Sequence[np.ndarray],
        jacobian: np.ndarray,
        curvature: np.ndarray,
    ) -> None:
        gain_v, gain_a, gain_k = gains
        values = np.concatenate(
            [
                *(part.matrices(gains, now).ravel() for part, now in zip((self._elements, *self._parts), tangents)),
                scale * jacobian,
                scale * jacobian,
                gain_k * curvature,
                gain_k * curvature[self._mirrored],
                np.zeros(self._constraints.n_constraints),
                self._elements.lumped_tangents(gain_v, gain_a),
            ]
        )
        data = np.bincount(self._positions, weights=values[self._chosen], minlength=self._indices.size)
        self._finite_matrix = bool(np.isfinite(data).all())
        self._matrix.setValuesCSR(self._indptr, self._indices, data)
        self._matrix.assemble()
        self._ksp.setOperators(self._matrix)
