"""Affine parameter dependence: constants times monomials of the uncertain parameters.

The full-order model is ``M(p) = sum_i w_i(p) M_i`` and ``g_int(q, p) = sum_i w_i(p) g_i(q)`` (Naets et al. 2015,
eq. (2)). Every weight ``w_i`` that sections and materials produce is a monomial such as ``r1**4`` or ``E * r1**2``;
terms with the same monomial are one term.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Powers = tuple[tuple[Any, int], ...]
Values = Mapping[str, "np.ndarray | float"]  # of parameters, by name: numbers, or of one shape


@dataclass(frozen=True, order=True)
class Place:
    """The place of a parameter in a range: ``(value - middle) / half``, -1 to 1, written ``length(0.7,0.035)``.

    Monomials of places have no round-off where those of a parameter that hardly varies cancel.
    """

    name: str
    middle: float
    half: float

    def __str__(self) -> str:
        return f"{self.name}({self.middle!r},{self.half!r})"

    @classmethod
    def parse(cls, text: str) -> Place:
        """Read back what ``str`` wrote."""
        name, _, numbers = text.rstrip(")").partition("(")
        middle, half = numbers.split(",")
        return cls(name, float(middle), float(half))

    def at(self, values: Values) -> np.ndarray | float:
        """Return the place at the given parameter values."""
        return (values[self.name] - self.middle) / self.half


@dataclass(frozen=True, order=True)
class Monomial:
    """A product of integer powers of parameters, e.g. ``(("E", 1), ("r1", 4))``; the empty product is 1.

    `places` are powers of places in ranges (`Place`), which tables of lengths have as factors besides.
    """

    powers: tuple[tuple[str, int], ...] = ()
    places: tuple[tuple[Place, int], ...] = ()

    def __mul__(self, other: Monomial) -> Monomial:
        if not (other.powers or other.places):
            return self
        return Monomial(_product(self.powers, other.powers), _product(self.places, other.places))

    def __pow__(self, exponent: int) -> Monomial:
        if exponent == 0:
            return Monomial()
        powers, places = (tuple((base, e * exponent) for base, e in part) for part in (self.powers, self.places))
        return Monomial(powers, places)

    def __str__(self) -> str:
        factors = (*self.powers, *self.places)
        return " ".join(f"{base}" if e == 1 else f"{base}^{e}" for base, e in factors) or "1"

    @classmethod
    def parse(cls, text: str) -> Monomial:
        """Read back what ``str`` wrote."""
        factors = [] if text == "1" else [factor.partition("^") for factor in text.split(" ")]
        powers = [(base, int(exponent or 1)) for base, _, exponent in factors]
        return cls(
            tuple((base, e) for base, e in powers if "(" not in base),
            tuple((Place.parse(base), e) for base, e in powers if "(" in base),
        )

    def evaluate(self, values: Values) -> np.ndarray | float:
        """Return the monomial at the given parameter values (scalars or arrays of one shape)."""
        result: np.ndarray | float = 1.0
        for name, exponent in self.powers:
            result = result * values[name] ** exponent
        for place, exponent in self.places:
            result = result * place.at(values) ** exponent
        return result

    def derivative(self, name: str, values: Values) -> np.ndarray | float:
        """Return the derivative with one of the parameters at the given values."""
        total: np.ndarray | float = 0.0
        for part, others in (("powers", "places"), ("places", "powers")):
            for base, exponent in getattr(self, part):
                if name == (base.name if isinstance(base, Place) else base):
                    less = tuple((b, e - (b == base)) for b, e in getattr(self, part) if e != 1 or b != base)
                    factor = exponent / base.half if isinstance(base, Place) else exponent
                    total = total + factor * Monomial(**{part: less, others: getattr(self, others)}).evaluate(values)
        return total


def _product(one: Powers, other: Powers) -> Powers:
    exponents = dict(one)
    for base, exponent in other:
        exponents[base] = exponents.get(base, 0) + exponent
    return tuple(sorted((base, e) for base, e in exponents.items() if e != 0))


@dataclass(frozen=True)
class Quantity:
    """A physical quantity ``coefficient * monomial``, closed under products and powers."""

    coefficient: float
    monomial: Monomial = Monomial()

    @classmethod
    def of(cls, entry: float | str) -> Quantity:
        """Make a quantity from a scene entry: a number, or a parameter's name."""
        return cls(1.0, Monomial(((entry, 1),))) if isinstance(entry, str) else cls(float(entry))

    def at(self, values: Values) -> np.ndarray | float:
        """Return the quantity at the given parameter values."""
        return self.coefficient * self.monomial.evaluate(values)

    def derivative(self, name: str, values: Values) -> np.ndarray | float:
        """Return the derivative with one of the parameters at the given values."""
        return self.coefficient * self.monomial.derivative(name, values)

    def __mul__(self, other: Quantity | float) -> Quantity:
        if isinstance(other, Quantity):
            return Quantity(self.coefficient * other.coefficient, self.monomial * other.monomial)
        return Quantity(self.coefficient * other, self.monomial)

    __rmul__ = __mul__

    def __pow__(self, exponent: int) -> Quantity:
        return Quantity(self.coefficient**exponent, self.monomial**exponent)


