"""The part of the static answers to its own loads that a basis misses away from the nominal parameters.

Every flexible vector answers a load at the nominal parameters p0, ``K(p0) psi_j = l_j(p0)`` but for joint forces: a
mode its inertia forces ``lambda M psi``, a static mode the loads that it was made of (`StaticLoads`). With
``Psi^T L(p) g = K_r(p) delta``, the loads that the state is in equilibrium with, and rigid accelerations that balance
these,

    du = K(p0)^-1 (L(p) g - K(p) Psi delta),        forces and stresses:  D(p) S (Psi delta) + D(p0) S du,

where S gives strains and D forces of strains (docs/method.md, section forces at other parameters): the residual
weighted with the answers to unit forces of the outputs (Becker and Rannacher 2001). What answers joints that are off
answers no load: it has a part in K Psi alone. Loads and stiffness are affine, so that forces and answers of every term
are tables over the configurations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Monomial, evaluate_weights
from pgmp_petsc.declare.records import Record, array
from pgmp_petsc.lanes.lane_items import solutions
from pgmp_petsc.reduction.cell_products import by_cell, cells_of
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.tables import WEIGHT_FREE, ReducedTables, Weights, beside_rigid, weights_of

if TYPE_CHECKING:
    from pgmp_petsc.modes.problem import ModalProblem, ModeSet
    from pgmp_petsc.reduction.sampler import Sample, StaticLoads

AT_ONCE = 2**12  # states that are evaluated together: what is between the tables stays in the cache
DEPENDENT = 1e-11  # of loads of unit size: what round-off leaves of a combination of them that is no load


@dataclass(frozen=True, eq=False)
class MissedAnswers(Record):
    """Tables over n configurations of the loads L of q vectors: the free rigid motions, then those of the basis."""

    weights: Weights = weights_of("forces", "term of forces")
    dofs: np.ndarray = array(
        "unknown of stresses", at="unknowns", about="numbers of the unknowns among those of the projection"
    )
    #: ``[d rho/d theta, Psi]^T L_i``, shape (n, n_w, q, q)
    forces: np.ndarray = array(
        "configuration", "term of forces", "vector", "vector", unit=WEIGHT_FREE,
        about="[d rho/d theta, Psi]^T L_i, L the loads answered",
    )  # fmt: skip
    #: ``K(p0)^-1 L_i``, shape (n, n_w, q, k), and behind them, shape (n, n_stiffness_terms, m, k), those to ``K_i
    #: Psi``; rows of both below each other, shape (n, n_w q + n_stiffness_terms m, k)
    answers: np.ndarray = array(
        "configuration", "answer", "unknown of stresses", unit=WEIGHT_FREE, about="K^-1 [L_i, K_i Psi]"
    )

    def turned(self, rotations: np.ndarray) -> MissedAnswers:
        """Express the flexible coordinates in another basis of the same space, ``Psi_new = Psi Q``, Q (n, m, m)."""
        n_terms, whole = self.forces.shape[1], beside_rigid(rotations, self.forces.shape[-1] - rotations.shape[1])
        parts = np.split(self.answers, [n_terms * whole.shape[1]], axis=1)
        parts = [
            np.einsum("nij,ntik->ntjk", by, part.reshape(len(by), -1, by.shape[1], part.shape[-1])).reshape(part.shape)
            for by, part in zip((whole, rotations), parts)
        ]
        forces = np.einsum("nki,ntkl,nlj->ntij", whole, self.forces, whole, optimize=True)
        return replace(self, forces=forces, answers=np.concatenate(parts, axis=1))


class Missed:
    """The missing part of reduced states, of what was found for the basis and the tables of the model, by their scheme
    of interpolation."""

    def __init__(self, found: MissedAnswers, tables: ReducedTables, scheme: str) -> None:
        self._weights, self._stiffness_weights = found.weights, tables.stiffness_weights
        self._n_theta = tables.n_coordinates
        n, n_w, self._n_loads, _ = found.forces.shape
        self._forces = interpolant(tables.samples, found.forces.reshape(n, n_w, -1), scheme)
        self._stiffness = interpolant(tables.samples, tables.stiffness.reshape(n, -1, tables.n_modes), scheme)
        self._answers = interpolant(tables.samples, found.answers, scheme)

    def of(self, eta: np.ndarray, values: Mapping[str, np.ndarray | float]) -> np.ndarray:
        """Return du, shape (k, n), for reduced coordinates (n, n_eta); values are numbers or of shape (n,)."""
        weights = [
            np.broadcast_to(evaluate_weights(own, values).T, (len(eta), len(own)))
            for own in (self._weights, self._stiffness_weights)
        ]
        order = by_cell(cells_of(np.ascontiguousarray(eta[:, : self._n_theta]), self._forces.axes))
        found = np.empty((self._answers.shape[1], len(eta)))
        for first in range(0, len(eta), AT_ONCE):
            some = order[first : first + AT_ONCE]
            found[:, some] = self._of(eta[some], *(part[some] for part in weights)).T
        return found

    def _of(self, eta: np.ndarray, loads: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        n, theta, delta = len(eta), eta[:, : self._n_theta], eta[:, self._n_theta :]
        bent = (stiffness[:, :, None] * delta[:, None]).reshape(n, -1)
        balance = self._forces.product(theta, loads).reshape(n, self._n_loads, self._n_loads)
        elastic = np.pad(self._stiffness.product(theta, bent), ((0, 0), (self._n_loads - delta.shape[1], 0)))
        answered = (loads[:, :, None] * solutions(balance, elastic)[:, None]).reshape(n, -1)
        return self._answers.product(theta, np.hstack([answered, -bent]))


def missed_answers_at(
    problem: ModalProblem, static_loads: StaticLoads, modes: ModeSet, sample: Sample, combination: np.ndarray
) -> tuple[tuple[Monomial, ...], np.ndarray, np.ndarray]:
    """Return the weights, the forces and the answers, local columns (n_w q + n_stiffness_terms m, n_local), of one
    configuration; see `MissedAnswers`. Collective on the problem's communicator.

    Static loads are what static modes answer; modes, sample and combination are as of `Manifold.at`. Raises
    `RunError` if the refinement of an answer does not converge.
    """
    rigid, vectors = modes.rigid[:, modes.free], np.hstack([sample.shape, sample.built_in])
    shape, n_own = vectors @ combination, sample.shape.shape[1]
    kept, others = combination[: sample.n_kept], sample.shape[:, sample.n_kept :] @ combination[sample.n_kept : n_own]
    stiffness = [problem.matrices.stiffness[weight] for weight in problem.mechanism.stiffness_weights]
    n_rigid, n = rigid.shape[1], rigid.shape[1] + shape.shape[1]
    terms: dict[Monomial, np.ndarray] = {}
    first, last = sample.n_modes, sample.n_modes + problem.n_released
    for weight, load in answered_terms(problem, modes, sample.kept[:, last:], static_loads).items():
        answered = load @ np.delete(kept, np.s_[first:last], axis=0)
        terms[weight] = np.hstack([np.zeros((len(load), n_rigid)), answered])
    # rigid motions answer no load: their inertia forces balance the others
    moving = np.hstack([rigid, modes.released @ kept[first:last]])
    for weight, term in problem.matrices.mass.items():
        terms[weight] += term @ problem.all_rows(moving)
    if others.size:
        # vectors of other parameters are no answers to loads that are known: they keep their own elastic forces
        for weight, term in zip(problem.mechanism.stiffness_weights, stiffness):
            own = terms.setdefault(weight, np.zeros((len(rigid), n)))
            own[:, n_rigid:] += term @ problem.all_rows(others)
    weights = tuple(sorted(terms))
    loads = np.array([terms[weight] for weight in weights])
    forces = problem.inner(np.hstack([rigid, shape]), loads)
    given = np.arange(n - sample.built_in.shape[1], n)
    forces[0, given, given] = 1.0  # no loads, and whatever their amplitudes none of them
    everywhere = problem.all_rows(shape)
    columns = np.hstack([*loads, *(term @ everywhere for term in stiffness)])
    return weights, forces, problem.static_answers(modes.unstrained, columns, "answers at other parameters").T


def answered_terms(
    problem: ModalProblem, modes: ModeSet, static: np.ndarray, static_loads: StaticLoads
) -> dict[Monomial, np.ndarray]:
    """Return by weight the loads that modes and static modes, local rows, shape (n_local, n_static), answer at the
    nominal parameters, each of shape (n_local, n_modes + n_static).

    Their sum there is `CurvatureProblem.answered_loads`.
    """
    kept, given = modes.eigenvectors, static_loads.terms_at(problem, modes)
    flexible, everywhere = problem.all_rows(modes.flexible), problem.all_rows(kept)
    loads, m_kept = static_loads.at(problem, modes), problem.times_mass(kept)
    coupling = np.linalg.solve(problem.inner(kept, m_kept), problem.inner(kept, loads))
    # S = K^-1 B R with an unknown R, so that S^T K S = S^T B R
    stiffness = problem.inner(static, problem.times_stiffness(static))
    sizes = np.sqrt(np.maximum(np.diag(problem.inner(loads, loads)), np.finfo(float).tiny))
    powers = problem.inner(static, loads - m_kept @ coupling) / sizes
    shares, _, rank, _ = np.linalg.lstsq(powers, stiffness, rcond=DEPENDENT)
    among = shares / sizes[:, None]
    found = {}
    for weight, part in given.items():
        term = problem.matrices.mass.get(weight)
        inertia, balanced = np.zeros((len(part), modes.flexible.shape[1])), part
        if term is not None:
            inertia, balanced = modes.eigenvalues * (term @ flexible), part - (term @ everywhere) @ coupling
        found[weight] = np.hstack([inertia, balanced @ among])
    if rank < len(stiffness):
        # where loads depend on each other, answers are limits of those beside: these keep their own elastic forces
        own = static - static @ np.linalg.solve(stiffness, powers @ shares)
        for weight in problem.mechanism.stiffness_weights:
            forces = found.setdefault(weight, np.zeros((len(static), modes.flexible.shape[1] + len(stiffness))))
            forces[:, -len(stiffness) :] += problem.matrices.stiffness[weight] @ problem.all_rows(own)
    return found
