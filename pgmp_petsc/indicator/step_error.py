"""What the time step does to a reduced motion, followed step by step while it runs.

**Vibrations.** In the mode k of `flexible_modes`, with amplitude x and the force ``f = x'' + 2 z x' + omega^2 x`` that
the motion itself says acts on it, one step of an exact oscillator under a force that is linear over the step would lead
from ``(x, x')_n`` to ``(x~, x~')_{n+1}``. What the integrator's own step differs by is its local error; it travels on
as a free vibration (Hairer, Norsett and Wanner 1993, section II.3)::

    E_{n+1} = R E_n + (x~ - x, x~' - x')_{n+1},     R = [[C + z S, S], [-omega^2 S, C - z S]]
    C = exp(-z h) cos(omega_d h),     S = exp(-z h) sin(omega_d h) / omega_d,     omega_d^2 = omega^2 - z^2

A prescribed coordinate p changes its speed by what it is told, whatever the accelerations at the steps make of it.
Where these jump, from rest or at the end of a table, a force that is linear over the step is not what acts, and the
mode gets the impulse of the rest,

    -drag_pk (theta_p'_{n+1} - theta_p'_n - h/2 (theta_p''_n + theta_p''_{n+1})).

However coarse the step is for a frequency, the sum x + E is what it should be, up to the phase. The modes of a sample
are held for a while, until it has turned a little, and then taken anew (`hold`).

**Rigid motion.** ``s = theta + follow.delta`` does not vibrate, so its accelerations at the steps, which fulfil the
equations of motion, determine it: integrated twice with fourth order from the exact start, they give the coordinates
``s - follow.delta`` that a scheme without an error of the step would have reached with these accelerations. It is no
solution yet, because the accelerations belong to the integrator's coordinates; `residual_error` corrects for that.
Accelerations bend where a law has an edge: they are integrated up to there and on, and the fourth order begins anew.
Prescribed coordinates are what they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.indicator.flexible_modes import Modes
from pgmp_petsc.indicator.quadrature import N_VALUES, WEIGHTS
from pgmp_petsc.runtime.compiled import njit

SOFTEST = 1e-3  # of omega h: below, a mode is taken for this stiff, and nothing is divided by zero


class Turns(NamedTuple):
    """Where samples have turned so far that other modes hold.

    Attributes
    ----------
    places
        After how many steps, increasing, shape (n_turns,).
    samples
        Numbers of the samples, shape (n_turns,).
    modes
        From there on.
    """

    places: np.ndarray
    samples: np.ndarray
    modes: Modes


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def find_turns(motion, looks, hold, middles, places, samples, found):
    """Find where samples have turned so far that other modes hold; return how often that is.

    Parameters
    ----------
    motion
        Coordinates and velocities after steps, shape (n_t, 2 or more, n, n_eta).
    looks
        Which of them are looked at, increasing, shape (n_looks,).
    hold
        Angle over which modes hold, rad.
    middles
        Coordinates in the middle of that range, shape (n, r); moved on.
    places, samples, found
        Results: as of `Turns`, and the middles from there on, of the turn that lies ahead; room for n_looks n of them.
    """
    n_turns = 0
    for look in looks:
        for b in range(middles.shape[0]):
            inside = True
            for c in range(middles.shape[1]):
                inside &= abs(motion[look, 0, b, c] - middles[b, c]) <= 0.5 * hold
            if not inside:
                for c in range(middles.shape[1]):
                    middles[b, c] = motion[look, 0, b, c] + 0.5 * np.copysign(hold, motion[look, 1, b, c])
                    found[n_turns, c] = middles[b, c]
                places[n_turns], samples[n_turns] = look + 1, b
                n_turns += 1
    return n_turns


class Held(NamedTuple):
    """Modes of n samples as steps take them.

    Attributes
    ----------
    squares, decays
        omega^2 and 2 z, shape (n, m).
    columns
        Inverse of the shapes by its columns, shape (n, m, m).
    shapes, follow, drag
        As of `Modes`, shapes (n, m, m), (n, r, m) and (n, r, m).
    oscillators
        Of every mode over a step, shape (n, 8, m); see `oscillators`.
    """

    squares: np.ndarray
    decays: np.ndarray
    columns: np.ndarray
    shapes: np.ndarray
    follow: np.ndarray
    drag: np.ndarray
    oscillators: np.ndarray

    @classmethod
    def of(cls, modes: Modes, step: float) -> Held:
        """Return what steps (s) take of modes."""
        omega = np.maximum(modes.omega, SOFTEST / step)
        parts = (
            omega**2, 2.0 * modes.decay, np.swapaxes(modes.inverse, 1, 2), modes.shapes, modes.follow,
            modes.drag, oscillators(omega, modes.decay, step),
        )  # fmt: skip
        return cls(*(np.ascontiguousarray(part) for part in parts))

    @classmethod
    def none(cls, n: int, r: int, m: int) -> Held:
        """Return the modes of samples before there are any."""
        shapes = (n, m), (n, m), (n, m, m), (n, m, m), (n, r, m), (n, r, m), (n, 8, m)
        return cls(*(np.zeros(shape) for shape in shapes))


@njit(cache=True, entry=True, error_model="numpy", fastmath={"contract"})
def advance(step, since, motion, past, held, turns, modal, vibration, smooth, free, shares, exact, missing):
    """Advance the errors of all samples over some steps, in place, and say what the motion should be after each.

    Parameters
    ----------
    step
        s.
    since
        Steps done since the start, or since each sample has crossed an edge of a law, shape (n,); moved on.
    motion
        Coordinates, velocities and accelerations at the beginning and at the end of every step, shape (n_steps + 1, 3,
        n, r + m).
    past
        Accelerations at the beginning and before, shape (3, n, r + m); moved on.
    held
        Modes of all samples (`Held`); replaced in `turns`.
    turns
        ``(places, samples, modes)``: numbers of the states of `motion`, in their order, at which samples, given by
        their numbers, take other modes, shapes (n_turns,), and these, `Held`.
    modal
        Displacement, velocity and force of the modes at the beginning, shape (n, 3, m); moved on.
    vibration
        E, displacement and velocity, shape (n, 2, m).
    smooth
        s and its rate, shape (2, n, r); of a prescribed coordinate its own at the beginning, and its speed there.
    free
        Whether each rigid coordinate is free, shape (r,).
    shares
        Of each step, before an edge of a law; see `EdgeCrossings.over`.
    exact, missing
        Results; see `StepError.advance`.
    """
    places, samples, others = turns
    n, m = held.squares.shape
    s = np.empty(N_VALUES)
    now, n_turned = np.empty((3, m)), 0
    for number in range(motion.shape[0]):
        for b in range(n if number > 0 else 0):
            _advance_one(
                step, since[b], motion[number], b, past, held, now, s, modal, vibration, smooth, free,
                shares[number - 1, b], exact[number - 1], missing[number - 1],
            )  # fmt: skip
            since[b] = since[b] + 1 if shares[number - 1, b] > 1.0 else 0
        while n_turned < places.size and places[n_turned] == number:
            _take_other(motion[number], samples[n_turned], others, n_turned, held, now, modal, vibration, smooth)
            n_turned += 1


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _advance_one(step, n_done, motion, b, past, held, now, s, modal, vibration, smooth, free, share, exact, missing):
    """Advance the errors of a sample over a step to the state `motion`, (3, n, r + m)."""
    weights = WEIGHTS[min(n_done, WEIGHTS.shape[0] - 1)]
    r, m = free.size, held.squares.shape[1]
    for p in range(2):
        for d in range(r + m):
            exact[p, b, d] = motion[p, b, d]
    for c in range(r):
        if not free[c]:
            kick = motion[1, b, c] - smooth[1, b, c] - 0.5 * step * (past[0, b, c] + motion[2, b, c])
            smooth[1, b, c] = motion[1, b, c]
            for k in range(m):
                vibration[b, 1, k] -= held.drag[b, c, k] * kick
            continue
        s[0] = motion[2, b, c]
        for p in range(N_VALUES - 1):
            s[1 + p] = past[p, b, c]
        for d in range(m):
            s[0] += held.follow[b, c, d] * motion[2, b, r + d]
            for p in range(N_VALUES - 1):
                s[1 + p] += held.follow[b, c, d] * past[p, b, r + d]
        rate = smooth[1, b, c]
        if share > 1.0:
            for p in range(N_VALUES):
                smooth[1, b, c] += step * weights[p] * s[p]
        else:
            smooth[1, b, c] += step * _over_edge(s, share, n_done)
        smooth[0, b, c] += 0.5 * step * (rate + smooth[1, b, c]) + step * step / 12.0 * (s[1] - s[0])
        for p in range(2):
            exact[p, b, c] = smooth[p, b, c]
            for d in range(m):
                exact[p, b, c] -= held.follow[b, c, d] * motion[p, b, r + d]
    _in_modes(motion, b, r, held.columns, now)
    _oscillate(now, b, held, modal, vibration)
    for d in range(r + m):
        for p in range(N_VALUES - 2, 0, -1):
            past[p, b, d] = past[p - 1, b, d]
        past[0, b, d] = motion[2, b, d]
    # displacement, velocity and acceleration of the free vibrations that are missing; `now` is done with
    for k in range(m):
        now[0, k], now[1, k] = vibration[b, 0, k], vibration[b, 1, k]
        now[2, k] = -held.squares[b, k] * vibration[b, 0, k] - held.decays[b, k] * vibration[b, 1, k]
    for p in range(3):
        for c in range(r):
            missing[p, b, c] = 0.0
        for d in range(m):
            lack = 0.0
            for k in range(m):
                lack += held.shapes[b, d, k] * now[p, k]
            missing[p, b, r + d] = lack
            for c in range(r):
                missing[p, b, c] -= held.follow[b, c, d] * lack


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _over_edge(s, share, n_done):
    """Return the mean over a step of what bends at an edge, from values at its end, its beginning and before."""
    there = s[1] + (share * (s[1] - s[2]) if n_done > 0 else 0.0)
    return 0.5 * (share * (s[1] + there) + (1.0 - share) * (there + s[0]))


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _in_modes(motion, b, r, columns, now):
    """Fill displacements, velocities and accelerations of a sample's modes, (3, m)."""
    for p in range(3):
        for k in range(columns.shape[1]):
            now[p, k] = 0.0
        for d in range(columns.shape[1]):
            for k in range(columns.shape[1]):
                now[p, k] += columns[b, d, k] * motion[p, b, r + d]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _oscillate(now, b, held, modal, vibration):
    """Advance the vibrations of a sample; `now` holds displacements, velocities, accelerations at the end, (3, m)."""
    of = held.oscillators
    for k in range(held.squares.shape[1]):
        force = now[2, k] + held.decays[b, k] * now[1, k] + held.squares[b, k] * now[0, k]
        constant, rise = modal[b, 2, k], force - modal[b, 2, k]
        # a free vibration of the error and of the motion, from the same instant
        x, y = vibration[b, 0, k] + modal[b, 0, k], vibration[b, 1, k] + modal[b, 1, k]
        vibration[b, 0, k] = of[b, 0, k] * x + of[b, 1, k] * y + of[b, 4, k] * constant + of[b, 5, k] * rise - now[0, k]
        vibration[b, 1, k] = of[b, 2, k] * x + of[b, 3, k] * y + of[b, 6, k] * constant + of[b, 7, k] * rise - now[1, k]
        modal[b, 0, k], modal[b, 1, k], modal[b, 2, k] = now[0, k], now[1, k], force


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _take_other(motion, b, others, number, held, now, modal, vibration, smooth):
    """Let a sample go on with other modes from a state (3, n, r + m); what vibrates is expressed in them."""
    r, m = held.follow.shape[1], held.squares.shape[1]
    for p in range(2):
        # coordinates and their rates are what they are; the sums that do not vibrate are others
        for c in range(r):
            for d in range(m):
                change = others.follow[number, c, d] - held.follow[b, c, d]
                smooth[p, b, c] += change * motion[p, b, r + d]
        for k in range(m):
            now[p, k] = 0.0
        for d in range(m):
            moved = 0.0
            for k in range(m):
                moved += held.shapes[b, d, k] * vibration[b, p, k]
            for k in range(m):
                now[p, k] += others.columns[number, d, k] * moved
        for k in range(m):
            vibration[b, p, k] = now[p, k]
    for k in range(m):
        held.squares[b, k], held.decays[b, k] = others.squares[number, k], others.decays[number, k]
        for d in range(m):
            held.columns[b, d, k], held.shapes[b, d, k] = others.columns[number, d, k], others.shapes[number, d, k]
        for c in range(r):
            held.follow[b, c, k], held.drag[b, c, k] = others.follow[number, c, k], others.drag[number, c, k]
        for i in range(held.oscillators.shape[1]):
            held.oscillators[b, i, k] = others.oscillators[number, i, k]
    _in_modes(motion, b, r, held.columns, now)
    for k in range(m):
        modal[b, 0, k], modal[b, 1, k] = now[0, k], now[1, k]
        modal[b, 2, k] = now[2, k] + held.squares[b, k] * now[0, k] + held.decays[b, k] * now[1, k]


