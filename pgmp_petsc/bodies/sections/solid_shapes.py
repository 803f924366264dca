"""Solid sections: circle and rectangle.

Circle of radius r: ``A = pi r^2``, ``I = pi r^4 / 4``, shear factor ``6 (1 + nu) / (7 + 6 nu)``; rectangle of
width b and height h (h in the plane of motion): ``A = b h``, ``I = b h^3 / 12``, shear factor
``10 (1 + nu) / (12 + 11 nu)`` (Cowper 1966).

The torsion constant is ``pi r^4 / 2`` of a circle. That of a rectangle with the longer side a and the shorter side b is
(Timoshenko and Goodier 1951, art. 94)

    J = k a b^3,    k(x) = 1/3 (1 - 192 / pi^5 x sum_odd tanh(n pi / (2 x)) / n^5),    x = b / a,

which is one term where the ratio of the sides is fixed. Where it changes with parameters,

    J = a^2 b^2 g(x),    g(x) = g(1/x) = sum_k c_k x^k,

which is smooth also where the sides exchange their order, with c fitted over all ratios that the parameters have, exact
at the nominal values: three terms or more, as few as are `NEAR` it: 0.1 % off at most where sides that exchange their
order are up to four times as long as each other, 0.6 % up to `WIDEST`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.bodies.affine import AffineSum, Quantity
from pgmp_petsc.bodies.sections.section import ShapedSection
from pgmp_petsc.scene.bodies import Spans
from pgmp_petsc.scene.fields import PositiveOrParameter, Unit

NEAR = 5e-4  # of a torsion constant: how far a fit may be off it
MOST_TERMS = 11
WIDEST = 8.0  # ratio of sides up to which one fit is made on both sides of the square


class Circle(ShapedSection):
    """A solid circular cross-section."""

    round = True
    sizes = ("radius", "radius")
    shape: Literal["circle"]
    radius: Annotated[PositiveOrParameter, Unit("m")] = Field(description="radius (m)")

    @property
    def reach(self) -> tuple[Quantity, Quantity]:
        return (Quantity.of(self.radius),) * 2

    def area(self) -> AffineSum:
        return math.pi * AffineSum.of(self.radius) ** 2

    def inertia(self) -> tuple[AffineSum, AffineSum]:
        return (math.pi / 4 * AffineSum.of(self.radius) ** 4,) * 2

    def sheared(self, nu: float, nominal: Mapping[str, float], spans: Spans) -> tuple[AffineSum, AffineSum]:
        return (6 * (1 + nu) / (7 + 6 * nu) * self.area(),) * 2

    def torsion(self, nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        return 2.0 * self.inertia()[0]


class Rectangle(ShapedSection):
    """A solid rectangular cross-section."""

    sizes = ("height", "width")
    proportional = ("width",)
    shape: Literal["rectangle"]
    width: Annotated[PositiveOrParameter, Unit("m")] = Field(
        description="size across the plane of motion (m), in space along the third axis"
    )
    height: Annotated[PositiveOrParameter, Unit("m")] = Field(
        description="size in the plane of motion (m), in space along `orientation`"
    )

    @property
    def reach(self) -> tuple[Quantity, Quantity]:
        return 0.5 * Quantity.of(self.height), 0.5 * Quantity.of(self.width)

    def area(self) -> AffineSum:
        return AffineSum.of(self.width) * AffineSum.of(self.height)

    def inertia(self) -> tuple[AffineSum, AffineSum]:
        width, height = AffineSum.of(self.width), AffineSum.of(self.height)
        return height * width**3 * (1 / 12), width * height**3 * (1 / 12)

    def sheared(self, nu: float, nominal: Mapping[str, float], spans: Spans) -> tuple[AffineSum, AffineSum]:
        return (10 * (1 + nu) / (12 + 11 * nu) * self.area(),) * 2

    def torsion(self, nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        sides = Quantity.of(self.width), Quantity.of(self.height)
        short, long = sorted(sides, key=lambda side: float(side.at(nominal)))
        ratio = float(short.at(nominal) / long.at(nominal))
        exact = float(_square_share(ratio))
        if short.monomial == long.monomial:
            return AffineSum.total(exact / ratio * long * short**3)
        # of values at which each side is as short, or as long, as it gets
        found = spans()
        ends = [{name: found.get(name, (value, value))[end] for name, value in nominal.items()} for end in (0, 1)]
        least, most = ([float(side.at(values)) for side in (short, long)] for values in ends)
        largest = max(ratio, most[0] / max(least[1], most[0] / WIDEST))
        smallest = least[0] / most[1]
        if largest > 1.0:
            smallest = max(smallest, 1.0 / WIDEST)
        # fitted over ratios of the sides, and exact at the nominal one
        ratios = np.geomspace(min(smallest, ratio), largest, 200)
        wanted = _square_share(ratios)
        for n in range(3, MOST_TERMS + 1):
            fits = []
            for powers in np.arange(2 - n, n)[:, None] + np.arange(n) - n // 2:  # around the square, or to one side
                rows = ratios[:, None] ** powers.astype(float)
                factors = np.linalg.lstsq(rows / wanted[:, None], np.ones(ratios.size), rcond=None)[0]
                factors *= exact / (factors @ ratio ** powers.astype(float))
                fits.append((float(np.max(np.abs(rows @ factors / wanted - 1.0))), factors, powers))
            error, factors, powers = min(fits, key=lambda fit: fit[0])
            if error < NEAR:
                break
        return AffineSum.total(*(float(c) * short ** int(2 + k) * long ** int(2 - k) for c, k in zip(factors, powers)))


def _square_share(ratio: np.ndarray | float) -> np.ndarray:
    """Return ``J / (a b)^2`` of rectangles with ratios of their sides, one of which is as good as its inverse."""
    ratio = np.asarray(ratio, dtype=float)
    x, n = np.minimum(ratio, 1.0 / ratio), np.arange(1, 200, 2)
    series = np.sum(np.tanh(n * math.pi / (2.0 * x[..., None])) / n**5, axis=-1)
    return x / 3.0 * (1.0 - 192.0 / math.pi**5 * x * series)
