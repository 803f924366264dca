"""Sectional stiffness and inertia of beams as affine quantities.

Circle of radius r: ``A = pi r^2``, ``I = pi r^4 / 4``, shear factor ``6 (1 + nu) / (7 + 6 nu)``; rectangle of
width b and height h (h in the plane of motion): ``A = b h``, ``I = b h^3 / 12``, shear factor
``10 (1 + nu) / (12 + 11 nu)`` (Cowper 1966).

In space the second axis of a section is along its height, the third along its width; ``I_3 = b h^3 / 12`` resists
bending in the plane of the height, ``I_2 = h b^3 / 12`` in that of the width. The torsion constant is ``pi r^4 / 2`` of
a circle. That of a rectangle with the longer side a and the shorter side b is (Timoshenko and Goodier 1951, art. 94)

    J = k a b^3,    k(x) = 1/3 (1 - 192 / pi^5 x sum_odd tanh(n pi / (2 x)) / n^5),    x = b / a,

which is one term where the ratio of the sides is fixed. Where it changes with parameters, k is that of the polynomial
``1/3 (1 - 0.63 x (1 - x^4 / 12))``, scaled to be exact at the nominal values: three terms, 0.5 % off at most while the
side that is shorter at the nominal values stays the shorter one. Where values of the parameters exchange both,

    J = a^2 b^2 g(x),    g(x) = g(1/x) = sum_k c_k x^k,

which is smooth, with c fitted over all ratios that the parameters have: three to nine terms, as few as are `NEAR` it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.scene.bodies import Circle, Coefficients, Coefficients3d, Material, Rectangle

NEAR = 3e-3  # of a torsion constant: how far a fit may be off it
NEARLY_SQUARE = 0.8  # ratio of sides from which on they may exchange
MOST_TERMS = 9
WIDEST = 8.0  # ratio of sides up to which one fit is made on both sides of the square


@dataclass(frozen=True)
class BeamSection:
    """Coefficients of a planar beam, each a constant times a monomial of the parameters."""

    axial: Quantity  # E A, N
    shear: Quantity  # k_s G A, N
    bending: Quantity  # E I, N m^2
    line_density: Quantity  # rho A, kg/m
    rotary_density: Quantity  # rho I, kg m

    @classmethod
    def of(cls, section: Circle | Rectangle | Coefficients, material: Material | None) -> BeamSection:
        """Derive the coefficients from a scene's section and material; a section given by coefficients has none."""
        if isinstance(section, Coefficients):
            entries = (section.axial, section.shear, section.bending, section.line_density, section.rotary_density)
            return cls(*map(Quantity.of, entries))
        nu = material.nu
        if isinstance(section, Circle):
            radius = Quantity.of(section.radius)
            area, inertia = math.pi * radius**2, math.pi / 4 * radius**4
            shear_factor = 6 * (1 + nu) / (7 + 6 * nu)
        else:
            width, height = Quantity.of(section.width), Quantity.of(section.height)
            area, inertia = width * height, width * height**3 * (1 / 12)
            shear_factor = 10 * (1 + nu) / (12 + 11 * nu)
        young, density = Quantity.of(material.E), Quantity.of(material.rho)
        return cls(
            axial=young * area,
            shear=young * area * (shear_factor / (2 * (1 + nu))),
            bending=young * inertia,
            line_density=density * area,
            rotary_density=density * inertia,
        )

    def stiffness_terms(self) -> dict[Monomial, tuple[float, float, float]]:
        """Return (EA, k_s GA, EI) coefficients by monomial."""
        return _by_monomial(((self.axial,), (self.shear,), (self.bending,)))

    def mass_terms(self) -> dict[Monomial, tuple[float, float]]:
        """Return (rho A, rho I) coefficients by monomial."""
        return _by_monomial(((self.line_density,), (self.rotary_density,)))


