"""Multipliers of joints in a reduced model: rows of unit gaps in its equations (`reduced.gap_forces`).

Friction that hangs on the force that a joint carries is in these equations, and that force of them: at given
accelerations the two are found in turn, which contracts by about the coefficient times a lever over a length. Forces of
controllers are known with the states; where they jump, accelerations are those before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Values
from pgmp_petsc.controllers.running import BEFORE
from pgmp_petsc.controllers.running import rows_of as rows_of_beside
from pgmp_petsc.effects import Effect, Motion, actions_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.models.model import MultipliersOf
from pgmp_petsc.outputs.joint_forces import ForceOutput
from pgmp_petsc.outputs.readings import Seen
from pgmp_petsc.reduced.actions import ReducedActions, nodes_of
from pgmp_petsc.reduced.carried_forces import CarriedForces
from pgmp_petsc.reduced.gap_forces import GapForces
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedDamping, ReducedTerms
from pgmp_petsc.reduction.joint_gaps import rows_of
from pgmp_petsc.reduction.reconstruction import Reconstruction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import State

AT_ONCE = 4096  # states whose local effects are evaluated together
MOST_KEPT = 3  # systems that are used again: of all samples, of many states, and of those that are left
MOST_TURNS, SETTLED = 100, 1e-12  # of forces carried and friction, found in turn


class ReducedMultipliers:
    """The multipliers of what joints hold and of prescribed coordinates, from states of a reduced model.

    `forces` are outputs that are made of multipliers, `carried` forces in joints that effects hang on, motions those
    that are prescribed, by the numbers of their coordinates, and `own` terms and local effects of the model. Raises
    `InputError` if the model was built without the gaps of an output, or of an effect.
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
        own: tuple[ReducedTerms, ReducedActions],
    ) -> None:
        n_held, gaps = kinematics.mechanism.n_held, rom.gaps
        known = np.zeros(0, dtype=int) if gaps is None else gaps.rows
        for entry, force in ((table, one) for table, of in (("outputs", forces), ("effects", carried)) for one in of):
            if not np.isin(rows_of([force], n_held), known).all():
                raise InputError(
                    f"{entry}.{force.name}: the reduced model was built without what forces in this joint need; name "
                    "it in the scene and run pgmp build again"
                )
        self._n_held, self._effects, self._motions = n_held, effects, motions
        self._drives = any((force.rows >= n_held).any() for force in forces)
        self.gaps, (self._terms, self._actions) = None, own
        self._carried, scheme = carried, scene.interpolation
        self._rows_of_control = rows_of_beside(scene)[len(carried) :]
        self._nodes = sorted({node for one in carried for node in one.nodes})
        self._frames = Reconstruction(kinematics, rom, scheme, self._nodes) if self._nodes else None
        self._kept: dict[int, tuple[ReducedSystem, Mapping[str, np.ndarray]]] = {}  # by numbers of samples
        self.rows = rows_of((*forces, *carried), n_held)
        if self.rows.size:
            gaps = gaps.of_rows(self.rows)
            wider = replace(rom, projection=np.concatenate([rom.projection, gaps.shapes], axis=2))
            damping = ReducedDamping.of(effects, kinematics, wider)
            loaded = [kinematics.mechanism.node_dofs(node) for node in nodes_of(self._actions.actions)]
            self.gaps = GapForces.of(gaps, rom.tables, scheme, damping, scene.gyroscopic, loaded)

    def under(self, effects: Sequence[Effect]) -> Self:
        """Return the multipliers under effects that differ in what acts over time alone."""
        other = copy(self)
        other._effects, other._kept = effects, {}
        other._actions = replace(self._actions, actions=actions_of(effects))
        return other

    def of(self, times: np.ndarray | float, states: State, values: Values) -> np.ndarray:
        """Return the multipliers, shape (n_held + n_driven, n), NaN where they are not known, in states (n, n_eta);
        times (s) and parameter values are numbers or of shape (n,). Under control they take ``states.forces``, as of
        `ReducedModel.observed_of`."""
        n = len(states.q)
        times, values = np.broadcast_to(times, n), {name: np.broadcast_to(one, n) for name, one in values.items()}
        if self._carried or self._rows_of_control or not n:
            return self._turn_by_turn(times, states, values)
        n_samples, found = _side_by_side(times, values), self._nothing(n)
        together = n_samples * max(1, AT_ONCE // n_samples)  # states with the values of those before: a system is kept
        if self.rows.size:
            own = {name: one[:n_samples] for name, one in values.items()}
            system, loads = self._system_of(n_samples, own), []
            for first in range(0, n, together):
                some = slice(first, first + together)
                loads.append(self._node_loads(system, times[some], _part(states, some)))
            every = np.concatenate(loads)
            found[self.rows] = -self.gaps.at(times, states, own, self._effects, every, n_samples)
        together = min(together, AT_ONCE)  # of what is not side by side too
        for first in range(0, n if self._drives else 0, together):
            some = slice(first, min(first + together, n))
            system = self._system_of(some.stop - first, {name: one[some] for name, one in values.items()})
            found[self._n_held :, some] = self._of_drives(system, times[some], _part(states, some))
        return found

    def _turn_by_turn(self, times: np.ndarray, states: State, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the multipliers where forces that joints carry, or of controllers, are in the equations."""
        found = self._nothing(times.size)
        for first in range(0, times.size, AT_ONCE):
            some = slice(first, min(first + AT_ONCE, times.size))
            own, state = {name: one[some] for name, one in values.items()}, _part(states, some)
            system = self._system_of(some.stop - first, own)
            loads = np.zeros((len(self._carried), some.stop - first))
            acting = [np.zeros((rows, some.stop - first, 3)) for rows in self._rows_of_control]
            for part, force in zip(acting, states.forces[some, BEFORE, len(loads) :].T if acting else ()):
                part[0, :, 0] = force
            for _ in range(MOST_TURNS):
                found[:, some], before = self._with(system, loads, times[some], state, own, acting), loads
                loads = self._loads(state, found[:, some], own)
                if not np.any(np.abs(loads - before) > SETTLED * np.abs(loads)):
                    break
        return found

    def in_steps(
        self, values: Mapping[str, np.ndarray], n_samples: int, acting: Callable[[State], np.ndarray]
    ) -> MultipliersOf:
        """Return what finds the multipliers of samples as an iteration goes on, under what controllers give then
        (`Controls.acting`); a sample that does not move keeps what it had, so that what is beside it changes no more
        than round-off."""
        every = {name: np.broadcast_to(one, n_samples) for name, one in values.items()}
        system, n_own = self._system(n_samples, every), self._terms.layout.n_eta
        kept: list[np.ndarray | None] = [np.full((n_samples, n_own), np.nan), None]

        def multipliers(time: float, state: State, loads: np.ndarray) -> np.ndarray:
            times = np.full(n_samples, time)
            found = self._with(system, loads, times, state, every, [acting(state)])
            same = (kept[0] == state.a).all(axis=1)
            if same.any():
                found[:, same] = kept[1][:, same]
            kept[:] = state.a.copy(), found
            return found

        return multipliers

    def take_actions(self, actions: ReducedActions) -> None:
        """Take local effects of samples with any lengths in place of the model's own: a law that bends, of a stop or of
        friction, has the force that it has at the sample's places, not at those of the model's lengths."""
        self._actions = actions

    def in_lanes(self) -> CarriedForces | None:
        """Return what steps in lanes take of the forces that joints carry; see `CarriedForces.of`."""
        actions = self._actions.actions
        rubbing = [k for k, action in enumerate(actions) if action.law.loaded]
        return CarriedForces.of(
            self.gaps, self.rows.tolist(), self._terms.terms, self._terms.grid, self._carried, rubbing, actions
        )

    def _nothing(self, n: int) -> np.ndarray:
        return np.full((self._n_held + len(self._motions), n), np.nan)

    def _with(
        self, system: ReducedSystem, loads: np.ndarray, times: np.ndarray, state: State,
        values: Mapping[str, np.ndarray], acting: Iterable[np.ndarray] = (),
    ) -> np.ndarray:  # fmt: skip
        """Return the multipliers where joints carry forces (n_carried, n), and controllers act, as of `Controls`."""
        found = self._nothing(times.size)
        system.put_forces([*loads[..., None], *(row for part in acting for row in part)])
        if self._drives:
            found[self._n_held :] = self._of_drives(system, times, state)
        if self.rows.size:
            of_nodes = self._node_loads(system, times, state)
            found[self.rows] = -self.gaps.at(times, state, values, self._effects, of_nodes, system.n_samples)
        return found

    def _of_drives(self, system: ReducedSystem, times: np.ndarray, state: State) -> np.ndarray:
        return -system.residuals_at(times, state)[:, sorted(self._motions)].T

    def _node_loads(self, system: ReducedSystem, times: np.ndarray, state: State) -> np.ndarray:
        """Return what local effects do to their nodes in states of a system's samples, at one instant after the other,
        (n, n_dofs)."""
        if not self._actions.actions:
            return np.empty((times.size, 0))
        trail = np.stack([part.reshape(-1, system.n_samples, part.shape[1]) for part in (state.q, state.v)], axis=1)
        found = system.node_loads(times.reshape(len(trail), -1), trail)
        # behind the nodes of bodies there may be points of the ground: `ReducedActions.joined`
        nodes = found.reshape(times.size, self._actions.places.n_nodes, -1)[:, : len(nodes_of(self._actions.actions))]
        return nodes.reshape(times.size, -1)

    def _loads(self, state: State, multipliers: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the forces that joints carry, (n_carried, n)."""
        if not self._carried:
            return np.zeros((0, len(state.q)))
        jets = () if self._frames is None else self._frames.jets((state.q, state.v), 1)
        at = tuple(dict(zip(self._nodes, part)) for part in jets) or ({},)
        seen = Seen(at, values=values, multipliers=multipliers)
        return np.array([one.made(one.parts(seen)) for one in self._carried])

    def _system_of(self, n: int, values: Mapping[str, np.ndarray]) -> ReducedSystem:
        """Return n samples of the model; the last ones again where they are the same."""
        if n not in self._kept or not _same(self._kept[n][1], values):
            values = {name: np.array(one) for name, one in values.items()}
            if len(self._kept) > MOST_KEPT:
                self._kept.clear()
            self._kept[n] = self._system(n, values), values
        return self._kept[n][0]

    def _system(self, n: int, values: Mapping[str, np.ndarray]) -> ReducedSystem:
        """Return n samples of the model."""
        given = np.zeros((self._terms.tables.n_given, n))
        return ReducedSystem(self._terms, self._effects, values, (0.0, 0.0), n, self._motions, self._actions, given)


def _part(states: State, some: slice) -> State:
    return State(states.q[some], states.v[some], states.a[some], np.zeros(0))


def _side_by_side(times: np.ndarray, values: Mapping[str, np.ndarray]) -> int:
    """Return how many samples are at one instant after the other, of their times and values (n,); n where they are not
    the same samples."""
    n = times.size
    found = int(np.argmin(times == times[0]))  # states at the first instant, 0 where all are
    if not found or n % found or (times.reshape(-1, found) != times[::found, None]).any():
        return n
    return found if all((one.reshape(-1, found) == one[:found]).all() for one in values.values()) else n


def _same(values: Mapping[str, np.ndarray], others: Mapping[str, np.ndarray]) -> bool:
    """Return whether samples have the same values: what is interpolated for them is kept from call to call."""
    return values.keys() == others.keys() and all(np.array_equal(values[name], one) for name, one in others.items())
