"""Reduced affine matrices at the sampled configurations (docs/method.md, reduced equations).

With Psi = [d rho/d theta, Psi_flexible] and the coordinates eta = [theta, delta] they are ``M^r_i = Psi^T M_i Psi``,
``K^r_i = Psi^T K_i Psi``, on delta alone, and ``Q_j = Psi^T f_j``; the table of the inertia forces that bend the bodies
is ``c_i = (d2 rho/d theta2)^T M_i Psi_flexible``. The inertia of the rigid motion follows from the exact kinematics on
a fine grid. At the samples mass and stiffness are positive definite by construction; in between
(`indefinite_between`) a sum of interpolated entries need not be.

How modes change with theta: the kinetic energy of ``D_k = d(R Psi)/d theta_k``, in body frames ``D_k = d_k Psi + W_k
Psi``, with d_k Psi from the interpolated projection and W_k = R^T d_k R the body's spin per unit of theta_k, which
turns its points (`bodies.matrices`).

How the forces in the bodies change the stiffness of each mode (docs/method.md, validity): *influences* ``h_k.f``, with
one static answer h_k a mode (`CurvatureProblem.stiffness_answers`), for units of all that loads the bodies, in this
order of columns:

- every load term of the effects, its weight taken out,
- every action (local effect), per unit of its force,
- for every mass term, its weight taken out: the inertia forces of unit accelerations theta_k'', and those of unit
  products theta_k' theta_l', k >= l, each pair once: where k > l a motion has twice as much of it.

They hold at the nominal parameters, at which forces in statically determinate bodies do not depend on the stiffness.

Tables of second order (docs/method.md, second order in the deformation), with K3_t of a term of the strain energy:

    cubic_t[i, j, k] = K3_t[psi_i, psi_j, psi_k] + psi_i.K_t chi_jk + psi_j.K_t chi_ik + psi_k.K_t chi_ij
    curved_load_l[i, j] = f_l.chi_ij
    curved_inertia_t[kl, i, j] = (d2 rho/d theta_k d theta_l).M_t chi_ij,     pairs k >= l of rigid coordinates
    curved_mass_t[k, i, j] = (d rho/d theta_k).M_t chi_ij,     where coordinates are prescribed

Pairs (i, j) of coordinates are packed as ``np.tril_indices`` orders them, each once: ``1/2 chi delta delta`` is the sum
over the packed pairs of ``chi_ij delta_i delta_j``, halved where i = j.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial, evaluate_weights
from pgmp_petsc.bodies.matrices import inertia_moments
from pgmp_petsc.declare.records import Record, array, attribute, check_sizes, derived
from pgmp_petsc.effects.action import Action
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.cell_products import congruent, symmetric
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import EACH, SampleGrid, Samples
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.units import values_text
from pgmp_petsc.scene.uses import slides

WEIGHT_FREE = "SI, weight taken out"
NODE_UNITS = "m of the translations, 1 of the rotations, per unit of the modal coordinate (kg^-1/2)"
CURVATURE_UNITS = "m of the translations, 1 of the rotations, per unit of two modal coordinates (kg^-1)"
WEIGHTS = (
    lambda weights: tuple(str(weight) for weight in weights),
    lambda texts: tuple(Monomial.parse(str(text)) for text in texts),
)
Weights = tuple[Monomial, ...]
At = Callable[[np.ndarray], np.ndarray]  # what takes tables at the samples to other configurations
OF_WEIGHTS = "monomial of parameters that each term is multiplied with"


def weights_of(table: str, size: str, **how: Any) -> Any:
    """Declare the monomials of the terms of a table; ``also``: of the tables beside it."""
    also = tuple(f"{other}@weights" for other in how.pop("also", ()))
    return attribute(f"{table}@weights", size, code=WEIGHTS, also=also, about=OF_WEIGHTS, **how)


def _weights_of_model(name: str, size: str, *tables: str) -> Any:
    """Declare that a file repeats weights of the model at tables of its parts."""
    first, *also = (f"{table}@weights" for table in tables)
    how = {"code": WEIGHTS, "also": tuple(also), "about": OF_WEIGHTS}
    return derived(Weights, lambda _, at: getattr(at.outer.own, name), first, size, **how)


@dataclass(frozen=True, eq=False)
class SecondOrderTables(Record):
    """Tables at n samples, symmetric in the flexible indices; see `cell_products`."""

    cubic: np.ndarray = array(
        "configuration", "stiffness term", "mode", "mode", "mode", unit=WEIGHT_FREE,
        about="third derivative of the strain energy along the curved modes",
    )  # fmt: skip
    curved_load: np.ndarray = array("configuration", "load term", "mode", "mode", unit=WEIGHT_FREE, about="f_j.chi")
    curved_inertia: np.ndarray = array(
        "configuration", "mass term", "pair of coordinates", "mode", "mode", unit=WEIGHT_FREE,
        about="(d2 rho/d theta_k d theta_l)^T M_i chi, k >= l",
    )  # fmt: skip
    #: zero for coordinates that are free
    curved_mass: np.ndarray = array(
        "configuration", "mass term", "coordinate where any is prescribed", "mode", "mode", unit=WEIGHT_FREE,
        about="(d rho/d theta_k)^T M_i chi of prescribed coordinates",
    )  # fmt: skip

    FURTHER = (
        _weights_of_model("stiffness_weights", "stiffness term", "cubic"),
        _weights_of_model("load_weights", "load term", "curved_load"),
        _weights_of_model("mass_weights", "mass term", "curved_inertia", "curved_mass"),
    )

    def turned(self, rotations: np.ndarray) -> SecondOrderTables:
        """Express the flexible coordinates in another basis, ``Psi_new = Psi Q``, Q of shape (n, n_delta, n_delta)."""
        cubic = np.einsum("nia,njb,nkc,ntijk->ntabc", rotations, rotations, rotations, self.cubic, optimize=True)
        others = (self.curved_load, self.curved_inertia, self.curved_mass)
        return SecondOrderTables(symmetric(cubic), *(congruent(rotations, table) for table in others))


@dataclass(frozen=True, eq=False)
class ModeChanges(Record):
    """Tables of changing modes at n samples."""

    #: the symmetric part is half the derivative of ``Psi^T M_i Psi``, which vanishes at the nominal parameters
    gyroscopic: np.ndarray = array(
        "configuration", "mass term", "coordinate", "mode", "mode", unit=WEIGHT_FREE,
        about="skew part of D_k^T M_i Psi",
    )  # fmt: skip
    spread: np.ndarray = array(
        "configuration", "mass term", "pair of coordinates", "mode", "mode", unit=WEIGHT_FREE,
        about="D_k^T M_i D_l, k >= l, D_k = d(R Psi)/d theta_k",
    )  # fmt: skip

    FURTHER = (_weights_of_model("mass_weights", "mass term", "gyroscopic", "spread"),)


def mode_changes(
    kinematics: RigidKinematics,
    masses: Mapping[Monomial, sp.csr_matrix],
    samples: SampleGrid,
    projection: np.ndarray,
    scheme: str,
    n_given: int = 0,
) -> ModeChanges:
    """Return the tables of changing modes: flexible vectors in body frames, shape (n, n_dofs, n_delta), continuous.

    Masses are all rows of the mass terms in body frames, shape (n_dofs, n_dofs) each. Coordinates of the last `n_given`
    vectors do not change: with theirs alone D^T M Psi counts, all of it.
    """
    mechanism, r = kinematics.mechanism, kinematics.n_coordinates
    over = interpolant(samples, projection, scheme)
    slopes = np.array([over(samples.theta, k) for k in range(r)])
    bodies = [(body.dofs, inertia_moments(body)) for body in mechanism.bodies]
    n, _, m = projection.shape
    own = m - n_given
    n_terms, pairs = len(mechanism.mass_weights), np.tril_indices(r)
    gyroscopic, spread = np.empty((n, n_terms, r, m, m)), np.empty((n, n_terms, pairs[0].size, m, m))
    for sample in range(n):
        shape, changes = projection[sample], slopes[:, sample]
        # W_k of every body, each of shape (n_theta, d, d)
        theta = samples.theta[sample]
        d = kinematics.mechanism.space.dimension
        fields = kinematics.motion(theta).velocities[:, d:]
        spins = [np.moveaxis(field.reshape(d, d, -1), -1, 0) for field in fields]
        for t, weight in enumerate(mechanism.mass_weights):
            m_changes = [masses[weight] @ change for change in changes]
            felt = [moments[weight] @ shape[dofs] if weight in moments else None for dofs, moments in bodies]
            m_spins = [_turned(bodies, felt, [spin[k] for spin in spins], shape) for k in range(r)]
            for k in range(r):
                mixed = m_changes[k].T @ shape + m_spins[k].T @ shape
                mixed[:own, own:] = -mixed[own:, :own].T
                gyroscopic[sample, t, k] = 0.5 * (mixed - mixed.T)
            for pair, (k, j) in enumerate(zip(*pairs)):
                both = _turned(bodies, felt, [spin[k].T @ spin[j] for spin in spins], shape)
                crossed = changes[k].T @ m_spins[j] + m_spins[k].T @ changes[j]
                spread[sample, t, pair] = changes[k].T @ m_changes[j] + crossed + shape.T @ both
    return ModeChanges(gyroscopic, 0.5 * (spread + np.swapaxes(spread, -1, -2)))


def _turned(bodies: list, felt: list[np.ndarray | None], turns: list[np.ndarray], vectors: np.ndarray) -> np.ndarray:
    """Return ``C^T m (W C v)`` of one mass term, shape (n_dofs, m), for a matrix W (d, d) of every body and what
    `inertia_moments` make of its vectors."""
    result = np.zeros_like(vectors)
    for (dofs, _), parts, turn in zip(bodies, felt, turns):
        if parts is not None:
            result[dofs] = np.tensordot(turn.ravel(), parts.reshape(turn.size, dofs.size, -1), axes=1)
    return result


@dataclass(frozen=True, eq=False)
class StiffnessChanges(Record):
    """Influences of all loads on the stiffness of the modes at the samples, modes in ascending order at each."""

    influence: np.ndarray = array(
        "configuration", "mode of the order", "unit load or motion", unit="SI", gaps=True,
        about="change of the modes' stiffness by unit loads and motions",
    )  # fmt: skip
    stiffness: np.ndarray = array(
        "configuration", "stiffness term", "mode of the order", unit=WEIGHT_FREE, gaps=True,
        about="psi_k.K_i psi_k of the modes",
    )  # fmt: skip


@dataclass(frozen=True)
class ReducedTables(Record):
    """Reduced matrices and loads at the samples."""

    samples: SampleGrid = array(at="")  # n configurations
    mass_weights: Weights = weights_of("tables/mass", "mass term", also=("tables/inertia", "tables/rigid"))
    stiffness_weights: Weights = weights_of("tables/stiffness", "stiffness term")
    load_weights: Weights = weights_of("tables/load", "load term")
    load_effects: tuple[str, ...] = attribute("tables/load@effects", "load term", about="effect of each term")
    mass: np.ndarray = array(
        EACH, "mass term", "eta", "eta", at="tables/mass", unit=WEIGHT_FREE, about="Psi^T M_i Psi, eq. (13)"
    )
    inertia: np.ndarray = array(
        EACH, "mass term", "coordinate", "coordinate", "mode", at="tables/inertia", unit=WEIGHT_FREE,
        about="(d2 rho/d theta2)^T M_i Psi",
    )  # fmt: skip
    stiffness: np.ndarray = array(
        EACH, "stiffness term", "mode", "mode", at="tables/stiffness", unit=WEIGHT_FREE, about="Psi^T K_i Psi, eq. (14)"
    )
    load: np.ndarray = array(EACH, "load term", "eta", at="tables/load", unit=WEIGHT_FREE, about="Psi^T f_j")
    #: how far joints are off, given and constant in time
    n_given: int = attribute(
        "@n_given", absent=0, about="of the modes, the last ones: displacements per unit of the joints' offsets"
    )
    #: of second order in the flexible coordinates, None where the scene does not ask for them
    second_order: SecondOrderTables | None = array(at="tables/second_order", absent=None)
    #: kinetic energy of the modes' change with theta, which comes with them. It is known once the whole basis is
    #: continuous; what makes other tables of these leaves it out.
    changes: ModeChanges | None = array(at="tables/second_order", absent=None)

    def __post_init__(self) -> None:
        check_sizes(self, {EACH: self.samples.n})
        if self.mass.shape[-1] != sum(self.inertia.shape[-2:]):
            raise ValueError(f"mass has shape {self.mass.shape}, inertia {self.inertia.shape}")

    @property
    def n_modes(self) -> int:
        """Number of flexible coordinates n_delta."""
        return self.stiffness.shape[-1]

    @property
    def n_coordinates(self) -> int:
        """Number of rigid coordinates n_theta."""
        return self.mass.shape[-1] - self.n_modes

    def prescribed(self, motions: Collection[int]) -> np.ndarray:
        """Return whether a coordinate is given, shape (n_eta,): one that moves as said, or how far a joint is off."""
        n_eta = self.mass.shape[-1]
        found = np.arange(n_eta) >= n_eta - self.n_given
        found[list(motions)] = True
        return found

    def at(self, rows: np.ndarray) -> ReducedTables:
        """Return the tables at some of the samples that make a grid, given by their increasing numbers."""
        found, samples = replace(self, changes=None), self.samples.tabulated(self.samples.theta[rows])
        return replace(found, samples=samples, **found.each(EACH, lambda table: table[rows]))

    def turned(self, rotations: np.ndarray) -> ReducedTables:
        """Express the flexible coordinates in another basis at every sample, ``Psi_new = Psi Q``.

        Rotations Q, shape (n, n_delta, n_new), are orthogonal, or combinations of fewer vectors.
        """
        whole = beside_rigid(rotations, self.n_coordinates)
        return replace(
            self,
            mass=congruent(whole, self.mass),
            inertia=np.einsum("nij,ntkli->ntklj", rotations, self.inertia),
            stiffness=congruent(rotations, self.stiffness),
            load=np.einsum("nij,nti->ntj", whole, self.load),
            second_order=None if self.second_order is None else self.second_order.turned(rotations),
            changes=None,
        )

    @property
    def unstrained(self) -> np.ndarray:
        """Numbers of the flexible coordinates without stiffness at any parameters: what elastic joints allow."""
        return np.flatnonzero(~self.stiffness[..., : self.n_modes - self.n_given].any(axis=(0, 1, 2)))

    def moving(self, given: np.ndarray | None = None) -> ReducedTables:
        """Return the tables without given coordinates, whose values (n_given,) change the stiffness where they have
        terms of second order."""
        if not self.n_given:
            return self
        own, bent = slice(-self.n_given), self.second_order
        stiffness = self.stiffness[..., own, own]
        if bent is not None:
            if given is not None:
                stiffness = stiffness + bent.cubic[..., own, own, -self.n_given :] @ given
            others = (bent.curved_load, bent.curved_inertia, bent.curved_mass)
            bent = SecondOrderTables(bent.cubic[..., own, own, own], *(table[..., own, own] for table in others))
        return replace(
            self, mass=self.mass[..., own, own], inertia=self.inertia[..., own], stiffness=stiffness,
            load=self.load[..., own], n_given=0, second_order=bent, changes=None,
        )  # fmt: skip

    def over(self, scheme: str, theta: np.ndarray) -> At:
        """Return what interpolates tables at configurations (n, n_theta), rad."""
        return lambda table: interpolant(self.samples, table, scheme)(theta)

    def _matrices(self, values: Mapping[str, float], at: At) -> Iterator[np.ndarray]:
        """Yield mass and stiffness at parameter values, where `at` takes tables to."""
        for weights, table in ((self.mass_weights, self.mass), (self.stiffness_weights, self.stiffness)):
            yield weighted(at(table), weights, values)

    def vibrating(self, values: Mapping[str, float], free: np.ndarray, at: At) -> tuple[np.ndarray, np.ndarray]:
        """Return mass and stiffness of the `free` coordinates and the flexible ones, (n, n_free + n_delta, n_free +
        n_delta), at parameter values, where `at` takes tables to."""
        mass, stiffness = self._matrices(values, at)
        kept = np.append(free, self.n_coordinates + np.arange(self.n_modes))
        return mass[:, kept[:, None], kept], np.pad(stiffness, ((0, 0), (free.size, 0), (free.size, 0)))

    def frequencies_hz(
        self, values: Mapping[str, float], free: Sequence[int] | None = None, at: At = np.asarray
    ) -> np.ndarray:
        """Return the eigenfrequencies of the reduced model at parameter values and every sample, rigid motion left out,
        shape (n, n_delta - n_unstrained), Hz; or where `at` takes tables to.

        `free` are the numbers of the coordinates that are not prescribed, which are held; all by default.
        """
        if self.n_given:
            return self.moving().frequencies_hz(values, free, at)
        r = self.n_coordinates
        mass, stiffness = self._matrices(values, at)
        # free-free modes: what is free to move without strain is condensed out of the kinetic energy
        free = np.arange(r) if free is None else np.asarray(free, dtype=int)
        free, bent = np.append(free, r + self.unstrained), np.setdiff1d(np.arange(self.n_modes), self.unstrained)
        coupled = mass[:, free[:, None], r + bent]
        follow = np.linalg.solve(mass[:, free[:, None], free], coupled)
        flexible = mass[:, r + bent[:, None], r + bent] - np.einsum("nri,nrj->nij", coupled, follow)
        lower = np.linalg.inv(np.linalg.cholesky(flexible))
        stiffness = stiffness[:, bent[:, None], bent]
        values = np.linalg.eigvalsh(lower @ stiffness @ np.swapaxes(lower, 1, 2))
        return np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)


def weighted(table: np.ndarray, weights: Weights, values: Mapping[str, float]) -> np.ndarray:
    """Return the sum of the terms (axis 1) of a table at parameter values."""
    return np.einsum("t,nt...->n...", evaluate_weights(weights, values), table)


def beside_rigid(rotations: np.ndarray, n_rigid: int) -> np.ndarray:
    """Return rotations (n, m, n_new) beside an identity of rigid vectors, shape (n, n_rigid + m, n_rigid + n_new)."""
    n, m, n_new = rotations.shape
    whole = np.zeros((n, n_rigid + m, n_rigid + n_new))
    whole[:, :n_rigid, :n_rigid] = np.eye(n_rigid)
    whole[:, n_rigid:, n_rigid:] = rotations
    return whole


N_FINE = 1024  # cubic spline: an error of (2 pi / 1024)^4 / 384 = 4e-12 of the fourth derivative
N_FINE_OF_MORE = 192  # along each axis of two coordinates: 3e-9 of the fourth derivative, and some 40 MB
#: rad of a body from one place to the next, by which splines of its directors err by 3e-7; places more that it may take
SMALL_TURN, MOST_FINER = 0.1, (16, 2, 1)
#: Of three: parts of each cell between samples, and the fewest points. With 16 angles over 3.2 rad an error of 7e-8 of
#: the fourth derivative, and 100,000 points.
PARTS_OF_THREE, FEWEST_OF_THREE = 3, 16


def fine_grid(samples: SampleGrid) -> SampleGrid:
    """Return the grid on which what the rigid kinematics gives is tabulated, over the range of the samples."""
    if samples.n_coordinates < 3:
        counts = [N_FINE if samples.n_coordinates == 1 else N_FINE_OF_MORE] * samples.n_coordinates
    else:
        ends = [0 if axis.periodic else 1 for axis in samples]
        counts = [max(FEWEST_OF_THREE, PARTS_OF_THREE * (axis.n - end) + end) for axis, end in zip(samples, ends)]
    return _even(samples, counts)


def grid_of_places(
    samples: SampleGrid, kinematics: RigidKinematics, actions: Sequence[Action]
) -> tuple[SampleGrid, np.ndarray]:
    """Return the grid on which it is tabulated where actions hold: `fine_grid`, and finer where their bodies turn far
    between its places, as motors behind gears do; up to `MOST_FINER` times as many places. Behind it is how far each
    body turns between these, (n_bodies,), rad; empty without actions."""
    fine, bodies = fine_grid(samples), acted_bodies(actions)
    if not bodies:
        return fine, np.zeros(0)
    turning = kinematics.turning(kinematics.poses(samples.theta))
    parts = np.maximum(turning[bodies].max(axis=0) * _steps(fine) / SMALL_TURN, 1.0)
    too_many = parts.prod() / MOST_FINER[samples.n_coordinates - 1]
    if too_many > 1.0:
        parts = np.maximum(np.where(parts > 1.0, parts * too_many ** (-1.0 / np.sum(parts > 1.0)), 1.0), 1.0)
    places = _even(samples, [int(np.ceil(axis.n * own)) for axis, own in zip(fine, parts)])
    return places, np.max(turning * _steps(places), axis=1)


def acted_bodies(actions: Sequence[Action]) -> list[int]:
    """Return the numbers of the bodies that actions hold at."""
    return sorted({side.body for action in actions for side in action.sides if not side.on_ground})


def _steps(fine: SampleGrid) -> np.ndarray:
    """Return how far places of a grid at equal distances are apart along each coordinate, about, rad or m."""
    return np.array([(axis.upper - axis.lower) / axis.n for axis in fine])


def _even(samples: SampleGrid, counts: Sequence[int]) -> SampleGrid:
    """Return the range of samples at so many equal distances."""
    return SampleGrid(tuple(Samples.uniform(a.lower, a.upper, n, a.periodic) for a, n in zip(samples, counts)))


def rigid_inertia(
    samples: SampleGrid, mass: Mapping[Monomial, sp.csr_matrix], kinematics: RigidKinematics
) -> np.ndarray:
    """Return ``(d rho/d theta_k)^T M_i (d rho/d theta_l)`` of every mass term on the fine grid, shape (n_fine,
    n_mass_terms, n_theta (n_theta + 1) / 2), lower triangles row by row.

    In its own frame a body moves as a combination of constant vectors, so the mass that belongs to the velocities of
    all bodies is projected once. Masses are all rows of the mass terms in body frames, shape (n_dofs, n_dofs) each.
    """
    fine, mechanism = fine_grid(samples), kinematics.mechanism
    unit = np.zeros((mechanism.n_dofs, 0))
    for dofs, fields in mechanism.linear_fields:
        own = np.zeros((mechanism.n_dofs, fields.shape[1]))
        own[dofs] = fields
        unit = np.hstack([unit, own])
    poses = kinematics.poses(fine.theta)
    rates = kinematics.rates(poses)
    local = np.concatenate([mechanism.space.velocity_field(*pair) for pair in zip(poses, rates)])
    terms = [unit.T @ (mass[weight] @ unit) for weight in mechanism.mass_weights]
    values = [np.einsum("akn,ab,bjn->nkj", local, term, local, optimize=True) for term in terms]
    rows, columns = np.tril_indices(kinematics.n_coordinates)
    return np.ascontiguousarray(np.stack(values, axis=1)[..., rows, columns])


PLACES = (0.25, 0.5, 0.75)  # of every interval between samples
MIDDLE = (0.5,)  # the same over several coordinates, whose cells are many
SMALLEST = 1e-6  # eigenvalue of a matrix with unit diagonal


def indefinite_between(tables: ReducedTables, scene: Scene, values: Mapping[str, np.ndarray], n_samples: int) -> str:
    """Say where mass or stiffness of what is flexible and moves is indefinite between samples, which matrix, where,
    with which parameter values, shape (n_samples,) each, and what helps; empty where it is nowhere."""
    tables = tables.moving()  # given coordinates may have no stiffness at all
    samples, r = tables.samples, tables.n_coordinates
    places = PLACES if samples.n_coordinates == 1 else MIDDLE
    theta = SampleGrid(tuple(replace(axis, theta=axis.between(*places)) for axis in samples)).theta
    for name, table, weights in (
        ("mass", tables.mass[:, :, r:, r:], tables.mass_weights),
        ("stiffness", tables.stiffness, tables.stiffness_weights),
    ):
        between = interpolant(samples, table, scene.interpolation)(theta)
        for k in range(n_samples):
            point = {key: float(column[k]) for key, column in values.items()}
            matrices = _scaled(with_units(np.tensordot(evaluate_weights(weights, point), between, axes=(0, 1))))
            with suppress(np.linalg.LinAlgError):  # factors are far cheaper than eigenvalues
                np.linalg.cholesky(matrices - SMALLEST * np.eye(matrices.shape[-1]))
                continue
            smallest = np.linalg.eigvalsh(matrices)[:, 0]
            worst = int(np.argmin(smallest))
            if smallest[worst] < SMALLEST:
                where = ", ".join(["", *filter(None, [values_text(scene, point, ".4g")])])
                units = ["m" if slides(scene, coordinate) else "rad" for coordinate in scene.coordinates.values()]
                places = [axis.in_first_turn(value) for axis, value in zip(samples, theta[worst])]
                at = ", ".join(scene.system.text(*place, ".4g") for place in zip(places, units))
                return (
                    f"with {' x '.join(str(axis.n // axis.turns) for axis in samples)} angles the interpolated {name} "
                    f"matrix is not positive definite at {at}{where} (smallest "
                    f"eigenvalue {smallest[worst]:.2g}, diagonal 1): the model runs away with small steps; take "
                    f"{smoother(scene.interpolation)}"
                )
    return ""


@contextmanager
def definite_mass(where: str, scheme: str) -> Iterator[None]:
    """Raise `InputError` with the cure where modes take an interpolated mass that is indefinite, in a scheme."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        cure = f"build with {smoother(scheme)}, or take sampled angles"
        raise InputError(f"{where}: the interpolated mass matrix is not positive definite there; {cure}") from error


def smoother(scheme: str) -> str:
    """Return what makes interpolated matrices follow the samples more closely than with this interpolation."""
    if scheme == "spline":
        return "more reduction.angles or fewer reduction.modes"
    return 'more reduction.angles, fewer reduction.modes, or reduction.interpolation = "spline"'


def with_units(stiffness: np.ndarray) -> np.ndarray:
    """Return stiffness matrices (n, m, m) with 1 on the diagonal of coordinates that have none, as elastic joints do:
    what is left is as definite as it is without these."""
    empty = ~stiffness.any(axis=(0, 1))
    return stiffness + np.diag(empty.astype(float)) if empty.any() else stiffness


def _scaled(matrices: np.ndarray) -> np.ndarray:
    """Return matrices (n, m, m) scaled to a unit diagonal; the negative identity for those that cannot be."""
    diagonal = np.einsum("nii->ni", matrices)
    positive = np.all(diagonal > 0.0, axis=1)
    scale = 1.0 / np.sqrt(np.where(positive[:, None], diagonal, 1.0))
    return np.where(positive[:, None, None], matrices * scale[:, :, None] * scale[:, None, :], -np.eye(len(scale.T)))
