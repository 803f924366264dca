"""The loads whose static answers extend the basis, at any configuration and parameter values, in body frames.

`InfluenceProbe` has the influences of unit loads on the stiffness of the modes (`tables`), `BuiltInStress` that of
joints that are off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.effects import Action, Patterns
from pgmp_petsc.effects.effect import UnitForces
from pgmp_petsc.modes.built_in import BuiltIn
from pgmp_petsc.modes.curvature import CurvatureProblem
from pgmp_petsc.modes.problem import DEPENDENT_TOLERANCE, ModalProblem, ModeSet
from pgmp_petsc.modes.static_modes import dependent_loads, off_symmetry
from pgmp_petsc.reduction.cell_products import symmetric, unpacked
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.scene.uses import offset_values

ROUND_OFF = 1e-24  # a square: of inertia forces, beside those of the largest velocity of the rigid motion


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
    gram[np.diag(gram) < ROUND_OFF * largest] = 0.0
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
