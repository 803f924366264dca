"""Affine parameter dependence: constants times monomials of the uncertain parameters.

The full-order model is ``M(p) = sum_i w_i(p) M_i`` and ``g_int(q, p) = sum_i w_i(p) g_i(q)`` (Naets et al. 2015,
eq. (2)). Every weight ``w_i`` that sections and materials produce is a monomial such as ``r1**4`` or ``E * r1**2``;
terms with the same monomial are one term.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, order=True)
class Monomial:
    """A product of integer powers of parameters, e.g. ``(("E", 1), ("r1", 4))``; the empty product is 1."""

    powers: tuple[tuple[str, int], ...] = ()

    def __mul__(self, other: Monomial) -> Monomial:
        exponents = dict(self.powers)
        for name, exponent in other.powers:
            exponents[name] = exponents.get(name, 0) + exponent
        return Monomial(tuple(sorted((name, e) for name, e in exponents.items() if e != 0)))

    def __pow__(self, exponent: int) -> Monomial:
        return Monomial(tuple((name, e * exponent) for name, e in self.powers if exponent != 0))

    def __str__(self) -> str:
        if not self.powers:
            return "1"
        return " ".join(name if e == 1 else f"{name}^{e}" for name, e in self.powers)

    @classmethod
    def parse(cls, text: str) -> Monomial:
        """Read back what ``str`` wrote."""
        factors = [] if text == "1" else [factor.partition("^") for factor in text.split(" ")]
        return cls(tuple((name, int(exponent or 1)) for name, _, exponent in factors))

    def evaluate(self, values: Mapping[str, np.ndarray | float]) -> np.ndarray | float:
        """Return the monomial at the given parameter values (scalars or arrays of one shape)."""
        result: np.ndarray | float = 1.0
        for name, exponent in self.powers:
            result = result * values[name] ** exponent
        return result

    def derivative(self, name: str, values: Mapping[str, np.ndarray | float]) -> np.ndarray | float:
        """Return the derivative with one of the parameters at the given values."""
        exponents = dict(self.powers)
        exponent = exponents.pop(name, 0)
        if exponent == 0:
            return 0.0
        if exponent != 1:
            exponents[name] = exponent - 1
        return exponent * Monomial(tuple(sorted(exponents.items()))).evaluate(values)


@dataclass(frozen=True)
class Quantity:
    """A physical quantity ``coefficient * monomial``, closed under products and powers."""

    coefficient: float
    monomial: Monomial = Monomial()

    @classmethod
    def of(cls, entry: float | str) -> Quantity:
        """Make a quantity from a scene entry: a number, or a parameter's name."""
        if isinstance(entry, str):
            return cls(1.0, Monomial(((entry, 1),)))
        return cls(float(entry))

    def at(self, values: Mapping[str, np.ndarray | float]) -> np.ndarray | float:
        """Return the quantity at the given parameter values."""
        return self.coefficient * self.monomial.evaluate(values)

    def __mul__(self, other: Quantity | float) -> Quantity:
        if isinstance(other, Quantity):
            return Quantity(self.coefficient * other.coefficient, self.monomial * other.monomial)
        return Quantity(self.coefficient * other, self.monomial)

    __rmul__ = __mul__

    def __pow__(self, exponent: int) -> Quantity:
        return Quantity(self.coefficient**exponent, self.monomial**exponent)


def evaluate_weights(monomials: Iterable[Monomial], values: Mapping[str, np.ndarray | float]) -> np.ndarray:
    """Stack the weights of several terms.

    Parameters
    ----------
    monomials
        The n_terms weights.
    values
        Parameter values, scalars or arrays of shape (n_samples,).

    Returns
    -------
    ndarray, shape (n_terms,) or (n_terms, n_samples)
    """
    monomials = list(monomials)
    shape = np.broadcast_shapes(*(np.shape(value) for value in values.values())) if values else ()
    weights = np.empty((len(monomials), *shape))
    for index, monomial in enumerate(monomials):
        weights[index] = monomial.evaluate(values)
    return weights
