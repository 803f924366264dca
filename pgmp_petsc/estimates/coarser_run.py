"""Error of the time step in a full-order or component run, from a second run of the system with a coarser step.

A run with the step h and one with r h, whose outputs are y and z, differ by ``d = z - y`` (docs/method.md, the time
step of full-order and component runs: how d is read, and how well).

**Resolved.** The error of the run is ``d / (r^2 - 1)`` (Richardson; Hairer, Norsett and Wanner 1993, section II.4).

**Vibrations that the coarser run loses**, in bands of a short-time Fourier transform in which d is `LOST` of what both
runs have and more. With the eigenvalue lambda of a step for ``omega h`` a vibration of amplitude a goes off by ``a |i
omega h - log lambda|`` in each step (Hughes 2000, section 9.1). What it is off by fades with the machine's own damping,
by which a falls faster than ``|lambda|``, and is no more than ``2 a d / (a + b)``, where the coarser run has b: with
``b = a`` that is d, and 2 a where the coarser run has no vibration left. A band goes on to count until the coarser run
would have left the other by `MET` since d was large, as phases that have parted meet again. Corners are in all bands.
Where a controller's reference has some, forces have them between the coarser run's instants, in both runs: up to half
of the frequency of these d is interpolated, and a band above counts where it is `TONE` times those around it. The
largest of many points, and the size of a force, have kinks of their own: every band counts by that, with `PEAK`.

**Lower order**, where friction or short contacts act: what is left of d counts a seventh for r = 5 (`rough`), and the
estimate is unsure. Where a force jumps (over time, in a formula, of friction as a held one does) the order is one.

**A coarser run that runs away**, as of rotors, tells nothing of the run: the estimate ends before it does.

**Forces that are stepped over.** Of one that a formula or a table over a joint has bend within a coarser step d says
little: it is read as resolved, and unsure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from pgmp_petsc.effects.formula import FormulaEffect
from pgmp_petsc.estimates.reference_motion import steps_between_samplings
from pgmp_petsc.models import FullModel, Model, OutputRecord
from pgmp_petsc.outputs.multipliers import joints_of, judged
from pgmp_petsc.outputs.of_frames import Angle, Distance, Sliding
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.results.numbers import ROUND_OFF, VANISHING, Arrays, felt, share_text
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.uses import slides_over
from pgmp_petsc.stepping.generalised_alpha import GeneralisedAlpha, Run
from pgmp_petsc.stepping.second_order_system import Scheme, SecondOrderSystem
from pgmp_petsc.stepping.status import Status

TIMES = 5  # steps of the run in one of the coarser run, at most
MOST = 2.5  # steps of it for the work of one of the run, counted in corrections, so that it is the same on all machines
FACTORS = 3.0  # corrections that cost as much as a matrix and its factors
CALLING = {2: 2000.0, 3: 120.0}  # unknowns of which a correction costs as much as a call, by the dimension of space
RECORDED = 0.15  # calls that cost as much as what a step of a run records
ENOUGH = 200  # steps of the coarser run, from which on it may have fewer than half of the run's
FEWEST = 10  # steps that the coarser run has done at least where its outputs tell anything
APART = 10  # steps between two looks at the work of the coarser run, at least
PER_WINDOW, SHORTEST, LONGEST = 10, 16, 512  # windows of a run, and steps in one
LOWEST = 2  # band that counts: lower ones hold what is not periodic
LOST = 0.25  # of the sum of a vibration's amplitudes, by which runs differ that are out of phase
MET = np.pi  # rad; phases that meet after a turn leave d below `LOST` for 4 asin(LOST) = 1.0 rad
BEATS = 3  # windows within which a vibration comes back that beats, and has not faded
PEAK, AROUND = 1.15, 17  # of a vibration over the median of so many bands around it
TONE = 2.0  # of one that the coarser run has too few instants for: two corners in a window ripple by 1.4 times
TREMBLES = 0.1  # of an output's largest value, from which on lost vibrations are worth naming
RUBS = 0.015  # of it, from which on they move what has friction or stops, and their cycles count
BRIEF = 10.0  # steps of the coarser run in a contact whose force it follows
SOME = 0.1  # of the steps, taken in parts, from which on an estimate is unsure
RELIED_ON = 0.9  # of a run that fails, before which it runs away, or that differs by as much as `ASTRAY` says
WITHIN = 10  # places within a coarser step at which tables over joints and formulas are looked up
#: of a force's largest value, by which it bends within a coarser step. With 1.3 % estimates of 40 presses were 0.55 to
#: 1.1 times the true errors, with 3 % 0.2 to 1.8 times, with 6 to 14 % 0.1 to 8 times
BENT = 0.02
ASTRAY = 2.0  # of an output's largest value: runs whose vibrations are out of phase differ by so much at most
LASTS = 3  # coarser steps for which they differ by more where one runs away
GREW = 10.0  # times that the difference grew before
#: what its second root of `GREW` may take of the time of the first: 1 where it grows exponentially, 1.8 as a square
SLOWER = 1.5
FADED = 0.1  # of the largest error that a lost vibration makes, from which on it counts
TINY = np.finfo(float).tiny
CROWDED = 0.5  # of `APART` of them, from which on it ends: changes of step set off what is seen then


@dataclass(frozen=True)
class CoarserRun:
    """Outputs of a run with a coarser step."""

    step: float  # s
    time: np.ndarray  # instants, shape (n_t,), s
    #: by name, each of shape (n_t, n_samples); NaN from the step on in which a sample failed
    outputs: dict[str, np.ndarray]
    status: np.ndarray  # status, failure_time: of every sample; FINE and NaN where only the work was too much
    failure_time: np.ndarray
    divided: np.ndarray  # share of the steps that were taken in parts, shape (n_samples,)
    until: np.ndarray  # time from which on most were, shape (n_samples,), s; infinite where there is none
    #: time between two crossings of an edge, the shortest, shape (n_samples,), s; infinite where there is none
    shortest: np.ndarray
    #: see `_bent`, by the entries of effects whose force is written as a formula or as a table over a joint
    bent: dict[str, np.ndarray]


@dataclass(frozen=True)
class StepErrors:
    """Errors of one run's time step."""

    time: np.ndarray  # instants, shape (n_e,), s
    outputs: dict[str, np.ndarray]  # error of each output, shape (n_e,): the run's less what it should be
    lost_hz: float  # frequency of the vibration whose phase the run loses most, NaN where there is none worth naming
    lost_within: tuple[float, float]  # from when to when, s
    unsure: str  # why the order of the error is not known; empty where it is


