"""Steps that end where a law has an edge, such as the contact with an end stop.

A step over an edge loses the order of the scheme: the force bends within it. The samples that cross one are taken back
to the beginning of their step and go up to the edge, found by root search in time with steps of its own, and on from
there; all others keep their step, so that the samples of a batch meet again at its end.

Samples of the reduced model search by themselves, lane by lane, compiled (`look`). It takes the outcome of a trial,
from the beginning of the step or from the edge before, and returns the length of the next one:

    WHOLE      the step itself. Where an edge is crossed in it, the rest of the step is searched
    EARLIEST   next to nothing: is the edge there already?
    NARROWING  an instant between two whose depths have different signs, by Brent's method
    REACHING   up to the first of the edges that were found
    REST       from there to the end of the step

`EventLocation` does the trials of all other systems, one sample after the other, and of samples of which a part of a
step fails.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import LANES
from pgmp_petsc.ranks.petsc import log_event
from pgmp_petsc.stepping.alpha_step import AlphaStep, put, standing
from pgmp_petsc.stepping.second_order_system import Moment, SecondOrderSystem, State

MAX_EVENTS = 20  # in one step of one sample; beyond, the step is taken as it is
TIME_TOLERANCE = 1e-9  # of the step: what is left is far below the scheme's own error
SHORTEST = 1e-6  # part of a step that is worth a step of its own
WHOLE, EARLIEST, NARROWING, REACHING, REST = range(5)  # what a trial is for
BEGUN, TRIED, REACHED, DONE, HOPELESS = range(5)  # what comes of it; see `look`
MAX_TRIALS = 1000  # in one step; Brent's method alone takes a dozen
RELATIVE = 4.0 * np.finfo(float).eps  # of a root, whatever its tolerance

# rows of a bracket (Brent 1973): the best instant, the one before and one on the other side of the root, with their
# depths; and the last two changes
NOW, BEFORE, ACROSS, DEPTH_NOW, DEPTH_BEFORE, DEPTH_ACROSS, CHANGE, CHANGE_BEFORE = range(8)


class EdgeSearch(NamedTuple):
    """How far the search in the lanes of a block is."""

    stage: np.ndarray  # what the trial is for, shape (LANES,)
    #: n_found, n_trials: edges found, and trials, in this step, (LANES,)
    n_found: np.ndarray
    n_trials: np.ndarray
    #: edge, nearest: the edge that is looked for, and the nearest one of those found, (LANES,)
    edge: np.ndarray
    nearest: np.ndarray
    duration: np.ndarray  # length of the trial, s, (LANES,)
    #: left, first: what is left of the step, and how much of it there is up to the nearest edge, s, (LANES,)
    left: np.ndarray
    first: np.ndarray
    depths: np.ndarray  # how far each edge is crossed at the end of the rest, (n_events, LANES)
    bracket: np.ndarray  # see above, (8, LANES)
    beyond: np.ndarray  # which edges were crossed at the beginning of the step, (n_events, LANES)

    @classmethod
    def of(cls, n_events: int) -> EdgeSearch:
        """Return arrays for the search in a block."""
        whole, lengths, bracket = np.empty((5, LANES), dtype=np.int64), np.empty((3, LANES)), np.empty((8, LANES))
        return cls(*whole, *lengths, np.empty((n_events, LANES)), bracket, np.empty((n_events, LANES), dtype=bool))


@njit(inline="always")
def begin_step(search, lane, step):
    """Let a lane begin with a whole step, s."""
    search.stage[lane], search.duration[lane] = WHOLE, step


@njit(error_model="numpy", counted=False)
def in_search(search):
    """Return the lanes whose trial is no whole step."""
    lanes = 0
    for lane in range(LANES):
        if search.stage[lane] != WHOLE:
            lanes |= 1 << lane
    return lanes


@njit(error_model="numpy", counted=False)
def look_at_all(search, lanes, step, depths, samples, beyond):
    """Look at the ends of the trials of some lanes; see `look`. The depths to which each edge is crossed, and which are
    `beyond`, are of all samples, (n_samples, n_events); each lane has the number of its sample, (LANES,). Return the
    sets of the lanes that begin, are reached, are done, and are hopeless."""
    begun = reached = done = hopeless = 0
    for lane in range(LANES):
        if lanes & (1 << lane):
            found = look(search, lane, step, depths[samples[lane]], beyond[samples[lane]])
            begun |= (found == BEGUN) << lane
            reached |= (found == REACHED) << lane
            done |= (found == DONE) << lane
            hopeless |= (found == HOPELESS) << lane
    return begun, reached, done, hopeless


@njit(error_model="numpy", counted=False)
def give_up(search, lanes, samples, beyond):
    """Let some lanes search no more, as if they were at the beginning of their steps; see `look_at_all`."""
    for lane in range(LANES):
        if lanes & (1 << lane):
            search.stage[lane] = WHOLE
            for event in range(search.beyond.shape[0]):
                beyond[samples[lane], event] = search.beyond[event, lane]


@njit(cache=True, error_model="numpy", counted=False)
def look(search, lane, step, depths, beyond):
    """Look at the end of a lane's trial in a step of a length (s), with the depth to which each edge is crossed there,
    (n_events,), and choose the next one; `beyond`, whether each was crossed when the search began or since,
    (n_events,), is brought up to date.

    Return ``BEGUN``, if the step crosses an edge: what is known at its beginning has to be kept; ``REACHED``, if the
    trial is to be gone on from; ``DONE``, if it ends the step; otherwise ``TRIED``, or ``HOPELESS``.
    """
    stage = search.stage[lane]
    search.n_trials[lane] += 1
    if stage == WHOLE or stage == REST:
        crossed = False
        for event in range(beyond.size):
            search.depths[event, lane] = depths[event]
            crossed |= (search.depths[event, lane] > 0.0) != beyond[event]
        if not crossed or (stage == REST and search.n_found[lane] >= MAX_EVENTS):
            begin_step(search, lane, step)
            return DONE
        if stage == WHOLE:
            search.n_found[lane], search.n_trials[lane], search.left[lane] = 0, 0, step
            for event in range(beyond.size):
                search.beyond[event, lane] = beyond[event]
        search.first[lane], search.nearest[lane] = np.inf, -1
        _next_edge(search, lane, step, -1, beyond)
        return BEGUN if stage == WHOLE else TRIED
    if search.n_trials[lane] > MAX_TRIALS:
        return HOPELESS
    tried, edge, bracket = search.duration[lane], search.edge[lane], search.bracket
    if stage == EARLIEST or stage == NARROWING:
        sign = -1.0 if beyond[edge] else 1.0
        depth = sign * depths[edge]
        is_there = stage == EARLIEST and not depth < 0.0
        if is_there:
            bracket[NOW, lane] = 0.0
        elif stage == NARROWING:
            bracket[DEPTH_NOW, lane] = depth
        else:
            bracket[BEFORE, lane], bracket[DEPTH_BEFORE, lane] = tried, depth
            bracket[NOW, lane], bracket[DEPTH_NOW, lane] = search.left[lane], sign * search.depths[edge, lane]
            search.stage[lane] = NARROWING
        if not (is_there or _narrow(bracket, lane, TIME_TOLERANCE * search.left[lane], stage == NARROWING)):
            search.duration[lane] = bracket[NOW, lane]
            return TRIED
        _note(search, lane, bracket[NOW, lane])
        _next_edge(search, lane, step, edge, beyond)
        if search.stage[lane] != REACHING or search.first[lane] != tried:
            return TRIED
    search.left[lane] -= search.first[lane]
    if search.left[lane] <= SHORTEST * step:
        begin_step(search, lane, step)
        return DONE
    search.stage[lane], search.duration[lane] = REST, search.left[lane]
    return REACHED


@njit(error_model="numpy", counted=False)
def _note(search, lane, root):
    """Note when the edge that was looked for is reached."""
    if root < search.first[lane]:
        search.first[lane], search.nearest[lane] = root, search.edge[lane]


@njit(error_model="numpy", counted=False)
def _next_edge(search, lane, step, edge, beyond):
    """Look for the next edge that lies in the rest of the step, or go to the nearest."""
    for event in range(edge + 1, beyond.size):
        if (search.depths[event, lane] > 0.0) != beyond[event]:
            search.edge[lane], search.stage[lane] = event, EARLIEST
            search.duration[lane] = SHORTEST * search.left[lane]
            return
    nearest = search.nearest[lane]
    beyond[nearest] = not beyond[nearest]
    search.n_found[lane] += 1
    if search.first[lane] > SHORTEST * step:
        search.stage[lane], search.duration[lane] = REACHING, search.first[lane]
    else:
        search.stage[lane], search.duration[lane] = REST, search.left[lane]


@njit(error_model="numpy", counted=False)
def _narrow(bracket, lane, tolerance, inside):
    """Do one step of Brent's method (1973, chapter 4) with a new depth; return whether the root is found.

    The root, or the next instant to be tried, is that in the row `NOW`. Once an instant `inside` the first two was
    tried, one is the root too that interpolation would move by less than the tolerance: the method itself would try
    another on the other side.
    """
    b = bracket[:, lane]
    if (b[DEPTH_BEFORE] < 0.0) != (b[DEPTH_NOW] < 0.0):
        b[ACROSS], b[DEPTH_ACROSS] = b[BEFORE], b[DEPTH_BEFORE]
        b[CHANGE] = b[CHANGE_BEFORE] = b[NOW] - b[BEFORE]
    if abs(b[DEPTH_ACROSS]) < abs(b[DEPTH_NOW]):
        b[BEFORE], b[NOW] = b[NOW], b[ACROSS]
        b[ACROSS] = b[BEFORE]
        b[DEPTH_BEFORE], b[DEPTH_NOW] = b[DEPTH_NOW], b[DEPTH_ACROSS]
        b[DEPTH_ACROSS] = b[DEPTH_BEFORE]
    least, half = 0.5 * (tolerance + RELATIVE * abs(b[NOW])), 0.5 * (b[ACROSS] - b[NOW])
    if b[DEPTH_NOW] == 0.0 or abs(half) < least:
        return True
    before, change = half, half
    if abs(b[CHANGE_BEFORE]) > least and abs(b[DEPTH_NOW]) < abs(b[DEPTH_BEFORE]):
        if b[BEFORE] == b[ACROSS]:  # a line through both
            trial = -b[DEPTH_NOW] * (b[NOW] - b[BEFORE]) / (b[DEPTH_NOW] - b[DEPTH_BEFORE])
        else:  # an inverse parabola through all three
            behind = (b[DEPTH_BEFORE] - b[DEPTH_NOW]) / (b[BEFORE] - b[NOW])
            across = (b[DEPTH_ACROSS] - b[DEPTH_NOW]) / (b[ACROSS] - b[NOW])
            weighted = b[DEPTH_ACROSS] * across - b[DEPTH_BEFORE] * behind
            trial = -b[DEPTH_NOW] * weighted / (across * behind * (b[DEPTH_ACROSS] - b[DEPTH_BEFORE]))
        if 2.0 * abs(trial) < min(abs(b[CHANGE_BEFORE]), 3.0 * abs(half) - least):
            before, change = b[CHANGE], trial
            if inside and abs(trial) <= least:
                return True
    b[CHANGE_BEFORE], b[CHANGE] = before, change
    b[BEFORE], b[DEPTH_BEFORE] = b[NOW], b[DEPTH_NOW]
    if abs(change) > least:
        b[NOW] += change
    else:
        b[NOW] += least if half > 0.0 else -least
    return False


Place = tuple[State, np.ndarray]  # a state, and the auxiliary accelerations there


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a step, as one sample takes it."""

    #: end, duration: s
    end: float
    duration: float
    #: the edge that it goes up to, -1 where there is none; the last part may have both, an edge and the step's end
    edge: int
    #: state, auxiliary: state and auxiliary accelerations at its end
    state: State
    auxiliary: np.ndarray


