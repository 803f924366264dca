"""Forward sensitivities through the steps of the generalised-alpha scheme (`dynamics.generalised_alpha`); compiled.

The scheme is differentiated as it stands. With S_q, S_v, S_a, S_A the derivatives of coordinates, velocities,
accelerations and auxiliary accelerations with a parameter, hats for their prediction with ``S_a_hat = S_a`` of the
step's beginning, and the step's own matrix,

    (by_q + gain_v by_v + gain_a by_a) x = - (by_p + by_q S_q_hat + by_v S_v_hat + by_a S_a_hat),
    S_q = S_q_hat + x,     S_v = S_v_hat + gain_v x,     S_a = S_a_hat + gain_a x.

One factorisation serves all parameters. Prescribed coordinates do not depend on any.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.gradients.elimination import factorise, hold, substitute
from pgmp_petsc.runtime.compiled import njit


@njit(cache=True, entry=True, error_model="numpy", fastmath={"contract"})
def propagate(by_q, by_v, by_a, by_parameters, scheme, step, prescribed, moment, result):
    """Take the sensitivities through steps.

    Parameters
    ----------
    by_q, by_v, by_a, by_parameters
        At the ends of the steps, see `linearisation.Linearised`.
    scheme
        ``(alpha_m, alpha_f, beta, gamma, gain_v, gain_a)`` of the step.
    step
        s.
    prescribed
        Whether a coordinate's motion is given, shape (n_theta,).
    moment
        S_q, S_v, S_a and S_A at the beginning, shape (4, n_parameters, n_eta); advanced in place.
    result
        S_q at the ends of the steps, shape (n_t, n_parameters, n_eta).
    """
    alpha_m, alpha_f, beta, gamma, gain_v, gain_a = scheme
    n_t, n_parameters, n = by_parameters.shape
    matrix, order = np.empty((n, n)), np.empty(n, dtype=np.int64)
    q, v, a, right = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    weight = 1.0 / (1.0 - alpha_m)
    for t in range(n_t):
        for i in range(n):
            for j in range(n):
                matrix[i, j] = by_q[t, i, j] + gain_v * by_v[t, i, j] + gain_a * by_a[t, i, j]
        hold(prescribed, matrix, right)
        factorise(matrix, order)
        for p in range(n_parameters):
            for i in range(n):
                before, rate, now, auxiliary = moment[0, p, i], moment[1, p, i], moment[2, p, i], moment[3, p, i]
                ahead = (now - alpha_m * auxiliary) * weight
                q[i] = before + step * rate + step * step * ((0.5 - beta) * auxiliary + beta * ahead)
                v[i], a[i] = rate + step * ((1.0 - gamma) * auxiliary + gamma * ahead), now
            for k in range(prescribed.size):
                if prescribed[k]:
                    q[k] = v[k] = a[k] = 0.0
            for i in range(n):
                right[i] = -by_parameters[t, p, i]
                for j in range(n):
                    right[i] -= by_q[t, i, j] * q[j] + by_v[t, i, j] * v[j] + by_a[t, i, j] * a[j]
            for k in range(prescribed.size):
                if prescribed[k]:
                    right[k] = 0.0
            substitute(matrix, order, right)
            for i in range(n):
                then, now, auxiliary = a[i] + gain_a * right[i], moment[2, p, i], moment[3, p, i]
                moment[0, p, i], moment[1, p, i], moment[2, p, i] = q[i] + right[i], v[i] + gain_v * right[i], then
                moment[3, p, i] = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * auxiliary) * weight
                result[t, p, i] = moment[0, p, i]
