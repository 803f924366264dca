"""Multipliers of joints in a reduced model: residuals of unit gaps in its equations (`reduction.joint_gaps`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.effects import Effect, Motion, actions_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.outputs.joint_forces import ForceOutput
from pgmp_petsc.reduced.actions import ReducedActions
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedDamping, ReducedTerms
from pgmp_petsc.reduction.joint_gaps import rows_of
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State

AT_ONCE = 2048  # states that are evaluated together: their polynomials stay in the cache


class ReducedMultipliers:
    """The multipliers of what joints hold and of prescribed coordinates, from states of a reduced model.

    Parameters
    ----------
    scene, rom, kinematics
        The scene, the reduced model, and the mechanism's kinematics.
    forces
        Outputs that are made of multipliers.
    effects, motions
        What acts, and the prescribed motions by the numbers of their coordinates.
    start
        Positions (rad) of the coordinates at the start, shape (n_theta,).

    Raises
    ------
    InputError
        If the model was built without the gaps of an output.
    """

    def __init__(
        self,
        scene: Scene,
        rom: ReducedOrderModel,
        kinematics: RigidKinematics,
        forces: Sequence[ForceOutput],
        effects: Sequence[Effect],
        motions: Mapping[int, Motion],
        start: np.ndarray,
    ) -> None:
        known = np.zeros(0, dtype=int) if rom.gaps is None else rom.gaps.rows
        for force in forces:
            if not np.isin(rows_of([force], kinematics.mechanism.n_held), known).all():
                raise InputError(
                    f"outputs.{force.name}: the reduced model was built without what forces in this joint need; name "
                    "the output in the scene and run pgmp build again"
                )
        self._n_held, self._n_own = kinematics.mechanism.n_held, rom.tables.n_modes + rom.tables.n_coordinates
        self._rows, self._effects, self._motions = known, effects, motions
        scheme, wider = scene.reduction.interpolation, rom.with_gaps
        damping = ReducedDamping.of(effects, kinematics, wider)
        self._terms = ReducedTerms.of(
            wider.tables, wider.rigid_inertia, kinematics, wider.projection, scheme, damping, scene.gyroscopic
        )
        self._actions = ReducedActions.of(
            actions_of(effects), kinematics, wider, scheme, start, self._terms.parts
        )  # fmt: skip

    def under(self, effects: Sequence[Effect]) -> Self:
        """Return the multipliers under effects that differ in what acts over time alone."""
        other = copy(self)
        other._effects, other._actions = effects, replace(self._actions, actions=actions_of(effects))
        return other

    def of(self, times: np.ndarray | float, states: State, values: Mapping[str, np.ndarray | float]) -> np.ndarray:
        """Return the multipliers, shape (n_held + n_driven, n), NaN where they are not known, in states (n, n_eta);
        times (s) and parameter values are numbers or of shape (n,)."""
        n, driven = len(states.q), sorted(self._motions)
        times = np.broadcast_to(times, n)
        found = np.full((self._n_held + len(driven), n), np.nan)
        for first in range(0, n, AT_ONCE):
            some = slice(first, min(first + AT_ONCE, n))
            residual = self._residual(times[some], *(part[some] for part in (states.q, states.v, states.a)), {
                name: np.broadcast_to(value, n)[some] for name, value in values.items()
            })  # fmt: skip
            found[self._rows, some] = -residual[:, self._n_own :].T
            found[self._n_held :, some] = -residual[:, driven].T
        return found

    def _residual(
        self, times: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray, values: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        n, more = len(times), np.zeros((len(times), self._rows.size))
        given = np.zeros((self._terms.tables.n_given, n))
        system = ReducedSystem(
            self._terms, self._effects, values, (0.0, 0.0), n, self._motions, self._actions, given
        )  # fmt: skip
        return system.residuals_at(times, State(*(np.hstack([part, more]) for part in (q, v, a)), np.zeros(0)))
