"""Sobol indices of an output: which parameters its variance comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from pgmp_petsc.results.layout import check_shape
from pgmp_petsc.runtime.files import put, take

if TYPE_CHECKING:
    import h5py


@dataclass(frozen=True)
class Sensitivity:
    """First and total Sobol indices with their intervals; total ones only where samples were drawn for them.

    Parameters
    ----------
    parameters : tuple of str
        Names, in the order of the arrays.
    method : {"saltelli", "given data"}
    count : int
        Number of blocks, or of samples, that they are estimated from.
    confidence : float
        Level of the intervals.
    first, total : ndarray, shape (d,)
        ``S1`` and ``ST``; the latter None where it is not known.
    first_interval, total_interval : ndarray, shape (d, 2)
    """

    parameters: tuple[str, ...]
    method: str
    count: int
    confidence: float
    first: np.ndarray
    first_interval: np.ndarray
    total: np.ndarray | None = None
    total_interval: np.ndarray | None = None

    def __post_init__(self) -> None:
        d = len(self.parameters)
        check_shape("first", self.first, (d,))
        check_shape("first_interval", self.first_interval, (d, 2))
        if self.total is not None:
            check_shape("total", self.total, (d,))
            check_shape("total_interval", self.total_interval, (d, 2))

    def write(self, group: h5py.Group, name: str) -> None:
        """Write them into a group of their own."""
        group.attrs["parameters"] = list(self.parameters)
        group.attrs["method"] = self.method
        group.attrs["confidence"] = self.confidence
        put(group, "count", self.count, "1", "number of blocks, or of samples, that these are estimated from")
        put(group, "S1", self.first, "1", f"first Sobol indices of '{name}', in the order of attribute parameters")
        put(group, "S1_interval", self.first_interval, "1", f"{100 * self.confidence:g} % confidence intervals of S1")
        if self.total is not None:
            put(group, "ST", self.total, "1", f"total Sobol indices of '{name}', in the order of attribute parameters")
            about = f"{100 * self.confidence:g} % confidence intervals of ST"
            put(group, "ST_interval", self.total_interval, "1", about)

    @classmethod
    def read(cls, group: h5py.Group) -> Self:
        """Read what `write` wrote."""
        has_total = "ST" in group
        return cls(
            parameters=tuple(str(name) for name in group.attrs["parameters"]),
            method=str(group.attrs["method"]),
            count=int(take(group, "count", 0)),
            confidence=float(group.attrs["confidence"]),
            first=take(group, "S1", 1),
            first_interval=take(group, "S1_interval", 2),
            total=take(group, "ST", 1) if has_total else None,
            total_interval=take(group, "ST_interval", 2) if has_total else None,
        )
