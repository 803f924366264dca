"""Sensitivities through the steps of a run that are taken in parts, where end stops are met and left.

The engine ends a part of a step where an edge is crossed, depth(q, p) = 0, and goes on from there with the scheme as it
stands: positions, velocities, accelerations and auxiliary accelerations are what they were, as the force of a stop
begins and ends at zero (`effects.law`). The discrete map is differentiated, with the length h of a part as one more
variable (Galan, Feehery and Barton 1999 have the same of continuous time). With the prediction of `propagate` and all
other symbols from there,

    d q_hat/dh = q'_n + 2 h ((1/2 - beta) A_n + beta A_{n+1}),     d q'_hat/dh = (1 - gamma) A_n + gamma A_{n+1},

and r has a derivative with time itself where loads change, so that one more right-hand side gives ``S_h``. The end t*
of a part that goes up to an edge, and the length of the last part, whose end is fixed, follow from

    depth_q (S + S_h h_p) + depth_p = 0,     dt*/dp = dt*_before/dp + h_p,     h_p of the last part = - dt*_before/dp.

It makes no difference on which side of the edge the residual is linearised: the term of the stop's stiffness is
multiplied by the first of these equations. Where the path turns at the edge (grazing), the instant has no derivative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.gradients.linearisation import Linearisation
from pgmp_petsc.models import Observing
from pgmp_petsc.stepping.alpha_step import AlphaStep
from pgmp_petsc.stepping.edge_search import EventLocation, Part
from pgmp_petsc.stepping.edge_search import Place as Moment
from pgmp_petsc.stepping.second_order_system import Scheme, SecondOrderSystem, State

GRAZING = 1e-3  # of a step: within so little time no run tells a path that meets the edge from one that does not
RETRACED = 1e-8  # in rad or of the mechanism's size: the iterations of run and search leave 1e-11 a step
IN_PARTS = 1e-10  # in the same, that a step's equations are off by, far above round-off: those of its parts hold
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Contact:
    """An instant at which a stop is met or left."""

    effect: str  # name of the stop
    met: bool  # whether it is met there, or left
    time: float  # s
    #: within which time the path would turn back, from its rate and acceleration there, s: the less, the nearer it is
    #: to grazing
    turning: float
    derivatives: np.ndarray  # of the time with the parameters, shape (n_parameters,), s per unit
    entry: str  # of the scene, that the stop is of


class Contacts:
    """The steps of a run of one sample that cross edges of laws, with what was met and left so far.

    The system is that of the run, with which its steps are retraced, and the linearisation that of the sample; times,
    shape (n_t,), and states, arrays of shape (n_t, n_eta), are those of the whole run, the first ones with the
    accelerations that its steps began with, beside `auxiliary` ones (n_eta,).
    """

    def __init__(
        self, model: Observing, system: SecondOrderSystem, linearisation: Linearisation, times: np.ndarray,
        states: State, auxiliary: np.ndarray,
    ) -> None:  # fmt: skip
        self._model, self._linearisation, self._times, self._states = model, linearisation, times, states
        self._radius, self._step = model.scene.simulation.spectral_radius, times[-1] / (len(times) - 1)
        self._free = ~linearisation.prescribed
        self._beyond = linearisation.local.depths(times, states) > 0.0
        self._in_parts = self._taken_in_parts()
        self._location: EventLocation | None = None
        self._known = 0, auxiliary  # an instant, and the auxiliary accelerations there
        self.found: list[Contact] = []
        if self._in_parts.any() or (self._beyond[1:] != self._beyond[:-1]).any():
            self._location = EventLocation(system, AlphaStep(system, self._radius), states.at(slice(1)).copy())

    def following(self, first: int) -> int:
        """Return the number of the first instant, from one on, whose step crosses an edge; n_t where there is none."""
        if self._location is None:
            return len(self._times)
        met = (self._beyond[first:] != self._location.beyond[:, 0]).any(axis=1)
        crossing = np.flatnonzero(met | self._in_parts[first:])
        return first + int(crossing[0]) if crossing.size else len(self._times)

    def _taken_in_parts(self) -> np.ndarray:
        """Return which instants end a step that was taken in parts, (n_t,): an edge that is met and left within one is
        not seen at its ends. Of a step as a whole a sum of the scheme's three equations holds in which there are no
        auxiliary accelerations."""
        scheme, h, free = Scheme.of(self._radius, 1.0), self._step, self._free
        of_auxiliary = [
            [0.5 - scheme.beta, 1.0 - scheme.gamma, scheme.alpha_m],
            [scheme.beta, scheme.gamma, 1.0 - scheme.alpha_m],
        ]
        by_q, by_v, by_a = np.linalg.svd(of_auxiliary)[2][-1]
        q, v, a = (part[:, free] for part in (self._states.q, self._states.v, self._states.a))
        off = by_q * (np.diff(q, axis=0) - h * v[:-1]) + by_v * h * np.diff(v, axis=0)
        off += by_a * h * h * ((1.0 - scheme.alpha_f) * a[1:] + scheme.alpha_f * a[:-1])
        return np.append(False, (np.abs(off) * self._model.terms.scale[free] > IN_PARTS).any(axis=1))

    def through(self, number: int, moment: np.ndarray) -> np.ndarray:
        """Take the sensitivities through the step up to the instant of that number, as `following` gives it; return
        them there.

        They are S_q, S_v, S_a and S_A at the step's beginning, shape (4, n_parameters, n_eta). Raises `InputError` if
        an edge is grazed; `RunError` if the step does not lead where the run went.
        """
        moved = np.zeros(moment.shape[1])  # the beginning of the part, s per unit of a parameter
        before, parts = self._retraced(number)
        for part in parts:
            along, with_length = self._through_part(part, before, moment, moved)
            longer = -moved
            if part.edge >= 0:
                up_to_edge = self._up_to_edge(part, along[0], with_length[0])
                self.found[-1].derivatives[:] = moved + up_to_edge
                longer = longer if part is parts[-1] else up_to_edge
            moved = moved + longer
            moment = along + longer[:, None] * with_length[:, None]
            before = part.state, part.auxiliary
        return moment

    def _retraced(self, number: int) -> tuple[Moment, list[Part]]:
        """Return the beginning of the step up to an instant, and its parts."""
        known, auxiliary = self._known
        # the scheme's recursion A_{n+1} = - c A_n + w_n as the sum that it is; c is between -1/2 and 1
        scheme, a = Scheme.of(self._radius, 1.0), self._states.a[known:number]
        weighted = (1.0 - scheme.alpha_f) * a[1:] + scheme.alpha_f * a[:-1]
        n, c = len(weighted), scheme.alpha_m / (1.0 - scheme.alpha_m)
        added = (-c) ** np.arange(n - 1, -1, -1.0) @ weighted / (1.0 - scheme.alpha_m)
        auxiliary = (-c) ** n * auxiliary + added
        before = self._states.at(slice(number - 1, number)).copy(), auxiliary[None]
        end = float(self._times[number])
        parts = self._location.parts(before, end, self._step, np.ones(1, dtype=bool))
        off = np.inf
        if parts is not None:
            off = np.abs((parts[-1].state.q[0] - self._states.q[number]) * self._model.terms.scale).max()
        if not off <= RETRACED:
            raise RunError(
                f"the step with a contact that ends at {end:.6g} s could not be retraced: it ends {off:.2g} of the "
                "mechanism's size (or rad) from where the run went; try a smaller simulation.step"
            )
        self._known = number, parts[-1].auxiliary[0]
        return before, parts

    def _up_to_edge(self, part: Part, along: np.ndarray, with_length: np.ndarray) -> np.ndarray:
        """Return the derivatives of the length of a part with the parameters, and note the contact."""
        edge = self._linearisation.local.edge(part.edge, part.end, part.state)
        rate = float(edge.gradient @ with_length)
        entry = next(effect.entry for effect in self._model.effects if effect.name == edge.effect)
        turning = min(abs(rate), abs(edge.rate)) / max(abs(edge.acceleration), TINY)
        if not turning > GRAZING * self._step:
            cure = "end the run before (simulation.duration), move the stop, or change a parameter (--set)"
            if part.end < self._times[1]:
                cure = "start away from the stop, or as deep in it as what rests on it is (simulation.initial)"
            raise InputError(
                f"{entry}: at {part.end:.6g} s the run grazes this stop: its path turns back within "
                f"{turning:.2g} s, less than {GRAZING:g} of a step, so that the least change of a parameter decides "
                f"whether they meet, and the instant has no derivative; {cure}"
            )
        self.found.append(Contact(edge.effect, edge.rate > 0.0, part.end, turning, np.zeros(len(along)), entry))
        return -(along @ edge.gradient + edge.by_parameters) / rate

    def _through_part(
        self, part: Part, before: Moment, moment: np.ndarray, moved: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the sensitivities at the end of a part of fixed length, (4, n_parameters, n_eta), and those with its
        length, (4, n_eta)."""
        h, scheme = part.duration, Scheme.of(self._radius, part.duration)
        weight, (start, behind) = 1.0 / (1.0 - scheme.alpha_m), before
        there = self._linearisation.at(np.array([part.end]), part.state, by_time=True)
        late = np.append(moved, 1.0)[:, None]  # how the end moves
        of_q, of_v, now, auxiliary = np.concatenate([moment, np.zeros((4, 1, moment.shape[2]))], axis=1)
        ahead = (now - scheme.alpha_m * auxiliary) * weight
        q = of_q + h * of_v + h * h * ((0.5 - scheme.beta) * auxiliary + scheme.beta * ahead)
        v, a = of_v + h * ((1.0 - scheme.gamma) * auxiliary + scheme.gamma * ahead), now.copy()
        mean = (0.5 - scheme.beta) * behind[0] + scheme.beta * part.auxiliary[0]
        q[-1] += start.v[0] + 2.0 * h * mean
        v[-1] += (1.0 - scheme.gamma) * behind[0] + scheme.gamma * part.auxiliary[0]
        for k, motion in self._model.motions.items():
            (jerk,) = motion.angle.jet(np.array([part.end]), 3)[3]
            rates = part.state.v[0, k], part.state.a[0, k], jerk
            q[:, k], v[:, k], a[:, k] = late[:, 0] * np.array(rates)[:, None]
        by_parameters, by_time = there.by_parameters[0, :-1], there.by_parameters[0, -1]
        right = -late * by_time - q @ there.by_q[0].T - v @ there.by_v[0].T - a @ there.by_a[0].T
        right[:-1] -= by_parameters
        matrix = there.by_q[0] + scheme.gain_v * there.by_v[0] + scheme.gain_a * there.by_a[0]
        free = self._free
        x = np.zeros_like(q)
        x[:, free] = np.linalg.solve(matrix[np.ix_(free, free)], right[:, free].T).T
        then = a + scheme.gain_a * x
        end = ((1.0 - scheme.alpha_f) * then + scheme.alpha_f * now - scheme.alpha_m * auxiliary) * weight
        found = np.array([q + x, v + scheme.gain_v * x, then, end])
        return found[:, :-1], found[:, -1]
