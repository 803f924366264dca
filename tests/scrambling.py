"""Modes as another solver might return them: in another order, with other signs, turned where frequencies agree."""

from dataclasses import replace

import numpy as np
import scipy.linalg

from pgmp_petsc.modes.problem import ModeSet


def _random_of(seed: int, modes: ModeSet) -> np.random.Generator:
    """Return a generator that is the same on all ranks, and another one at every configuration."""
    return np.random.default_rng([seed, int(1e6 * modes.theta[0])])


def scrambled(seed: int, modes: ModeSet) -> ModeSet:
    """Return the modes in random order with random signs."""
    random = _random_of(seed, modes)
    order = random.permutation(modes.eigenvalues.size)
    signs = random.choice([-1.0, 1.0], order.size)
    return replace(modes, eigenvalues=modes.eigenvalues[order], flexible=modes.flexible[:, order] * signs)


def clusters(eigenvalues: np.ndarray, apart: float) -> list[np.ndarray]:
    """Return the numbers of the modes whose eigenvalues are not apart by such a share."""
    return np.split(np.arange(eigenvalues.size), np.flatnonzero(np.diff(eigenvalues) > apart * eigenvalues[1:]) + 1)


def turned(seed: int, modes: ModeSet, apart: float) -> ModeSet:
    """Return the modes with random rotations and reflections inside the clusters."""
    random = _random_of(seed, modes)
    turns = [np.linalg.qr(random.normal(size=(c.size, c.size)))[0] for c in clusters(modes.eigenvalues, apart)]
    return replace(modes, flexible=modes.flexible @ scipy.linalg.block_diag(*turns))
