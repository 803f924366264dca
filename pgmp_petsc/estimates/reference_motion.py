"""The motion of all unknowns that a reduced run represents, with its velocities and accelerations.

A reduced state gives the unknowns ``q(eta)`` by back-transformation (`reduction.reconstruction`). The velocities and
accelerations that belong to it are the derivatives along the path ``eta + tau eta' + 1/2 tau^2 eta''`` at tau = 0,
taken as differences of fourth order. All of the chain rule is in them, also what the reduced equations leave out.

A path stays where a difference is good: the mechanism does not turn far on it, nor do bodies bend by large rotations.

At which steps of a run its error is evaluated, until two sets of instants agree, and why at these: docs/method.md,
error indicator. Every interval is a whole number of steps, the same throughout; one that is not would move the motion
by up to half a step in time from one evaluation to the next. Where controllers, or what joints carry, are found between
corrections, samplings are at evaluations: there may be too few strides for an estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import gcd

import numpy as np

from pgmp_petsc.controllers.acting import are_stated
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Simulation

# us of one core: an unknown of a beam with its neighbours, a pair of unknowns of a condensed body
OF_BEAM, OF_PAIR = 0.8, 0.02
OF_BESIDE = 500.0  # a controller, or friction by the force carried, found beside steps; of runs too
CARRYING = 2.0  # how often as much a step takes that finds the forces carried: it has 7 corrections in place of 3
DEAR = 4e6  # us that the evaluations of a sample may take
FINER = 4  # steps of the run that is followed in one of the run itself
MOST, LEAST = 8000, 100  # evaluations
DAMPED = 0.5  # spectral radius of the steps of the error: less than of runs, as these instants are all that is seen
AGREED = 1.25  # ratio of two estimates, of which the second is then kept
UNSURE_WITH_OTHERS = 1.5  # where another output of the same run is unsure
UNSURE = 2.5  # beyond which the last two do not tell the error, as their own errors are of second order in the interval


@dataclass(frozen=True)
class Schedule:
    """Even evaluations of a run."""

    #: numbers of the smaller steps, the first 0 and the last that of the end, shape (n_e,). All intervals have the same
    #: number of steps, but the first may have less: the value at its end then represents a whole interval.
    steps: np.ndarray
    places: np.ndarray  # places of these among the steps that are kept while a run goes on, shape (n_e,)
    told: np.ndarray  # which of these are ends of the run's own steps, shape (n_e,)
    interval: float  # time between two evaluations, s
    #: of the integration over these: 0, without a memory of what is faster, where they are longer than the run's steps
    spectral_radius: float


def schedules(n_steps: int, duration: float, most: int = MOST, every: int = 0) -> list[Schedule]:
    """Return the schedules of a run from the coarsest, which is there to be compared with, to the densest with no more
    than `most` evaluations; none where that leaves less than two.

    Where it is given, the ends of every so many steps are evaluated.
    """
    most = min(max(most, LEAST), MOST)
    stride = -(-n_steps // most)
    strides = [FINER * max(2, 2 * stride - 1), FINER * stride]
    while stride == 1 and strides[-1] > 1 and 2 * FINER * n_steps <= most * strides[-1]:
        strides.append(strides[-1] // 2)
    strides = strides[1:] if len(strides) > 2 else strides
    if every:
        whole = [each for each in range(1, FINER * every + 1) if FINER % each == 0 or each % FINER == 0]
        whole = [each for each in whole if FINER * every % each == 0 and FINER * n_steps <= most * each]
        strides = whole[2::-1] if len(whole) > 1 else []
    steps = [np.concatenate([[0], np.arange(FINER * n_steps, 0, -each)[::-1]]) for each in strides]
    kept, radius = np.unique(np.concatenate([[0], *steps])), DAMPED if strides and strides[-1] <= FINER else 0.0
    return [
        Schedule(some, np.searchsorted(kept, some), some % FINER == 0, each * duration / (FINER * n_steps), radius)
        for some, each in zip(steps, strides)
    ]


def places_of(kept: np.ndarray) -> np.ndarray:
    """Return where each step is among those that are kept, -1 where it is not, by the numbers of steps."""
    places = np.full(kept[-1] + 1, -1)
    places[kept] = np.arange(kept.size)
    return places


def differences(one: Arrays, other: Arrays, floors: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Return the factors by which two estimates (n,) of every output differ, 1 and more; NaN where one is not known.

    What is below its floor is taken for that.
    """
    found = {}
    for name, floor in floors.items():
        ratio = np.maximum(one[name], floor) / np.maximum(other[name], floor)
        found[name] = np.maximum(ratio, 1.0 / ratio)
    return found


