"""What the time step does to a reduced motion, followed step by step while it runs.

**Vibrations.** In the mode k of `flexible_modes`, with amplitude x and the force ``f = x'' + omega^2 x`` that the motion
itself says acts on it, one step of an exact oscillator under a force that is linear over the step would lead from
``(x, x')_n`` to ``(x~, x~')_{n+1}``. What the integrator's own step differs by is its local error; it travels on as a
free vibration (Hairer, Norsett and Wanner 1993, section II.3)::

    E_{n+1} = R(omega h) E_n + (x~ - x, x~' - x')_{n+1},     R = [[cos, sin / omega], [-omega sin, cos]]

However coarse the step is for a frequency, the sum x + E is what it should be, up to the phase. Modes are held for a
while (`hold`) and then taken anew.

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


@njit(cache=True, error_model="numpy")
def advance(step, weights, motion, past, modes, trigonometric, modal, vibration, smooth):
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
        ``(omega, inverse, follow)``, shapes (n, m), (n, m, m), (n, m).
    trigonometric
        cos and sin of omega times the step, shape (2, n, m).
    modal
        Displacement, velocity and force of the modes at the beginning, shape (3, n, m); moved on.
    vibration
        E, displacement and velocity, shape (2, n, m).
    smooth
        s and its rate, shape (2, n).
    """
    q, v, a = motion
    omega, inverse, follow = modes
    n, m = omega.shape
    s = np.empty(weights.size)
    for b in range(n):
        s[0] = a[b, 0]
        for r in range(past.shape[0]):
            s[1 + r] = past[r, b, 0]
        for d in range(m):
            s[0] += follow[b, d] * a[b, 1 + d]
            for r in range(past.shape[0]):
                s[1 + r] += follow[b, d] * past[r, b, 1 + d]
        rate = smooth[1, b]
        for r in range(weights.size):
            smooth[1, b] += step * weights[r] * s[r]
        smooth[0, b] += 0.5 * step * (rate + smooth[1, b]) + step * step / 12.0 * (s[1] - s[0])
        for k in range(m):
            w, c, sine = omega[b, k], trigonometric[0, b, k], trigonometric[1, b, k]
            x_1, v_1, a_1 = 0.0, 0.0, 0.0
            for d in range(m):
                x_1 += inverse[b, k, d] * q[b, 1 + d]
                v_1 += inverse[b, k, d] * v[b, 1 + d]
                a_1 += inverse[b, k, d] * a[b, 1 + d]
            force = a_1 + w * w * x_1
            x_0, v_0, f_0 = modal[0, b, k], modal[1, b, k], modal[2, b, k]
            moved = x_0 * c + v_0 * sine / w + f_0 * (1.0 - c) / w**2
            moved += (force - f_0) * (1.0 - sine / (w * step)) / w**2
            rate = v_0 * c - x_0 * w * sine + f_0 * sine / w + (force - f_0) * (1.0 - c) / (w * w * step)
            e_0, e_1 = vibration[0, b, k], vibration[1, b, k]
            vibration[0, b, k] = e_0 * c + e_1 * sine / w + moved - x_1
            vibration[1, b, k] = e_1 * c - e_0 * w * sine + rate - v_1
            modal[0, b, k], modal[1, b, k], modal[2, b, k] = x_1, v_1, force
        for d in range(m + 1):
            for r in range(past.shape[0] - 1, 0, -1):
                past[r, b, d] = past[r - 1, b, d]
            past[0, b, d] = a[b, d]


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
        n, n_eta = q.shape
        self._step = step
        self._number = 0
        self._motion = tuple(np.array(part) for part in (q, v, a))
        self._past = np.zeros((N_VALUES - 1, n, n_eta))
        self._past[0] = a
        self._vibration = np.zeros((2, n, n_eta - 1))
        # the exact angle and its rate, of which the smooth sum is made whenever `follow` changes
        self._rigid = np.array([q[:, 0], v[:, 0]])
        self._take(modes)

    def advance(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        """Take in the state at the end of the next step, each of shape (n, n_eta)."""
        self._motion = tuple(np.array(part) for part in (q, v, a))
        weights = WEIGHTS[min(self._number, len(WEIGHTS) - 1)]
        modes = (self._modes.omega, self._modes.inverse, self._modes.follow)
        advance(
            self._step, weights, self._motion, self._past, modes, self._trigonometric, self._modal, self._vibration,
            self._smooth,
        )
        self._number += 1

    def hold(self, modes: Modes) -> None:
        """Go on with other modes; what vibrates is expressed in them."""
        self._rigid = self._angles()
        moved = np.einsum("ndk,pnk->pnd", self._modes.shapes, self._vibration)
        self._vibration = np.einsum("nkd,pnd->pnk", modes.inverse, moved)
        self._take(modes)

    def exact_steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates and velocities with the angle that follows from the accelerations, (n, n_eta) each."""
        q, v = self._motion[0].copy(), self._motion[1].copy()
        q[:, 0], v[:, 0] = self._angles()
        return q, v

    def vibration(self) -> np.ndarray:
        """Return what the vibrations lack, in reduced coordinates, shape (n, n_eta)."""
        delta = np.einsum("ndk,nk->nd", self._modes.shapes, self._vibration[0])
        theta = -np.einsum("nd,nd->n", self._modes.follow, delta)
        return np.hstack([theta[:, None], delta])

    def _angles(self) -> np.ndarray:
        """Return the angle that follows from the accelerations, and its rate, shape (2, n)."""
        return self._smooth - np.einsum("nd,pnd->pn", self._modes.follow, np.array(self._motion[:2])[..., 1:])

    def _take(self, modes: Modes) -> None:
        q, v, a = self._motion
        omega = np.maximum(modes.omega, SOFTEST / self._step)
        self._modes = Modes(omega, modes.shapes, modes.inverse, np.ascontiguousarray(modes.follow))
        self._trigonometric = np.array([np.cos(omega * self._step), np.sin(omega * self._step)])
        modal = np.einsum("nkd,pnd->pnk", modes.inverse, np.array([q, v, a])[..., 1:])
        modal[2] += omega**2 * modal[0]
        self._modal = modal
        self._smooth = self._rigid + np.einsum("nd,pnd->pn", modes.follow, np.array([q, v])[..., 1:])
