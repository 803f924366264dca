"""Distributions that scipy.stats has no name for or takes long to load, and tables of those whose quantiles it has to
search for.

============== =====================================================================================================
discrete       values with shares of their own
empirical      as measured: the distribution function goes through each of n sorted values at (k - 1/2) / n, straight
               between them (Hazen's positions), and the outermost ones keep half a share each. The mean is that of
               the values
mixture        shares of other distributions
============== =====================================================================================================

Distributions may have atoms: ``below`` is the share of smaller numbers, ``cdf`` that of no larger ones.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from scipy.stats._distn_infrastructure import rv_frozen

RESOLUTION = 1e-12  # of shares, of tables of quantiles
TAIL = 1e-9  # share beyond which quantiles are searched for: a table knows it to a thousandth of itself at least
MOST_DENSITIES = 20_000  # that a table may take; usual are 2,000 to 5,000
OFF = 1e-7  # of a share, beyond which a table is none: some distribution functions are themselves off by 1e-8
PROBES = np.array([1e-6, 1e-3, *np.linspace(0.02, 0.98, 25), 1.0 - 1e-3, 1.0 - 1e-6])


class Own:
    """A distribution of our own. By the names of scipy.stats it has its `support`, `mean` and `std`, the shares up to
    numbers (`cdf`) and above them (`sf`), and the smallest numbers that have shares up to them (`ppf`), or above
    (`isf`)."""

    has_atoms = False  # whether single values have shares

    def support(self) -> tuple[float, float]:
        return float(self._values[0]), float(self._values[-1])

    def median(self) -> float:
        return float(self.ppf(0.5))

    def below(self, x: np.ndarray | float) -> np.ndarray:
        """Return the share below x."""
        return self.cdf(x)

    def sf(self, x: np.ndarray | float) -> np.ndarray:
        return 1.0 - self.cdf(x)

    def isf(self, share: np.ndarray | float) -> np.ndarray:
        return self.ppf(1.0 - np.asarray(share))


@dataclass(frozen=True)
class Normal(Own):
    """The normal distribution as scipy.stats has it, whose import takes half a second."""

    loc: float
    scale: float

    def support(self) -> tuple[float, float]:
        return -math.inf, math.inf

    def mean(self) -> float:
        return self.loc

    median = mean

    def std(self) -> float:
        return self.scale

    def cdf(self, x: np.ndarray | float) -> np.ndarray | float:
        return self.sf(2.0 * self.loc - x)

    def sf(self, x: np.ndarray | float) -> np.ndarray | float:
        if np.ndim(x):
            from scipy.special import ndtr

            return ndtr((self.loc - x) / self.scale)
        return 0.5 * math.erfc((x - self.loc) / self.scale / math.sqrt(2.0))

    def ppf(self, share: np.ndarray | float) -> np.ndarray | float:
        if np.ndim(share) == 0 and 0.0 < share < 1.0:
            return NormalDist(self.loc, self.scale).inv_cdf(share)
        from scipy.special import ndtri

        return self.loc + self.scale * ndtri(share)

    def isf(self, share: np.ndarray | float) -> np.ndarray:
        return 2.0 * self.loc - self.ppf(share)


@dataclass(frozen=True)
class Uniform(Own):
    """The uniform distribution between loc and loc + scale."""

    loc: float
    scale: float

    def support(self) -> tuple[float, float]:
        return self.loc, self.loc + self.scale

    def mean(self) -> float:
        return self.loc + 0.5 * self.scale

    median = mean

    def std(self) -> float:
        return self.scale / math.sqrt(12.0)

    def cdf(self, x: np.ndarray | float) -> np.ndarray | float:
        if np.ndim(x):
            return np.clip((x - self.loc) / self.scale, 0.0, 1.0)
        return min(max((x - self.loc) / self.scale, 0.0), 1.0)

    def ppf(self, share: np.ndarray | float) -> np.ndarray:
        return self.loc + self.scale * share


class Discrete(Own):
    """Values (n,), each once or more often, with shares (n,) in any proportion, not negative."""

    has_atoms = True

    def __init__(self, values: np.ndarray, weights: np.ndarray) -> None:
        self._values, own = np.unique(values, return_inverse=True)
        shares = np.bincount(own, weights=weights)
        self._shares = shares / shares.sum()
        self._sums = np.cumsum(self._shares)
        self._sums[-1] = 1.0
        used = self._shares > 0.0
        self._values, self._shares, self._sums = self._values[used], self._shares[used], self._sums[used]

    def mean(self) -> float:
        return float(self._shares @ self._values)

    def std(self) -> float:
        return float(np.sqrt(self._shares @ (self._values - self.mean()) ** 2))

    def cdf(self, x: np.ndarray | float) -> np.ndarray:
        return np.append(0.0, self._sums)[np.searchsorted(self._values, x, side="right")]

    def below(self, x: np.ndarray | float) -> np.ndarray:
        return np.append(0.0, self._sums)[np.searchsorted(self._values, x, side="left")]

    def ppf(self, share: np.ndarray | float) -> np.ndarray:
        return self._values[np.minimum(np.searchsorted(self._sums, share, side="left"), len(self._values) - 1)]


class Empirical(Own):
    """Measured values (n,); see the module.

    It has no atoms but for half a share at either end, where a hair's breadth of values represents them.
    """

    def __init__(self, values: np.ndarray) -> None:
        self._values = np.sort(values)
        self._shares = (np.arange(len(values)) + 0.5) / len(values)

    def mean(self) -> float:
        return float(self._values.mean())

    def std(self) -> float:
        """Return the standard deviation: of straight lines between values, which is a little less than theirs."""
        steps = self._values - self.mean()
        first, last = steps[:-1], steps[1:]
        ends = 0.5 * (steps[0] ** 2 + steps[-1] ** 2)
        return float(np.sqrt((ends + np.sum(first**2 + first * last + last**2) / 3.0) / len(steps)))

    def cdf(self, x: np.ndarray | float) -> np.ndarray:
        return self._share(x, "right")

    def below(self, x: np.ndarray | float) -> np.ndarray:
        return self._share(x, "left")

    def ppf(self, share: np.ndarray | float) -> np.ndarray:
        return np.interp(share, self._shares, self._values)

    def _share(self, x: np.ndarray | float, side: str) -> np.ndarray:
        place, n = np.searchsorted(self._values, x, side=side), len(self._values)
        low, high = np.clip(place - 1, 0, n - 1), np.clip(place, 0, n - 1)
        width = self._values[high] - self._values[low]
        with np.errstate(invalid="ignore"):
            part = np.where(width > 0.0, (x - self._values[low]) / np.where(width > 0.0, width, 1.0), 0.0)
        between = self._shares[low] + part * (self._shares[high] - self._shares[low])
        return np.where(place == 0, 0.0, np.where(place == n, 1.0, between))


class Mixture(Own):
    """Shares (n_parts,) of other distributions, of scipy.stats or with its names, in any proportion, above 0."""

    def __init__(self, parts: Sequence[Any], weights: np.ndarray) -> None:
        self._parts, self._shares = tuple(parts), weights / weights.sum()

    @property
    def has_atoms(self) -> bool:
        return any(getattr(part, "has_atoms", False) for part in self._parts)

    def support(self) -> tuple[float, float]:
        ends = np.array([part.support() for part in self._parts], dtype=float)
        return float(ends[:, 0].min()), float(ends[:, 1].max())

    def mean(self) -> float:
        return float(self._shares @ [part.mean() for part in self._parts])

    def std(self) -> float:
        squares = [part.std() ** 2 + (part.mean() - self.mean()) ** 2 for part in self._parts]
        return float(np.sqrt(self._shares @ squares))

    def cdf(self, x: np.ndarray | float) -> np.ndarray:
        return sum(share * part.cdf(x) for share, part in zip(self._shares, self._parts))

    def below(self, x: np.ndarray | float) -> np.ndarray:
        return sum(share * getattr(part, "below", part.cdf)(x) for share, part in zip(self._shares, self._parts))

    def sf(self, x: np.ndarray | float) -> np.ndarray:
        return sum(share * part.sf(x) for share, part in zip(self._shares, self._parts))

    def ppf(self, share: np.ndarray | float) -> np.ndarray:
        """Return the smallest numbers that have shares up to them, by bisection between those of the parts."""
        return self._inverse(share, "ppf", lambda x, share: self.cdf(x) < share)

    def isf(self, share: np.ndarray | float) -> np.ndarray:
        return self._inverse(share, "isf", lambda x, share: self.sf(x) > share)

    def _inverse(self, share: np.ndarray | float, name: str, is_too_low: Any) -> np.ndarray:
        share = np.asarray(share, dtype=float)
        ends = np.array([np.broadcast_to(getattr(part, name)(share), share.shape) for part in self._parts], dtype=float)
        low, high = ends.min(axis=0), ends.max(axis=0)
        known = ~(np.isfinite(low) & np.isfinite(high))
        # below the lowest no share is reached, but at an atom of it
        begin = np.nextafter(np.where(known, 0.0, low), -np.inf)
        end = np.where(known, 1.0, high)
        while True:
            middle = 0.5 * begin + 0.5 * end
            moving = (middle > begin) & (middle < end)
            if not moving.any():
                break
            too_low = is_too_low(middle, share)
            begin, end = np.where(moving & too_low, middle, begin), np.where(moving & ~too_low, middle, end)
        return np.where(known, np.where(share < 0.5 if name == "ppf" else share > 0.5, low, high), end)


class Tabulated:
    """A distribution of scipy.stats with a table of its quantiles, which it would have to search for one by one.

    All but `ppf` and `isf` is scipy's own.
    """

    def __init__(self, frozen: rv_frozen, table: Any, loc: float, scale: float) -> None:
        self._frozen, self._table, self._loc, self._scale = frozen, table, loc, scale

    def __getattr__(self, name: str) -> Any:
        return getattr(self._frozen, name)

    def ppf(self, share: np.ndarray | float) -> np.ndarray:
        """Return the numbers that have shares below them; far tails are searched for."""
        return self._looked_up(share, share, self._frozen.ppf)

    def isf(self, share: np.ndarray | float) -> np.ndarray:
        """Return the numbers that have shares above them."""
        return self._looked_up(1.0 - np.asarray(share), share, self._frozen.isf)

    def _looked_up(self, below: np.ndarray | float, share: np.ndarray | float, search: Any) -> np.ndarray:
        below, share = np.asarray(below, dtype=float), np.asarray(share, dtype=float)
        inner = (below > TAIL) & (below < 1.0 - TAIL)
        found = np.empty(below.shape)
        try:
            found[~inner] = search(share[~inner])
        except RuntimeError:  # scipy's search in the tails of some does not end
            inner = (below > 0.0) & (below < 1.0)
            found[~inner] = search(share[~inner])
        found[inner] = self._loc + self._scale * self._table.ppf(below[inner])
        return found


def quick(frozen: rv_frozen) -> Any:
    """Return a distribution with a table of its quantiles where scipy.stats searches for each of them; else itself.

    The table is of polynomials that invert the integral of the density (Derflinger, Hoermann and Leydold, ACM
    Transactions on Modeling and Computer Simulation 20 (2010) 18; `scipy.stats.sampling.NumericalInversePolynomial`),
    whose error in shares is below `RESOLUTION`; it is compared with the distribution function before it is used.
    """
    from scipy.stats import rv_continuous

    if type(frozen.dist)._ppf is not rv_continuous._ppf:
        return frozen
    arguments = dict(frozen.kwds)
    loc, scale = arguments.pop("loc", 0.0), arguments.pop("scale", 1.0)
    table = _table(frozen.dist.name, tuple(sorted(arguments.items())))
    return frozen if table is None else Tabulated(frozen, table, loc, scale)


@cache
def _table(name: str, shapes: tuple[tuple[str, float], ...]) -> Any:
    """Return quantiles of a distribution of scale 1 at 0; None where they cannot be tabulated."""
    from scipy import stats
    from scipy.stats.sampling import NumericalInversePolynomial, UNURANError

    found, left = getattr(stats, name)(**dict(shapes)), iter(range(MOST_DENSITIES))

    def density(x: float) -> float:
        if next(left, None) is None:  # some have no end, as they repeat themselves
            raise ValueError("the table takes more than it saves")
        return float(found.pdf(x))

    with warnings.catch_warnings(), np.errstate(all="ignore"):  # of densities at the ends
        warnings.simplefilter("ignore")
        try:
            counted, centre = SimpleNamespace(pdf=density), float(found.median())
            table = NumericalInversePolynomial(counted, center=centre, domain=found.support(), u_resolution=RESOLUTION)
        except (UNURANError, ValueError):
            return None
        off = np.abs(found.cdf(table.ppf(PROBES)) - PROBES)
    return table if np.all(off <= OFF * np.minimum(PROBES, 1.0 - PROBES) ** 0.5) else None
