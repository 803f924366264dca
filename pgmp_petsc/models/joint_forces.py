"""Multipliers of joints in a reduced model: residuals of unit gaps in its equations (`reduction.joint_gaps`).

Friction that hangs on the force that a joint carries is in these equations, and that force of them: at given
accelerations the two are found in turn, which contracts by about the coefficient times a lever over a length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.effects import Effect, Motion, actions_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.models.measures import MultipliersOf
from pgmp_petsc.outputs.joint_forces import ForceOutput
from pgmp_petsc.reduced.actions import ReducedActions
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedDamping, ReducedTerms
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.joint_gaps import rows_of
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State

AT_ONCE = 2048  # states that are evaluated together: their polynomials stay in the cache
MOST_TURNS, SETTLED = 100, 1e-12  # of forces carried and friction, found in turn
MANY = 64  # samples at an instant from which on instants are evaluated one by one


class ReducedMultipliers:
    """The multipliers of what joints hold and of prescribed coordinates, from states of a reduced model.

    Parameters
    ----------
    scene, rom, kinematics
        The scene, the reduced model, and the mechanism's kinematics.
    forces, carried
        Outputs that are made of multipliers, and forces in joints that effects hang on.
    effects, motions
        What acts, and the prescribed motions by the numbers of their coordinates.
    start
        Positions (rad) of the coordinates at the start, shape (n_theta,).

    Raises
    ------
    InputError
        If the model was built without the gaps of an output, or of an effect.
    """

    def __init__(
        self,
        scene: Scene,
        rom: ReducedOrderModel,
        kinematics: RigidKinematics,
        forces: Sequence[ForceOutput],
        carried: Sequence[ForceOutput],
        effects: Sequence[Effect],
        motions: Mapping[int, Motion],
        start: np.ndarray,
    ) -> None:
        known = np.zeros(0, dtype=int) if rom.gaps is None else rom.gaps.rows
        for entry, force in ((table, one) for table, of in (("outputs", forces), ("effects", carried)) for one in of):
            if not np.isin(rows_of([force], kinematics.mechanism.n_held), known).all():
                raise InputError(
                    f"{entry}.{force.name}: the reduced model was built without what forces in this joint need; name "
                    "it in the scene and run pgmp build again"
                )
        self._asked, self._carried = any(force.rows.size for force in (*forces, *carried)), carried
        self._n_held, self._n_own = kinematics.mechanism.n_held, rom.tables.n_modes + rom.tables.n_coordinates
        self._rows, self._effects, self._motions = known, effects, motions
        scheme, wider = scene.interpolation, rom.with_gaps
        self._nodes = sorted({node for one in carried for node in one.nodes})
        self._frames = Reconstruction(kinematics, rom, scheme, self._nodes)
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
        n = len(states.q)
        times, values = np.broadcast_to(times, n), {name: np.broadcast_to(one, n) for name, one in values.items()}
        found = np.full((self._n_held + len(self._motions), n), np.nan)
        if not self._asked:
            return found
        together, same = _samples(times, values)
        system = self._system(together, {name: one[:together] for name, one in values.items()}) if same else None
        for first in range(0, n, together):
            some = slice(first, min(first + together, n))
            own = {name: one[some] for name, one in values.items()}
            rows = system or self._system(some.stop - first, own)
            state = State(*(part[some] for part in (states.q, states.v, states.a)), np.zeros(0))
            loads = np.zeros((len(self._carried), some.stop - first))
            for _ in range(MOST_TURNS):
                found[:, some], before = self._with(rows, loads, times[some], state, own), loads
                loads = self._loads(state, found[:, some], own)
                if not np.any(np.abs(loads - before) > SETTLED * np.abs(loads)):
                    break
        return found

    def in_steps(self, values: Mapping[str, np.ndarray], n_samples: int) -> MultipliersOf:
        """Return what finds the multipliers of samples as an iteration goes on; a sample that does not move keeps what
        it had, so that it is the same whatever is beside it."""
        every = {name: np.broadcast_to(one, n_samples) for name, one in values.items()}
        system, kept = self._system(n_samples, every), [np.full((n_samples, self._n_own), np.nan), None]

        def multipliers(time: float, state: State, loads: np.ndarray) -> np.ndarray:
            found = self._with(system, loads, np.full(n_samples, time), state, every)
            same = (kept[0] == state.a).all(axis=1)
            if same.any():
                found[:, same] = kept[1][:, same]
            kept[:] = state.a.copy(), found
            return found

        return multipliers

    def _with(
        self,
        system: ReducedSystem,
        loads: np.ndarray,
        times: np.ndarray,
        state: State,
        values: Mapping[str, np.ndarray],
    ) -> np.ndarray:
        """Return the multipliers where joints carry forces (n_carried, n)."""
        found, driven = np.full((self._n_held + len(self._motions), len(times)), np.nan), sorted(self._motions)
        system.put_forces(list(loads[..., None]))
        wider = State(*(self._wider(part) for part in (state.q, state.v, state.a)), np.zeros(0))
        residual = system.residuals_at(times, wider)
        found[self._rows] = -residual[:, self._n_own :].T
        if self._inertia is not None:
            found[self._rows] -= self._as_inertia_changes(wider, values)
        found[self._n_held :] = -residual[:, driven].T
        return found

    def _loads(self, state: State, multipliers: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the forces that joints carry, (n_carried, n)."""
        if not self._carried:
            return np.zeros((0, len(state.q)))
        at, moving = (dict(zip(self._nodes, part)) for part in self._frames.jets((state.q, state.v), 1))
        return np.array([one.value(at, moving, multipliers, values) for one in self._carried])

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