@dataclass(frozen=True)
class SpatialSection:
    """Coefficients of a beam in space, each a constant times a monomial of the parameters.

    Attributes
    ----------
    axial, shear
        E A; k_s G A along the second and the third axis, N.
    torsion
        Terms of G J, N m^2.
    bending
        E I_2 and E I_3, N m^2.
    line_density, rotary
        rho A, kg/m; rho I_2 and rho I_3, kg m.
    lever
        ``(I_3 - I_2) / (I_2 + I_3)`` at the nominal values: how unlike both are about the axis.
    """

    axial: Quantity
    shear: tuple[Quantity, Quantity]
    torsion: tuple[Quantity, ...]
    bending: tuple[Quantity, Quantity]
    line_density: Quantity
    rotary: tuple[Quantity, Quantity]
    lever: float

    @classmethod
    def of(
        cls,
        section: Circle | Rectangle | Coefficients3d,
        material: Material | None,
        nominal: Mapping[str, float],
        spans: Mapping[str, tuple[float, float]] | None = None,
    ) -> SpatialSection:
        """Derive the coefficients from a scene's section and material, which a section by coefficients has not.

        `spans` has the smallest and largest values that parameters take, where they vary.
        """
        if isinstance(section, Coefficients3d):
            given = {name: Quantity.of(entry) for name, entry in section if name != "shape"}
            pairs = {name: (given[f"{name}_2"], given[f"{name}_3"]) for name in ("shear", "bending", "rotary")}
            return cls(
                given["axial"],
                pairs["shear"],
                (given["torsion"],),
                pairs["bending"],
                given["line_density"],
                pairs["rotary"],
                _lever(pairs["rotary"], nominal),
            )
        flat = BeamSection.of(section, material)
        young, density = Quantity.of(material.E), Quantity.of(material.rho)
        if isinstance(section, Circle):
            inertia = (0.25 * math.pi * Quantity.of(section.radius) ** 4,) * 2
            torsion = (2.0 * inertia[0],)
        else:
            sides = Quantity.of(section.width), Quantity.of(section.height)
            inertia = tuple(one * other**3 * (1 / 12) for one, other in (sides[::-1], sides))
            torsion = _of_rectangle(sides, nominal, spans or {})
        return cls(
            flat.axial,
            (flat.shear, flat.shear),
            tuple(young * part * (0.5 / (1 + material.nu)) for part in torsion),
            tuple(young * part for part in inertia),
            flat.line_density,
            tuple(density * part for part in inertia),
            _lever(inertia, nominal),
        )

    def stiffness_terms(self) -> dict[Monomial, tuple[float, ...]]:
        """Return (EA, GA_2, GA_3, GJ, EI_2, EI_3) coefficients by monomial."""
        parts = (self.axial,), *((part,) for part in self.shear), self.torsion, *((part,) for part in self.bending)
        return _by_monomial(parts)

    def mass_terms(self) -> dict[Monomial, tuple[float, ...]]:
        """Return (rho A, rho I_2, rho I_3) coefficients by monomial."""
        return _by_monomial(((self.line_density,), *((part,) for part in self.rotary)))


def _lever(inertia: tuple[Quantity, Quantity], nominal: Mapping[str, float]) -> float:
    about_2, about_3 = (float(part.at(nominal)) for part in inertia)
    return (about_3 - about_2) / (about_2 + about_3)


def _of_rectangle(
    sides: Sequence[Quantity], nominal: Mapping[str, float], spans: Mapping[str, tuple[float, float]]
) -> tuple[Quantity, ...]:
    """Return the terms of a rectangle's torsion constant; see the module."""
    short, long = sorted(sides, key=lambda side: float(side.at(nominal)))
    ratio = float(short.at(nominal) / long.at(nominal))
    exact = float(_square_share(ratio))
    if short.monomial == long.monomial:
        return (exact / ratio * long * short**3,)
    # of values at which each side is as short, or as long, as it gets
    ends = [{name: spans.get(name, (value, value))[end] for name, value in nominal.items()} for end in (0, 1)]
    least, most = ([float(side.at(values)) for side in (short, long)] for values in ends)
    largest = most[0] / max(least[1], most[0] / WIDEST)
    if largest > NEARLY_SQUARE:
        smallest = max(least[0] / most[1], 1.0 / WIDEST)
        return _fitted(short, long, np.geomspace(min(smallest, ratio), largest, 200), ratio)
    factor = exact / ratio / (1.0 - 0.63 * ratio * (1.0 - ratio**4 / 12.0))
    return factor * long * short**3, -0.63 * factor * short**4, 0.0525 * factor * short**8 * long**-4


def _fitted(short: Quantity, long: Quantity, ratios: np.ndarray, nominal: float) -> tuple[Quantity, ...]:
    """Return the terms of a torsion constant over ratios (n,) of its sides on both sides of 1, exact at `nominal`."""
    exact = _square_share(ratios)
    for n in range(3, MOST_TERMS + 1, 2):
        fits = []
        for powers in np.arange(2 - n, n)[:, None] + np.arange(n) - n // 2:  # rows around the square, or to one side
            rows = ratios[:, None] ** powers.astype(float)
            found = np.linalg.lstsq(rows / exact[:, None], np.ones(ratios.size), rcond=None)[0]
            found *= _square_share(nominal) / (found @ nominal ** powers.astype(float))
            fits.append((float(np.max(np.abs(rows @ found / exact - 1.0))), found, powers))
        error, found, powers = min(fits, key=lambda fit: fit[0])
        if error < NEAR:
            break
    return tuple(float(c) * short ** int(2 + k) * long ** int(2 - k) for c, k in zip(found, powers))


def _square_share(ratio: np.ndarray | float) -> np.ndarray:
    """Return ``J / (a b)^2`` of rectangles with ratios of their sides, one of which is as good as its inverse."""
    ratio = np.asarray(ratio, dtype=float)
    x, n = np.minimum(ratio, 1.0 / ratio), np.arange(1, 200, 2)
    series = np.sum(np.tanh(n * math.pi / (2.0 * x[..., None])) / n**5, axis=-1)
    return x / 3.0 * (1.0 - 192.0 / math.pi**5 * x * series)


def _by_monomial(sums: Iterable[Sequence[Quantity]]) -> dict[Monomial, tuple[float, ...]]:
    """Group sums of quantities by monomial, with zeros where none of a sum has it."""
    sums = list(sums)
    monomials = dict.fromkeys(part.monomial for parts in sums for part in parts)
    return {m: tuple(sum(q.coefficient for q in parts if q.monomial == m) for parts in sums) for m in monomials}
