"""The terms of the reduced equations of motion as interpolants, shared by all samples of an ensemble.

What belongs to the rigid motion alone comes on a fine grid (`reduction.tables`); what involves flexible modes is
interpolated between the samples.

Structural damping in the reduced model; `effects.damping` has the equations.

In body frames the damping matrices of all bodies are constant, so that

    D(theta) = Psi^T (sum_b beta_b K_b + alpha_b M_b + P_b P_b^T) Psi,     Psi = [d rho/d theta, Psi_flexible]

and rigid motion is braked by alpha alone. What all bodies have of alpha in common brakes the momentum of the reduced
model itself (`lagrangian`), which has the terms of higher order in the deformation, too; only what exceeds it is
in D.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects import Effect
from pgmp_petsc.full.damping import BodyDampings
from pgmp_petsc.lanes.vectors import N_POWERS_OF_RIGID
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import rigid_velocities
from pgmp_petsc.reduced.arrays import Layout, Tables
from pgmp_petsc.reduced.cells import Cells, Grid
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.tables import ReducedTables, fine_grid
from pgmp_petsc.scene import Scene


@dataclass(frozen=True)
class ReducedDamping:
    """Structural damping of a reduced model."""

    effect: str  # name of the effect, or of several
    mass: float  # factor alpha that all bodies have in common, 1/s
    weights: tuple[Monomial, ...]  # monomials of the terms of D
    table: np.ndarray  # ``D_i`` at the samples, symmetric, shape (n, n_terms, n_eta, n_eta)

    @classmethod
    def of(
        cls, effects: Sequence[Effect], kinematics: RigidKinematics, rom: ReducedOrderModel
    ) -> ReducedDamping | None:
        """Return the damping of all bodies, None if there is none."""
        mechanism = kinematics.mechanism
        found = BodyDampings.of(effects, mechanism)
        names = dict.fromkeys([*found.effects.values(), *(modal.effect for modal in found.modal)])
        if not names:
            return None
        rayleigh = found.rayleigh.tolist()
        common = min(alpha for _, alpha in rayleigh)
        # [d rho/d theta, Psi_flexible] in body frames at the samples, shape (n, n_dofs, n_eta)
        poses = kinematics.poses(rom.tables.samples.theta)
        at = zip(np.moveaxis(poses, -1, 0), np.moveaxis(kinematics.rates(poses), -1, 0))
        shapes = np.concatenate([np.array([rigid_velocities(mechanism, *one) for one in at]), rom.projection], axis=2)
        r, n_eta = rom.tables.n_coordinates, shapes.shape[2]
        terms: dict[Monomial, np.ndarray] = {}

        def add(weight: Monomial, table: np.ndarray) -> None:
            terms[weight] = terms.get(weight, 0.0) + 0.5 * (table + np.swapaxes(table, 1, 2))

        for body, (beta, alpha) in zip(mechanism.bodies, rayleigh):
            rows, alone = body.dofs, body.alone()
            matrices = AffineMatrices([alone], range(rows.size))
            for factor, of_body, first in ((beta, matrices.stiffness, r), (alpha - common, matrices.mass, 0)):
                if factor:
                    for weight, matrix in of_body.items():
                        table = np.zeros((len(shapes), n_eta, n_eta))
                        own = shapes[:, rows, first:]
                        product = np.einsum("nki,kl,nlj->nij", own, factor * matrix.toarray(), own, optimize=True)
                        table[:, first:, first:] = product
                        add(weight, table)
        for modal in found.modal:
            own = shapes[:, mechanism.bodies[modal.body].dofs, r:]
            rates = np.einsum("im,nij->nmj", modal.factor, own)
            table = np.zeros((len(shapes), n_eta, n_eta))
            table[:, r:, r:] = np.einsum("nmi,nmj->nij", rates, rates)
            add(Monomial(), table)
        table = np.zeros((len(shapes), len(terms), n_eta, n_eta))
        for k, values in enumerate(terms.values()):
            table[:, k] = values
        return cls(", ".join(names), common, tuple(terms), table)


# rad, or of the mechanism's size; in such cells polynomials of degree 7 agree with the rigid inertia to 4e-10 of its
# largest value in all scenes of one coordinate. Of two, 12 cells a turn are as good as the spline is: 5e-7 in five_bar.
WIDEST = 2 * np.pi / 48


@dataclass(frozen=True, eq=False)
class ReducedTerms:
    """Interpolated terms of a reduced model."""

    tables: ReducedTables  # the tables they were made from
    weights: tuple[Monomial, ...]  # monomials of the terms of mass and stiffness together
    rigid: Interpolant  # packed rigid inertia of every term, rows of shape (n_terms, n_theta (n_theta + 1) / 2)
    #: packed mass, couplings `coupling_of` and packed stiffness of every term side by side, what there is of second
    #: order, and structural damping, rows of shape (n_terms, n_entries); zero where a term has no part in them. The
    #: first entries, the rigid inertia, are not used.
    terms: Interpolant
    layout: Layout  # where these parts begin
    load: Interpolant  # load terms, rows of shape (n_load_terms, layout.load_end)
    #: displacement (in units of the mechanism's size or 1 rad) per unit of each coordinate, shape (n_eta,)
    scale: np.ndarray
    damping: ReducedDamping | None = None  # structural damping, if there is any

    @cached_property
    def damping_terms(self) -> Interpolant:
        """Structural damping of every term alone, rows of shape (n_terms, n_packed)."""
        return Interpolant(self.terms.axes, np.ascontiguousarray(self.terms.rows[..., self.layout.damping :]))

    @classmethod
    def of(
        cls, rom: ReducedOrderModel, kinematics: RigidKinematics, scene: Scene, damping: ReducedDamping | None = None
    ) -> ReducedTerms:
        """Prepare the terms of a model by a scene's scheme of interpolation over the samples. Its flexible vectors give
        the scale of the flexible coordinates, as the kinematics give the size."""
        tables, samples, scheme = rom.tables, rom.tables.samples, scene.interpolation
        damping_weights = () if damping is None else damping.weights
        weights = tuple(sorted({*tables.mass_weights, *tables.stiffness_weights, *damping_weights}))
        parts = [
            _spread(pack(tables.mass), tables.mass_weights, weights),
            _spread(coupling_of(tables, scheme), tables.mass_weights, weights),
            _spread(pack(tables.stiffness), tables.stiffness_weights, weights),
        ]
        load = tables.load
        if tables.second_order is not None:
            bent, changes = tables.second_order, tables.changes
            parts.append(_spread(pack_cubic(bent.cubic), tables.stiffness_weights, weights))
            swing, gyroscopic = pack(swing_of(tables, scheme)), pack(changes.gyroscopic, -1)
            # pairs of rigid coordinates, or these, one after the other
            for part in (swing, gyroscopic, pack(bent.curved_mass)):
                side_by_side = part.reshape(*part.shape[:2], math.prod(part.shape[2:]))
                parts.append(_spread(side_by_side, tables.mass_weights, weights))
            load = np.concatenate([load, pack(bent.curved_load)], axis=2)
        else:
            parts += [np.zeros((*parts[0].shape[:2], 0))] * 4
        if damping is not None:
            parts.append(_spread(pack(damping.table), damping.weights, weights))
        ends = [int(end) for end in np.cumsum([part.shape[2] for part in parts])]
        r, n_eta = tables.n_coordinates, tables.n_coordinates + tables.n_modes
        space = kinematics.mechanism.space
        scales = np.array([coordinate.scale(kinematics.size) for coordinate in kinematics.coordinates])
        nodal = rom.projection[:, : space.n_dofs * kinematics.mechanism.n_nodes]
        return cls(
            tables=tables,
            weights=weights,
            rigid=interpolant(fine_grid(samples), _spread(rom.rigid_inertia, tables.mass_weights, weights), "spline"),
            terms=interpolant(samples, np.concatenate(parts, axis=2), scheme),
            layout=Layout(tuple(range(r)), n_eta, *ends[:7], ends[-1], load.shape[2], scene.gyroscopic),
            load=interpolant(samples, load, scheme),
            scale=np.concatenate([1.0 / scales, displacement_scale(nodal, kinematics.size, space.dimension)]),
            damping=damping,
        )

    @property
    def grid(self) -> tuple[Grid, ...]:
        """Cells of every coordinate. Of one, polynomials over several cells are no wider than `WIDEST`; of more, a cell
        is made from the rows that reach into it along all of them, which would be too many."""
        axes = self.terms.axes
        most = int(WIDEST / (axes[0].step * self.scale[0]) + 1e-9) if len(axes) == 1 else 1
        return grid_of(self.terms, self.parts, most)

    @property
    def parts(self) -> int:
        """Number of parts of a cell between samples: of one coordinate none is wider than `WIDEST`."""
        axes = self.terms.axes
        return int(np.ceil(axes[0].step * self.scale[0] / WIDEST - 1e-9)) if len(axes) == 1 else 1

    @cached_property
    def cells(self) -> Tables:
        """All terms as the kernel takes them."""
        grid = self.grid
        # one after the other: those of a part are let go before the next one's are made
        return Tables(
            Cells.of(self.rigid, grid, N_POWERS_OF_RIGID), Cells.of(self.terms, grid), Cells.of(self.load, grid)
        )


def grid_of(part: Interpolant, parts: int = 1, most: int = 1) -> tuple[Grid, ...]:
    """Return the cells of an interpolant along every coordinate, each of them in some parts, or at most so many of them
    with one polynomial where it has no more."""
    found = []
    for k, axis in enumerate(part.axes):
        number = np.arange(axis.n_cells * parts)
        begins = number
        if most > 1 and part.begins:
            of_piece = np.zeros(axis.n_cells, dtype=int)
            of_piece[part.begins[k]] = part.begins[k]
            of_piece = np.maximum.accumulate(of_piece)
            begins = number - (number - of_piece) % most
        found.append(Grid(axis.lower, axis.step / parts, number.size, axis.periodic, begins.astype(float)))
    return tuple(found)


def coupling_of(tables: ReducedTables, scheme: str) -> np.ndarray:
    """Return b_i at the samples, pairs k >= l one after the other, shape (n, n_mass_terms, n_pairs * n_delta).

    By the product rule, ``b_kl`` is the symmetric part of the derivative of the mass table's row of theta_k with
    theta_l, taken from the interpolant, less the inertia table.
    """
    r, at = tables.n_coordinates, tables.samples.theta
    block = interpolant(tables.samples, np.ascontiguousarray(tables.mass[:, :, :r, r:]), scheme)
    slopes = [block(at, k) for k in range(r)]
    pairs = [
        0.5 * (slopes[j][:, :, k] + slopes[k][:, :, j]) - tables.inertia[:, :, k, j]
        for k in range(r)
        for j in range(k + 1)
    ]
    return np.concatenate(pairs, axis=2)


def swing_of(tables: ReducedTables, scheme: str) -> np.ndarray:
    """Return c_kl at the samples, pairs k >= l, shape (n, n_mass_terms, n_pairs, n_delta, n_delta).

    The momentum P_k of the curvature along a prescribed coordinate is that of ``v_k d/dt (1/2 P_k delta delta)``, of
    which ``1/2 v_k v_l (d_l P_k) delta delta`` is here, by the product rule with slopes of the interpolant.
    """
    bent, r, at = tables.second_order, tables.n_coordinates, tables.samples.theta
    swing = bent.curved_inertia - tables.changes.spread
    if bent.curved_mass.shape[2]:
        momenta = interpolant(tables.samples, bent.curved_mass, scheme)
        slopes = [momenta(at, k) for k in range(r)]
        for pair, (k, j) in enumerate(zip(*np.tril_indices(r))):
            swing[:, :, pair] -= 0.5 * (slopes[j][:, :, k] + slopes[k][:, :, j])
    return swing


def _spread(table: np.ndarray, own: tuple[Monomial, ...], weights: tuple[Monomial, ...]) -> np.ndarray:
    """Put the terms (axis 1) of a table where their weights are among all weights, zeros elsewhere."""
    result = np.zeros((len(table), len(weights), table.shape[2]))
    result[:, [weights.index(weight) for weight in own]] = table
    return result


def pack(matrices: np.ndarray, diagonal: int = 0) -> np.ndarray:
    """Pack symmetric matrices (..., n, n) as lower triangles row by row, skew ones up to the diagonal -1."""
    rows, columns = np.tril_indices(matrices.shape[-1], diagonal)
    return np.ascontiguousarray(matrices[..., rows, columns])


def pack_cubic(tensors: np.ndarray) -> np.ndarray:
    """Pack symmetric tensors (..., n, n, n) over ``i >= j >= k``, k fastest."""
    i, j, k = np.indices(tensors.shape[-3:]).reshape(3, -1)
    chosen = (i >= j) & (j >= k)
    return np.ascontiguousarray(tensors[..., i[chosen], j[chosen], k[chosen]])


def displacement_scale(projection: np.ndarray, size: float, dimension: int) -> np.ndarray:
    """Return the largest displacement per unit of each flexible coordinate, shape (n_delta,); 1 of one without any: of
    an offset that an elastic joint takes.

    The projection has flexible vectors, shape (n, n_dofs, n_delta), in 2 or 3 dimensions; translations are measured in
    `size`, m.
    """
    node = [1.0 / size] * dimension + [1.0] * (1 if dimension == 2 else 3)
    units = np.tile(node, projection.shape[1] // len(node))
    found = np.max(np.abs(projection) * units[:, None], axis=(0, 1))
    return np.where(found > 0.0, found, 1.0)
