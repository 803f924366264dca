"""Static equilibrium of a model under its loads at time zero, where a run may start at rest.

With held coordinates theta the bodies take their static deformation, and a torque on every coordinate keeps it where it
is. What the loads leave over, ``f(theta)``, is that torque with the opposite sign; free coordinates are in equilibrium
where ``f = 0``. The search follows f downhill from the given start with steps of `LONGEST` at most: with ``S = - df /
dtheta`` by differences,

    step = |S|^-1 f,     |S| = V |Lambda| V^T  of the symmetric part of S, or S itself where it pulls back,

Newton's method with the modified Hessian (Nocedal and Wright 2006, section 3.4): it goes to the equilibrium that loads
pull the mechanism to, and stays at an unstable one only if it starts there. S pulls back where the eigenvalues of
``I^-1 S`` with the coordinates' inertia I have positive real parts: where it is positive definite if it is symmetric;
forces that turn with a body, or hang on another joint, are not. That such forces feed vibrations is not looked for.
Every sample is searched by itself. What users are told of such starts is here, too (`start_remarks`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, note, warning
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Coordinate, words_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, Settled

SHARES = (1, 4, 16, 64)  # steps in which loads are put on, one after the other where fewer do not converge
MAX_CORRECTIONS = 60  # forces that turn with a body have no exact tangent: the iteration is then linear
LONGEST = 0.2  # of a correction or a step, in units of the mechanism's size or of 1 rad
SHORTENED, SHORTEST = 0.25, 1e-4  # of a step after which bodies have no deformation, or leave the range; not shorter
TOLERANCE = 1e-12  # of the last correction, in the same units
ROUND_OFF = 1e-8  # of a correction that no longer becomes smaller
DIFFERENCE = 1e-5  # rad, or of the mechanism's size
MAX_STEPS = 400
TRAVEL = 4.5 * np.pi  # rad; every equilibrium of a periodic coordinate lies within a turn
STILL = 1e-10  # rad, or share of the size, that a torque moves a coordinate within the run: less is none


class Statics(Protocol):
    """Interface of a model with held coordinates for the search."""

    n_samples: int

    def hold(self, theta: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the deformation of the samples of a mask at held coordinates, shape (n_samples, n_theta), rad.

        Returns what the loads leave over on every coordinate, shape (n_samples, n_theta), N m, and the mask of the
        samples without a solution.
        """

    def cause(self, sample: int) -> str:
        """Return why a sample was lost last, with what helps."""

    def unknowns(self) -> np.ndarray:
        """Return the unknowns that were found last, a column a sample."""

    def inertia(self) -> np.ndarray:
        """Return the inertia of the rigid mechanism against each coordinate at the start, (n_samples, n_theta)."""


@dataclass(frozen=True, eq=False)
class Search:
    """The free coordinates, and how far they may go."""

    free: tuple[int, ...]  # their numbers
    coordinates: tuple[Coordinate, ...]  # all of them
    #: lower, upper: range of all coordinates, without bounds for periodic ones, each of shape (n_theta,)
    lower: np.ndarray
    upper: np.ndarray
    duration: float  # of the run, s: what does not move within it is at rest
    size: float  # of the mechanism, m

    @property
    def scales(self) -> np.ndarray:
        """Units of changes of the free coordinates, 1 rad or the size, shape (n_free,)."""
        return np.array([self.coordinates[k].scale(self.size) for k in self.free])


