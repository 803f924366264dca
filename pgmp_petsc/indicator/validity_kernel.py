"""What is looked at in every step of every sample, compiled: the largest elastic energy, and changes of stiffness."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.runtime.compiled import njit


@njit(cache=True, error_model="numpy")
def keep_most_deformed(places, q, stiffness, weights, states):
    """Fill states (n, n_eta) with those of the largest linear strain energy of every sample.

    `q` (n_steps n, n_eta) are states, all samples of a step together, with the flexible coordinates last; `places`
    (n_steps n) are the numbers of the sampled configurations next to them; `stiffness` (n_places, n_terms, n_delta,
    n_delta) and `weights` (n, n_terms) are its terms.
    """
    n_delta, n = stiffness.shape[2], weights.shape[0]
    r = q.shape[1] - n_delta
    energies = np.full(n, -1.0)
    for row in range(places.size):
        sample, total = row % n, 0.0
        for term in range(stiffness.shape[1]):
            part = 0.0
            for i in range(n_delta):
                half = 0.5 * stiffness[places[row], term, i, i] * q[row, r + i]
                for j in range(i):
                    half += stiffness[places[row], term, i, j] * q[row, r + j]
                part += half * q[row, r + i]
            total += weights[sample, term] * part
        if total > energies[sample]:
            energies[sample] = total
            states[sample] = q[row]


@njit(cache=True, error_model="numpy")
def keep_changes(places, influence, stiffness, weights, loading, gained, lost):
    """Replace the largest and the least share by which stiffness has changed, of samples where it is beyond now.

    See `StiffnessChanges` for `influence` (n_places, n_modes, n_columns) and `stiffness` (n_places, n_terms, n_modes);
    `weights` (n, n_terms), `loading` (n_steps n, n_columns) as the states above; `gained` (not negative) and `lost`
    (not positive), each (n), are NaN where nothing is known so far.
    """
    for row in range(places.size):
        place, sample = places[row], row % gained.size
        for mode in range(influence.shape[1]):
            force, own = 0.0, 0.0
            for column in range(influence.shape[2]):
                force += influence[place, mode, column] * loading[row, column]
            for term in range(stiffness.shape[1]):
                own += weights[sample, term] * stiffness[place, term, mode]
            share = force / own
            if np.isfinite(share):
                if not gained[sample] >= share:
                    gained[sample] = max(share, 0.0)
                if not lost[sample] <= share:
                    lost[sample] = min(share, 0.0)
