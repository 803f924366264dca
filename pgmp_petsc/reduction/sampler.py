"""Modes and reduced matrices at one configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.component import incommensurate
from pgmp_petsc.effects import Load
from pgmp_petsc.mechanism.mechanism import to_body
from pgmp_petsc.modes.built_in import BuiltIn
from pgmp_petsc.modes.continuity import canonical_rotation
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.modes.static_modes import static_modes
from pgmp_petsc.reduction.snapshots import ParameterSnapshots
from pgmp_petsc.reduction.static_loads import InfluenceProbe, StaticLoads

# a test's way to spoil signs and order after the solver
Scramble = Callable[[ModeSet], ModeSet]
DENSE = 0.1  # share of entries from which on a matrix is multiplied as a dense one
TABLES = ("eigenvalues", "mass", "inertia", "stiffness", "load", "canonical", "influence")


@dataclass(frozen=True, eq=False)
class Sample:
    """Results of a group of ranks at one configuration, in the eigensolver's own basis.

    The kept vectors are the eigenmodes, ascending, after them what elastic joints allow, and the static modes of the
    loads. Snapshots of every parameter point follow, M-orthogonal to them: candidates, of which the build takes a few
    combinations. Tables are of all these, and last of what joints that are off build in.
    """

    eigenvalues: np.ndarray  # full-order eigenvalues at the nominal parameters, shape (n_modes,), (rad/s)^2
    #: mass, inertia, stiffness, load: as in `ReducedTables`, at this configuration
    mass: np.ndarray
    inertia: np.ndarray
    stiffness: np.ndarray
    load: np.ndarray
    canonical: np.ndarray  # rotation that fixes the signs of the kept vectors by itself, shape (n_kept, n_kept)
    shape: np.ndarray  # flexible vectors V in body frames, local rows, shape (n_local, n_kept + n_snapshots)
    mass_kept: np.ndarray  # m times the kept vectors, local rows, shape (n_local, n_kept)
    built_in: np.ndarray  # what joints that are off build in, local rows, shape (n_local, n_given)
    #: of loads on the stiffness of the eigenmodes (`stiffness_changes`), shape (n_modes, n_columns); without columns
    #: where it is not wanted
    influence: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def n_modes(self) -> int:
        """Number of eigenmodes."""
        return self.eigenvalues.size

    @property
    def n_kept(self) -> int:
        """Number of kept vectors."""
        return self.mass_kept.shape[1]

    @property
    def kept(self) -> np.ndarray:
        """The kept vectors, local rows, shape (n_local, n_kept)."""
        return self.shape[:, : self.n_kept]


class Sampler:
    """Computes samples at the nominal parameters. Collective on the problem's communicator.

    Load terms of the scene are local rows in the inertial frame; answers to the static loads extend the basis. Without
    snapshots at other parameter values, a probe of the influence of loads on the stiffness of modes, or what joints
    that are off build in, these are None.
    """

    def __init__(
        self,
        problem: ModalProblem,
        loads: Sequence[Load],
        static_loads: StaticLoads,
        snapshots: ParameterSnapshots | None = None,
        probe: InfluenceProbe | None = None,
        built_in: BuiltIn | None = None,
    ) -> None:
        self.problem = problem
        mechanism = problem.mechanism
        self._mass = _stacked([problem.matrices.mass[w] for w in mechanism.mass_weights])
        self._stiffness = _stacked([problem.matrices.stiffness[w] for w in mechanism.stiffness_weights])
        self._loads = TurnedLoads(problem, loads)
        # no mode shape of any mesh is orthogonal to its own wave but by accident; internal coordinates of condensed
        # bodies have no meaning of their own: the waves over the bodies' meshes have
        n_waves = problem.n_modes
        waves = incommensurate(np.arange(mechanism.n_dofs), mechanism.n_dofs, np.arange(1, n_waves + 1))
        for body in mechanism.bodies:
            if body.probes is not None:
                waves[body.dofs] = body.probes[:, np.arange(n_waves) % body.probes.shape[1]]
        self._waves = waves[problem.rows.start : problem.rows.stop]
        self._static_loads = static_loads
        self._snapshots = snapshots
        self._probe, self._built_in = probe, built_in

    def sample(self, theta: np.ndarray, scramble: Scramble) -> Sample:
        """Sample one configuration (n_theta,), rad.

        Raises `RunError` if the eigensolver fails; see `ModalProblem.solve`.
        """
        problem = self.problem
        modes = scramble(problem.solve(theta))
        order = np.argsort(modes.eigenvalues, kind="stable")
        modes = replace(modes, eigenvalues=modes.eigenvalues[order], flexible=modes.flexible[:, order])
        loads = self._loads.at(theta)
        static = static_modes(problem, modes, self._static_loads.at)
        shape = kept = np.hstack([modes.kept, static])
        if self._snapshots is not None:
            missed = self._snapshots.missed(
                self._snapshots.at(theta, kept), np.hstack([modes.rigid[:, modes.free], kept])
            )
            shape = np.hstack([kept, missed])
        built_in = shape[:, :0] if self._built_in is None else self._built_in.at(modes)
        flexible = np.hstack([shape, built_in])
        basis = np.hstack([modes.rigid, flexible])
        n_theta = modes.rigid.shape[1]
        inertia = self._times(self._mass, basis)
        stiffness = _symmetric(problem.inner(flexible, self._times(self._stiffness, flexible)))
        released = slice(problem.n_modes, problem.n_modes + problem.n_released)
        stiffness[:, released] = stiffness[:, :, released] = 0.0  # but for round-off
        return Sample(
            eigenvalues=modes.eigenvalues,
            mass=_symmetric(problem.inner(basis, inertia)),
            inertia=problem.work_of_motion(modes, flexible, inertia[..., n_theta:]),
            stiffness=stiffness,
            load=problem.inner(loads, basis),
            canonical=self._canonical(modes, kept.shape[1]),
            shape=shape,
            mass_kept=problem.times_mass(kept),
            built_in=built_in,
            influence=np.zeros((0, 0)) if self._probe is None else self._probe.at(modes, loads),
        )

    def _canonical(self, modes: ModeSet, n_kept: int) -> np.ndarray:
        """Return the rotation that fixes the modes' signs whatever the solver made of them."""
        n_modes = modes.flexible.shape[1]
        rotation = np.eye(n_kept)
        probe = self.problem.inner(modes.flexible, self._waves[:, :n_modes])
        rotation[:n_modes, :n_modes] = canonical_rotation(modes.eigenvalues, probe)
        return rotation

    def _times(self, terms: sp.csr_matrix | np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return stacked terms times local columns (n_local, k), shape (n_terms, n_local, k)."""
        return (terms @ self.problem.all_rows(columns)).reshape(-1, *columns.shape)


class TurnedLoads:
    """Load vectors in body frames at any configuration, on the problem's ranks.

    Terms are local rows in the inertial frame but for those that are constant in the frames of the bodies.
    """

    def __init__(self, problem: ModalProblem, loads: Sequence[Load]) -> None:
        self._problem, self._loads = problem, loads
        self._vectors = np.array([load.vector for load in loads]).reshape(len(loads), len(problem.rows)).T
        self._turning = [k for k, load in enumerate(loads) if not load.in_bodies and load.body_force is None]
        self._everywhere = problem.all_rows(self._vectors[:, self._turning])

    def at(self, theta: np.ndarray) -> np.ndarray:
        """Return the vectors at a configuration (n_theta,), local rows, shape (n_local, n_loads)."""
        problem, turned = self._problem, self._vectors.copy()
        poses = problem.kinematics.motion(theta).poses
        if self._turning:
            own = slice(problem.rows.start, problem.rows.stop)
            turned[:, self._turning] = to_body(problem.mechanism, poses, self._everywhere)[own]
        for column, load in enumerate(self._loads):
            if load.body_force is not None and not load.in_bodies:
                weight, field = load.body_force
                turned[:, column] = problem.matrices.mass[weight] @ to_body(problem.mechanism, poses, field)
        return turned


def _stacked(terms: Sequence[sp.csr_matrix]) -> sp.csr_matrix | np.ndarray:
    """Return terms below each other, their products with vectors are one; dense where that is not much more."""
    stacked = sp.vstack(terms, format="csr")
    return stacked.toarray() if stacked.nnz > DENSE * math.prod(stacked.shape) else stacked


def _symmetric(matrices: np.ndarray) -> np.ndarray:
    """Return the symmetric parts of matrices (n, k, k)."""
    return 0.5 * (matrices + np.swapaxes(matrices, 1, 2))
