"""Parameter values of the trade-off study: where errors are measured, and where a response surface has its nodes.

Test values are quantiles of the distributions, spread over all of them by a Latin hypercube with a fixed seed; the
nodes lie elsewhere. Where bounds cut a distribution off, so do they here: an ensemble would not integrate a
sample beyond them.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.spanning_values import uncertain_names

N_TEST = 8  # both models take so few in one batch at little more than the price of one
TEST_RANGE = (0.01, 0.99)  # probabilities of the outermost test values
NODE_RANGE = (0.001, 0.999)
SEED = 1


def held_out(scene: Scene, n: int = N_TEST) -> dict[str, np.ndarray]:
    """Return n test values of every parameter, shape (n,); one, that of the scene, where nothing is uncertain.

    Every uncertain parameter takes n quantiles with probabilities at equal distances over `TEST_RANGE`, one: in
    order, several: in the random order of a Latin hypercube.
    """
    names = uncertain_names(scene)
    if not names:
        return at_values(scene, np.empty((1, 0)))
    centred = qmc.LatinHypercube(len(names), scramble=False, seed=SEED).random(n)
    if len(names) == 1:
        centred = np.sort(centred, axis=0)
    low, high = TEST_RANGE
    # the centres of n strata reach from 1/(2n) to 1 - 1/(2n)
    probabilities = 0.5 * (low + high) + (centred - 0.5) * (high - low) * n / max(n - 1, 1)
    return at_values(scene, quantiles(scene, probabilities))


def node_values(scene: Scene, n: int) -> np.ndarray:
    """Return n nodes of a response surface, shape (n, n_uncertain): equal distances, or Halton points in a box."""
    low, high = box(scene)
    if len(low) == 1:
        return np.linspace(low, high, n)
    return low + (high - low) * qmc.Halton(len(low), scramble=True, seed=SEED).random(n)


def box(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the box that nodes span, each of shape (n_uncertain,)."""
    n = len(uncertain_names(scene))
    low, high = (quantiles(scene, np.full((1, n), probability))[0] for probability in NODE_RANGE)
    return low, high


def at_values(scene: Scene, uncertain: np.ndarray) -> dict[str, np.ndarray]:
    """Return values of all parameters from those of the uncertain ones, shape (n, n_uncertain)."""
    values = {name: np.full(len(uncertain), value) for name, value in scene.values.items()}
    return values | dict(zip(uncertain_names(scene), uncertain.T))


def quantiles(scene: Scene, probabilities: np.ndarray) -> np.ndarray:
    """Return quantiles of the distributions, bounds applied, for probabilities of shape (n, n_uncertain)."""
    columns = []
    for name, column in zip(uncertain_names(scene), probabilities.T):
        parameter = scene.parameters[name]
        columns.append(parameter.quantiles(column, 0.0 if name in scene.parameters_not_negative else -np.inf))
    return np.column_stack(columns) if columns else np.empty((len(probabilities), 0))