def price_of_evaluation(mechanism: Mechanism) -> float:
    """Return about how long an evaluation of the full-order equations takes, corrections included, us of one core."""
    price = 0.0
    for body in mechanism.bodies:
        n = mechanism.space.n_pose * body.n_nodes + body.n_internal
        price += OF_PAIR * n**2 if body.dense or body.blocks("floating") else OF_BEAM * n
    return OF_BESIDE * found_beside(mechanism.scene) + carrying(mechanism.scene) * price


def found_beside(scene: Scene) -> float:
    """Return how many forces are found beside a step of a sample on the mesh, by no compiled code: where they hold,
    between two steps."""
    if scene.held:
        return sum(scene.simulation.step / one.sample_time for one in scene.controllers.values())
    sampled = any(one.sample_time for one in scene.controllers.values())
    return len(scene.beside) if sampled or not are_stated(scene) else 0


def carrying(scene: Scene) -> float:
    """Return how often as much a step takes as one without the forces carried that are found in it."""
    return CARRYING if scene.carried and not found_beside(scene) else 1.0


def schedules_of(mechanism: Mechanism, simulation: Simulation) -> list[Schedule]:
    """Return the schedules of a mechanism's run; see `schedules`."""
    n_steps, scene = simulation.n_steps, mechanism.scene
    every = steps_between_samplings(scene, simulation) if scene.beside else 0
    return schedules(n_steps, simulation.duration, int(DEAR / price_of_evaluation(mechanism)), every)


def steps_between_samplings(scene: Scene, simulation: Simulation) -> int:
    """Return the largest number of steps that divides a run, and the time between samplings of every controller."""
    sampled = [round(one.sample_time / simulation.step) for one in scene.controllers.values() if one.sample_time]
    return gcd(simulation.n_steps, *sampled)


#: From points (n_points, k, n_eta) of paths of reduced coordinates to unknowns (n_dofs, n_points, k).
Unknowns = Callable[[np.ndarray], np.ndarray]

# rad that a rigid coordinate turns from point to point: a difference is wrong by TURN^4 / 90 of the sixth derivative,
# which in a four-bar, whose table closes its loops, is 1e5 times the second where it turns round, and by round-off of
# the table, 1e-12, over TURN^2. Both are about 1e-7 here; with 1e-2 the error of an angle was 3 times as large.
# Where loops are closed one by one, the points are on parabolas, which have exact first and second differences
TURN = 3e-3
BEND = 0.1  # rad that frames turn in their bodies from point to point, at most; wrong by BEND^4 / 90 likewise
# weights of the points on both sides for first and second derivatives, and of the point itself
AT, FIRST = (-2, -1, 1, 2), (1 / 12, -8 / 12, 8 / 12, -1 / 12)
SECOND, HERE = (-1 / 12, 16 / 12, 16 / 12, -1 / 12), -30 / 12
LARGEST = 2**22  # numbers that are kept at once
TOGETHER = 2**17  # that are evaluated together: no more than stay in the cache


