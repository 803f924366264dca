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
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.joint_gaps import rows_of
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State

AT_ONCE = 2048  # states that are evaluated together: their polynomials stay in the cache
MANY = 64  # samples at an instant from which on instants are evaluated one by one


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
        self._asked = any(force.rows.size for force in forces)
        self._n_held, self._n_own = kinematics.mechanism.n_held, rom.tables.n_modes + rom.tables.n_coordinates
        self._rows, self._effects, self._motions = known, effects, motions
        scheme, wider = scene.interpolation, rom.with_gaps
        self._weights, self._inertia = rom.tables.mass_weights, None
        if rom.gaps is not None and rom.gaps.cubic is not None:
            inertia = np.moveaxis(rom.gaps.mass[..., rom.tables.n_coordinates :], -1, 1)
            self._inertia = interpolant(rom.tables.samples, inertia.reshape(*inertia.shape[:2], -1), scheme)
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
        times, values = np.broadcast_to(times, n), {name: np.broadcast_to(one, n) for name, one in values.items()}
        found = np.full((self._n_held + len(driven), n), np.nan)
        if not self._asked:
            return found
        together, same = _samples(times, values)
        system = self._system(together, {name: one[:together] for name, one in values.items()}) if same else None
        for first in range(0, n, together):
            some = slice(first, min(first + together, n))
            rows = system or self._system(some.stop - first, {name: one[some] for name, one in values.items()})
            state = State(*(self._wider(part[some]) for part in (states.q, states.v, states.a)), np.zeros(0))
            residual = rows.residuals_at(times[some], state)
            found[self._rows, some] = -residual[:, self._n_own :].T
            if self._inertia is not None:
                found[self._rows, some] -= self._as_inertia_changes(state, {k: v[some] for k, v in values.items()})
            found[self._n_held :, some] = -residual[:, driven].T
        return found

    def _as_inertia_changes(self, state: State, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return ``1/2 m_ij' theta'' d_j``, shape (g, n): what is linear in accelerations of theta of all that
        skew gyroscopic terms leave out (`JointGaps.changing`)."""
        m, n = self._inertia.shape[0], len(state.q)
        theta, delta = np.split(state.q[:, : self._n_own], [self._n_own - m], axis=1)
        found = sum(self._inertia.product(theta, 0.5 * state.a[:, k, None] * delta, k) for k in range(theta.shape[1]))
        shares = [np.broadcast_to(weight.evaluate(values), n) for weight in self._weights]
        return np.einsum("nwg,wn->gn", found.reshape(n, len(shares), self._rows.size), shares)

    def _system(self, n: int, values: Mapping[str, np.ndarray]) -> ReducedSystem:
        given = np.zeros((self._terms.tables.n_given, n))
        return ReducedSystem(self._terms, self._effects, values, (0.0, 0.0), n, self._motions, self._actions, given)

    def _wider(self, rows: np.ndarray) -> np.ndarray:
        """Return coordinates (n, n_eta), or their rates, with those of the gaps behind them."""
        return np.hstack([rows, np.zeros((len(rows), self._rows.size))])


def _samples(times: np.ndarray, values: Mapping[str, np.ndarray]) -> tuple[int, bool]:
    """Return how many rows are evaluated together, and whether they are the same samples at one instant after the
    other: what is interpolated for these is kept from instant to instant."""
    n = int(np.argmin(np.append(times == times[0], False)))
    if n < MANY or len(times) % n or any((one.reshape(-1, n) != one[:n]).any() for one in values.values()):
        return AT_ONCE, False
    return n, True
