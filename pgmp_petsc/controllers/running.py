"""Controllers in a run: their states from step to step, and the forces that the mechanics take of them; and the forces
that joints carry, of friction that hangs on these.

`stepping.alpha_step` begins the iteration of a step with `begin`, lets every correction `act`, and ends it with `end`.
Between the corrections measures are read of the iterate itself, as outputs are, so that the iteration ends where
mechanics and states hold together. A controller that is sampled holds its force, and finds the next one, with states by
Euler's implicit rule over its sample time, between two steps (`sample`).

The force that a joint carries is that of the iterate too. It goes with accelerations, and friction changes these: the
iteration contracts by about the coefficient times a lever over a length, so that a step takes a few corrections more,
and what it ends with is solved with the step. In the first accelerations of a run both are found in turn.

Numbers lie in `State.beside`, a row a sample: the forces carried, then of each controller z, z', the auxiliary rates
Z' and the force.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.controllers.acting import has_slopes
from pgmp_petsc.controllers.law import MEASURED, ControlLaw, respond
from pgmp_petsc.effects.time_function import TimeFunction, amplitude_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.controllers import WHOLE, ControllerEntry

MOST_STARTS, SETTLED = 100, 1e-13  # of the forces carried at the start, found in turn with accelerations
#: Forces (n_carried, n_samples) in joints at a time (s), for a state of a system, from those that were found before.
Carried = Callable[[float, Any, np.ndarray], np.ndarray]
#: Measures (n_controllers, n_samples) and their rates at a time (s), for a state of a system.
Measure = Callable[[float, Any], tuple[np.ndarray, np.ndarray]]


@dataclass(eq=False)
class Running:
    """One controller of some samples."""

    entry: ControllerEntry
    law: ControlLaw
    p: np.ndarray  # parameters of its law and its limits, (n_samples, n_parameters)
    reference: TimeFunction | np.ndarray  # over time, or of each sample
    columns: slice  # of the numbers beside
    #: by_measure, by_rate: whether slopes by the measure are stiffness, those by it or its rate damping
    by_measure: float
    by_rate: float
    x: np.ndarray  # what is `MEASURED`, (n_samples, 5)
    z: np.ndarray  # states of an iterate, (n_samples, n)
    force: np.ndarray  # with its slopes by the measure and its rate, (n_samples, 3)
    rates: np.ndarray  # (n_samples, n)
    c: np.ndarray  # (n_samples, n)
    found: np.ndarray
    kappa: float = 0.0

    def respond(self) -> None:
        """Solve for the states, and find the force."""
        respond(self.law.address, self.p, self.x, self.c, self.kappa, self.z, self.found, self.rates, self.force)

    def parts(self, beside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return z, z', Z' (n_samples, n) and the force (n_samples, 1) of the numbers beside, sharing memory."""
        own, n = beside[:, self.columns], self.z.shape[1]
        return own[:, :n], own[:, n : 2 * n], own[:, 2 * n : 3 * n], own[:, 3 * n :]

    def look(self, time: float, measure: np.ndarray, rate: np.ndarray) -> None:
        """Take what is measured at a time."""
        fixed = isinstance(self.reference, np.ndarray)
        now, change = (self.reference, 0.0) if fixed else self.reference.with_rates(time)[:2]
        for column, value in zip(self.x.T, (time, measure, rate, now, change)):
            column[:] = value