class EventLocation:
    """Location of the edges that the samples of a system cross, from a state at time 0 on: `beyond` says whether each
    is crossed, (n_events, n_samples), `depths` how far at the end of a step that is to be repeated, NaN where that is
    not known, and `shortest` is the time between two crossings of one, (n_samples,), s; infinite where none was
    crossed twice."""

    def __init__(self, system: SecondOrderSystem, stepper: AlphaStep, start: State) -> None:
        self._system, self._stepper = system, stepper
        self.beyond = np.zeros((system.n_events, system.n_samples), dtype=bool)
        if system.n_events:
            everyone = np.ones(system.n_samples, dtype=bool)
            self.beyond = system.depths(np.zeros(1), start.alone, everyone)[0] > 0.0
        self.depths = np.full(self.beyond.shape, np.nan)
        self.shortest = np.full(system.n_samples, np.inf)
        self._last = np.full(self.beyond.shape, -np.inf)

    def by(self, stepper: AlphaStep) -> EventLocation:
        """Return the location with other steps of the same samples: what either of them crosses, both have crossed."""
        other = copy(self)
        other._stepper = stepper
        return other

    def crossing(self, end: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return which of some samples, a mask, are beyond other edges at the end of a step than at its beginning."""
        if not len(self.beyond):
            return np.zeros_like(samples)
        depths = self._system.depths(np.array([end]), state.alone, samples)[0]
        found = samples & np.any((depths > 0.0) != self.beyond, axis=0)
        self.depths[:, found] = depths[:, found]
        return found

    def repeat_steps(self, before: Moment, after: Moment, end: float, step: float, samples: np.ndarray) -> np.ndarray:
        """Repeat steps that cross edges, to their `end` and of a length, s, into `after`; return the samples whose
        iteration failed. Samples are a mask, shape (n_samples,)."""
        lost = np.zeros_like(samples)
        for sample in np.flatnonzero(samples):
            alone = np.arange(samples.size) == sample
            with log_event("contacts"):
                parts = self.parts((before.state, before.auxiliary), end, step, alone)
            for part in parts or ():
                if part.edge >= 0:
                    self.shortest[sample] = min(self.shortest[sample], part.end - self._last[part.edge, sample])
                    self._last[part.edge, sample] = part.end
            if parts is None:
                lost[sample] = True
            else:
                reached = standing(parts[-1].state, parts[-1].auxiliary, samples.size)
                put(self._system, after, reached._replace(before=before.state.a), alone)
        return lost

    def parts(self, moment: Place, end: float, step: float, alone: np.ndarray) -> list[Part] | None:
        """Take one sample, a mask of shape (n_samples,), to the end of a step, edge by edge; None where its iteration
        fails.

        No part goes up to an edge that lies at the beginning of the step, or where another one is.
        """
        search, taken, (sample,) = EdgeSearch.of(len(self.beyond)), [], np.flatnonzero(alone)
        beyond = self.beyond[:, sample].copy()
        search.stage[0], search.duration[0] = WHOLE, step
        known, self.depths[:, sample] = self.depths[:, sample].copy(), np.nan
        left, found = step, TRIED if np.isnan(known).any() else look(search, 0, step, known, beyond)
        while found != DONE:
            duration = float(search.duration[0])
            within = search.stage[0] not in (WHOLE, REST)
            until = end if duration == left else end - left + duration
            after, lost = self._stepper.take_one(standing(*moment, alone.size), until, duration, alone)
            there = after.state, after.auxiliary
            if not lost.any():
                depths = self._system.depths(np.array([until]), there[0].alone, alone)[0, :, sample].copy()
            elif search.stage[0] == EARLIEST:
                depths = np.full(len(beyond), np.nan)  # as if the edge were there
            else:
                return None
            found = look(search, 0, step, depths, beyond)
            if found == HOPELESS:
                return None
            if found in (REACHED, DONE):
                left -= duration
                moment = there
                taken.append(Part(until, duration, int(search.nearest[0]) if within else -1, *there))
        self.beyond[:, sample] = beyond
        return taken
