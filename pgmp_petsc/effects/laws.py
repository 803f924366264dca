"""Force laws ``F(t, s, s')`` on a scalar measure s of the motion; compiled.

====================== =============================================== ==============================================
law                    F                                               parameters
====================== =============================================== ==============================================
``SOURCE``             ``amplitude(t) scale``                          scale
``SPRING_DAMPER``      ``-k (s - rest) - c s'``                        k, c, rest
``FRICTION``           ``-limit tanh(s' / speed)``                     limit, speed
``STOP``               ``-side k depth (1 + c depth')``, where         k, c, place, side (1 upper, -1 lower)
                       ``depth = side (s - place) > 0``, never a pull
====================== =============================================== ==============================================

The stop's damping is that of Hunt and Crossley (1975): its force begins at zero, so that it is continuous at contact.

On a light node Newton's iteration jumps between both branches of friction: from either of them, where the force hardly
changes, it goes far beyond the other. The forces of a step, ``b``, and the inertia in it, ``A v``, meet friction where
``A v + F(v) = b``. For v > 0 this is concave: an iterate from zero on never goes too far. One that has crossed zero
from beyond the speed of the law is therefore taken up from zero (`about_zero`), as circuit simulators limit the voltage
at a junction (Nagel 1975, SPICE2, section 5.2), and what follows is monotonic.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.runtime.compiled import njit

SOURCE, SPRING_DAMPER, FRICTION, STOP = range(4)
N_PARAMETERS = 4


@njit(cache=True, error_model="numpy")
def depth(kind, p, s):
    """Return how deep a stop is entered (negative: how far it is), NaN for other laws."""
    return p[3] * (s - p[2]) if kind == STOP else np.nan


@njit(cache=True, error_model="numpy")
def law(kind, p, amplitude, s, rate):
    """Evaluate a law.

    Parameters
    ----------
    kind
        ``SOURCE``, ``SPRING_DAMPER``, ``FRICTION`` or ``STOP``.
    p
        Parameters as in the module's table, shape (N_PARAMETERS,).
    amplitude
        Of a source, now.
    s, rate
        Measure and its rate.

    Returns
    -------
    tuple of float
        F, ``-dF/ds``, ``-dF/ds'``, and of its elastic part ``F_e = -dV/ds`` the force and the potential energy V (J).
    """
    if kind == SOURCE:
        return amplitude * p[0], 0.0, 0.0, 0.0, 0.0
    if kind == SPRING_DAMPER:
        stretch = s - p[2]
        elastic = -p[0] * stretch
        return elastic - p[1] * rate, p[0], p[1], elastic, 0.5 * p[0] * stretch * stretch
    if kind == FRICTION:
        bent = np.tanh(rate / p[1])
        return -p[0] * bent, 0.0, p[0] * (1.0 - bent * bent) / p[1], 0.0, 0.0
    side, entered = p[3], depth(kind, p, s)
    if entered <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    braking = 1.0 + p[1] * side * rate
    elastic, stored = -side * p[0] * entered, 0.5 * p[0] * entered * entered
    if braking <= 0.0:
        return 0.0, 0.0, 0.0, elastic, stored
    return elastic * braking, p[0] * braking, p[0] * p[1] * entered, elastic, stored


@njit(cache=True, error_model="numpy")
def rubs(laws):
    """Return whether any of some laws is friction: how a step's iteration contracts says nothing of the next one."""
    for kind in laws:
        if kind == FRICTION:
            return True
    return False


@njit(cache=True, error_model="numpy")
def about_zero(kind, p, rate, about):
    """Return whether an iterate's friction is to be linearised about zero rather than about its own rate.

    Parameters
    ----------
    kind, p, rate
        As of `law`.
    about
        Rate about which the iterate before was linearised in the same step; NaN for the first one.
    """
    return kind == FRICTION and abs(about) > p[1] and about * rate < 0.0