def run_coarser(
    model: Model,
    system: SecondOrderSystem,
    simulation: Simulation,
    alive: np.ndarray,
    of: Run | None = None,
    pulse: Callable[[int], object] = lambda n_steps: None,
) -> CoarserRun:
    """Run the samples `alive`, shape (n_samples,), of a system again, with a coarser step than the run's. Collective on
    ``system.comm``.

    The run `of` says what it took; there is no limit where it is not given. `pulse` is called with numbers of steps.
    """
    coarse, times = coarser(model.scene, simulation), times_of(model.scene, simulation)
    n_steps, record = coarse.n_steps, OutputRecord(_measuring(model), system, pulse)
    stepper = GeneralisedAlpha(
        system, coarse.spectral_radius, coarse.duration, n_steps, alive, np.array([0]), record, pulse=None, parts=times
    )
    mechanism = model.kinematics.mechanism
    calling = CALLING[mechanism.space.dimension] / mechanism.n_dofs

    def work(done: Run | GeneralisedAlpha, n_steps: int) -> float:
        n_iterations, n_fresh, n_calls = done.counted
        return n_iterations + FACTORS * n_fresh + calling * (n_calls + RECORDED * n_steps)

    most, spent = np.inf if of is None else MOST / times * work(of, of.n_steps), work(stepper, 0)
    dearest = 0.0  # work of a step, the most so far
    while stepper.n_done < n_steps and np.any(stepper.status == Status.FINE) and spent <= most:
        # steps that half of the rest allows at the cost of the costliest so far; the first are looked at soon
        affords = 0.5 * (most - spent) / dearest if dearest else 0.0 if np.isfinite(most) else np.inf
        before, begun = spent, stepper.n_done
        stepper.stops = np.array([0, int(min(begun + max(affords, APART), n_steps))])
        stepper.advance()
        spent = work(stepper, stepper.n_done)
        dearest = max(dearest, (spent - before) / (stepper.n_done - begun))
    time, found = record.outputs()
    motions = {entry: found.pop(entry) for entry in [*found] if entry.startswith("effects.")}
    told = motions if time.size > FEWEST else ()
    bent = {entry: _bent(model, entry, system.values, time, motions[entry]) for entry in told}
    until, divided = _taken_in_parts(stepper)
    failed = time[:, None] >= np.where(stepper.status == Status.FINE, np.inf, stepper.failure_time)
    failed |= (time[:, None] > until) | (stepper.status == Status.UNSTABLE)  # nobody knows since when
    outputs = {name: np.where(failed, np.nan, values) for name, values in found.items()}
    return CoarserRun(
        coarse.duration / n_steps, time, outputs, stepper.status, stepper.failure_time, divided, until,
        stepper.shortest_crossing, bent,
    )  # fmt: skip


