"""What the time step does to a reduced motion, followed step by step while it runs.

**Vibrations.** In the mode k of `flexible_modes`, with amplitude x and the force ``f = x'' + omega^2 x`` that the motion
itself says acts on it, one step of an exact oscillator under a force that is linear over the step would lead from
``(x, x')_n`` to ``(x~, x~')_{n+1}``. What the integrator's own step differs by is its local error; it travels on as a
free vibration (Hairer, Norsett and Wanner 1993, section II.3)::

    E_{n+1} = R(omega h) E_n + (x~ - x, x~' - x')_{n+1},     R = [[cos, sin / omega], [-omega sin, cos]]

However coarse the step is for a frequency, the sum x + E is what it should be, up to the phase. The modes of a sample
are held for a while, until it has turned a little, and then taken anew (`hold`).

**Rigid motion.** ``s = theta + follow.delta`` does not vibrate, so its accelerations at the steps, which fulfil the
equations of motion, determine it: integrated twice with fourth order from the exact start, they give the angle
``s - follow.delta`` that a scheme without an error of the step would have reached with these accelerations. It is no
solution yet, because the accelerations belong to the integrator's angles; `residual_error` corrects for that.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pgmp_petsc.indicator.flexible_modes import Modes
from pgmp_petsc.indicator.quadrature import N_VALUES, WEIGHTS

SOFTEST = 1e-3  # of omega h: below, a mode is taken for this stiff, and nothing is divided by zero


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def advance(step, weights, motion, past, modes, oscillator, modal, vibration, smooth):
    """Advance the errors of all samples over one step, in place.

    Parameters
    ----------
    step
        s.
    weights
        Of the accelerations now and before, shape (4,); see `quadrature`.
    motion
        ``(q, v, a)`` at the end of the step, each (n, 1 + m).
    past
        Accelerations at its beginning and before, shape (3, n, 1 + m); moved on.
    modes
        ``(squares, columns, follow)``: omega^2 of shape (n, m), the inverse of the shapes by its columns, (n, m, m), and
        ``follow``, (n, m).
    oscillator
        Of every mode over the step, shape (n, 7, m); see `oscillators`.
    modal
        Displacement, velocity and force of the modes at the beginning, shape (n, 3, m); moved on.
    vibration
        E, displacement and velocity, shape (n, 2, m).
    smooth
        s and its rate, shape (2, n).
    """
    q, v, a = motion
    squares, columns, follow = modes
    n, m = squares.shape
    s = np.empty(weights.size)
    now = np.empty((3, m))
    for b in range(n):
        s[0] = a[b, 0]
        for r in range(past.shape[0]):
            s[1 + r] = past[r, b, 0]
        now[:] = 0.0
        for d in range(m):
            q_d, v_d, a_d = q[b, 1 + d], v[b, 1 + d], a[b, 1 + d]
            s[0] += follow[b, d] * a_d
            for r in range(past.shape[0]):
                s[1 + r] += follow[b, d] * past[r, b, 1 + d]
            for k in range(m):
                now[0, k] += columns[b, d, k] * q_d
                now[1, k] += columns[b, d, k] * v_d
                now[2, k] += columns[b, d, k] * a_d
        rate = smooth[1, b]
        for r in range(weights.size):
            smooth[1, b] += step * weights[r] * s[r]
        smooth[0, b] += 0.5 * step * (rate + smooth[1, b]) + step * step / 12.0 * (s[1] - s[0])
        x, y, of = vibration[b], modal[b], oscillator[b]
        for k in range(m):
            force = now[2, k] + squares[b, k] * now[0, k]
            rise = force - y[2, k]
            # a free vibration of the error and of the motion, from the same instant
            moved, rate_moved = x[0, k] + y[0, k], x[1, k] + y[1, k]
            x[0, k] = of[0, k] * moved + of[1, k] * rate_moved + of[3, k] * y[2, k] + of[4, k] * rise - now[0, k]
            x[1, k] = of[2, k] * moved + of[0, k] * rate_moved + of[5, k] * y[2, k] + of[6, k] * rise - now[1, k]
            y[0, k], y[1, k], y[2, k] = now[0, k], now[1, k], force
        for d in range(m + 1):
            for r in range(past.shape[0] - 1, 0, -1):
                past[r, b, d] = past[r - 1, b, d]
            past[0, b, d] = a[b, d]


def oscillators(omega: np.ndarray, step: float) -> np.ndarray:
    """Return what an oscillator does over a step, shape (n, 7, m), for omega of shape (n, m).

    With ``c, s = cos, sin (omega h)``: c, s / omega, -omega s for its displacement and velocity; then displacements from a
    constant force and from its rise, velocities from both.
    """
    cos, sin = np.cos(omega * step), np.sin(omega * step)
    turned = omega * step
    return np.stack(
        [
            cos,
            sin / omega,
            -omega * sin,
            (1.0 - cos) / omega**2,
            (1.0 - sin / turned) / omega**2,
            sin / omega,
            (1.0 - cos) / (omega * turned),
        ],
        axis=1,
    )


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def describe(motion, shapes, follow, vibration, smooth, exact, missing):
    """Fill what a motion lacks; see `StepError.describe`.

    Parameters
    ----------
    motion
        ``(q, v)``, each (n, 1 + m).
    shapes, follow
        Of the modes, (n, m, m) and (n, m).
    vibration, smooth
        As `advance` leaves them.
    exact
        Result: coordinates and velocities, (2, n, 1 + m).
    missing
        Result: vibrations, (n, 1 + m).
    """
    n, m = follow.shape
    for b in range(n):
        missing[b, 0] = 0.0
        for p in range(2):
            exact[p, b, 0] = smooth[p, b]
            for d in range(m):
                exact[p, b, 0] -= follow[b, d] * motion[p][b, 1 + d]
                exact[p, b, 1 + d] = motion[p][b, 1 + d]
        for d in range(m):
            missing[b, 1 + d] = 0.0
            for k in range(m):
                missing[b, 1 + d] += shapes[b, d, k] * vibration[b, 0, k]
            missing[b, 0] -= follow[b, d] * missing[b, 1 + d]


class StepError:
    """Errors of the time step of n samples, from the start of a run on.

    Parameters
    ----------
    step
        s.
    q, v, a
        Reduced coordinates, velocities and accelerations at the start, shape (n, n_eta).
    modes
        Modes to begin with.
    """

    def __init__(self, step: float, q: np.ndarray, v: np.ndarray, a: np.ndarray, modes: Modes) -> None:
        n, m = modes.omega.shape
        self._step = step
        self._number = 0
        self._motion = (q, v, a)
        self._past = np.zeros((N_VALUES - 1, n, 1 + m))
        self._past[0] = a
        self._vibration = np.zeros((n, 2, m))
        self._shapes, self._follow = np.zeros((n, m, m)), np.zeros((n, m))
        self._squares, self._columns = np.empty((n, m)), np.empty((n, m, m))
        self._oscillators, self._modal = np.empty((n, 7, m)), np.empty((n, 3, m))
        self._smooth = np.array([q[:, 0], v[:, 0]])
        self.hold(np.arange(n), modes)

    def advance(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        """Take in the state at the end of the next step, each of shape (n, n_eta); it is kept."""
        self._motion = (q, v, a)
        weights = WEIGHTS[min(self._number, len(WEIGHTS) - 1)]
        modes = (self._squares, self._columns, self._follow)
        advance(
            self._step, weights, self._motion, self._past, modes, self._oscillators, self._modal, self._vibration,
            self._smooth,
        )
        self._number += 1

    def hold(self, samples: np.ndarray, modes: Modes) -> None:
        """Go on with other modes of some samples, given by their numbers; what vibrates is expressed in them."""
        q, v, a = (part[samples, 1:] for part in self._motion)
        moved = self._vibration[samples] @ np.swapaxes(self._shapes[samples], 1, 2)
        columns = np.swapaxes(modes.inverse, 1, 2)
        omega = np.maximum(modes.omega, SOFTEST / self._step)
        modal = np.stack([q, v, a], axis=1) @ columns
        modal[:, 2] += omega**2 * modal[:, 0]
        # the angle and its rate are what they are; the sum that does not vibrate is another one
        change = modes.follow - self._follow[samples]
        self._smooth[:, samples] += np.sum(change * np.array([q, v]), axis=2)
        self._vibration[samples] = moved @ columns
        self._modal[samples], self._columns[samples] = modal, columns
        self._shapes[samples], self._follow[samples] = modes.shapes, modes.follow
        self._squares[samples], self._oscillators[samples] = omega**2, oscillators(omega, self._step)

    def describe(self, exact: np.ndarray, missing: np.ndarray) -> None:
        """Fill what the motion should be.

        Parameters
        ----------
        exact
            Coordinates and velocities with the angle that follows from the accelerations, shape (2, n, n_eta).
        missing
            What the vibrations lack, in reduced coordinates, shape (n, n_eta).
        """
        describe(self._motion[:2], self._shapes, self._follow, self._vibration, self._smooth, exact, missing)
