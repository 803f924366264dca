"""Multipliers of joints in a reduced model: rows of unit gaps in its equations (`reduced.gap_forces`)."""

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
from pgmp_petsc.reduced.gap_forces import GapForces
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedDamping, ReducedTerms
from pgmp_petsc.reduction.joint_gaps import rows_of
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State

AT_ONCE = 2048  # states whose local effects are evaluated together


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
    own
        Terms and local effects of the model.

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
        own: tuple[ReducedTerms, ReducedActions],
    ) -> None:
        n_held, gaps = kinematics.mechanism.n_held, rom.gaps
        known = np.zeros(0, dtype=int) if gaps is None else gaps.rows
        for force in forces:
            if not np.isin(rows_of([force], n_held), known).all():
                raise InputError(
                    f"outputs.{force.name}: the reduced model was built without what forces in this joint need; name "
                    "the output in the scene and run pgmp build again"
                )
        self._n_held, self._rows, self._effects, self._motions = n_held, known, effects, motions
        self._drives = any((force.rows >= n_held).any() for force in forces)
        self._gaps, (self._terms, self._own_actions), self._actions = None, own, None
        self._kept: tuple[tuple[int, ReducedSystem | None, ReducedSystem | None] | None, dict] = None, {}
        if not rows_of(forces, n_held).size:
            return
        scheme, terms = scene.reduction.interpolation, own[0]
        projection, curvature = gaps.beside(rom.projection, rom.curvature)
        wider = replace(rom, projection=projection, curvature=curvature)
        self._gaps = GapForces.of(
            gaps, rom.tables, scheme, ReducedDamping.of(effects, kinematics, wider), scene.gyroscopic
        )
        actions = actions_of(effects)
        if actions:
            self._actions = ReducedActions.of(actions, kinematics, wider, scheme, start, terms.parts)
            self._wider = _widened(terms, known.size)

    def under(self, effects: Sequence[Effect]) -> Self:
        """Return the multipliers under effects that differ in what acts over time alone."""
        other, actions = copy(self), actions_of(effects)
        other._effects, other._own_actions = effects, replace(self._own_actions, actions=actions)
        other._actions, other._kept = self._actions and replace(self._actions, actions=actions), (None, {})
        return other

    def of(self, times: np.ndarray | float, states: State, values: Mapping[str, np.ndarray | float]) -> np.ndarray:
        """Return the multipliers, shape (n_held + n_driven, n), NaN where they are not known, in states (n, n_eta);
        times (s) and parameter values are numbers or of shape (n,)."""
        n, driven = len(states.q), sorted(self._motions)
        times, values = np.broadcast_to(times, n), {name: np.broadcast_to(one, n) for name, one in values.items()}
        found = np.full((self._n_held + len(driven), n), np.nan)
        if self._gaps is not None:
            found[self._rows] = -self._gaps.at(times, states, values, self._effects)
        if self._actions is None and not self._drives:
            return found
        for first in range(0, n, AT_ONCE):
            some = slice(first, min(first + AT_ONCE, n))
            own, wide = self._systems({name: one[some] for name, one in values.items()}, some.stop - first)
            state = State(states.q[some], states.v[some], states.a[some], np.zeros(0))
            if wide is not None:
                g = self._rows.size
                moving = State(*(np.pad(part, ((0, 0), (0, g))) for part in (state.q, state.v, state.a)), np.zeros(0))
                found[self._rows, some] -= wide.acting_at(times[some], moving)[:, -g:].T
            if own is not None:
                found[self._n_held :, some] = -own.residuals_at(times[some], state)[:, driven].T
        return found

    def _systems(self, values: Mapping[str, np.ndarray], n: int) -> tuple[ReducedSystem | None, ReducedSystem | None]:
        """Return n samples of the model, where drives are asked for, and samples that know of local effects alone, on a
        basis with the gaps behind it, where there are any; those of the last call, with what they keep of the tables'
        cells, where they have the same values."""
        (kept, known), same = self._kept, False
        if kept is not None and kept[0] == n and values.keys() == known.keys():
            same = all(np.array_equal(known[name], value) for name, value in values.items())
        if not same:
            given, moving = np.zeros((self._terms.tables.n_given, n)), ((0.0, 0.0), n, self._motions)
            values = {name: np.array(value) for name, value in values.items()}
            own = wide = None
            if self._drives:
                own = ReducedSystem(self._terms, self._effects, values, *moving, self._own_actions, given)
            if self._actions is not None:
                wide = ReducedSystem(self._wider, self._effects, values, *moving, self._actions, given)
            self._kept = (n, own, wide), values
        return self._kept[0][1:]


def _widened(terms: ReducedTerms, g: int) -> ReducedTerms:
    """Return the terms of a system of which local effects alone are evaluated, with g coordinates more."""
    tables, n_eta = terms.tables, terms.layout.n_eta + g
    sizes = {
        "mass": (len(tables.mass), 0, n_eta, n_eta),
        "stiffness": (len(tables.mass), 0, *(tables.n_modes + g,) * 2),
    }
    return replace(
        terms, tables=replace(tables, **{name: np.empty(size) for name, size in sizes.items()}),
        layout=terms.layout._replace(n_eta=n_eta), scale=np.pad(terms.scale, (0, g), constant_values=1.0),
    )  # fmt: skip
