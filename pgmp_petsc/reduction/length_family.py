"""Reduced models of one scene at the points of a grid of lengths, in bases that are continuous over the lengths too.

The rigid motion depends on a length l as on nothing else: ``q = rho(theta; l) + Psi(theta; l) delta``. The members of
the family are models built at the points l_p; their bases are expressed in that of the model at the nominal lengths,

    Psi_p R_p,    R_p(theta) = (Psi_p^T M Psi_p)^-1 Psi_p^T M Psi_nominal,

so that entries of their tables are smooth in l, whatever signs, order and rotations the builds have found (Amsallem and
Farhat 2011 join the members of a family so). In between, tables are polynomials of l (`sample_grid`). The kinematics of
one run are exact: the mechanism is made anew with its lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pgmp_petsc.bodies.matrices import mass_of_bodies
from pgmp_petsc.bodies.shape import at_lengths
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.reduction.cell_products import SecondOrderTables
from pgmp_petsc.reduction.missed_answers import MissedAnswers
from pgmp_petsc.reduction.mode_changes import ModeChanges, StiffnessChanges
from pgmp_petsc.reduction.sample_grid import LengthGrid
from pgmp_petsc.reduction.tables import ReducedTables, rigid_inertia
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from pgmp_petsc.reduction.rom import ReducedOrderModel

#: Tables by the weights that their terms have.
OF_TABLES = {
    "mass": "mass_weights",
    "inertia": "mass_weights",
    "stiffness": "stiffness_weights",
    "load": "load_weights",
}
OF_SECOND_ORDER = ("cubic", "curved_load", "curved_inertia")
OF_CHANGES = ("gyroscopic", "spread")
OF_MISSED = ("forces", "answers")
Arrays = TypeVar("Arrays", ReducedTables, SecondOrderTables, ModeChanges, StiffnessChanges, MissedAnswers)


@dataclass(frozen=True, eq=False)
class LengthCheck:
    """How far the family is from a model that was built between its points."""

    values: dict[str, float]  # lengths of that model, m
    #: frequencies, inertia: largest difference of the reduced frequencies of the modes at any angle, and of the rigid
    #: inertia, as shares
    frequencies: float
    inertia: float


@dataclass(frozen=True, eq=False)
class LengthFamily:
    """Models at the points of a grid of lengths."""

    grid: LengthGrid  # the grid
    #: a model of each point, without meshes (`bodies.shape` makes them), all in continuous bases
    members: tuple[ReducedOrderModel, ...]
    check: LengthCheck  # of the family against a model of none of these points

    def at(self, scene: Scene, nominal: ReducedOrderModel) -> ReducedOrderModel:
        """Return the model with the lengths of a scene's run (``scene.values``).

        Kinematics and rigid inertia are exact, tables and shapes polynomials of the lengths. Raises `InputError` if the
        mechanism cannot be closed with these lengths.

        Parameters
        ----------
        nominal
            The model at the nominal lengths, which the family belongs to.
        """
        kinematics = self.kinematics(scene, nominal, None)
        mechanism = kinematics.mechanism
        masses = mass_of_bodies(mechanism.bodies, range(mechanism.n_dofs))
        parts = [member.tables for member in self.members]
        tables = replace(
            self._of_parts(scene, parts, tuple(OF_TABLES)),
            second_order=self._of_parts(scene, [part.second_order for part in parts], OF_SECOND_ORDER),
            changes=self._of_parts(scene, [part.changes for part in parts], OF_CHANGES),
        )
        return replace(
            nominal,
            tables=tables,
            branch=kinematics.branch,
            rigid_inertia=rigid_inertia(tables.samples, masses, kinematics),
            projection=self._blended(scene, [member.projection for member in self.members]),
            curvature=None
            if nominal.curvature is None
            else self._blended(scene, [member.curvature for member in self.members]),
            frequencies_hz=self._blended(scene, [member.frequencies_hz for member in self.members]),
            stiffness_changes=self._of_parts(
                scene, [member.stiffness_changes for member in self.members], ("influence", "stiffness")
            ),
            missed=self._of_parts(scene, [member.missed for member in self.members], OF_MISSED),
            meshes=at_lengths(scene, nominal.meshes),
        )

    def kinematics(self, scene: Scene, nominal: ReducedOrderModel, number: int | None) -> RigidKinematics:
        """Return the rigid kinematics of a scene's run, or those of a member, given by its number."""
        branch = None
        if number is not None:
            scene, branch = scene.with_values(self.grid.points[number]), self.members[number].branch
        return RigidKinematics(Mechanism.from_scene(scene, at_lengths(scene, nominal.meshes)), branch)

    def merged(self, nominal: ReducedOrderModel) -> ReducedOrderModel:
        """Return the model whose terms are affine in monomials of the lengths besides all other parameters.

        Its tables and its rigid inertia are those of any lengths; kinematics and shapes are the nominal ones.
        """
        tables, grid, parts = nominal.tables, self.grid, [member.tables for member in self.members]
        weights = {name: grid.weights(getattr(tables, name)) for name in dict.fromkeys(OF_TABLES.values())}
        n_each = len(grid.points)
        merged = replace(
            tables,
            **{name: grid.coefficients([getattr(part, name) for part in parts]) for name in OF_TABLES},
            **weights,
            load_effects=tuple(name for name in tables.load_effects for _ in range(n_each)),
        )
        for field, names in (("second_order", OF_SECOND_ORDER), ("changes", OF_CHANGES)):
            own = [getattr(part, field) for part in parts]
            if own[0] is not None:
                arrays = {name: grid.coefficients([getattr(one, name) for one in own]) for name in names}
                merged = replace(merged, **{field: replace(own[0], **arrays)})
        rigid = grid.coefficients([member.rigid_inertia for member in self.members])
        return replace(nominal, tables=merged, rigid_inertia=rigid, stiffness_changes=self._merged_changes(tables))

    def _merged_changes(self, tables: ReducedTables) -> StiffnessChanges | None:
        """Return the influences of terms that are affine in monomials of the lengths, of whose units these are."""
        members, grid = [member.stiffness_changes for member in self.members], self.grid
        if members[0] is None:
            return None
        influence = np.swapaxes(grid.coefficients([np.swapaxes(one.influence, 1, 2) for one in members]), 1, 2)
        r, n_mass, n_each = tables.n_coordinates, len(tables.mass_weights), len(grid.points)
        n_moving = r + r * (r + 1) // 2
        rest, inertia = np.split(influence, [influence.shape[2] - n_mass * n_moving * n_each], axis=2)
        # monomials belong to the weights of terms, motions to each of these
        inertia = np.swapaxes(inertia.reshape(*inertia.shape[:2], n_mass, n_moving, n_each), 3, 4)
        influence = np.concatenate([rest, inertia.reshape(*rest.shape[:2], n_mass * n_moving * n_each)], axis=2)
        return StiffnessChanges(influence, grid.coefficients([one.stiffness for one in members]))

    def _of_parts(self, scene: Scene, parts: Sequence[Arrays | None], names: Sequence[str]) -> Arrays | None:
        """Return the polynomials of some fields of dataclasses; None where there is nothing."""
        if parts[0] is None:
            return None
        return replace(
            parts[0], **{name: self._blended(scene, [getattr(one, name) for one in parts]) for name in names}
        )

    def _blended(self, scene: Scene, arrays: Sequence[np.ndarray]) -> np.ndarray:
        shares = self.grid.shares(scene.values)
        return sum(share * array for share, array in zip(shares, arrays))