def settle(statics: Statics, theta: np.ndarray, search: Search) -> Settled:
    """Find the equilibrium of every sample that its loads pull it to from theta, shape (n_samples, n_theta)."""
    theta = np.array(theta, dtype=float)
    everyone, reasons = np.ones(statics.n_samples, dtype=bool), {}
    free = list(search.free)
    torques, lost = statics.hold(theta, everyone)
    _note(reasons, lost, _no_deformation, statics, search, theta)
    unstable = np.zeros(statics.n_samples, dtype=bool)
    if not free:
        return Settled(theta, statics.unknowns(), reasons, unstable, search.coordinates, bool(free))
    scales, origin = search.scales, theta.copy()
    inertia = statics.inertia()[:, free] * scales**2
    active, limit = everyone & ~lost, np.full(statics.n_samples, LONGEST)
    last, before = np.full(statics.n_samples, np.inf), np.zeros((statics.n_samples, len(free)))
    for _ in range(MAX_STEPS):
        slopes, lost = _slopes(statics, theta, torques, free, scales, active)
        _note(reasons, active & lost, _no_deformation, statics, search, theta)
        active &= ~lost
        step, definite = _downhill(slopes, torques[:, free] * scales, inertia / search.duration**2)
        limit = np.where(np.sum(step * before, axis=1) < 0.0, 0.5 * limit, np.minimum(LONGEST, 1.5 * limit))
        size = np.max(np.abs(step), axis=1)
        arrived = active & settled_in(size, last)
        unstable |= arrived & ~definite
        active &= ~arrived
        if not active.any():
            break
        step = step * np.minimum(1.0, limit / np.maximum(size, 1e-300))[:, None] * active[:, None]
        before, last = np.where(active[:, None], step, before), np.where(active, size, last)
        theta[:, free] += step * scales
        away = active & _out_of_reach(search, theta, origin)
        ended = away & (limit <= SHORTEST)
        _note(reasons, ended, _nowhere, search, theta, origin, torques)
        theta[ended] = origin[ended]
        active &= ~ended
        torques_there, lost = statics.hold(theta, active & ~away)
        back = active & (lost | away) & (limit > SHORTEST)
        torques = np.where(back[:, None], torques, torques_there)
        if back.any():  # too far for the bodies' deformation, or out of the range: a shorter step from where it was not
            theta[:, free] -= step * scales * back[:, None]
            limit[back] = SHORTENED * np.minimum(limit, size)[back]
            _, lost_there = statics.hold(theta, back)
            lost[back] = lost_there[back]
        _note(reasons, active & lost, _no_deformation, statics, search, theta)
        active &= ~lost
    _note(reasons, active, _nowhere, search, theta, origin, torques)
    _, lost = statics.hold(theta, everyone & ~np.isin(np.arange(statics.n_samples), list(reasons)))
    _note(reasons, lost, _no_deformation, statics, search, theta)
    return Settled(theta, statics.unknowns(), reasons, unstable, search.coordinates, bool(free))


def put_on(
    begin: Callable[[np.ndarray], None], converge: Callable[[np.ndarray, float], np.ndarray], samples: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Put loads on some samples, a mask, at once, or in more parts where their deformations do not converge.

    `begin` puts samples back to the beginning; `converge` deforms them under a share of the loads, and returns which of
    them converged. Returned are the mask of the samples that no number of parts helps, and the largest share with which
    a deformation was found, shape (n_samples,).
    """
    lost, reached = samples.copy(), np.zeros(samples.size)
    for n_parts in SHARES:
        going = lost.copy()
        begin(going)
        for part in range(1, n_parts + 1):
            going &= converge(going, part / n_parts)
            if not going.any():
                break
            reached[going] = np.maximum(reached[going], part / n_parts)
        lost &= ~going
        if not lost.any():
            break
    return lost, reached


def iterate_at_rest(correct: Callable[[np.ndarray], np.ndarray], samples: np.ndarray) -> np.ndarray:
    """Correct some samples, a mask, each to its own convergence; return which of them converged.

    `correct` does one correction of a mask of them, and returns its sizes.
    """
    active, found, last = samples.copy(), np.zeros_like(samples), np.full(samples.size, np.inf)
    for _ in range(MAX_CORRECTIONS):
        size = correct(active)
        done = active & settled_in(size, last)
        found |= done
        active &= ~done & np.isfinite(size)
        last = size
        if not active.any():
            break
    return found


def settled_in(size: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return which corrections, after others of the size `last`, are small or no longer become smaller."""
    return (size <= TOLERANCE) | ((size < ROUND_OFF) & (size >= last))


def _slopes(
    statics: Statics, theta: np.ndarray, torques: np.ndarray, free: Sequence[int], scales: np.ndarray,
    active: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return ``- df / dtheta`` of the free coordinates in units of `scales`, shape (n_samples, n_free, n_free), and the
    samples lost."""
    slopes = np.zeros((statics.n_samples, len(free), len(free)))
    failed = np.zeros(statics.n_samples, dtype=bool)
    for column, k in enumerate(free):
        moved = theta.copy()
        moved[:, k] += DIFFERENCE * scales[column]
        changed, lost = statics.hold(moved, active)
        failed |= lost
        slopes[:, :, column] = -((changed - torques)[:, free] * scales) / DIFFERENCE
    return slopes, failed & active


def _downhill(slopes: np.ndarray, torques: np.ndarray, still: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return steps (n_samples, n_free), and whether S pulls back, or is as good as zero.

    `still` are torques that move a coordinate by 1 rad within the run, shape (n_samples, n_free), N m.
    """
    steps, definite = np.zeros_like(torques), np.ones(len(torques), dtype=bool)
    for sample, (slope, torque, least) in enumerate(zip(slopes, torques, still)):
        if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(torque))):
            continue
        pulls = np.linalg.eigvals(slope / np.where(least > 0.0, least, 1.0)[:, None]).real
        # differences of torques as small as round-off are no stiffness
        definite[sample] = bool(np.all(pulls > -STILL / DIFFERENCE))
        if np.all(np.abs(torque) <= STILL * least):
            continue
        if np.all(pulls > 0.0):
            steps[sample] = np.linalg.solve(slope, torque)
        else:
            faint = STILL * float(np.min(least))
            values, vectors = np.linalg.eigh(0.5 * (slope + slope.T))
            steps[sample] = vectors @ ((vectors.T @ torque) / np.maximum(np.abs(values), faint))
    return steps, definite


