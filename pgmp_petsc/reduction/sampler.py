"""Vectors and reduced matrices at one configuration: loads whose static answers extend the basis, vectors of other
parameter values, and samples.

The snapshots X(theta) of other parameter values, modes and static modes that the basis of the nominal ones misses,
M-orthogonal to the kept vectors, are compressed by one constant matrix C, the leading eigenvectors of the mean Gram
matrix ``mean_k X_k^T M X_k``; the values are a greedy choice among those that span the distributions (docs/method.md,
parameters far from nominal).

`InfluenceProbe` has the influences of unit loads on the stiffness of the modes (`tables`), `BuiltInStress` that of
joints that are off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
from scipy.linalg import block_diag

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import incommensurate
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.effects import Action, Load, Patterns
from pgmp_petsc.effects.effect import UnitForces
from pgmp_petsc.mechanism.continuation import tensor_grid
from pgmp_petsc.mechanism.mechanism import to_body
from pgmp_petsc.modes.built_in import BuiltIn
from pgmp_petsc.modes.continuity import canonical_rotation
from pgmp_petsc.modes.curvature import CurvatureProblem
from pgmp_petsc.modes.problem import DEPENDENT_TOLERANCE, ModalProblem, ModeSet
from pgmp_petsc.modes.static_modes import dependent_loads, off_symmetry, static_modes
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.cell_products import symmetric, unpacked
from pgmp_petsc.reduction.sample_grid import ParameterPoints
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.scene.parameters import spanning_values
from pgmp_petsc.scene.uses import offset_values

NO_INERTIA = 1e-24  # a square: of inertia forces, beside those of the largest velocity of the rigid motion


@dataclass(frozen=True, eq=False)
class StaticLoads:
    """Load patterns of the effects, and the inertia forces of the rigid motion."""

    #: independent load patterns of the effects that are the same in any configuration, local rows, shape (n_local,
    #: n_patterns)
    patterns: np.ndarray
    #: forces of actions that turn with the configuration, a further load each; of several that are parallel everywhere
    #: the first
    turning: UnitForces
    #: numbers of the independent ones among the accelerations of `_accelerations`, whose inertia forces are further
    #: loads, shape (n_inertia,)
    accelerations: np.ndarray

    @classmethod
    def of(cls, problem: ModalProblem, patterns: Patterns, reduction: Reduction) -> StaticLoads:
        """Return the loads that a scene asks for, those that depend on others left out; the problem is moved.

        Of the load patterns of the effects all are used where static modes are wanted, and those of linear springs
        where nothing is said against them. Raises `InputError` if the mesh has too few degrees of freedom for the whole
        basis.
        """
        wanted = patterns.wanted(reduction)
        accelerations = _independent(problem) if reduction.inertia_modes else np.zeros(0, dtype=int)
        turning = UnitForces(wanted.turning, problem.mechanism)
        turning = turning.chosen(_independent_forces(problem, turning))
        loads = cls(problem.independent(wanted.fixed), turning, accelerations)._answered(problem)
        n_static = loads.patterns.shape[1] + len(loads.turning.actions) + loads.accelerations.size
        return loads if problem.keep(reduction, n_static) else loads._chosen(np.zeros(n_static, dtype=bool))

    def _answered(self, problem: ModalProblem) -> StaticLoads:
        """Return the loads without those whose answers are combinations of others wherever they are tried.

        A guide takes up a part of the weight of a rigid body, for one: its answers along two axes are then the same
        one.
        """
        n_fixed, n_turning = self.patterns.shape[1], len(self.turning.actions)
        if not n_fixed + n_turning + self.accelerations.size:
            return self
        found = []
        for theta in off_symmetry(problem.kinematics):
            modes = problem.solve(theta)
            found.append(dependent_loads(problem, modes, self.at(problem, modes)))
        return self._chosen(~np.all(found, axis=0))

    def _chosen(self, kept: np.ndarray) -> StaticLoads:
        """Return those of the loads that a mask over all of them has."""
        n_fixed = self.patterns.shape[1]
        fixed, turning, inertia = np.split(kept, [n_fixed, n_fixed + len(self.turning.actions)])
        return StaticLoads(self.patterns[:, fixed], self.turning.chosen(turning), self.accelerations[inertia])

    def at(self, problem: ModalProblem, modes: ModeSet) -> np.ndarray:
        """Return the loads at a configuration and the parameter values of a problem, shape (n_local, n_loads)."""
        terms = self.terms_at(problem, modes).items()
        return sum(float(weight.evaluate(problem.values)) * term for weight, term in terms)

    def terms_at(self, problem: ModalProblem, modes: ModeSet) -> dict[Monomial, np.ndarray]:
        """Return the affine terms of the loads at a configuration by their weights, each of shape (n_local, n_loads);
        of every mass term there is one."""
        acting = np.hstack([self.patterns, _forces(problem, self.turning, modes.theta)])
        moving = _accelerations(problem, modes.rigid, modes.rigid_curvature)[:, self.accelerations]
        everywhere, found = problem.all_rows(moving), {Monomial(): np.zeros((len(acting), self.accelerations.size))}
        for weight, term in problem.matrices.mass.items():
            found[weight] = term @ everywhere
        k, j = np.tril_indices(modes.rigid.shape[1])
        curved = self.accelerations < k.size  # the others are velocities of prescribed coordinates
        for weight, forces in problem.lost_inertia(modes.theta).items():
            found[weight][:, curved] += forces[:, k, j][:, self.accelerations[curved]]
        return {
            weight: np.hstack([acting if weight == Monomial() else np.zeros_like(acting), inertia])
            for weight, inertia in found.items()
        }


def _accelerations(problem: ModalProblem, rigid: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """Return the accelerations of the rigid motion whose inertia forces the flexible vectors have to answer.

    ``d2 rho/d theta2``, each pair of coordinates once, those of a mechanism that moves at constant speed; and ``d rho/d
    theta`` of the prescribed coordinates, shape (n_local, n_accelerations).
    """
    n_theta = rigid.shape[1]
    pairs = [(k, j) for k in range(n_theta) for j in range(k + 1)]
    driven = [k for k in range(n_theta) if k not in problem.free]
    return np.stack([*(curvature[:, k, j] for k, j in pairs), *(rigid[:, k] for k in driven)], axis=1)


def _forces(problem: ModalProblem, turning: UnitForces, theta: np.ndarray) -> np.ndarray:
    """Return unit forces at a configuration, in body frames, local rows, shape (n_local, n_actions)."""
    return turning.at(problem.kinematics.motion(theta).poses)[problem.rows.start : problem.rows.stop]


def _independent_forces(problem: ModalProblem, turning: UnitForces) -> np.ndarray:
    """Return the numbers of the actions whose force is no combination, the same everywhere, of those before them."""
    if not turning.actions:
        return np.zeros(0, dtype=int)
    forces = [_forces(problem, turning, theta) for theta in off_symmetry(problem.kinematics)]
    return _independent_columns(sum(problem.inner(force, force) for force in forces))


def _independent(problem: ModalProblem) -> np.ndarray:
    """Return the numbers of the accelerations that are no combination, the same everywhere, of those before them, and
    more than round-off: a balanced rotor has none about its axis."""
    gram = largest = 0.0
    for theta in off_symmetry(problem.kinematics):
        rigid, curvature = problem.rigid_motion(theta)
        moving = _accelerations(problem, rigid, curvature)
        gram = gram + problem.inner(moving, problem.times_mass(moving))
        largest = largest + np.max(np.diag(problem.inner(rigid, problem.times_mass(rigid))))
    gram[np.diag(gram) < NO_INERTIA * largest] = 0.0
    return _independent_columns(gram)


def _independent_columns(gram: np.ndarray) -> np.ndarray:
    """Return the numbers of the vectors that are no combination of those before them, from their products (n, n)."""
    sizes = np.diag(gram)  # none of a motion that does not bend its way, as on a rail
    scale = 1.0 / np.sqrt(np.where(sizes > 0.0, sizes, 1.0))
    gram, chosen = gram * scale * scale[:, None], []
    for k in range(len(gram)):
        before = np.linalg.lstsq(gram[np.ix_(chosen, chosen)], gram[chosen, k], rcond=None)[0]
        # a square: round-off leaves 1e-16 of what is dependent
        if gram[k, k] - gram[k, chosen] @ before > DEPENDENT_TOLERANCE:
            chosen.append(k)
    return np.array(chosen, dtype=int)


class InfluenceProbe:
    """Computes influences of local effects at any configuration. Collective on the problem's communicator.

    The problem is at the nominal parameters; the third derivative of its bodies' strain energy is known.
    """

    def __init__(self, problem: ModalProblem, actions: Sequence[Action]) -> None:
        self._problem = problem
        self._curvature = CurvatureProblem(problem)
        self._forces = UnitForces(actions, problem.mechanism)
        self._pairs = np.tril_indices(problem.kinematics.n_coordinates)
        masses = [problem.matrices.mass[weight] for weight in problem.mechanism.mass_weights]
        self._mass = sp.vstack(masses, format="csr")

    def at(self, modes: ModeSet, loads: np.ndarray) -> np.ndarray:
        """Return the influences at the configuration that the problem is at, shape (n_modes, n_columns), of the modes
        there and load terms in body frames, local rows, shape (n_local, n_loads)."""
        problem = self._problem
        answers = self._curvature.stiffness_answers(modes)
        motion = problem.kinematics.motion(modes.theta)
        turned = self._forces.at(motion.poses)[problem.rows.start : problem.rows.stop]
        k, j = self._pairs
        moving = np.hstack([modes.rigid, modes.rigid_curvature[:, k, j]])
        inertia = (self._mass @ problem.all_rows(moving)).reshape(-1, *moving.shape)
        for weight, forces in problem.lost_inertia(modes.theta).items():
            inertia[problem.mechanism.mass_weights.index(weight), :, modes.rigid.shape[1] :] += forces[:, k, j]
        found = problem.inner(answers, np.hstack([loads, turned, *-inertia]))
        # of accelerations, their work on the directors' part of second order: chi_kk of the modes' own, less
        fields = np.concatenate([motion.velocities, motion.accelerations[:, :, k, j]], axis=2)
        vectors, each = problem.all_rows(modes.flexible), (np.arange(modes.flexible.shape[1]),) * 2
        influences = found[:, loads.shape[1] + turned.shape[1] :]
        for t, weight in enumerate(problem.mechanism.mass_weights):
            columns = slice(t * fields.shape[2], (t + 1) * fields.shape[2])
            influences[:, columns] += self._curvature.rotary.work(fields, vectors, each, weight).T
        return found


class BuiltInStress:
    """Stiffness by the stress that joints build in where they are off, for modes. Collective on the problem's
    communicator.

    The problem is at the nominal parameters; the third derivative of its bodies' strain energy is known. Scene and
    shapes are as of `BuiltIn`; the scene has the offsets.
    """

    def __init__(self, problem: ModalProblem, scene: Scene, shapes: Mapping[str, BodyShape]) -> None:
        self._problem, self._built_in = problem, BuiltIn(problem, scene, shapes)
        self._curvature = CurvatureProblem(problem, built_in=self._built_in)
        self._offsets = offset_values(scene, scene.values)

    def at(self, modes: ModeSet) -> np.ndarray:
        """Return it in the modes, ``Psi^T K Psi``, shape (n_modes, n_modes), of first order in the offsets.

        Raises what `BuiltIn.at` and `CurvatureProblem.solve` raise.
        """
        problem, n = self._problem, modes.flexible.shape[1]
        if not self._offsets.size:
            return np.zeros((n, n))
        inertia = modes.eigenvalues * problem.times_mass(modes.flexible)
        shape = np.hstack([modes.flexible, self._built_in.at(modes)])
        found = self._curvature.solve(modes, shape, np.pad(inertia, ((0, 0), (0, self._offsets.size))))
        forces = problem.times_stiffness(found.chi)
        for weight, part in found.third.items():
            forces += float(weight.evaluate(problem.values)) / 3.0 * part
        return 3.0 * symmetric(unpacked(problem.inner(shape, forces)))[:n, :n, n:] @ self._offsets


class ParameterSnapshots(AbstractContextManager):
    """Bases at points of given values of all parameters. Collective on the problem's communicator.

    The problem is at the nominal parameters; loads are what static modes answer.
    """

    def __init__(self, problem: ModalProblem, loads: StaticLoads, points: Sequence[Mapping[str, float]]) -> None:
        self.problem, self.loads = problem, loads
        self.problems = [problem.at_values(values) for values in points]

    def __exit__(self, *error: object) -> None:
        for problem in self.problems:
            problem.close()

    def at(self, theta: np.ndarray, kept: np.ndarray) -> list[np.ndarray]:
        """Return the snapshots of every point at a configuration, shape (n_theta,), rad, each of the shape of `kept`,
        nominal modes and static modes there, local rows, shape (n_local, n_kept).

        They are the projections, in the point's own mass norm, of the nominal vectors onto the space of the point's
        modes and static modes.
        """
        found = []
        for problem in self.problems:
            modes = problem.solve(theta)
            own = np.hstack([modes.flexible, static_modes(problem, modes, self.loads.at)])
            found.append(own @ problem.inner(own, problem.times_mass(kept)))
        return found

    def missed(self, snapshots: Sequence[np.ndarray], kept: np.ndarray) -> np.ndarray:
        """Return what vectors leave of the snapshots of `at`, side by side, M-orthogonal to them at the nominal
        parameters.

        `kept` are free rigid and flexible vectors that the basis has, shape (n_local, n_kept).
        """
        if not snapshots:
            return np.empty((len(kept), 0))
        rest = np.hstack(snapshots)
        for _ in range(2):
            rest = rest - self.problem.onto(kept, rest)
        return rest


# Smallest eigenvalue of ``E^T M E`` at any configuration; its mean is 1. Tables of vectors that nearly vanish somewhere
# are interpolated badly there: with 1e-4 the slider-crank's deformation errs by percents, with 1e-2 no more than
# elsewhere; with 1e-3 made orthonormal they turn within 0.03 rad over the size's own rate.
INDEPENDENT = 1e-2
ROUND_OFF = 1e-10  # mean squares below this share of the largest one


@dataclass(frozen=True, eq=False)
class Compression:
    """The vectors that a basis takes from the snapshots."""

    matrix: np.ndarray  # c, shape (n_snapshots, n_parameter)
    #: whether a vector changes its sign after a revolution of each coordinate, shape (n_theta, n_parameter)
    flips: np.ndarray

    @classmethod
    def of(cls, grams: np.ndarray, flipped: np.ndarray, n_parameter: int) -> Compression:
        """Find the leading `n_parameter` vectors that are independent at every configuration, or as many as there are:
        where one vanishes, the reduced mass would be singular. Gram matrices are those of the snapshots in the
        continuous basis, shape (n, n_snapshots, n_snapshots).

        `flipped` tells whether a snapshot changes its sign after a revolution of each coordinate, shape (n_theta,
        n_snapshots): over two of them, those that do are orthogonal to those that do not.
        """
        mean = np.where((flipped[:, :, None] == flipped[:, None, :]).all(axis=0), grams.mean(axis=0), 0.0)
        squares, vectors = np.linalg.eigh(mean)
        squares, vectors = squares[::-1], vectors[:, ::-1]
        # the leading ones that are independent everywhere of those before them; one that vanishes somewhere, as the
        # answer to a spring does where that lies along a bar, is passed over
        n = int(np.sum(squares > ROUND_OFF * squares[:1]))
        scaled = vectors[:, :n] / np.sqrt(squares[:n])
        everywhere, chosen = scaled.T @ grams @ scaled, []
        for k in range(n):
            tried = [*chosen, k]
            of = everywhere[:, tried][:, :, tried]
            if len(chosen) < n_parameter and np.linalg.eigvalsh(of)[:, 0].min() >= INDEPENDENT:
                chosen = tried
        squares, vectors = squares[chosen], vectors[:, chosen]
        largest = np.argmax(np.abs(vectors), axis=0)
        signs = np.sign(vectors[largest, range(len(chosen))])
        return cls(signs * vectors / np.sqrt(squares), flipped[:, largest])

    def holds(self, grams: np.ndarray) -> bool:
        """Return whether the vectors are independent at every configuration of Gram matrices (n, n_snapshots,
        n_snapshots), which may be other ones than they were found at."""
        return bool(np.linalg.eigvalsh(self.matrix.T @ grams @ self.matrix).min(initial=np.inf) >= INDEPENDENT)

    def beside(self, n_kept: int, n_given: int) -> np.ndarray:
        """Return the matrix leaving kept vectors before, and given ones after these, as they are, shape (n_kept +
        n_snapshots + n_given, n_kept + n_parameter + n_given)."""
        return block_diag(np.eye(n_kept), self.matrix, np.eye(n_given))


N_CONFIGURATIONS = 8  # at least, over the middles of a grid
MOST_POINTS = 4
GAIN = 0.9  # a further point leaves less than this of the largest share, or is not worth its eigenproblems
DIGITS = 6  # of the shares that are compared: round-off must not choose


def choose_points(scene: Scene, problem: ModalProblem, loads: StaticLoads, group: RankGroup) -> ParameterPoints:
    """Choose the points for ``reduction.parameter_modes``. Collective on ``group.world``; the same on all ranks.

    The problem is at the nominal parameters; loads are what static modes answer. Raises `InputError` if no parameter
    has a distribution: there is nowhere to take modes; `RunError` if an eigenproblem fails.
    """
    if not scene.reduction.parameter_modes:
        return ParameterPoints.none()
    spanned, n_samples = spanning_values(scene)
    candidates = [{name: float(column[k]) for name, column in spanned.items()} for k in range(1, n_samples)]
    if not candidates:
        raise InputError(
            f"reduction.parameter_modes = {scene.reduction.parameter_modes}: no parameter has a distribution (or a "
            "value beside the nominal one) to take modes at; give one, or leave parameter_modes out"
        )
    # configurations spread over the range, shape (n, n_theta)
    coordinates = problem.kinematics.coordinates
    n = int(np.ceil(N_CONFIGURATIONS ** (1.0 / len(coordinates))))
    axes = [c.lower + (c.upper - c.lower) * (np.arange(n) + 0.5) / n for c in coordinates]
    middles = tensor_grid(axes)
    own = middles[list(group.arc(len(middles)))]

    def shares(chosen: Sequence[int]) -> np.ndarray:
        """Return the largest missed share of every candidate over the configurations, shape (n_candidates,)."""
        worst = np.zeros(len(candidates))
        for configuration in configurations:
            worst = np.maximum(worst, configuration.shares(snapshots, chosen, scene.reduction.parameter_modes))
        return np.round(np.max(group.world.allgather(worst), axis=0), DIGITS)

    with ExitStack() as stack:
        with agreed(group.world, "choice of parameter points"):
            snapshots = stack.enter_context(ParameterSnapshots(problem, loads, candidates if own.size else ()))
            configurations = [_Configuration.of(snapshots, theta) for theta in own]
        chosen: list[int] = []
        current = shares(chosen)
        missed = [current.max()]
        # where nothing is missed, as with parameters of forces alone, a point gives vectors of round-off
        while current.max() > 0.0 and len(chosen) < min(MOST_POINTS, len(candidates)):
            trial = [*chosen, int(np.argmax(current))]
            found = shares(trial)
            if trial[-1] in chosen or (chosen and found.max() > GAIN * current.max()):
                break
            chosen, current = trial, found
            missed.append(current.max())
    values = {name: np.array([candidates[k][name] for k in chosen]) for name in spanned}
    return ParameterPoints(scene.reduction.parameter_modes, np.array(missed), values)


@dataclass(frozen=True, eq=False)
class _Configuration:
    """The kept flexible vectors V, and X, what they leave of all snapshots, at one configuration; local rows."""

    kept: np.ndarray  # shape (n_local, n_kept)
    rest: np.ndarray  # shape (n_candidates, n_local, q)
    #: ``V^T M`` times the whole snapshots, which are V times these plus X (plus a rigid motion, which strains nothing),
    #: shape (n_candidates, n_kept, q)
    coefficients: np.ndarray

    @classmethod
    def of(cls, snapshots: ParameterSnapshots, theta: np.ndarray) -> _Configuration:
        """Compute the vectors."""
        problem = snapshots.problem
        modes = problem.solve(theta)
        kept = np.hstack([modes.flexible, static_modes(problem, modes, snapshots.loads.at)])
        found = snapshots.at(theta, kept)
        rest = snapshots.missed(found, np.hstack([modes.unstrained, kept]))
        along = problem.inner(kept, problem.times_mass(np.hstack(found)))
        return cls(kept, *(np.stack(np.hsplit(part, len(found))) for part in (rest, along)))

    def shares(self, snapshots: ParameterSnapshots, chosen: Sequence[int], n_vectors: int) -> np.ndarray:
        """Return the missed share of the energy norm of every candidate, shape (n_candidates,)."""
        problem, basis = snapshots.problem, self.kept
        if chosen:
            own = np.hstack(self.rest[list(chosen)])
            squares, vectors = np.linalg.eigh(problem.inner(own, problem.times_mass(own)))
            leading = vectors[:, squares > ROUND_OFF * squares[-1]][:, ::-1][:, :n_vectors]
            basis = np.hstack([basis, own @ leading])
        worst = np.empty(len(snapshots.problems))
        for candidate, other in enumerate(snapshots.problems):
            snapshot = self.kept @ self.coefficients[candidate] + self.rest[candidate]
            forces = other.times_stiffness(basis)
            inner = problem.inner(forces, basis)
            scale = 1.0 / np.sqrt(np.diag(inner))
            missed = scale[:, None] * problem.inner(forces, snapshot)
            projected = np.linalg.solve(inner * scale * scale[:, None], missed)
            rest = snapshot - basis @ (scale[:, None] * projected)
            both = np.hstack([rest, snapshot])
            energies = np.maximum(np.diag(problem.inner(both, other.times_stiffness(both))), 0.0)
            worst[candidate] = np.sqrt(np.max(energies[: rest.shape[1]] / energies[rest.shape[1] :]))
        return worst


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