def _measuring(model: Model) -> Model:
    """Return the model with outputs, by the entries of effects, of the motions that forces are of which the scene
    writes as formulas or as tables over joints."""
    scene, other, added = model.scene, copy(model), {}
    for name, one in scene.effects.items():
        if getattr(one, "over", None) or isinstance(one, FormulaEffect):
            kind, joint = Sliding if slides_over(scene, one) else Angle, one.over or one.joint
            where = {"type": "distance", "points": one.points} if joint is None else {"joint": joint}
            added[f"effects.{name}"] = Distance(**where) if joint is None else kind(type=kind.__name__.lower(), **where)
    if not added or not isinstance(model, FullModel):
        return model
    other.outputs = OutputSet.of(scene.model_copy(update={"outputs": scene.outputs | added}), model.kinematics)
    return other


def _bent(model: Model, entry: str, values: Arrays, time: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return by how much of its largest value the force of an effect bends within every step but the last, shape (n_t
    - 2, n_samples), of a motion that is `at` (n_t, n_samples) at some times (n_t,), s."""
    action = model.scene.effects[entry.removeprefix("effects.")].forces(entry, model.kinematics.mechanism).actions()[-1]
    shares, at = np.arange(WITHIN)[:, None] / WITHIN, np.nan_to_num(at)

    def within(nodes: np.ndarray) -> np.ndarray:
        return nodes[:-1, None] + shares * np.diff(nodes, axis=0)[:, None]

    s, rates, clock = map(within, (at, np.gradient(at, time, axis=0), np.broadcast_to(time[:, None], at.shape)))
    p = np.array([np.broadcast_to(one.at(values), s.shape) for one in action.parameters]).reshape(-1, s.size).T
    amplitudes = 0.0 if action.amplitude is None else action.amplitude(clock.ravel())
    forces = action.law.forces(p, s.ravel(), rates.ravel(), amplitudes).reshape(s.shape)
    largest = np.maximum(np.abs(forces).max(axis=(0, 1)), TINY)
    return np.abs(forces[:-1] - within(forces[:, 0])).max(axis=1) / largest


def _taken_in_parts(stepper: GeneralisedAlpha) -> tuple[np.ndarray, np.ndarray]:
    """Return from what time on most steps of a run were taken in parts, s, infinite where there is none, and the share
    of those before, each (n_samples,)."""
    parted = np.zeros((stepper.n_done + 1, stepper.status.size))
    for number, samples in stepper.divided:
        parted[number + 1] += samples
    before = parted.cumsum(axis=0)
    crowded = before[APART:] - before[:-APART] > CROWDED * APART
    first = np.where(crowded.any(axis=0), crowded.argmax(axis=0) if len(crowded) else 0, stepper.n_done)
    share = np.take_along_axis(before, first[None], axis=0)[0] / np.maximum(first, 1)
    return np.where(first < stepper.n_done, stepper.instants[first], np.inf), share


def times_of(scene: Scene, simulation: Simulation) -> int:
    """Return how many steps of a run make one of the coarser run; 1 where controllers are sampled too often for one."""
    possible = list(range(2, TIMES + 1))
    if any(one.sample_time for one in scene.controllers.values()):
        every = steps_between_samplings(scene, simulation)
        possible = [times for times in possible if every % times == 0]
    affordable = (times for times in possible if times * ENOUGH <= simulation.n_steps)
    return max(affordable, default=min(possible, default=1))


def rough(ratio: float) -> float:
    """Return the mean, on a logarithmic scale, of what d counts by with order two and half of that with order one."""
    return float(np.sqrt(0.5 * (ratio**2 - 1.0) * (ratio - 1.0)))


def fewest_steps(times: int) -> int:
    """Return how many steps a run has at least whose coarser one tells anything."""
    return (FEWEST - 1) * times + 1


def coarser(scene: Scene, simulation: Simulation) -> Simulation:
    return simulation.in_steps(-(-simulation.n_steps // times_of(scene, simulation)))


def relied_on(scene: Scene, time: np.ndarray, outputs: Arrays, other: CoarserRun, sample: int = 0) -> tuple[int, str]:
    """Return how many instants of the coarser run tell of the errors of a run: most of those before it fails or runs
    away from it; and the output in which it runs away, empty where it does not."""
    known = np.all([np.isfinite(values[:, sample]) for values in other.outputs.values()], axis=0)
    reach = known.size if known.all() else int(np.argmin(known))
    found = (reach if known.all() else int(RELIED_ON * reach)), ""
    for name, values in outputs.items():
        apart = np.abs(other.outputs[name][:reach, sample] - np.interp(other.time[:reach], time, values))
        far = apart > ASTRAY * np.abs(values).max()
        far = np.all([far[k : far.size - LASTS + 1 + k] for k in range(LASTS)], axis=0)
        if name in scene.counted or not far.any():
            continue
        first = int(np.argmax(far))
        levels = apart[first] / np.array([GREW, np.sqrt(GREW)])
        begins, half = np.searchsorted(np.maximum.accumulate(apart[: first + 1]), levels).tolist()
        if first - half < SLOWER * (half - begins) and int(RELIED_ON * begins) < found[0]:
            found = int(RELIED_ON * begins), name
    return found


def largest_felt(model: Model, outputs: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Return the largest size of every output of a run, zero where it is none beside others (`numbers.felt`)."""
    sizes = {name: np.max(np.abs(values)) for name, values in judged(model.scene, outputs).items()}
    seen = felt(sizes, model.outputs.units, vanishing_length(model), joints_of(model.scene))
    return {name: float(size) for name, size in seen.items()}


def vanishing_length(model: Model) -> float:
    """Return beside which a displacement vanishes that is round-off of places, m."""
    return ROUND_OFF / VANISHING * model.kinematics.size


def step_errors(
    scene: Scene, time: np.ndarray, outputs: Arrays, largest: Mapping[str, float], other: CoarserRun, sample: int = 0
) -> StepErrors | None:
    """Return the errors of a run, times and outputs of shape (n_t,), at the instants of the coarser one, of which it is
    the sample of that number; None where that did not go far enough. The largest sizes of outputs are as of
    `largest_felt`."""
    # of an output that is round-off, as across the line of a slider, no difference and no vibration says anything
    n, _ = relied_on(scene, time, {name: outputs[name] for name in outputs if largest[name]}, other, sample)
    if n <= FEWEST or not all(np.isfinite(values).all() for values in outputs.values()):
        return None
    at, step, n_steps = other.time[:n], float(time[1] - time[0]), time.size - 1
    covered, ratio = slice(0, 1 + int(np.searchsorted(time[1:], at[-1] * (1 + 1e-12), side="right"))), other.step / step
    times = round(ratio)
    fine = np.column_stack(list(outputs.values()))
    coarse = np.column_stack([other.outputs[name][:n, sample] for name in outputs])
    there = fine[: n * times : times] if n_steps % times == 0 else scipy.interpolate.CubicSpline(time, fine)(at)
    differences = dict(zip(outputs, (coarse - there).T))
    marks = {name: (output.kinked_in(scene), output.jumps_in(scene)) for name, output in scene.outputs.items()}
    kinked, jumping = np.array([marks.get(name, (False, False)) for name in outputs]).T
    cornered = any(one.cornered for one in scene.controllers.values())
    apart, values = (scipy.interpolate.CubicSpline(at, one)(time[covered]) for one in (coarse - there, coarse))
    # what jumps at instants of both has no vibrations that are seen between those
    between = np.where(jumping, apart, values - fine[covered])
    bands = Bands.of(scene.simulation.spectral_radius, n_steps, ratio)
    found, turns = bands.lost(fine[covered], apart if cornered else between, between, kinked, cornered)
    places = bands.hop * step * np.arange(len(found))
    lost = {name: np.interp(at, places, one) for name, one in zip(outputs, found.T)}
    shares = np.array([one.max() / largest[name] if largest[name] else 0.0 for name, one in lost.items()])
    loudest, most = float(shares.max()), int(shares.argmax())
    large = np.flatnonzero(found[:, most] > FADED * found[:, most].max(initial=TINY))
    first, last = (large[0], large[-1]) if large.size else (0, 0)
    lost_within = float(places[max(first - 1, 0)]), min(float(places[last] + bands.hop * step), float(at[-1]))
    lost_hz = float(turns[most] / (2.0 * np.pi * step))
    edged = [f"effects.{name}" for name, effect in scene.effects.items() if effect.edged]
    acting = {f"effects.{name}": one for name, one in scene.effects.items()}
    acting |= {f"controllers.{name}": one for name, one in scene.controllers.items()}
    at_once = [name for name, one in acting.items() if one.jumps_within(other.step)]
    if any(one.sample_time for one in scene.controllers.values()):  # friction turns at once with a force that jumps
        at_once += [name for name in edged if not acting[name].stiff_by and name not in at_once]
    unsure, order = "", ratio**2 - 1.0
    if other.divided[sample] > SOME:
        unsure = f"{share_text(float(other.divided[sample]))} of the coarser steps failed and were taken as the run's"
    elif other.shortest[sample] < BRIEF * other.step:
        unsure = f"a contact lasts {other.shortest[sample]:.2g} s"
    elif edged and (loudest > RUBS or other.status[sample] != Status.FINE):
        unsure = f"forces that turn at once ({', '.join(edged)}) act with vibrations that a coarser step loses"
    if unsure:
        order = rough(ratio)
    elif at_once:
        unsure = f"errors fall as the step, not as its square, where a force jumps ({', '.join(at_once)})"
        order = ratio - 1.0
    elif over := [entry for entry, one in other.bent.items() if one[: n - 1, sample].max() > BENT]:
        unsure = f"a force bends within a step of the coarser run, which steps over that ({', '.join(over)})"
    order *= max(1.0 - float(other.divided[sample]), 1.0 / times)
    errors = {name: np.copysign(np.hypot(d / order, lost[name]), d) for name, d in differences.items()}
    for name in scene.counted:
        made_of = np.isin(list(outputs), list(scene.outputs[name].made_in(scene)))
        # cycles of a vibration that is lost are those of neither run, and their damage has no order
        errors[name] = differences[name] / (1.0 if shares[made_of].max() > RUBS else order)
    return StepErrors(at, judged(scene, errors), lost_hz if loudest > TREMBLES else np.nan, lost_within, unsure)


@dataclass(frozen=True)
class Bands:
    """Bands of a short-time Fourier transform: Hann windows, half over one another."""

    length: int  # steps that are looked at in a window
    #: ``omega h`` of a free vibration that the scheme lets turn with the frequency of a band, rad, shape (n_bands,)
    turns: np.ndarray
    #: drifts, decays: by what share of its amplitude such a vibration goes off from one to the next, and what it loses
    #: by the scheme, as minus a logarithm, (n_bands,)
    drifts: np.ndarray
    decays: np.ndarray
    ratio: float  # of the coarser run's step to the run's

    @classmethod
    def of(cls, spectral_radius: float, n_steps: int, ratio: float) -> Bands:
        """Return those of a run of so many steps, and of a coarser one whose steps are longer by that ratio."""
        length = int(np.clip(2 ** int(np.log2(max(n_steps / PER_WINDOW, 1.0))), SHORTEST, LONGEST))
        exact, rates = _amplifications(spectral_radius)
        seen = np.minimum(2.0 * np.pi * np.arange(length // 2 + 1) / length, rates.imag[-1])
        drifts = np.minimum(np.interp(seen, rates.imag, np.abs(1j * exact - rates)), np.pi)
        decays = np.interp(seen, rates.imag, -rates.real)
        return cls(length, np.interp(seen, rates.imag, exact), drifts, decays, ratio)

    @property
    def hop(self) -> int:
        """Steps that are looked at between the middles of neighbouring windows, the first of which is the start."""
        return self.length // 2

    def lost(
        self, fine: np.ndarray, apart: np.ndarray, between: np.ndarray, kinked: np.ndarray, cornered: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return how far vibrations out of phase are off in every window, shape (n_windows, k), and ``omega h`` of the
        one that is off most, shape (k,), of k outputs after every step, shape (n, k).

        By how much the coarser run differs, shape (n, k), is a spline through its outputs less the run's, `between`,
        and one through the differences at its instants, `apart`: corners are in the first one alone. Which outputs have
        kinks of their own tells `kinked`, shape (k,), and whether what drives has corners `cornered`.
        """
        if len(fine) < 2 * self.length:
            return np.zeros((1, kinked.size)), np.full(kinked.size, np.nan)
        spectra, *others = (self._spectra(values) for values in (fine, apart, between))
        # the squares of neighbouring bands add up to that of a vibration between them
        scale = 4.0 / (self.length * np.sqrt(1.5))
        amplitudes, *apart = (scale * np.abs(one) for one in (spectra, *others))
        coarser = (scale * np.abs(spectra + one) for one in others)
        at_instants, parted = (d / np.maximum(amplitudes + b, TINY) for d, b in zip(apart, coarser))
        beyond = np.arange(amplitudes.shape[2]) * self.ratio > 0.5 * self.length  # half of the coarser run's frequency
        parted[1:, :, ~beyond] = np.minimum(at_instants, parted)[1:, :, ~beyond]
        out = parted > LOST
        out[..., :LOWEST] = False
        least = np.where(kinked[:, None], PEAK, np.zeros(out.shape))
        if cornered:  # but at the start, which may be a shock, whose vibrations fade within a window
            least[1:, :, beyond] = TONE
        rows = (out & (least > 0.0)).any(axis=2)
        around = scipy.ndimage.median_filter(amplitudes[rows], (1, AROUND), mode="nearest")
        out[rows] &= amplitudes[rows] > least[rows] * around
        drifts = self.hop * self.drifts
        # what the machine's own damping leaves of a vibration from one window to the next
        levels = np.log(np.maximum(amplitudes, TINY)) + self.hop * self.decays * np.arange(len(out))[:, None, None]
        levels = scipy.ndimage.maximum_filter1d(levels, BEATS, axis=0, mode="nearest", origin=-(BEATS // 2))
        fades = np.maximum(-np.diff(levels, axis=0), 0.0)
        kept, most, resolved = np.exp(-fades), 2.0 * amplitudes * parted, np.minimum(*apart) / (self.ratio**2 - 1.0)
        found, off = np.zeros_like(amplitudes), resolved[0]
        # at the start, what drifts most of a vibration that fades before the next window: s exp(-s fades), s up to 1
        soon = drifts * amplitudes[0] * np.exp(-np.minimum(fades[0], 1.0)) / np.maximum(fades[0], 1.0)
        found[0] = np.where(out[0], np.minimum(soon, most[0]), 0.0)
        since = np.where(out[0], 0.0, MET)  # what the coarser run went off by since it was out of phase, rad
        for k in range(1, len(out)):
            since = np.where(out[k], 0.0, since + (self.ratio**2 - 1.0) * drifts)
            out[k] = since < MET
            before, off = most[k - 1], kept[k - 1] * off + drifts * amplitudes[k]
            most[k] = np.maximum(most[k], kept[k - 1] * before)
            found[k] = np.where(out[k], np.minimum(off, np.maximum(before, most[k])), 0.0)
            off = np.where(out[k], np.minimum(off, most[k]), resolved[k])
        weights = (found**2).sum(axis=0)
        loudest = np.where(weights.any(axis=1), self.turns[weights.argmax(axis=1)], np.nan)
        # as the vibration itself, each band by its share
        lost = np.fft.irfft(spectra * found / np.maximum(amplitudes, TINY), axis=2)
        return np.abs(lost).max(axis=2), loudest

    def _spectra(self, values: np.ndarray) -> np.ndarray:
        """Return the spectra of k outputs (n, k) in all windows, shape (n_windows, k, n_bands).

        The ends go on point-symmetrically for half a window: what begins at the start is seen.
        """
        n, half = self.length, self.hop
        every = np.pad(values, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
        windows = np.lib.stride_tricks.sliding_window_view(every, n, axis=0)[::half]
        line = np.arange(n) - 0.5 * (n - 1)
        slopes = windows @ line / (line @ line)
        level = windows - windows.mean(axis=2, keepdims=True) - slopes[..., None] * line
        hann = np.sin(np.pi * np.arange(n) / n) ** 2
        return np.fft.rfft(level * hann, axis=2)


def amplification(spectral_radius: float, turns: np.ndarray) -> np.ndarray:
    """Return the logarithm of the scheme's factor for a free vibration in a step, for omega h of shape (n,).

    With ``q'' = -omega^2 q`` a step of `generalised_alpha` is linear in (q, h q', h^2 A).
    """
    s = Scheme.of(spectral_radius, 1.0)
    square, weight = turns**2, 1.0 / (1.0 - s.alpha_m)
    by = 1.0 + s.beta * weight * (1.0 - s.alpha_f) * square
    steps = np.empty((turns.size, 3, 3))
    steps[:, 0, 0] = (1.0 - s.beta * weight * s.alpha_f * square) / by
    steps[:, 0, 1] = 1.0 / by
    steps[:, 0, 2] = (0.5 - s.beta - s.beta * weight * s.alpha_m) / by
    steps[:, 2] = -weight * (1.0 - s.alpha_f) * square[:, None] * steps[:, 0]
    steps[:, 2, 0] -= weight * s.alpha_f * square
    steps[:, 2, 2] -= weight * s.alpha_m
    steps[:, 1] = s.gamma * steps[:, 2]
    steps[:, 1, 1] += 1.0
    steps[:, 1, 2] += 1.0 - s.gamma
    values = np.linalg.eigvals(steps)
    chosen = np.take_along_axis(values, np.argmax(np.abs(values.imag), axis=1)[:, None], axis=1)[:, 0]
    return np.log(chosen.real + 1j * np.abs(chosen.imag))


@lru_cache(maxsize=8)
def _amplifications(spectral_radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return omega h from slow to fast vibrations, and their `amplification`."""
    turns = np.concatenate([np.linspace(1e-3, 3.0, 300), np.geomspace(3.01, 200.0, 150)])
    return turns, amplification(spectral_radius, turns)