@dataclass(frozen=True)
class AffineSum:
    """A sum of quantities, closed under sums and products."""

    terms: tuple[tuple[Monomial, float], ...]  # monomials, each once, with their coefficients

    @classmethod
    def of(cls, entry: float | str) -> AffineSum:
        """Make a sum of one term from a scene entry: a number, or a parameter's name."""
        return cls.total(Quantity.of(entry))

    @classmethod
    def total(cls, *parts: Quantity) -> AffineSum:
        """Return the sum of quantities."""
        found: dict[Monomial, float] = {}
        for part in parts:
            found[part.monomial] = found.get(part.monomial, 0.0) + part.coefficient
        return cls(tuple(found.items()))

    def at(self, values: Values) -> np.ndarray | float:
        """Return the sum at the given parameter values."""
        return sum(part.at(values) for part in self)

    def derivative(self, name: str, values: Values) -> np.ndarray | float:
        """Return the derivative with one of the parameters at the given values."""
        return sum(part.derivative(name, values) for part in self)

    def __iter__(self) -> Iterator[Quantity]:
        return (Quantity(coefficient, monomial) for monomial, coefficient in self.terms)

    def __add__(self, other: AffineSum) -> AffineSum:
        return AffineSum.total(*self, *other)

    def __sub__(self, other: AffineSum) -> AffineSum:
        return self + -1.0 * other

    def __mul__(self, other: AffineSum | Quantity | float) -> AffineSum:
        if isinstance(other, (float, int)):
            return AffineSum(tuple((monomial, coefficient * other) for monomial, coefficient in self.terms))
        factors = other if isinstance(other, AffineSum) else (other,)
        return AffineSum.total(*(one * factor for one in self for factor in factors))

    __rmul__ = __mul__

    def __pow__(self, exponent: int) -> AffineSum:
        result = AffineSum.of(1.0)
        for _ in range(exponent):
            result = result * self
        return result


ByWeight = Mapping[Monomial, np.ndarray]  # what remains of affine terms when their weights are taken out


def total_at(terms: ByWeight, values: Mapping[str, float]) -> np.ndarray:
    """Return ``sum_i w_i A_i`` at parameter values, by which no weight is of more than one number."""
    return sum(float(weight.evaluate(values)) * term for weight, term in terms.items())


def evaluate_weights(monomials: Iterable[Monomial], values: Values) -> np.ndarray:
    """Return the weights of several terms, shape (n_terms,) or (n_terms, n_samples), at parameter values that are
    numbers or of shape (n_samples,)."""
    monomials = list(monomials)
    shape = np.broadcast_shapes(*(np.shape(value) for value in values.values())) if values else ()
    weights = np.empty((len(monomials), *shape))
    for index, monomial in enumerate(monomials):
        weights[index] = monomial.evaluate(values)
    return weights