def oscillators(omega: np.ndarray, decay: np.ndarray, step: float) -> np.ndarray:
    """Return what an oscillator does over a step, shape (n, 8, m), for omega and z of shape (n, m).

    R by rows; then displacements from a constant force and from its rise, velocities from both.
    """
    turning = np.sqrt((omega**2 - decay**2).astype(complex))
    ahead, back = (np.exp((-decay + sign * turning) * step) for sign in (1j, -1j))
    cos, apart = np.real(0.5 * (ahead + back)), np.abs(turning * step) > 1e-6
    sin = np.where(apart, np.real((ahead - back) / (2j * np.where(apart, turning, 1.0))), step * np.exp(-decay * step))
    swing = cos + decay * sin
    constant = (1.0 - swing) / omega**2
    rise = (1.0 - 2.0 * decay / step * constant - sin / step) / omega**2
    return np.stack([swing, sin, -(omega**2) * sin, cos - decay * sin, constant, rise, sin, constant / step], axis=1)


class StepError:
    """Errors of the time step of n samples, from the start of a run on.

    Parameters
    ----------
    step
        s.
    start
        Reduced coordinates, velocities and accelerations at the start, shape (3, n, n_eta).
    modes
        Modes to begin with.
    driven
        Numbers of the prescribed coordinates.
    """

    def __init__(self, step: float, start: np.ndarray, modes: Modes, driven: tuple[int, ...] = ()) -> None:
        (n, m), r = modes.omega.shape, modes.follow.shape[1]
        self._free = ~np.isin(np.arange(r), driven)
        self._step, self._since = step, np.zeros(n, dtype=np.int64)
        self._motion = start[None].copy()
        self._past = np.zeros((N_VALUES - 1, n, r + m))
        self._past[0] = start[2]
        self._held = Held.none(n, r, m)
        self._vibration, self._modal = np.zeros((n, 2, m)), np.empty((n, 3, m))
        self._smooth = start[:2, :, :r].copy()
        self.hold(np.arange(n), modes)

    def hold(self, samples: np.ndarray, modes: Modes) -> None:
        """Go on from here with other modes of some samples, given by their numbers."""
        turns = Turns(np.zeros(samples.size, dtype=np.int64), samples, modes)
        self.advance(self._motion[1:], np.empty((0, self._since.size)), turns)

    def advance(
        self, motion: np.ndarray, shares: np.ndarray, turns: Turns | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Take in the next steps.

        Parameters
        ----------
        motion
            Coordinates, velocities and accelerations at the end of each, shape (n_steps, 3, n, n_eta).
        shares
            Of each step, before an edge of a law, shape (n_steps, n); see `EdgeCrossings.over`.
        turns
            Other modes to go on with on the way.

        Returns
        -------
        exact : ndarray, shape (n_steps, 2, n, n_eta)
            Coordinates and velocities with the coordinates that follow from the accelerations.
        missing : ndarray, shape (n_steps, 3, n, n_eta)
            What the vibrations lack, in reduced coordinates, and its first and second rates.
        """
        exact, missing = np.empty_like(motion[:, :2]), np.empty_like(motion)
        if turns is None:
            nothing = np.zeros(0, dtype=np.int64)
            coming = nothing, nothing, Held.none(0, *self._held.follow.shape[1:])
        else:
            coming = turns.places, turns.samples, Held.of(turns.modes, self._step)
        states = np.concatenate([self._motion, motion])
        advance(
            self._step, self._since, states, self._past, self._held, coming, self._modal, self._vibration,
            self._smooth, self._free, shares, exact, missing,
        )  # fmt: skip
        self._motion = states[-1:].copy()
        return exact, missing
