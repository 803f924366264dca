"""Rotations by a vector phi, compiled: ``exp(phi)``, and its change ``exp(phi) (spin x .)`` with phi.

exp(phi) = 1 + a P + b P^2,    spin = (1 - b P + c P^2) phi',    P = phi x,  t = |phi|,
a = sin(t) / t,    b = (1 - cos(t)) / t^2,    c = (t - sin(t)) / t^3

All take numbers or vectors (`lane_items`).
"""

from __future__ import annotations

from pgmp_petsc.runtime.compiled import njit
from pgmp_petsc.runtime.lane_items import beyond, select, sine_cosine, square_root

SMALL = 1e-2  # of t^2, below which the first terms of the series are exact to round-off


@njit(cache=True, error_model="numpy")
def factors_of(phi):
    """Return a, b and c of a vector phi (3,), rad."""
    square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    a = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))
    b = 0.5 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0 * (1.0 - square / 90.0))))
    c = (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0 * (1.0 - square / 110.0)))) / 6.0
    large, t = beyond(square, SMALL), square_root(square)
    sine, cosine = sine_cosine(t)
    return (
        select(large, sine / t, a),
        select(large, (1.0 - cosine) / square, b),
        select(large, (t - sine) / (t * square), c),
    )


@njit(cache=True, error_model="numpy")
def rotation_of(phi, factors, turn):
    """Fill the rotation (3, 3) of a vector phi (3,), rad, with `factors_of` it."""
    x, y, z = phi[0], phi[1], phi[2]
    a, b, _ = factors
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    turn[1, 0], turn[1, 1], turn[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    turn[2, 0], turn[2, 1], turn[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)


@njit(cache=True, error_model="numpy")
def spin_of(phi, factors, rate, spin):
    """Fill the spin (3,) in the turned frame for a rate (3,) of phi (3,), rad/s, with `factors_of` phi."""
    x, y, z = phi[0], phi[1], phi[2]
    _, b, c = factors
    # phi x phi', and phi x that
    e, f, g = y * rate[2] - z * rate[1], z * rate[0] - x * rate[2], x * rate[1] - y * rate[0]
    spin[0] = rate[0] - b * e + c * (y * g - z * f)
    spin[1] = rate[1] - b * f + c * (z * e - x * g)
    spin[2] = rate[2] - b * g + c * (x * f - y * e)