def _out_of_reach(search: Search, theta: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return the samples that left the range, or went round without coming to rest."""
    turns = [coordinate.turns for coordinate in search.coordinates]
    outside = np.any((theta < search.lower) | (theta > search.upper), axis=1)
    return outside | np.any((np.abs(theta - origin) > TRAVEL) & turns, axis=1)


def _note(reasons: dict[int, str], samples: np.ndarray, explain: Callable[..., str], *about: Any) -> None:
    """Keep the reason of samples (a mask) that have none yet."""
    for sample in np.flatnonzero(samples):
        reasons.setdefault(int(sample), explain(int(sample), *about))


def _no_deformation(sample: int, statics: Statics, search: Search, theta: np.ndarray) -> str:
    where = words_of(search.coordinates, theta[sample])
    return f"initial.equilibrium = true: the static deformation at {where} was not found: {statics.cause(sample)}"


def cause_of(share: float) -> str:
    """Say why a deformation was not found under the loads at time zero, of which a share was reached."""
    reached = f"{100.0 * share:.3g} % of" if share > 0.0 else f"less than 1/{SHARES[-1]} of"
    return (
        f"Newton's iteration converges with {reached} the loads and springs at time zero, and not with all: they may "
        "be larger than the bodies carry; take smaller ones, or let simulation.initial begin elsewhere"
    )


def _nowhere(sample: int, search: Search, theta: np.ndarray, origin: np.ndarray, torques: np.ndarray) -> str:
    free = ((torques[sample, k], search.coordinates[k]) for k in search.free)
    left = ", ".join(f"{torque:.3g} {'N m' if c.turns else 'N'} on {c.name}" for torque, c in free)
    first, last = (words_of(search.coordinates, where[sample]) for where in (origin, theta))
    beyond = (theta[sample] < search.lower) | (theta[sample] > search.upper)
    ranges = " and ".join(f"coordinates.{search.coordinates[k].name}.range" for k in np.flatnonzero(beyond))
    within, cure = (f" within {ranges}", f"Widen {ranges}, give what") if ranges else ("", "Give what")
    return (
        f'initial.coordinates = "free": from {first} the loads at time zero pull the '
        f"mechanism to no static equilibrium{within}; at {last} they leave {left}. {cure} "
        'holds it against them, another start in simulation.initial, or take coordinates = "held"'
    )


def moved_along(
    deformed: Callable[[np.ndarray], np.ndarray],
    q: np.ndarray,
    theta: np.ndarray,
    rates: np.ndarray,
    scales: np.ndarray,
) -> np.ndarray:
    """Return the velocities of what is in balance while the coordinates move, by central differences.

    `deformed` returns unknowns at positions of the coordinates, a column of the only sample or a row of each of
    several, and `q` are these at `theta`. Positions and rates have shape (n_theta,) of the only sample, or (n_samples,
    n_theta); small changes of the coordinates are measured against scales, shape (n_theta,).
    """
    v = np.zeros_like(q)
    for k, scale in enumerate(scales):
        if rates[..., k].any():
            step = DIFFERENCE * scale * np.eye(scales.size)[k]
            change = deformed(theta + step) - deformed(theta - step)
            v += rates[..., k, None] * change / (2.0 * DIFFERENCE * scale)
    return v


BUILT_IN = "the run starts with the stress that joints that are off build in, without loads, and lets the mechanism go"
UNBALANCED = (
    "joints: no balance of springs of elastic joints and bodies was found at the start, which is to answer joints that "
    "are off: {}. A direction that an elastic joint releases needs a stiffness, there or in another joint"
)


def require_balance(scene: Scene, kinematics: RigidKinematics, theta: np.ndarray, values: Mapping[str, Any]) -> None:
    """Refuse a start at theta (n_theta,) with what joints that are off build in, if elastic joints release a rigid
    motion that no spring of theirs holds; `values` are those of parameters, one or many each.

    Raises `InputError`, with the joint and its direction.
    """
    mechanism, stiff, entries = kinematics.mechanism, [], []
    for connection in (c for c in mechanism.connections if c.released):
        elastic = scene.joints[connection.name].elastic
        if elastic is None:
            return  # of what has a clearance the search itself tells
        for part in connection.released:
            given = getattr(elastic, part.key)
            k = given[part.axis]
            stiff.append(bool(np.all(np.asarray(values[k] if isinstance(k, str) else k) > 0.0)))
            words = [f"{one:g}" if isinstance(one, float) else str(one) for one in given]
            entries.append(f"joints.{connection.name}.elastic.{part.key} = [{', '.join(words)}]")
    stiff += [True for coupling in mechanism.couplings if coupling.elastic]
    number = kinematics.unheld(theta, stiff) if stiff else None
    if number is not None:
        raise InputError(UNBALANCED.format(f"nothing holds what {entries[number]} releases"))


def start_remarks(scene: Scene, system: SecondOrderSystem) -> tuple[Remark, ...]:
    """Return where runs of a scene start from static equilibrium, and whether they will stay there."""
    settled = system.settled
    if settled is None:
        return (note(BUILT_IN),) if system.built_in is not None else ()
    places = words_of(settled.coordinates, settled.theta[0])
    remarks = [_start(scene, "the run starts from static", settled.free, f" at {places}")]
    if np.any(settled.unstable):
        remarks.append(_unstable(f"at {places}"))
    return tuple(remarks)


def starts_remarks(scene: Scene, unstable: np.ndarray) -> tuple[Remark, ...]:
    """Return where the samples of an ensemble start from, and how many will not stay there (a mask)."""
    if not scene.initial.equilibrium:
        off = any(joint.offset is not None for joint in scene.joints.values())
        return (note(BUILT_IN.replace("the run", "every sample")),) if off else ()
    remarks = [_start(scene, "every sample starts from its own static", scene.initial.coordinates == "free", "")]
    if unstable.any():
        remarks.append(_unstable(f"of {int(unstable.sum())} of {unstable.size} samples"))
    return tuple(remarks)


def _unstable(which: str) -> Remark:
    return warning(
        f"the static equilibrium {which} is unstable: the smallest disturbance, round-off too, makes the mechanism "
        "leave it; begin elsewhere (simulation.initial) to find the one that it falls to"
    )


def _start(scene: Scene, words: str, free: bool, places: str) -> Remark:
    """Return how runs start; of coordinates that are held at first, prescribed ones go on as prescribed."""
    courses = [course for one in scene.plain_effects.values() if (course := one.course()) is not None]
    if any(course.jet(np.zeros(1), 2)[2].any() for course in courses):
        places += ", under the inertia forces of the base's acceleration at time zero too"
    if free:
        return note(f"{words} equilibrium{places}")
    let_go = [name for name in scene.coordinates if name not in scene.driven]
    going = f", and lets {', '.join(let_go) if scene.driven else 'them'} go" if let_go else ""
    return note(f"{words} deformation with coordinates held{places}{going}")
