"""Reduced models of candidates: the latest stay in memory, as many as fit; an earlier one is built again when it is
wanted. Few are: errors and histories are kept with the trials themselves, and are small."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene.numerics import Reduction

#: Of all models on the shelf together; tables of second order grow with the third power of the flexible coordinates.
MOST_BYTES = 2**29


class Shelf:
    """Models by their reduction. The same on all ranks, which put and take the same models in the same order.

    Parameters
    ----------
    build
        Builds a model; collective.
    most_bytes
        That all models may have together; the latest one stays, however large.
    """

    def __init__(self, build: Callable[[Reduction], ReducedOrderModel], most_bytes: int = MOST_BYTES) -> None:
        self._build, self._most = build, most_bytes
        self._models: dict[str, tuple[ReducedOrderModel, int]] = {}

    def put(self, reduction: Reduction, rom: ReducedOrderModel) -> None:
        """Keep a model, and let the oldest ones go."""
        self._models[_key(reduction)] = rom, bytes_of(rom)
        while len(self._models) > 1 and sum(size for _, size in self._models.values()) > self._most:
            del self._models[next(iter(self._models))]

    def take(self, reduction: Reduction) -> ReducedOrderModel:
        """Return a model that was put here before. Collective where it has to be built again."""
        kept = self._models.pop(_key(reduction), None)
        rom = self._build(reduction) if kept is None else kept[0]
        self.put(reduction, rom)
        return rom


def bytes_of(item: object) -> int:
    """Return the bytes of all arrays in dataclasses, mappings and sequences within an object."""
    if isinstance(item, np.ndarray):
        return item.nbytes
    if isinstance(item, Mapping):
        return sum(map(bytes_of, item.values()))
    if isinstance(item, (tuple, list)):
        return sum(map(bytes_of, item))
    return sum(map(bytes_of, vars(item).values())) if hasattr(item, "__dict__") else 0


def _key(reduction: Reduction) -> str:
    return reduction.model_dump_json()
