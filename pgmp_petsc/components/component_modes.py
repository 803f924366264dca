"""Component modes: the few displacement fields that represent a continuum body, whatever its frames are joined to.

The bodies of a mechanism are coupled by the frames of their joints alone. At an eigenvalue lambda of the mechanism a
body therefore moves either in an elastic mode of its own that no frame feels, or as its interface answers,

    (K - lambda M) u = P^T f,

with P the frames' mean displacements and rotations. The first are elastic modes of the free body (`BodyProblem`). The
second form a family with lambda alone, the same for every configuration of the mechanism. A subspace V of it is grown
until it answers at all test values of lambda up to the highest one wanted: where the Galerkin answer ``V x``
leaves the residual R, its compliance ``P u`` misses ``R^T (K - lambda M)^-1 R``, of which ``R^T (K - sigma M)^-1 R`` is
an estimate for R far above lambda, and ``(K - sigma M)^-1 R`` is the direction to add. It takes one factorisation with
one shift sigma.

A mechanism's n-th eigenvalue is at most that of any of its bodies' (n + r)-th elastic one, r the number of constraints
that rigid bodies do not need: all others take away no more low eigenvalues than the bodies' rigid motions add. So the
free body's first n + r modes say how far to go.

Coordinates of a condensed body with a scaled cross-section: those in which what a scale does to a motion is least.

With the scale s (`bodies.profile`) mass and stiffness of the displacements on the mesh are affine in its powers. But a
motion of the body is another one on the mesh for every s: what goes across the axis, rotations of sections and
bending's axial displacements are scaled, what the axis does is not. So

    u = V T(s) y,    T(s) = T_0 + s T_1,

with V the body's frames and internal coordinates at s = 1, T_0 the part of a motion that is a function of the place
along the axis alone, T_1 the rest: a mode shape y of one section then is nearly one of the others. Exactly constant are
the frames and the linear displacement fields C, those across the axis being s C_1 on the mesh: ``T(s) C = C - C_1 + s
C_1``. ``T^T M T`` and ``T^T K T`` are affine again, with two powers more, and everything else is as without a scale.

Condensed bodies in floating frames: moments, a stiffness and the shapes at the frames, from the condensed matrices.

With the linear displacement fields of a condensed body in its unknowns y, the scalar fields 1 and X_k are components of
displacements ``T y`` as all others are, so that its moments ``int rho u_i v_j dV`` are all that inertia needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import eigh, null_space

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.affine import ByWeight, Monomial, Quantity, total_at
from pgmp_petsc.bodies.assembled import AssembledBody
from pgmp_petsc.bodies.component import Component, incommensurate, linear_fields, rigid_motions
from pgmp_petsc.bodies.floating import FloatingBody, Recovery, second_moments, without_noise
from pgmp_petsc.bodies.solid import FaceFrame, Solid
from pgmp_petsc.components.body_problem import BodyProblem, Operator, Subspace, Terms, petsc_terms
from pgmp_petsc.ranks.petsc import times

if TYPE_CHECKING:
    from petsc4py import PETSc

TOLERANCE = 1e-10  # relative error of compliances, and so of eigenvalues; of mode shapes its root
MAX_ROUNDS = 24  # for one value of lambda; close to others, as of stocky bodies, answers take a dozen
N_TESTS = 5  # values of lambda at which the interface's answers are tried
N_PROBES = 64
LEAST = 1e-8  # of the largest of second order, below which there is none: symmetric meshes leave round-off there
MOST_KEPT = 2**27  # bytes of a body's displacements that are kept without being asked for


def condense(
    solid: Solid | AssembledBody,
    frames: Mapping[str, FaceFrame],
    points: Sequence[Mapping[str, float]],
    n_modes: int,
    comm: Comm,
    timings: Timings | None = None,
    memory: float | None = None,
    stressed: bool = False,
    large: bool = False,
) -> tuple[Component, np.ndarray]:
    """Condense a body where `frames` hold it, and for `points`, parameter values of which the nominal ones are first.
    Collective on `comm`, the ranks that share it.

    Of n_modes flexible modes that the mechanism's basis takes, a coarse mesh may have fewer. `timings` get the wall
    time of the phases assembly, modes, answers (of the frames, the growing subspace included) and projection. A factor
    beyond `memory`, bytes on this rank, is kept in files. Where stresses are asked for (`stressed`), the subspace holds
    the static answers to all inertia forces of rigid motion too, and the component keeps T and the mesh whatever their
    size; otherwise for pictures, where they are small (`MOST_KEPT`) and there is no scaled cross-section. Where what is
    of second order in the deformation will be (`large`, see `large_deformation.with_second_order`), it answers the
    inertia forces of the rigid motion as well.

    Returns the body, on all ranks, and the displacements on the mesh of unit coordinates, local rows, (n_local, n),
    with a scaled cross-section of unit ``T(s) y``. Raises `RunError` if an eigenproblem fails, or the interface's
    answers do not settle.
    """
    timings = timings or Timings()
    d, n_nodes = solid.mesh.dimension, solid.mesh.n_nodes
    n_modes = min(n_modes, solid.n_dofs - d * (d + 1) // 2)  # a coarse mesh has no more
    nodes = own_nodes(n_nodes, comm)
    own = slice(d * nodes.start, d * nodes.stop)
    interface = [frame.functionals(n_nodes) for frame in frames.values()]
    loads = np.vstack([functionals.toarray() for functionals in interface])[:, own].T
    places = solid.mesh.nodes[nodes.start : nodes.stop]
    fields = linear_fields(places)
    with timings.phase("assembly"):
        stiffness, mass = (petsc_terms(assemble(nodes), comm) for assemble in (solid.stiffness, solid.mass))
    subspace, error = None, 0.0
    try:
        for values in points:
            with timings.phase("assembly"):
                problem = BodyProblem(mass, stiffness, values, places, comm, memory, solid.name)
            try:
                with timings.phase("modes"):
                    problem.factor()
                    own_modes = problem.modes(n_modes)
                with timings.phase("answers"):
                    if subspace is None:
                        subspace = Subspace(problem.mass, _stiffness_of(problem), comm)
                        subspace.add(fields)
                    else:
                        subspace.turn_to(problem.mass, _stiffness_of(problem))
                    if stressed or large:
                        # stresses are those of inertia forces too, and what is left out at second order does no work
                        # with the loads that are answered
                        subspace.add(problem.answers(times(problem.mass, fields)))
                    error = max(error, _serve(problem, subspace, loads, own_modes, solid.name))
            finally:
                problem.close()
        with timings.phase("projection"):
            component, recovery = _condensed(
                solid, frames, points, subspace, loads, fields, (mass, stiffness), nodes, error
            )
            small = solid.section_scale is None and recovery.shape[1] * solid.n_dofs * 8 <= MOST_KEPT
            if isinstance(solid, Solid) and (stressed or small):  # matrices have no cells to show anything on
                shapes = np.concatenate(comm.allgather(recovery))
                component = replace(component, recovery=Recovery(solid.mesh, shapes, stressed))
    finally:
        for matrix in (*mass.values(), *stiffness.values()):
            matrix.destroy()
    return component, recovery


def own_nodes(n_nodes: int, comm: Comm) -> range:
    """Return this rank's nodes of a mesh that several ranks share."""
    return range(n_nodes * comm.rank // comm.size, n_nodes * (comm.rank + 1) // comm.size)


def _stiffness_of(problem: BodyProblem) -> Operator:
    """Return the operator of a subspace whose images are ``K V``."""
    return lambda vectors, _: times(problem.stiffness, vectors)


def _serve(
    problem: BodyProblem, subspace: Subspace, loads: np.ndarray, own_modes: tuple[np.ndarray, np.ndarray], name: str
) -> float:
    """Grow the subspace by the body's own modes and until it answers; return the error that is left."""
    values, modes = own_modes
    first = problem.answers(loads)
    subspace.add(np.hstack([modes, first]))
    scale = np.diag(subspace.inner(loads, first))
    # answers stay finite in the middle between eigenvalues; the highest value asks for most, and serves the others too
    distinct = np.concatenate([[0.0], values[np.diff(values, prepend=0.0) > 1e-3 * values]])
    middles = 0.5 * (distinct[1:] + distinct[:-1])
    chosen = np.unique(np.linspace(0, middles.size - 1, min(N_TESTS, middles.size)).round().astype(int))
    waiting, largest, rounds = list(middles[chosen]), 0.0, 0
    while waiting:
        # P^T - (K - lambda M) V x with the Galerkin answer x
        reduced = subspace.inner(subspace.vectors, subspace.images) - waiting[-1] * np.eye(subspace.n)
        x = np.linalg.solve(reduced, subspace.inner(subspace.vectors, loads))
        residual = loads - (subspace.images @ x - waiting[-1] * (subspace.mass_vectors @ x))
        answer = problem.answers(residual)
        error = float(np.max(np.abs(np.diag(subspace.inner(residual, answer))) / scale))
        if error < TOLERANCE:
            waiting.pop()
            largest, rounds = max(largest, error), 0
        elif rounds == MAX_ROUNDS or subspace.add(answer) == 0:
            raise RunError(
                f"bodies.{name}: the answers of its frames are still {error:.2g} off with {subspace.n} vectors; the "
                "mesh may be too fine for double precision"
            )
        else:
            rounds += 1
    return largest


def _condensed(
    solid: Solid | AssembledBody,
    frames: Mapping[str, FaceFrame],
    points: Sequence[Mapping[str, float]],
    subspace: Subspace,
    loads: np.ndarray,
    fields: np.ndarray,
    matrices: tuple[Terms, Terms],
    nodes: range,
    error: float,
) -> tuple[Component, np.ndarray]:
    """Turn a subspace's coordinates into those of the frames and internal ones."""
    d, comm, values = solid.mesh.dimension, subspace.comm, points[0]
    vectors = subspace.vectors
    mass, stiffness = ({w: _projected(a, vectors, comm) for w, a in terms.items()} for terms in matrices)
    moments = {w: _moments(a, vectors, d, comm) for w, a in matrices[0].items()}
    frame_of = subspace.inner(loads, vectors)  # P V
    total_mass, total = total_at(mass, values), total_at(stiffness, values)
    shapes = _frame_shapes(total, frame_of)
    rest = null_space(frame_of)
    _, modes = eigh(rest.T @ total @ rest, rest.T @ total_mass @ rest)
    turn = np.hstack([shapes, rest @ modes])
    constant = np.linalg.solve(turn, subspace.inner(subspace.mass_vectors, fields))
    mass, stiffness, moments = (
        {w: turn.T @ a @ turn for w, a in terms.items()} for terms in (mass, stiffness, moments)
    )
    recovery = vectors @ turn
    if solid.section_scale is not None:
        across = np.linalg.solve(turn, _across_axis(solid, nodes, subspace, matrices[0], points[-1]) @ turn)
        own = total_at(mass, values)
        section = SectionCoordinates.of(solid.section_scale.factor, len(frames), across, own, constant)
        mass, stiffness, moments = (section.apply(terms) for terms in (mass, stiffness, moments))
        turn = turn @ section.at(values)
    # without rigid motion: its exact stiffness of zero is not left to round-off
    total_mass, rigid = total_at(mass, values), np.linalg.qr(constant @ rigid_motions(np.zeros(d)))[0]
    keep = np.eye(len(total_mass)) - rigid @ np.linalg.solve(rigid.T @ total_mass @ rigid, rigid.T @ total_mass)
    rows = d * nodes.start + np.arange(d * len(nodes))
    waves = incommensurate(rows, solid.n_dofs, np.arange(1, N_PROBES + 1))
    component = Component(
        {name: number for number, name in enumerate(frames)},
        np.array([frame.centre for frame in frames.values()]),
        mass,
        {w: keep.T @ a @ keep for w, a in stiffness.items()},
        moments,
        constant,
        turn.T @ subspace.inner(subspace.mass_vectors, waves),
        solid.n_dofs,
        error,
    )
    return component, recovery


def _across_axis(
    solid: Solid, nodes: range, subspace: Subspace, mass: Terms, values: Mapping[str, float]
) -> np.ndarray:
    """Return what takes vectors V of the subspace to the rest beside their part along the axis: that of displacement
    fields F that are polynomials of x alone, from ``V^T M F`` and ``F^T M F``.

    The subspace is orthonormal in the mass at the parameter values.
    """
    x, places = solid.mesh.nodes[:, 0], solid.mesh.nodes[nodes.start : nodes.stop]
    (n, d), lowest, highest = places.shape, x.min(), x.max()
    along = legvander((2.0 * places[:, 0] - lowest - highest) / (highest - lowest), DEGREE)
    fields = np.einsum("nk,ij->nikj", along, np.eye(d)).reshape(n * d, -1)
    squares = {weight: _projected(matrix, fields, subspace.comm) for weight, matrix in mass.items()}
    momenta = subspace.inner(subspace.mass_vectors, fields)
    squared, directions = eigh(total_at(squares, values))
    chosen = squared > DEPENDENT * squared[-1]
    unit = momenta @ (directions[:, chosen] / np.sqrt(squared[chosen]))
    return np.eye(subspace.n) - unit @ unit.T


def _projected(matrix: PETSc.Mat, vectors: np.ndarray, comm: Comm) -> np.ndarray:
    """Return ``V^T A V`` for local rows of V."""
    product = comm.allreduce(vectors.T @ times(matrix, vectors))
    return 0.5 * (product + product.T)


def _moments(mass: PETSc.Mat, vectors: np.ndarray, d: int, comm: Comm) -> np.ndarray:
    """Return ``int rho u_i v_j dV`` of fields given by local rows, shape (d, d, n, n): the mass is the same along every
    axis."""
    rows, n = vectors.shape
    by_node = vectors.reshape(rows // d, d, n)
    along = np.zeros((d, rows // d, d, n))
    along[:, :, 0] = np.moveaxis(by_node, 1, 0)  # each component as one in the first direction
    along = along.reshape(d, rows, n)
    pushed = [times(mass, fields) for fields in along]
    return comm.allreduce(np.array([[fields.T @ force for force in pushed] for fields in along]))


def _frame_shapes(stiffness: np.ndarray, frame_of: np.ndarray) -> np.ndarray:
    """Return what has the least strain energy among all that moves one unknown of the frames by 1, shape (n,
    n_frame)."""
    n_frame, n = frame_of.shape
    scale = np.linalg.norm(stiffness) / np.linalg.norm(frame_of) ** 2  # both parts of one size, for the pivots' sake
    saddle = np.block([[stiffness, scale * frame_of.T], [scale * frame_of, np.zeros((n_frame, n_frame))]])
    return np.linalg.solve(saddle, np.vstack([np.zeros((n, n_frame)), scale * np.eye(n_frame)]))[:n]


DEGREE = 24  # of polynomials along the axis, for modes with up to half as many waves
DEPENDENT = 1e-10  # of the largest square: a coarse mesh does not tell all of them apart


@dataclass(frozen=True, eq=False)
class SectionCoordinates:
    """The change of coordinates."""

    factor: Quantity  # s
    #: constant, linear: T_0 and T_1, shape (n, n)
    constant: np.ndarray
    linear: np.ndarray

    @classmethod
    def of(
        cls, factor: Quantity, n_frames: int, across: np.ndarray, mass: np.ndarray, fields: np.ndarray
    ) -> SectionCoordinates:
        """Find T of the factor s, with the unknowns of so many frames first.

        Shapes (n, n) have the rest of a motion beside its part along the axis, which need not be exact, and the mass in
        the coordinates at s = 1 for any parameter values; C, shape (n, d (d + 1)), is as `Component.fields`.
        """
        d = {6: 2, 12: 3}[fields.shape[1]]
        turning = np.tile(np.arange(3 * (d - 1)) >= d, n_frames)
        scaling = np.concatenate([np.zeros(d, dtype=bool), np.tile(np.arange(d) > 0, d)])
        linear = across.copy()
        linear[: turning.size] = 0.0
        linear[np.flatnonzero(turning), np.flatnonzero(turning)] = 1.0
        # the least correction, in the mass, that makes the fields exact
        unit = fields / np.sqrt(np.einsum("if,ij,jf->f", fields, mass, fields))
        weighted = unit.T @ mass
        missing = np.where(scaling, unit, 0.0) - linear @ unit
        missing[: turning.size] = 0.0  # frames are
        linear += missing @ np.linalg.solve(weighted @ unit, weighted)
        return cls(factor, np.eye(len(mass)) - linear, linear)

    def apply(self, terms: ByWeight) -> dict[Monomial, np.ndarray]:
        """Return ``T^T A T`` by weight, for terms A by weight: symmetric, or (d, d, n, n) that are as a whole."""
        found: dict[Monomial, np.ndarray] = {}
        for weight, matrix in terms.items():
            mixed = self.constant.T @ matrix @ self.linear
            parts = (
                self.constant.T @ matrix @ self.constant,
                mixed + (mixed.T if mixed.ndim == 2 else mixed.transpose(1, 0, 3, 2)),
                self.linear.T @ matrix @ self.linear,
            )
            for power, part in enumerate(parts):
                scale = self.factor**power
                place = weight * scale.monomial
                found[place] = found.get(place, 0.0) + scale.coefficient * part
        return found

    def at(self, values: Mapping[str, float]) -> np.ndarray:
        """Return T."""
        return self.constant + self.factor.at(values) * self.linear


def in_floating_frame(
    component: Component, nominal: Mapping[str, float], basis: np.ndarray | None = None
) -> FloatingBody:
    """Put a flexible condensed body into a floating frame, the mean axes at the nominal parameters.

    Its fields are all that it is condensed to, with which it follows its foreshortening where that is known, or those
    that a basis (n, k) has beside the rigid motions, which are among its columns.
    """
    d, modes = component.centres.shape[1], elastic_modes(component, nominal, basis)
    rigid = component.fields @ rigid_motions(np.zeros(d))
    n_frames, n = len(component.frames), modes.shape[1]
    stiffness = {weight: modes.T @ matrix @ modes for weight, matrix in component.stiffness.items()}
    shapes = modes[: component.n_frame_dofs].reshape(n_frames, -1, n)
    moments, stiffness = without_noise(_moments_of(component, modes), stiffness, nominal, d)
    bent, curved = np.zeros((n_frames, d, n, n)), {}
    if component.foreshortening is not None and basis is None:
        bent, curved = foreshortened(component.foreshortening, shapes, moments)
    kept = component.recovery and replace(component.recovery, shapes=component.recovery.shapes @ modes, curved=None)
    taken = np.linalg.inv(np.hstack([rigid, modes])) if basis is None else None
    frames, centres = component.frames, component.centres
    return FloatingBody(frames, centres, shapes, moments, stiffness, bent, curved, kept, taken)


def elastic_modes(component: Component, nominal: Mapping[str, float], basis: np.ndarray | None = None) -> np.ndarray:
    """Return the elastic free modes of a condensed body at the nominal parameters, of a mean square displacement of 1
    m2, shape (n, n - n_rigid); of a basis (n, k) with the rigid motions (n, k - n_rigid)."""
    mass, stiffness = (total_at(terms, nominal) for terms in (component.mass, component.stiffness))
    along, basis = component.fields[:, 0], np.eye(len(mass)) if basis is None else basis  # unit displacement along x
    own = free_modes(basis.T @ mass @ basis, basis.T @ stiffness @ basis, component.centres.shape[1])
    return np.sqrt(along @ mass @ along) * (basis @ own)


def foreshortened(
    curvature: np.ndarray, shapes: np.ndarray, moments: ByWeight, sections: ByWeight | None = None
) -> tuple[np.ndarray, ByWeight]:
    """Return what amplitudes of second order (n, n, n) displace frames by, and their moments; see `FloatingBody`.

    `sections` are moments of what turns to second order without being displaced, by weight.
    """
    d, curved = {3: 2, 6: 3}[shapes.shape[1]], dict(sections or {})
    for weight, part in moments.items():
        curved[weight] = curved.get(weight, 0.0) + np.einsum("klm,mij->klij", second_moments(part, d)[1], curvature)
    bent = np.einsum("fkm,mij->fkij", shapes[:, :d], curvature)
    return _without_least(bent), {weight: _without_least(part) for weight, part in curved.items()}


def _without_least(part: np.ndarray) -> np.ndarray:
    return np.where(np.abs(part) > LEAST * np.max(np.abs(part), initial=0.0), part, 0.0)


def _moments_of(component: Component, modes: np.ndarray) -> dict[Monomial, np.ndarray]:
    """Return the moments of 1, of the coordinates and of modes (n, n_modes) of a condensed body; see `FloatingBody`."""
    d, (n, n_modes) = component.centres.shape[1], modes.shape
    # scalar fields as components of displacements: 1 and X_k along the first axis, every mode along all of them
    fields = np.zeros((1 + d + d * n_modes, d, n))
    fields[0, 0] = component.fields[:, 0]
    fields[1 : 1 + d, 0] = component.fields[:, d : 2 * d].T
    for k in range(d):
        fields[1 + d + k * n_modes : 1 + d + (k + 1) * n_modes, k] = modes.T
    flat = fields.reshape(len(fields), d * n)
    return {w: flat @ part.swapaxes(1, 2).reshape(d * n, d * n) @ flat.T for w, part in component.moments.items()}


def free_modes(mass: np.ndarray, stiffness: np.ndarray, d: int) -> np.ndarray:
    """Return the elastic free modes in given coordinates, M-orthonormal, shape (n, n - n_rigid)."""
    return eigh(stiffness, mass)[1][:, d * (d + 1) // 2 :]
