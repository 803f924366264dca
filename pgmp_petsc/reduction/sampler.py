"""Modes and reduced matrices at one configuration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pgmp_petsc.effects import Load
from pgmp_petsc.mechanism.body_frames import to_body
from pgmp_petsc.modes.continuity import canonical_rotation
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.modes.static_modes import static_modes
from pgmp_petsc.reduction.snapshots import ParameterSnapshots
from pgmp_petsc.reduction.static_loads import StaticLoads
from pgmp_petsc.reduction.stiffness_changes import InfluenceProbe

# a test's way to spoil signs and order after the solver
Scramble = Callable[[ModeSet], ModeSet]
TABLES = ("eigenvalues", "mass", "inertia", "stiffness", "load", "canonical", "influence")


@dataclass(frozen=True, eq=False)
class Sample:
    """What a group of ranks computed at one configuration, in the eigensolver's own basis.

    The kept vectors are the eigenmodes, ascending, and after them the static modes of the loads. Snapshots of every
    parameter point follow, M-orthogonal to them: candidates, of which the build takes a few combinations.

    Attributes
    ----------
    eigenvalues
        Full-order eigenvalues at the nominal parameters, shape (n_modes,), (rad/s)^2.
    mass, inertia, stiffness, load
        As in `ReducedTables`, at this configuration.
    canonical
        Rotation that fixes the signs of the kept vectors by itself, shape (n_kept, n_kept).
    shape
        Flexible vectors V in body frames, local rows, shape (n_local, n_kept + n_snapshots).
    mass_kept
        M times the kept vectors, local rows, shape (n_local, n_kept).
    influence
        Of loads on the stiffness of the eigenmodes (`stiffness_changes`), shape (n_modes, n_columns); without columns
        where it is not wanted.
    """

    eigenvalues: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray
    stiffness: np.ndarray
    load: np.ndarray
    canonical: np.ndarray
    shape: np.ndarray
    mass_kept: np.ndarray
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
    """Computes samples. Collective on the problem's communicator.

    Parameters
    ----------
    problem
        Eigenproblem at the nominal parameters.
    loads
        Load terms of the scene, local rows, inertial frame.
    static_loads
        Loads whose static answers extend the basis.
    snapshots
        Snapshots at other parameter values, or None.
    probe
        Of the influence of loads on the stiffness of modes, or None.
    """

    def __init__(
        self,
        problem: ModalProblem,
        loads: Sequence[Load],
        static_loads: StaticLoads,
        snapshots: ParameterSnapshots | None = None,
        probe: InfluenceProbe | None = None,
    ) -> None:
        self.problem = problem
        mechanism = problem.mechanism
        self._mass = [problem.matrices.mass[w] for w in mechanism.mass_weights]
        self._stiffness = [problem.matrices.stiffness[w] for w in mechanism.stiffness_weights]
        self._loads = loads
        self._static_loads = static_loads
        self._snapshots = snapshots
        self._probe = probe

    def sample(self, theta: np.ndarray, scramble: Scramble) -> Sample:
        """Sample one configuration (n_theta,), rad.

        Raises
        ------
        RunError
            If the eigensolver fails; see `ModalProblem.solve`.
        """
        problem = self.problem
        modes = _ascending(scramble(problem.solve(theta)))
        loads = turned_loads(problem, self._loads, theta)
        static = static_modes(problem, modes, self._static_loads.at(problem, modes))
        shape = kept = np.hstack([modes.flexible, static])
        if self._snapshots is not None:
            missed = self._snapshots.missed(
                self._snapshots.at(theta, kept), np.hstack([modes.rigid[:, modes.free], kept])
            )
            shape = np.hstack([kept, missed])
        basis = np.hstack([modes.rigid, shape])
        return Sample(
            eigenvalues=modes.eigenvalues,
            mass=self._project(self._mass, basis),
            inertia=self._project_inertia(modes.rigid_curvature, shape),
            stiffness=self._project(self._stiffness, shape),
            load=problem.inner(loads, basis),
            canonical=self._canonical(modes, kept.shape[1]),
            shape=shape,
            mass_kept=problem.times_mass(kept),
            influence=np.zeros((0, 0)) if self._probe is None else self._probe.at(modes, loads),
        )

    def _canonical(self, modes: ModeSet, n_kept: int) -> np.ndarray:
        """Return the rotation that fixes the modes' signs whatever the solver made of them."""
        n_modes = modes.flexible.shape[1]
        waves = self._waves(n_modes)
        rotation = np.eye(n_kept)
        probe = self.problem.inner(modes.flexible, waves)
        rotation[:n_modes, :n_modes] = canonical_rotation(modes.eigenvalues, probe)
        return rotation

    def _waves(self, n_waves: int) -> np.ndarray:
        """Return incommensurate waves, local rows: no mode shape of any mesh is orthogonal to its own one but by
        accident.

        Internal coordinates of condensed bodies have no meaning of their own; the waves over the bodies' meshes have.
        """
        mechanism, rows = self.problem.mechanism, self.problem.rows
        numbers = np.arange(mechanism.n_dofs)
        waves = np.cos(
            np.outer(1.0 + numbers * (np.sqrt(5.0) / mechanism.n_dofs), 1.0 + np.sqrt(2.0) * np.arange(1, n_waves + 1))
        )
        for body in mechanism.bodies:
            if body.component is not None:
                probes = body.component.probes
                waves[body.dofs] = probes[:, np.arange(n_waves) % probes.shape[1]]
        return waves[rows.start : rows.stop]

    def _project(self, terms: Sequence, basis: np.ndarray) -> np.ndarray:
        everywhere = self.problem.all_rows(basis)
        products = [self.problem.inner(basis, term @ everywhere) for term in terms]
        return np.array([0.5 * (product + product.T) for product in products])

    def _project_inertia(self, curvature: np.ndarray, shape: np.ndarray) -> np.ndarray:
        n_theta = curvature.shape[1]
        everywhere = self.problem.all_rows(shape)
        columns = curvature.reshape(len(curvature), n_theta**2)
        products = [self.problem.inner(columns, term @ everywhere) for term in self._mass]
        return np.array(products).reshape(len(self._mass), n_theta, n_theta, -1)


def turned_loads(problem: ModalProblem, loads: Sequence[Load], theta: np.ndarray) -> np.ndarray:
    """Return load vectors in body frames at a configuration (n_theta,), local rows, shape (n_local, n_loads)."""
    if not loads:
        return np.zeros((len(problem.rows), 0))
    poses = problem.kinematics.motion(theta).poses
    own = slice(problem.rows.start, problem.rows.stop)
    vectors = problem.all_rows(np.array([load.vector for load in loads]).T)
    turned = to_body(problem.mechanism, poses, vectors)[own]
    for column, load in enumerate(loads):
        if load.in_bodies:
            turned[:, column] = load.vector
        elif load.body_force is not None:
            weight, field = load.body_force
            turned[:, column] = problem.matrices.mass[weight] @ to_body(problem.mechanism, poses, field)
    return turned


def _ascending(modes: ModeSet) -> ModeSet:
    order = np.argsort(modes.eigenvalues, kind="stable")
    return replace(modes, eigenvalues=modes.eigenvalues[order], flexible=modes.flexible[:, order])
