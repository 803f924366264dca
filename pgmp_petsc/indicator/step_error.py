"""What the time step does to a reduced motion, followed step by step while it runs.

**Vibrations.** In the mode k of `flexible_modes`, with amplitude x and the force ``f = x'' + omega^2 x`` that the
motion itself says acts on it, one step of an exact oscillator under a force that is linear over the step would lead
from ``(x, x')_n`` to ``(x~, x~')_{n+1}``. What the integrator's own step differs by is its local error; it travels on
as a free vibration (Hairer, Norsett and Wanner 1993, section II.3)::

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

from pgmp_petsc.indicator.flexible_modes import Modes
from pgmp_petsc.indicator.quadrature import N_VALUES, WEIGHTS
from pgmp_petsc.runtime.compiled import njit

SOFTEST = 1e-3  # of omega h: below, a mode is taken for this stiff, and nothing is divided by zero


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def advance(step, first, motion, past, modes, oscillator, modal, vibration, smooth, exact, missing):
    """Advance the errors of all samples over some steps, in place, and say what the motion should be after each.

    Parameters
    ----------
    step
        s.
    first
        Number of steps done before.
    motion
        Coordinates, velocities and accelerations at the end of every step, shape (n_steps, 3, n, 1 + m).
    past
        Accelerations at the beginning and before, shape (3, n, 1 + m); moved on.
    modes
        ``(squares, columns, shapes, follow)``: omega^2 of shape (n, m), the inverse of the shapes by its columns and
        the shapes, (n, m, m), and ``follow``, (n, m).
    oscillator
        Of every mode over the step, shape (n, 7, m); see `oscillators`.
    modal
        Displacement, velocity and force of the modes at the beginning, shape (n, 3, m); moved on.
    vibration
        E, displacement and velocity, shape (n, 2, m).
    smooth
        s and its rate, shape (2, n).
    exact, missing
        Results; see `StepError.advance`.
    """
    squares, columns, shapes, follow = modes
    n, m = squares.shape
    s = np.empty(N_VALUES)
    now = np.empty((3, m))
    for number in range(motion.shape[0]):
        weights = WEIGHTS[min(first + number, WEIGHTS.shape[0] - 1)]
        for b in range(n):
            s[0] = motion[number, 2, b, 0]
            for r in range(N_VALUES - 1):
                s[1 + r] = past[r, b, 0]
            now[:] = 0.0
            for d in range(m):
                s[0] += follow[b, d] * motion[number, 2, b, 1 + d]
                for r in range(N_VALUES - 1):
                    s[1 + r] += follow[b, d] * past[r, b, 1 + d]
                for p in range(3):
                    value = motion[number, p, b, 1 + d]
                    for k in range(m):
                        now[p, k] += columns[b, d, k] * value
            rate = smooth[1, b]
            for r in range(N_VALUES):
                smooth[1, b] += step * weights[r] * s[r]
            smooth[0, b] += 0.5 * step * (rate + smooth[1, b]) + step * step / 12.0 * (s[1] - s[0])
            oscillate(now, squares[b], oscillator[b], modal[b], vibration[b])
            for r in range(N_VALUES - 2, 0, -1):
                past[r, b] = past[r - 1, b]
            past[0, b] = motion[number, 2, b]
            missing[number, b, 0] = 0.0
            for d in range(m):
                lack = 0.0
                for k in range(m):
                    lack += shapes[b, d, k] * vibration[b, 0, k]
                missing[number, b, 1 + d] = lack
                missing[number, b, 0] -= follow[b, d] * lack
            for p in range(2):
                angle = smooth[p, b]
                for d in range(m):
                    angle -= follow[b, d] * motion[number, p, b, 1 + d]
                    exact[number, p, b, 1 + d] = motion[number, p, b, 1 + d]
                exact[number, p, b, 0] = angle


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def oscillate(now, squares, oscillator, modal, vibration):
    """Advance the vibrations of one sample; `now` holds displacements, velocities, accelerations at the end, (3, m)."""
    of = oscillator
    for k in range(squares.size):
        force = now[2, k] + squares[k] * now[0, k]
        constant, rise = modal[2, k], force - modal[2, k]
        # a free vibration of the error and of the motion, from the same instant
        x, y = vibration[0, k] + modal[0, k], vibration[1, k] + modal[1, k]
        vibration[0, k] = of[0, k] * x + of[1, k] * y + of[3, k] * constant + of[4, k] * rise - now[0, k]
        vibration[1, k] = of[2, k] * x + of[0, k] * y + of[5, k] * constant + of[6, k] * rise - now[1, k]
        modal[0, k], modal[1, k], modal[2, k] = now[0, k], now[1, k], force


def oscillators(omega: np.ndarray, step: float) -> np.ndarray:
    """Return what an oscillator does over a step, shape (n, 7, m), for omega of shape (n, m).

    With ``c, s = cos, sin (omega h)``: c, s / omega, -omega s for its displacement and velocity; then displacements
    from a constant force and from its rise, velocities from both.
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
    """

    def __init__(self, step: float, start: np.ndarray, modes: Modes) -> None:
        n, m = modes.omega.shape
        self._step = step
        self._number = 0
        self._motion = start
        self._past = np.zeros((N_VALUES - 1, n, 1 + m))
        self._past[0] = start[2]
        self._vibration = np.zeros((n, 2, m))
        self._shapes, self._follow = np.zeros((n, m, m)), np.zeros((n, m))
        self._squares, self._columns = np.empty((n, m)), np.empty((n, m, m))
        self._oscillators, self._modal = np.empty((n, 7, m)), np.empty((n, 3, m))
        self._smooth = start[:2, :, 0].copy()
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
            Coordinates and velocities with the angle that follows from the accelerations.
        missing : ndarray, shape (n_steps, n, n_eta)
            What the vibrations lack, in reduced coordinates.
        """
        exact, missing = np.empty_like(motion[:, :2]), np.empty_like(motion[:, 0])
        modes = (self._squares, self._columns, self._shapes, self._follow)
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
            exact,
            missing,
        )
        self._number += len(motion)
        self._motion = motion[-1].copy()
        return exact, missing

    def hold(self, samples: np.ndarray, modes: Modes) -> None:
        """Go on with other modes of some samples, given by their numbers; what vibrates is expressed in them."""
        flexible = self._motion[:, samples, 1:]
        moved = self._vibration[samples] @ np.swapaxes(self._shapes[samples], 1, 2)
        columns = np.swapaxes(modes.inverse, 1, 2)
        omega = np.maximum(modes.omega, SOFTEST / self._step)
        modal = np.swapaxes(flexible, 0, 1) @ columns
        modal[:, 2] += omega**2 * modal[:, 0]
        # the angle and its rate are what they are; the sum that does not vibrate is another one
        change = modes.follow - self._follow[samples]
        self._smooth[:, samples] += np.sum(change * flexible[:2], axis=2)
        self._vibration[samples] = moved @ columns
        self._modal[samples], self._columns[samples] = modal, columns
        self._shapes[samples], self._follow[samples] = modes.shapes, modes.follow
        self._squares[samples], self._oscillators[samples] = omega**2, oscillators(omega, self._step)
