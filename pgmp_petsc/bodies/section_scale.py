"""Uniform scaling of a slender body's cross-section about the x axis of its mesh.

A scale s takes the place X of the mesh to ``D X``, ``D = diag(1, s, s)`` (in the plane ``diag(1, s)`` with s times the
thickness). Derivatives across the axis are then 1/s of those on the mesh and volumes s^2, so that

    M = s^2 M_2,    K = s^2 K_2 + s K_1 + K_0,

where K_2, K_1 and K_0 hold the products of strains with none, one and two derivatives across the axis: exact terms of
the mapped energy, not a Taylor series.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pgmp_petsc.bodies.affine import Quantity


@dataclass(frozen=True)
class SectionScale:
    """A scale s of cross-sections.

    Attributes
    ----------
    factor
        s, of which the mesh has 1.
    """

    factor: Quantity
    #: of the condensed body's terms, whose coordinates scale too (`components.section_coordinates`)
    powers: ClassVar[Mapping[str, range]] = {"mass": range(2, 5), "stiffness": range(5)}

    def pairs(self, dimension: int) -> Iterator[tuple[Quantity, np.ndarray]]:
        """Yield each power of s in the stiffness, and which pairs of derivatives it belongs to, shape (d, d)."""
        across = np.arange(dimension) > 0
        count = across[:, None].astype(int) + across
        for n_across in range(3):
            yield self.factor ** (2 - n_across), count == n_across

    @property
    def area(self) -> Quantity:
        """Area over that of the mesh: the factor of the mass."""
        return self.factor**2

    def stretch(self, dimension: int, values: Mapping[str, float]) -> np.ndarray:
        """Return the diagonal of D, shape (d,)."""
        stretch = np.ones(dimension)
        stretch[1:] = self.factor.at(values)
        return stretch
