"""Effects a scene may call for; one that it does not name is not assembled, stored or evaluated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.gravity import Gravity
from pgmp_petsc.effects.load import Effect, Load
from pgmp_petsc.effects.torque import Torque
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene.schema import Scene

_KINDS = {"torque": Torque, "gravity": Gravity}


def effects_of(scene: Scene, mechanism: Mechanism) -> tuple[Effect, ...]:
    """Return the effects that a scene names, in its order."""
    return tuple(_KINDS[entry.type](name, entry, mechanism) for name, entry in scene.effects.items())


def loads_of(effects: Sequence[Effect], matrices: AffineMatrices) -> tuple[Load, ...]:
    """Return the load terms of all effects, effect after effect."""
    return tuple(load for effect in effects for load in effect.loads(matrices))


def patterns_of(effects: Sequence[Effect], matrices: AffineMatrices) -> np.ndarray:
    """Return the load patterns of all effects in body frames, shape (n_rows, n_patterns)."""
    vectors = [vector for effect in effects for vector in effect.patterns(matrices)]
    return np.array(vectors).reshape(len(vectors), len(matrices.rows)).T


__all__ = ["Effect", "Load", "effects_of", "loads_of", "patterns_of"]
