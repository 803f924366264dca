"""Steps that end where a law has an edge, such as the contact with an end stop.

A step over an edge loses the order of the scheme: the force bends within it. The samples that cross one are taken back
to the beginning of their step and go up to the edge, found by root search in time with steps of its own, and on from
there; all others keep their step, so that the samples of a batch meet again at its end.

Samples of the reduced model search by themselves (`edge_search`); here is the search of all other systems, and of those
among them of which a part of a step fails.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.dynamics.alpha_step import AlphaStep
from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem, State
from pgmp_petsc.runtime.petsc import log_event

MAX_EVENTS = 20  # in one step of one sample; beyond, the step is taken as it is
TIME_TOLERANCE = 1e-9  # of the step: what is left is far below the scheme's own error
SHORTEST = 1e-6  # part of a step that is worth a step of its own

Moment = tuple[State, np.ndarray]


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a step, as one sample takes it.

    Attributes
    ----------
    end, duration
        s.
    edge
        The edge that it goes up to, -1 where there is none; the last part may have both, an edge and the step's end.
    state, auxiliary
        State and auxiliary accelerations at its end.
    """

    end: float
    duration: float
    edge: int
    state: State
    auxiliary: np.ndarray


class EventLocation:
    """Location of the edges that the samples of a system cross.

    Parameters
    ----------
    system
        A system with events.
    stepper
        Its steps.
    start
        State at time 0.

    Attributes
    ----------
    beyond
        Whether each edge is crossed, shape (n_events, n_samples).
    shortest
        Between two crossings of an edge, shape (n_samples,), s; infinite where none was crossed twice.
    """

    def __init__(self, system: SecondOrderSystem, stepper: AlphaStep, start: State) -> None:
        self._system, self._stepper = system, stepper
        self.beyond = system.depths(0.0, start) > 0.0
        self.shortest = np.full(system.n_samples, np.inf)
        self._last = np.full(self.beyond.shape, -np.inf)
        self.n_located = 0

    def by(self, stepper: AlphaStep) -> EventLocation:
        """Return the location with other steps of the same samples: what either of them crosses, both have crossed."""
        other = copy(self)
        other._stepper = stepper
        return other

    def repeat_steps(self, before: Moment, after: Moment, end: float, step: float, samples: np.ndarray) -> np.ndarray:
        """Repeat the steps that cross edges, in place of `after`; return the samples whose iteration failed.

        Parameters
        ----------
        before, after
            State and auxiliary accelerations at the beginning and at the end of the step.
        end, step
            End and length of the step, s.
        samples
            Mask of the samples that took the step, shape (n_samples,).
        """
        lost = np.zeros_like(samples)
        crossed = samples & np.any((self._system.depths(end, after[0]) > 0.0) != self.beyond, axis=0)
        with log_event("contacts"):
            for sample in np.flatnonzero(crossed):
                lost |= self._repeat(before, after, end, step, np.arange(samples.size) == sample)
        self._stepper.moved(crossed, lost)
        return lost

    def _repeat(self, before: Moment, after: Moment, end: float, step: float, alone: np.ndarray) -> np.ndarray:
        """Repeat the step of one sample; return it as a mask if its iteration failed."""
        parts = self.parts(before, end, step, alone)
        if parts is None:
            return alone
        for part in parts:
            if part.edge >= 0:
                last = self._last[part.edge, alone]
                self.shortest[alone] = np.minimum(self.shortest[alone], part.end - last)
                self._last[part.edge, alone] = part.end
        put(self._system, after, (parts[-1].state, parts[-1].auxiliary), alone)
        return np.zeros_like(alone)

    def parts(self, moment: Moment, end: float, step: float, alone: np.ndarray) -> list[Part] | None:
        """Take one sample to the end of a step, edge by edge; None where its iteration fails.

        No part goes up to an edge that lies at the beginning of the step, or where another one is.

        Parameters
        ----------
        moment
            State and auxiliary accelerations at the beginning of the step.
        end, step
            End and length of the step, s.
        alone
            The sample as a mask, shape (n_samples,).
        """
        left, taken = step, []
        for _ in range(MAX_EVENTS):
            there = self._advance(moment, end, left, alone)
            if there is None:
                return None
            crossed = np.flatnonzero(self._crossed(end, there, alone))
            if not crossed.size:
                return [*taken, Part(end, left, -1, *there)]
            first, edge = min((self._root(moment, end, left, alone, edge), edge) for edge in crossed)
            self.beyond[edge, alone] = ~self.beyond[edge, alone]
            self.n_located += 1
            if first > SHORTEST * step:
                moment = self._advance(moment, end - left + first, first, alone)
                if moment is None:
                    return None
                left -= first
                taken.append(Part(end - left, first, int(edge), *moment))
                if left <= SHORTEST * step:
                    return taken
        last = self._advance(moment, end, left, alone)
        return None if last is None else [*taken, Part(end, left, -1, *last)]

    def _root(self, moment: Moment, end: float, left: float, alone: np.ndarray, edge: int) -> float:
        """Return how long it takes to the edge, s."""
        from scipy.optimize import brentq  # takes a noticeable time, and few runs have events

        start = end - left
        sign = -1.0 if self.beyond[edge, alone][0] else 1.0

        def depth(duration: float) -> float:
            there = self._advance(moment, start + duration, duration, alone)
            if there is None:
                return np.nan
            return sign * float(self._system.depths(start + duration, there[0])[edge, alone][0])

        earliest = SHORTEST * left
        if not depth(earliest) < 0.0:
            return 0.0
        return float(brentq(depth, earliest, left, xtol=TIME_TOLERANCE * left))

    def _advance(self, moment: Moment, end: float, duration: float, alone: np.ndarray) -> Moment | None:
        state, auxiliary, lost = self._stepper.advance(*moment, end, duration, alone, for_good=False)
        return None if lost.any() else (state, auxiliary)

    def _crossed(self, time: float, moment: Moment, alone: np.ndarray) -> np.ndarray:
        """Return which edges lie between the sample and where it was, shape (n_events,)."""
        return (self._system.depths(time, moment[0])[:, alone] > 0.0)[:, 0] != self.beyond[:, alone][:, 0]


def put(system: SecondOrderSystem, target: Moment, source: Moment, samples: np.ndarray) -> None:
    """Copy state and auxiliary accelerations of some samples; a system alone knows where its samples are in arrays."""
    (to, to_auxiliary), (state, auxiliary) = target, source
    system.restore(to, state, samples)
    behind, ahead = to.copy(), state.copy()
    behind.a, ahead.a = to_auxiliary, auxiliary
    system.restore(behind, ahead, samples)
