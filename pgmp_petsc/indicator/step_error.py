"""What the time step does to a reduced motion, followed step by step while it runs.

**Vibrations.** In the mode k of `flexible_modes`, with amplitude x and the force ``f = x'' + 2 z x' + omega^2 x`` that
the motion itself says acts on it, one step of an exact oscillator under a force that is linear over the step would lead
from ``(x, x')_n`` to ``(x~, x~')_{n+1}``. What the integrator's own step differs by is its local error; it travels on
as a free vibration (Hairer, Norsett and Wanner 1993, section II.3)::

    E_{n+1} = R E_n + (x~ - x, x~' - x')_{n+1},     R = [[C + z S, S], [-omega^2 S, C - z S]]
    C = exp(-z h) cos(omega_d h),     S = exp(-z h) sin(omega_d h) / omega_d,     omega_d^2 = omega^2 - z^2

However coarse the step is for a frequency, the sum x + E is what it should be, up to the phase. The modes of a sample
are held for a while, until it has turned a little, and then taken anew (`hold`).

**Rigid motion.** ``s = theta + follow.delta`` does not vibrate, so its accelerations at the steps, which fulfil the
equations of motion, determine it: integrated twice with fourth order from the exact start, they give the coordinates
``s - follow.delta`` that a scheme without an error of the step would have reached with these accelerations. It is no
solution yet, because the accelerations belong to the integrator's coordinates; `residual_error` corrects for that.
Prescribed coordinates are what they are.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.indicator.flexible_modes import Modes
from pgmp_petsc.indicator.quadrature import N_VALUES, WEIGHTS
from pgmp_petsc.runtime.compiled import njit

SOFTEST = 1e-3  # of omega h: below, a mode is taken for this stiff, and nothing is divided by zero


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def advance(step, first, motion, past, modes, oscillator, modal, vibration, smooth, free, exact, missing):
    """Advance the errors of all samples over some steps, in place, and say what the motion should be after each.

    Parameters
    ----------
    step
        s.
    first
        Number of steps done before.
    motion
        Coordinates, velocities and accelerations at the end of every step, shape (n_steps, 3, n, r + m).
    past
        Accelerations at the beginning and before, shape (3, n, r + m); moved on.
    modes
        ``(squares, decays, columns, shapes, follow)``: omega^2 and 2 z of shape (n, m), the inverse of the shapes by
        its columns and the shapes, (n, m, m), and ``follow``, (n, r, m).
    oscillator
        Of every mode over the step, shape (n, 8, m); see `oscillators`.
    modal
        Displacement, velocity and force of the modes at the beginning, shape (n, 3, m); moved on.
    vibration
        E, displacement and velocity, shape (n, 2, m).
    smooth
        s and its rate, shape (2, n, r).
    free
        Whether each rigid coordinate is free, shape (r,).
    exact, missing
        Results; see `StepError.advance`.
    """
    squares, decays, columns, shapes, follow = modes
    n, m = squares.shape
    s = np.empty(N_VALUES)
    now = np.empty((3, m))
    for number in range(motion.shape[0]):
        weights = WEIGHTS[min(first + number, WEIGHTS.shape[0] - 1)]
        for b in range(n):
            exact[number, 0, b], exact[number, 1, b] = motion[number, 0, b], motion[number, 1, b]
            for c in range(free.size):
                if not free[c]:
                    continue
                s[0] = motion[number, 2, b, c]
                for p in range(N_VALUES - 1):
                    s[1 + p] = past[p, b, c]
                for d in range(m):
                    s[0] += follow[b, c, d] * motion[number, 2, b, free.size + d]
                    for p in range(N_VALUES - 1):
                        s[1 + p] += follow[b, c, d] * past[p, b, free.size + d]
                rate = smooth[1, b, c]
                for p in range(N_VALUES):
                    smooth[1, b, c] += step * weights[p] * s[p]
                smooth[0, b, c] += 0.5 * step * (rate + smooth[1, b, c]) + step * step / 12.0 * (s[1] - s[0])
                for p in range(2):
                    exact[number, p, b, c] = smooth[p, b, c]
                    for d in range(m):
                        exact[number, p, b, c] -= follow[b, c, d] * motion[number, p, b, free.size + d]
            now[:] = 0.0
            for d in range(m):
                for p in range(3):
                    value = motion[number, p, b, free.size + d]
                    for k in range(m):
                        now[p, k] += columns[b, d, k] * value
            oscillate(now, squares[b], decays[b], oscillator[b], modal[b], vibration[b])
            for p in range(N_VALUES - 2, 0, -1):
                past[p, b] = past[p - 1, b]
            past[0, b] = motion[number, 2, b]
            missing[number, b, : free.size] = 0.0
            for d in range(m):
                lack = 0.0
                for k in range(m):
                    lack += shapes[b, d, k] * vibration[b, 0, k]
                missing[number, b, free.size + d] = lack
                for c in range(free.size):
                    missing[number, b, c] -= follow[b, c, d] * lack


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def oscillate(now, squares, decays, oscillator, modal, vibration):
    """Advance the vibrations of one sample; `now` holds displacements, velocities, accelerations at the end, (3, m)."""
    of = oscillator
    for k in range(squares.size):
        force = now[2, k] + decays[k] * now[1, k] + squares[k] * now[0, k]
        constant, rise = modal[2, k], force - modal[2, k]
        # a free vibration of the error and of the motion, from the same instant
        x, y = vibration[0, k] + modal[0, k], vibration[1, k] + modal[1, k]
        vibration[0, k] = of[0, k] * x + of[1, k] * y + of[4, k] * constant + of[5, k] * rise - now[0, k]
        vibration[1, k] = of[2, k] * x + of[3, k] * y + of[6, k] * constant + of[7, k] * rise - now[1, k]
        modal[0, k], modal[1, k], modal[2, k] = now[0, k], now[1, k], force


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
        self._step = step
        self._number = 0
        self._motion = start
        self._past = np.zeros((N_VALUES - 1, n, r + m))
        self._past[0] = start[2]
        self._vibration = np.zeros((n, 2, m))
        self._shapes, self._follow = np.zeros((n, m, m)), np.zeros((n, r, m))
        self._squares, self._decays, self._columns = np.empty((n, m)), np.empty((n, m)), np.empty((n, m, m))
        self._oscillators, self._modal = np.empty((n, 8, m)), np.empty((n, 3, m))
        self._smooth = start[:2, :, :r].copy()
        self.hold(np.arange(n), modes)

    def advance(self, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take in the next steps.

        Parameters
        ----------
        motion
            Coordinates, velocities and accelerations at the end of each, shape (n_steps, 3, n, n_eta).

        Returns
        -------
        exact : ndarray, shape (n_steps, 2, n, n_eta)
            Coordinates and velocities with the coordinates that follow from the accelerations.
        missing : ndarray, shape (n_steps, n, n_eta)
            What the vibrations lack, in reduced coordinates.
        """
        exact, missing = np.empty_like(motion[:, :2]), np.empty_like(motion[:, 0])
        modes = (self._squares, self._decays, self._columns, self._shapes, self._follow)
        advance(
            self._step,
            self._number,
            motion,
            self._past,
            modes,
            self._oscillators,
            self._modal,
            self._vibration,
            self._smooth,
            self._free,
            exact,
            missing,
        )
        self._number += len(motion)
        self._motion = motion[-1].copy()
        return exact, missing

    def hold(self, samples: np.ndarray, modes: Modes) -> None:
        """Go on with other modes of some samples, given by their numbers; what vibrates is expressed in them."""
        flexible = self._motion[:, samples, self._free.size :]
        moved = self._vibration[samples] @ np.swapaxes(self._shapes[samples], 1, 2)
        columns = np.swapaxes(modes.inverse, 1, 2)
        omega = np.maximum(modes.omega, SOFTEST / self._step)
        modal = np.swapaxes(flexible, 0, 1) @ columns
        modal[:, 2] += omega**2 * modal[:, 0] + 2.0 * modes.decay * modal[:, 1]
        # coordinates and their rates are what they are; the sums that do not vibrate are others
        change = modes.follow - self._follow[samples]
        self._smooth[:, samples] += np.einsum("ncd,pnd->pnc", change, flexible[:2])
        self._vibration[samples] = moved @ columns
        self._modal[samples], self._columns[samples] = modal, columns
        self._shapes[samples], self._follow[samples] = modes.shapes, modes.follow
        self._squares[samples], self._decays[samples] = omega**2, 2.0 * modes.decay
        self._oscillators[samples] = oscillators(omega, modes.decay, self._step)