class ReferenceMotion:
    """Motion at the instants of evaluation.

    States are reduced coordinates, velocities and accelerations at every instant, shape (n_instants, 3, n_samples,
    n_eta), the first `n_theta` of them rigid; the unknowns transform them back. `longest` is the largest step of the
    differences, s: for what does not move at all. Rotations are the largest of a frame in its body per unit of each
    flexible coordinate, shape (n_eta - n_theta,), rad, and turns what one unit of each rigid coordinate counts, shape
    (n_theta,), rad.
    """

    def __init__(
        self, unknowns: Unknowns, n_dofs: int, states: np.ndarray, n_theta: int, longest: float, rotations: np.ndarray,
        turns: np.ndarray | float = 1.0,
    ) -> None:  # fmt: skip
        self._unknowns, self._n_dofs, self._states = unknowns, n_dofs, states
        self._n_theta, self._longest, self._rotations, self._turns = n_theta, longest, rotations, turns
        self._first, self._kept = 0, np.empty((3, 0, 0, 0))

    def over(self, number: int, n: int) -> np.ndarray:
        """Return positions, velocities and accelerations at n instants from a number on, shape (3, n, n_dofs,
        n_samples); those of further ones are computed with them."""
        first = number - self._first
        if not 0 <= first <= self._kept.shape[1] - n:
            self._compute(number, n)
            first = 0
        return self._kept[:, first : first + n]

    def _compute(self, number: int, n: int) -> None:
        n_samples, n_dofs = self._states.shape[2], self._n_dofs
        numbers = (1 + len(AT)) * n_dofs * n_samples
        states = self._states[number : number + max(n, LARGEST // numbers)]
        kept = np.empty((3, len(states), n_dofs, n_samples))
        n_together = max(1, TOGETHER // numbers)
        for first in range(0, len(states), n_together):
            some = slice(first, first + n_together)
            self._fill(states[some], kept[:, some])
        self._first, self._kept = number, kept

    def _fill(self, states: np.ndarray, kept: np.ndarray) -> None:
        """Fill the parts of instants, (3, n, n_dofs, n_samples), for states (n, 3, n_samples, n_eta)."""
        r = self._n_theta
        speeds, changes = (states[:, part, :, :r] * self._turns for part in (1, 2))
        pace = np.max(speeds**2 + TURN * np.abs(changes), axis=-1)
        bending, changing = (np.abs(states[:, part, :, r:]) @ self._rotations for part in (1, 2))
        bent = (TURN / BEND) ** 2 * np.maximum(bending**2, BEND * changing)
        tau = TURN / np.sqrt(np.maximum(np.maximum(pace, bent), (TURN / self._longest) ** 2))
        eta = np.empty((1 + len(AT), *tau.shape, states.shape[3]))
        fill_path(np.ascontiguousarray(states), tau, eta)
        found = self._unknowns(eta.reshape(len(eta), -1, eta.shape[-1]))
        fill_motion(found.reshape(-1, *eta.shape[:-1]), tau, *kept)


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def fill_path(states, tau, eta):
    """Fill reduced coordinates: those of states, and those along the path on both sides.

    Parameters
    ----------
    states
        As of `ReferenceMotion`, shape (n, 3, n_samples, n_eta).
    tau
        Steps of the differences, shape (n, n_samples), s.
    eta
        Results, shape (5, n, n_samples, n_eta).
    """
    for k in range(tau.shape[0]):
        for b in range(tau.shape[1]):
            for d in range(states.shape[3]):
                q, v, a = states[k, 0, b, d], states[k, 1, b, d], states[k, 2, b, d]
                eta[0, k, b, d] = q
                for side in range(len(AT)):
                    far = AT[side] * tau[k, b]
                    eta[1 + side, k, b, d] = q + far * v + 0.5 * (far * far) * a


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def fill_motion(found, tau, q, v, a):
    """Fill the parts of instants, (n, n_dofs, n_samples), from unknowns (n_dofs, 5, n, n_samples) at `fill_path`."""
    for k in range(tau.shape[0]):
        for dof in range(found.shape[0]):
            for b in range(tau.shape[1]):
                here = found[dof, 0, k, b]
                first, second = 0.0, HERE * here
                for side in range(len(AT)):
                    first += FIRST[side] * found[dof, 1 + side, k, b]
                    second += SECOND[side] * found[dof, 1 + side, k, b]
                q[k, dof, b] = here
                v[k, dof, b], a[k, dof, b] = first / tau[k, b], second / tau[k, b] ** 2