class Controls:
    """The controllers of a system.

    Parameters
    ----------
    scene
        The scene; its controllers are in its order.
    values
        Parameter values of the samples, each of shape (n_samples,).
    n_samples
        Number of samples.
    measure
        Reads the measures of a state.
    put
        Takes what is given to each action, in the order of `names`: the force carried, (n_samples, 1); or force,
        stiffness and damping of a controller, (n_samples, 3).
    carried
        Finds the forces that joints carry; None where nothing hangs on these.

    Attributes
    ----------
    iterates
        Whether the iteration of a step has the forces, as it was given them, so that `forces` has none to add.
    """

    def __init__(
        self, scene: Scene, values: Mapping[str, np.ndarray], n_samples: int, measure: Measure,
        put: Callable[[Sequence[np.ndarray]], object], carried: Carried | None = None,
    ) -> None:  # fmt: skip
        self._measure, self._put, self._find = measure, put, carried
        self.names = (*scene.carried, *scene.controllers)
        self._each: list[Running] = []
        n_carried = len(scene.carried)
        self._carried = np.zeros((n_carried, n_samples))
        self._acting = np.zeros((len(self.names) - n_carried, n_samples, 3))
        self.iterates = False
        #: forces at the instants that were reached, (n_controllers, n_samples); where one jumps the mean of both, with
        #: which the trapezoidal rule of works is right, and until the next step `_jumped` has the new ones
        self._kept: dict[float, np.ndarray] = {}
        self._jumped: dict[float, np.ndarray] = {}
        first = n_carried
        for entry in scene.controllers.values():
            law, n = entry.law(), len(entry.law().states)
            every = {**scene.values, **values}
            limits = dict(zip(("lower", "upper"), entry.limits or (-np.inf, np.inf)))
            p = np.empty((n_samples, len(law.parameters) + 2))
            for column, value in zip(p.T, [*(entry.parameters()[name] for name in law.parameters), *limits.values()]):
                column[:] = every[value] if isinstance(value, str) else value
            if entry.reference.changes:
                reference = amplitude_of(entry.reference)
            else:
                constant = entry.reference.constant
                known = every[constant] if isinstance(constant, str) else constant
                reference = np.broadcast_to(np.asarray(known, dtype=float), (n_samples,))
            sloped, of_rate = has_slopes(scene, entry), scene.outputs[entry.measures].derivative
            self._each.append(
                Running(
                    entry, law, p, reference, slice(first, first + 3 * n + 1),
                    float(sloped and not of_rate), float(sloped and of_rate), np.zeros((n_samples, len(MEASURED))),
                    np.zeros((n_samples, n)), np.zeros((n_samples, 3)), np.zeros((n_samples, n)),
                    np.zeros((n_samples, n)), np.zeros(law.n_found),
                )
            )  # fmt: skip
            first += 3 * n + 1
        self._n = first
        self._n_samples = n_samples

    def start(self, state) -> None:
        """Begin a run: find the first states and forces, at time 0, of joints without any."""
        self._look(0.0, state)
        self._carried[:] = 0.0
        state.beside = np.zeros((self._n_samples, self._n))
        for one in self._each:
            states = [one.law.code.initial(p, x) for p, x in zip(one.p.tolist(), one.x.tolist())]
            one.c[:] = one.z[:] = np.array(states).reshape(one.z.shape)
            one.kappa = 0.0
            one.respond()
            z, change, auxiliary, force = one.parts(state.beside)
            z[:], change[:], auxiliary[:], force[:] = one.z, one.rates, one.rates, one.force[:, :1]
            if not np.isfinite(one.force[:, 0]).any():
                name = self.names[self._each.index(one)]
                raise InputError(
                    f"controllers.{name}: its force or the rates of its states are not finite at the start, where the "
                    f"measure is {one.x[0, 1]:g}, its rate {one.x[0, 2]:g} and t = 0"
                )
        self._kept.clear()
        self._keep(0.0, state, np.ones(self._n_samples, dtype=bool))

    def settle(self, state) -> bool:
        """Find what joints carry with the accelerations at the start; return whether that changes these."""
        if not self._carried.size:
            return False
        found = self._find(0.0, state, self._carried)
        change = np.abs(found - self._carried)
        self._carried[:] = found
        state.beside[:, : len(found)] = found.T
        self._kept.clear()
        self._keep(0.0, state, np.ones(self._n_samples, dtype=bool))
        return bool(np.any(change > SETTLED * np.abs(found)))

    def begin(self, time: float, state, scheme) -> None:
        """Begin the iteration of a step that ends at a time, from the numbers beside at its beginning."""
        self.iterates, s = True, scheme
        self._jumped.clear()
        self._carried[:] = state.beside[:, : len(self._carried)].T
        step, kappa = s.gamma / (s.beta * s.gain_v), s.gain_v / s.gain_a
        for one in self._each:
            if one.entry.sample_time:
                continue
            z, change, auxiliary, _ = one.parts(state.beside)
            share = step * s.gamma / (1 - s.alpha_m)
            one.c[:] = z + step * (1 - s.gamma) * auxiliary + share * (s.alpha_f * change - s.alpha_m * auxiliary)
            one.kappa, one.z[:] = kappa, one.c + kappa * change

    def act(self, time: float, state) -> None:
        """Give the mechanics the forces about an iterate."""
        self._look(time, state)
        for one, acting in zip(self._each, self._acting):
            if one.entry.sample_time:
                acting[:, :1], acting[:, 1:] = one.parts(state.beside)[3], 0.0
                continue
            one.respond()
            force, by_measure, by_rate = one.force.T
            acting[:, 0] = force
            acting[:, 1] = -one.by_measure * by_measure
            acting[:, 2] = -one.by_measure * by_rate - one.by_rate * by_measure
        self._find_carried(time, state)
        self._put([*self._carried[:, :, None], *self._acting])

    def end(self, time: float, state, scheme, samples: np.ndarray) -> None:
        """Take the numbers beside of some samples, a mask, to the end of the step."""
        self._look(time, state)
        s = scheme
        for one in self._each:
            if one.entry.sample_time:
                continue
            one.respond()
            z, change, auxiliary, force = one.parts(state.beside)
            found = ((1 - s.alpha_f) * one.rates + s.alpha_f * change - s.alpha_m * auxiliary) / (1 - s.alpha_m)
            for into, new in ((auxiliary, found), (z, one.z), (change, one.rates), (force, one.force[:, :1])):
                into[samples] = new[samples]
        self._find_carried(time, state)
        state.beside[samples, : len(self._carried)] = self._carried.T[samples]
        self._put([*np.zeros((*self._carried.shape, 1)), *np.zeros_like(self._acting)])
        self.iterates = False
        self._keep(time, state, samples)

    def sample(self, time: float, state, samples: np.ndarray) -> bool:
        """Let the sampled controllers whose time it is find new forces for some samples; return whether any did."""
        due = [one for one in self._each if one.entry.sample_time and _is_whole(time / one.entry.sample_time)]
        if not due:
            return False
        self._look(time, state)
        for one in due:
            z, _, _, force = one.parts(state.beside)
            one.c[:], one.z[:], one.kappa = z, z, one.entry.sample_time
            one.respond()
            z[samples], force[samples] = one.z[samples], one.force[samples, :1]
        before = self._kept[time]
        after = self._forces(state)
        after[:, ~samples] = before[:, ~samples]
        self._kept[time], self._jumped[time] = 0.5 * (before + after), after
        return True

    def forces(self, times: np.ndarray) -> np.ndarray:
        """Return the forces at times (n_t,) that were reached, those carried first, (n_t, n_samples, n_names)."""
        found = np.zeros((times.size, self._n_samples, len(self.names)))
        for row, time in zip(found, times.tolist()):
            if time not in self._kept:  # of a step that failed: as it began
                time = max((one for one in self._kept if one < time), default=0.0)
            row[:] = self._jumped.get(time, self._kept[time]).T
        return found

    def _find_carried(self, time: float, state) -> None:
        if self._carried.size:
            self._carried[:] = self._find(time, state, self._carried)

    def _look(self, time: float, state) -> None:
        if not self._each:
            return
        measures, rates = self._measure(time, state)
        for one, measure, rate in zip(self._each, measures, rates):
            one.look(time, measure, rate)

    def _keep(self, time: float, state, samples: np.ndarray) -> None:
        forces = self._forces(state)
        kept = self._kept.setdefault(time, forces)
        kept[:, samples] = forces[:, samples]

    def _forces(self, state) -> np.ndarray:
        carried = state.beside[:, : len(self._carried)].T
        return np.array([*carried, *(one.parts(state.beside)[3][:, 0] for one in self._each)])


def _is_whole(number: float) -> bool:
    return abs(number - round(number)) <= WHOLE * max(1.0, number)
