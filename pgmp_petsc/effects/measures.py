"""Scalar measures of two frames ``(x, y, phi)``, on which local effects act; compiled.

A measure gives a scalar ``s(a, b)``, its gradient g in the six frame unknowns and the derivative h of the gradient. A
law (`laws`) makes of s and its rate ``s' = g.(a', b')`` a generalised force F on it; the frames then feel ``F g``, and
the power is ``F s'`` in every model alike.

=============== ================================================================================================
``ROTATION``    ``phi_b - phi_a``
``SLIDE``       ``d(phi_a).(b - a)``: how far b is along a direction d that turns with a (fixed, where a is on the
                ground)
``DISTANCE``    ``|b - a|``; where the points meet it has no direction, and its gradient is taken as zero
``FOLLOWING``   no measure but a direction: ``g = d(phi_b)`` at b, for a force that turns with its body; s is 0
=============== ================================================================================================
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.runtime.compiled import njit

ROTATION, SLIDE, DISTANCE, FOLLOWING = range(4)
#: Frame unknowns (x_a, y_a, phi_a, x_b, y_b, phi_b) that each measure depends on.
COLUMNS = {
    ROTATION: (2, 5),
    SLIDE: (0, 1, 2, 3, 4),
    DISTANCE: (0, 1, 3, 4),
    FOLLOWING: (3, 4, 5),
}


@njit(cache=True, error_model="numpy")
def measure(kind, direction, z, gradient, hessian):
    """Evaluate a measure.

    Parameters
    ----------
    kind
        ``ROTATION``, ``SLIDE``, ``DISTANCE`` or ``FOLLOWING``.
    direction
        Unit vector (x, y) in the frame it turns with, where the kind has one, shape (2,).
    z
        Both frames, shape (6,): m, m, rad each.
    gradient, hessian
        Results: g, shape (6,), and ``dg_i/dz_j``, shape (6, 6); symmetric but for ``FOLLOWING``.

    Returns
    -------
    float
        s, rad or m.
    """
    gradient[:] = 0.0
    hessian[:] = 0.0
    if kind == ROTATION:
        gradient[2], gradient[5] = -1.0, 1.0
        return z[5] - z[2]
    x, y = z[3] - z[0], z[4] - z[1]
    if kind == DISTANCE:
        length = np.sqrt(x * x + y * y)
        if length == 0.0:
            return length
        ex, ey = x / length, y / length
        gradient[0], gradient[1], gradient[3], gradient[4] = -ex, -ey, ex, ey
        across = (ey * ey / length, -ex * ey / length, ex * ex / length)
        for i in range(2):
            for j in range(2):
                value = across[i + j]
                hessian[i, j] = hessian[3 + i, 3 + j] = value
                hessian[i, 3 + j] = hessian[3 + i, j] = -value
        return length
    angle = z[2] if kind == SLIDE else z[5]
    cos, sin = np.cos(angle), np.sin(angle)
    dx, dy = cos * direction[0] - sin * direction[1], sin * direction[0] + cos * direction[1]
    gradient[3], gradient[4] = dx, dy
    if kind == FOLLOWING:
        hessian[3, 5], hessian[4, 5] = -dy, dx
        return 0.0
    gradient[0], gradient[1] = -dx, -dy
    gradient[2] = dx * y - dy * x
    hessian[0, 2] = hessian[2, 0] = dy
    hessian[1, 2] = hessian[2, 1] = -dx
    hessian[3, 2] = hessian[2, 3] = -dy
    hessian[4, 2] = hessian[2, 4] = dx
    hessian[2, 2] = -(dx * x + dy * y)
    return dx * x + dy * y
